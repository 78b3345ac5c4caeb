"""Checks of a path before it is opened, a note of every file read, and hashes of files."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

from threadline.errors import InputError, JobError, Place

_INPUTS: ContextVar[dict[tuple[int, int], str] | None] = ContextVar("inputs", default=None)
"""Device and inode of every file that was read in ``noting_inputs``, with its name."""
_WITHIN: ContextVar[Path | None] = ContextVar("within", default=None)
"""The only folder in which files are read now; None for any."""


def refuse_special(path: Path) -> None:
    """Refuse a pipe, a device or a socket: opening or reading one may never end.

    Every reader asks this first, so the file is noted as an input here.

    Raises
    ------
    OSError
        If ``path`` is one of them, cannot be looked at, or is not in the folder that
        ``reading_within`` names. A folder passes: opening it fails with a reason of its own.
    """
    if (folder := _WITHIN.get()) is not None:
        _refuse_outside(path, folder)
    status = path.stat()
    if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
        raise OSError(errno.EINVAL, "it is a pipe or a device, not a file", str(path))
    note_input(path, status)


@contextmanager
def reading_within(folder: Path) -> Iterator[None]:
    """Read only files in ``folder`` in the block, and follow no link that stands in it.

    What is read by the words of somebody else, as a file that he has sent, may name any other.
    """
    mark = _WITHIN.set(folder)
    try:
        yield
    finally:
        _WITHIN.reset(mark)


def _refuse_outside(path: Path, folder: Path) -> None:
    real = Path(os.path.realpath(folder))
    named = Path(os.path.normpath(path.absolute()))  # links stay what they are
    folders = (Path(os.path.normpath(folder.absolute())), real)
    base = next((one for one in folders if named.is_relative_to(one)), None)
    if base is None:
        raise OSError(errno.EACCES, "it is not in the project folder", str(path))
    if Path(os.path.realpath(path)) != real / named.relative_to(base):
        raise OSError(errno.EACCES, "a link leads to it, and links are not followed", str(path))


@contextmanager
def noting_inputs() -> Iterator[None]:
    """Note every file that is read in the block, however it is reached; blocks may be nested."""
    before = _INPUTS.get()
    mark = _INPUTS.set({} if before is None else before)
    try:
        yield
    finally:
        _INPUTS.reset(mark)


def note_input(path: Path, status: os.stat_result | None = None) -> None:
    """Note that ``path`` is read, where inputs are noted."""
    noted = _INPUTS.get()
    if noted is None:
        return
    with suppress(OSError, ValueError):
        status = path.stat() if status is None else status
        noted[status.st_dev, status.st_ino] = str(path)


def input_behind(path: Path) -> str | None:
    """Return the name under which the file at ``path`` was read, links followed; None if not."""
    noted = _INPUTS.get()
    if not noted:
        return None
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return noted.get((status.st_dev, status.st_ino))


def inputs_read() -> tuple[Path, ...]:
    """Return the files that were read since inputs are noted, first the one that came first."""
    return tuple(Path(name) for name in (_INPUTS.get() or {}).values())


def open_binary(path: Path) -> BinaryIO:
    """Open ``path`` for reading bytes.

    Raises
    ------
    JobError
        If there is no such file or it cannot be read.
    """
    try:
        refuse_special(path)
        return path.open("rb")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise JobError(
            f"cannot read job file {str(path)[:200]!r}: {reason}", remedy="Name an existing file."
        ) from error


@dataclass(frozen=True, slots=True)
class KnownFile:
    """A file as it was when its hash was taken.

    Parameters
    ----------
    path
        Absolute: another process may have another working directory.
    sha256
        Hash of its content.
    size, modified_ns
        As long as both are the same, the content is taken for the same without reading it.
    """

    path: Path
    sha256: str
    size: int
    modified_ns: int

    @classmethod
    def of(cls, path: Path) -> KnownFile:
        """Return the file at ``path`` with its hash.

        Raises
        ------
        OSError
            If it cannot be read.
        """
        refuse_special(path)
        status = path.stat()
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return cls(path.absolute(), digest, status.st_size, status.st_mtime_ns)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        # No modification time is -1: the process that receives it hashes the content once.
        return KnownFile, (self.path, self.sha256, self.size, -1)

    def is_unchanged(self) -> bool:
        """Say whether the file still holds what it did.

        Raises
        ------
        OSError
            If it cannot be read.
        """
        refuse_special(self.path)
        status = self.path.stat()
        if status.st_size != self.size:
            return False
        if status.st_mtime_ns == self.modified_ns:
            return True
        return _sha256(self.path, status.st_mtime_ns) == self.sha256


@lru_cache(maxsize=64)
def _sha256(path: Path, modified_ns: int) -> str:
    """Return the SHA-256 of a file, from the cache as long as ``modified_ns`` is the same."""
    del modified_ns
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def naming(output: Path, temporary: Path) -> Iterator[None]:
    """Let an OSError or InputError of the block name ``output``, and not a temporary file.

    An error that names no file, as that of a full disk, then names ``output``, too.

    Parameters
    ----------
    output
        What was asked for.
    temporary
        What it is made from, a folder or a file that is gone afterwards.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None or str(error.filename).startswith(str(temporary)):
            error.filename = str(output)
        raise
    except InputError as error:
        error.message = error.message.replace(str(temporary), str(output))
        raise


def read_text(
    path: Path, most_bytes: int, error: type[InputError], what: str, encoding: str = "utf-8"
) -> str:
    """Return the whole of a text file that people write.

    Parameters
    ----------
    path
        The file.
    most_bytes
        A larger one is refused before it is read.
    error
        What is raised.
    what
        What the file should be, for remedies: ``"machine file"``.
    encoding
        ``"utf-8-sig"`` where a byte order mark may stand first.

    Raises
    ------
    InputError
        Of the kind ``error``, if the file cannot be read, is too large or is not UTF-8.
    """
    try:
        refuse_special(path)
        size = path.stat().st_size
        content = path.read_bytes() if size <= most_bytes else b""
    except (OSError, ValueError) as failure:  # a null in a name is a ValueError
        why = failure.strerror if isinstance(failure, OSError) else failure
        raise error(
            f"cannot read {str(path)[:200]!r}: {why}", remedy=f"Give a {what} that can be read."
        ) from failure
    place = Place(str(path))
    if size > most_bytes:
        said = f"the file has {size} bytes, limit {most_bytes}"
        raise error(said, place=place, remedy=f"Is this a {what}?")
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as failure:
        raise error(
            "the file is not UTF-8 text", place=place, remedy="Save it as UTF-8."
        ) from failure
