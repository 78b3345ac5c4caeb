"""Settings from real sources: logs of terminals, old forms, and files of every controller."""

from __future__ import annotations

import codecs
import random
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.machine.test_firmware import FLUIDNC, KLIPPER, REPRAPFIRMWARE
from threadline.cli.from_settings import settings_files
from threadline.errors import MachineError, OptionError
from threadline.machine import load_machine
from threadline.machine.firmware import (
    Settings,
    machine_text,
    missing_answers,
    parse_answers,
    read_settings,
)
from threadline.machine.motion_planner import MarlinPlanner

GRBL = """$0=10
$11=0.020
$13=0
$100=250.000
$101=251.000
$102=400.500
$110=5000.000
$111=4000.000
$112=500.000
$120=200.000
$121=150.000
$122=50.000
$130=300.000
$131=180.000
$132=45.000
ok
"""
FIRST = """echo:Steps per unit:
echo:  M92 X80.00 Y81.00 Z800.00 E92.60
echo:Maximum feedrates (mm/s):
echo:  M203 X300.00 Y200.00 Z3.00 E25.00
echo:Maximum Acceleration (mm/s2):
echo:  M201 X9000 Y8000 Z100 E1000
echo:Acceleration: S=acceleration, T=retract acceleration
echo:  M204 S3000.00 T500.00
echo:Advanced variables: S=Min feedrate (mm/s), T=Min travel feedrate (mm/s), B=minimum segment \
time (ms), X=maximum XY jerk (mm/s),  Z=maximum Z jerk (mm/s),  E=maximum E jerk (mm/s)
echo:  M205 S0.00 T0.00 B20000 X20.00 Z0.40 E5.00
"""


def read(folder: Path, text: str | bytes, name: str = "settings.txt") -> Settings:
    file = folder / name
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_settings(file)


def numbers(settings: Settings) -> dict[str, float]:
    """Return the content of the settings without their lines."""
    found = {key: setting.value for key, setting in settings.planner.items()}
    for axis, setting in settings.axes.items():
        for what in ("steps", "rate", "acceleration", "travel", "microsteps"):
            one = getattr(setting, what)
            if one is not None:
                found[f"{axis} {what}"] = one.value
    return found


def each(change: Callable[[str], str]) -> Callable[[str], bytes]:
    """A terminal that writes text before or after every line."""
    return lambda text: "".join(f"{change(line)}\n" for line in text.splitlines()).encode()


TERMINALS: dict[str, Callable[[str], bytes]] = {
    "UGS": lambda text: (
        b"Grbl 1.1h ['$' for help]\n>>> $$\n"
        + re.sub(r"=([\d.]+)$", r" = \1    (Axis, step/mm)", text, flags=re.M).encode()
    ),
    "arrows": each(lambda line: f"< {line}"),
    "explained": each(lambda line: f"{line} >> Step resolution (step/mm) : in steps\n"),
    "received": each(lambda line: f"Recv: {line}"),
    "dated": each(lambda line: f"2021-08-01 11:12:13,456 - Recv: {line}"),
    "clock": each(lambda line: f"22:24:55.009 : {line}"),
    "clock of twelve": each(lambda line: f"< 8:04:47 PM: {line}"),
    "Arduino": each(lambda line: f"16:52:24.183 -> {line}"),
    "in brackets": each(lambda line: f"[12:31:07] {line}"),
    "client": each(lambda line: f"serial> {line}"),
    "port": each(lambda line: f"COM3: {line}"),
    "printer": each(lambda line: f"[PRINTER] {line}"),
    "logger": each(lambda line: f"2021-08-01 11:12:13,456 INFO {line}"),
    "journal": each(lambda line: f"Nov 29 12:03:44 pi sender[812]: {line}"),
    "numbered": lambda text: "".join(
        f"{number:4d}\t{line}\n" for number, line in enumerate(text.splitlines(), 1)
    ).encode(),
    "quoted": each(lambda line: f"│ {line}"),
    "mark": lambda text: codecs.BOM_UTF8 + text.encode(),
    "wide": lambda text: text.encode("utf-16"),
    "wide, little end first, no mark": lambda text: text.encode("utf-16-le"),
    "wide, big end first, no mark": lambda text: text.encode("utf-16-be"),
    "Windows": lambda text: text.replace("\n", "\r\n").encode(),
    "prose": lambda text: f"My machine moves well.\n\n{text}\nAny ideas?\n".encode(),
    "backup": lambda text: (
        "%\n; grblHAL\n; [OPT:VNMSL+,999,1024,4,0]\n$N0=\n$N1=\n; 100 - X\n" + text + "$376=1\n%\n"
    ).encode(),
}


