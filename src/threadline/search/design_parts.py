"""A redesign in parts: each part makes some of its searches somewhere; merged, they are one answer.

Part i of n has consecutive searches, by their numbers alone. A file holds one part: its record in
the first line, then a line for each search with all its candidates. The record has the hashes of
everything that affects the results, the result of the machine as its file says, and the words of
the command, so that the merge needs no other file. The merge proves the cheapest of all candidates.
"""

from __future__ import annotations

import base64
import hashlib
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from threadline import __version__
from threadline.base.arrays import FloatArray, IntArray
from threadline.base.reading import refuse_special
from threadline.errors import OptionError
from threadline.proof.proof_hash import spec_sha256
from threadline.search.design import Redesign
from threadline.search.design_evaluate import Tried
from threadline.search.design_front import CandidateYield
from threadline.search.design_searches import MOST_SEARCHES, Search
from threadline.search.yield_parts import Part, differing, in_order, part_in, said_in, write_lines
from threadline.search.yield_state import MOST_LINE, NOT_AS_WRITTEN, Lines

FORMAT = "threadline design part 1"
_AGAIN = "Make that part again."
_ENGINES = ("numpy", "scipy", "numba")
_MOST_TRIED = 1 << 22  # candidates of one search


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignRecord:
    """The redesign to which a part belongs.

    Parameters
    ----------
    identity
        Names and values of everything that the results depend on.
    words
        Job, machine and options as typed, by name.
    corners, front, searches
        Options of the redesign, as in ``Requirements``.
    part
        Number of the part, and of all parts.
    """

    identity: Mapping[str, str]
    words: Mapping[str, str | int | float | bool]
    corners: bool
    front: int
    searches: int
    part: Part

    def check_same(self, path: Path, other: DesignRecord, than: str) -> None:
        """Refuse this part, in the file ``path``, if it belongs to another redesign than ``other``.

        Raises
        ------
        OptionError
            If they differ.
        """
        counts = {
            "number of searches": (self.searches, other.searches),
            "number of parts": (self.part.count, other.part.count),
            "number of machines of --front": (self.front, other.front),
            "choice of --corners": (self.corners, other.corners),
        }
        names = differing(self.identity, other.identity, counts)
        if names:
            raise OptionError(
                f"{str(path)!r} belongs to another redesign than {than}: another "
                f"{', '.join(names)}",
                remedy="Give parts of one redesign, made and merged with the same versions and "
                "files.",
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DesignPart:
    """A part that was read from its file."""

    path: Path
    record: DesignRecord
    searches: tuple[Search, ...]


def searches_of(part: Part, searches: int) -> range:
    """Return the numbers of the searches of a part, from 0.

    Raises
    ------
    OptionError
        If there are fewer searches than parts.
    """
    return part.share(searches, "searches", "make more searches (--searches)")


def design_identity(question: Redesign) -> dict[str, str]:
    """Return everything that affects the results of a part."""
    requirements = question.requirements
    settings = repr(
        (question.options, requirements.trials, requirements.smoothing_s, question.evaluator.effort)
    )
    return {
        "job": question.read.sha256,
        "machine": question.machine.sha256,
        "specification": spec_sha256(question.spec),
        "set of options": hashlib.sha256(settings.encode()).hexdigest(),
        "version of threadline": __version__,
        **{f"version of {name}": version(name) for name in _ENGINES},
        "result of the machine as its file says": _known(question),
    }


def _known(question: Redesign) -> str:
    """Return a hash over the bits of the result of the file's machine at its least settings."""
    space, evaluator = question.space, question.evaluator
    point = np.clip(np.zeros((1, len(space.low))), space.low, space.high)
    simulated = evaluator.simulated
    result = evaluator.tried(point, np.zeros(1, dtype=np.int64), beyond=-1.0)
    evaluator.simulated = simulated  # the machine of the file is not counted as a candidate
    bits = result.ratio.tobytes() + result.nominal.tobytes() + "".join(result.binding).encode()
    return hashlib.sha256(bits).hexdigest()


def write_design_part(path: Path, record: DesignRecord, searches: Sequence[Search]) -> None:
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
        "corners": record.corners,
        "front": record.front,
        "searches": record.searches,
        "part": [record.part.number, record.part.count],
    }
    write_lines(path, head, map(_content, searches))


def read_design_parts(paths: Sequence[Path]) -> list[DesignPart]:
    """Return all parts of one redesign, in their order.

    Raises
    ------
    OptionError
        If a part is missing, is there twice, or belongs to another redesign.
    RecordingError
        If a file cannot be read as a part.
    """
    parts = [read_design_part(path) for path in paths]
    for one in parts:
        one.record.check_same(one.path, parts[0].record, f"{str(parts[0].path)!r}")
    return in_order(parts)


