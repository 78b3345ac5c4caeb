"""Each control's own grammar: words that it refuses, drops or reads differently."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from unittest.mock import patch

import pytest

from tests.jobs.in_dialects import millimetres, moves, numbered, read
from tests.jobs.made_machines import made_machine
from tests.jobs.random_blocks import random_blocks, random_commands
from threadline.errors import InputError, JobError
from threadline.jobs import Dwell, Move, Stop
from threadline.jobs.gcode.plain_blocks import PlainReader
from threadline.machine import Machine

HEAD = "G21 G90 G94\nG1 X5 F600\n"


@pytest.fixture(scope="module")
def xyza(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("xyza"), "XYZ", "A")


@pytest.mark.parametrize(
    "dialect", ["grbl", "fluidnc", "linuxcnc", "marlin", "klipper", "reprapfirmware"]
)
def test_a_block_behind_a_semicolon_is_a_comment_for_controls(
    tmp_path: Path, xyza: Machine, dialect: str
) -> None:
    """Posts write ``M0 ;T102``, and users disable a block with a semicolon."""
    stop = "M226" if dialect == "reprapfirmware" else "M0"
    text = f"G21\nG90\nG1 X5 F600 ;G1 X9\n{stop} ;T102\nG1 X7 ; Y3\nM30\n"
    job = read(tmp_path, xyza, text, dialect)
    assert [p[:2] for p in millimetres(job)] == [(5, 0), (7, 0)]


@pytest.mark.parametrize("dialect", ["winder", "fanuc"])
def test_second_block_behind_a_semicolon_is_refused(
    tmp_path: Path, xyza: Machine, dialect: str
) -> None:
    with pytest.raises(JobError, match=r"reads as another block: 'Y2\.'"):
        list(read(tmp_path, xyza, "G1 X1. F600.; Y2.\nM30\n", dialect))


@pytest.mark.parametrize(
    ("dialect", "block", "message"),
    [
        ("marlin", "M201 X4000 Y4000 Z200", "M201 is a new setting of steps, limits or jerks"),
        ("marlin", "M204 P4000 T4000", "M204 is a new setting of steps, limits or jerks"),
        ("marlin", "M220 S50", "M220 is a share of every feed"),
        ("linuxcnc", "M68 E0 Q50", "M68 is an analogue output"),
        ("fluidnc", "M67 E0 Q50", "M67 is an analogue output"),
    ],
)
def test_line_of_a_slicer_or_postprocessor_is_refused_with_its_meaning(
    tmp_path: Path, xyza: Machine, dialect: str, block: str, message: str
) -> None:
    with pytest.raises(JobError, match=message):
        list(read(tmp_path, xyza, f"G21\nG90\n{block}\nG1 X5 F600\nM30\n", dialect))


def test_t_behind_an_m_word_of_marlin_is_no_command(tmp_path: Path, xyza: Machine) -> None:
    """Slicers write ``M104 T0 S215``; after G1, T is a word that Marlin drops."""
    text = "M0 Put tool 2 in\nM104 T0 S215\nM109 S215 T0\nG1 X5 F600\nM84 X Y E\nM18\nM2\n"
    job = read(tmp_path, xyza, text, "marlin")
    assert [p[0] for p in millimetres(job)] == [5]
    for line in ("G1 X6 T0", "M106 S255 G1 X6"):
        with pytest.raises(JobError, match="runs only the first command of a line"):
            list(read(tmp_path, xyza, f"G1 X5 F600\n{line}\n", "marlin"))


def test_fanuc_reads_times_of_moves(tmp_path: Path, xyza: Machine) -> None:
    """Posts of rotary axes write G93: 120 a minute is half a second, for every axis."""
    text = "G21 G90 G93\nG1 X1. A3.5 F120.\nG94 X2. F60.\nM30\n"
    for dialect in ("fanuc", "linuxcnc"):
        first, second = moves(read(tmp_path, xyza, text, dialect))
        assert first.feed is not None and first.feed.value == 2.0, dialect
        assert second.feed is not None and second.feed.value == pytest.approx(1e-3), dialect


@pytest.mark.parametrize("dialect", ["grbl", "fluidnc", "linuxcnc"])
@pytest.mark.parametrize("word", ["G28.1", "G92.1"])
def test_axis_words_beside_what_takes_none_are_a_move(
    tmp_path: Path, xyza: Machine, dialect: str, word: str
) -> None:
    """They belong to the motion mode in force, as in rs274 and grbl's gcode.c."""
    job = read(tmp_path, xyza, f"{HEAD}{word} X-1 Y-2\nX2\n{word} G0 Y7\nM30\n", dialect)
    ends = [p[:2] for p in millimetres(job)]
    assert ends == [(5, 0), (-1, -2), (2, -2), (2, 7)]
    assert [m.source.line for m in moves(job)] == [2, 3, 4, 5]


