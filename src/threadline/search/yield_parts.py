"""A yield in parts: each part is judged somewhere, and all of them are merged into one answer.

Part i of n has consecutive machines of the whole sequence, by their numbers alone. A file holds one
part: its record in the first line, then its machines as in ``yield_state``. The record has the
hashes of everything that affects the results, and the words of the command, so that the merge needs
no other file. Every file must belong to the same yield, and its first machine is judged again.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from threadline.base.reading import refuse_special
from threadline.base.workers import Done
from threadline.base.writing import staged_file
from threadline.errors import OptionError, RecordingError
from threadline.machine.variants import drawn
from threadline.search.machine_yield import AT_ONCE, MachineYield, Yield
from threadline.search.yield_state import (
    MOST_LINE,
    Lines,
    content_of_runs,
    line_of,
    same_first,
    same_rows,
)
from threadline.verdict import EachRun

FORMAT = "threadline yield part 1"
MOST_VARIANTS = 10_000_000
_PART = re.compile(r"([0-9]{1,9})/([0-9]{1,9})")
_NAMED = 8  # largest number of missing parts that an error names
_AGAIN = "Make that part again."


@dataclass(frozen=True, slots=True)
class Part:
    """One of the consecutive parts of a yield.

    Parameters
    ----------
    number, count
        Part ``number`` of ``count``, from 1.
    """

    number: int
    count: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def machines(self, variants: int) -> range:
        """Return the numbers of this part's machines in the sequence of ``variants``, from 0.

        >>> [Part(k, 3).machines(10) for k in (1, 2, 3)]
        [range(0, 3), range(3, 6), range(6, 10)]

        Raises
        ------
        OptionError
            If there are fewer machines than parts.
        """
        return self.share(variants, "machines", "draw more machines (--variants)")

    def share(self, total: int, what: str, more: str) -> range:
        """Return the numbers of this part's items among ``total`` items, from 0.

        Parameters
        ----------
        what, more
            Name of the items, and the advice for getting more of them, for the error.

        Raises
        ------
        OptionError
            If there are fewer items than parts.
        """
        if total < self.count:
            raise OptionError(
                f"--part {self}: {total} {what} are too few for {self.count} parts",
                remedy=f"Make at most {total} parts, or {more}.",
            )
        return range((self.number - 1) * total // self.count, self.number * total // self.count)


def parse_part(text: str) -> Part:
    """Return the part that ``--part`` names, "3/16".

    >>> parse_part("3/16")
    Part(number=3, count=16)

    Raises
    ------
    OptionError
        If it is not a part, or its number is not from 1 to the number of parts.
    """
    match = _PART.fullmatch(text.strip())
    if match is None:
        raise OptionError(
            f"--part {text[:40]!r} is not the number of a part and the number of parts",
            remedy='Write it like "3/16".',
        )
    number, count = int(match[1]), int(match[2])
    if not 1 <= number <= count:
        raise OptionError(
            f"--part {text[:40]!r}: the number of the part must be from 1 to the number of parts",
            remedy=f'Write it like "1/{max(count, 1)}".',
        )
    return Part(number, count)


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """The yield to which a part belongs.

    Parameters
    ----------
    identity
        Names and values of everything that affects the results.
    words
        Job, machine and options as typed, by name.
    seed, variants
        Seed and length of the whole sequence.
    part
        Number of the part, and of all parts.
    """

    identity: Mapping[str, str]
    words: Mapping[str, str | int | float | bool]
    seed: int
    variants: int
    part: Part

    def differences(self, other: Record) -> list[str]:
        """Return the names of the entries that differ from another part's."""
        counts = {
            "seed": (self.seed, other.seed),
            "number of machines": (self.variants, other.variants),
            "number of parts": (self.part.count, other.part.count),
        }
        return differing(self.identity, other.identity, counts)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PartFile:
    """A part that was read from its file.

    Parameters
    ----------
    path
        The file.
    record
        The yield to which it belongs.
    found
        The results of its machines.
    """

    path: Path
    record: Record
    found: EachRun


