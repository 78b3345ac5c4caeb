"""Files for other machines: renamed axes, guessed dialects, tables of axis values.

A renamed program is compared with the same program after an editor replaced the letters, and a
table with the program of the same moves.
"""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from tests.jobs.made_machines import made_machine
from threadline.errors import InputError, JobError, OptionError
from threadline.jobs import Dwell, Job, Move, read_job
from threadline.jobs.feed_times import programmed_time_s
from threadline.machine import Machine

PROGRAM = """G21 G90
G1 C10 Z5 F600 ; tension_N=25
G1 C40 Z-3
G0 Y2
G2 X3 Y5 I3
M2
"""


@pytest.fixture(scope="module")
def axy(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("axy"), "XY", "A")


def made(folder: Path, text: str, machine: Machine, name: str = "a.nc", **options: str) -> Job:
    path = folder / name
    path.write_text(text)
    return read_job(path, machine, **options)


def moves(job: Job) -> list[tuple[object, ...]]:
    return [(one.target, one.feed, one.tags) for one in job if isinstance(one, Move)]


def test_comments_beside_what_grbl_is_asked_are_taken_out_as_grbl_does(
    tmp_path: Path, axy: Machine
) -> None:
    """FluidNC reads such a line with its comment, and knows no setting of that name."""
    program = "$I  ; build info\n(state) $G (modes)\n? ; where\nG21 G90\nG1 X5 F600\n"
    assert len(moves(made(tmp_path, program, axy, dialect="grbl"))) == 1
    with pytest.raises(JobError, match=r"a\.nc:1: '\$I'"):
        made(tmp_path, program, axy, dialect="fluidnc")


@pytest.mark.parametrize(
    ("dialect", "line", "message"),
    [
        ("grbl", "# 4mm square", "'# 4mm square': # begins no comment"),
        ("grbl", "# Offset X: 33.34", "# begins no comment"),
        ("grbl", "#5=1", "parameters and expressions are not read"),
        ("marlin", "G29", "G29 is probing"),
        ("marlin", "G26", "G26 is a test print"),
    ],
)
def test_line_of_another_tool_is_refused_with_its_meaning(
    tmp_path: Path, axy: Machine, dialect: str, line: str, message: str
) -> None:
    with pytest.raises(JobError, match=message):
        list(made(tmp_path, f"G21\n{line}\nG1 X5 F600\n", axy, dialect=dialect))


def test_the_diameter_of_a_filament_moves_nothing(tmp_path: Path, axy: Machine) -> None:
    job = made(tmp_path, "M200 D1.75\nG1 X5 F600\n", axy, dialect="marlin")
    assert len(moves(job)) == 1 and "M200 (line 1)" in job.warnings[0]


@pytest.mark.parametrize("long", [False, True])
def test_lines_that_ask_grbl_for_a_report_move_nothing(
    tmp_path: Path, axy: Machine, long: bool
) -> None:
    """A sender's log begins with such lines; $H moves, and is refused."""
    program = "G21 G90\n" + "G1 X5 F600\nG1 X0\n" * (900 if long else 2)
    asking = "$I\n $$ \n?\n$#\n$n\n" + program + "$G\n"
    for dialect in ("grbl", "fluidnc"):
        job = made(tmp_path, asking, axy, dialect=dialect)
        assert moves(job) == moves(made(tmp_path, program, axy, dialect=dialect))
        with pytest.raises(JobError, match=r"a\.nc:1: .*\$[hH]"):
            list(made(tmp_path, "$H\n" + program, axy, dialect=dialect))
    assert "guessed from the file (it has '$I')" in made(tmp_path, asking, axy).warnings[0]


@pytest.mark.parametrize("long", [False, True])
def test_renamed_axes_are_those_of_a_replaced_text(
    tmp_path: Path, axy: Machine, long: bool
) -> None:
    """Short programs and the compiled reader of long ones."""
    lines = "".join(f"G1 C{i % 7} Z{i % 5}.5 F{500 + i % 3}\n" for i in range(900 if long else 9))
    text = f"G21 G90\n{lines}G0 Y2\nM2\n"
    other = text.replace("C", "A").replace("Z", "X")
    renamed = made(tmp_path, text, axy, axes="C=A, z=x")
    assert moves(renamed) == moves(made(tmp_path, other, axy, "b.nc"))
    assert renamed.axes == axy.axis_names