@pytest.mark.parametrize(
    ("block", "ends"),
    [
        ("G92.2 X-1 Y-2\nX0 Y0", [(-1, -2), (0, 0)]),
        ("G92 X0 Y4\nG92.3\nY0", [(5, -4)]),
        ("G92 X0 Y4\nG92.2\nG92.2\nX0 Y0\nG92.3 X1\nY0", [(0, 0), (6, 0), (6, -4)]),
        ("G92 X0 Y4\nG92.1\nG92.3\nX0 Y1", [(0, 1)]),
    ],
)
def test_linuxcnc_keeps_what_g92_has_shifted(
    tmp_path: Path, xyza: Machine, block: str, ends: list[tuple[float, float]]
) -> None:
    """G92.3 restores the last G92, whether G92.2 suspended it or not; G92.1 forgets it."""
    job = read(tmp_path, xyza, f"{HEAD}{block}\nM2\n", "linuxcnc")
    assert [p[:2] for p in millimetres(job)][1:] == [pytest.approx(end) for end in ends]


def test_the_zero_that_g92_1_takes_back_counts_for_its_own_block_on_grbl(
    tmp_path: Path, xyza: Machine
) -> None:
    text = f"{HEAD}G92 X0\nG92.1 X1\nX2\nM2\n"
    there = {d: [p[0] for p in millimetres(read(tmp_path, xyza, text, d))] for d in _BOTH}
    assert there == {"grbl": [5, 6, 2], "linuxcnc": [5, 1, 2]}


_BOTH = ("grbl", "linuxcnc")


def test_a_shift_in_a_folded_subroutine_is_kept_for_g92_3(tmp_path: Path, xyza: Machine) -> None:
    text = "F60 G1 X0\nM98 P2 L50\nG92.2\nG92.3\nX0\nM30\nO2\nX5\nG92 X0\nM99\n"
    job = read(tmp_path, xyza, text, "linuxcnc")
    assert millimetres(job)[-1][0] == pytest.approx(250.0)
    last = [operation for operation, _, _ in job.folded()][-2]
    assert (last.targets[-1] if hasattr(last, "targets") else last.target)[0] == pytest.approx(0.25)


