"""Compare the figures of the validation pages with what the program gives now.

    python -m tools.validation --check             every row whose command is quick
    python -m tools.validation --check --long      every row
    python -m tools.validation --check PAGE TEXT   rows of a page (winder) that have a text in them
    python -m tools.validation --write ...         put what the program gives now into the pages

Each of ``docs/validation*.md`` has a table whose last column is the command of the row and, after a
colon, the place of each number of the column *here* in the answer to ``--json``:
``threadline analyse stitcher``: ``axes/X/bandwidth_hz``. A key of a place is

- a key of the answer, or its beginning;
- of an answer with criteria also a criterion, with its axis and step: the most that it measured;
- of a list a number, or the name of one of its tables;
- of a list of texts a text with ``{}`` for the number that is wanted, in the unit of the text.

A place of a list gives all its numbers. Otherwise the unit behind a number says how the SI value is
printed. ``&&`` joins commands, of which the last one answers. A time in brackets marks a row that
takes long. Rows whose command is ``pytest`` are checked by the tests that they name. The exit
status is 1 where a figure, a verdict or a level differs.

A table of records has a bound beside each value, with a command of its own: both are compared.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import json
import re
import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from threadline.cli.main import main as threadline

ROOT = Path(__file__).resolve().parent.parent
NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?: \d{3})*(?:\.\d+)?(?:e-?\d+)?")
UNITS = {
    "mm": 1e3, "um": 1e6, "ms": 1e3, "us": 1e6, "%": 1e2, "in": 1 / 0.0254, "in/s2": 1 / 0.0254,
    "mm/s": 1e3, "kHz": 1e-3, "kN": 1e-3, "count/mm": 1e-3, "degrees": 57.29577951308232,
}  # fmt: skip
"""How many of a unit are one of the SI; any other unit, such as deg of a margin, is as answered."""
BETWEEN = re.compile(r"(,| and| to| or|;|)\s*")  # two numbers of one unit
LAST_DIGIT = 0.51  # of a unit of the last digit that is printed: rounding, and its own rounding
NOISE = 1e-9  # what rounding leaves of nothing
COLUMNS = ("claim", "printed", "checked by hand", "here", "level", "command")
RECORDS = ("record", "machine", "here", "level", "bound", "command", "command of the bound")
LEVELS = ("nominal", "repeated", "over tolerances", "drawn machines")


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a page: its line, counted from 1, what it says, and how that is asked for."""

    page: Path
    line: int
    claim: str
    here: str
    level: str
    command: str
    answers: tuple[str, ...]
    takes: str  # how long, empty if it is quick

    @property
    def compared(self) -> bool:
        return not self.command.startswith("pytest ")

    @property
    def numbers(self) -> list[re.Match[str]]:
        return list(NUMBER.finditer(self.here))


def pages() -> list[Path]:
    return sorted((ROOT / "docs").glob("validation*.md"))


def rows_of(page: Path) -> Iterator[Row]:
    """Yield the rows of the tables of a page that have the columns of a validation, or of records.

    A row of records yields its value, and its bound where it has one.

    Raises
    ------
    ValueError
        If a row has no command, or more or fewer cells than the head.
    """
    inside: tuple[str, ...] = ()
    for line, text in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", text)[1:-1]]
        if not text.startswith("|"):
            inside = ()
        elif tuple(cells) in (COLUMNS, RECORDS):
            inside = tuple(cells)
        elif inside and not set(text) <= set("|-: "):
            if len(cells) != len(inside):
                raise ValueError(f"{page.name}:{line}: {len(cells)} cells, not {len(inside)}")
            of = dict(zip(inside, cells, strict=True))
            name = of["claim"] if inside == COLUMNS else f"{of['record']}, {of['machine']}"
            yield _row(page, line, name, of["here"], of["level"], of["command"])
            if of.get("bound", "-") != "-":
                bound = of["bound"], "model", of["command of the bound"]
                yield _row(page, line, f"{name}: bound", *bound)


def _row(page: Path, line: int, claim: str, here: str, level: str, command: str) -> Row:
    """Return a row whose command stands in the cell ``command``."""
    parts = re.fullmatch(r"`([^`]+)`(?:: ((?:`[^`]+`(?:, )?)+))?(?: \((.+)\))?", command)
    if parts is None:
        raise ValueError(f"{page.name}:{line}: no command in {command!r}")
    answers = tuple(re.findall(r"`([^`]+)`", parts[2] or ""))
    return Row(page, line, claim, here, level, parts[1], answers, parts[3] or "")


@cache
def answer(command: str) -> Any:
    """Return what a command answers with ``--json``, run in this process.

    Of several that are joined by ``&&`` all are run, and the last one answers.

    Raises
    ------
    ValueError
        If the command refuses its input.
    """
    before, _, command = command.rpartition(" && ")
    if before:
        answer(before)
    words = shlex.split(command)
    if words[:2] == ["python", "-m"]:
        return importlib.import_module(words[2]).answers(*words[3:])
    output, status = io.StringIO(), 0
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(io.StringIO()) as wrong:
        try:
            threadline([*words[1:], "--json"])
        except SystemExit as stopped:
            status = int(stopped.code or 0)
    if status > 1:
        raise ValueError(f"{command} ends with {status}: {wrong.getvalue().strip()[-300:]}")
    return json.loads(output.getvalue())


