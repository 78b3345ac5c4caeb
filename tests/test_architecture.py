"""The page on the architecture names every room, in the order that the linter holds."""

from __future__ import annotations

import configparser
import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_rooms_stand_in_their_order() -> None:
    """The table goes down the house; the contract has the same layers, the highest first."""
    contracts = configparser.ConfigParser()
    contracts.read(ROOT / ".importlinter")
    layers = contracts["importlinter:contract:layers"]["layers"].split("\n")
    wanted = [set(re.findall(r"\w+", layer)) for layer in reversed(layers) if layer.strip()]

    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    page = page.partition("## Kinds of work")[0]
    rows = [re.findall(r"`(\w+)/?`", cell) for cell in re.findall(r"^\| (`.*?) \|", page, re.M)]

    assert set(rows[0]) == wanted[0] | wanted[1]  # the ground floor is one row
    assert [set(row) for row in rows[1:]] == wanted[2:]


def test_a_file_name_stands_for_one_thing() -> None:
    """Names that come in several rooms are those that the page names, and no others."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    section = page.partition("## File names")[2].partition("\n## ")[0]
    stems = Counter(f.stem for f in (ROOT / "src" / "threadline").rglob("*.py") if f.stem[0] != "_")
    assert {stem for stem, times in stems.items() if times > 1} == set(
        re.findall(r"`(\w+)`", section)
    )


ASKS = re.compile(
    r"isinstance\([^()]*\b(?:TickTable|SwitchSchedule|StepPlay|Motion|Scheduled|Stitched)\b"
    r"|\.cylinders\b|\b(?:machine|chosen)\.shaft\b"
    r"|\.commanded_by\b\s*(?:==|!=|\bin\b|\bnot in\b)"
    r"|\bmatch\b.*\.commanded_by\b"
)
"""What a line looks like that asks which kind of work it has."""


def test_only_the_rooms_of_a_kind_ask_which_it_is() -> None:
    """The page lists these rooms; outside them no line asks, and each room listed is there."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = page[page.index("| rooms of a kind |") :].split("\n\n")[0]
    rooms = re.findall(r"`([\w/.]+)`", "\n".join(r.split("|")[1] for r in table.split("\n")[2:]))
    source = ROOT / "src" / "threadline"
    assert len(rooms) > 5
    assert [room for room in rooms if not (source / room).exists()] == []

    own = tuple(str(source / room) for room in rooms)
    files = [file for file in source.rglob("*.py") if not str(file).startswith(own)]
    found = [
        f"{file.relative_to(source)}:{number}: {line.strip()}"
        for file in files
        for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), start=1)
        if ASKS.search(line)
    ]
    assert found == []


def test_the_count_sees_every_way_to_ask() -> None:
    """Each room of a kind that exists for its parts has such a line; ordinary lines have none."""
    for line in (
        "if isinstance(plan.commands, TickTable | SwitchSchedule):",
        "if machine.cylinders:",
        "if machine.shaft is None:",
        "if isinstance(plan.intent, Stitched):",
        'elif machine.commanded_by == "ticks":',
        "match machine.commanded_by:",
    ):
        assert ASKS.search(line), line
    assert not ASKS.search("kind = KINDS[machine.commanded_by]")