REFUSED = [
    # one word of a kind, and one that takes the axis words
    ("grbl", "G28 G92 X1", "grbl takes one of G28 and G92 in a block|two G words of one kind"),
    ("grbl", "G53 G4 P1", "grbl takes one of G53 and G4 in a block"),
    ("grbl", "M7 M8", "grbl takes one of M7 and M8 in a block"),
    ("linuxcnc", "M7 M8", "linuxcnc takes one of M7 and M8 in a block"),
    ("fluidnc", "M62 P1 M63", "fluidnc takes one of M62 and M63 in a block"),
    ("fluidnc", "M62", "M62 needs the number of its output as P"),
    ("grbl", "G49 X7", "grbl uses the axis words beside G49 for G49, not for a motion"),
    ("grbl", "G80\nG92 X0", "axis words while G80 is in force, which grbl refuses"),
    ("linuxcnc", "G53", "G53 needs axis words, and G0 or G1"),
    # words without use
    ("grbl", "G4 P1\nI5", "I has no use in this block"),
    ("grbl", "G21 R5", "R has no use in this block"),
    ("grbl", "G92 X0 J1", "J has no use in this block"),
    ("grbl", "G1 X9 P1", "P has no use in this block"),
    ("linuxcnc", "G1 X9\nX7 L1", "L has no use in this block"),
    ("linuxcnc", "G92 X1 L1", "L has no use in this block"),
    # numbers
    ("grbl", "N10000001 X7", "N10000001 is beyond 10000000, the most that grbl takes"),
    ("grbl", "T256", "T256 is beyond 255, the most that grbl takes"),
    ("grbl", "M3 S-1", "S-1 must not be negative for grbl"),
    ("linuxcnc", "G1 N7 X9", "linuxcnc takes N7 only at the beginning of a line"),
    ("linuxcnc", "N3. X9", "takes N3. only at the beginning of a line, and without a point"),
    # words unknown to the control
    ("grbl", "G64", "G64 is no word of grbl"),
    ("grbl", "T1 M6 G1 X9", "grbl refuses M6 with its whole line, G1 too"),
    ("grbl", "O100", "grbl has no word O"),
    ("grbl", "G92.2", "unknown word G92.2"),
    ("fluidnc", "G92.3", "unknown word G92.3"),
    # feeds
    ("grbl", "G93\nG1", "in G93 every G1 block needs its own F"),
    ("linuxcnc", "G94\nX7", "G1 moves before any feed F"),
    # arcs
    ("grbl", "G2 X15 I5 P2", "P of an arc is not a number of turns for grbl"),
    ("fanuc", "G2 X15. I5. P2", "P of an arc is not a number of turns for fanuc"),
    ("grbl", "G2 I5", "grbl takes no G2 without axis words"),
    ("grbl", "G2 Z5 I5", "grbl takes no arc without an axis word of X or Y"),
    ("grbl", "G2", "grbl takes no G2 without axis words"),
    ("linuxcnc", "G3", "linuxcnc takes no G3 without axis words"),
    ("grbl", "G2 X5.005 I0.0025 J-20000", "the arc turns by 2.5e-07 rad"),
    ("linuxcnc", "G2 X5.005 I0.0025 J-20000", "the arc turns by 2.5e-07 rad"),
    # lines
    ("grbl", "N" + "0" * 76 + "1 X 7", r"80 characters \(without blanks and comments\); grbl"),
    ("fluidnc", "X7 (" + "a" * 125 + ")", "fluidnc takes 127. Take its comment out"),
    ("fluidnc", "\n(tube)\n%\nX7\n%", "fluidnc ends the file with this %"),
    ("fluidnc", "(a;b) X7", "a semicolon in parentheses ends the line for fluidnc"),
]  # fmt: skip


@pytest.mark.parametrize(("dialect", "block", "message"), REFUSED)
def test_block_that_the_control_refuses_is_refused_with_its_line(
    tmp_path: Path, xyza: Machine, dialect: str, block: str, message: str
) -> None:
    head = HEAD.replace("X5", "X5.")
    with pytest.raises(JobError, match=message) as refused:
        moves(read(tmp_path, xyza, f"{head}{block}\nG0 X1.\nM2\n", dialect))
    assert "\n" not in str(refused.value)
    assert refused.value.place is not None and refused.value.place.line > 2


@pytest.mark.parametrize(
    ("dialect", "block", "x_mm"),
    [
        ("grbl", "X1.25 (" + "a" * 100 + ") ; " + "b" * 200, 1.25),
        ("fluidnc", "G2 X15 I5 P2", 15),
        ("linuxcnc", "G2 X15 I5 P2", 15),
        ("linuxcnc", "(a;b) X7", 7),
        ("grbl", "(a;b) X7", 7),
        ("grbl", "G3 X5 I-5", 5),
    ],
)
def test_block_that_the_control_accepts_is_read(
    tmp_path: Path, xyza: Machine, dialect: str, block: str, x_mm: float
) -> None:
    job = read(tmp_path, xyza, f"{HEAD}{block}\nM2\n", dialect)
    assert millimetres(job)[-1][0] == pytest.approx(x_mm)