OF_GRBL = ("UGS", "explained", "backup")


@pytest.mark.parametrize(
    ("text", "terminal"),
    [(GRBL, name) for name in TERMINALS]
    + [(FIRST, name) for name in TERMINALS if name not in OF_GRBL],
)
def test_text_of_a_terminal_around_a_dump_is_ignored(
    text: str, terminal: str, tmp_path: Path
) -> None:
    plain = numbers(read(tmp_path, text))
    assert len(plain) > 12
    assert numbers(read(tmp_path, TERMINALS[terminal](text))) == plain


def test_settings_may_share_a_line(tmp_path: Path) -> None:
    lines = GRBL.splitlines()
    joined = "\n".join(" ".join(lines[at : at + 3]) for at in range(0, len(lines), 3))
    assert numbers(read(tmp_path, joined + "\n")) == numbers(read(tmp_path, GRBL))


def test_the_last_whole_dump_of_a_log_counts(tmp_path: Path) -> None:
    older = GRBL.replace("$110=5000", "$110=3000").replace("$122=50", "$122=20")
    settings = read(tmp_path, f">>> $$\n{older}>>> $110=5000\nok\n>>> $$\n{GRBL}")
    assert numbers(settings) == numbers(read(tmp_path, GRBL))
    assert "the last of 2 complete dumps in this file is read, lines 22 to 35" in settings.notes[0]
    cut = "".join(GRBL.splitlines(keepends=True)[:6])
    assert numbers(read(tmp_path, older + GRBL + cut)) == numbers(read(tmp_path, GRBL))


def test_warnings_come_only_from_the_last_dump(tmp_path: Path) -> None:
    older = FIRST.replace("M204 S3000", "M204 S2000") + "echo:  M852 I0.0100\n"
    newer = FIRST + "echo:  M852 I0.0200\n"
    (ignored,) = read(tmp_path, older + newer).ignored
    assert "M852 I0.0200" in ignored
    (ignored,) = read(tmp_path, newer + newer).ignored
    assert "M852 I0.0200" in ignored


@pytest.mark.parametrize("behind", [">>> $110=6000\nok\n", ">>> $$\n$11=0.020\n$100=111.000\n"])
def test_setting_that_contradicts_the_last_whole_dump_is_refused(
    behind: str, tmp_path: Path
) -> None:
    """A setting sent after the dump, or a cut-off dump: neither is passed over."""
    with pytest.raises(MachineError, match=r"is \S+ here and \S+ on line \d+"):
        read(tmp_path, GRBL + behind)


def test_zeros_stand_for_none(tmp_path: Path) -> None:
    """$102=0: no such axis, whatever its other settings are; $133=0.000: no end of its travel."""
    text = GRBL.replace("$102=400.500", "$102=0.000").replace("$132=45.000", "$132=-0.000")
    text += "$103=88.88889\n$113=7200.000\n$123=300.000\n$133=0.000\n"
    settings = read(tmp_path, text)
    assert list(settings.axes) == ["X", "Y", "A"]
    assert settings.axes["A"].travel is None
    assert len(settings.notes) == 2
    asked = [one.key for one in missing_answers(settings, parse_answers([]), limits_only=True)]
    assert asked == ["rotary", "radius"]
    # The proposed answer works; for a linear axis the end is asked for.
    machine_text(settings, parse_answers(["rotary=A", "radius=5 mm"]), "m", limits_only=True)
    along = missing_answers(settings, parse_answers(["rotary=none"]), limits_only=True)
    assert [one.key for one in along] == ["travel.A"]


def test_a_firmware_names_its_axes(tmp_path: Path) -> None:
    text = "[AXS:4:XYZC]\n" + GRBL + "$103=10\n$113=100\n$123=100\n$133=360\n"
    assert list(read(tmp_path, text).axes) == ["X", "Y", "Z", "C"]


@pytest.mark.parametrize("answer", ["none", "", "0", "no"])
def test_no_axis_that_turns_is_an_answer(answer: str, tmp_path: Path) -> None:
    settings = read(tmp_path, GRBL + "$103=10\n$113=100\n$123=100\n$133=360\n")
    text = machine_text(settings, parse_answers([f"rotary={answer}"]), "m", limits_only=True)
    assert "rotary" not in text and "[axes.A]" in text


