"""Results of drawn machines, kept in a file as they come, so that a yield can be continued.

The file has a line for what it is of, and one for each part of the sequence of machines; lines are
only ever added. A line that was cut short by an interrupt is left out, and its machines are drawn
again: a machine depends on the seed and its number alone, so that the answer is the same to the
bit.
"""

from __future__ import annotations

import base64
import binascii
import json
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from threadline.errors import OptionError, Place, RecordingError
from threadline.input_files import naming
from threadline.signals.files.common import parse_json
from threadline.verdict import CriterionRow, EachRun
from threadline.writing import check_output, is_stdout

FORMAT = "threadline yield 1"
_MOST_LINE = 64 << 20
_MOST_RUNS = 1 << 20  # of one line
_TOLD = ("name", "axis", "step", "limit", "unit", "required", "hard", "of_plan")


class YieldState:
    """The machines of a sequence that were judged, in a file.

    Parameters
    ----------
    path
        The file; made where it is missing.
    identity
        What the machines, their commands and the criteria are of: names and hashes. A file of
        another identity is refused.

    Attributes
    ----------
    known
        What came of the first machines of the sequence; None of a new file.
    cut
        Whether the last line was cut short, and left out.

    Raises
    ------
    OptionError
        If the file must not be written, or is of other machines, commands or criteria.
    RecordingError
        If it is no such file, or damaged.
    """

    def __init__(self, path: Path, identity: Mapping[str, str]) -> None:
        check_output(path)
        if is_stdout(path):
            raise OptionError(
                f"--resume {str(path)!r} is where the answer is printed", remedy="Name a file."
            )
        self._path = path
        self.known: EachRun | None = None
        self.cut = False
        if path.exists() and path.stat().st_size:
            self._read(identity)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._append({"format": FORMAT, "identity": dict(identity)})

    def add(self, found: EachRun) -> None:
        """Keep what came of the next machines of the sequence."""
        at = 0 if self.known is None else self.known.runs
        self._append({"first": at, "runs": found.runs, "rows": [_packed(r) for r in found.rows]})
        parts = [found] if self.known is None else [self.known, found]
        self.known = EachRun.joined(parts)

    def _append(self, content: Mapping[str, Any]) -> None:
        text = json.dumps(content, ensure_ascii=True, separators=(",", ":")).encode()
        with naming(self._path, self._path), self._path.open("ab") as file:
            file.write(b"%08x %s\n" % (zlib.crc32(text), text))

    def _read(self, identity: Mapping[str, str]) -> None:
        found: list[EachRun] = []
        with self._path.open("rb") as file:
            head = self._content(file.readline(_MOST_LINE), 1)
            if head.get("format") != FORMAT:
                self._refuse("it is not the state of a yield", 1)
            self._check_identity(head.get("identity"), identity)
            good, line = file.tell(), 1
            while text := file.readline(_MOST_LINE):
                line += 1
                if not text.endswith(b"\n") and not file.read(1):
                    self.cut = True
                    break
                at = sum(part.runs for part in found)
                found.append(self._part(self._content(text, line), at, line))
                good = file.tell()
        if self.cut:
            os.truncate(self._path, good)
        if found:
            self.known = EachRun.joined(found)

    def _content(self, text: bytes, line: int) -> dict[str, Any]:
        """Return what a line says, whose check sum comes first."""
        told, _, body = text.rstrip(b"\n").partition(b" ")
        if told != b"%08x" % zlib.crc32(body):
            self._refuse("it is not the state of a yield, or it was changed", line)
        content = parse_json(body.decode(errors="replace"), Place(str(self._path), line))
        if not isinstance(content, dict):
            self._refuse("it was changed", line)
        return content

    def _check_identity(self, told: Any, identity: Mapping[str, str]) -> None:
        known = told if isinstance(told, dict) else {}
        other = [name for name, value in identity.items() if known.get(name) != value]
        if other:
            raise OptionError(
                f"{str(self._path)!r} was begun with another {', '.join(other)}",
                remedy="Give another file to --resume, or remove this one to begin anew.",
            )

    def _part(self, content: dict[str, Any], at: int, line: int) -> EachRun:
        runs = content.get("runs")
        if content.get("first") != at or not isinstance(runs, int) or not 0 < runs <= _MOST_RUNS:
            self._refuse(f"machines {at} and on should stand here", line)
        try:
            rows = tuple(_unpacked(row, runs) for row in content["rows"])
        except (KeyError, TypeError, ValueError, zlib.error, binascii.Error):
            self._refuse("it was changed", line)
        return EachRun(rows=rows, runs=runs)

    def _refuse(self, why: str, line: int) -> NoReturn:
        raise RecordingError(
            f"the state of a yield cannot be read: {why}",
            place=Place(str(self._path), line),
            remedy="Give another file to --resume, or remove this one to begin anew.",
        )


def _packed(row: CriterionRow) -> dict[str, Any]:
    told = {key: getattr(row, key) for key in _TOLD}
    values = np.ascontiguousarray(row.values, dtype="<f8").tobytes()
    failed = np.packbits(row.failed).tobytes()
    return told | {"values": _text(values), "failed": _text(failed)}


def _unpacked(told: Mapping[str, Any], runs: int) -> CriterionRow:
    values = np.frombuffer(_bytes(told["values"], 8 * runs), dtype="<f8").astype(np.float64)
    bits = np.frombuffer(_bytes(told["failed"], (runs + 7) // 8), dtype=np.uint8)
    failed = np.unpackbits(bits, count=runs).astype(np.bool_)
    return CriterionRow(**{key: told[key] for key in _TOLD}, values=values, failed=failed)


def _text(content: bytes) -> str:
    return base64.b64encode(zlib.compress(content, 1)).decode()


def _bytes(text: str, count: int) -> bytes:
    reader = zlib.decompressobj()
    content = reader.decompress(base64.b64decode(text, validate=True), count + 1)
    if len(content) != count:
        raise ValueError(f"{len(content)} bytes, not {count}")
    return content
