"""Results of drawn machines, kept in a file, so that a yield can be continued.

The first line of the file holds its identity. Each further line holds one part of the sequence of
machines. Lines are only added, by one process at a time. A line that an interrupt cut short is left
out, and its machines are drawn again. A machine depends only on the seed and its number, so the
answer is the same to the bit.

A line begins with its check sum, and its rows are numbered. A line does not store whether a machine
failed: failure follows from value and limit. A process that continues a yield judges the first
machine again, and so notices a file with other criteria or values.
"""

from __future__ import annotations

import base64
import json
import math
import sys
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np

from threadline.base.reading import naming
from threadline.base.writing import check_output, is_stdout
from threadline.errors import OptionError, Place, RecordingError
from threadline.files.formats.common import parse_json
from threadline.verdict import CriterionRow, EachRun
from threadline.verdict.each_run import exceeded
from threadline.verdict.registry import MEASURES

if sys.platform != "win32":
    import fcntl

FORMAT = "threadline yield 2"
_REMEDY = "Give another file to --resume, or remove this one to begin anew."
MOST_LINE = 64 << 20
NOT_AS_WRITTEN = KeyError, TypeError, ValueError, AttributeError, OverflowError, zlib.error
"""Errors from the content of a line that Threadline did not write."""
_MOST_RUNS = 1 << 20  # largest number of machines in one line
_TEXTS = ("name", "axis", "step", "unit")
_FLAGS = ("required", "hard", "of_plan")
_ROW_FIELDS = (*_TEXTS, "limit", *_FLAGS)


@dataclass(frozen=True, slots=True)
class Lines:
    """Reads the lines of a file of judged machines, and refuses a changed one by its number.

    Parameters
    ----------
    path
        The file.
    subject, remedy
        Name of the file's content, and the remedy, for messages.
    """

    path: Path
    subject: str
    remedy: str

    def content(self, text: bytes, line: int) -> dict[str, Any]:
        """Return the content of a line, and check its check sum.

        Raises
        ------
        RecordingError
            If the line was changed.
        """
        checksum, _, body = text.rstrip(b"\n").partition(b" ")
        if checksum != b"%08x" % zlib.crc32(body):
            self.refuse(f"it is not {self.subject}, or it was changed", line)
        content = parse_json(body.decode(errors="replace"), Place(str(self.path), line))
        if not isinstance(content, dict):
            self.refuse("it was changed", line)
        return content

    def judged(self, content: Mapping[str, Any], at: int, line: int) -> EachRun:
        """Return the results in a line, whose first machine is ``at`` in the sequence.

        Raises
        ------
        RecordingError
            If the line has other machines, or was changed.
        """
        runs, first = content.get("runs"), content.get("first")
        if type(first) is not int or first != at or type(runs) is not int:
            self.refuse(f"machines {at} and on should stand here", line)
        if not 0 < runs <= _MOST_RUNS:
            self.refuse(f"it has {runs} machines in one line, not 1 to {_MOST_RUNS}", line)
        incomplete = content.get("incomplete")
        try:
            rows = tuple(_unpacked(row, k, runs) for k, row in enumerate(content["rows"]))
        except NOT_AS_WRITTEN as error:
            reason = f": {error}" if type(error) is ValueError else ""
            self.refuse(f"it was changed{reason}", line)
        if not isinstance(incomplete, str) or not rows:
            self.refuse("it was changed", line)
        return EachRun(rows=rows, runs=runs, incomplete=incomplete)

    def refuse(self, why: str, line: int) -> NoReturn:
        """Raise the error that a line cannot be read."""
        raise RecordingError(
            f"{self.subject} cannot be read: {why}",
            place=Place(str(self.path), line),
            remedy=self.remedy,
        )


