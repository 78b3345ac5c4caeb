"""Bad input: each gets one line with file, line and fault."""

from __future__ import annotations

from pathlib import Path

import pytest

from threadline.errors import BudgetError, InputError, JobError, MachineError, OptionError
from threadline.jobs import Job, read_job, read_part_program
from threadline.machine import load_machine
from threadline.machine.tool import eye_within

MACHINE = load_machine("lathe-winder")


def write(folder: Path, data: str | bytes, name: str = "a.nc") -> Path:
    path = folder / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def refused(path: Path, **options: object) -> str:
    """Return the error of reading a job and going through it; one line without a traceback."""
    with pytest.raises(InputError) as caught:
        list(read_job(path, MACHINE, **options))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def program(*blocks: str) -> str:
    return "\n".join(["G91 G1 F100", *blocks, "M30"]) + "\n"


FILES = [
    (b"", "a.nc: the file is empty"),
    (b"\n\n(only a comment)\n", "a.nc: the file holds no block"),
    ("G91\nX1\n".encode("utf-16"), "a.nc: the file is UTF-16 text. Save it as UTF-8."),
    (b"G91 (Gr\xf6\xdfe)\n", "a.nc:1: byte 0xF6 in column 8 is not UTF-8"),
    (b"G91\n\x7fELF\x02\x01\x00", "a.nc:2: the line holds the control character 0x7F in column 1"),
    (b"G\x001\x00 \x00", "a.nc:1: the line holds the control character 0x00 in column 2"),
    (b"X" * 300_000, "a.nc:1: the line has more than 4096 bytes"),
    (b"G91\n" + b"(" + b"x" * 5000 + b")\nM30\n", "a.nc:2: the line has more than 4096 bytes"),
    ("O1\nG91 G1 F5\nG4 P1\nM30\n", "a.nc:1: O 1 moves nothing"),
    ("%\nO1\nG91 G1 F5 X1\nX", "a.nc:4: 'X': the letter X has no number"),
    ("%\nO1\nG91 G1 F5 X1\nX2\n", "a.nc:4: the % on line 1 opens the program and none closes it"),
    ("G91 G1 F5 X1\nX2\n", "a.nc:2: the program, begun on line 1, has no end: the file may be tr"),
    ("G91 G1 F5 X1\nM30\n%\n", "a.nc:3: this % closes a program that no % has opened"),
    ("%\nG91 G1 F5 X1\nM30\n%\nX5\n", "a.nc:5: a block after the % that ends the file is never r"),
    ("%\nG91 G1 F5 X1\nM30\n%\n%\n", "a.nc:5: this % closes"),
    ("G91 G1 F5 X1\nM30\nX5\n", "a.nc:3: a block after the end of a program is never run"),
]


@pytest.mark.parametrize("separator", ["\x85", "\u2028", "\u2029", "\r"])
@pytest.mark.parametrize("block", ["X1 ; note{}X2", "; note{}X2", "X1 (note{}X2)", "(note){}X2"])
@pytest.mark.parametrize("before", [0, 3000])  # plain blocks, which the compiled reader reads
def test_no_block_is_hidden_behind_a_line_separator(
    tmp_path: Path, separator: str, block: str, before: int
) -> None:
    """An editor shows X2 on a line of its own: it is a block there, or the file is refused."""
    lines = ["X1"] * before + [block.format(separator), "X3"]
    message = refused(write(tmp_path, program(*lines)))
    assert f"a.nc:{before + 2}: the line holds the " in message
    assert "line feed" in message


@pytest.mark.parametrize("end", ["\r\n", "\r\r\n"])
@pytest.mark.parametrize("before", [0, 3000])
def test_carriage_returns_before_a_line_feed_end_a_line(
    tmp_path: Path, end: str, before: int
) -> None:
    """PyCAM's public programs for grbl have such line ends after two conversions for Windows."""
    text = program(*["X1"] * before, "X1 ; note", "X2 Y3 (rest)")
    moves = [
        [
            (item.target, item.source.line)
            for item in read_job(path, MACHINE)
            if hasattr(item, "target")
        ]
        for path in (
            write(tmp_path, text, "plain.nc"),
            write(tmp_path, text.replace("\n", end), "converted.nc"),
        )
    ]
    assert moves[0] == moves[1] and len(moves[0]) == before + 2


