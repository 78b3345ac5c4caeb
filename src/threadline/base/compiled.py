"""``njit`` with a cache on disk that several processes, and changed files, cannot mislead.

numba writes the index of a function before the machine code that the index names, and gives the
code of two processes the same name. A process that comes in between runs code of the file as it was
before, or of other types. It also does not look at the files of functions that are called. Here
machine code is written first and named by what it was made from, called functions included. Of
processes that want the same function at once, one compiles it and the others wait for it.

numba runs what it finds in a file, whatever a loss of power or a bad disk made of it. Here every
file begins with a digest of the rest; a file that does not have its digest is made again.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import time
import uuid
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from types import CodeType
from typing import Any, BinaryIO, TypeVar

from threadline.base.progress import COMPILING
from threadline.errors import OptionError

try:
    import numba
    from numba.core.caching import CompileResultCacheImpl, IndexDataCacheFile
    from numba.core.dispatcher import Dispatcher
    from numba.core.event import Event, Listener, register
except ValueError as error:  # NUMBA_NUM_THREADS=0, for instance
    raise OptionError(
        f"the compiler numba refuses its settings in the environment: {error}",
        remedy="Correct or unset the variables whose names begin with NUMBA_.",
    ) from error

if sys.platform != "win32":
    import fcntl

_config: Any = numba.config  # numba has no types for it
if _config.DISABLE_JIT:
    raise OptionError(
        "NUMBA_DISABLE_JIT is set: simulations and plans run as machine code alone",
        remedy="Unset it.",
    )

__all__ = ["FileLock", "njit", "where_kept"]

F = TypeVar("F", bound=Callable[..., Any])
WAITS_S = 120.0
"""How long a process waits for another's machine code; it compiles for itself after that."""
_LOOKS_EACH_S = 0.02
_PLAIN = (bool, int, float, complex, str, bytes, tuple)


