"""Settings of firmwares become machine files: their numbers, and named questions for the rest."""

from __future__ import annotations

import math
import random
import re
from pathlib import Path

import pytest

from threadline.errors import InputError, MachineError, OptionError
from threadline.machine import Machine, load_machine
from threadline.machine.firmware import machine_text, parse_answers, read_settings

# The defaults of grbl 1.1 with a mandrel as A, as its wiki prints a dump.
GRBL = """Grbl 1.1h ['$' for help]
$0=10 (step pulse, usec)
$20=0 (soft limits, bool)
$100=250.000 (x, step/mm)
$101=250.000 (y, step/mm)
$103=26.666 (a, step/deg)
$110=500.000 (x max rate, mm/min)
$111=500.000 (y max rate, mm/min)
$113=36000.000
$120=10.000 (x accel, mm/sec^2)
$121=10.000 (y accel, mm/sec^2)
$123=2000.000
$130=200.000 (x max travel, mm)
$131=200.000 (y max travel, mm)
ok
"""
MARLIN = """echo:; Linear Units:
echo:  G21 ; (mm)
echo:; Steps per unit:
echo:  M92 X80.00 A26.67 E500.00
echo:; Max feedrates (units/s):
echo:  M203 X300.00 A400.00 E25.00
echo:; Max Acceleration (units/s2):
echo:  M201 X3000.00 A1500.00 E10000.00
echo:  M204 P3000.00 R3000.00 T3000.00
echo:  M205 B20000.00 S0.00 T0.00 J0.01
ok
"""
FLUIDNC = """name: "winder"
board: 6 Pack
axes:
  shared_stepper_disable_pin: NO_PIN
  x:
    steps_per_mm: 80.000
    max_rate_mm_per_min: 5000.000   # brisk
    acceleration_mm_per_sec2: 100.000
    max_travel_mm: 900.000
    motor0:
      stepstick:
        step_pin: gpio.26
  a:
    steps_per_mm: 26.667
    max_rate_mm_per_min: 36000.000
    acceleration_mm_per_sec2: 2000.000
    max_travel_mm: 360.000
"""
KLIPPER = """[stepper_x]
step_pin: PF0
microsteps: 16
rotation_distance: 40
position_min: -5
position_max: 895
homing_speed: 50

[stepper_y]  # the mandrel, in degrees
microsteps: 16
rotation_distance: 360
full_steps_per_rotation: 200
gear_ratio: 60:20
position_max: 100000

[printer]
kinematics: cartesian
max_velocity: 300
max_accel: 3000
"""
REPRAPFIRMWARE = """; config.g
G90                               ; absolute
M550 P"Winder; M92 X1"
M569 P0.0 S1
M584 X0.0 A0.1 E0.2
M350 X16 A16 E16:16 I1
M92 X80.00 A26.67 E420:420        ; steps per mm
M566 X900.00 A600.00 E120 P1      ; mm/min
M203 X6000.00 A36000.00 E1200
M201 X500.00 A2000.00 E250
M204 P400 T450
M906 X800 A800 E800 I30
M208 X-10 S1
M208 X590 S0
"""
OWNER = (
    "torque=1.26 N m", "current=2.8 A", "resistance=0.9 ohm", "inductance=2.5 mH", "supply=36 V",
    "mass=1.2 kg", "inertia=4e-3 kg m^2", "radius=50 mm", "microsteps=16",
)  # fmt: skip


def machine(folder: Path, text: str, *more: str) -> Machine:
    source, file = folder / "settings.txt", folder / "machine.toml"
    source.write_text(text)
    answers = parse_answers([*OWNER, *more])
    file.write_text(machine_text(read_settings(source), answers, "mine"))
    return load_machine(file)


