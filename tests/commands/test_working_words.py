"""Words that switch devices of a machine: each at its place, or refused by name.

A small reader that only knows the modes (G0 or G1, spindle, S, coolant, position) plays the
programs here, once as written by hand and once as compiled; LinuxCNC's interpreter plays its own.
"""

from __future__ import annotations

import json
import math
import random
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.jobs.controls_themselves import interpreted
from tests.jobs.made_machines import made_machine
from threadline.cli.main import main
from threadline.commands.boards import BOARDS
from threadline.commands.plan import Plan
from threadline.errors import PlanError
from threadline.files import tick_table
from threadline.jobs import read_job
from threadline.jobs.gcode.dialects import DIALECTS
from threadline.jobs.operations import Dwell, Job, Move, Stop, ToolEvent
from threadline.machine import Machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, write

LASER = "G21 G90\nM4 S0\nG0 X10 Y10\nG1 X20 S300 F1200\nG0 X30\nG1 X40 S500\nM5\n"
MILL = (
    "G21 G90\nT1 M6\nM3 S10000\nG0 X10\nG1 Y-2 F100\nG1 X20 F500\nG0 Y5\nM5\nT2 M6\nM3 S4000\n"
    "G1 X40 F500\nM8\nG1 X50\nM9\nM5\nM30\n"
)
PEN = (
    "G21\nG92 X0 Y0\nM300 S30\nG4 P150\nM18\nM17\nG1 X10 Y2 F3500\nM117 half way\nM300 S30.00\n"
    "G4 P150\nG0 X12 Y9 F6000\nM106 S255\nG1 X14\nM280 P0 S90\nG28 X\nM84\n"
)
NEAR_MM = 0.11  # the plan's tolerance plus its chords' tolerance


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Machine]:
    """A machine by the dialect of its programs; ``klipper`` has Klipper's planner."""
    planner = (
        '[planner]\nkind = "klipper"\nvelocity = "300 mm/s exact, assumed"\nacceleration = "3000 '
        'mm/s^2 exact, assumed"\nsquare_corner_velocity = "5 mm/s exact, assumed"\n'
    )
    found = {}
    for name in ("grbl", "fluidnc", "linuxcnc", "marlin", "fanuc", "klipper"):
        more = f'[programs]\ndialect = "{"marlin" if name == "klipper" else name}"\n'
        more += planner if name == "klipper" else ""
        found[name] = made_machine(tmp_path_factory.mktemp(name), "XY", "", more)
    return found


def plan(folder: Path, machine: Machine, text: str, **options: object) -> Plan:
    job = folder / "job.nc"
    job.write_text(text)
    chosen = Options(**options)  # type: ignore[arg-type]
    return plan_job(open_job(job, machine, chosen), machine, chosen)


def compiled(folder: Path, machine: Machine, text: str, target: str, **options: object) -> str:
    out = folder / "out.nc"
    write(plan(folder, machine, text, **options), target, out)
    return out.read_text()


def played(text: str) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return each straight way: its modes, its start and its end, mm."""
    at, found = np.zeros(2), []
    motion, spindle, power, coolant = "G0", "M5", "S0", "M9"
    for line in text.splitlines():
        words = re.findall(r"[A-Z]-?[0-9.]+", line.partition(";")[0])
        for word in words:
            motion = word if word in {"G0", "G1"} else motion
            spindle = word if word in {"M3", "M4", "M5"} else spindle
            power = word if word[0] == "S" else power
            coolant = word if word in {"M7", "M8", "M9"} else coolant
        if "G4" in words or "G92" in words:
            continue
        then = at.copy()
        for word in words:
            if word[0] in "XY":
                then["XY".index(word[0])] = float(word[1:])
        if (then != at).any():
            found.append((" ".join((motion, spindle, power, coolant)), at, then))
        at = then
    return found


def stretches(text: str) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return the ways of a program in each state of its modes, one after the other."""
    found: list[tuple[str, np.ndarray, np.ndarray]] = []
    for modes, begin, end in played(text):
        if found and found[-1][0] == modes:
            found[-1] = (modes, found[-1][1], end)
        else:
            found.append((modes, begin, end))
    return found


