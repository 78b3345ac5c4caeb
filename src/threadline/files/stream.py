"""Re-iterable streams: with them, a job of any length needs only bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sized
from functools import partial
from itertools import chain, islice
from threading import Lock
from types import FunctionType, MethodType
from typing import Any, Generic, ParamSpec, TypeVar

T = TypeVar("T")
SizedT = TypeVar("SizedT", bound=Sized)
P = ParamSpec("P")


class Stream(Generic[T]):
    """A source of blocks that can be read any number of times, each time from the beginning.

    Stages pass streams of blocks instead of lists, so that only the current block is in memory, and
    a second pass (for a scale, or for the judge) is another ``for`` loop.

    A stream consists of a function and its arguments, and never of a closure. It can therefore be
    pickled, and another process can read the same blocks from it.

    >>> numbers = Stream(reversed, (1, 2, 3))
    >>> list(numbers), list(numbers)
    ([3, 2, 1], [3, 2, 1])

    Parameters
    ----------
    function
        A function or class at the top level of a module. It is called with the arguments once per
        reading and returns a new iterator.
    arguments, keywords
        Arguments of the function.

    Raises
    ------
    TypeError
        If the function or an argument is a lambda or a nested function, which another process
        cannot find; or if an argument is an iterator, which can be read only once.
    """

    __slots__ = ("_arguments", "_function", "_keywords")

    def __init__(
        self, function: Callable[P, Iterator[T]], *arguments: P.args, **keywords: P.kwargs
    ) -> None:
        for part in (function, *arguments, *keywords.values()):
            _check_travels(part)
        self._function = function
        self._arguments = arguments
        self._keywords = keywords

    def __iter__(self) -> Iterator[T]:
        return self._function(*self._arguments, **self._keywords)

    @classmethod
    def of(cls, items: Iterable[T]) -> Stream[T]:
        """Return a stream over ``items``, which are kept in memory."""
        return Stream(_iterate, tuple(items))


class CachedStream(Stream[SizedT]):
    """A stream of blocks that is computed once and kept in memory, if it is short.

    All readings, simultaneous or later, share the blocks that the first reading computed. A stream
    with more than ``MOST_CACHED`` rows in total is computed anew for each reading. Kept blocks are
    not pickled: another process computes them again. Because readers share the blocks, the blocks
    must be locked.

    >>> lengths = CachedStream(iter, ("abc", "de"))
    >>> list(lengths) == list(lengths) == ["abc", "de"]
    True
    """

    MOST_CACHED = 2048

    __slots__ = ("_exhausted", "_items", "_lock", "_rows", "_source")

    def __init__(
        self, function: Callable[P, Iterator[SizedT]], *arguments: P.args, **keywords: P.kwargs
    ) -> None:
        super().__init__(function, *arguments, **keywords)
        self._begin()

    def _begin(self) -> None:
        self._items: list[SizedT] = []  # blocks computed so far
        self._source: Iterator[SizedT] | None = None  # computes the following blocks
        self._rows = 0  # if it exceeds ``MOST_CACHED``, every reading computes its own blocks
        self._exhausted = False
        self._lock = Lock()

    def __iter__(self) -> Iterator[SizedT]:
        return iter(tuple(self._items)) if self._exhausted else self._reading()

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in Stream.__slots__}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            setattr(self, name, value)
        self._begin()

    def _reading(self) -> Iterator[SizedT]:
        items, yielded_count = self._items, 0
        remaining: Iterator[SizedT] | None = None
        while remaining is None:
            while yielded_count < len(items):
                yield items[yielded_count]
                yielded_count += 1
            with self._lock:
                if yielded_count < len(items):
                    continue
                if self._exhausted:
                    return
                remaining = (
                    self._extend()
                    if self._rows <= self.MOST_CACHED
                    else self._behind(yielded_count)
                )
        yield from remaining

    @staticmethod
    def _rows_of(item: SizedT) -> int:
        return len(item)

    def _behind(self, yielded_count: int) -> Iterator[SizedT]:
        return islice(super().__iter__(), yielded_count, None)

    def _extend(self) -> Iterator[SizedT] | None:
        """Compute the next item; if there are too many to keep, return it and all further items."""
        source = super().__iter__() if self._source is None else self._source
        rows = self._rows
        self._source, self._rows = None, self.MOST_CACHED + 1  # in case it raises
        item = next(source, None)
        item_rows = 0 if item is None else self._rows_of(item)
        if item is not None and rows + item_rows > self.MOST_CACHED:
            self._items = []  # readers hold their own reference to the old list
            return chain((item,), source)
        self._exhausted = item is None
        if item is not None:
            self._items.append(item)
            self._source, self._rows = source, rows + item_rows
        return None


def _iterate(items: tuple[T, ...]) -> Iterator[T]:
    return iter(items)


def _check_travels(value: object) -> None:
    """Refuse an object that another process could not unpickle."""
    if isinstance(value, partial):
        for part in (value.func, *value.args, *value.keywords.values()):
            _check_travels(part)
    if isinstance(value, MethodType):
        _check_travels(value.__self__)
        value = value.__func__
    named_type = value if isinstance(value, FunctionType | type) else type(value)
    if "<" in named_type.__qualname__:
        raise TypeError(
            f"a stream cannot use {named_type.__qualname__}: another process would not find it. "
            "Define it at the top level of its module and pass the values that it needs: "
            "Stream(function, *arguments)."
        )
    if isinstance(value, Iterator):
        raise TypeError(
            f"a stream cannot use a {named_type.__qualname__}, which can be read only once. "
            "Pass the source of the iterator."
        )