@pytest.mark.parametrize(
    ("text", "more", "counts", "velocity", "acceleration", "travel_m", "dialect"),
    [
        (GRBL, ["rotary=A"], {"X": 250e3, "Y": 250e3, "A": 26.666}, {"X": 0.5 / 60, "A": 600.0},
         {"X": 0.01, "A": 2000.0}, {"X": 0.2}, "grbl"),
        (MARLIN, ["rotary=A", "travel=600 mm"], {"X": 80e3, "A": 26.67}, {"X": 0.3, "A": 400.0},
         {"X": 3.0, "A": 1500.0}, {"X": 0.6}, "marlin"),
        (FLUIDNC, ["rotary=A"], {"X": 80e3, "A": 26.667}, {"X": 5 / 60, "A": 600.0},
         {"X": 0.1, "A": 2000.0}, {"X": 0.9}, "fluidnc"),
        (KLIPPER, ["rotary=Y"], {"X": 80e3, "Y": 200 * 16 * 3 / 360}, {"X": 0.3, "Y": 300.0},
         {"X": 3.0, "Y": 3000.0}, {"X": 0.9}, "klipper"),
        (REPRAPFIRMWARE, ["rotary=A"], {"X": 80e3, "A": 26.67}, {"X": 0.1, "A": 600.0},
         {"X": 0.5, "A": 2000.0}, {"X": 0.6}, "reprapfirmware"),
    ],
)  # fmt: skip
def test_a_firmware_becomes_a_machine(
    tmp_path: Path,
    text: str,
    more: list[str],
    counts: dict[str, float],
    velocity: dict[str, float],
    acceleration: dict[str, float],
    travel_m: dict[str, float],
    dialect: str,
) -> None:
    """Steps, rates, accelerations and travel equal those of the dump; degrees on a rotary axis."""
    made = machine(tmp_path, text, *more)
    assert made.axis_names == tuple(counts)
    assert made.programs.dialect == dialect
    for found, expected in (
        (made.counts_per_unit, counts),
        (made.velocity_limit, velocity),
        (made.acceleration_limit, acceleration),
    ):
        for axis, value in expected.items():
            turns = axis in made.rotary
            # A count per degree is 180/pi of one per rad; a rate in degrees pi/180 of one in rad.
            factor = 180.0 / math.pi if turns else 1.0
            factor = factor if expected is counts else 1.0 / factor
            at = made.axis_names.index(axis)
            assert found[at] == pytest.approx(value * factor, rel=1e-9), axis
    for axis, value in travel_m.items():
        assert made.travel[made.axis_names.index(axis), 1] == pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "more", "expected"),
    [
        (GRBL + "$11=0.025\n", ["rotary=A"], {"junction_deviation": 0.025e-3}),
        (GRBL, ["rotary=A"], {"junction_deviation": 0.01e-3}),  # its default
        (MARLIN, ["rotary=A", "travel=600 mm"], {"junction_deviation": 0.01e-3, "acceleration": 3}),
        (FLUIDNC + "junction_deviation_mm: 0.03\n", ["rotary=A"], {"junction_deviation": 0.03e-3}),
        (KLIPPER + "square_corner_velocity: 8\n", ["rotary=Y"],
         {"square_corner_velocity": 0.008, "velocity": 0.3, "acceleration": 3.0,
          "minimum_cruise_ratio": 0.5}),
        (REPRAPFIRMWARE, ["rotary=A"], {"policy": 1.0, "acceleration": 0.45}),
        (REPRAPFIRMWARE.replace(" P1 ", " "), ["rotary=A"], {"policy": 0.0}),  # its default
    ],
)  # fmt: skip
def test_a_firmware_tells_its_planner(
    tmp_path: Path, text: str, more: list[str], expected: dict[str, float]
) -> None:
    """$11, M205 J and M204 T, junction_deviation_mm, [printer]: in the machine file, in SI."""
    made = machine(tmp_path, text, *more)
    for key, value in expected.items():
        assert getattr(made.planner, key).si == pytest.approx(value), key


