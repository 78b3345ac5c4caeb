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
"""(device, inode) -> name, of every file that is read within ``noting_inputs``."""
_WITHIN: ContextVar[Path | None] = ContextVar("within", default=None)
"""The folder to which reading is limited; None for no limit."""


def refuse_special(path: Path) -> None:
    """Refuse a pipe, a device or a socket: opening or reading it may block forever.

    Every reader calls this function first, so it also notes the file as an input.

    Raises
    ------
    OSError
        If ``path`` is a special file, is inaccessible, or is outside of the folder of
        ``reading_within``. A folder is not refused, because opening it raises an error anyway.
    """
    if (folder := _WITHIN.get()) is not None:
        _refuse_outside(path, folder)
    status = path.stat()
    if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
        raise OSError(errno.EINVAL, "it is a pipe or a device, not a file", str(path))
    note_input(path, status)


@contextmanager
def reading_within(folder: Path) -> Iterator[None]:
    """Allow the block to read only files in ``folder``, and to follow no link below it.

    This protects against a file from another person, which may name any other file on this
    computer.
    """
    mark = _WITHIN.set(folder)
    try:
        yield
    finally:
        _WITHIN.reset(mark)


def within_folder(path: Path) -> Path:
    """Return a relative path as a path in the folder of ``reading_within``, if there is one."""
    folder = _WITHIN.get()
    return path if folder is None or path.is_absolute() else folder / path


def _refuse_outside(path: Path, folder: Path) -> None:
    real_folder = Path(os.path.realpath(folder))
    absolute_path = Path(os.path.normpath(path.absolute()))  # links are not followed
    folders = (Path(os.path.normpath(folder.absolute())), real_folder)
    base = next(
        (candidate for candidate in folders if absolute_path.is_relative_to(candidate)), None
    )
    if base is None:
        raise OSError(errno.EACCES, "it is not in the project folder", str(path))
    if Path(os.path.realpath(path)) != real_folder / absolute_path.relative_to(base):
        raise OSError(errno.EACCES, "a link leads to it, and links are not followed", str(path))


@contextmanager
def noting_inputs() -> Iterator[None]:
    """Note every file that the block reads; such blocks may be nested."""
    outer_inputs = _INPUTS.get()
    mark = _INPUTS.set({} if outer_inputs is None else outer_inputs)
    try:
        yield
    finally:
        _INPUTS.reset(mark)


def note_input(path: Path, status: os.stat_result | None = None) -> None:
    """Note ``path`` as an input, inside a block ``noting_inputs``."""
    noted = _INPUTS.get()
    if noted is None:
        return
    with suppress(OSError, ValueError):
        status = path.stat() if status is None else status
        noted[status.st_dev, status.st_ino] = str(path)


def input_behind(path: Path) -> str | None:
    """Return the name under which the file at ``path`` was read; None if it was not read.

    Links are followed.
    """
    noted = _INPUTS.get()
    if not noted:
        return None
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return noted.get((status.st_dev, status.st_ino))


def inputs_read() -> tuple[Path, ...]:
    """Return the noted input files in the order of reading."""
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
    """A file with its hash and its state at the time of hashing.

    Parameters
    ----------
    path
        Absolute path, because another process may have another working directory.
    sha256
        Hash of the content.
    size, modified_ns
        Size in bytes, and time of modification. While both are unchanged, the content counts as
        unchanged and is not read again.
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
        # No file has the modification time -1, so the receiving process hashes the content itself.
        return KnownFile, (self.path, self.sha256, self.size, -1)

    def is_unchanged(self) -> bool:
        """Return whether the content of the file is unchanged.

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
    """Return the SHA-256 of a file, cached by its path and modification time."""
    del modified_ns
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def naming(output: Path, temporary: Path) -> Iterator[None]:
    """Let an OSError or InputError of the block name ``output`` instead of a temporary file.

    An error without a file name, such as a full disk, also names ``output``.

    Parameters
    ----------
    output
        The file or folder that the user named.
    temporary
        The temporary file or folder from which it is made.
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
    """Return the content of a text file that a person wrote.

    Parameters
    ----------
    path
        The file.
    most_bytes
        Largest size; a larger file is refused before it is read.
    error
        Class of the errors raised.
    what
        Kind of file, for remedies: ``"machine file"``.
    encoding
        ``"utf-8-sig"`` where a byte order mark is allowed.

    Raises
    ------
    InputError
        An error of the class ``error``, if the file cannot be read, is too large or is not UTF-8.
    """
    try:
        refuse_special(path)
        size = path.stat().st_size
        content = path.read_bytes() if size <= most_bytes else b""
    except (OSError, ValueError) as failure:  # a null character in a name is a ValueError
        why = failure.strerror if isinstance(failure, OSError) else failure
        raise error(
            f"cannot read {str(path)[:200]!r}: {why}", remedy=f"Give a {what} that can be read."
        ) from failure
    place = Place(str(path))
    if size > most_bytes:
        message = f"the file has {size} bytes, limit {most_bytes}"
        raise error(message, place=place, remedy=f"Is this a {what}?")
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as failure:
        raise error(
            "the file is not UTF-8 text", place=place, remedy="Save it as UTF-8."
        ) from failure