@pytest.mark.parametrize("text", [LASER, MILL])
@pytest.mark.parametrize("interpolation", ["auto", "optimal", "parabolic", "linear", "b-spline"])
def test_each_way_is_gone_in_the_modes_of_the_program(
    tmp_path: Path, machines: dict[str, Machine], text: str, interpolation: str
) -> None:
    """Travel stays G0, and power and coolant change at their places, within the tolerance."""
    near_mm = 3.0 if interpolation == "b-spline" else NEAR_MM  # which has no tolerance
    out = compiled(tmp_path, machines["grbl"], text, "grbl", interpolation=interpolation)
    expected, found = stretches(text), stretches(out)
    assert [modes for modes, _, _ in found] == [modes for modes, _, _ in expected]
    for (_, begin, end), (_, begun, ended) in zip(expected, found, strict=True):
        assert np.linalg.norm(begin - begun) <= near_mm
        assert np.linalg.norm(end - ended) <= near_mm


@pytest.mark.long(shown_by="test_each_way_is_gone_in_the_modes_of_the_program")
def test_random_programs_keep_their_modes(tmp_path: Path, machines: dict[str, Machine]) -> None:
    """Twenty programs of moves, powers and switches in any order, seed 39."""
    chance = random.Random(39)
    for number in range(20):
        lines = ["G21 G90 F1500"]
        for _ in range(chance.randint(4, 14)):
            word = chance.choice(
                ["M3", "M4", "M5", "M8", "M9", "G4 P0.05", f"S{chance.randint(0, 9)}"]
            )
            way = f"X{chance.randint(-9, 9) * 5} Y{chance.randint(-9, 9) * 5}"
            beside = chance.choice(["", "", f" S{chance.randint(10, 99)}"])
            lines += [word] if chance.random() < 0.4 else []
            lines.append(f"G{chance.randint(0, 1)} {way}{beside}")
        text = "\n".join(lines) + "\n"
        out = compiled(tmp_path, machines["grbl"], text, "grbl")
        expected, found = stretches(text), stretches(out)
        assert [m for m, _, _ in found] == [m for m, _, _ in expected], (number, text, out)
        for (_, _, end), (_, _, ended) in zip(expected, found, strict=True):
            assert np.linalg.norm(end - ended) <= 2.0 * NEAR_MM, (number, text, out)


def test_words_of_a_line_go_over_as_they_are(tmp_path: Path, machines: dict[str, Machine]) -> None:
    """For the firmware of the source: in order, travel as G0, only messages left out."""
    out = compiled(tmp_path, machines["klipper"], PEN, "klipper")
    lines = [line for line in out.splitlines() if not line.startswith(";")]
    others = [line for line in lines if not line.startswith(("G0 ", "G1 "))]
    assert others == [
        "G21", "G90", "G92 X0 Y0", "M300 S30", "G4 P150", "M18", "M17", "M300 S30.00", "G4 P150",
        "M106 S255", "M280 P0 S90", "G28 X", "M84", "M400",
    ]  # fmt: skip
    travel = [k for k, line in enumerate(lines) if line.startswith("G0 ")]
    assert travel and "F" in lines[travel[0]]
    assert lines.index("M300 S30.00") < travel[0] < lines.index("M106 S255")


