"""Whatever names jobs, machines and steps have: every output stays the same program.

An independent reader reads each target: blark for structured text, an XML parser, LinuxCNC's
interpreter, an HTML parser, TOML's reader.
"""

from __future__ import annotations

import json
import re
import shutil
import tomllib
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from tests.commands.plc.parts import read_in_parts
from tests.commands.plc.reading import code_of
from tests.jobs.controls_themselves import interpreted
from threadline.base.wording import json_line, nc_comment, plain, st_comment, toml_string
from threadline.commands.intents import Scheduled
from threadline.commands.nc import part_program_lines
from threadline.commands.plcopen import plcopen_xml
from threadline.commands.schedule import compile_schedule
from threadline.commands.schedule_options import shaping_of
from threadline.commands.structured_text import structured_text
from threadline.files import Stream, TickTable, tick_table
from threadline.files.formats import read_table
from threadline.files.formats.tick_table import write_table_csv, write_table_npz
from threadline.jobs import read_job
from threadline.jobs.operations import Move
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.report.document import Document, Table
from threadline.report.publish import write_document
from threadline.report.style import figure_style

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
HOSTILE = [
    "a *) x_right := TRUE; (* b",
    "***)))",
    "(*",
    "/* // *",
    "{attribute 'qualified_only'}",
    "' := TRUE; '",
    'a" b',
    "$x^$",
    "$ $$ \\$",
    "$\\frac{",
    "[/b][red]",
    "</title><script>alert(1)</script>",
    "<![CDATA[ ]]> &amp; --> <?x?>",
    "a\nb\rc\x0bd\x85e\u2028f",
    "\x00\x1b[2J\x7f\x9b",
    "a) M3 S9999 (MSG, stop) ; #1=2",
    "% \n%",
    "K\u00e4fig \u7e54\u6a5f \U0001f600",
    "\u202egrp.txt",
    "END_FUNCTION_BLOCK",
    "{{ 7 * 7 }}{% raw %}",
    "# end: 3",
]
EVERY = pytest.mark.parametrize("text", HOSTILE)
XHTML = "{http://www.w3.org/1999/xhtml}p"


@cache
def _scheduled() -> Scheduled:
    machine = load_machine("letter-placer")
    job = read_job(EXAMPLES / "letter-cycle.toml", machine)
    return compile_schedule(job, machine, shaping_of(machine, "um-zv"))


def _called(text: str) -> Scheduled:
    made = _scheduled()
    return replace(
        made, job=replace(made.job, name=text), machine=replace(made.machine, name=text, title=text)
    )


def _without_comments(text: str) -> str:
    """Remove comments by the rules of the third edition: nested, and of three kinds."""
    code, depth, at = [], 0, 0
    while at < len(text):
        two = text[at : at + 2]
        assert depth or two not in {"//", "/*", "*)"}, text[at : at + 40]
        if two == "(*":
            depth, at = depth + 1, at + 2
        elif depth and two == "*)":
            depth, at = depth - 1, at + 2
        else:
            code.append("" if depth else text[at])
            at += 1
    assert depth == 0
    return "".join(code)


@cache
def _benign() -> tuple[str, list[list[str]]]:
    """The code of the harmless program, and blark's reading of each of its units."""
    text = structured_text(_called("benign")).units
    units = read_in_parts(text).values()
    return _without_comments(text).lower(), [code_of(unit).lines for unit in units]


@EVERY
def test_structured_text_is_the_same_program(text: str) -> None:
    """Only the names of its two units differ, which are made of that text; blark agrees."""
    made = structured_text(_called(text)).units
    assert made.isascii()
    units = read_in_parts(made)
    first, second = units
    expected, lines = _benign()
    code = _without_comments(made).lower()
    code = re.sub(rf"\b{second}\b", "benign_main", re.sub(rf"\b{first}\b", "benign", code))
    assert code == expected
    assert [code_of(unit).lines for unit in units.values()] == lines


@EVERY
def test_plcopen_is_the_same_project(text: str) -> None:
    root = ET.fromstring(plcopen_xml(_called(text)))
    expected = ET.fromstring(plcopen_xml(_called("benign")))
    assert [e.tag for e in root.iter()] == [e.tag for e in expected.iter()]
    ours, theirs = (
        [e.text for e in tree.iterfind(f".//{{*}}ST/{XHTML}")] for tree in (root, expected)
    )
    assert len(ours) == 2
    assert ours == theirs
    (head,) = root.iterfind("{*}contentHeader")
    assert head.get("name") == plain(text)


@EVERY
def test_a_comment_of_a_part_program_is_none_of_its_words(text: str) -> None:
    message = nc_comment(text)
    assert message.isascii()
    assert message.isprintable()
    assert not set(message) & set("();%#")