def test_settings_of_x_y_z_need_no_answer_about_rotary_axes(tmp_path: Path) -> None:
    assert not missing_answers(read(tmp_path, GRBL), parse_answers([]), limits_only=True)


def marlin(rng: random.Random, form: str) -> tuple[str, dict[str, float]]:
    """Return a dump of ``form``, in the letters of its source, and the acceleration of a move."""
    at, jx, jy, jz, slow = (round(rng.uniform(1.0, 900.0), 2) for _ in range(5))
    other = at + 77.0
    meant = {"acceleration": at, "least_speed": slow, "jump.X": jx, "jump.Z": jz}
    if form == "1.0":
        lines = [f"M204 S{at} T{other}", f"M205 S0.00 T{slow} B20000 X{jx} Z{jz} E5.00"]
        meant["jump.Y"] = jx
    elif form == "1.0 with its comments":
        lines = [
            "Acceleration: S=acceleration, T=retract acceleration",
            f"M204 S{at} T{other}",
            "Advanced variables: X=maximum XY jerk (mm/s)",
            f"M205 S0.00 T{slow} B20000 X{jx} Z{jz} E5.00",
        ]
        meant["jump.Y"] = jx
    elif form == "kimbra":
        lines = [f"M204 P{other} V{at}", "M204 T0 R10000.00"]
        lines += [f"M205 S0.00 V{slow} B20000 X{jx} Y{jy} Z{jz} E5.00", "M205 T1 E4.00"]
        meant["jump.Y"] = jy
    elif form == "kimbra, old":
        lines = ["Accelerations: P=printing, V=travel and T* R=retract", f"M204 P{other} V{at}"]
        lines += ["M204 T0 R10000.00", f"M205 S0.00 V{slow} B20000 X{jx} Z{jz} E5.00"]
        meant["jump.Y"] = jx
    elif form == "1.1, release candidate":
        lines = [f"M204 P{other} R{other} T{at}"]
        lines += ["Advanced variables: X=maximum XY jerk (mm/s)"]
        lines += [f"M205 S0.00 T{slow} B20000 X{jx} Z{jz} E5.00"]
        meant["jump.Y"] = jx
    elif form == "1.1.9":
        lines = [f"M204 P{other} R{other} T{at}"]
        lines += [f"M205 Q20000 S0.00 T{slow} X{jx} Y{jy} Z{jz} E2.50"]
        meant["jump.Y"] = jy
    else:
        lines = [f"M204 P{other} R{other} T{at}", f"M205 B20000.00 S0.00 T{slow} J0.02"]
        meant = {"acceleration": at, "least_speed": slow, "junction_deviation": 0.02}
    return "".join(f"echo:  {line}\n" for line in lines), meant


@pytest.mark.parametrize(
    ("form", "named"),
    [
        ("1.0", "Marlin 1.0"), ("1.0 with its comments", "Marlin 1.0"),
        ("kimbra", "MarlinKimbra or MK4duo"), ("kimbra, old", "MarlinKimbra or MK4duo"),
        ("1.1, release candidate", "Marlin 1.1 or later"), ("1.1.9", "Marlin 1.1 or later"),
        ("2", "Marlin 1.1 or later"),
    ],
)  # fmt: skip
def test_each_form_of_marlin_s_dump_is_read_as_its_own(
    form: str, named: str, tmp_path: Path
) -> None:
    """S of M204 counts for every move in 1.0, T for retracting; V is for travel, T in 1.1."""
    rng = random.Random(form)
    for _ in range(20):
        text, meant = marlin(rng, form)
        head = "echo:  M92 X80 Y80 Z400\necho:  M203 X9 Y9 Z9\necho:  M201 X9 Y9 Z9\n"
        settings = read(tmp_path, head + text)
        assert settings.form == named
        assert {key: setting.value for key, setting in settings.planner.items()} == meant