@pytest.mark.parametrize(
    ("source", "target", "text", "lost"),
    [
        (
            "grbl",
            "marlin",
            LASER,
            "3 words .* marlin: M4 S0 (line 2), S300 (line 4), S500 (line 6)",
        ),
        ("grbl", "linuxcnc", LASER, "1 word .* linuxcnc: M4 S0 (line 2)"),
        ("grbl", "nc", LASER, "1 word .* linuxcnc: M4 S0 (line 2)"),
        ("linuxcnc", "grbl", "M4 S100\nG1 X9 F600\nM2\n", "1 word .* grbl: M4 S100 (line 1)"),
        ("linuxcnc", "grbl", "M64 P1\nG1 X9 F600\nM2\n", "1 word .* grbl: M64 P1 (line 1)"),
        ("klipper", "grbl", "G1 X9 F600\nM280 P0 S90\n", "1 word .* grbl: M280 P0 S90 (line 2)"),
        ("klipper", "marlin", "G1 X9 F600\nM300 S9\n", "1 word .* marlin: M300 S9 (line 2)"),
        ("marlin", "klipper", "M106 P1 S9\nG1 X9 F600\n", "1 word .* klipper: M106 P1 S9 (line 1)"),
        ("marlin", "grbl", "M3 S128\nG1 X9 F600\nM5\n", "1 word .* grbl: M3 S128 (line 1)"),
        ("marlin", "grbl", "M0 Turn it\nG1 X9 F600\n", "1 word .* grbl: M0 Turn it (line 1)"),
        ("marlin", "nc", "G1 X9 F600\nM0 Set it\n", "1 word .* linuxcnc: M0 Set it (line 2)"),
        ("klipper", "grbl", "G1 X9 F600\n" + "M300 S1\n" * 9, "9 words .* (line 6) and 4 more"),
    ],
)
def test_a_word_that_means_something_else_is_refused_by_name(
    tmp_path: Path, machines: dict[str, Machine], source: str, target: str, text: str, lost: str
) -> None:
    made = plan(tmp_path, machines[source], text)
    pattern = re.escape(lost).replace(r"\ \.\*\ ", ".*")
    with pytest.raises(PlanError, match=pattern):
        write(made, target, tmp_path / "out.nc")
    assert not (tmp_path / "out.nc").exists()


def test_a_g0_with_its_planned_time_is_told_and_is_dark(
    tmp_path: Path, machines: dict[str, Machine]
) -> None:
    """``nc`` is a program of times: LinuxCNC would take its own over a G0."""
    text = "G0 X10\nM3 S300\nG1 Y10 F600\nM5\nG0 X0\nM2\n"
    (file,) = write(plan(tmp_path, machines["linuxcnc"], text), "nc", tmp_path / "out.ngc")
    assert "2 G0 are G1 with the planned time (G93)" in file.warnings[0]
    moves = played((tmp_path / "out.ngc").read_text())
    assert {modes[:2] for modes, _, _ in moves} == {"G1"}
    dark = plan(tmp_path, machines["linuxcnc"], "M3 S0\nG0 X9\nG1 X0 F600 S9\nM2\n")
    assert "1 G0 is a G1" in write(dark, "nc", tmp_path / "out.ngc")[0].warnings[0]
    burning = plan(tmp_path, machines["linuxcnc"], text.replace("M5\n", ""))
    with pytest.raises(PlanError, match=r"job.nc:4: M3 \(line 2\) is on in a G0") as caught:
        write(burning, "nc", tmp_path / "no.ngc")
    assert "--target linuxcnc" in str(caught.value)
    assert not (tmp_path / "no.ngc").exists()