def test_jerks_of_marlin_are_jumps_of_its_axes(tmp_path: Path) -> None:
    """M205 X8 A5: mm/s of a linear axis, deg/s of a rotary one; E is no axis here."""
    text = MARLIN.replace("J0.01", "X8.00 A5.00")
    made = machine(tmp_path, text, "rotary=A", "travel=600 mm")
    jumps = {axis: jump.si for axis, jump in made.planner.jump.items()}
    assert jumps == pytest.approx({"X": 0.008, "A": math.radians(5.0)})
    assert made.planner.junction_deviation is None


def test_jumps_of_reprapfirmware_are_a_minute_s(tmp_path: Path) -> None:
    """M566 X900 A600: 900 mm/min are 15 mm/s, 600 deg/min 10 deg/s. M350 has the microsteps."""
    made = machine(tmp_path, REPRAPFIRMWARE, "rotary=A")
    jumps = {axis: jump.si for axis, jump in made.planner.jump.items()}
    assert jumps == pytest.approx({"X": 0.015, "A": math.radians(10.0)})
    assert read_settings(tmp_path / "settings.txt").axes["X"].microsteps.value == 16.0


def test_moved_mass_is_reflected_to_the_motor_inertia(tmp_path: Path) -> None:
    """J = rotor + m r^2: 80 step/mm of 200 x 16 are 40 mm a turn, r 6.366 mm, as with GT2."""
    made = machine(tmp_path, FLUIDNC, "rotary=A", "rotor=3e-5 kg m^2")
    assert made.bodies["x"].inertia.si == pytest.approx(3e-5 + 1.2 * (0.02 / math.pi) ** 2)
    ratio = (200 * 16 / 26.667) / 360.0  # turns of the mandrel in one turn of the motor
    assert made.bodies["a"].inertia.si == pytest.approx(3e-5 + 4e-3 * ratio**2, rel=1e-5)


