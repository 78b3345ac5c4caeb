"""Output files: all files of a command appear together when it succeeds, or none of them.

Every file is written under a temporary name in its folder and renamed at the end, in steps that can
be undone. No output replaces an input file, a read-only file, a folder, a pipe or a device; links
are followed. Standard output is written last. Missing parent folders are made. Signals that end the
program are held back while files are renamed.
"""

from __future__ import annotations

import os
import shutil
import signal
import stat
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import IO

from threadline.base.reading import input_behind, naming
from threadline.errors import OptionError

_PREFIX = 80  # number of characters of the file's name that the temporary name begins with
_STDOUT = 1
_ANY_WRITES = 0o222
_REMEDY = "Give another path."


def check_output(path: Path) -> None:
    """Refuse a path that must not be overwritten.

    Raises
    ------
    OptionError
        If ``path`` is a folder, read-only, a pipe or a device, or a file that was read.
    """
    if is_stdout(path):
        return
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError):  # a missing folder is checked when it is made
        return
    except (OSError, ValueError) as error:  # for example a loop of links, or a null in the name
        why = getattr(error, "strerror", None) or error
        raise OptionError(f"cannot write {str(path)!r}: {why}", remedy=_REMEDY) from error
    if stat.S_ISDIR(status.st_mode):
        raise OptionError(f"cannot write {str(path)!r}: it is a folder", remedy="Name a file.")
    if not stat.S_ISREG(status.st_mode):
        raise OptionError(
            f"cannot write {str(path)!r}: it is a pipe or a device, not a file",
            remedy="Name a file, or /dev/stdout.",
        )
    if not status.st_mode & _ANY_WRITES or not os.access(path, os.W_OK):
        raise OptionError(f"cannot write {str(path)!r}: it is read-only", remedy=_REMEDY)
    input_name = input_behind(path)
    if input_name is not None:
        raise OptionError(
            f"{str(path)!r} is the input {input_name!r} and would be overwritten",
            remedy="Give another file to write.",
        )


def check_machine_output(path: Path) -> None:
    """Refuse a path that is not a name for a machine file, or that must not be overwritten."""
    check_machine_name(path)
    check_output(path)


def check_machine_name(path: Path) -> None:
    """Refuse a path that does not end in .toml or is the name of a specification."""
    if path.suffix != ".toml" or path.name.endswith(".spec.toml"):
        raise OptionError(
            f"{str(path)!r} is no name for a machine file",
            remedy="Give one that ends in .toml and not in .spec.toml.",
        )


def is_stdout(path: Path) -> bool:
    """Return whether ``path`` is the present standard output and not a file to be replaced."""
    try:
        status, stdout_status = path.stat(), os.fstat(_STDOUT)
    except (OSError, ValueError):
        return False
    if str(path) in {"/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"}:
        return True
    return not stat.S_ISREG(stdout_status.st_mode) and os.path.samestat(status, stdout_status)


@dataclass(slots=True)
class _Move:
    """A temporary file to rename to its place, or (``made`` is None) a file to remove."""

    made: Path | None
    place: Path
    requested: Path


@dataclass(slots=True)
class _Together:
    """Files written and folders made in a block ``together`` that has not ended."""

    stack: ExitStack
    moves: list[_Move] = field(default_factory=list)
    folders: list[Path] = field(default_factory=list)
    unrequested: list[Path] = field(default_factory=list)  # made folders that no option named


@dataclass(slots=True)
class Appeared:
    """Files that have appeared, and the missing parent folders that were made for them."""

    files: list[Path] = field(default_factory=list)
    folders: list[Path] = field(default_factory=list)


_TOGETHER: ContextVar[_Together | None] = ContextVar("together", default=None)
_APPEARED: ContextVar[Appeared | None] = ContextVar("_APPEARED", default=None)


@contextmanager
def noting_outputs() -> Iterator[Appeared]:
    """Yield an object that collects the files that appear, and the folders made for them."""
    appeared = Appeared()
    mark = _APPEARED.set(appeared)
    try:
        yield appeared
    finally:
        _APPEARED.reset(mark)


@contextmanager
def together(*outputs: Path | None) -> Iterator[None]:
    """Let all files written within the block appear at its end, or none if it fails.

    A nested block joins the outer one: its files appear at the end of the outer block.

    Parameters
    ----------
    outputs
        Files whose missing folders are made; if the block fails, these folders are removed again.

    Raises
    ------
    OptionError
        If an output must not be overwritten.
    OSError
        If a file cannot be renamed to its place; the files renamed before it are restored.
    """
    if _TOGETHER.get() is not None:
        _make_folders(outputs)
        yield
        return
    with ExitStack() as stack:
        pending = _Together(stack)
        stack.callback(_unmake, pending)  # runs last, when the folders are empty again
        mark = _TOGETHER.set(pending)
        try:
            _make_folders(outputs)
            yield
        finally:
            _TOGETHER.reset(mark)
        with uninterrupted():
            _commit(pending)
            pending.folders.clear()
            appeared = _APPEARED.get()
            if appeared is not None:
                appeared.files += [move.place for move in pending.moves]
                appeared.folders += pending.unrequested