@pytest.mark.parametrize("spindle", ["M3 S12000", "M4 S12000"])
def test_a_mill_goes_in_g0_with_its_spindle_on(tmp_path: Path, spindle: str) -> None:
    """It plunges along Z, which no laser does; an output that is on stays on, too.

    The same moves along X and Y alone may be a laser's, and so may Z moves with it off.
    """
    text = f"G0 Z5\n{spindle}\nM64 P1\nG0 X10\nG1 Z-1 F300\nG1 Y10 F600\nG0 Z5\nG0 X0\nM5\nM2\n"
    machine = made_machine(tmp_path, "XYZ", "", '[programs]\ndialect = "linuxcnc"\n')
    (file,) = write(plan(tmp_path, machine, text), "nc", tmp_path / "out.ngc")
    assert "4 G0 are G1 with the planned time (G93)" in file.warnings[0]
    made = (tmp_path / "out.ngc").read_text()
    assert spindle in made and "M64 P1" in made and "M65" not in made
    for laser in (text.replace("Z-1", "Y1"), f"G1 Z-2 F300\n{text.replace('Z-1', 'Z7')}"):
        with pytest.raises(PlanError, match=r"is on in a G0.*no feed move goes down along Z"):
            write(plan(tmp_path, machine, laser), "nc", tmp_path / "no.ngc")


@pytest.mark.parametrize("length", ["G43 H1\nG0 Z15\n", "G43 Z15 H1\n"])
def test_the_tool_goes_over_the_place_before_its_length_holds(tmp_path: Path, length: str) -> None:
    """Over the place first, then down with G43: no chord before G43 moves Z, none after G49."""
    machine = made_machine(tmp_path, "XYZ", "", '[programs]\ndialect = "linuxcnc"\n')
    text = f"M3 S900\nG0 X20 Y10\n{length}G1 Z-2 F300\nG0 Z15\nG49\nG0 X0 Y0\nM5\nM2\n"
    lines = compiled(tmp_path, machine, text, "linuxcnc").splitlines()
    begins, ends = lines.index("G43 H1"), lines.index("G49")
    lowered = [at for at, line in enumerate(lines) if "Z" in line]
    assert begins < lowered[0] and lowered[-1] < ends
    assert lines[begins - 1] == "G0 X20 Y10"


def test_lines_for_fluidnc_and_linuxcnc_are_as_long_as_these_take(
    tmp_path: Path, machines: dict[str, Machine]
) -> None:
    """FluidNC copies a line into 128 bytes (``GCode.cpp``), LinuxCNC one into 256 with its end."""
    for target in ("fluidnc", "linuxcnc", "grbl", "marlin"):
        assert BOARDS[target].longest == DIALECTS[target].grammar.longest
    words = f"M62 P{'0' * 130}1"
    with pytest.raises(PlanError, match=r"a line has 1\d\d characters, and fluidnc takes 127"):
        compiled(tmp_path, machines["linuxcnc"], f"{words}\nG1 X5 F600\nM2\n", "fluidnc")


def test_words_that_mean_the_same_go_over(tmp_path: Path, machines: dict[str, Machine]) -> None:
    text = "M3 S5000\nM8\nG1 X9 F600\nM9\nM5\nM30\n"
    for target in ("grbl", "fluidnc", "linuxcnc", "fanuc"):
        out = compiled(tmp_path, machines["fluidnc"], text, target)
        assert [line for line in out.splitlines() if line[0] == "M"][:2] == ["M3 S5000", "M8"]
        assert out.index("M8") < out.index("X9") < out.index("M9") < out.index("M5")
    assert "M106 S9" in compiled(
        tmp_path, machines["marlin"], "M106 S9\nG1 X9 F600\n", "reprapfirmware"
    )


def test_marlin_shows_the_text_of_a_stop(tmp_path: Path, machines: dict[str, Machine]) -> None:
    """``M0 [S] [P] text`` of Marlin shows the text and waits for the operator."""
    stops = ["M0 Dreh das Teil für 2!", "M0 S2.5 go on", "M1 now", "M0"]
    text = "".join(f"G1 X{5 + k} F600\n{stop}\n" for k, stop in enumerate(stops))
    lines = compiled(tmp_path, machines["marlin"], text, "marlin").splitlines()
    assert [line for line in lines if line[:2] in {"M0", "M1"}] == stops
    with pytest.raises(PlanError, match=r"a line has 103 characters, and marlin takes 95"):
        compiled(tmp_path, machines["marlin"], f"M0 {'x' * 100}\nG1 X5 F600\n", "marlin")