BLOCKS = [
    ("X1 (open", "a comment in parentheses is opened and not closed"),
    ("X1 close)", "a comment in parentheses is closed and not opened"),
    ("X1; Y2", "the text after ';' reads as another block: 'Y2'"),
    ("X1; Y2;", "the text after ';' reads as another block: 'Y2'"),
    ("X1;; Y2 (in the printed dialect)", "the text after ';' reads as another block: 'Y2'"),
    ("X1; and home; Y2 A3 ; M30", "the text after ';' reads as another block: 'Y2 A3'"),
    ("X1e400", "'X1e400' has an exponent"),
    ("X 1E5 Y2", "'X 1E5' has an exponent"),
    ("X nan", "'X nan': the letter X has no number"),
    ("Y inf", "'Y inf': the letter Y has no number"),
    ("X" + "9" * 400, "the number of X 999999999999999999999999... is beyond 10^12"),
    ("X0." + "1" * 30, "the number of X 0.1111111111111111111111... has more than 17 decimals"),
    ("X1,5", "'X1,5' has a decimal comma"),
    ("X1.2.3", "'X1.2.3' is not a number"),
    ("X 1 2", "'2' has no letter before it"),
    ("X", "'X': the letter X has no number"),
    ("F0 X1", "feed F 0 must be greater than 0"),
    ("F-5 X1", "feed F -5 must be greater than 0"),
    ("Z5", "Z 5: the machine 'lathe-winder' has no axis Z. Its axes are A, X, Y"),
    ("B5", "B 5: the machine 'lathe-winder' has no axis B"),
    ("U5", "unknown word U5"),
    ("S500", "unknown word S500"),
    ("T1", "unknown word T1"),
    ("G2 X1", "unknown word G2. Known G words are G0 G1 G4"),
    ("G61.1", "unknown word G61.1"),
    ("M8", "unknown word M8"),
    ("M6.5", "unknown word M6.5"),
    ("X1 X2", "the word X stands twice in the block"),
    ("F1 F1 X1", "the word F stands twice in the block"),
    ("G0 G1 X1", "two G words of one kind (motion) in a block"),
    ("G90 G91 X1", "two G words of one kind (distance) in a block"),
    ("M0 M0", "two M words that direct the program"),
    ("N1.5 X1", "N 1.5 must be a whole number"),
    ("N-1 X1", "N -1 must be a whole number"),
    ("X1 P2", "P has no use in this block"),
    ("X1 L2", "L has no use in this block"),
    ("G4", "G4 has no P"),
    ("G4 P-1", "P -1 must not be negative"),
    ("G4 X1 P2", "G4 stands with axis words"),
    ("G28 G1 X1", "G28 and G1 both take the axis words"),
    ("G4 P1 M98", "P could belong to two words"),
    ("M98", "M98 needs the number of a subroutine"),
    ("M98 P1.5", "M98 needs the number of a subroutine"),
    ("M98 P7", "subroutine O 7 does not exist"),
    ("M98 P7 L0", "L 0 calls the subroutine no times"),
    ("M98 P7 L-1", "L -1 must be a whole number"),
    ("#1=5", "'#1=5': parameters and expressions are not read"),
    ("X[1+2]", "'X[1+2]': parameters and expressions are not read"),
    ("/X1", "a line that begins with / is run or left out by a switch of the control"),
    ("O100 sub", "'sub': the letter S has no number"),
    ("$H", "'$H' is a command to grbl's terminal and no part of a program"),
    ("X1 % 5", "'% 5' is not part of this dialect"),
    ("X\xb2", "'X\xb2': the letter X has no number"),
]


@pytest.mark.parametrize(("data", "message"), FILES)
def test_a_bad_file(tmp_path: Path, data: str | bytes, message: str) -> None:
    """Truncated, binary, empty, huge line, wrong encoding."""
    assert f"[JOB] {message}" in refused(write(tmp_path, data))


@pytest.mark.parametrize(("block", "message"), BLOCKS)
def test_a_bad_block(tmp_path: Path, block: str, message: str) -> None:
    """The third line of the program is wrong, and the error says so."""
    text = refused(write(tmp_path, program("X5", block)))
    assert f"a.nc:3: {message}" in text


