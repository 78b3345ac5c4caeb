"""Move lists (``.toml``): the steps of an on/off machine, as a sequence of ``[[operation]]``.

Each operation has one of the keys ``move``, ``dwell``, ``valve``, ``vacuum``, ``output``,
``wait`` and ``home``. The key ``step`` names a step of the cycle that begins with the operation;
``first_cycle_only`` leaves it out of every cycle but the first.
"""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

from threadline.base.reading import open_binary
from threadline.base.wording import line_in_rows, nearest, toml_fault
from threadline.errors import JobError, Place, UnitError
from threadline.files import Stream
from threadline.jobs.operations import (
    NO_TAGS,
    Dwell,
    Home,
    Job,
    Move,
    Operation,
    SetOutput,
    Source,
    ToolEvent,
    WaitInput,
)
from threadline.machine import Machine
from threadline.units import parse_quantity

TOP_KEYS = ("name", "home", "operation")
OPERATION_KEYS = {
    "move": ("move", "shaper", "levels", "rest", "overlap"),
    "dwell": ("dwell",),
    "valve": ("valve", "on"),
    "vacuum": ("vacuum", "on"),
    "output": ("output", "on"),
    "wait": ("wait", "is", "timeout", "creep"),
    "home": ("home",),
}
"""Allowed keys of each kind of operation, by the key that names the kind."""
FIRST = "first_cycle_only"
ANY_KEYS = ("step", FIRST)
"""Allowed keys of every operation."""
DEFAULT_TIMEOUT_S = 2.0
"""Time after which a missing input is a fault, unless the list gives another time."""
MAX_BYTES = 4 * 1024 * 1024
REST, OVERLAP, NEVER = "rest", "overlap", "never"
"""Tags of a move: the rest in s after its last switching, and whether it may be cut short."""
STEP_EVENT = "step "
"""Prefix of the name of the ``ToolEvent`` at the start of a step."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,39}")
_HEADER = re.compile(r"\s*\[\[\s*operation\s*\]\]")


def read_moves(path: str | Path, *, machine: Machine) -> Job:
    """Return the job of a move list.

    Parameters
    ----------
    path
        Move list to read.
    machine
        Machine with the cylinders, outputs and inputs that the list names.

    Raises
    ------
    JobError
        If the file is not TOML or not a move list for this machine; the error gives the line.
    """
    path = Path(path)
    with open_binary(path) as stream:
        content = b"" if path.is_dir() else stream.read(MAX_BYTES + 1)
    place = Place(str(path))
    if len(content) > MAX_BYTES:
        raise JobError(
            f"the move list has more than {MAX_BYTES} bytes",
            place=place,
            remedy="Is this a move list?",
        )
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise JobError(
            "the file is not UTF-8 text", place=place, remedy="Save it as UTF-8."
        ) from error
    try:
        table = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        what, line = toml_fault(error, text)
        raise JobError(what, place=Place(str(path), line), remedy="Correct that line.") from error
    reader = _Reader(str(path), text, machine)
    operations = reader.operations(table)
    name = table.get("name", path.stem)
    if not isinstance(name, str) or not name:
        reader.refuse('name must be a text, like name = "letter-cycle"', None, "name")
    return Job(
        name=name,
        file=str(path),
        sha256=hashlib.sha256(content).hexdigest(),
        axes=tuple(machine.cylinders),
        start=tuple(0.0 for _ in machine.cylinders),
        operations=Stream.of(operations),
        paced_by="switchings",
        home=reader.home(table, operations),
        once=reader.once,
    )


def repeated(job: Job) -> Job:
    """Return the first cycle of ``job`` followed by a further one, with steps of the same names."""
    first = list(job)
    return replace(job, operations=Stream.of([*first, *first[job.once :]]))


@dataclass(slots=True)
class _Reader:
    """The reader of one file; its text gives the lines for errors."""

    file: str
    text: str
    machine: Machine
    once: int = 0

    def operations(self, table: Mapping[str, Any]) -> list[Operation]:
        if not self.machine.cylinders:
            self.refuse(
                f"machine {self.machine.name!r} has no cylinders to move",
                None,
                "",
                "Move lists are for on/off machines.",
            )
        self._known(table, TOP_KEYS, None)
        rows = table.get("operation")
        if not isinstance(rows, list) or not rows or not all(isinstance(r, dict) for r in rows):
            self.refuse("there are no operations", None, "", "Write [[operation]] tables.")
        operations: list[Operation] = []
        position = dict.fromkeys(self.machine.cylinders, 0.0)
        headers = self._headers()
        for index, row in enumerate(rows):
            self._known(
                row, (*ANY_KEYS, *{k for keys in OPERATION_KEYS.values() for k in keys}), index
            )
            source = Source(self.file, headers[index] if index < len(headers) else 0)
            if "step" in row:
                step = row["step"]
                if not isinstance(step, str) or not _NAME.fullmatch(step):
                    self.refuse(
                        f"step = {step!r} is not a name", index, "step", 'Write it like "lift".'
                    )
                operations.append(ToolEvent(STEP_EVENT + step, 0.0, source))
            operations += self._operation(row, index, source, position)
            if self._flag(row, index, FIRST, False):
                self._check_first(rows, index)
                self.once = len(operations)
        return operations

    def _check_first(self, rows: list[dict[str, Any]], index: int) -> None:
        """Refuse a first-cycle operation that moves, follows others, or has no wait after it."""
        if "move" in rows[index]:
            self.refuse(f"a move belongs to every cycle, it has no {FIRST}", index, FIRST)
        if index and FIRST not in rows[index - 1]:
            self.refuse(
                f"{FIRST} stands behind an operation that every cycle has",
                index,
                FIRST,
                "Put what only the first cycle does at the beginning of the list.",
            )
        next_row = rows[index + 1] if index + 1 < len(rows) else {}
        if not next_row.get(FIRST, False) and "wait" not in next_row:
            self.refuse(
                f"behind the last operation with {FIRST} there is no wait: every further cycle "
                "begins there, and the PLC counts its times from an input",
                index,
                FIRST,
                'Let the next operation wait for an end switch, like wait = "x_is_left".',
            )

    def home(self, table: Mapping[str, Any], operations: list[Operation]) -> tuple[str, ...]:
        """Return the homing order of the cylinders, with every cylinder once; empty without one.

        The key ``home`` at the top of the list, or an operation ``home``, gives the order.
        """
        homed = [operation.axes for operation in operations if isinstance(operation, Home)]
        if "home" in table:
            homed.insert(0, self._order(table["home"], None))
        for order in homed[1:]:
            if order != homed[0]:
                self.refuse(
                    f"the list brings the cylinders home in two orders, {', '.join(homed[0])} and "
                    f"{', '.join(order)}",
                    None,
                    "home",
                    "The way home of the PLC program has one: write the same.",
                )
        return homed[0] if homed else ()

    def _order(self, order: Any, index: int | None) -> tuple[str, ...]:
        """Return the given homing order, which must name every cylinder once."""
        axes = tuple(self.machine.cylinders)
        if sorted(map(str, order if isinstance(order, list) else [])) != sorted(axes):
            shown = json.dumps(order, default=str)[:80]
            example = ", ".join(f'"{axis}"' for axis in reversed(axes))
            self.refuse(
                f"home = {shown} does not name every cylinder once",
                index,
                "home",
                f"Write them in the order in which they are to come back, like home = [{example}].",
            )
        return tuple(order)

    def _operation(
        self, row: Mapping[str, Any], index: int, source: Source, position: dict[str, float]
    ) -> list[Operation]:
        verbs = [verb for verb in OPERATION_KEYS if verb in row]
        if len(verbs) != 1:
            verbs_text = " and ".join(verbs) or "nothing"
            self.refuse(
                f"an operation says {verbs_text}, it must say one thing",
                index,
                verbs[1] if len(verbs) > 1 else "",
                f"Use one of {', '.join(OPERATION_KEYS)}; the rest is another [[operation]].",
            )
        verb = verbs[0]
        self._known(row, (*ANY_KEYS, *OPERATION_KEYS[verb]), index)
        if verb == "move":
            return [self._move(row, index, source, position)]
        if verb == "dwell":
            return [Dwell(self._time(row, index, "dwell"), source)]
        if verb == "wait":
            contacts = [n for n, c in self.machine.contacts.items() if c.kind == "contact"]
            name = self._named(row, index, "wait", contacts, "contact")
            timeout = self._time(row, index, "timeout") if "timeout" in row else DEFAULT_TIMEOUT_S
            value, creep = (self._flag(row, index, key, True) for key in ("is", "creep"))
            return [WaitInput(name, float(value), timeout, source, creep)]
        if verb == "home":
            order = self._order(row["home"], index)
            position.update(dict.fromkeys(order, 0.0))
            return [Home(order, source)]
        kinds = {"valve": "soft-start", "vacuum": "vacuum", "output": "tool"}
        outputs = [n for n, o in self.machine.outputs.items() if o.kind == kinds[verb]]
        name = self._named(row, index, verb, outputs, f"{kinds[verb]} output")
        return [SetOutput(name, float(self._flag(row, index, "on", True)), source)]

    def _move(
        self, row: Mapping[str, Any], index: int, source: Source, position: dict[str, float]
    ) -> Move:
        targets = row["move"]
        if not isinstance(targets, dict) or not targets:
            self.refuse('move must name an axis, like { X = "200 mm" }', index, "move")
        for axis, text in targets.items():
            if axis not in self.machine.cylinders:
                remedy = nearest(axis, self.machine.cylinders)
                self.refuse(f"there is no cylinder {axis[:40]!r}", index, "move", remedy)
            cylinder = self.machine.cylinders[axis]
            stroke = cylinder.stroke.si
            value = self._number(text, cylinder.stroke.unit, index, "move")
            if not 0.0 <= value <= stroke:
                ends = f"0 ... {cylinder.place(stroke)}"
                self.refuse(
                    f"{axis} would move to {cylinder.place(value)} of {ends}",
                    index,
                    "move",
                    "Stay within the stroke.",
                )
            position[axis] = value
        return Move(tuple(position.values()), None, source, self._how(row, index))

    def _how(self, row: Mapping[str, Any], index: int) -> Mapping[str, float | str]:
        """Return the tags that a move gives: shaper or levels, rest and overlap."""
        tags: dict[str, Any] = {k: row[k] for k in ("shaper", "levels") if k in row}
        if len(tags) > 1:
            self.refuse("a move has a shaper or levels, not both", index, "levels")
        if isinstance(tags.get("levels"), dict):
            tags["levels"] = self._each_levels(row, index)
        for key, text in tags.items():
            if not isinstance(text, str) or not text:
                example = {"shaper": "um-zv", "levels": "1 for 180 ms, 0 for 60 ms, 1 for 290 ms"}
                self.refuse(f"{key} = {text!r} is no text", index, key, f'"{example[key]}".')
        if REST in row:
            rest_s = self._number(row[REST], "s", index, REST)
            if not 0.0 <= rest_s <= 86400.0:
                self.refuse(f"{REST} = {row[REST]!r} is not within 0 ... 24 h", index, REST)
            tags[REST] = rest_s
        if not self._flag(row, index, OVERLAP, True):
            tags[OVERLAP] = NEVER
        return tags or NO_TAGS

    def _each_levels(self, row: Mapping[str, Any], index: int) -> str:
        """Return one text with the levels of each cylinder of an operation."""
        for axis, text in row["levels"].items():
            if axis not in row["move"]:
                self.refuse(
                    f"levels are given for {axis[:40]!r}, which this operation does not move",
                    index,
                    "levels",
                    f"It moves {', '.join(row['move'])}.",
                )
            if not isinstance(text, str) or not text or "=" in text or ";" in text:
                self.refuse(f"levels of {axis}: {text!r} is no text of levels", index, "levels")
        return "; ".join(f"{axis}={text}" for axis, text in row["levels"].items())

    def _time(self, row: Mapping[str, Any], index: int, key: str) -> float:
        value = self._number(row[key], "s", index, key)
        is_dwell = key == "dwell"  # a dwell of 0 does nothing; a wait of 0 would be a fault at once
        if not 0.0 <= value <= 86400.0 or (value == 0.0 and not is_dwell):
            range_text = "within 0 ... 24 h" if is_dwell else "more than 0 and at most 24 h"
            self.refuse(f"{key} = {row[key]!r} is not {range_text}", index, key)
        return value

    def _number(self, text: Any, unit: str, index: int, key: str) -> float:
        example = {"m": "120 mm", "rad": "90 deg", "s": "300 ms"}[unit]
        if not isinstance(text, str):
            self.refuse(f"{key}: {text!r} has no unit", index, key, f'Write it like "{example}".')
        try:
            return parse_quantity(text, unit)
        except UnitError as error:
            self.refuse(f"{key}: {error.message}", index, key, error.remedy)

    def _named(
        self, row: Mapping[str, Any], index: int, key: str, known: list[str], kind: str
    ) -> str:
        name = row[key]
        if not isinstance(name, str) or name not in known:
            shown = name[:40] if isinstance(name, str) else name
            self.refuse(f"there is no {kind} {shown!r}", index, key, nearest(str(shown), known))
        return name

    def _flag(self, row: Mapping[str, Any], index: int, key: str, default: bool) -> bool:
        value = row.get(key, default)
        if not isinstance(value, bool):
            self.refuse(f"{key} must be true or false, got {value!r}", index, key)
        return value

    def _known(self, row: Mapping[str, Any], known: tuple[str, ...], index: int | None) -> None:
        for key in row:
            if key not in known:
                self.refuse(f"unknown key {key[:80]!r}", index, key, nearest(key, known))

    def refuse(self, message: str, index: int | None, key: str, remedy: str = "") -> NoReturn:
        line = line_in_rows(self.text, "operation", index, key)
        raise JobError(message, place=Place(self.file, line), remedy=remedy)

    def _headers(self) -> list[int]:
        """Return the lines of all headers in one pass, because a list may have 100 000 headers."""
        lines = enumerate(self.text.splitlines(), start=1)
        return [number for number, line in lines if _HEADER.match(line)]