def test_the_command_ends_with_2_and_writes_nothing(
    tmp_path: Path, machines: dict[str, Machine], capsys: pytest.CaptureFixture[str]
) -> None:
    job, out = tmp_path / "pen.gcode", tmp_path / "out.nc"
    job.write_text(PEN)
    machine = str(machines["klipper"].reference)
    with pytest.raises(SystemExit) as stopped:
        main(["compile", str(job), "-m", machine, "--target", "grbl", "-o", str(out)])
    errors = capsys.readouterr().err
    assert stopped.value.code == 2 and not out.exists()
    assert "pen.gcode:3: " in errors.replace("\n", "") and "M300 S30 (line 3)" in errors


def acting(job: Job) -> list[str]:
    """Return the actions of a job, in order: its words, and the ends of its moves."""
    found = []
    for item in job:
        if isinstance(item, Move):
            found += [act.words for act in item.acts]
            found.append(f"{1e3 * item.target[0]:g}")
        elif isinstance(item, ToolEvent | Stop):
            found.append(item.words or "end")
        elif isinstance(item, Dwell):
            found.append("dwell")
    return found


@pytest.mark.parametrize(
    ("dialect", "text", "expected"),
    [
        # RS274/NGC switches before it moves; a Fanuc's M5 and M9 act after the move.
        ("grbl", "G1 X5 F600 M5\nX9\n", "M5,5,9,end"),
        ("fanuc", "G1 X5. F600 M5\nX9.\nM30\n", "5,M5,9,end"),
        ("fanuc", "G1 X5. F600 S9 M3\nX9.\nM30\n", "S9 M3,5,9,end"),
        # A change of the tool comes before the move of its block, a stop after it.
        ("linuxcnc", "G1 X5 F600 T2 M6\nX9 M0\nM2\n", "T2 M6,5,9,M0,end"),
        # grbl goes on after M30 with spindle and coolant off.
        ("grbl", "M3 S9\nG1 X5 F600\nM30\nX9\n", "M3 S9,5,M5 M9,9,end"),
        # The zero is the job's start, and its system is named once.
        ("grbl", "G55\nG92 X7\nG1 X9 F600\nG92 X0\nX1\n", "G92 X0,G55,2,3,end"),
        ("marlin", "M280 P0 S90\nG28 X\nG1 X5 F600\n", "M280 P0 S90,0,G28 X,5,end"),
        ("marlin", "M0 Turn the part ; (2)\nM1 S5\nG1 X5 F600\n", "M0 Turn the part,M1 S5,5,end"),
        ("marlin", "M0 S1.5 M5 is off\nM0P9 X\nG1 X5 F600\n", "M0 S1.5 M5 is off,M0 P9 X,5,end"),
        ("marlin", "M117 M3\nM105\nG1 X5 F600\nM109 S60\nG1 X6\n", "5,M109 S60,6,end"),
        ("linuxcnc", "#1=7\nM62 P1\nG1 X5 F600 S#1\nM2\n", "M62 P1,S7,5,end"),
    ],
)
def test_the_reader_knows_what_a_program_works(
    tmp_path: Path, machines: dict[str, Machine], dialect: str, text: str, expected: str
) -> None:
    file = tmp_path / "job.nc"
    file.write_text(text)
    found = acting(read_job(file, machines[dialect]))
    assert [re.sub(r"\.0+$", "", word) for word in found] == expected.split(",")


