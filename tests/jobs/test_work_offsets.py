"""Work coordinate systems, programs one after another, and outputs that move nothing.

Sources: grbl 1.1, gcode.c: M2 and M30 set G1 G17 G54 G90 G94, keep F and units, and end nothing;
G53 uses the machine's own system, even in G91. LinuxCNC, G Codes: G54 to G59.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.jobs.made_machines import made_machine
from threadline.errors import InputError, JobError
from threadline.jobs import Dwell, Job, Move, Stop, read_job
from threadline.machine import Machine

OFFSETS = """[programs]
dialect = "grbl"
[programs.offsets]
G54 = { X = "100 mm exact, assumed", Y = "-5 mm exact, assumed" }
G55 = { X = "130 mm exact, assumed", A = "90 deg exact, assumed" }
"""


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("plain"), "XYZ", "A")


@pytest.fixture(scope="module")
def with_offsets(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("told"), "XYZ", "A", OFFSETS)


def read(folder: Path, machine: Machine, text: str, dialect: str = "grbl") -> Job:
    path = folder / "a.nc"
    path.write_text(text)
    return read_job(path, machine, dialect=dialect)


def places(job: Job) -> list[tuple[float, ...]]:
    """Return X and Y in mm after every move."""
    moves = (one for one in job if isinstance(one, Move))
    return [tuple(round(1e3 * p, 9) for p in move.target[:2]) for move in moves]


@pytest.mark.parametrize("dialect", ["linuxcnc", "grbl", "fluidnc", "fanuc"])
def test_a_program_in_one_system_has_its_zero_there(
    tmp_path: Path, plain: Machine, dialect: str
) -> None:
    text = "{} G21 G90\nG1 X10. Y2. F600\nG92 X0.\nX5.\nM30\n"
    first = places(read(tmp_path, plain, text.format("G54"), dialect))
    assert places(read(tmp_path, plain, text.format("G56"), dialect)) == first
    assert first == [(10.0, 2.0), (15.0, 2.0)]


def test_systems_lie_as_far_apart_as_the_machine_file_says(
    tmp_path: Path, with_offsets: Machine
) -> None:
    """The zero of the first is the start of the job; G92 is kept, and G53 ignores every shift."""
    text = (
        "G1 F600 X10 Y0\nG55 X10\nY1\nG91 X1\nG90 G54 X0\nG92 X100\nX101\nG55 X101\n"
        "G91 G53 X100 Y-5\nG90 X101\nM2\n"
    )
    assert places(read(tmp_path, with_offsets, text)) == [
        (10, 0), (40, 0), (40, 6), (41, 6), (0, 6), (1, 6), (31, 6), (0, 0), (31, 0),
    ]  # fmt: skip
    job = read(tmp_path, with_offsets, "G1 F600 X10\nG55 A0\nM2\n")
    assert [one.target[3] for one in job if isinstance(one, Move)][-1] == pytest.approx(
        1.5707963268
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "G1 X1 F60\nG55 X2\nM2\n",
            "a.nc:2: the program moves by G54 and G55: only the",
        ),
        (
            "G55 G1 X1 F60\nG53 X2\nM2\n",
            "a.nc:2: the program moves by G55 and G53: only the",
        ),
        ("G1 X1 F60\nG56 X2\nM2\n", "by G54 and G56: only the control knows"),
    ],
)
def test_missing_work_offset_is_requested_in_the_machine_file(
    tmp_path: Path, plain: Machine, with_offsets: Machine, text: str, message: str
) -> None:
    machine = with_offsets if "G56" in text else plain
    with pytest.raises(JobError) as caught:
        read(tmp_path, machine, text)
    assert message in str(caught.value) and "\n" not in str(caught.value)
    assert "programs.offsets" in str(caught.value)


def test_offsets_are_of_axes_in_their_units(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"programs.offsets.G54.A is in m, but the axis needs rad"):
        made_machine(tmp_path, "X", "A", OFFSETS.replace('Y = "-5', 'A = "-5'))


def test_grbl_goes_on_behind_the_end_of_a_program(tmp_path: Path, plain: Machine) -> None:
    """Modes are reset, F stays, and the machine rests between; the last end is the end."""
    text = "G91 G0 X1\nG1 X1 F60\nG18\nM30\nX5\nY1\nG0 X9\nM2\n(over)\n\nM30\n"
    job = read(tmp_path, plain, text)
    assert places(job) == [(1, 0), (2, 0), (5, 0), (5, 1), (9, 1)]
    operations = list(job)
    assert [type(one) for one in operations if not isinstance(one, Move)] == [Dwell, Stop]
    assert operations[3].source.line == 5 and operations[3].feed == operations[1].feed
    (end_warning,) = [warning for warning in job.warnings if "do not end the program" in warning]
    assert "a.nc:4" in end_warning and "lines 4)" in end_warning
    open_end = read(tmp_path, plain, "G1 X1 F60\nM30\nX2\n")
    assert places(open_end) == [(1, 0), (2, 0)] and isinstance(list(open_end)[-1], Stop)
    for dialect in ("fluidnc", "linuxcnc"):
        with pytest.raises(JobError, match="never run"):
            read(tmp_path, plain, text, dialect)


@pytest.mark.parametrize("dialect", ["linuxcnc", "fluidnc"])
def test_outputs_move_nothing(tmp_path: Path, plain: Machine, dialect: str) -> None:
    job = read(tmp_path, plain, "G1 X1 F60\nM62 P0\nM65 P3\nX2\nM30\n", dialect)
    assert places(job) == [(1, 0), (2, 0)]
    assert any("M62 (line 2), M65 (line 3)" in warning for warning in job.warnings)
    with pytest.raises(JobError, match="unknown word M62"):
        read(tmp_path, plain, "G1 X1 F60\nM62 P0\n", "grbl")


@pytest.mark.parametrize("block", ["#<up> = 5", "G1 X[#5 + 1]", "X#<up>", "o100 if [#1 GT 2]"])
def test_grbl_has_no_parameters_and_expressions(tmp_path: Path, plain: Machine, block: str) -> None:
    with pytest.raises(JobError, match=r"parameters and expressions are not read|no number"):
        read(tmp_path, plain, f"G1 X1 F60\n{block}\nM30\n", "grbl")


def test_a_subroutine_in_another_system_is_no_program_in_one(
    tmp_path: Path, plain: Machine
) -> None:
    """It is written before its caller, whose first move is in G54 although the last word is G55."""
    text = "%\nO1\nG55\nX5\nM99\nO2\nG1 X10 F60\nM98 P1\nX20\nM30\n%\n"
    with pytest.raises(JobError, match="moves by G55 and G54"):
        read(tmp_path, plain, text, "linuxcnc")


def test_a_tool_length_before_all_moves_is_where_the_zero_is(
    tmp_path: Path, plain: Machine
) -> None:
    """Posts for LinuxCNC write it; T0, G49, G64 P, G98 and M48 change no motion either."""
    head = "G17 G21 G40 G49 G54 G64 P0.01 G80 G90 G94 G98\nM48\nT0 M6\n"
    bare = "G0 X2 Y1\nG1 X7 F600\n{}M2\n"
    for lengths in ("G43 H1\n", "G43\nG43\n", "G49\nG43 H0\n", "N5 G43 H12 (long)\n"):
        job = read(tmp_path, plain, head + lengths + bare.format("G49\n"), "linuxcnc")
        assert places(job) == [(2.0, 1.0), (7.0, 1.0)]
        assert sum("knows the tool length of G43" in warning for warning in job.warnings) == 1
        taken, *_, left = [word for word in _words(job) if word[:2] == "G4"]
        assert taken in lengths and taken.startswith("G43") and left == "G49"
    in_move = read(tmp_path, plain, "G90\nG0 G43 Z5 H1 X1\n#1=3\nG0 X#1\nM2\n", "linuxcnc")
    assert places(in_move) == [(1.0, 0.0), (3.0, 0.0)]


def _words(job: Job) -> list[str]:
    """Return the words that switch the machine's devices, in order."""
    found: list[str] = []
    for one in job:
        acts = one.acts if isinstance(one, Move) else (one,)
        found += [act.words for act in acts if getattr(act, "words", "")]
    return found


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "G0 Z1\nG43 H1\nZ2\nM2\n",
            "or a program for each tool (leave out the move on line 1, if it only lifts the tool",
        ),
        ("G43 H1\nG0 Z1\nG43 H2\nZ2\nM2\n", "G43 H2 begins it between moves"),
        ("G43 H1\nG0 Z1\nG49\nZ2\nM2\n", "G49 on line 3 ends it between moves"),
        ("M98 P2\nG43\nG0 X1\nM2\nO2\nG0 X2\nM99\n", "a.nc:2: G43 is compensation"),
        ("G0 X1\nM98 P2\nX2\nM2\nO2\nG43 H1\nM99\n", "G43 H1 begins it between moves"),
        ("G43 H1\nG0 Z1\n#1=2\nG49\nZ#1\nM2\n", "G49 on line 4 ends"),
        ("H1 G0 X1\nM2\n", "H has no use in this block"),
        ("G43 H1.5\nG0 X1\nM2\n", "H 1.5 must be a whole number"),
    ],
)
def test_a_tool_length_between_moves_is_refused(
    tmp_path: Path, plain: Machine, text: str, message: str
) -> None:
    with pytest.raises(InputError) as caught:
        list(read(tmp_path, plain, text, "linuxcnc"))
    assert message in str(caught.value)
