"""Re-iterable streams: how a job of any length passes through bounded memory."""

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
    """A source that can be read again and again; each reading starts from the beginning.

    Stages hand each other streams of blocks instead of lists, so that nothing but the block in
    hand has to be in memory, and a second pass (for a scale, or for the judge) is just another
    ``for``.

    A stream is a recipe, a function and what it is called with, and never a closure: it can be
    pickled, and another process reads the same from it.

    >>> numbers = Stream(reversed, (1, 2, 3))
    >>> list(numbers), list(numbers)
    ([3, 2, 1], [3, 2, 1])

    Parameters
    ----------
    function
        Called once per reading with the arguments; returns a fresh iterator. A function or a
        class that its module names.
    arguments, keywords
        What it is called with.

    Raises
    ------
    TypeError
        If the function or an argument is a lambda or nested in another function, so that another
        process could not find it; or if an argument can be read once only.
    """

    __slots__ = ("_arguments", "_function", "_keywords")

    def __init__(
        self, function: Callable[P, Iterator[T]], *arguments: P.args, **keywords: P.kwargs
    ) -> None:
        for what in (function, *arguments, *keywords.values()):
            _check_travels(what)
        self._function = function
        self._arguments = arguments
        self._keywords = keywords

    def __iter__(self) -> Iterator[T]:
        return self._function(*self._arguments, **self._keywords)

    @classmethod
    def of(cls, items: Iterable[T]) -> Stream[T]:
        """Return a stream over ``items``, which are kept in memory."""
        return Stream(_kept, tuple(items))


class KeptStream(Stream[SizedT]):
    """A stream of blocks that will be read many times: a short one is worked out once and kept.

    What one reading worked out is there for every other, side by side or later, unless it has more
    than ``MOST_KEPT`` rows in all. What is kept does not travel: another process reads anew.
    Whoever reads gets the same blocks, so they must be locked.

    >>> lengths = KeptStream(iter, ("abc", "de"))
    >>> list(lengths) == list(lengths) == ["abc", "de"]
    True
    """

    MOST_KEPT = 2048

    __slots__ = ("_ended", "_items", "_lock", "_rows", "_source")

    def __init__(
        self, function: Callable[P, Iterator[SizedT]], *arguments: P.args, **keywords: P.kwargs
    ) -> None:
        super().__init__(function, *arguments, **keywords)
        self._begin()

    def _begin(self) -> None:
        self._items: list[SizedT] = []  # what was worked out, from the beginning on
        self._source: Iterator[SizedT] | None = None  # works out what follows
        self._rows = 0  # more than ``MOST_KEPT`` where every reading is one of its own
        self._ended = False
        self._lock = Lock()

    def __iter__(self) -> Iterator[SizedT]:
        return iter(tuple(self._items)) if self._ended else self._reading()

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in Stream.__slots__}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            setattr(self, name, value)
        self._begin()

    def _reading(self) -> Iterator[SizedT]:
        items, taken = self._items, 0
        rest: Iterator[SizedT] | None = None
        while rest is None:
            while taken < len(items):
                yield items[taken]
                taken += 1
            with self._lock:
                if taken < len(items):
                    continue
                if self._ended:
                    return
                rest = self._extend() if self._rows <= self.MOST_KEPT else self._behind(taken)
        yield from rest

    def _behind(self, taken: int) -> Iterator[SizedT]:
        return islice(super().__iter__(), taken, None)

    def _extend(self) -> Iterator[SizedT] | None:
        """Work out the next item; return it, and what follows, where they are too many to keep."""
        source = super().__iter__() if self._source is None else self._source
        rows = self._rows
        self._source, self._rows = None, self.MOST_KEPT + 1  # should it fail
        item = next(source, None)
        if item is not None and rows + len(item) > self.MOST_KEPT:
            self._items = []  # whoever reads has those that it has yet to read
            return chain((item,), source)
        self._ended = item is None
        if item is not None:
            self._items.append(item)
            self._source, self._rows = source, rows + len(item)
        return None


def _kept(items: tuple[T, ...]) -> Iterator[T]:
    return iter(items)


def _check_travels(what: object) -> None:
    """Refuse what another process could not make again from its name."""
    if isinstance(what, partial):
        for part in (what.func, *what.args, *what.keywords.values()):
            _check_travels(part)
    if isinstance(what, MethodType):
        _check_travels(what.__self__)
        what = what.__func__
    named = what if isinstance(what, FunctionType | type) else type(what)
    if "<" in named.__qualname__:
        raise TypeError(
            f"a stream cannot be made of {named.__qualname__}: another process would not find it. "
            "Put it into its module, and give what it needs from around it as arguments: "
            "Stream(function, *arguments)."
        )
    if isinstance(what, Iterator):
        raise TypeError(
            f"a stream cannot be made of a {named.__qualname__}: it can be read once only. "
            "Give what it is made from."
        )