def test_words_are_events_at_their_places(tmp_path: Path, machines: dict[str, Machine]) -> None:
    """The tick of each event is that at which X passes its place, while the motion goes on."""
    text = "M3 S0\nG1 X10 F3000 S100\nX20 S200\nX30 S300\nM5\n"
    made = plan(tmp_path, machines["grbl"], text)
    x = made.machine.axis_names.index("X")
    counts, events = [], []
    for block in tick_table(made.commands):
        counts.append(block.counts[:, x])
        events += [event for event in block.events if event.kind == "tool"]
    at_mm = np.concatenate([[0.0], np.cumsum(np.concatenate(counts))]) / 80.0
    assert [event.name for event in events] == ["M3 S0", "S100", "S200", "S300", "M5"]
    assert [event.value for event in events] == [0.0, 100.0, 200.0, 300.0, 0.0]
    places = [at_mm[event.tick] for event in events]
    assert places == pytest.approx([0.0, 0.0, 10.0, 20.0, 30.0], abs=0.06)  # 0.05 mm a tick
    assert min(np.diff(at_mm)[events[2].tick - 5 : events[3].tick]) > 0.0


def test_a_dwell_behind_a_move_that_stays_is_written_once(
    tmp_path: Path, machines: dict[str, Machine]
) -> None:
    """Plotters write the last point twice: the dwell after it stays one, and so does its time."""
    text = "G1 X5 Y1 F3000\nG1 X5 Y1\nM300 S50\nG4 P150\nG1 X9\nG1 X9\nG4 P50\n"
    made = plan(tmp_path, machines["klipper"], text)
    write(made, "klipper", tmp_path / "out.nc")
    lines = (tmp_path / "out.nc").read_text().splitlines()
    assert [line for line in lines if line.startswith(("G4", "M3"))] == [
        "M300 S50", "G4 P150", "G4 P50",
    ]  # fmt: skip


@pytest.mark.linuxcnc
def test_linuxcnc_switches_where_the_program_did(
    tmp_path: Path, machines: dict[str, Machine]
) -> None:
    """Its interpreter prints its calls: the same speeds and switches, at the same places."""
    rs274 = shutil.which("rs274")
    if rs274 is None:
        pytest.skip("rs274 (Debian's linuxcnc-uspace) is not installed")
    text = (
        "G21 G90\nS4000 M3\nG0 X10 Y5\nM62 P1\nG1 X20 F900 S500\nM8\nX30\nG0 X40 Y0\nM4 S70\n"
        "G1 X50\nM9 M5\nM2\n"
    )
    (tmp_path / "out.nc").write_text(compiled(tmp_path, machines["linuxcnc"], text, "linuxcnc"))

    def calls(name: str) -> list[tuple[str, float]]:
        output = interpreted(rs274, tmp_path / name, 300.0)
        found, x = [], 0.0
        for call, message in re.findall(r"([A-Z_]+)\(([^)]*)\)", output):
            if call in {"STRAIGHT_TRAVERSE", "STRAIGHT_FEED"}:
                x = float(message.split(",")[0])
            elif re.search("SPINDLE|FLOOD|OUTPUT", call):
                found.append((f"{call} {message}", x))
        return found

    ours, theirs = calls("out.nc"), calls("job.nc")
    assert len(theirs) >= 8
    assert [call for call, _ in ours] == [call for call, _ in theirs]
    assert [x for _, x in ours] == pytest.approx([x for _, x in theirs], abs=NEAR_MM)


