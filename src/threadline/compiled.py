"""``njit`` with a cache on disk that several processes, and changed files, cannot mislead.

numba writes the index of a function before the machine code that the index names, and gives the
code of two processes the same name. A process that comes in between runs code of the file as it was
before, or of other types. It also does not look at the files of functions that are called. Here
machine code is written first and named by what it was made from, called functions included.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType
from typing import Any, BinaryIO, TypeVar

import numba
from numba.core.caching import IndexDataCacheFile
from numba.core.dispatcher import Dispatcher
from numba.core.event import Event, Listener, register

from threadline.compiling import COMPILING

__all__ = ["njit"]

F = TypeVar("F", bound=Callable[..., Any])
_PLAIN = (bool, int, float, complex, str, bytes, tuple)


class CacheFile(IndexDataCacheFile):
    """An index, and files of machine code whose names say what they were made from."""

    def save(self, key: Hashable, data: object) -> None:
        """Write machine code, then name it in the index; a loser of a race compiles once more."""
        made_from = repr((self._version, self._source_stamp, key)).encode()
        name = self._data_name_pattern.replace(
            "{number:d}", hashlib.sha256(made_from).hexdigest()[:16]
        )
        inherited: Any = self  # numba has types for some of itself
        inherited._save_data(name, data)
        known = inherited._load_index()
        known[key] = name
        inherited._save_index(known)
        self._forget(set(known.values()))

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[BinaryIO]:
        """Write beside the file, then take its place; an interrupt leaves no half of it."""
        part = Path(f"{filepath}.tmp.{uuid.uuid4().hex[:16]}")
        try:
            with part.open("wb") as file:
                yield file
            part.replace(filepath)
        finally:
            part.unlink(missing_ok=True)

    def _forget(self, kept: set[str]) -> None:
        """Remove machine code of files as they were; who still wants it compiles once more."""
        for file in Path(self._cache_path).glob(self._data_name_pattern.replace("{number:d}", "*")):
            if file.name not in kept:
                file.unlink(missing_ok=True)


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
    """Compile the function that is given next, as ``numba.njit``; its machine code is kept."""

    def compiled(function: F) -> Dispatcher[F]:
        found: Dispatcher[F] = numba.njit(cache=True, **options)(function)
        _keep_safely(found)
        return found

    return compiled


def _keep_safely(function: Any) -> None:
    cache = function._cache
    own = cache._cache_file
    made: Callable[..., CacheFile] = CacheFile
    cache._cache_file = made(
        cache_path=own._cache_path,
        filename_base=cache._impl.filename_base,
        source_stamp=(own._source_stamp, _used_by(function.py_func, {function})),
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