@pytest.mark.parametrize(
    ("message", "slower"),
    [
        ("FIRMWARE_NAME:Marlin 2.1.2.4 (Jan  1 2024)", True), ("echo:Marlin 1.1.9", True),
        ("Marlin 2.0", True), ("FIRMWARE_NAME:Marlin 2.1.3 (Jan  1 2026)", False), ("", False),
    ],
)  # fmt: skip
def test_the_version_of_marlin_says_what_bounds_a_corner(
    message: str, slower: bool, tmp_path: Path
) -> None:
    """If the settings do not state it, a note says so."""
    limits = "M92 X80 Y80\nM203 X200 Y200\nM201 X500 Y300\nM204 T800\nM205 J0.02\n"
    settings = read(tmp_path, f"{message}\n{limits}")
    assert any("corner_axes" in note for note in settings.notes) == (not message)
    file = tmp_path / "machine.toml"
    answers = parse_answers(["travel=300 mm"])
    file.write_text(machine_text(settings, answers, "m", limits_only=True))
    planner = load_machine(file).planner
    assert isinstance(planner, MarlinPlanner) and planner.corner_axes == slower


def test_a_jerk_that_is_not_said_is_marlin_s_and_told(tmp_path: Path) -> None:
    text = "M203 X200 Y200 Z10 E50\nM201 X500 Y500 Z100 E500\nM204 P500 T800\nM205 X10 Y9\nM500\n"
    settings = read(tmp_path, text)
    assert settings.planner["jump.Z"].value == 0.3
    assert any("no jerk of Z" in note for note in settings.notes)
    asked = [one.key for one in missing_answers(settings, parse_answers([]), limits_only=True)]
    assert asked[:3] == ["steps.X", "travel.X", "steps.Y"]
    given = ["steps=80 count/mm", "travel=300 mm"]
    file = tmp_path / "machine.toml"
    file.write_text(machine_text(settings, parse_answers(given), "m", limits_only=True))
    assert load_machine(file).counts_per_unit.tolist() == [80_000.0] * 3


def test_the_stealth_mode_of_prusa_s_firmware_is_left(tmp_path: Path) -> None:
    text = """echo:  M92 X100.00
Maximum feedrates - normal (mm/s):
  M203 X200.00
Maximum feedrates - stealth (mm/s):
  M203 X100.00
Maximum acceleration - normal (mm/s2):
  M201 X1000
Maximum acceleration - stealth (mm/s2):
  M201 X960
Acceleration: P=print, R=retract, T=travel
  M204 P1250.00 R1250.00 T1250.00
"""
    found = numbers(read(tmp_path, text))
    assert found["X rate"] == 12_000.0 and found["X acceleration"] == 1000.0


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("echo: M852 I0.0100", "skew"),
        ("echo: M425 F1 X0.1", "backlash"),
        ("echo:  M420 S1 Z10.00", "moves Z by the mesh"),
        ("echo:  M493 S1", "fixed-time motion"),
        ("echo:  M201 F20 G100", "frequency"),
    ],
)
def test_ignored_marlin_settings_are_reported_and_stored(
    line: str, message: str, tmp_path: Path
) -> None:
    settings = read(tmp_path, f"{FIRST}{line}\n")
    (ignored,) = settings.ignored
    assert message in ignored and f"settings.txt:{len(FIRST.splitlines()) + 1}" in ignored
    file = tmp_path / "machine.toml"
    answers = parse_answers(["travel=300 mm"])
    file.write_text(machine_text(settings, answers, "m", limits_only=True))
    planner = load_machine(file).planner
    assert planner is not None and planner.left_out == [ignored]


@pytest.mark.parametrize(
    "line",
    ["M852 I0.0 J0.0", "M425 F0.0 X0.1", "M425 F1 X0.0", "M420 S0 Z0.00", "M206 X0.00 Y0.00"],
)
def test_disabled_setting_gives_no_warning(line: str, tmp_path: Path) -> None:
    settings = read(tmp_path, f"{FIRST}echo:  {line}\n")
    assert not settings.ignored
    assert numbers(settings) == numbers(read(tmp_path, FIRST))


def test_klipper_s_deprecated_braking_is_its_least_cruise(tmp_path: Path) -> None:
    """Until 2024: minimum_cruise_ratio = 1 - max_accel_to_decel / max_accel, 0 at the most."""
    for slow, ratio in ((3000, 0.0), (1500, 0.5), (750, 0.75), (9000, 0.0)):
        settings = read(tmp_path, f"{KLIPPER}max_accel_to_decel: {slow}\n", "printer.cfg")
        assert settings.planner["minimum_cruise_ratio"].value == pytest.approx(ratio)
    both = f"{KLIPPER}max_accel_to_decel: 100\nminimum_cruise_ratio: 0.3\n"
    assert read(tmp_path, both).planner["minimum_cruise_ratio"].value == 0.3