def find(said: Any, path: str) -> Any:
    """Return what an answer has at a place, as the head of this file says."""
    for key in path.split("/"):
        if isinstance(said, list) and "{}" in key:
            pattern = re.escape(key).replace(r"\{\}", "([0-9.]*[0-9])")
            said = [float(n) for text in said for n in re.findall(pattern, text)]
        elif isinstance(said, list):
            at = int(key) if key.isdecimal() else [one["name"] for one in said].index(key)
            said = said[at]
        elif key in said:
            said = said[key]
        elif "criteria" in said:
            said = _criterion(said["criteria"], *key.split())
        else:
            (said,) = (said[name] for name in said if name.startswith(key))
    return said


def _criterion(criteria: list[dict[str, Any]], name: str, axis: str = "", step: str = "") -> float:
    """Return the most that a criterion measured, of any axis and step unless they are named."""
    measured = [
        float(one["measured"])
        for one in criteria
        if one["name"] == name
        and axis in ("", one["axis"])
        and step in ("", one.get("step"))
        and one["measured"] is not None
    ]
    if not measured:
        raise ValueError(f"no {name} {axis} {step} was measured")
    return max(measured)


def factors(here: str, numbers: Sequence[re.Match[str]]) -> list[float]:
    """Return how many of the unit behind each number are one of the SI."""
    found: list[float] = []
    for at, number in enumerate(numbers):
        unit = re.match(r" ?([^\s,;)]+)", here[number.end() :])
        own = UNITS.get(unit[1]) if unit else None
        found.append(own or 1.0)
        if own:  # numbers before it that have no unit, such as 1 and 2 of "1, 2 mm", have this one
            for before in range(at - 1, -1, -1):
                between = here[numbers[before].end() : numbers[before + 1].start()]
                if not BETWEEN.fullmatch(between):
                    break
                found[before] = own
    return found


def value_of(text: str) -> tuple[float, float]:
    """Return a printed number, and how far from it a figure that rounds to it can be."""
    digits, _, power = text.replace(" ", "").partition("e")
    last = 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
    return float(text.replace(" ", "")), LAST_DIGIT * last


def figures_of(row: Row) -> list[float]:
    """Return what the program gives now for each number of a row, in the unit of the row."""
    said = answer(row.command)
    values: list[tuple[float, bool]] = []  # numbers of a text have the unit of the text
    for path in row.answers:
        found = find(said, path)
        several = found if isinstance(found, list) else [found]
        values += [(float(value), "{}" in path) for value in several]
    numbers = row.numbers
    if len(values) != len(numbers):
        raise ValueError(f"{len(numbers)} numbers are printed, and {len(values)} answered")
    units = factors(row.here, numbers)
    return [v if of_text else v * f for (v, of_text), f in zip(values, units, strict=True)]


def differences(row: Row) -> list[str]:
    """Return what a row says and the program does not: figures, its verdict, its level."""
    wrong = []
    for number, figure in zip(row.numbers, figures_of(row), strict=True):
        printed, within = value_of(number[0])
        if abs(figure - printed) > max(within, NOISE):
            wrong.append(f"printed {number[0]}, answered {figure:.6g}")
    said = answer(row.command)
    if isinstance(said, dict) and isinstance(said.get("passed"), bool):
        says = {True: "in spec" in row.here, False: "out of spec" in row.here}
        if any(says.values()) and not says[said["passed"]]:
            wrong.append(f"printed {row.here!r}, and passed is {said['passed']}")
        if said.get("level") and said["level"] != row.level:
            wrong.append(f"printed {row.level!r}, and the level is {said['level']!r}")
    return wrong


def rewritten(row: Row) -> str:
    """Return the cell with what the program gives now, to the digits that are printed."""
    made, end = "", 0
    for number, figure in zip(row.numbers, figures_of(row), strict=True):
        printed, within = value_of(number[0])
        if abs(figure - printed) > max(within, NOISE):
            decimals = len(number[0].partition(".")[2])
            text = f"{figure:.{decimals}f}"
        else:
            text = number[0]
        made, end = made + row.here[end : number.start()] + text, number.end()
    return made + row.here[end:]


def main() -> int:
    """Check or write the rows that are asked for, and say what differs."""
    parser = argparse.ArgumentParser(prog="python -m tools.validation", description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare, which is the default")
    parser.add_argument("--write", action="store_true", help="write what differs into the pages")
    parser.add_argument("--long", action="store_true", help="rows that take long, too")
    parser.add_argument("page", nargs="?", default="", help="such as winder; every page without it")
    parser.add_argument("text", nargs="?", default="", help="only rows that have it in them")
    options = parser.parse_args()
    wrong = compared = left = 0
    for page in pages():
        for row in rows_of(page):
            if options.page not in page.name or options.text not in f"{row.claim} {row.command}":
                continue
            if not row.compared or (row.takes and not options.long):
                left += 1
                continue
            compared += 1
            try:
                found = differences(row)
                if found and options.write:
                    lines = page.read_text(encoding="utf-8").split("\n")
                    cell = f"| {row.here} |"
                    lines[row.line - 1] = lines[row.line - 1].replace(cell, f"| {rewritten(row)} |")
                    page.write_text("\n".join(lines), encoding="utf-8")
            except (ValueError, KeyError, IndexError, TypeError) as error:
                found = [f"{type(error).__name__}: {error}"]
            wrong += bool(found)
            for text in found:
                print(f"{page.name}:{row.line}: {row.claim}: {text}", flush=True)
    print(f"{compared} rows compared, {wrong} differ, {left} left out")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