def test_m6_of_grbl_is_a_stop_of_what_sends_the_program(tmp_path: Path, xyza: Machine) -> None:
    job = read(tmp_path, xyza, f"{HEAD}N4 T1 M6\nX7\n", "grbl")
    assert any("a.nc:3: grbl itself refuses M6" in warning for warning in job.warnings)
    assert [isinstance(item, Stop) for item in job] == [False, True, False, True]
    assert not any("M6" in w for w in read(tmp_path, xyza, f"{HEAD}M6\nX7\n", "fluidnc").warnings)


@pytest.mark.parametrize(("dialect", "bulge"), [("grbl", 100.0), ("linuxcnc", 100.05)])
def test_grbl_keeps_the_radius_of_the_start(
    tmp_path: Path, xyza: Machine, dialect: str, bulge: float
) -> None:
    """An arc whose ends differ by 0.1 mm in their radius of 100 mm: a circle, or a spiral."""
    job = read(tmp_path, xyza, f"{HEAD}G0 X0\nG2 X200.1 Y0 I100\nM2\n", dialect)
    assert max(p[1] for p in millimetres(job)) == pytest.approx(bulge, abs=0.003)


# --- Marlin ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("G21 G90 G1 X50", r"only the first command of a line \(G21\), and not G90"),
        ("M3 G1 X5", r"only the first command of a line \(M3\), and not G1"),
        ("G1 X10 F600 (see Y20)", "reads the capital letters in parentheses as words"),
        ("M3 (Penetrate)", "reads the capital letters in parentheses as words"),
        ("G1 X10) F600", "reads the capital letters in parentheses as words"),
        ("g1 X5", "reads only capital letters"),
        ("X5 G1", "does not begin with a command"),
        ("\tG1 X5", "has a tab"),
        ("G1\tX5", "has a tab"),
        ("G1 X\t5", "has a tab"),
        ("G+1 X5", "does not begin with a command"),
        ("G21 F50", "does not read F50 beside G21"),
        ("G90 X5", "axis words without a G word"),
        ("G2 X15 Y0 I5 J0 P2", "P of an arc is not a number of turns for marlin"),
        ("M502", "M502 is a new setting of steps, limits or jerks"),
        ("M420 S1", "M420 is the compensation of the bed"),
        ("M810", "M810 is a macro"),
        ("G20", "INCH_MODE_SUPPORT; otherwise all numbers stay millimetres"),
        ("G18", "CNC_WORKSPACE_PLANES"),
        ("G92.1", "CNC_COORDINATE_SYSTEMS"),
        ("G5 X9 Y0 I1 J1 P1 Q1", "BEZIER_CURVE_SUPPORT"),
        ("G1 X1" + " " * 90 + "Y1", "the line has 97 characters; marlin cuts it off behind 95"),
        ("N1 G1 X5", "has the number N1 and no checksum"),
        ("N1 G1 X5*1", "the checksum of the line is 1 and must be 100"),
        (numbered(2, "G1 X5"), "N2 where marlin waits for N1"),
        (numbered(1, "G1 X5") + "\n" + numbered(3, "G1 X6"), "N3 where marlin waits for N2"),
    ],
)  # fmt: skip
def test_line_with_another_meaning_in_marlin_is_refused(
    tmp_path: Path, xyza: Machine, line: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        moves(read(tmp_path, xyza, f"G1 X5 F600\n{line}\nG1 X1\n", "marlin"))


@pytest.mark.parametrize(
    ("line", "dwell_s"),
    [("G4 S60 P200", 60.0), ("G4 P200 S60", 60.0), ("G4 P200", 0.2), ("G4 P150.9", 0.15)],
)
def test_s_goes_over_p_in_a_dwell_of_marlin(
    tmp_path: Path, xyza: Machine, line: str, dwell_s: float
) -> None:
    job = read(tmp_path, xyza, f"G1 X5 F600\n{line}\n", "marlin")
    assert [d.duration_s for d in job if isinstance(d, Dwell)] == [pytest.approx(dwell_s)]


def test_numbered_lines_of_marlin_are_followed(tmp_path: Path, xyza: Machine) -> None:
    lines = [numbered(1, "G1 X5 F600"), numbered(2, "M110 N7"), numbered(8, "G1 X6"), "G1 X7"]
    job = read(tmp_path, xyza, "\n".join(lines), "marlin")
    assert [p[0] for p in millimetres(job)] == [5, 6, 7]
    with pytest.raises(JobError, match="G4 has two times, the second is X2"):
        read(tmp_path, xyza, "G1 X1. F60\nG4 P1 X2.\nM30\n", "fanuc")


# --- Klipper ---


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("PRINT_START BED=60", "PRINT_START runs a macro"),
        ("_home", "_HOME runs a macro"),
        ("set_velocity_limit ACCEL=-500", "ACCEL -500 must be a number above 0"),
        ("SET_VELOCITY_LIMIT ACCEL={a}", "ACCEL {A} must be a number above 0"),
        ("SET_VELOCITY_LIMIT MINIMUM_CRUISE_RATIO=1", "1 must be a number from 0, and below 1"),
        ("SET_VELOCITY_LIMIT ACCEL", "klipper cannot read 'ACCEL' of SET_VELOCITY_LIMIT"),
        ("SET_VELOCITY_LIMIT ACCEL_TO_DECEL=5", "ACCEL_TO_DECEL without ACCEL"),
        ("M204 S0", "S 0 must be a number above 0"),
        ("EXCLUDE_OBJECT NAME=a", "EXCLUDE_OBJECT leaves out the moves of an object"),
        ("RESTORE_GCODE_STATE NAME=a", "takes back the zero and the feed"),
        ("M220 S50", "M220 is a share of every feed"),
        ("G20", "G20 is the inch, which klipper refuses"),
        ("G4 S1", "S1 is no word of klipper's G4"),
        ("G2 X15 R5", "klipper takes no arc with R"),
        ("G2 I0", "klipper takes no arc without a centre"),
        ("G91\nG2 X10 I5 J0", "klipper takes no arc while G91 is in force"),
        ("G90 G1 X5", r"only the first command of a line \(G90\), and not G1"),
        ("G1 X9 (see Y20)", "for '\\(' in it"),
        ("(see) G1 Y20", "for '\\(' in it"),
        ("G1 XY9", "for 'XY' in it"),
        ("G+1 X9", "cannot read 'G\\+1 X9' as a command"),
        ("X9", "cannot read 'X9' as a command"),
    ],
)
def test_line_with_another_meaning_in_klipper_is_refused(
    tmp_path: Path, xyza: Machine, line: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        moves(read(tmp_path, xyza, f"G1 X5 F600\n{line}\nG1 X1\n", "klipper"))


@pytest.mark.parametrize("dialect", ["marlin", "klipper"])
def test_a_line_of_parentheses_alone_is_no_command(
    tmp_path: Path, xyza: Machine, dialect: str
) -> None:
    """Neither firmware reads a word of it."""
    text = "(Made of A.svg (@ X99))\nG1 X5 F600\n(end) (of G1 X1)\n (open Y7\nG1 X6\n"
    assert [p[0] for p in millimetres(read(tmp_path, xyza, text, dialect))] == [5, 6]


def test_a_plotter_file_of_unicorn_is_read_for_marlin(tmp_path: Path, xyza: Machine) -> None:
    """Its comments are in parentheses, and it lifts the pen by M300, at which grbl stops."""
    text = (
        "(Scribbled version of C:\\U~1\\ink.svg @ 3500)\n"
        '( unicorn.py --tab="plotter" --x-home=0 )\n'
        "G21 (metric ftw)\nG90 (absolute mode)\nG92 X0.00 Y0.00 Z0.00 (you are here)\n"
        "M300 S30 (pen down)\nG4 P150 (wait 150ms)\nM18 (disengage drives)\n"
        "M01 (Was registration test successful?)\n"
        "M17 (engage drives if YES, and continue)\nG1 X35 Y19 F3500.00\n"
        "G1 Z0.00 F100.0(Penetrate)\nM300 S50.00 (pen up)\n(end of print job)\n"
    )
    job = read(tmp_path, xyza, text, "marlin")
    assert [tuple(p[:2]) for p in millimetres(job)] == [(35, 19), (35, 19)]
    assert [d.duration_s for d in job if isinstance(d, Dwell)] == [pytest.approx(0.15)]
    with pytest.raises(JobError, match=r"M300 is no word of grbl.*M3 S\.\.\. and M5"):
        read(tmp_path, xyza, text, "grbl")


def test_klipper_passes_over_the_limits_that_slicers_set_for_marlin(
    tmp_path: Path, xyza: Machine
) -> None:
    text = "M201 X3000 Y3000 Z100\nM203 X300 Y300\nM205 X8 Y8\nM92 X80\nG1 X5 F600\n"
    job = read(tmp_path, xyza, text, "klipper")
    assert [p[0] for p in millimetres(job)] == [5]
    assert "M201 (line 1)" in "".join(job.warnings)


def test_klipper_reads_small_letters_and_passes_numbers_and_checksums_over(
    tmp_path: Path, xyza: Machine
) -> None:
    """From ``gcode.py``; before the first F the feed is the 25 mm/s of ``gcode_move.py``."""
    text = "g1 x5\nn9 G0 X6*1\nN3 g1 X7 f600 ; (Y9\nG4 P150.9\nm117 G1 X99\nG28 y\nG1 X8\n"
    job = read(tmp_path, xyza, text, "klipper")
    assert [p[0] for p in millimetres(job)] == [5, 6, 7, 7, 8]
    feeds = [move.feed.value for move in job if isinstance(move, Move) and move.feed]
    assert feeds[:3] == pytest.approx([0.025, 0.025, 0.01])
    assert [d.duration_s for d in job if isinstance(d, Dwell)] == [pytest.approx(0.1509)]


# --- RepRapFirmware ---


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("if move.axes[0].homed", "if is a meta command of reprapfirmware"),
        ("  while iterations < 3", "while is a meta command"),
        ("var a=1", "var is a meta command"),
        ('echo >"a.g" "G1 X5"', "echo is a meta command"),
        ("G1 X{1+1}", "expressions in braces are not read"),
        ("G1 X9 (see Y20)", "letters in parentheses as words, unless M453"),
        ("G1 'a9", "an apostrophe names an axis with a small letter"),
        ("G1 X9 G 1 Y2", "answers to 'G 1 Y2' with an error"),
        ("X9", "answers to 'X9' with an error"),
        ("N 5 G1 X9", "answers to '5 ' with an error"),
        ("PRINT_START", "answers to 'PRINT_START' with an error"),
        ("G1 X9 T0", "ignores T behind G1"),
        ("G90 X9", "axis words without a G word"),
        ("G90 F50 G1 X9", "does not read F50 beside G90"),
        ("N5 G1 X9*1", "the checksum of the line is 1 and must be 108"),
        ("G1 X9" + " " * 250 + "Y1", "the line has 257 characters; reprapfirmware takes 255"),
        ("G1 X9 M0 G1 X8", "a block after the end of a program is never run"),
        ("M2", "a block after the end of a program is never run"),
        ('M98 P"home.g"', "M98 is a macro file"),
        ("M121", "restores the feed and modes"),
        ("M204 P500", "M204 is a new setting of steps, limits"),
        ("M220 S50", "M220 is a share of every feed"),
        ("G20", "scales the words of turning axes, too"),
        ("G1 H1 X9", "H1 is a move to an endstop"),
        ("M8", "runs a macro file of this name"),
        ('M42 P"out1" S1', "the text in quotes beside M42 is not read"),
    ],
)  # fmt: skip
def test_line_with_another_meaning_in_reprapfirmware_is_refused(
    tmp_path: Path, xyza: Machine, line: str, message: str
) -> None:
    with pytest.raises(InputError, match=message) as refused:
        moves(read(tmp_path, xyza, f"G1 X5 F600\n{line}\nG1 X1\n", "reprapfirmware"))
    assert "\n" not in str(refused.value)