def test_an_error_late_in_a_file_has_its_line(tmp_path: Path) -> None:
    """The 50 000th line, found before the job returns its first operation."""
    lines = ["G91 G1 F100", *["X1", "X-1"] * 25_000]
    lines[49_999] = "X1 Q5"
    path = write(tmp_path, "\n".join([*lines, "M30"]))
    with pytest.raises(JobError, match=r"a\.nc:50000: unknown word Q5"):
        read_job(path, MACHINE)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G91 G1 X1\nM30\n", "a.nc:1: G1 moves before any feed F"),
        ("G91 F100\nX1\nM30\n", "a.nc:2: axis words before any G0 or G1"),
        ("G91 G93 G1 X1 F5\nX2\nM30\n", "a.nc:2: in G93 every G1 block needs its own F"),
        ("G91 G93 G1 X1 F5\nG94\nX2\nM30\n", "a.nc:3: G1 moves before any feed F"),
        ("G91 G94 G1 X1 F5\nG93\nX2\nM30\n", "a.nc:3: G1 moves before any feed F"),
        ("O5\nX1\nM99\nO1\nM98 P5\nM30\n", "a.nc:2: axis words before any G0 or G1"),
    ],
)
def test_block_without_its_mode_is_refused_on_the_way_through_the_program(
    tmp_path: Path, text: str, message: str
) -> None:
    """Modes carry over calls; going through the job refuses a block without its mode."""
    assert message in refused(write(tmp_path, text))


def test_calls_without_end_or_of_the_wrong_thing(tmp_path: Path) -> None:
    """Recursion, doubled and missing programs, missing M99: each at its line."""
    main = "O1\nG91 G1 F5\nM98 P5\nM30\n"
    cases = {
        "O1\nG91\nG1 X1 F60\nM98 P1\nM30\n": "a.nc:4: O 1 calls itself without end: O 1 -> O 1",
        "O5\nX1\nM98 P5\nM99\n" + main: "a.nc:3: O 5 calls itself without end: O 5 -> O 5",
        "O5\nM98 P6\nM99\nO6\nM98 P5\nM99\n" + main: "O 5 -> O 6 -> O 5",
        "O5\nX1\nM99\nO5\nX1\nM99\n" + main: "a.nc:4: O 5 is defined twice, first on line 1",
        "O5\nX1\n" + main: "a.nc:3: O 5, begun on line 1, has no end before the next program",
        "O5\nX1\nM99\n": "a.nc: the file has subroutines only",
        "O5\nX1\nM30\n" + main: "two main programs end with M30 or M2: O 5 and O 1",
        "G91 G1 F5 X1\nM98 P2\nM30\n": "a.nc:2: subroutine O 2 does not exist",
    }
    for text, message in cases.items():
        assert message in refused(write(tmp_path, text))
    deep = "".join(f"O{k}\nM98 P{k + 1}\nM99\n" for k in range(2, 200))
    text = "O1\nG91 G1 F5 X1\nM98 P2\nM30\n" + deep + "O200\nX1\nM99\n"
    assert "calls are nested more than 99 deep" in refused(write(tmp_path, text))


@pytest.mark.parametrize("passes", [10**9, 10**12])
def test_a_billion_passes_are_refused_unread(tmp_path: Path, passes: int) -> None:
    """5 moves x 10^9 against a budget of 5e8 ticks: refused by multiplication, at the call."""
    text = f"O5\n{'X1' * 1}\n{'X-1' * 1}\nX3\nX-3\nX1\nM99\nO1\nG91 G1 F5\nM98 P5 L{passes}\nM30\n"
    with pytest.raises(BudgetError, match=r"a\.nc:10: .*tick budget is 500000000"):
        read_job(write(tmp_path, text), MACHINE)