@contextmanager
def staged_file(path: Path) -> Iterator[IO[bytes]]:
    """Open a temporary file that becomes ``path`` at the end of ``together``, else of this block.

    The ``name`` of the opened file is its temporary path.

    Raises
    ------
    OptionError, OSError
        As for ``together``.
    """
    check_output(path)
    with together():
        pending = _pending()
        with naming(path, _real(path).parent):
            folder = Path(tempfile.gettempdir()) if is_stdout(path) else _made(_real(path).parent)
        with naming(path, folder), uninterrupted():  # note the file, so that it will be removed
            handle, name = tempfile.mkstemp(dir=folder, prefix=f".{path.name[:_PREFIX]}.")
            temporary = Path(name)
            pending.stack.callback(temporary.unlink, missing_ok=True)
        os.close(handle)
        with naming(path, temporary), temporary.open("wb") as file:
            yield file
        _grant(temporary, path)
        pending.moves.append(_Move(temporary, _real(path), path))


@contextmanager
def staging_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder whose files appear in ``folder`` at the end of ``together``.

    Raises
    ------
    OptionError, OSError
        As for ``together``.
    """
    with together():
        pending = _pending()
        real_folder = _real(folder)
        with naming(folder, real_folder), uninterrupted():  # note made folders, to remove them
            home = _made(real_folder, requested=True)
            temporary = tempfile.TemporaryDirectory(dir=home, prefix=".threadline-")
            temporary_path = Path(pending.stack.enter_context(temporary))
        with naming(folder, temporary_path):
            yield temporary_path
        for file in sorted(temporary_path.iterdir()):
            check_output(folder / file.name)
            pending.moves.append(_Move(file, _real(folder / file.name), folder / file.name))


def remove_with(path: Path) -> None:
    """Remove ``path`` when the other files of the block ``together`` appear."""
    _pending().moves.append(_Move(None, path, path))


def content_of(path: Path) -> Path:
    """Return the file that holds the bytes of ``path`` now: until it appears a temporary file."""
    pending = _TOGETHER.get()
    staged = [m.made for m in pending.moves if m.requested == path and m.made] if pending else []
    return staged[-1] if staged else path


def _pending() -> _Together:
    pending = _TOGETHER.get()
    assert pending is not None, "outside of together()"
    return pending


def _real(path: Path) -> Path:
    return Path(os.path.realpath(path))


def _made(folder: Path, *, requested: bool = False) -> Path:
    """Make ``folder`` and its parents; they are removed again if the block ``together`` fails.

    Parameters
    ----------
    requested
        Whether the user named this folder itself, and not a file in it.
    """
    missing = [p for p in (folder, *folder.parents) if not os.path.lexists(p)]
    for missing_folder in reversed(missing):
        with uninterrupted():
            missing_folder.mkdir()
            _pending().folders.append(missing_folder)
            if not requested or missing_folder != folder:
                _pending().unrequested.append(missing_folder)
    return folder


def _make_folders(outputs: Iterable[Path | None]) -> None:
    for path in outputs:
        if path is not None and not is_stdout(path):
            _made(_real(path).parent)


def _unmake(pending: _Together) -> None:
    for folder in reversed(pending.folders):
        with suppress(OSError):  # the folder may contain other files now
            folder.rmdir()


def _grant(temporary: Path, path: Path) -> None:
    """Give a new file the usual permissions, or the permissions of the file that it replaces."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError:
        mask = os.umask(0)
        os.umask(mask)
        mode = 0o666 & ~mask
    temporary.chmod(mode)


def _commit(pending: _Together) -> None:
    """Put every file in its place; if that fails for one file, restore all files."""
    undo: list[tuple[Path, Path | None]] = []  # each place, and the backup of its old file
    to_stdout = []
    places: dict[Path, Path] = {}
    for move in pending.moves:
        check_output(move.requested)  # again: files may have been read or folders made since then
        other_request = places.setdefault(move.place, move.requested)
        if move.made is not None and places[move.place] is not move.requested:
            raise OptionError(
                f"{str(move.requested)!r} is written twice, as {str(other_request)!r} too",
                remedy=_REMEDY,
            )
        if move.made is not None and is_stdout(move.requested):
            to_stdout.append(move.made)
    try:
        for move in pending.moves:
            if move.made in to_stdout or (move.made is None and not move.place.exists()):
                continue
            with naming(move.requested, move.made or move.place):
                backup = _backup(move, pending.stack)
                undo.append((move.place, backup))
                if move.made is None:
                    move.place.unlink()
                else:
                    move.made.replace(move.place)
        for made in to_stdout:
            with made.open("rb") as file:
                shutil.copyfileobj(file, sys.stdout.buffer)
            sys.stdout.flush()
    except BaseException:
        for place, backup in reversed(undo):
            with suppress(OSError):
                place.unlink(missing_ok=True) if backup is None else backup.replace(place)
        raise


def _backup(move: _Move, stack: ExitStack) -> Path | None:
    """Back up the file at ``move.place`` beside it; return the backup, None if there is no file."""
    if not move.place.exists():
        return None
    folder = tempfile.TemporaryDirectory(
        dir=move.place.parent, prefix=f".{move.place.name[:_PREFIX]}."
    )
    backup = Path(stack.enter_context(folder)) / "old"
    try:
        os.link(move.place, backup)
    except OSError:  # a file system without links
        shutil.copy2(move.place, backup)
    return backup


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold back SIGINT, SIGTERM and SIGHUP until the end of the block."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[tuple[int, FrameType | None]] = []
    handlers = {
        number: signal.signal(number, lambda *arguments: received.append(arguments))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        if callable(signal.getsignal(number))
    }
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for arguments in received[:1]:
            handler = handlers[signal.Signals(arguments[0])]
            if callable(handler):
                handler(*arguments)