class _OfPart(Protocol):
    @property
    def part(self) -> Part: ...


class _OnePart(Protocol):
    @property
    def path(self) -> Path: ...

    @property
    def record(self) -> _OfPart: ...


OnePartT = TypeVar("OnePartT", bound=_OnePart)


def write_part(path: Path, record: Record, found: EachRun) -> None:
    """Write a part; the file appears whole on the disk, or not at all.

    Raises
    ------
    OptionError, OSError
        If the file cannot be written.
    """
    head = {
        "format": FORMAT,
        "identity": dict(record.identity),
        "words": dict(record.words),
        "seed": record.seed,
        "variants": record.variants,
        "part": [record.part.number, record.part.count],
    }
    first = record.part.machines(record.variants).start
    batches = (
        content_of_runs(
            found.taken(np.arange(index, min(index + AT_ONCE, found.runs))), first + index
        )
        for index in range(0, found.runs, AT_ONCE)
    )
    write_lines(path, head, batches)


def write_lines(path: Path, head: Mapping[str, Any], contents: Iterable[Mapping[str, Any]]) -> None:
    """Write the first line of a part, and a line for each of its results."""
    with staged_file(path) as file:
        for content in (head, *contents):
            file.write(line_of(content))
        file.flush()
        os.fsync(file.fileno())


def differing(
    own: Mapping[str, str], other: Mapping[str, str], counts: Mapping[str, tuple[int, int]]
) -> list[str]:
    """Return the names of the identities, and of the pairs of counts, that differ."""
    names = [name for name in dict.fromkeys([*other, *own]) if own.get(name) != other.get(name)]
    return [*names, *(name for name, (one, another) in counts.items() if one != another)]


def said_in(
    content: Mapping[str, Any], form: str, lines: Lines
) -> tuple[dict[str, str], dict[str, str | int | float | bool]]:
    """Return identity and words of the first line of a part, whose format must be ``form``."""
    if content.get("format") != form:
        lines.refuse(f"it is not {lines.subject} of this version", 1)
    identity, words = content.get("identity"), content.get("words")
    if not isinstance(identity, dict) or not all(isinstance(v, str) for v in identity.values()):
        lines.refuse("it was changed", 1)
    if not isinstance(words, dict) or not all(
        isinstance(value, str | int | float | bool) for value in words.values()
    ):
        lines.refuse("it was changed", 1)
    return identity, words


def part_in(content: Mapping[str, Any], total: int, what: str, lines: Lines) -> Part:
    """Return which part of ``total`` machines or searches the first line of a part names."""
    part = content.get("part")
    if not isinstance(part, list) or len(part) != 2 or any(type(one) is not int for one in part):
        lines.refuse("it was changed", 1)
    number, count = part
    if not 1 <= number <= count <= total:
        lines.refuse(f"there is no part {number}/{count} of {total} {what}", 1)
    return Part(number, count)


def read_part(path: Path) -> PartFile:
    """Return the part in a file.

    Raises
    ------
    OSError
        If the file cannot be opened.
    RecordingError
        If it is not a part of a yield, was changed, or is cut short.
    """
    refuse_special(path)
    lines = Lines(path, "a part of a yield", _AGAIN)
    batches: list[EachRun] = []
    with path.open("rb") as file:
        record = _record(lines.content(file.readline(MOST_LINE), 1), lines)
        machines = record.part.machines(record.variants)
        next_machine, line = machines.start, 1
        while text := file.readline(MOST_LINE):
            line += 1
            if not text.endswith(b"\n"):
                lines.refuse("its last line is cut short", line)
            batches.append(lines.judged(lines.content(text, line), next_machine, line))
            if not same_rows(batches[-1], batches[0]):
                lines.refuse("it has other criteria than the lines before it", line)
            next_machine += batches[-1].runs
    if next_machine != machines.stop:
        held_words = f"it has {next_machine - machines.start} of its {len(machines)} machines"
        lines.refuse(f"{held_words}: it is cut short", line)
    return PartFile(path=path, record=record, found=EachRun.joined(batches))


