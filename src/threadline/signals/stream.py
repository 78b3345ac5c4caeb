"""Re-iterable streams: how a job of any length passes through bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class Stream(Generic[T]):
    """A source that can be read again and again; each reading starts from the beginning.

    Stages hand each other streams of blocks instead of lists, so that nothing but the block in
    hand has to be in memory, and a second pass (for a scale, or for the judge) is just another
    ``for``.

    >>> numbers = Stream(lambda: iter(range(3)))
    >>> list(numbers), list(numbers)
    ([0, 1, 2], [0, 1, 2])

    Parameters
    ----------
    start
        Called once per reading; returns a fresh iterator.
    """

    __slots__ = ("_start",)

    def __init__(self, start: Callable[[], Iterator[T]]) -> None:
        self._start = start

    def __iter__(self) -> Iterator[T]:
        return self._start()

    @classmethod
    def of(cls, items: Iterable[T]) -> Stream[T]:
        """Return a stream over ``items``, which are kept in memory."""
        kept = tuple(items)
        return cls(lambda: iter(kept))
