"""Programs for firmwares have few blocks, within the tolerance, at the planned speeds.

A parser of three lines reads the written text, and the tests measure the distance of the sampled
trajectory from the blocks, in order.
"""

from __future__ import annotations

import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.jobs.controls_themselves import interpreted
from tests.jobs.made_machines import made_machine
from threadline.cli.main import main
from threadline.commands import firmware_program, merged_chords
from threadline.commands.boards import BOARDS
from threadline.commands.plan import Plan
from threadline.errors import PlanError
from threadline.jobs import Job, read_job
from threadline.machine import Machine, load_machine
from threadline.machine.motion_planner import GrblPlanner, LinuxCncPlanner
from threadline.machine.quantity import parse_machine_quantity
from threadline.motion.shaping import FlexibleMode
from threadline.motion.shaping.firmwares import (
    TYPES,
    klipper_impulses,
    marlin_impulses,
    reprap_impulses,
    shortest_for_all,
)
from threadline.motion.shaping.types import Shaper
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, write

TARGETS = tuple(BOARDS)


@pytest.fixture(scope="module")
def xya(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(
        tmp_path_factory.mktemp("xya"), "XY", "A", '[programs]\nfeed_mode = "grbl"\n'
    )


def plan(folder: Path, machine: Machine, text: str, **options: object) -> Plan:
    job = folder / "job.nc"
    job.write_text(text)
    chosen = Options(**options)  # type: ignore[arg-type]
    return plan_job(open_job(job, machine, chosen), machine, chosen)


def blocks(text: str) -> list[tuple[dict[str, float], float]]:
    """Return the end and the F of each G1, by a reader that shares no code with the writer."""
    at, feed, found = {"X": 0.0, "Y": 0.0, "A": 0.0}, 0.0, []
    for line in text.splitlines():
        words = {w[0]: float(w[1:]) for w in re.findall(r"[A-Z]-?[0-9.]+", line)}
        feed = words.get("F", feed)
        moved = {name: value for name, value in words.items() if name in at}
        if moved and "G4" not in line:
            at = at | moved
            found.append((dict(at), feed))
    return found


@pytest.mark.parametrize("target", TARGETS)
def test_a_straight_line_is_one_block(tmp_path: Path, xya: Machine, target: str) -> None:
    """A way there and back in steps of 1 mm at one feed is a block each way, with F as programmed.

    No block of a thousandth of a millimetre stands at the turning point; the planner's tolerance
    cuts 0.1 mm off there at most, and the warnings say by how much.
    """
    lines = [f"X{x}" for x in [*range(1, 31), *range(29, -1, -1)]]
    halt = ["M0"] if BOARDS[target].stops else []
    made = plan(tmp_path, xya, "\n".join(["G1 F1200", *lines, "G4 P0.5", *halt, "M30"]) + "\n")
    out = tmp_path / "out.gcode"
    (file,) = write(made, target, out)
    found = blocks(out.read_text())
    ends = [0.0, *(end["X"] for end, _ in found)]
    long = [
        (b, f) for a, b, (_, f) in zip(ends, ends[1:], found, strict=False) if abs(a - b) > 0.01
    ]
    assert [end for end, _ in long] == pytest.approx([30.0, 0.0], abs=0.1)
    assert [f for _, f in long] == pytest.approx([1200.0, 1200.0], rel=1e-3)
    assert len(found) == 2
    (facts,) = [fact for fact in file.facts if "corners are cut" in fact]
    cut_mm = 30.0 - found[0][0]["X"]
    shown_mm = float(facts.split(" by up to ")[1].split(" mm")[0])
    assert 0.0 < shown_mm == pytest.approx(cut_mm, abs=0.006)
    assert max(map(len, out.read_text().splitlines())) < 80
    assert f"{len(found)} blocks, read back" in file.warnings[0]
    text = out.read_text()
    milliseconds = ("marlin", "klipper", "reprapfirmware")
    pause = {"fanuc": "G4 X0.5"} | dict.fromkeys(milliseconds, "G4 P500")
    assert pause.get(target, "G4 P0.5") in text and ("M0" in text) == BOARDS[target].stops
    again = read_job(out, xya, dialect=target)
    assert again.axes == ("X", "Y", "A")


@pytest.mark.parametrize("target", ["grbl", "marlin"])
def test_a_winding_stays_within_its_tolerance(tmp_path: Path, xya: Machine, target: str) -> None:
    """Every sample of the plan of a helix with rounded ends is within 0.02 mm of the blocks."""
    text = ["G1 F3000"]
    for k in range(1, 3):
        text += [f"X{20 * (k % 2)} A{60 * k} Y{5 * (k % 3)}", f"A{60 * k + 20}"]
    made = plan(tmp_path, xya, "\n".join([*text, "M30"]) + "\n")
    out = tmp_path / "out.gcode"
    write(made, target, out)
    found = blocks(out.read_text())
    scale = np.array([1.0, 1.0, math.radians(50.0)])
    chain = np.array([[0.0, 0.0, 0.0], *[[e["X"], e["Y"], e["A"]] for e, _ in found]]) * scale
    trajectory = made.motion.trajectory
    times = np.linspace(0.0, trajectory.duration_s, 4000)
    samples = trajectory(times) * [1e3, 1e3, 50.0]
    low = 0
    for sample in samples:
        a, b = chain[low : low + 40], chain[low + 1 : low + 41]
        a = a[: len(b)]
        way = b - a
        share = np.clip(((sample - a) * way).sum(axis=1) / (way**2).sum(axis=1), 0, 1)
        away = np.linalg.norm(sample - a - share[:, None] * way, axis=1)
        assert away.min() <= 0.0202
        low += int(np.flatnonzero(away <= 0.0202)[0])
    assert len(chain) - low <= 3
    # By grbl's own length no block is faster than the job's feed, and one reaches it.
    if target == "grbl":
        assert max(f for _, f in found) == pytest.approx(3000.0, rel=0.02)


def test_a_change_of_feed_ends_a_block(tmp_path: Path, xya: Machine) -> None:
    made = plan(tmp_path, xya, "G1 X10 F600\nX20 F1200\nX30 F600\nM30\n")
    write(made, "grbl", tmp_path / "out.gcode")
    found = blocks((tmp_path / "out.gcode").read_text())
    assert found[0][1] <= 600.0 * 1.001 and found[0][0]["X"] == pytest.approx(10.0, abs=0.2)
    assert {round(f, -1) for _, f in found} >= {600.0, 1200.0}
    assert len(found) <= 12


def test_the_time_of_the_firmware_s_own_planner_is_told(tmp_path: Path, xya: Machine) -> None:
    """A move of 20 mm at 10 mm/s takes L / v + v / a on a machine with grbl's planner."""
    deviation = parse_machine_quantity("0.01 mm exact, assumed", ("m",))
    own = replace(xya, planner=GrblPlanner(kind="grbl", junction_deviation=deviation))
    made = plan(tmp_path, own, "G1 X20 F600\nM30\n")
    (file,) = write(made, "grbl", tmp_path / "out.gcode")
    warnings = " ".join(file.warnings)
    acceleration = own.acceleration_limit[own.axis_names.index("X")]
    found = re.search(r"([\d.]+) s as the planner of grbl runs it", warnings)
    assert found is not None
    assert float(found[1]) == pytest.approx(2.0 + 0.01 / acceleration, rel=2e-3)
    (file,) = write(made, "marlin", tmp_path / "out2.gcode")
    assert "which the firmware makes itself" in file.warnings[0]


def test_program_that_reads_back_differently_is_not_written(
    tmp_path: Path, xya: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When the ends read back 0.1 mm off, there is an error and no file."""
    made = plan(tmp_path, xya, "G1 X5 F600\nM30\n")
    usual = firmware_program.read_written

    def off(path: Path, machine: Machine, target: str) -> Job:
        text = path.read_text("ascii")
        assert "X5" in text
        path.write_text(text.replace("X5", "X5.1"), "ascii")
        return usual(path, machine, target)

    monkeypatch.setattr(firmware_program, "read_written", off)
    with pytest.raises(PlanError, match="read back, is not the plan: it leaves it by"):
        write(made, "grbl", tmp_path / "out.gcode")
    assert not (tmp_path / "out.gcode").exists()


@pytest.mark.linuxcnc
def test_linuxcnc_takes_what_is_written_for_it(tmp_path: Path, xya: Machine) -> None:
    """LinuxCNC's interpreter ends every block where it was written, within one fourth decimal."""
    rs274 = shutil.which("rs274")
    if rs274 is None:
        pytest.skip("rs274 (Debian's linuxcnc-uspace) is not installed")
    text = "G1 F3000 X8 A20\nX16 Y5\nA40\nG4 P0.2\nX0 Y0 A0\nM30\n"
    made = plan(tmp_path, xya, text)
    out = tmp_path / "out.ngc"
    write(made, "linuxcnc", out)
    found = re.findall(r"STRAIGHT_FEED\(([^)]*)\)", interpreted(rs274, out))
    ends = [[float(n) for n in call.split(",")] for call in found]
    written = [[e["X"], e["Y"], e["A"]] for e, _ in blocks(out.read_text())]
    assert [[e[0], e[1], e[3]] for e in ends] == [pytest.approx(w, abs=1.01e-4) for w in written]


def test_the_command_says_what_it_wrote(
    tmp_path: Path, examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """x-180 needs a handful of blocks for grbl, but thousands of lines as a timed program."""
    out = tmp_path / "x.gcode"
    with pytest.raises(SystemExit) as stopped:
        main(["compile", str(examples / "x-180.prg"), "-m", "lathe-winder", "--target", "grbl",
              "-o", str(out)])  # fmt: skip
    captured = capsys.readouterr()
    assert not stopped.value.code, captured.err
    assert "blocks, read back: within" in captured.err
    assert len(out.read_text().splitlines()) < 60
    assert load_machine("lathe-winder").axes["X"].kind == "linear"


def test_klipper_gets_the_shaper_of_each_mode(tmp_path: Path) -> None:
    """The eye of the stepper winder swings on its belt while the motor holds: f = sqrt(k/m) / 2 pi.

    The belt has 60 kN/m, the eye 1.2 kg; the belt damps with 25 N s/m, the rollers with 8. Every
    named type leaves at most 5 % of that mode within 10 %, by the impulses and the phasor sum
    below.
    """
    machine = load_machine("stepper-winder")
    made = plan(tmp_path, machine, "O1\nG1 X30 F1200\nM30\n")
    out = tmp_path / "out.gcode"
    write(made, "klipper", out)
    head = [line[2:] for line in out.read_text().splitlines() if line.startswith("; ")]
    values = dict(line.split(": ") for line in head if line.startswith(("shaper_", "damping_")))
    hz, zeta = float(values["shaper_freq_x"]), float(values["damping_ratio_x"])
    assert hz == pytest.approx(math.sqrt(60e3 / 1.2) / (2.0 * math.pi), rel=1e-3)
    assert zeta == pytest.approx(33.0 / (2.0 * math.sqrt(60e3 * 1.2)), rel=1e-3)
    assert head.index("[input_shaper]") < len(head) - 3
    assert not any(key.endswith(("_a", "_y")) for key in values)
    mode = FlexibleMode(frequency_hz=hz, damping_ratio=zeta)
    train = klipper_impulses(values["shaper_type_x"], mode)
    for f in hz * np.linspace(0.9, 1.1, 41):
        w = 2.0 * math.pi * f
        decayed = train.amplitudes * np.exp(-zeta * w * (train.times_s[-1] - train.times_s))
        turned = np.exp(1j * w * math.sqrt(1.0 - zeta**2) * train.times_s)
        assert abs((decayed * turned).sum()) <= 0.0501
    zv = klipper_impulses("zv", mode)
    assert (zv.times_s[-1] < train.times_s[-1]) == (values["shaper_type_x"] != "zv")


def left(train: Shaper, hz: float, zeta: float) -> float:
    """Return the share of a mode that a train of impulses leaves, by the sum of its phasors."""
    w = 2.0 * math.pi * hz
    decayed = train.amplitudes * np.exp(-zeta * w * (train.times_s[-1] - train.times_s))
    turned = np.exp(1j * w * math.sqrt(1.0 - zeta**2) * train.times_s)
    return float(abs((decayed * turned).sum()))


def head_of(folder: Path, machine: Machine, target: str) -> list[str]:
    made = plan(folder, machine, "O1\nG1 X30 F1200\nM30\n")
    out = folder / "out.gcode"
    write(made, target, out)
    return [line[2:] for line in out.read_text().splitlines() if line.startswith("; ")]


def words_of(line: str) -> dict[str, float]:
    return {word[0]: float(word[1:]) for word in line.split() if word[0] in "FDS"}


def test_marlin_gets_the_damped_frequency(tmp_path: Path) -> None:
    """F is the damped frequency, because Marlin's second impulse comes half a period of F later.

    The first impulse is 1 / (1 + K) and the second K / (1 + K), with K = exp(-pi zeta / sqrt(1 -
    zeta^2)), within 1 / 128.
    """
    machine = load_machine("stepper-winder")
    head = head_of(tmp_path, machine, "marlin")
    (command,) = (line for line in head if line.startswith("M593"))
    values = words_of(command)
    zeta = 33.0 / (2.0 * math.sqrt(60e3 * 1.2))
    hz = math.sqrt(60e3 / 1.2) / (2.0 * math.pi)
    assert command.startswith("M593 X F")
    assert values["D"] == pytest.approx(zeta, rel=1e-3)
    assert values["F"] == pytest.approx(hz * math.sqrt(1.0 - zeta**2), rel=1e-4)
    train = marlin_impulses(values["F"], values["D"])
    decay = math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2))
    assert train.amplitudes == pytest.approx([1 / (1 + decay), decay / (1 + decay)], abs=1 / 128)
    assert train.times_s.tolist() == [0.0, 0.5 / values["F"]]
    assert left(train, hz, zeta) < 0.01
    (comment,) = (line for line in head if "Marlin's ZV leaves" in line)
    off = max(left(train, f, zeta) for f in hz * np.linspace(0.9, 1.1, 41))
    assert f"{off:.0%} at most" in comment
    assert any(line.startswith("A: Marlin shapes X, Y alone") for line in head)


def test_reprapfirmware_gets_one_shaper_for_all(tmp_path: Path) -> None:
    """One train leaves at most 5 % of the modes of X and A within 10 %, and no shorter one does.

    X has 60 kN/m and 1.2 kg; the mode of A is read from the file's head. ZVD shows that the trains
    are RepRapFirmware's: 1, 2 k and k^2 over (1 + k)^2, half a damped period apart
    (``AxisShaper::Configure``).
    """
    machine = load_machine("stepper-winder")
    head = head_of(tmp_path, machine, "reprapfirmware")
    (command,) = (line for line in head if line.startswith("M593"))
    name, values = command.split('"')[1], words_of(command.split('"')[2])
    modes = [
        [float(number) for number in re.findall(r"[\d.]+(?= Hz)|(?<=ratio )[\d.]+", line)]
        for line in head
        if " Hz, damping ratio " in line
    ]
    zeta = 33.0 / (2.0 * math.sqrt(60e3 * 1.2))
    hz = math.sqrt(60e3 / 1.2) / (2.0 * math.pi)
    assert len(modes) == 2 and max(modes) == pytest.approx([hz, zeta], rel=1e-3)
    assert min(f for f, _ in modes) <= values["F"] <= max(f for f, _ in modes)

    def most(train: Shaper) -> float:
        return max(left(train, f * k, z) for f, z in modes for k in np.linspace(0.9, 1.1, 41))

    chosen = reprap_impulses(name, values["F"], values["S"])
    assert most(chosen) <= 0.0501
    for other in TYPES:
        for f in np.linspace(min(f for f, _ in modes), max(f for f, _ in modes), 9):
            train = reprap_impulses(other, f, values["S"])
            assert train.times_s[-1] > 0.999 * chosen.times_s[-1] or most(train) > 0.0499
    root = math.sqrt(1.0 - zeta**2)
    k = math.exp(-math.pi * zeta / root)
    zvd = reprap_impulses("zvd", hz, zeta)
    assert zvd.amplitudes == pytest.approx(np.array([1.0, 2.0 * k, k * k]) / (1.0 + k) ** 2)
    assert zvd.times_s == pytest.approx(np.arange(3) * 0.5 / (hz * root))


def test_one_shaper_lies_between_two_modes() -> None:
    """One train leaves at most 5 % of 30 and 34 Hz within 10 %, but none of 10 and 97 Hz."""
    near = [FlexibleMode(frequency_hz=f, damping_ratio=0.05) for f in (30.0, 34.0)]
    found = shortest_for_all(near)
    assert found is not None and 30.0 <= found.frequency_hz <= 34.0
    train = reprap_impulses(found.type, found.frequency_hz, found.damping_ratio)
    most = max(left(train, f * k, 0.05) for f in (30.0, 34.0) for k in np.linspace(0.9, 1.1, 41))
    assert most <= 0.0501 and found.left == pytest.approx(most, abs=1e-3)
    far = [FlexibleMode(frequency_hz=f, damping_ratio=0.02) for f in (10.0, 97.0)]
    assert shortest_for_all(far) is None


@pytest.mark.parametrize("target", ["klipper", "reprapfirmware"])
def test_a_firmware_is_refused_what_it_has_no_word_for(
    tmp_path: Path, xya: Machine, target: str
) -> None:
    """M0 is no word of Klipper, and in RepRapFirmware it ends the job (``GCodes2.cpp``)."""
    made = plan(tmp_path, xya, "G1 X30 F1200\nM0\nG1 X0\nM30\n")
    with pytest.raises(PlanError, match=rf"program for {target}: M0 \(line 2\)"):
        write(made, target, tmp_path / "out.gcode")
    assert not (tmp_path / "out.gcode").exists()


def test_a_feed_that_replaces_the_programmed_ones_is_written(tmp_path: Path, xya: Machine) -> None:
    """With --feed the program is as fast as the plan; no F of the job limits it."""
    feed = parse_feed("3000 mm/min")
    as_it_is = plan(tmp_path, xya, "G1 X60 A110 F1200\nX0 A0\nM30\n")
    faster = plan(tmp_path, xya, "G1 X60 A110 F1200\nX0 A0\nM30\n", feed=feed)
    out = tmp_path / "out.gcode"
    write(as_it_is, "grbl", out)
    assert max(f for _, f in blocks(out.read_text())) == pytest.approx(1200.0, rel=1e-3)
    write(faster, "grbl", out)
    found = blocks(out.read_text())
    # 3000 mm/min along one axis is a higher F of both together, as grbl counts.
    assert max(f for _, f in found) >= 3000.0
    # Rounded ends change a constant speed a little; that begins no new block.
    assert len(found) <= 4


def test_linuxcnc_s_own_time_is_that_of_its_blends(tmp_path: Path, xya: Machine) -> None:
    """A move of 20 mm at 10 mm/s takes L / v + v / a, and the program's own P counts."""
    own = replace(xya, planner=LinuxCncPlanner(kind="linuxcnc", exact_stop=True))
    made = plan(tmp_path, own, "G1 X20 F600\nM30\n")
    (file,) = write(made, "linuxcnc", tmp_path / "out.ngc")
    warnings = re.search(r"([0-9.]+) s as the planner of linuxcnc runs it", file.warnings[0])
    assert warnings is not None and float(warnings[1]) == pytest.approx(2.0 + 0.01 / 5.0, rel=2e-3)


@pytest.mark.parametrize(
    ("first", "early"), [("G0 X20 Y10", True), ("G0 X20 Y10 Z5", False), ("G0 X20 Y10\nM0", False)]
)
def test_an_axis_that_moves_before_the_job_names_it_is_told(
    tmp_path: Path, first: str, early: bool
) -> None:
    """The rounded corner before a descent would move Z before the job names it."""
    machine = made_machine(tmp_path, "XYZ", "A", '[programs]\nfeed_mode = "grbl"\n')
    text = f"G21 G90\n{first}\nG0 Z7\nG1 X40 F1000\nG0 X0 Y0\nM30\n"
    found = plan(tmp_path, machine, text, dialect="grbl", interpolation="auto")
    (written,) = write(found, "grbl", tmp_path / "out.nc")
    warnings = [one for one in written.warnings if one.startswith("Z moves before line 3")]
    assert bool(warnings) == early


def test_a_plan_is_read_once_for_all_passes(
    tmp_path: Path, xya: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its program is written and read back; a plan too long to keep gives the same program."""
    zigzag = "".join(f"G1 X{10 + k % 3} A{40 * (k % 2)} F6000\n" for k in range(12))
    made = plan(tmp_path, xya, f"G21 G90\n{zigzag}M2\n", interpolation="auto")
    reads = []
    planned_runs = merged_chords.planned_runs

    def counted(*given: object) -> object:
        reads.append(given)
        return planned_runs(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(merged_chords, "planned_runs", counted)
    write(made, "grbl", tmp_path / "once.nc")
    assert len(reads) == 1
    monkeypatch.setattr(merged_chords, "MOST_CACHED", 10)
    write(made, "grbl", tmp_path / "again.nc")
    assert len(reads) > 2
    assert (tmp_path / "once.nc").read_bytes() == (tmp_path / "again.nc").read_bytes()