def test_files_that_klipper_includes_are_read_beside(tmp_path: Path) -> None:
    head, _, printer = KLIPPER.partition("[printer]")
    parts = tmp_path / "parts"
    parts.mkdir()
    (parts / "printer.cfg").write_text("[printer]" + printer)
    settings = read(tmp_path, "[include parts/*.cfg]\n[include mainsail.cfg]\n" + head)
    assert numbers(settings) == numbers(read(tmp_path, KLIPPER))
    assert str(settings.planner["velocity"].place) == "printer.cfg:3"
    (note,) = [note for note in settings.notes if "include" in note]
    assert "settings.txt:2: [include mainsail.cfg] is not read" in note
    (parts / "printer.cfg").write_text("[include printer.cfg]\n")
    with pytest.raises(MachineError, match="includes its own file"):
        read(tmp_path, "[include parts/*.cfg]\n" + head)


def test_axes_begin_with_x_whatever_klipper_s_includes_name_first(tmp_path: Path) -> None:
    """A macro's file may set Z before the sections of X and Y."""
    (tmp_path / "park.cfg").write_text("[stepper_z]\nposition_max: 240\n")
    settings = read(tmp_path, "[include park.cfg]\n" + KLIPPER)
    assert list(settings.axes) == ["X", "Y", "Z"]


def test_the_error_asks_once_what_several_axes_lack_and_its_hint_does(tmp_path: Path) -> None:
    """An INI of a simulation without scales, with rotary axes."""
    ini = "[EMC]\nMACHINE = m\n[TRAJ]\nCOORDINATES = X Y A\nLINEAR_UNITS = mm\n[KINS]\nJOINTS = 3\n"
    for number, kind in enumerate(("LINEAR", "LINEAR", "ANGULAR")):
        ini += f"[JOINT_{number}]\nTYPE = {kind}\nMAX_VELOCITY = 30\nMAX_ACCELERATION = 200\n"
        ini += f"MIN_LIMIT = 0\nMAX_LIMIT = 300\n[AXIS_{'XYA'[number]}]\n"
        ini += "MAX_VELOCITY = 30\nMAX_ACCELERATION = 200\nMIN_LIMIT = 0\nMAX_LIMIT = 300\n"
    settings = read(tmp_path, ini, "m.ini")
    with pytest.raises(OptionError) as caught:
        machine_text(settings, parse_answers([]), "m", limits_only=True)
    asked = re.findall(r'--set "([^"]+)"', caught.value.remedy)
    assert asked == ["steps=80 count/mm", "steps.A=26.667 count/deg", "radius=50 mm"]
    machine_text(settings, parse_answers(asked), "m", limits_only=True)
    with pytest.raises(OptionError, match="need no motors: --limits-only"):
        machine_text(settings, parse_answers(asked), "m")


@pytest.mark.parametrize("more", ["[printer]\nmax_velocity: 9\n", "[mcu]\nserial: /dev/x\n"])
def test_an_include_that_is_not_there_is_named_where_it_would_have_the_axes(
    tmp_path: Path, more: str
) -> None:
    """Users send printer.cfg alone."""
    message = r"contain no axis \(klipper\); settings.txt:1: \[include steppers.cfg\] is not read"
    with pytest.raises(MachineError, match=message) as caught:
        read(tmp_path, "[include steppers.cfg]\n" + more)
    assert "beside this one" in caught.value.remedy


def test_no_file_outside_its_folder_is_included(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "secret.cfg").write_text("[stepper_z]\nrotation_distance: 8\nmicrosteps: 16\n")
    settings = read(inner, "[include ../secret.cfg]\n" + KLIPPER)
    assert "Z" not in settings.axes and "is not read" in settings.notes[0]


def test_the_configuration_in_a_log_of_klipper_counts(tmp_path: Path) -> None:
    log = f"Starting Klippy...\n===== Config file =====\n{KLIPPER}=======================\nExtruder"
    assert numbers(read(tmp_path, log + " max_extrude_ratio=0.266081\n")) == numbers(
        read(tmp_path, KLIPPER)
    )


