"""``njit`` with a cache on disk that is safe with several processes and after changes of files.

numba writes the index of a function before the machine code that the index names, and the machine
code of two processes gets the same file name. Another process may then run code of an older source
file, or code for other types. numba also ignores changes in the files of called functions. This
module writes the machine code first. The name of its file contains a digest of its sources,
including called functions. If several processes need the same function, one process compiles it and
the others wait.

numba would also run a file that a power failure or a bad disk has damaged. Here every file begins
with a digest of its content; a file with a wrong digest is compiled again.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import time
import uuid
from collections.abc import Callable, Hashable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from types import CodeType
from typing import Any, BinaryIO, TypeVar

from threadline.base.progress import COMPILING
from threadline.base.writing import uninterrupted
from threadline.errors import OptionError

try:
    import numba
    from numba.core.caching import CompileResultCacheImpl, IndexDataCacheFile
    from numba.core.dispatcher import Dispatcher
    from numba.core.event import Event, Listener, register
except ValueError as error:  # NUMBA_NUM_THREADS=0, for instance
    raise OptionError(
        f"the compiler numba refuses the settings in the environment: {error}",
        remedy="Correct or unset the variables whose names begin with NUMBA_.",
    ) from error

if sys.platform != "win32":
    import fcntl

_config: Any = numba.config  # numba has no types for it
if _config.DISABLE_JIT:
    raise OptionError(
        "NUMBA_DISABLE_JIT is set, but simulations and plans need compiled code",
        remedy="Unset it.",
    )

__all__ = ["FileLock", "cache_folder", "njit"]

F = TypeVar("F", bound=Callable[..., Any])
LOCK_TIMEOUT_S = 120.0
"""Longest wait for the machine code of another process; after that this process compiles it."""
_POLL_S = 0.02
_CONSTANT_TYPES = (bool, int, float, complex, str, bytes, tuple)


class FileLock:
    """A file that one process locks until it deletes this object, if the system has file locks.

    Other processes wait at most ``LOCK_TIMEOUT_S``, because the owner may have been suspended.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._file = path, -1
        if sys.platform == "win32":
            return
        end_s = time.monotonic() + LOCK_TIMEOUT_S
        # Work goes on without a lock if the file cannot be written or locked.
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_CREAT | os.O_RDWR)
            while time.monotonic() < end_s:
                try:
                    fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    time.sleep(_POLL_S)
                else:
                    break

    def remove(self) -> None:
        """Remove the file, so that no process waits for it."""
        with suppress(OSError):
            self._path.unlink(missing_ok=True)

    def __del__(self) -> None:
        if self._file >= 0:
            os.close(self._file)


class CacheFile(IndexDataCacheFile):
    """An index, and files of machine code whose names contain a digest of their sources.

    A process that finds no machine code compiles it. Other processes that need the same code wait
    until this process calls ``save`` or ends.
    """

    def load(self, key: Hashable) -> Any:
        """Return the machine code of a key; None if the caller has to compile it."""
        inherited: Any = super()  # numba has types for some of itself
        machine_code = inherited.load(key)
        if machine_code is not None or key in self._locks_here:
            return machine_code
        lock = FileLock(Path(self._cache_path) / f"{self._name_of(key)}.lock")
        machine_code = inherited.load(key)
        if machine_code is None:
            self._locks_here[key] = lock
        return machine_code

    def save(self, key: Hashable, data: object) -> None:
        """Write machine code, then its index entry.

        If two processes write the index at the same time, one entry is lost, and a process that
        needs it compiles again.
        """
        name = self._name_of(key)
        inherited: Any = self
        try:
            # If it cannot be written, the next process compiles again.
            with suppress(OSError):
                inherited._save_data(name, data)
                index = self._load_index()
                index[key] = name
                inherited._save_index(index)
                self._remove_older(set(index.values()))
        finally:
            lock = self._locks_here.pop(key, None)
            if lock is not None:
                lock.remove()

    @property
    def _locks_here(self) -> dict[Hashable, FileLock]:
        """Locks of the machine code that this process has to compile."""
        locks: dict[Hashable, FileLock] = self.__dict__.setdefault("_made_here", {})
        return locks

    def _name_of(self, key: Hashable) -> str:
        made_from = repr((self._version, self._source_stamp, key)).encode()
        digest = hashlib.sha256(made_from).hexdigest()[:16]
        return str(self._data_name_pattern.replace("{number:d}", digest))

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[BinaryIO]:
        """Write a temporary file, then rename it; an interrupt leaves no partial file."""
        temporary = Path(f"{filepath}.tmp.{uuid.uuid4().hex[:16]}")
        try:
            content = BytesIO()
            yield content
            with temporary.open("wb") as file:
                file.write(_digest(content.getvalue()))
                file.write(content.getbuffer())
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(filepath)
        finally:
            temporary.unlink(missing_ok=True)

    def _load_index(self) -> dict[Hashable, str]:
        """Return key -> file name; empty if the index is missing or damaged."""
        try:
            content = BytesIO(_checked(Path(self._index_path)))
        except OSError:
            return {}
        if pickle.load(content) != self._version:  # noqa: S301  its digest is the one we wrote
            return {}
        stamp, names = pickle.load(content)  # noqa: S301
        return dict(names) if stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> Any:
        """Return machine code; raise OSError if the file is missing or damaged."""
        return pickle.loads(_checked(Path(self._cache_path) / name))  # noqa: S301

    def _remove_older(self, current_names: set[str]) -> None:
        """Remove machine code of older sources; a process that still needs it compiles again."""
        for file in Path(self._cache_path).glob(self._data_name_pattern.replace("{number:d}", "*")):
            if file.name not in current_names:
                file.unlink(missing_ok=True)


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).digest()


