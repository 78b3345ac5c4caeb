"""One stream for two readers who take it in step: it is read once."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class Fork(Generic[T]):
    """Items that two readers get, each in order; what one has not taken yet is kept for it.

    >>> fork = Fork(iter("abc"))
    >>> one, other = iter(fork.first), iter(fork.second)
    >>> next(one), next(one), next(other)
    ('a', 'b', 'a')
    >>> fork.second.leave()
    >>> list(one), list(other)
    (['c'], [])

    Parameters
    ----------
    items
        Read once, when the first of the two asks.
    """

    def __init__(self, items: Iterable[T]) -> None:
        self._items = items
        self._source: Iterator[T] | None = None
        self.first: Branch[T] = Branch(self)
        self.second: Branch[T] = Branch(self)

    def pull(self) -> bool:
        """Put the next item before both readers; return whether there was one."""
        if self._source is None:
            self._source = iter(self._items)
        for item in self._source:
            self.first.put(item)
            self.second.put(item)
            return True
        return False


class Branch(Generic[T]):
    """What one of the two readers gets."""

    def __init__(self, fork: Fork[T]) -> None:
        self._fork = fork
        self._waiting: deque[T] = deque()
        self._left = False

    def __iter__(self) -> Iterator[T]:
        while not self._left and (self._waiting or self._fork.pull()):
            yield self._waiting.popleft()

    def put(self, item: T) -> None:
        """Keep an item for this reader, unless it has left."""
        if not self._left:
            self._waiting.append(item)

    def leave(self) -> None:
        """Take no more: nothing is kept for this reader from now on."""
        self._left = True
        self._waiting.clear()