def test_axes_may_change_places(tmp_path: Path, axy: Machine) -> None:
    """An arc bends in the program's own plane, and a freed letter is no axis any more."""
    text = "G17 G21 G90\nG1 X1 Y2 F600\nG2 X4 Y5 I3\nM2\n"
    job = made(tmp_path, text, axy, dialect="linuxcnc", axes="X=Y,Y=X")
    straight = made(tmp_path, text, axy, "b.nc", dialect="linuxcnc")
    x, y = axy.axis_names.index("X"), axy.axis_names.index("Y")
    swapped = [list(target) for target, _, _ in moves(straight)]  # type: ignore[call-overload]
    for target in swapped:
        target[x], target[y] = target[y], target[x]
    assert [list(target) for target, _, _ in moves(job)] == swapped  # type: ignore[call-overload]
    with pytest.raises(JobError, match=r"X 1: the machine .* has no axis X.*X \(here Z\)"):
        made(tmp_path, text, axy, axes="Z=X", dialect="linuxcnc")


def test_words_of_a_letter_are_left_out_and_said(tmp_path: Path, axy: Machine) -> None:
    text = "G21 G90\n" + "G1 A4 X5 B30 F600\nG1 B7\nG1 A5 X6\n" * 80 + "M2\n"
    job = made(tmp_path, text, axy, axes="B=none")
    bare = text.replace(" B30", "").replace("G1 B7\n", "\n")
    assert moves(job) == moves(made(tmp_path, bare, axy, "b.nc"))
    assert any(
        "without effect on motion, first seen: B (line 2)" in warning for warning in job.warnings
    )


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ("C", "axes 'C' is no pair of axes"),
        ("C=Q", "has no axis Q"),
        ("C=A,C=X", "names C twice"),
        ("C=A,B=A", "names A twice"),
        ("F=A", "axes 'F=A' is no pair of axes"),
        (
            "macros=1",
            "axes 'macros=1': the moves of Klipper's macros can only be left out. "
            "Write macros=none",
        ),
    ],
)
def test_pairs_that_cannot_be_are_refused(
    tmp_path: Path, axy: Machine, axes: str, message: str
) -> None:
    with pytest.raises(OptionError, match=message):
        made(tmp_path, PROGRAM, axy, axes=axes)


def test_an_x_winder_program_goes_to_other_axes(tmp_path: Path, axy: Machine) -> None:
    head = "[G-CODE GENERATED BY X-WINDER DESIGNER v418]\nG20\nG90\n"
    text = head + "M4 S10\nG1 F1 Z8 B5\nG4 C90\nM5\n"
    with pytest.raises(JobError, match=r'--axes "C=A,Z=X"'):
        made(tmp_path, text, axy)
    job = made(tmp_path, text, axy, axes="C=A,Z=X,B=none")
    named = made_machine(tmp_path, "ZY", "C")
    own = made(tmp_path, text.replace(" B5", ""), named, "b.nc")
    ours = [dict(zip(axy.axis_names, target, strict=True)) for target, _, _ in moves(job)]  # type: ignore[call-overload]
    theirs = [dict(zip(named.axis_names, target, strict=True)) for target, _, _ in moves(own)]  # type: ignore[call-overload]
    assert [(p["A"], p["X"]) for p in ours] == [(p["C"], p["Z"]) for p in theirs]


def test_the_head_of_a_3d_print_goes_its_way_without_e(tmp_path: Path) -> None:
    """``G92 E0`` and ``G28 E`` without their E would affect every axis; they do nothing."""
    machine = made_machine(tmp_path, "XY", "")
    printed = "G28\nG92 E0\nG1 X5 Y2 F600 E1.2\nG1 E0.4 F2400\nG92 E0\nG1 X9 F900 E3\n"
    job = made(tmp_path, printed, machine, dialect="klipper", axes="E=none")
    bare = "G28\nG1 X5 Y2 F600\nG1 F2400\nG1 X9 F900\n"
    assert moves(job) == moves(made(tmp_path, bare, machine, "b.nc", dialect="klipper"))
    assert any(
        "E (line 2)" in warning and "compile writes no E" in warning for warning in job.warnings
    )
    for refused in ("E=X", "E=A"):
        with pytest.raises(InputError, match="axes"):
            made(tmp_path, printed, machine, dialect="klipper", axes=refused)


@pytest.mark.parametrize(
    ("left", "words"), [("G92 B0", ""), ("G28 B0", ""), ("G92 X5 B0", "G92 X5")]
)
def test_a_word_left_out_does_not_make_a_block_one_of_all_axes(
    tmp_path: Path, axy: Machine, left: str, words: str
) -> None:
    text = "G1 F600 X7\n{}\nG1 X9\nM2\n"
    job = made(tmp_path, text.format(left), axy, dialect="linuxcnc", axes="B=none")
    own = made(tmp_path, text.format(words), axy, "b.nc", dialect="linuxcnc")
    assert moves(job) == moves(own)