class YieldState:
    """The judged machines of a sequence, in a file.

    Parameters
    ----------
    path
        The file; it is created if it is missing.
    identity
        Names and hashes of the machines, their commands and the criteria. A file with another
        identity is refused.

    Attributes
    ----------
    cut
        Whether the last line was cut short, and left out.

    Raises
    ------
    OptionError
        If the file must not be written, belongs to other machines, commands or criteria, or another
        process writes it.
    RecordingError
        If the file is not a yield state, or is damaged.
    """

    def __init__(self, path: Path, identity: Mapping[str, str]) -> None:
        check_output(path)
        if is_stdout(path):
            raise OptionError(
                f"--resume {str(path)!r} is where the answer is printed", remedy="Name a file."
            )
        self._path = path
        self._lines = Lines(path, "the state of a yield", _REMEDY)
        self._known: list[EachRun] = []
        self.cut = False
        path.parent.mkdir(parents=True, exist_ok=True)
        with naming(path, path):
            self._file: IO[bytes] = path.open("a+b")
        try:
            self._lock()
            if self._file.seek(0, 2):
                self._read(identity)
            else:
                self._append({"format": FORMAT, "identity": dict(identity)})
        except BaseException:
            self._file.close()
            raise

    def __del__(self) -> None:
        if hasattr(self, "_file"):
            self._file.close()

    @property
    def known(self) -> EachRun | None:
        """Results of the first machines of the sequence; None for a new file."""
        if len(self._known) > 1:
            self._known = [EachRun.joined(self._known)]
        return self._known[0] if self._known else None

    def add(self, found: EachRun) -> None:
        """Keep the results of the next machines of the sequence."""
        self._append(content_of_runs(found, sum(part.runs for part in self._known)))
        self._known.append(found)  # joined only when read, because each join copies all results

    def check_first(self, found: EachRun) -> None:
        """Compare the file's result of the first machine with its new result.

        Raises
        ------
        RecordingError
            If they differ.
        """
        known = self.known
        assert known is not None
        if not same_first(known, found) or known.incomplete != found.incomplete:
            self._lines.refuse("its first machine has another result today", 2)

    def _lock(self) -> None:
        """Keep other processes from writing the file, until this process closes it or ends."""
        if sys.platform == "win32":
            return
        try:
            fcntl.lockf(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            raise OptionError(
                f"another program writes {str(self._path)!r} at this moment",
                remedy="Wait for its end, or give another file to --resume.",
            ) from None
        except OSError as error:
            raise OptionError(
                f"{str(self._path)!r} cannot be locked against other programs: {error.strerror}",
                remedy="Give a file on a disk of this computer to --resume.",
            ) from error

    def _append(self, content: Mapping[str, Any]) -> None:
        try:
            self._file.write(line_of(content))
            self._file.flush()
        except OSError as error:  # the disk is full: the machines in the file are not lost
            raise OptionError(
                f"cannot write {str(self._path)!r}: {error.strerror}",
                remedy="Make room on its disk, and repeat the command: it goes on with the "
                "machines that the file holds.",
            ) from error

    def _read(self, identity: Mapping[str, str]) -> None:
        batches: list[EachRun] = []
        file = self._file
        file.seek(0)
        head = self._lines.content(file.readline(MOST_LINE), 1)
        if head.get("format") != FORMAT:
            self._lines.refuse("it is not the state of a yield of this version", 1)
        self._check_identity(head.get("identity"), identity)
        good_end, line = file.tell(), 1
        while text := file.readline(MOST_LINE):
            line += 1
            if not text.endswith(b"\n") and not file.read(1):
                self.cut = True
                break
            first_index = sum(part.runs for part in batches)
            batches.append(self._lines.judged(self._lines.content(text, line), first_index, line))
            if not same_rows(batches[-1], batches[0]):
                self._lines.refuse("it has other criteria than the lines before it", line)
            good_end = file.tell()
        if self.cut:
            file.truncate(good_end)
        self._known = batches

    def _check_identity(self, stated: Any, identity: Mapping[str, str]) -> None:
        stated_identity = stated if isinstance(stated, dict) else {}
        names = [*identity, *(name for name in stated_identity if name not in identity)]
        differing = [str(name) for name in names if stated_identity.get(name) != identity.get(name)]
        if differing:
            raise OptionError(
                f"{str(self._path)!r} was begun with another {', '.join(differing)}",
                remedy=_REMEDY,
            )


def content_of_runs(found: EachRun, first: int) -> dict[str, Any]:
    """Return the content of a line: judged machines, ``first`` in the sequence and on."""
    rows = [{"number": k, **_packed(row)} for k, row in enumerate(found.rows)]
    return {"first": first, "runs": found.runs, "incomplete": found.incomplete, "rows": rows}


def line_of(content: Mapping[str, Any]) -> bytes:
    """Return a line of the file, with its check sum."""
    text = json.dumps(content, ensure_ascii=True, separators=(",", ":")).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)


def same_rows(one: EachRun, other: EachRun) -> bool:
    """Return whether two results have the same criteria, axes, steps and limits."""
    return [*map(_table, one.rows)] == [*map(_table, other.rows)]


def same_first(known: EachRun, found: EachRun) -> bool:
    """Return whether the first machine has the same result in both, to the bit."""
    known_rows, found_rows = (
        [(*_table(row), row.values[:1].tobytes()) for row in one.rows] for one in (known, found)
    )
    return known_rows == found_rows


def _table(row: CriterionRow) -> tuple[Any, ...]:
    """Return the description of a row."""
    return tuple(getattr(row, key) for key in _ROW_FIELDS)


def _packed(row: CriterionRow) -> dict[str, Any]:
    values = np.ascontiguousarray(row.values, dtype="<f8").tobytes()
    return {**dict(zip(_ROW_FIELDS, _table(row), strict=True)), "values": _text(values)}


def _unpacked(row: Mapping[str, Any], number: int, runs: int) -> CriterionRow:
    if type(row["number"]) is not int or row["number"] != number:
        raise ValueError(f"row {number} is not where it belongs")
    if not all(isinstance(row[key], str) for key in _TEXTS):
        raise ValueError(f"row {number} has a name that is no text")
    if not all(isinstance(row[key], bool) for key in _FLAGS):
        raise ValueError(f"row {number} has a mark that is neither true nor false")
    limit = row["limit"]
    if limit is not None and (isinstance(limit, bool) or not math.isfinite(limit)):
        raise ValueError(f"row {number} has a limit that is not a number")
    if (kind := MEASURES.get(row["name"])) is None:
        raise ValueError(f"row {number} is of no criterion")
    values = np.frombuffer(_bytes(row["values"], 8 * runs), dtype="<f8").astype(np.float64)
    return CriterionRow(
        **{key: row[key] for key in _ROW_FIELDS},
        values=values,
        failed=exceeded(kind, limit, values),
    )


def _text(content: bytes) -> str:
    return base64.b64encode(zlib.compress(content, 1)).decode()


def _bytes(text: str, count: int) -> bytes:
    reader = zlib.decompressobj()
    content = reader.decompress(base64.b64decode(text, validate=True), count + 1)
    if len(content) != count:
        raise ValueError(f"a row has {len(content)} bytes, not {count}")
    return content
