"""Text files, read line by line in bounded memory; files that are not text are refused."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threadline.base.reading import KnownFile, open_binary
from threadline.errors import JobError, Place

MAX_LINE_BYTES = 4096
CHUNK_BYTES = 1 << 18
_DOS_END = b"\x1a"  # editors of the 1990s ended a text file with this byte
_UTF8_MARK = b"\xef\xbb\xbf"
_SEPARATOR = re.compile("[\x85\u2028\u2029]")  # editors show these as a new line
_CONTROL = re.compile(rb"[\x00-\x08\x0a-\x1f\x7f]")


class Chunk(NamedTuple):
    """Whole lines of a file: the offset of their first byte, and their bytes."""

    offset: int
    data: bytes


@dataclass(frozen=True, slots=True)
class SourceFile:
    """A file at the time of its hash.

    Parameters
    ----------
    path
        Path of the file, as shown in places.
    known
        Hash of the file, and the check for later changes.
    begin, end
        Range of the text in bytes, without a byte order mark and a DOS end-of-file mark.
    """

    path: str
    known: KnownFile
    begin: int
    end: int

    @property
    def sha256(self) -> str:
        """Hash of all bytes of the file."""
        return self.known.sha256

    def place(self, line: int = 0) -> Place:
        """Return a place in this file."""
        return Place(self.path, line)

    def chunks(
        self, offset: int, size: int = CHUNK_BYTES, end: int | None = None
    ) -> Iterator[Chunk]:
        """Return the whole lines from byte ``offset`` to ``end``, in chunks.

        Raises
        ------
        JobError
            If the file was changed after it was hashed.
        """
        with open_binary(self.known.path) as stream:
            if not self.known.is_unchanged():
                raise JobError(
                    "the file was changed while it was in use",
                    place=self.place(),
                    remedy="Start again.",
                )
            stream.seek(offset)
            unfinished = b""
            position = offset
            end = self.end if end is None else min(end, self.end)
            while position < end:
                data = unfinished + stream.read(min(size, end - position - len(unfinished)))
                is_last = position + len(data) >= end
                whole_bytes = len(data) if is_last else data.rfind(b"\n") + 1
                if whole_bytes == 0:
                    # One line fills the chunk: ``Lines.take`` refuses it, with its number.
                    yield Chunk(position, data)
                    return
                yield Chunk(position, data[:whole_bytes])
                unfinished = data[whole_bytes:]
                position += whole_bytes


def first_found(file: SourceFile, pattern: str) -> tuple[int, str]:
    """Return the first line that matches a pattern, and the letter there; line 0 without a match.

    Raises
    ------
    JobError
        If the file was changed after it was hashed.
    """
    compiled = re.compile(pattern.encode("latin-1"))
    lines_before = 1
    for _, data in file.chunks(file.begin):
        match = compiled.search(data)
        if match is not None:
            begin = data.rfind(b"\n", 0, match.start()) + 1
            line = data[begin:].partition(b"\n")[0].decode("utf-8", "replace")
            letters = len(data[begin : match.start()].decode("utf-8", "ignore"))
            return lines_before + data.count(b"\n", 0, begin), line[letters]
        lines_before += data.count(b"\n")
    return 0, ""


def identify(path: Path) -> SourceFile:
    """Return the file at ``path`` with its hash, which is computed in chunks.

    Raises
    ------
    JobError
        If the path cannot be read or is no file, or the file is empty or UTF-16.
    """
    place = Place(str(path))
    digest = hashlib.sha256()
    with open_binary(path) as stream:
        if not path.is_file():
            raise JobError(f"{path} is not a file", remedy="Name a job file.")
        status = path.stat()
        head = tail = b""
        while chunk := stream.read(CHUNK_BYTES):
            head = head or chunk[:3]
            tail = chunk
            digest.update(chunk)
    if status.st_size == 0:
        raise JobError("the file is empty", place=place, remedy="Name a file with a program.")
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise JobError("the file is UTF-16 text", place=place, remedy="Save it as UTF-8.")
    return SourceFile(
        path=str(path),
        known=KnownFile(path.absolute(), digest.hexdigest(), status.st_size, status.st_mtime_ns),
        begin=3 if head == _UTF8_MARK else 0,
        end=status.st_size - (len(tail) - len(tail.rstrip(_DOS_END))),
    )


class TextLine(NamedTuple):
    """A line: its number from 1, the offset of its first byte, its text without the line end."""

    number: int
    offset: int
    text: str


class Lines:
    """A reader of a text file whose position moves forward line by line or in chunks.

    Parameters
    ----------
    file
        The file.
    offset, number
        First byte and first line (from 1) to read.
    kept
        Lines from ``offset``, if they are in memory already.
    """

    def __init__(
        self, file: SourceFile, offset: int, number: int, cached_chunk: Chunk | None = None
    ) -> None:
        self._file = file
        self._chunks = iter((cached_chunk,)) if cached_chunk is not None else file.chunks(offset)
        self._chunk = Chunk(offset, b"")
        self.data: NDArray[np.uint8] = np.empty(0, np.uint8)
        self.at = 0
        self.number = number

    @property
    def offset(self) -> int:
        """Offset of the next byte of the file."""
        return self._chunk.offset + self.at

    def more(self) -> bool:
        """Return whether there is another line; the line starts at ``data[at]``."""
        if self.at < len(self._chunk.data):
            return True
        chunk = next(self._chunks, None)
        if chunk is None or not chunk.data:
            return False
        self._chunk = chunk
        self.data = np.frombuffer(chunk.data, np.uint8)
        self.at = 0
        return True

    def skip(self) -> None:
        """Skip the next line."""
        end = self._chunk.data.find(b"\n", self.at)
        self.at = (len(self._chunk.data) if end < 0 else end) + 1
        self.number += 1

    def take(self) -> TextLine:
        """Return the next line, which must exist (see ``more``).

        Raises
        ------
        JobError
            If the line is too long or is not text.
        """
        data = self._chunk.data
        end = data.find(b"\n", self.at)
        end = len(data) if end < 0 else end
        text = decode_line(data[self.at : end], self._file.path, self.number)
        line = TextLine(self.number, self.offset, text)
        self.at = end + 1
        self.number += 1
        return line


def decode_line(raw: bytes, file: str, number: int) -> str:
    """Return a line, given without its line feed, as text.

    Raises
    ------
    JobError
        If the line is too long, holds a control character or a line separator, or is not UTF-8.
    """
    # Two behind it if a program was converted for Windows twice, one in front of it if LF CR ends
    # its lines.
    raw = raw.strip(b"\r")
    if len(raw) > MAX_LINE_BYTES:
        raise JobError(
            f"the line has more than {MAX_LINE_BYTES} bytes",
            place=Place(file, number),
            remedy="Is this a job file? One block to a line.",
        )
    control = _CONTROL.search(raw)
    if control is not None:
        byte = control[0][0]
        kind = {
            0x00: "is the file binary or UTF-16?",
            0x0D: "lines end with a line feed, with or without carriage returns beside it.",
        }.get(byte, "only tabs are allowed.")
        raise JobError(
            f"the line holds the control character 0x{byte:02X} in column {control.start() + 1}",
            place=Place(file, number),
            remedy=f"Save the program as UTF-8 text; {kind}",
        )
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise JobError(
            f"byte 0x{raw[error.start]:02X} in column {error.start + 1} is not UTF-8",
            place=Place(file, number),
            remedy="Save the program as UTF-8.",
        ) from error
    separator = _SEPARATOR.search(text)
    if separator is not None:
        # After a comment, an editor would show the rest as a block on the next line.
        raise JobError(
            f"the line holds the line separator U+{ord(separator[0]):04X} in column "
            f"{separator.start() + 1}",
            place=Place(file, number),
            remedy="Write each block on a line of its own, ended by a line feed.",
        )
    return text