class FileLock:
    """A file that one process locks until it forgets this object, where files can be locked.

    Others wait, though not for ever: a process may have been stopped.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._file = path, -1
        if sys.platform == "win32":
            return
        end_s = time.monotonic() + WAITS_S
        # It goes on where the file cannot be written, or its file system has no locks.
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_CREAT | os.O_RDWR)
            while time.monotonic() < end_s:
                try:
                    fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    time.sleep(_LOOKS_EACH_S)
                else:
                    break

    def remove(self) -> None:
        """Remove the file: nobody has to wait any more."""
        with suppress(OSError):
            self._path.unlink(missing_ok=True)

    def __del__(self) -> None:
        if self._file >= 0:
            os.close(self._file)


class CacheFile(IndexDataCacheFile):
    """An index, and files of machine code whose names say what they were made from.

    Who finds no machine code is the one to make it, until ``save`` or the end of its process; who
    looks for the same in the meantime waits.
    """

    def load(self, key: Hashable) -> Any:
        """Return the machine code of a key; None if whoever asks has to make it."""
        inherited: Any = super()  # numba has types for some of itself
        found = inherited.load(key)
        if found is not None or key in self._making:
            return found
        lock = FileLock(Path(self._cache_path) / f"{self._name_of(key)}.lock")
        found = inherited.load(key)
        if found is None:
            self._making[key] = lock
        return found

    def save(self, key: Hashable, data: object) -> None:
        """Write machine code, then name it in the index; a loser of a race compiles once more."""
        name = self._name_of(key)
        inherited: Any = self
        try:
            # It goes on where it cannot be kept: the next process compiles it, too.
            with suppress(OSError):
                inherited._save_data(name, data)
                known = self._load_index()
                known[key] = name
                inherited._save_index(known)
                self._forget(set(known.values()))
        finally:
            lock = self._making.pop(key, None)
            if lock is not None:
                lock.remove()

    @property
    def _making(self) -> dict[Hashable, FileLock]:
        """What this process has to make."""
        found: dict[Hashable, FileLock] = self.__dict__.setdefault("_made_here", {})
        return found

    def _name_of(self, key: Hashable) -> str:
        made_from = repr((self._version, self._source_stamp, key)).encode()
        digest = hashlib.sha256(made_from).hexdigest()[:16]
        return str(self._data_name_pattern.replace("{number:d}", digest))

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[BinaryIO]:
        """Write beside the file, then take its place; an interrupt leaves no half of it."""
        part = Path(f"{filepath}.tmp.{uuid.uuid4().hex[:16]}")
        try:
            content = BytesIO()
            yield content
            with part.open("wb") as file:
                file.write(_digest(content.getvalue()))
                file.write(content.getbuffer())
                file.flush()
                os.fsync(file.fileno())
            part.replace(filepath)
        finally:
            part.unlink(missing_ok=True)

    def _load_index(self) -> dict[Hashable, str]:
        """Return the names of what is kept by its key; nothing where the index is not whole."""
        try:
            content = BytesIO(_checked(Path(self._index_path)))
        except OSError:
            return {}
        if pickle.load(content) != self._version:  # noqa: S301  its digest is the one we wrote
            return {}
        stamp, names = pickle.load(content)  # noqa: S301
        return dict(names) if stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> Any:
        """Return machine code; an OSError says that it is not there, or not whole."""
        return pickle.loads(_checked(Path(self._cache_path) / name))  # noqa: S301

    def _forget(self, kept: set[str]) -> None:
        """Remove machine code of files as they were; who still wants it compiles once more."""
        for file in Path(self._cache_path).glob(self._data_name_pattern.replace("{number:d}", "*")):
            if file.name not in kept:
                file.unlink(missing_ok=True)


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).digest()


def _checked(path: Path) -> bytes:
    """Return what is behind the digest of a file; an OSError says that they do not agree."""
    content = path.read_bytes()
    size = hashlib.sha256().digest_size
    digest, rest = content[:size], content[size:]
    if digest != _digest(rest):
        raise OSError(f"{path} does not have its digest")
    return rest


class _Clock(Listener):
    """Tells ``COMPILING`` when functions are compiled that are not on disk yet."""

    def on_start(self, event: Event) -> None:  # noqa: ARG002
        """Note the start."""
        COMPILING.begin()

    def on_end(self, event: Event) -> None:  # noqa: ARG002
        """Note the end, with or without success."""
        COMPILING.end()


_register: Any = register  # numba has no types for it
_register("numba:compile", _Clock())


def njit(**options: Any) -> Callable[[F], Dispatcher[F]]:
    """Compile the function that is given next, as ``numba.njit``; its machine code is kept.

    It divides as numpy does: what is divided by zero is infinite, or no number. A look at each
    divisor, as Python's, would be a sixth of the work of compiling; a block of a trajectory refuses
    what is not finite.
    """
    options = {"error_model": "numpy", **options}

    def compiled(function: F) -> Dispatcher[F]:
        found: Dispatcher[F] = numba.njit(cache=True, **options)(function)
        _keep_safely(found, repr(sorted(options.items())))
        return found

    return compiled


def where_kept(function: Callable[..., Any]) -> Path | None:
    """Return the folder where machine code of a function's file is kept; None where it cannot be.

    That is beside the file, in the user's folder for caches where that cannot be written, or where
    NUMBA_CACHE_DIR says.
    """
    untyped: Any = CompileResultCacheImpl
    try:
        return Path(untyped(function).locator.get_cache_path())
    except RuntimeError:
        return None


def _keep_safely(function: Any, options: str) -> None:
    cache = function._cache
    own = cache._cache_file
    made: Callable[..., CacheFile] = CacheFile
    cache._cache_file = made(
        cache_path=own._cache_path,
        filename_base=cache._impl.filename_base,
        source_stamp=(own._source_stamp, options, _used_by(function.py_func, {function})),
    )


def _used_by(function: Callable[..., Any], seen: set[Any]) -> tuple[Hashable, ...]:
    """Return what machine code of ``function`` is made from beside its file.

    Constants of the module, and the files of compiled functions that it calls, which may call
    others.
    """
    found: list[Hashable] = []
    for name in sorted(_names(function.__code__)):
        value: Any = function.__globals__.get(name)
        called: bool = isinstance(value, Dispatcher)
        if called:
            if value not in seen:
                seen.add(value)
                found += [(name, value._cache._impl.locator.get_source_stamp())]
                found += _used_by(value.py_func, seen)
        elif isinstance(value, _PLAIN):
            found.append((name, repr(value)))
    return tuple(found)


def _names(code: CodeType) -> set[str]:
    """Return the names that a function, and those inside it, look up in the module."""
    inner = (c for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*map(_names, inner))