def test_all_that_is_not_said_is_asked_for_at_once(tmp_path: Path) -> None:
    source = tmp_path / "m503.txt"
    source.write_text(MARLIN)
    with pytest.raises(OptionError) as caught:
        machine_text(read_settings(source), parse_answers(["rotary=A"]), "mine")
    asked = re.findall(r'--set "([a-z.X]+)=', str(caught.value))
    assert asked == [
        "torque", "current", "resistance", "inductance", "supply", "microsteps", "mass",
        "travel.X", "inertia", "radius",
    ]  # fmt: skip
    assert len(asked) <= 10
    # The proposed answer works.
    given = re.findall(r'--set "([^"]+)"', str(caught.value))
    assert "[axes.A]" in machine_text(
        read_settings(source), parse_answers(["rotary=A", *given]), "mine"
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello\n", "the settings of this file are of no known firmware"),
        ("", "settings of this file are of no known"),
        ("$100=250\n$100=200\n", "$100 is 200 here and 250 on line 1"),
        ("$100=250\n$100=250\n$110=-5\n", "$110 is '-5'; it must be a number from 10^-6"),
        ("$100=nan\n", "$100 is 'nan'"),
        ("$100=250\n$130=1e-9\n", "$130 is '1e-9'"),
        ("$100=250\n$11=-1\n", "$11 is '-1'; it must be 0, or a number"),
        ("$100=250\n$11=0.01\n$11=0.02\n", "$11 is 0.02 here and 0.01 on line 2"),
        ("$100=1e99\n", "$100 is '1e99'"),
        ("$100=\n", "$100 is ''"),
        ("$100=250\n$110 5000\n", "'$110 5000' is not a line of these settings"),
        ("$100=250\nX: $110=5000\n", "'X: $110=5000' is not a line of these settings"),
        ("$0=755.906 (x, step/mm)\n$1=755.906 (y, step/mm)\n", "is a setting of grbl 0.8 or older"),
        ("$100=250\n[OPT:VC,15,128]\n", "C is CoreXY"),
        ("EPR:3 11 80.0 X-axis steps per mm\n", "belong to Repetier-Firmware"),
        ("echo:  M92 X80.0\nI sent M203 X5 to it\n", "'I sent M203 X5 to it' is not a line"),
        ("echo:  M92 X80.0\necho:  M204 T0 R10000\n", "settings.txt:2: M204 T is '0'"),
        ("echo:  M92 X80.0 X90.0\n", "M92 X is 90.0 here and 80.0 on line 1"),
        ("  M92 X\n", "not a line of these settings"),
        ("axes:\n\tx:\n", "a tab before a key"),
        ("axes:\n  x:\n    steps_per_mm: many\n", "axes.x.steps_per_mm is 'many'"),
        ("axes:\n  x\n", "'x' is not a line"),
        ("axes:\n  q:\n    steps_per_mm: 5\n", "contain no axis"),
        ("[stepper_x]\nrotation_distance: 0\nmicrosteps: 16\n", "rotation_distance is '0'"),
        ("[stepper_x]\nrotation_distance: 4\nmicrosteps: 16\ngear_ratio: 3\n", "gear_ratio: 3"),
        ("[stepper_x]\nrotation_distance: 4\nmicrosteps: 16\ngear_ratio: 1.2.3:1\n", "1.2.3:1"),
        ("[stepper_x]\nrotation_distance: 4\nmicrosteps: 16\ngear_ratio: 0:1\n", "0:1"),
        ("[stepper_x]\nrotation_distance 4\n", "'rotation_distance 4' is not a line"),
        ("[printer]\nmax_velocity: 9\n", "contain no axis"),
        ("M584 X0\nif {1}\n  M92 X80\n", "M92 is inside a condition"),
        ("M584 X0\nM92 X{var.steps}\n", "'M92 X{var.steps}' is not a line of these settings"),
        ("M584 X0\nM92 X80\nM579 X1.02\n", "M579 X1.02 scales the positions of an axis"),
        ("M584 X0\nM92 X80:80\n", "M92 X is '80:80'"),
        ("M584 X0\nM92 X80\nM208 X1:2:3\n", "M208 X is '1:2:3'"),
        ("M584 X0\nM92 X80\nM208 X9:3\n", "M208 X is '-6.0'"),
        ("M566 X900 P7..\n", "M566 P is '7..'"),
        ("M584 X0\nM569 P0 S1\n", "contain no axis (reprapfirmware)"),
        ("M584 X0\nG20\nM92 X80\n", "G20: these lengths are in inches"),
        ("echo:  G20 ; (in)\necho:  M92 X80.0\n", "G20: these lengths are in inches"),
        (
            "M584 X0\nM669 K1\nM92 X80\n",
            "M669 K1: settings can be read only for machines with one motor per axis",
        ),
        (
            MARLIN + "echo:  M665 L250.00 R105.00\n",
            "M665: settings can be read only for machines with one motor per",
        ),
        (
            FLUIDNC + "kinematics:\n  CoreXY:\n",
            "kinematics: CoreXY: settings can be read only for machines with one motor",
        ),
        (
            "M584 X0\nM665 R105 L215\nM92 X80\n",
            "M665: settings can be read only for machines with one motor per axis",
        ),
        (
            "M584 X0\nM667 S1\nM92 X80\n",
            "M667 S1: settings can be read only for machines with one motor per axis",
        ),
        ("M584 X0\nG90 G20\nM92 X80\n", "G20: these lengths are in inches"),
        (
            "[printer]\nkinematics: delta\n[stepper_x]\n",
            "kinematics: delta: settings can be read only for machines",
        ),
        (
            "Kinematics:\n  CoreXY:\n" + FLUIDNC,
            "kinematics: CoreXY: settings can be read only for machines with one motor",
        ),
        (
            "kinematics: corexy\n" + FLUIDNC,
            "kinematics: corexy: settings can be read only for machines with one motor",
        ),
    ],
)
def test_settings_that_cannot_be_are_refused(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "settings.txt"
    file.write_text(text)
    with pytest.raises(MachineError, match=re.escape(message)):
        read_settings(file)


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        (["mas=1 kg"], "Did you mean mass?"),
        (["mass"], "does not answer any question"),
        (["mass=1 kg", "mass=2 kg"], "given twice"),
        (["rotary=Q", *OWNER], "no axis Q"),
        (["rotary=A", "mass.Q=1 kg", *OWNER], "no axis Q"),
        (["rotary=A", "torque=1 kg", *OWNER[1:]], "--set torque='1 kg'"),
        (["rotary=A", "rate.A=5 mm/min", *OWNER], "--set rate.A='5 mm/min'"),
        (["rotary=A", "rate.A=5 mm/min", *OWNER], 'Write it like "rate.A=36000 deg/min"'),
        (["rotary=A", "travel.A=600 mm", *OWNER], "axis A turns without end, it has no travel"),
        (["rotary=A", "travel.A=90 deg", *OWNER], "Leave it out, or name the letters"),
        (["rotary=A", "travel=5", *OWNER], "--set travel='5'"),
        (["rotary=A", 'torque=1 N m", x = "', *OWNER[1:]], "--set torque="),
        (["rotary=A", "mass=-1 kg", "travel=1 m", *OWNER[:5], *OWNER[6:]], "greater than 0"),
    ],
)
def test_answers_that_cannot_be_are_refused(
    tmp_path: Path, answers: list[str], message: str
) -> None:
    file = tmp_path / "m503.txt"
    file.write_text(MARLIN)
    with pytest.raises(OptionError, match=re.escape(message)):
        machine_text(read_settings(file), parse_answers(answers), "mine")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MARLIN + "echo:  M593 X F41.2 D0.1\n", "M593 shapes the motion"),
        (REPRAPFIRMWARE + 'M593 P"zvd" F40 S0.1\n', "M593 shapes the motion"),
        (REPRAPFIRMWARE + 'M98 P"config-override.g"\n', "the file run by M98 is not read"),
        (REPRAPFIRMWARE + "M501\n", "the file run by M501 is not read"),
        (KLIPPER + "[input_shaper]\nshaper_freq_x: 40\n", "[input_shaper] shapes the motion"),
    ],
)
def test_ignored_setting_is_reported_with_its_line(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "settings.txt"
    file.write_text(text)
    (ignored,) = read_settings(file).ignored
    assert message in ignored and f"settings.txt:{len(text.splitlines())}" in ignored


@pytest.mark.parametrize("off", ["echo:  M593 X F0.00 D0.1\n", 'M593 P"none"\n'])
def test_a_shaper_that_is_off_is_not_told(off: str, tmp_path: Path) -> None:
    file = tmp_path / "settings.txt"
    file.write_text((MARLIN if off.startswith("echo") else REPRAPFIRMWARE) + off)
    assert not read_settings(file).ignored


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (FLUIDNC.replace("  x:\n", "  x: !include x.yaml\n  y:\n"), "x: !include x.yaml is not"),
        ("include: other.yaml\n" + FLUIDNC, "include: other.yaml is not followed"),
        ("axes: {x: {steps_per_mm: 80}}\n", "each setting of an axis needs a separate line"),
    ],
)
def test_axis_defined_in_another_file_is_refused(tmp_path: Path, text: str, message: str) -> None:
    """An axis in another file was left out without a message."""
    file = tmp_path / "config.yaml"
    file.write_text(text)
    with pytest.raises(MachineError, match=re.escape(message)):
        read_settings(file)


