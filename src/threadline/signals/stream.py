"""Re-iterable streams: how a job of any length passes through bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sized
from functools import partial
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

    The first reading that comes to the end keeps its blocks, unless they have more than
    ``MOST_KEPT`` rows in all. What is kept does not travel: another process reads anew. Whoever
    reads gets the same blocks, so they must be locked.

    >>> lengths = KeptStream(iter, ("abc", "de"))
    >>> list(lengths) == list(lengths) == ["abc", "de"]
    True
    """

    MOST_KEPT = 2048

    __slots__ = ("_items",)

    def __init__(
        self, function: Callable[P, Iterator[SizedT]], *arguments: P.args, **keywords: P.kwargs
    ) -> None:
        super().__init__(function, *arguments, **keywords)
        self._items: tuple[SizedT, ...] | None = None

    def __iter__(self) -> Iterator[SizedT]:
        return self._reading() if self._items is None else iter(self._items)

    def __getstate__(self) -> tuple[None, dict[str, Any]]:
        names = Stream.__slots__
        return None, {"_items": None} | {name: getattr(self, name) for name in names}

    def _reading(self) -> Iterator[SizedT]:
        items: list[SizedT] = []
        rows = 0
        for item in super().__iter__():
            rows += len(item)
            if rows <= self.MOST_KEPT:
                items.append(item)
            else:
                items.clear()
            yield item
        if rows <= self.MOST_KEPT:
            self._items = tuple(items)


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