def test_nested_passes_multiply(tmp_path: Path) -> None:
    """1000 x 1000 x 100 x 5 moves exceed the budget, 1000 x 1000 x 100 x 3 do not.

    The nest of 99 with L 10^12 each has more moves than a float can express.
    """
    nest = "O1\nG91 G1 F5 X0\nM98 P2 L1000\nM30\nO2\nM98 P3 L1000\nM99\nO3\nM98 P4 L100\nM99\nO4\n"
    with pytest.raises(BudgetError, match="500000002 operations"):
        read_job(write(tmp_path, nest + "X1\n" * 5 + "M99\n"), MACHINE)
    assert isinstance(read_job(write(tmp_path, nest + "X1\n" * 3 + "M99\n"), MACHINE), Job)
    deep = "".join(f"O{k}\nM98 P{k + 1} L1000000000000\nM99\n" for k in range(2, 90))
    text = "O1\nG91 G1 F5 X1\nM98 P2\nM30\n" + deep + "O90\nX1\nM99\n"
    with pytest.raises(BudgetError, match=r"more than 10\^15 operations"):
        read_job(write(tmp_path, text), MACHINE)


def test_a_billion_passes_of_nothing_cost_nothing(tmp_path: Path) -> None:
    """A body that only sets modes is the same after one pass as after 10^9."""
    text = "O1\nM98 P2 L1000000000\nG1 F5 X1\nM30\nO2\nG91\nM99\n"
    assert len(list(read_job(write(tmp_path, text), MACHINE))) == 2


def test_unusual_but_valid_text_is_read(tmp_path: Path) -> None:
    """N out of order, lower case, blanks, tabs, CR LF, byte order mark, DOS end of file."""
    text = "\ufeff%\r\nn30 g91 g1 x 1. f 100 (a ; b)\r\nN 10\tX-.5;\r\n"
    text += "N20 Y +2 ; note\r\n\r\nM30\r\n%\r\n\x1a"
    operations = list(read_job(write(tmp_path, text), MACHINE))
    assert [getattr(op, "target", None) for op in operations] == [
        (0.0, 0.001, 0.0), (0.0, 0.0005, 0.0), (0.0, 0.0005, 0.002), None,
    ]  # fmt: skip


def test_a_file_changed_between_readings_is_refused(tmp_path: Path) -> None:
    """The hash of the job would no longer belong to the operations."""
    path = write(tmp_path, program("X1"))
    job = read_job(path, MACHINE)
    write(tmp_path, program("X1", "X2"))
    with pytest.raises(JobError, match="the file was changed while it was in use"):
        list(job)


def test_other_files_and_options(tmp_path: Path) -> None:
    """Missing file, folder, unknown extension, unknown and contradictory options."""
    assert "cannot read job file" in refused(tmp_path / "none.nc")
    (tmp_path / "folder.nc").mkdir()
    assert "cannot read job file" in refused(tmp_path / "folder.nc")
    assert "'.xyz' is not a format of jobs" in refused(write(tmp_path, program("X1"), "a.xyz"))
    good = write(tmp_path, program("X1"))
    with pytest.raises(OptionError, match="has no option 'speed'"):
        read_job(good, MACHINE, speed=1)
    seam = write(tmp_path, "[stitching]\n", "a.seam.toml")
    of_both = "part programs and axis tables"
    for option, formats in (
        ("feed_mode", of_both),
        ("dialect", "part programs"),
        ("axes", of_both),
    ):
        typed = f"--{option.replace('_', '-')}"
        message = refused(seam, **{option: "grbl"})
        assert f"a.seam.toml is a seam, and {typed} is for {formats}. Leave {typed} out." in message
    with pytest.raises(OptionError, match="F cannot be read as 'fast'"):
        read_job(good, MACHINE, feed_mode="fast")
    with pytest.raises(OptionError, match="base axes go with"):
        read_job(good, MACHINE, feed_mode="base-axes")
    with pytest.raises(OptionError, match="the base axis 'Z' is not one of"):
        read_job(good, MACHINE, feed_mode="base-axes", base_axes=("Z",))


def test_an_axis_named_like_another_word_is_refused(tmp_path: Path) -> None:
    """A machine may call an axis F; a part program cannot."""
    machine = _with_axes(("F", "X"))
    with pytest.raises(MachineError, match=r"the axis F of .* has the letter of another word"):
        read_part_program(write(tmp_path, program("X1")), machine=machine)


def _with_axes(names: tuple[str, ...]):  # type: ignore[no-untyped-def]
    import dataclasses

    axes = dict(zip(names, MACHINE.axes.values(), strict=False))
    tool = eye_within(MACHINE.tool, axes)
    return dataclasses.replace(MACHINE, axes=axes, inputs={}, tool=tool)