def test_values_saved_by_save_config_override_the_file(tmp_path: Path) -> None:
    """Klipper appends it as comments in a form of its own, which override the lines above."""
    saved = """
#*# <---------------------- SAVE_CONFIG ---------------------->
#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.
#*#
#*# [stepper_x]
#*# position_max = 695
"""
    file = tmp_path / "printer.cfg"
    file.write_text(KLIPPER + saved)
    assert read_settings(file).axes["X"].travel.value == 700.0


def test_an_axis_of_reprapfirmware_without_its_jump_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MachineError, match="do not give the speed jump of axis A"):
        machine(tmp_path, REPRAPFIRMWARE.replace("X900.00 A600.00", "X900.00"), "rotary=A")


def test_mutated_settings_are_read_or_refused(tmp_path: Path) -> None:
    """300 dumps with a line changed, cut or doubled: a machine file, or one line of error."""
    rng = random.Random(11)
    file, made = tmp_path / "settings.txt", tmp_path / "machine.toml"
    answers = parse_answers([*OWNER, "rotary=A", "travel=600 mm"])
    read = 0
    for _ in range(300):
        lines = rng.choice((GRBL, MARLIN, FLUIDNC, KLIPPER, REPRAPFIRMWARE)).splitlines()
        at = rng.randrange(len(lines))
        line = lines[at]
        cut = rng.randrange(len(line) + 1)
        lines[at] = rng.choice(
            (line[:cut], line[cut:], line + line, line[:cut] + rng.choice("\t=:[x9.-") + line[cut:])
        )
        file.write_text("\n".join(lines) + "\n")
        try:
            made.write_text(machine_text(read_settings(file), answers, "mine"))
        except InputError as error:
            assert "\n" not in str(error)
            continue
        read += 1
    assert 30 < read < 290