@pytest.mark.parametrize(
    ("text", "dialect", "mark"),
    [
        ("(Fusion LinuxCNC post)\nG90 G17 G91.1\nG1 X1 F60\nM30\n", "linuxcnc", "LinuxCNC"),
        ("T0\nG21\nG90\nG1 X5 F600\n", "marlin", "T0"),
        ("; for RepRapFirmware 3\nG1 X5 F600 G1 X6\n", "reprapfirmware", "RepRapFirmware"),
        ("; made by grbl-plot for GRBL\nG1 X5 F600\n", "grbl", "grbl"),
        ("G21\nM3 S200\nG1 X5 F600\nM5\n", "grbl", "M3 S2"),
        ("G17 G21\nG1 X5 F600\nG2 X9 Y4 I4\nM2\n", "linuxcnc", "G17"),
        ("G17 G21\nG1 X5 F600\nG2 X9 Y4 I4\n", "grbl", "G17"),
        ("G21\nG1 X5 F600 M03\nG1 X9\nM30\n", "linuxcnc", "G1 X5 F600 M03"),
        ("O0001\nG54\nG1 X5. F600\nM30\n", "fanuc", "O0001"),
    ],
)
def test_the_dialect_is_guessed_and_said(
    tmp_path: Path, axy: Machine, text: str, dialect: str, mark: str
) -> None:
    """A dialect named by a machine file or an option is never overruled."""
    if dialect == "fanuc":
        text = text.replace("G54", "G54 G69")  # the winder reads O numbers as well
    job = made(tmp_path, text, axy)
    assert job.dialect == dialect
    assert (
        f"read in the dialect {dialect}, guessed from the file (it has {mark!r})"
        in (job.warnings[0])
    )
    assert moves(job) == moves(made(tmp_path, text, axy, "b.nc", dialect=dialect))
    with pytest.raises(InputError):
        list(made(tmp_path, text.replace("G1", "G1 Q1"), axy, dialect="winder"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G91 G1 F5 X1\nX2\n", "has no end: the file may be truncated"),
        ("G1 X5 F60\nM8\nM2\n", "unknown word M8"),
        ("; for Marlin\nG1 X5 F60\nG1 X7 E1.2\n", "E1.2 is the filament of a 3D print"),
    ],
)
def test_without_a_mark_nothing_is_guessed(
    tmp_path: Path, axy: Machine, text: str, message: str
) -> None:
    with pytest.raises(JobError, match=message):
        made(tmp_path, text, axy)


def test_a_tool_length_may_follow_moves_over_the_place(tmp_path: Path) -> None:
    """Posts write it so: over the place first, then down with G43; Fanuc homes beside G0."""
    machine = made_machine(tmp_path, "XYZ", "A")
    text = "G90 G54 G0 X5. Y2.\nG43 H1 Z15.\nG1 Z-1. F300\nX9.\n{}M30\n"
    for dialect, home in (("linuxcnc", ""), ("fanuc", "G0 G91 G28 Z0.\n")):
        job = made(tmp_path, text.format(home), machine, dialect=dialect)
        z = machine.axis_names.index("Z")
        levels = [round(1e3 * target[z], 6) for target, _, _ in moves(job)]  # type: ignore[index]
        assert levels[:4] == [0.0, 15.0, -1.0, -1.0] and levels[-1] == (0.0 if home else -1.0)
        assert any("it holds for every move of Z" in warning for warning in job.warnings)


TABLE = """# a planner's table
A_deg,Z_mm,F_mm_min,tension_N
0,0,600,25
10,5,600,25
40,-3,900,20
"""


def test_a_table_with_feeds_is_the_program_of_its_rows(tmp_path: Path, axy: Machine) -> None:
    job = made(tmp_path, TABLE, axy, "a.csv", axes="Z=X")
    text = "G1 A10 X5 F600 ; tension_n=25\nA40 X-3 F900 ; tension_n=20\nM2\n"
    program = made(tmp_path, text, axy, feed_mode="fastest-axis")
    assert [tags for *_, tags in moves(job)] == [{"tension_N": 25.0}, {"tension_N": 20.0}]
    for (target, feed, _), (expected, like, _) in zip(moves(job), moves(program), strict=True):
        assert target == pytest.approx(expected, rel=1e-12) and feed.mode == like.mode  # type: ignore[attr-defined]
        assert feed.value == pytest.approx(like.value)  # type: ignore[attr-defined]
    assert [one.source.line for one in job if isinstance(one, Move)] == [4, 5]