@pytest.mark.linuxcnc
def test_linuxcnc_takes_no_word_of_a_comment(tmp_path: Path) -> None:
    rs274 = shutil.which("rs274")
    if rs274 is None:
        pytest.skip("rs274 (Debian's linuxcnc-uspace) is not installed")
    machine = load_machine("lathe-winder")
    job = read_job(EXAMPLES / "x-180.prg", machine)

    def moves(name: str, tags: list[str]) -> list[str]:
        named = [
            replace(op, tags=dict.fromkeys(tags, 1.0)) if isinstance(op, Move) else op for op in job
        ]
        other = replace(job, operations=Stream.of(named))
        program = "\n".join(part_program_lines(other, machine, style="linuxcnc")) + "\n"
        (tmp_path / name).write_text(program, encoding="utf-8")
        output = interpreted(rs274, tmp_path / name)
        assert "PROGRAM_END" in output
        # The line number, the call, and the message without the text of comments.
        calls = re.findall(r"\b([A-Z_]+\([^\"]*?\))$", output, re.M)
        return [call for call in calls if not call.startswith(("COMMENT", "MESSAGE"))]

    expected = moves("plain.ngc", [])
    assert len(expected) > 5
    for text in HOSTILE:
        assert moves("hostile.ngc", [text]) == expected


@pytest.fixture(scope="module")
def benign_table(tmp_path_factory: pytest.TempPathFactory) -> tuple[TickTable, list[str]]:
    """Commands, and the lines of their file, with the machine's own digest in the head."""
    machine = load_machine("lathe-winder")
    job = read_job(EXAMPLES / "x-180.prg", machine)
    table = tick_table(plan_job(job, machine, Options(interpolation="linear")).commands)
    file = tmp_path_factory.mktemp("table") / "benign.csv"
    write_table_csv(table, file)
    return table, file.read_text(encoding="utf-8").splitlines()


@EVERY
def test_heads_of_tables_stay_heads(
    text: str, tmp_path: Path, benign_table: tuple[TickTable, list[str]]
) -> None:
    """One line for each key, and every cell unchanged, for readers that split at any line break."""
    table, benign = benign_table
    named = replace(table, job_sha256=table.job_sha256, machine_sha256=text[:128])
    write_table_csv(named, tmp_path / "t.csv")
    write_table_npz(named, tmp_path / "t.npz")
    lines = (tmp_path / "t.csv").read_text(encoding="utf-8").splitlines()
    rows = [line for line in lines if not line.startswith("#")]
    assert len(lines) == len(benign)
    assert rows == [line for line in benign if not line.startswith("#")]
    for file in ("t.csv", "t.npz"):
        assert read_table(tmp_path / file).machine_sha256 == text[:128]


@EVERY
def test_json_and_toml_keep_the_text(text: str) -> None:
    line = json_line({"name": text})
    assert len(line.splitlines()) == 1
    assert json.loads(line) == {"name": text}
    assert tomllib.loads(f"name = {toml_string(text)}") == {"name": text}


def test_half_a_pair_is_written_as_an_escape() -> None:
    """File names that are not UTF-8 contain it, and TOML cannot hold it."""
    assert tomllib.loads(f"name = {toml_string(chr(0xDCFF))}") == {"name": "\\udcff"}
    assert json.loads(json_line("\udcff")) == "\udcff"
    assert plain("\udcff") == st_comment("\udcff") == "\\udcff"


class _Tags(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, tuple[str, ...]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, tuple(name for name, _ in attrs)))


def _report(text: str, folder: Path) -> tuple[list[tuple[str, tuple[str, ...]]], str]:
    with figure_style():
        figure = Figure(figsize=(2.4, 1.2))  # inches; drawing takes most of the time
        panel = figure.add_subplot()
        panel.semilogy([0, 1], [1, 100], label=text)
        panel.set_title(text)
        panel.set_xticks([0, 1], ["$x^$", "b"])  # steps and outputs: letters, digits, _ and -
        panel.legend()
        document = Document(
            title=text,
            subtitle=text,
            verdicts=[(text, True)],
            tables=[Table(title=text, header=[text, text], rows=[[text, text]], note=text)],
            figures={"one": figure},
            captions={"one": text},
            facts=[(text, text)],
            warnings=[text],
        )
        page = write_document(document, folder, "r").read_text(encoding="utf-8")
    ET.fromstring((folder / "r-one.svg").read_text(encoding="utf-8"))
    head, _, rest = page.partition("<svg")
    tags = _Tags()
    tags.feed(head + rest.partition("</svg>")[2])
    return tags.found, page


@pytest.fixture(scope="module")
def benign_tags(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, tuple[str, ...]]]:
    return _report("benign", tmp_path_factory.mktemp("benign"))[0]


@EVERY
@pytest.mark.filterwarnings("ignore:Glyph:UserWarning")
def test_reports_show_the_text_and_are_the_same_page(
    text: str, tmp_path: Path, benign_tags: list[tuple[str, tuple[str, ...]]]
) -> None:
    tags, page = _report(text, tmp_path / "hostile")
    assert tags == benign_tags
    assert not set(page) & {"\x00", "\x1b", "\x7f", "\x85", "\x9b", "\u2028", "\u202e"}
    files = sorted(file.name for file in (tmp_path / "hostile").iterdir())
    assert files == ["r-one.png", "r-one.svg", "r.html", "r.pdf"]