def test_reprapfirmware_runs_every_command_of_a_line(tmp_path: Path, xyza: Machine) -> None:
    """``StringParser.cpp``: each in its order; after M42, P and S are words of M42."""
    text = (
        "g21 G90g1x5\nn9 G0 X6 m42 P1 S1 G91 G1 X1 F600 ; (Y9\n"
        f"{numbered(4, 'G4 P150.9 G4 S2 P7')}\n  G90 G2 X9 R1 M117 (G1 X99\n"
        'M117 "a;b" G1 X10\nT0 M104 T0 S9 M226 G1 X11\necho "G1 X99"\nN12\nG1 X12 M0\n'
    )
    job = read(tmp_path, xyza, text, "reprapfirmware")
    ends = {move.source.line: move.target[0] * 1e3 for move in moves(job)}
    assert ends == pytest.approx({1: 5, 2: 7, 4: 9, 5: 10, 6: 11, 9: 12})
    first, second, third = moves(job)[:3]
    assert [move.feed.value for move in (first, second, third) if move.feed] == pytest.approx(
        [0.05, 0.05, 0.01]  # DefaultFeedRate, 3000 mm/min, before the first F
    )
    assert [act.words for act in third.acts] == ["M42 P1 S1"] and third.source.line == 2
    assert [d.duration_s for d in job if isinstance(d, Dwell)] == pytest.approx([0.15, 2.0])
    stops = [(stop.final, stop.source.line) for stop in job if isinstance(stop, Stop)]
    assert stops == [(False, 6), (True, 9)]