def test_the_step_distance_of_an_old_klipper_is_its_steps(tmp_path: Path) -> None:
    text = "[stepper_x]\nstep_distance: .0125\nposition_max: 200\n[printer]\nmax_velocity: 9\n"
    assert numbers(read(tmp_path, text))["X steps"] == 80.0


def test_jumps_of_reprapfirmware_a_second_are_those_a_minute(tmp_path: Path) -> None:
    """M205 X15 is M566 X900."""
    jumps = [
        read(tmp_path, f"M584 X0\nM92 X80\n{line}\n").planner["jump.X"].value
        for line in ("M566 X900", "M205 X15")
    ]
    assert jumps == pytest.approx([15.0, 15.0])


def test_a_corexy_of_klipper_has_limits_and_no_motors(tmp_path: Path) -> None:
    """Klipper limits X, Y and Z there, but a motor moves both X and Y."""
    text = KLIPPER.replace("kinematics: cartesian", "kinematics: corexy")
    settings = read(tmp_path, text)
    assert numbers(settings) == numbers(read(tmp_path, KLIPPER))
    assert "[axes.X]" in machine_text(settings, parse_answers([]), "m", limits_only=True)
    with pytest.raises(OptionError, match="Add --limits-only"):
        machine_text(settings, parse_answers([]), "m")


@pytest.mark.parametrize(
    "lines",
    [
        "M350 X32\nM92 X160",
        "M92 X80\nM350 X32",  # 80 with the 16 microsteps with which a driver begins
        "M350 X32\nM92 X80 S16",
        "M350 X8 Y16\nM92 X40\nM350 X32",
        "M92 X80 M350 X32 Y16",
        "N7 M92 X80\nT0 M350 X32",
        "m92 x80\nm350 x32",
    ],
)
def test_microsteps_of_reprapfirmware_come_in_any_order(lines: str, tmp_path: Path) -> None:
    """RepRapFirmware keeps the length of a full step as M350 changes the microsteps."""
    found = numbers(read(tmp_path, f"M584 X0\n{lines}\n"))
    assert found["X steps"] == 160.0 and found["X microsteps"] == 32.0


def test_commands_that_marlin_has_too_are_reprapfirmware_s_if_their_owner_says_so(
    tmp_path: Path,
) -> None:
    """M203 X6000 is 6000 mm/min there, and 6000 mm/s in Marlin."""
    text = "M92 X80\nM203 X6000\nM201 X500\n"
    assert numbers(read(tmp_path, text))["X rate"] == 360_000.0
    settings = read_settings(tmp_path / "settings.txt", "reprapfirmware")
    assert settings.firmware == "reprapfirmware" and numbers(settings)["X rate"] == 6000.0
    assert read(tmp_path, "M350 X16 I1\n" + text).firmware == "reprapfirmware"


def test_the_queue_of_reprapfirmware_only_grows(tmp_path: Path) -> None:
    more = read(tmp_path, REPRAPFIRMWARE + "M595 P100\n")
    assert more.planner["blocks"].value == 100.0
    assert "blocks" not in read(tmp_path, REPRAPFIRMWARE + "M595 P20\n").planner


@pytest.mark.parametrize(
    ("line", "message"),
    [("M556 S100 X0.5", "skew"), ("M425 X0.1 S10", "backlash"), ("G29 S1", "mesh of the bed")],
)
def test_ignored_reprapfirmware_settings_are_reported(
    line: str, message: str, tmp_path: Path
) -> None:
    (ignored,) = read(tmp_path, f"{REPRAPFIRMWARE}{line}\n").ignored
    assert message in ignored
    assert not read(tmp_path, REPRAPFIRMWARE + "M556 S100 X0 Y0\nM425 X0\nM579 X1 Y1\n").ignored


def test_keys_of_fluidnc_have_no_case(tmp_path: Path) -> None:
    shouted = "\n".join(
        line.split(":", 1)[0].upper() + ":" + line.split(":", 1)[1] for line in FLUIDNC.splitlines()
    )
    assert numbers(read(tmp_path, shouted + "\n")) == numbers(read(tmp_path, FLUIDNC))
    with pytest.raises(MachineError, match="kinematics: CoreXY"):
        read(tmp_path, "KINEMATICS:\n  CoreXY:\n" + shouted)