def times_of(command: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[float, float]:
    """Return both times that a command reports for a written program."""
    with pytest.raises(SystemExit) as stopped:
        main([*command, "--json"])
    captured = capsys.readouterr()
    assert not stopped.value.code, captured.err
    (file,) = json.loads(captured.out)["files"]
    return file["stands_s"], file["as_run_s"]


def test_a_program_is_not_slower_than_its_source_unless_told_to(
    tmp_path: Path, machines: dict[str, Machine], capsys: pytest.CaptureFixture[str]
) -> None:
    """A tenth of the limits makes slow chords: both times are printed, and nothing is written."""
    machine = str(machines["klipper"].reference)
    job, out = tmp_path / "zigzag.gcode", tmp_path / "out.gcode"
    ends = [(5 * k, 8 * (k % 2)) for k in range(1, 9)]
    job.write_text("G1 F9000\n" + "".join(f"G1 X{x} Y{y}\n" for x, y in ends))
    expected = ["compile", str(job), "-m", machine, "--target", "klipper", "-o", str(out)]
    with pytest.raises(SystemExit) as stopped:
        main([*expected, "--limits", "10 %"])
    errors = " ".join(capsys.readouterr().err.split())
    match = re.search(r"takes ([\d.]+) s over it, and ([\d.]+) s over zigzag.gcode", errors)
    assert stopped.value.code == 2 and not out.exists() and match is not None
    assert float(match[1]) > 1.2 * float(match[2]) and "--slower" in errors
    slow = times_of([*expected, "--limits", "10 %", "--slower"], capsys)
    assert out.exists()
    assert slow == pytest.approx((float(match[2]), float(match[1])), rel=1e-4)
    with pytest.raises(SystemExit):
        main([*expected, "--limits", "10 %", "--feed", "F 6000"])
    assert "s over zigzag.gcode at the same feed" in " ".join(capsys.readouterr().err.split())
    stands_s, as_run_s = times_of(expected, capsys)
    assert stands_s == slow[0] and as_run_s <= 1.001 * stands_s


def test_compare_shows_what_the_firmware_makes_of_the_program(
    tmp_path: Path, machines: dict[str, Machine], capsys: pytest.CaptureFixture[str]
) -> None:
    """Beside the planned time, the time of the written program; for ``firmware`` both are one."""
    machine, out = str(machines["klipper"].reference), str(tmp_path / "out.gcode")
    job = tmp_path / "line.gcode"
    job.write_text("G1 X20 Y5 F6000\nG1 X40 Y0\n")
    spec = tmp_path / "spec.toml"
    spec.write_text('name = "made"\n[[criteria]]\nname = "path_deviation"\n')
    asked = ["compare", str(job), "-m", machine, "-s", str(spec), "--nominal"]
    asked += ["--interpolation", "auto,firmware"]
    with pytest.raises(SystemExit):
        main([*asked, "--json", "--no-fastest"])
    found = [proof["as_run_s"] for proof in json.loads(capsys.readouterr().out)["proofs"]]
    expected = ["compile", str(job), "-m", machine, "--target", "klipper", "-o", out]
    assert found == [*reversed(times_of(expected, capsys))]
    with pytest.raises(SystemExit):
        main([*asked, "--no-fastest"])
    assert "as run s" in capsys.readouterr().out


def test_the_planned_speeds_give_way_where_they_would_be_slower(tmp_path: Path) -> None:
    """Sixty short chords in a row: F becomes the job's, and the program is no slower."""
    planner = '[planner]\nkind = "marlin"\njunction_deviation = "0.013 mm exact, assumed"\n'
    machine = made_machine(tmp_path, "XY", "", f'[programs]\ndialect = "marlin"\n{planner}')
    chance = random.Random(1)
    x = y = heading = 0.0
    lines = ["G1 F3500 X0"]
    for _ in range(60):
        heading += chance.gauss(0.0, 0.5)
        step = chance.uniform(0.3, 1.6)
        x, y = x + step * math.cos(heading), y + step * math.sin(heading)
        lines.append(f"G1 X{x:.2f} Y{y:.2f}")
    made = plan(tmp_path, machine, "\n".join(lines) + "\n")
    (usual,) = write(made, "marlin", tmp_path / "usual.nc")
    (quick,) = write(made, "marlin", tmp_path / "quick.nc", slower=False)
    assert usual.as_run_s is not None and quick.as_run_s is not None
    assert usual.as_run_s[1] > 1.001 * usual.as_run_s[0] >= quick.as_run_s[1]
    speeds = [re.findall(r"F([\d.]+)", file.path.read_text()) for file in (usual, quick)]
    assert len(set(speeds[0])) > 1 and set(speeds[1]) == {"3500"}
    assert "F is the job's own" in quick.warnings[0]