def test_a_long_program_of_reprapfirmware_has_every_command(tmp_path: Path, xyza: Machine) -> None:
    """Also beyond the first lines, which the plain reader reads."""
    lines = [f"G1 X{k}" + (f" G1 Y{k}" if k % 7 == 0 else "") for k in range(600)]
    job = read(tmp_path, xyza, "\n".join(["G1 F600", *lines]), "reprapfirmware")
    ends = [(round(x), round(y)) for x, y, *_ in millimetres(job)]
    expected = []
    for k in range(600):
        expected.append((k, expected[-1][1] if expected else 0))
        if k % 7 == 0:
            expected.append((k, k))
    assert ends == expected


# --- FluidNC --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("#</axes/x/steps_per_mm>=160", "is an item of the control's configuration"),
        ("#1=#</axes/x/steps_per_mm>", "is an item of the control's configuration"),
        ("#1=EXISTS[#</axes/x/steps_per_mm>]", "is an item of the control's configuration"),
        ("G1 Y[#5420]", "parameter #5420 is where the motors are at the instant"),
        ("G1 Y#<_x>", "parameter #<_x> is where the motors are at the instant"),
    ],
)
def test_line_that_fluidnc_executes_itself_is_refused(
    tmp_path: Path, xyza: Machine, line: str, message: str
) -> None:
    with pytest.raises(JobError, match=message):
        moves(read(tmp_path, xyza, f"G21\nG1 X20 F60\n{line}\nG1 X1\n", "fluidnc"))