@pytest.mark.parametrize(
    ("jump", "message"),
    [
        ('Q = "8 mm/s exact, assumed"', "names the axis 'Q', which does not exist"),
        ('A = "8 mm/s exact, assumed"', "planner.jump.A is in m/s, but the axis needs rad/s"),
        ('X = "8 deg/s exact, assumed"', "planner.jump.X is in rad/s, but the axis needs m/s"),
    ],
)
def test_jumps_of_marlin_are_of_its_axes(jump: str, message: str, tmp_path: Path) -> None:
    """A jump with another letter limited nothing, and one in the other unit was taken as it was."""
    file = tmp_path / "m.toml"
    file.write_text(
        f'base = "stepper-winder"\n\n[planner]\nkind = "marlin"\n\n[planner.jump]\n{jump}\n'
    )
    with pytest.raises(MachineError, match=message):
        load_machine(file)


_DRIVES = "M584 X0 Y1\nM350 X16 Y16 I1\nM92 X80 Y80\n"
_SPEEDS = "M201 X500 Y500\nM203 X6000 Y6000\nM566 X300 Y300\nM208 X0:300 Y0:200\n"


def test_a_config_g_of_several_files_is_read(tmp_path: Path) -> None:
    """``M98 P"drives.g"`` runs a file of the folder of ``config.g``."""
    (tmp_path / "config.g").write_text('; modular\nM98 P"drives.g"\nM98 P"/sys/speed.g" ; limits\n')
    (tmp_path / "drives.g").write_text(_DRIVES)
    (tmp_path / "speed.g").write_text("\n\n" + _SPEEDS)
    settings = read_settings(tmp_path / "config.g")
    assert settings.firmware == "reprapfirmware" and list(settings.axes) == ["X", "Y"]
    text = machine_text(settings, parse_answers([]), "mine", limits_only=True)
    for number, where in (("500.0 mm/s^2", "speed.g:3"), ("80.0 count/mm", "drives.g:3")):
        assert any(number in line and where in line for line in text.splitlines()), number
    with pytest.raises(MachineError, match=r"no axis .*M98 is not read: no such file.*drives\.g"):
        (tmp_path / "drives.g").unlink()
        (tmp_path / "speed.g").unlink()
        read_settings(tmp_path / "config.g")
    (tmp_path / "drives.g").write_text('M98 P"config.g"\n')
    with pytest.raises(MachineError, match="runs its own file"):
        read_settings(tmp_path / "config.g")


def test_an_ini_whose_axes_are_included_names_the_file(tmp_path: Path) -> None:
    file = tmp_path / "moveoff.ini"
    file.write_text("#INCLUDE axes.inc\n\n[EMC]\nVERSION = 1.1\n[HAL]\nHALUI = halui\n")
    with pytest.raises(MachineError, match=r"#INCLUDE axes\.inc: no such file beside"):
        read_settings(file)
