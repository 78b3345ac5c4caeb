"""Differences between a file and its plan, in the form that every reader of ``equal`` gives."""

from __future__ import annotations

import csv
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import Place, RecordingError, ThreadlineError

MOST_BYTES = 1 << 30
"""Bytes of a file, and of a part of an archive, beyond which ``equal`` does not read it."""
_MOST_ROWS = 4000  # of a column of a curve
_FAULTS = (
    ArithmeticError, AttributeError, EOFError, LookupError, MemoryError, OSError, RuntimeError,
    TypeError, ValueError, csv.Error, struct.error, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""Errors that the readers of the standard library and numpy raise at changed or truncated files."""
_TIME_TEXT = re.compile(r"\d{1,30}(/\d{1,30}|(\.\d{1,30})?(e[-+]?\d{1,2})?)")
UNITS = {
    "count": (1.0, "count"), "step": (1.0, "step"), "m": (1e6, "um"), "rad": (1e6, "urad"),
}  # fmt: skip
"""Factor and name of the unit in which a difference in place is shown."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """Differences over the time of the plan.

    Parameters
    ----------
    time_s
        (n,) instants of the plan, s.
    place
        (n,) differences in place, in the unit of the file's ``Found``; None without any.
    late_s
        (n,) differences in time, s; None without any.
    """

    time_s: FloatArray
    place: FloatArray | None = None
    late_s: FloatArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """The differences between a file and its plan.

    Parameters
    ----------
    reader
        The reader of the file, in a few words.
    own
        Whether only Threadline's own reader has read the file, so that no other program confirms
        it.
    place, place_limit
        Largest difference in place and its limit, in ``unit``.
    unit
        ``"count"``, ``"step"``, ``"m"`` or ``"rad"``.
    axis
        Axis of the largest difference; empty for a distance of all axes together.
    tool_m
        The same difference at the tool, m; rotary axes act at their radius. None without a tool.
    time_s, time_limit_s
        Largest difference in time and its limit; None where nothing states a time.
    at
        Line, row, block or step of the largest difference.
    note
        Remarks that say nothing against the file.
    wrong
        Differences that no limit covers; empty if there are none.
    curve
        The differences over time.
    """

    reader: str
    own: bool = False
    place: float
    place_limit: float
    unit: str
    axis: str = ""
    tool_m: float | None = None
    time_s: float | None = None
    time_limit_s: float | None = None
    at: str = ""
    note: str = ""
    wrong: str = ""
    curve: Curve | None = None

    @property
    def beyond(self) -> bool:
        """Whether a difference is beyond its limit, or a difference has no limit."""
        too_far = self.place > self.place_limit * (1.0 + 1e-9)
        late = abs(self.time_s or 0.0) > (self.time_limit_s or 0.0) * (1.0 + 1e-9)
        return too_far or (self.time_limit_s is not None and late) or bool(self.wrong)


def no_file_of(
    what: str, target: str, path: Path, reason: object, line: int | None = None
) -> RecordingError:
    """Return the error, in one line, for a file that is not one of ``target``."""
    return RecordingError(
        f"the file is no {what}: {' '.join(str(reason).split())[:140]}",
        place=Place(str(path), line or 0),
        remedy=f"Give a file that compile --target {target} wrote.",
    )


@contextmanager
def refusing(what: str, target: str, path: Path) -> Iterator[None]:
    """Turn every failure of a reader of ``target`` files into an error of one line.

    Raises
    ------
    RecordingError
        If the reader fails with an error of Python or numpy.
    """
    try:
        yield
    except ThreadlineError:
        raise
    except _FAULTS as error:
        reason: object = error
        if isinstance(error, KeyError):
            reason = f"{error} is missing"
        elif isinstance(error, MemoryError):
            reason = "it needs more memory than there is"
        elif isinstance(error, RecursionError):
            reason = "its parts stand too deep in one another"
        line = getattr(error, "line", None)
        raise no_file_of(what, target, path, reason, line) from error


def whole_fraction(text: object) -> Fraction:
    """Return a time such as ``"1/200"`` or 0.005 exactly.

    Raises
    ------
    ValueError
        If it is no time, or has more digits than any clock.
    """
    if isinstance(text, bool) or not isinstance(text, int | float | str):
        raise ValueError(f"{str(text)[:40]!r} is no time")
    if _TIME_TEXT.fullmatch(str(text)) is None:
        raise ValueError(f"{str(text)[:40]!r} is no time")
    return Fraction(str(text))


def of_another(what: str, named: object, expected: str, path: Path) -> RecordingError:
    """Return the refusal of a file that names another job, machine file or version."""
    return RecordingError(
        f"the file was written for another {what}: it names {str(named)[:16]}, "
        f"this one is {expected[:16]}",
        place=Place(str(path)),
        remedy=f"Name the {what} that it was written for.",
    )


def thinned(*columns: FloatArray) -> list[FloatArray]:
    """Return columns with at most ``_MOST_ROWS`` rows.

    From each group of consecutive rows the row with the largest size in the last column is kept.
    """
    count = len(columns[-1])
    if count <= _MOST_ROWS:
        return list(columns)
    size = np.abs(columns[-1])
    edges = np.linspace(0, count, _MOST_ROWS + 1).astype(np.int64)
    largest_rows = np.array(
        [begin + int(np.argmax(size[begin:end])) for begin, end in pairwise(edges)],
        dtype=np.int64,
    )  # fmt: skip
    return [column[largest_rows] for column in columns]