def test_linuxcnc_reads_the_position_of_the_program(tmp_path: Path, xyza: Machine) -> None:
    text = "G21\nG1 X20 F60\n#</a/b>=2\nG1 Y[#5420+#<_x>+#</a/b>]\nM2\n"
    assert millimetres(read(tmp_path, xyza, text, "linuxcnc"))[-1][1] == 42


# --- the compiled reader --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "dialect", ["grbl", "fluidnc", "linuxcnc", "marlin", "klipper", "reprapfirmware"]
)
def test_the_compiled_reader_has_the_same_grammar(
    tmp_path: Path, xyza: Machine, dialect: str
) -> None:
    """For random lines, odd ones among them: the same operations, or the same error."""
    taken = 0
    for seed in range(60):
        made = {
            "marlin": random_commands, "klipper": partial(random_commands, klipper=True),
            "reprapfirmware": partial(random_commands, klipper=True),
        }.get(dialect, random_blocks)  # fmt: skip
        text = "\n".join([*made(seed, 0.1), *(["M2"] if dialect == "linuxcnc" else [])])

        def outcome(plain: bool, text: str = text) -> list[object]:
            usual = PlainReader.worth_trying
            with patch.object(PlainReader, "worth_trying", usual if plain else lambda _: False):
                try:
                    return list(read(tmp_path, xyza, text, dialect))
                except InputError as error:
                    return [str(error)]

        first, second = outcome(plain=True), outcome(plain=False)
        assert first == second, text
        taken += len(first) > 1
    assert taken > 15


