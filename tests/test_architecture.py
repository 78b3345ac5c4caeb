"""The page on the architecture names every room, in the order of the import contract."""

from __future__ import annotations

import ast
import configparser
import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_rooms_stand_in_their_order() -> None:
    """The table goes from the lowest layer up; the contract has the same layers from the top."""
    contracts = configparser.ConfigParser()
    contracts.read(ROOT / ".importlinter")
    layers = contracts["importlinter:contract:layers"]["layers"].split("\n")
    expected = [set(re.findall(r"\w+", layer)) for layer in reversed(layers) if layer.strip()]

    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    page = page.partition("## Kinds of work")[0]
    rows = [re.findall(r"`(\w+)/?`", cell) for cell in re.findall(r"^\| (`.*?) \|", page, re.M)]

    assert [set(row) for row in rows] == expected


def test_tests_stand_in_the_folder_of_their_room() -> None:
    """CONTRIBUTING names the other folders."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    _, _, others = text.partition("A folder of `tests/` has the name of its room.")
    rooms = {room.name for room in (ROOT / "src" / "threadline").iterdir()}
    folders = {file.parent.name for file in (ROOT / "tests").glob("*/__init__.py")}
    assert folders - rooms == set(re.findall(r"`(\w+)/`", others.partition("\n\n")[0]))


def test_a_file_name_stands_for_one_thing() -> None:
    """The page names all file names that several rooms share, and no others."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    section = page.partition("## File names")[2].partition("\n## ")[0]
    stems = Counter(f.stem for f in (ROOT / "src" / "threadline").rglob("*.py") if f.stem[0] != "_")
    assert {stem for stem, times in stems.items() if times > 1} == set(
        re.findall(r"`(\w+)`", section)
    )


KINDS = {"TickTable", "SwitchSchedule", "StepPlay", "Motion", "Scheduled", "Stitched"}
"""Classes of commands and of intents, one of each for each kind of work."""
PARTS = {"cylinders", "shaft"}
"""Parts of a machine that only one kind has."""
MACHINE_PARTS = {"plc", "tables"}
"""The same where other things than machines have parts of these names, too."""


def names_in(node: ast.AST) -> set[str]:
    """Return the names and attributes in an expression."""
    found = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
    return found | {n.attr for n in ast.walk(node) if isinstance(n, ast.Attribute)}


def asks(text: str) -> list[int]:
    """Return the lines of a module that depend on the kind of work.

    These are tests of a kind's class, uses of a kind's part of a machine, and comparisons with
    ``commanded_by`` or with the class of a kind. A choice from a table by the kind is allowed. A
    contract of the linter forbids comparing rows of the table, because nobody else can import them.
    """
    found = []
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Call(func=ast.Name(id="isinstance" | "issubclass"), args=[_, classes]):
                asked = bool(names_in(classes) & KINDS)
            case ast.Attribute(value=ast.Name(id=owner) | ast.Attribute(attr=owner), attr=name) if (
                name in MACHINE_PARTS
            ):
                asked = owner.endswith("machine")
            case ast.Attribute(attr=name):
                asked = name in PARTS
            case ast.Compare():
                asked = bool(names_in(node) & (KINDS | {"commanded_by"}))
            case ast.Match(subject=subject):
                asked = "commanded_by" in names_in(subject)
            case ast.MatchClass(cls=cls):
                asked = bool(names_in(cls) & KINDS)
            case _:
                asked = False
        if asked:
            found.append(getattr(node, "lineno", 0))
    return found


def test_only_the_rooms_of_a_kind_ask_which_it_is() -> None:
    """The page lists these rooms; no line outside depends on the kind, and each room exists."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = page[page.index("| files of a kind |") :].split("\n\n")[0]
    rooms = re.findall(r"`([\w/.]+)`", "\n".join(r.split("|")[1] for r in table.split("\n")[2:]))
    source = ROOT / "src" / "threadline"
    assert len(rooms) > 5
    assert [room for room in rooms if not (source / room).exists()] == []

    own = tuple(str(source / room) for room in rooms)
    files = [file for file in source.rglob("*.py") if not str(file).startswith(own)]
    found = [
        f"{file.relative_to(source)}:{number}"
        for file in files
        for number in asks(file.read_text(encoding="utf-8"))
    ]
    assert found == []


def test_the_count_sees_the_usual_ways_to_ask() -> None:
    """There is one example of each; a choice from a table does not count."""
    for text in (
        "if isinstance(plan.commands, targets.TickTable | SwitchSchedule): pass",
        "if machine.cylinders: pass",
        "if self._machine.plc is None: pass",
        "if type(plan.intent) is Motion: pass",
        "if machine.commanded_by == 'ticks': pass",
        "match machine.commanded_by:\n    case 'ticks': pass",
        "match plan.intent:\n    case Motion(): pass",
    ):
        assert asks(text), text
    assert asks("kind = KINDS[machine.commanded_by]\nif kind.cuts: pass") == []
    assert asks("name = plan.motion.name") == []
    assert asks("rows = found.tables") == []
    assert asks("found = REPORTS[type(plan.intent)]") == []


def test_a_report_draws_and_simulates_nothing() -> None:
    """It knows only the proof of the pipeline; a contract forbids it to import a twin."""
    taken = set()
    for file in (ROOT / "src" / "threadline" / "report").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module == "threadline.proof.pipeline":
                taken |= {name.name for name in node.names}
    assert taken == {"Proof"}


_POSSESSIVE_GROUP = re.compile(r"\)(?:[*+?]|\{\d*,?\d*\})\+|\(\?>")


def test_no_pattern_has_a_possessive_group() -> None:
    """Python 3.11.0 to 3.11.4 accept a partial match of such a group (gh-106052).

    There the block ``X1 Y`` was read as ``X1``, and its ``Y`` without a number was lost.
    """
    assert _POSSESSIVE_GROUP.search(r"(?:[A-Z]\d++)*+")
    assert [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in sorted((ROOT / "src" / "threadline").rglob("*.py"))
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if _POSSESSIVE_GROUP.search(line)
    ] == []