def test_an_axis_of_fluidnc_without_keys_has_its_defaults(tmp_path: Path) -> None:
    settings = read(tmp_path, "axes:\n  x:\n    max_travel_mm: 300\n  z:\n    motor0:\n")
    assert list(settings.axes) == ["X", "Z"]
    for letter, travel in [("X", 300.0), ("Z", 1000.0)]:
        axis = settings.axes[letter]
        values = (axis.steps, axis.rate, axis.acceleration, axis.travel)
        assert [one.value for one in values if one] == [80.0, 1000.0, 25.0, travel]
    assert settings.axes["Z"].rate is not None
    assert settings.axes["Z"].rate.name == "default of fluidnc"


INI = """[EMC]
MACHINE = mill
[KINS]
JOINTS = 4
KINEMATICS = trivkins coordinates=XYYA kinstype=BOTH
[RS274NGC]
RS274NGC_STARTUP_CODE = G21 G40 G90 G94 G64 P0.02 Q0.01  # as the shop has it
[TRAJ]
COORDINATES = X Y Y A
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
MAX_LINEAR_VELOCITY = 80
[HAL]
HALFILE = mill.hal
HALFILE = custom.hal
[AXIS_X]
MAX_VELOCITY = 50.0
MAX_ACCELERATION = 750.0
MIN_LIMIT = -10.0
MAX_LIMIT = 290.0
[JOINT_0]
TYPE = LINEAR
MAX_VELOCITY = 40.0
MAX_ACCELERATION = 800.0
SCALE = -320.0
BACKLASH = 0.02
[AXIS_Y]
MAX_VELOCITY = 100.0
MAX_ACCELERATION = 500.0
MIN_LIMIT = 0
MAX_LIMIT = 200
[JOINT_1]
SCALE = 200
[JOINT_2]
SCALE = -200
[AXIS_A]
MAX_VELOCITY = 90
MAX_ACCELERATION = 300
MIN_LIMIT = -1e99
MAX_LIMIT = 1e99
[JOINT_3]
TYPE = ANGULAR
SCALE = 88.888
"""


def test_an_ini_of_linuxcnc_becomes_a_machine(tmp_path: Path) -> None:
    """The smaller of axis and joint, a joint for each letter, and the initial path mode."""
    settings = read(tmp_path, INI, "mill.ini")
    assert numbers(settings) == {
        "X steps": 320.0, "X rate": 2400.0, "X acceleration": 750.0, "X travel": 300.0,
        "Y steps": 200.0, "Y rate": 4800.0, "Y acceleration": 500.0, "Y travel": 200.0,
        "A steps": 88.888, "A rate": 5400.0, "A acceleration": 300.0,
        "tolerance": 0.02, "cam_tolerance": 0.01,
    }  # fmt: skip
    assert "BACKLASH = 0.02" in settings.ignored[0]
    assert sum("HAL file" in note for note in settings.notes) == 2
    asked = [one.key for one in missing_answers(settings, parse_answers([]), limits_only=True)]
    assert asked == ["radius"]  # TYPE says which axis is rotary
    file = tmp_path / "machine.toml"
    file.write_text(machine_text(settings, parse_answers(["radius=40 mm"]), "m", limits_only=True))
    with pytest.raises(OptionError, match="the settings say that A turns, and rotary=none says"):
        machine_text(settings, parse_answers(["rotary=none"]), "m", limits_only=True)
    made = load_machine(file)
    assert list(made.rotary) == ["A"]
    assert made.programs.dialect == "linuxcnc" and made.planner.tolerance_m == pytest.approx(2e-5)


def test_inches_of_linuxcnc_are_converted(tmp_path: Path) -> None:
    """1 inch/s is 25.4 mm/s; 2000 steps an inch are 78.74 a mm. The same mill in both units."""
    mm = re.sub(r"(?m)^ANGULAR_UNITS.*\n", "", INI).replace("G21 ", "")

    def inches(found: re.Match[str]) -> str:
        factor = 25.4 if found[1] == "SCALE" else 1 / 25.4
        return f"{found[1]} = {float(found[2]) * factor!r}"

    head, _, angular = mm.partition("[AXIS_A]")
    keys = r"(MAX_VELOCITY|MAX_ACCELERATION|MIN_LIMIT|MAX_LIMIT|SCALE|MAX_LINEAR_VELOCITY) = (\S+)"
    head = re.sub(rf"(?m)^{keys}$", inches, head).replace(
        "LINEAR_UNITS = mm", "LINEAR_UNITS = inch"
    )
    head = head.replace("P0.02 Q0.01", f"P{0.02 / 25.4!r} Q{0.01 / 25.4!r}")
    found = numbers(read(tmp_path, f"{head}[AXIS_A]{angular}"))
    assert found == pytest.approx(numbers(read(tmp_path, mm)))