def test_fluidnc_takes_a_first_percent_behind_empty_lines(tmp_path: Path, xyza: Machine) -> None:
    """If a comment stands before it, the file ends there (``InputFile.cpp``)."""
    job = read(tmp_path, xyza, "\n\n%\nG0 X1\n%\n", "fluidnc")
    assert [p[0] for p in millimetres(job)] == [1]
    with pytest.raises(InputError, match="nc:2: fluidnc ends the file with this %"):
        read(tmp_path, xyza, "(tube)\n%\nG0 X1\n%\n", "fluidnc")
    with pytest.raises(InputError, match="nc:2: fluidnc ends the file with this %"):
        read(tmp_path, xyza, "(tube)\n%\n#31=1\nG0 X#31\n%\n", "fluidnc")


def test_a_percent_is_an_error_of_grbl_and_said(tmp_path: Path, xyza: Machine) -> None:
    """``protocol.c`` does not handle it, and ``gcode.c`` waits for a letter."""
    job = read(tmp_path, xyza, "(tube)\n%\nG0 X1\n%\n", "grbl")
    assert [p[0] for p in millimetres(job)] == [1]
    (warning,) = job.warnings
    assert "a.nc:2: grbl answers error:1 to a line with %" in warning
    assert not read(tmp_path, xyza, "%\nG0 X1\nM2\n%\n", "linuxcnc").warnings


@pytest.mark.parametrize(
    ("dialect", "comment", "letter", "does"),
    [
        ("grbl", "stop!", "'!'", "stops the feed"), ("grbl", "~10 mm", "'~'", "resumes"),
        ("fluidnc", "sure?", "'?'", "asks for a report"), ("grbl", "Käfig Öse", "'Ö'", "stops the"),
        ("grbl", "1 – 2", "'–'", "stops the"), ("fluidnc", "5\u00a0mm", "'\\xa0'", "stops the"),
        ("grbl", "Käse, 5 µm", "", ""), ("fluidnc", "Öse – 2", "", ""), ("marlin", "stop!", "", ""),
        ("linuxcnc", "stop! ~ ?", "", ""),
    ],
)  # fmt: skip
def test_letters_that_act_as_they_are_sent_are_said(
    tmp_path: Path, xyza: Machine, dialect: str, comment: str, letter: str, does: str
) -> None:
    """grbl picks them out of the serial stream (``serial.c``), FluidNC even in UTF-8."""
    text = f"G0 X1\nG0 X2 ; {comment}\nG0 X3\n" + ("M2\n" if dialect == "linuxcnc" else "")
    messages = [
        w for w in read(tmp_path, xyza, text, dialect).warnings if "as soon as it is sent" in w
    ]
    assert len(messages) == bool(letter)
    assert not letter or f"a.nc:2: {dialect} acts on {letter} " in messages[0]
    assert not letter or f"it {does}" in messages[0]


def test_a_3d_print_is_refused_as_one(tmp_path: Path, xyza: Machine) -> None:
    for line in ("G1 X7 E1.2", "G92 E0", "G1 E-5 F1800"):
        with pytest.raises(JobError, match=r"nc:2: E\S+ is the filament of a 3D print") as refused:
            read(tmp_path, xyza, f"G1 X1 F600\n{line}\n", "marlin")
        assert "(--axes E=none): the way of the head alone is then planned" in str(refused.value)


def test_marlin_sets_the_place_of_an_axis_by_g92_9(tmp_path: Path, xyza: Machine) -> None:
    """The place gets this number; later numbers count from there. After G92 it is refused."""
    text = "G21\nG90\nG1 A700 F600\nG92.9 A340\nG1 A350\n"
    assert [round(p[3]) for p in millimetres(read(tmp_path, xyza, text, "marlin"))] == [700, 710]
    with pytest.raises(JobError, match=r"G92\.9 behind a G92 of the same axis"):
        list(read(tmp_path, xyza, f"{text}G92 A0\nG92.9 A1\n", "marlin"))
    with pytest.raises(JobError, match=r"G92\.9 names no axis"):
        read(tmp_path, xyza, f"{text}G92.9\n", "marlin")