def read_design_part(path: Path) -> DesignPart:
    """Return the part in a file.

    Raises
    ------
    OSError
        If the file cannot be opened.
    RecordingError
        If it is not a part of a redesign, was changed, or is cut short.
    """
    refuse_special(path)
    lines = Lines(path, "a part of a redesign", _AGAIN)
    searches: list[Search] = []
    with path.open("rb") as file:
        record = _record(lines.content(file.readline(MOST_LINE), 1), lines)
        numbers, line = searches_of(record.part, record.searches), 1
        while text := file.readline(MOST_LINE):
            line += 1
            if not text.endswith(b"\n"):
                lines.refuse("its last line is cut short", line)
            if len(searches) == len(numbers):
                lines.refuse("it has more searches than its part", line)
            content = lines.content(text, line)
            searches.append(_search(content, numbers[len(searches)], record, lines, line))
    if len(searches) < len(numbers):
        lines.refuse(
            f"it has {len(searches)} of its {len(numbers)} searches: it is cut short", line
        )
    return DesignPart(path=path, record=record, searches=tuple(searches))


def _record(content: Mapping[str, Any], lines: Lines) -> DesignRecord:
    identity, words = said_in(content, FORMAT, lines)
    corners, front, searches = (content.get(name) for name in ("corners", "front", "searches"))
    if type(corners) is not bool or type(front) is not int or front < 0:
        lines.refuse("it was changed", 1)
    if type(searches) is not int or not 1 <= searches <= MOST_SEARCHES:
        lines.refuse(f"its number of searches is not from 1 to {MOST_SEARCHES}", 1)
    return DesignRecord(
        identity=identity,
        words=words,
        corners=corners,
        front=front,
        searches=searches,
        part=part_in(content, searches, "searches", lines),
    )


def _content(search: Search) -> dict[str, Any]:
    tried = search.tried
    names = sorted(set(tried.binding))
    binding_indices = np.array([names.index(name) for name in tried.binding], dtype=np.int64)
    return {
        "search": search.number,
        "simulated": search.simulated,
        "candidates": len(tried),
        "dims": tried.points.shape[1],
        "points": _text(tried.points),
        "level": _text(tried.level),
        "ratio": _text(tried.ratio),
        "nominal": _text(tried.nominal),
        "delay": _text(tried.delay),
        "criteria": names,
        "binding": _text(binding_indices),
        "yields": [
            {
                "cost": candidate_yield.cost,
                "factors": dict(candidate_yield.factors),
                "passed": candidate_yield.passed,
                "machines": candidate_yield.machines,
            }
            for candidate_yield in search.yields
        ],
    }


def _search(
    content: Mapping[str, Any], number: int, record: DesignRecord, lines: Lines, line: int
) -> Search:
    try:
        count, dims, simulated = (content[name] for name in ("candidates", "dims", "simulated"))
        if any(type(one) is not int for one in (count, dims, simulated)) or simulated < 0:
            raise ValueError("a number is no whole number")
        if content["search"] != number:
            raise ValueError(f"search {number} should stand here")
        if not 1 <= count <= _MOST_TRIED or not 1 <= dims <= 1000:
            raise ValueError(f"it has {count} candidates")
        names = content["criteria"]
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ValueError("a criterion has no name")
        binding_indices = _whole(content["binding"], count, len(names))
        tried = Tried(
            points=_floats(content["points"], count * dims).reshape(count, dims),
            level=_whole(content["level"], count),
            ratio=_floats(content["ratio"], count),
            nominal=_floats(content["nominal"], count),
            delay=_whole(content["delay"], count),
            binding=tuple(names[k] for k in binding_indices.tolist()),
        )
        yields = tuple(_yield(one, record.front) for one in content["yields"])
    except NOT_AS_WRITTEN as error:
        reason = f": {error}" if type(error) is ValueError else ""
        lines.refuse(f"it was changed{reason}", line)
    return Search(number=number, tried=tried, yields=yields, simulated=simulated)


def _yield(row: Mapping[str, Any], machines: int) -> CandidateYield:
    cost, factors, passed = row["cost"], row["factors"], row["passed"]
    numbers = [cost, *factors.values()]
    if not all(type(one) in (int, float) and math.isfinite(one) for one in numbers):
        raise ValueError("a yield has a cost or a factor that is not a number")
    if row["machines"] != machines or type(passed) is not int or not 0 <= passed <= machines:
        raise ValueError("a yield is of another number of machines")
    return CandidateYield(
        cost=float(cost),
        factors={str(name): float(value) for name, value in factors.items()},
        passed=passed,
        machines=machines,
    )


def _text(values: FloatArray | IntArray) -> str:
    kind = "<f8" if values.dtype == np.float64 else "<i8"
    content = np.ascontiguousarray(values, dtype=kind).tobytes()
    return base64.b64encode(zlib.compress(content, 1)).decode()


def _floats(text: str, count: int) -> FloatArray:
    values = np.frombuffer(_bytes(text, 8 * count), dtype="<f8").astype(np.float64)
    if not np.isfinite(values).all():
        raise ValueError("a number is not finite")
    return values


def _whole(text: str, count: int, limit: int = 1 << 16) -> IntArray:
    values = np.frombuffer(_bytes(text, 8 * count), dtype="<i8").astype(np.int64)
    if ((values < 0) | (values >= limit)).any():
        raise ValueError("a number is out of range")
    return values


def _bytes(text: str, count: int) -> bytes:
    content = zlib.decompressobj().decompress(base64.b64decode(text, validate=True), count + 1)
    if len(content) != count:
        raise ValueError(f"a row has {len(content)} bytes, not {count}")
    return content