def _record(content: Mapping[str, Any], lines: Lines) -> Record:
    identity, words = said_in(content, FORMAT, lines)
    seed, variants = content.get("seed"), content.get("variants")
    if type(seed) is not int or not 0 <= seed < 1 << 64:
        lines.refuse("it has a seed that is not from 0 to 2**64 - 1", 1)
    if type(variants) is not int or not 1 <= variants <= MOST_VARIANTS:
        lines.refuse(f"its number of machines is not from 1 to {MOST_VARIANTS}", 1)
    part = part_in(content, variants, "machines", lines)
    return Record(identity=identity, words=words, seed=seed, variants=variants, part=part)


def read_parts(paths: Sequence[Path]) -> list[PartFile]:
    """Return all parts of one yield, in their order.

    Raises
    ------
    OptionError
        If a part is missing, is there twice, or belongs to another yield.
    RecordingError
        If a file cannot be read as a part.
    """
    parts = [read_part(path) for path in paths]
    first = parts[0]
    for one in parts:
        check_same(one, first.record, f"{str(first.path)!r}")
        if not same_rows(one.found, first.found):
            raise OptionError(
                f"{str(one.path)!r} has other criteria than {str(first.path)!r}", remedy=_AGAIN
            )
    return in_order(parts)


def in_order(parts: Sequence[OnePartT]) -> list[OnePartT]:
    """Return all parts of a yield or of a redesign, in their order.

    Raises
    ------
    OptionError
        If a part is missing, or is there twice.
    """
    by_number: dict[int, OnePartT] = {}
    for part in parts:
        number = part.record.part.number
        if number in by_number:
            raise OptionError(
                f"part {part.record.part} is there twice: {str(by_number[number].path)!r} and "
                f"{str(part.path)!r}",
                remedy="Give each part once.",
            )
        by_number[number] = part
    count = parts[0].record.part.count
    if len(by_number) < count:
        missing = count - len(by_number)
        missing_numbers = (k for k in range(1, count + 1) if k not in by_number)
        named = ", ".join(str(k) for k, _ in zip(missing_numbers, range(_NAMED), strict=False))
        further = f" and {missing - _NAMED} more" if missing > _NAMED else ""
        raise OptionError(
            f"{missing} of {count} parts missing: {named}{further}",
            remedy="Make them, and give the files of all parts.",
        )
    return [by_number[number] for number in sorted(by_number)]


def check_same(one: PartFile, record: Record, than: str) -> None:
    """Refuse a part of another yield than ``record``; ``than`` names the record.

    Raises
    ------
    OptionError
        If they differ.
    """
    if other := one.record.differences(record):
        raise OptionError(
            f"{str(one.path)!r} belongs to another yield than {than}: another {', '.join(other)}",
            remedy="Give parts of one yield, made and merged with the same versions and files.",
        )


def merged(parts: Sequence[PartFile], judged: MachineYield, done: Done | None = None) -> Yield:
    """Return the answer of one run from all parts in their order, the same to the bit.

    The first machine of each part is judged again.

    Raises
    ------
    RecordingError
        If a machine's result is another one here.
    """
    for one in parts:
        record = one.record
        first = record.part.machines(record.variants).start
        again = judged.judged(drawn(judged.plan.machine, record.seed, np.array([first])), done)
        if not same_first(one.found, again):
            raise RecordingError(
                f"part {record.part} in {str(one.path)!r} has other results here: "
                f"its first machine, number {first}, differs",
                remedy="Make that part again on a computer like this one.",
            )
    found = EachRun.joined([one.found for one in parts])
    return Yield(numbers=judged.numbers, found=found, seed=parts[0].record.seed)
