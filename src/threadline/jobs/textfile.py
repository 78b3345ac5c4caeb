"""Reading a text file in bounded memory, and refusing what is not text."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

from threadline.errors import JobError, Place

MAX_LINE_BYTES = 4096
CHUNK_BYTES = 1 << 18
_DOS_END = b"\x1a"  # editors of the 1990s closed a text file with it
_UTF8_MARK = b"\xef\xbb\xbf"
_CONTROL = re.compile(rb"[\x00-\x08\x0a-\x1f\x7f]")


class Chunk(NamedTuple):
    """Whole lines of a file: the byte at which they begin, and their bytes."""

    offset: int
    data: bytes


@dataclass(frozen=True, slots=True)
class SourceFile:
    """A file as it was when its hash was taken.

    Parameters
    ----------
    path
        The file, as it is named in places.
    sha256
        Of all its bytes.
    begin, end
        The bytes that are text: without a byte order mark and a DOS end-of-file mark.
    size, modified_ns
        Tell whether the file has been changed since.
    """

    path: str
    sha256: str
    begin: int
    end: int
    size: int
    modified_ns: int

    def place(self, line: int = 0) -> Place:
        """Return a place in this file."""
        return Place(self.path, line)

    def chunks(self, offset: int, size: int = CHUNK_BYTES) -> Iterator[Chunk]:
        """Return the whole lines from the byte ``offset`` on, a chunk of them at a time.

        Raises
        ------
        JobError
            If the file was changed since it was hashed, or no line ends within a chunk.
        """
        with open_binary(Path(self.path)) as stream:
            status = Path(self.path).stat()
            if (status.st_size, status.st_mtime_ns) != (self.size, self.modified_ns):
                raise JobError(
                    "the file was changed while it was in use",
                    place=self.place(),
                    remedy="Start again.",
                )
            stream.seek(offset)
            rest = b""
            at = offset
            while at < self.end:
                data = rest + stream.read(min(size, self.end - at - len(rest)))
                last = at + len(data) >= self.end
                cut = len(data) if last else data.rfind(b"\n") + 1
                if cut == 0:
                    # The caller counts lines and says which one it is.
                    yield Chunk(at, data)
                    return
                yield Chunk(at, data[:cut])
                rest = data[cut:]
                at += cut


def open_binary(path: Path) -> BinaryIO:
    """Open ``path`` for reading bytes.

    Raises
    ------
    JobError
        If there is no such file or it cannot be read.
    """
    try:
        return path.open("rb")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise JobError(
            f"cannot read job file {str(path)[:200]!r}: {reason}", remedy="Name an existing file."
        ) from error


def identify(path: Path) -> SourceFile:
    """Return the file at ``path`` with its hash, read in chunks.

    Raises
    ------
    JobError
        If it cannot be read, is a device and not a file, is empty, or is UTF-16.
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
        sha256=digest.hexdigest(),
        begin=3 if head == _UTF8_MARK else 0,
        end=status.st_size - (len(tail) - len(tail.rstrip(_DOS_END))),
        size=status.st_size,
        modified_ns=status.st_mtime_ns,
    )


class TextLine(NamedTuple):
    """A line: its number from 1, the byte at which it begins, its text without the end."""

    number: int
    offset: int
    text: str


def lines_of(file: SourceFile, offset: int | None = None, number: int = 1) -> Iterator[TextLine]:
    """Return the lines of ``file`` from the byte ``offset`` on, which begins line ``number``.

    Raises
    ------
    JobError
        If a line is too long or is not text.
    """
    at = file.begin if offset is None else offset
    for chunk in file.chunks(at):
        at = chunk.offset
        for raw in chunk.data.removesuffix(b"\n").split(b"\n"):
            yield TextLine(number, at, decode_line(raw, file.path, number))
            at += len(raw) + 1
            number += 1


def decode_line(raw: bytes, file: str, number: int) -> str:
    """Return a line, given without its line feed, as text.

    Raises
    ------
    JobError
        If it is too long, holds a control character, or is not UTF-8.
    """
    if raw.endswith(b"\r"):
        raw = raw[:-1]
    if len(raw) > MAX_LINE_BYTES:
        raise JobError(
            f"the line has more than {MAX_LINE_BYTES} bytes",
            place=Place(file, number),
            remedy="Is this a job file? One block to a line.",
        )
    control = _CONTROL.search(raw)
    if control is not None:
        byte = control[0][0]
        kind = "is the file binary or UTF-16?" if byte == 0 else "only tabs are allowed."
        raise JobError(
            f"the line holds the control character 0x{byte:02X} in column {control.start() + 1}",
            place=Place(file, number),
            remedy=f"Save the program as UTF-8 text; {kind}",
        )
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise JobError(
            f"byte 0x{raw[error.start]:02X} in column {error.start + 1} is not UTF-8",
            place=Place(file, number),
            remedy="Save the program as UTF-8.",
        ) from error