def test_an_ini_may_include_files_and_continue_lines(tmp_path: Path) -> None:
    head, _, rest = INI.partition("[AXIS_X]")
    (tmp_path / "axes.inc").write_text("[AXIS_X]" + rest)
    split = head.replace("G94 G64", "G94 \\\n  G64").replace("X Y Y A", "X Y \\\nY A")
    settings = read(tmp_path, split + "#INCLUDE axes.inc\n", "mill.ini")
    assert numbers(settings) == numbers(read(tmp_path, INI, "mill.ini"))
    assert str(settings.axes["X"].acceleration.place) == "axes.inc:3"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("trivkins", "genhexkins"), "KINEMATICS = genhexkins"),
        (("LINEAR_UNITS = mm", "LINEAR_UNITS = cubit"), "LINEAR_UNITS is 'cubit'"),
        (("coordinates=XYYA", "coordinates=XQ"), "must be letters of X, Y, Z"),
        (("[TRAJ]", "#INCLUDE traj.inc\n[TRAJ]"), "#INCLUDE traj.inc: no such file beside"),
        (("MAX_VELOCITY = 90", "MAX_VELOCITY 90"), "'MAX_VELOCITY 90' is not a line"),
        (("MAX_VELOCITY = 90", "MAX_VELOCITY = fast"), "MAX_VELOCITY is 'fast'"),
    ],
)
def test_an_ini_that_cannot_be_read_is_refused(
    change: tuple[str, str], message: str, tmp_path: Path
) -> None:
    with pytest.raises(MachineError, match=re.escape(message)):
        read(tmp_path, INI.replace(*change), "mill.ini")


@pytest.mark.parametrize(
    ("scale", "steps"),
    [("OUTPUT_SCALE = 1.0\nINPUT_SCALE = -400", 400.0), ("ENCODER_SCALE = 500", 500.0)],
)
def test_the_scale_of_an_amplifier_is_no_scale_of_an_axis(
    scale: str, steps: float, tmp_path: Path
) -> None:
    """Servos have volts in OUTPUT_SCALE: read as steps, one count was an inch."""
    settings = read(tmp_path, INI.replace("SCALE = 200\n", f"{scale}\n", 1), "mill.ini")
    assert numbers(settings)["Y steps"] == steps


def test_limits_of_linuxcnc_need_no_scale(tmp_path: Path) -> None:
    """HAL files have the scale, and no time depends on it: the times are the same for any steps."""
    ini = tmp_path / "servo.ini"
    ini.write_text(re.sub(r"(?m)^SCALE = .*\n", "", INI))
    made = settings_files("linuxcnc", ini, ["radius=40 mm"])
    assumed = [(name, value, source) for name, value, source in made.rows if "steps" in name]
    assert [value for _, value, _ in assumed] == ["1000 /mm", "1000 /mm", "1000 /deg"]
    assert all(source.startswith("assumed: the INI has no scale") for *_, source in assumed)
    own = settings_files(
        "linuxcnc", ini, ["radius=40 mm", "steps=80 count/mm", "steps.A=9 count/deg"]
    )
    assert [row for row in own.rows if row[:2] == ("X steps", "80 count/mm")]
    assert not [one for one in made.notes if "steps" in one]
    with pytest.raises(OptionError, match="steps=80"):
        settings_files("linuxcnc", ini, ["radius=40 mm", "torque=1 N m"])


def test_lines_that_linuxcnc_skips_are_skipped_with_a_note(tmp_path: Path) -> None:
    """A line without =, and text after the name of a section; an INI may include all files."""
    text = INI.replace("[TRAJ]", "TOOL_CHANGE_POSITION -18 -12\n[TRAJ] section of the path", 1)
    settings = read(tmp_path, text, "mill.ini")
    assert numbers(settings) == numbers(read(tmp_path, INI, "whole.ini"))
    assert any("TOOL_CHANGE_POSITION" in note for note in settings.notes)
    (tmp_path / "all.inc").write_text(INI)
    outer = read(tmp_path, "#INCLUDE all.inc\n\n[APPLICATIONS]\nAPP = sim_pin x\n", "outer.ini")
    assert numbers(outer) == numbers(settings)