def _checked(path: Path) -> bytes:
    """Return the content that follows the digest in a file; raise OSError if they disagree."""
    content = path.read_bytes()
    size = hashlib.sha256().digest_size
    digest, body = content[:size], content[size:]
    if digest != _digest(body):
        raise OSError(f"{path} does not have its digest")
    return body


class _CompileTimer(Listener):
    """Reports to ``COMPILING`` the start and end of every compilation."""

    def on_start(self, event: Event) -> None:
        """Report the start of a compilation, and the module of the compiled function."""
        COMPILING.begin(event.data["dispatcher"].py_func.__module__)

    def on_end(self, event: Event) -> None:  # noqa: ARG002
        """Report the end of a compilation, with or without success."""
        COMPILING.end()


class _InterruptHold(Listener):
    """Holds back interrupts while numba passes modules to LLVM.

    llvmlite notes only after the call that a module now belongs to LLVM. An exception between the
    call and the note would let the module be freed twice, which ends the process by SIGSEGV.
    """

    def __init__(self) -> None:
        self._held: list[ExitStack] = []  # numba compiles in one thread at a time

    def on_start(self, event: Event) -> None:
        """Hold interrupts back from the start of a pass that writes machine code."""
        if _writes_machine_code(event):
            stack = ExitStack()
            stack.enter_context(uninterrupted())
            self._held.append(stack)

    def on_end(self, event: Event) -> None:
        """Raise the interrupt that came during the outermost pass, if any."""
        if _writes_machine_code(event) and self._held:
            self._held.pop().close()


def _writes_machine_code(event: Event) -> bool:
    return str(event.data["name"]).startswith("native_lowering")


_register: Any = register  # numba has no types for it
_register("numba:compile", _CompileTimer())
_register("numba:run_pass", _InterruptHold())


def njit(**options: Any) -> Callable[[F], Dispatcher[F]]:
    """Decorate a function like ``numba.njit``, with the cache of this module.

    Division by zero gives infinity or NaN, as in numpy: Python's check of each divisor would take a
    sixth of the compile time, and a block of a trajectory refuses values that are not finite. No
    wrappers for C are made, because nothing calls these functions from C, and wrappers would take
    another tenth of the compile time.
    """
    options = {"error_model": "numpy", "no_cfunc_wrapper": True, **options}

    def compiled(function: F) -> Dispatcher[F]:
        dispatcher: Dispatcher[F] = numba.njit(**options)(function)
        if _is_cacheable(dispatcher):
            _use_cache_file(dispatcher, repr(sorted(options.items())))
        else:
            COMPILING.cached = False
        _prepare_first(dispatcher)
        return dispatcher

    return compiled


def cache_folder(function: Callable[..., Any]) -> Path | None:
    """Return the cache folder of a function's file; None if no folder can be written.

    It is NUMBA_CACHE_DIR if that is set, else a folder beside the source file, else the user's
    cache folder if the source folder is read-only.
    """
    untyped: Any = CompileResultCacheImpl
    try:
        return Path(untyped(function).locator.get_cache_path())
    except RuntimeError:
        return None


def _is_cacheable(function: Any) -> bool:
    """Turn on numba's cache of a function; False if none of its folders can be written."""
    try:
        function.enable_caching()
    except RuntimeError as error:
        if str(error).startswith("cannot cache function"):
            return False
        raise OptionError(
            f"the compiler numba refuses the settings in the environment: {error}",
            remedy="Correct or unset the variables whose names begin with NUMBA_.",
        ) from error
    return True


def _use_cache_file(function: Any, options: str) -> None:
    cache = function._cache
    numba_file = cache._cache_file
    make_cache_file: Callable[..., CacheFile] = CacheFile
    cache._cache_file = make_cache_file(
        cache_path=numba_file._cache_path,
        filename_base=cache._impl.filename_base,
        source_stamp=(numba_file._source_stamp, options, _used_by(function.py_func, {function})),
    )


def _prepare_first(function: Any) -> None:
    """Let the first function that a process loads or compiles prepare numba uninterrupted."""
    load = function._cache.load_overload

    def prepared(signature: object, context: Any) -> Any:
        _prepare(context)
        return load(signature, context)

    function._cache.load_overload = prepared


@lru_cache
def _prepare(context: Any) -> None:
    with uninterrupted():
        context.refresh()


def _used_by(function: Callable[..., Any], seen: set[Any]) -> tuple[Hashable, ...]:
    """Return the sources of ``function``'s machine code other than its file.

    These are the constants of its module that it uses, and the files of the compiled functions that
    it calls, directly or through other functions.
    """
    sources: list[Hashable] = []
    for name in sorted(_names(function.__code__)):
        value: Any = function.__globals__.get(name)
        is_compiled: bool = isinstance(value, Dispatcher)
        if is_compiled:
            if value not in seen:
                seen.add(value)
                sources += [(name, value._cache._impl.locator.get_source_stamp())]
                sources += _used_by(value.py_func, seen)
        elif isinstance(value, _CONSTANT_TYPES):
            sources.append((name, repr(value)))
    return tuple(sources)


def _names(code: CodeType) -> set[str]:
    """Return the global names that a function and its inner functions use."""
    inner = (c for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*map(_names, inner))