def test_a_table_with_times_takes_them(tmp_path: Path, axy: Machine) -> None:
    """It begins at its first row, and rests while no axis moves."""
    text = "time [ms]; X [mm]; A [rad]\n0; 1,5; 0\n250; 2,5; 0,1\n750; 2,5; 0,1\n1000; 3; 0,2\n"
    job = made(tmp_path, text, axy, "a.csv")
    x = axy.axis_names.index("X")
    assert job.start[x] == pytest.approx(1.5e-3)
    assert programmed_time_s(job, axy) == pytest.approx(1.0)
    assert [type(one) for one in job] == [Move, Dwell, Move]
    assert [one.duration_s for one in job if isinstance(one, Dwell)] == [pytest.approx(0.5)]
    again = pickle.loads(pickle.dumps(job.operations))
    assert [one.target for one in again if isinstance(one, Move)] == [
        target for target, _, _ in moves(job)
    ]


def test_a_long_table_is_read_in_order(tmp_path: Path, axy: Machine) -> None:
    n = 10_000
    x_mm = np.sin(np.arange(n) * 0.01)
    rows = "".join(f"{i * 0.01:.3f},{x:.6f}\n" for i, x in enumerate(x_mm))
    job = made(tmp_path, "t_s,X_mm\n" + rows, axy, "a.csv", axes="X=X")
    x = axy.axis_names.index("X")
    ends = np.array([target[x] for target, _, _ in moves(job)])  # type: ignore[index]
    np.testing.assert_allclose(ends, 1e-3 * np.round(x_mm[1:], 6), atol=1e-12)
    assert programmed_time_s(job, axy) == pytest.approx(99.99)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x_mm,y_mm,z_mm,layer\n1,2,3,0\n1,2,4,0\n", "points x, y, z of a fibre"),
        ("A_deg,X_mm\n1,2\n2,3\n", "neither times nor feeds"),
        ("t_s,F_mm_min,X_mm\n0,5,2\n1,5,3\n", "both times and feeds"),
        ("t_s,X_mm\n0,2\n0,3\n", "a.csv:3: the row has no later time"),
        ("t_s,X_mm\n0,2\n1,abc\n", "a.csv:3: 'abc' is not a number"),
        ("t_s,X_mm\n0,2\n1,inf\n", "a.csv:3: a number is not finite"),
        ("t_s,X_mm\n0,2\n1,3,4\n", "a.csv:3: the row has 3 cells"),
        ("t_s,X\n0,2\n1,3\n", "column X has no unit"),
        ("t_s,X_deg\n0,2\n1,3\n", "column X"),
        ("t_s,X_mm\n0,2\n", "fewer than two rows"),
        ("t_s,C_deg\n0,2\n1,3\n", "column C: the machine .* has no axis C"),
        ("t_s,length_mm\n0,2\n1,3\n", "names no axis of the machine"),
    ],
)
def test_a_table_that_is_no_motion_is_refused(
    tmp_path: Path, axy: Machine, text: str, message: str
) -> None:
    with pytest.raises(JobError, match=message):
        made(tmp_path, text, axy, "a.csv")


def test_a_winding_definition_is_named(tmp_path: Path, axy: Machine) -> None:
    with pytest.raises(JobError, match="a winding definition of FiberPath"):
        made(tmp_path, "{}", axy, "a.wind")


@pytest.mark.parametrize("dialect", ["linuxcnc", "fluidnc", "grbl"])
def test_the_block_that_ends_a_program_is_enough_behind_a_percent_sign(
    tmp_path: Path, axy: Machine, dialect: str
) -> None:
    """CAM programs lost their last lines in a mail or an editor; a tape control waits for %."""
    text = "%\nG21\nG90\nG1 X5 F600\nM30\n\n"
    job = made(tmp_path, text, axy, dialect=dialect)
    assert moves(job) == moves(made(tmp_path, text + "%\n", axy, "b.nc", dialect=dialect))
    for cut, strict in [(text.replace("M30\n", ""), dialect), (text.replace("X5", "X5."), "fanuc")]:
        with pytest.raises(JobError, match="the % on line 1 opens the program and none closes it"):
            made(tmp_path, cut, axy, "c.nc", dialect=strict)
