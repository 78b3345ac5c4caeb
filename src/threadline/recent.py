"""What was made last, for a search that asks for the same things again and again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

K = TypeVar("K")
V = TypeVar("V")


class Recent(Generic[K, V]):
    """The last things that were made, each with what it was made of.

    Threads that ask side by side may lose one, and make it again.

    Parameters
    ----------
    most
        Number of things that are kept.
    alike
        Says whether the same would be made of two.
    """

    def __init__(self, most: int, alike: Callable[[K, K], bool]) -> None:
        self._most, self._alike = most, alike
        self._known: tuple[tuple[K, V], ...] = ()

    def of(self, key: K, make: Callable[[], V]) -> V:
        """Return what was made of ``key`` or one like it; else make it, and keep it."""
        for known, made in self._known:
            if self._alike(known, key):
                return made
        made = make()
        self._known = ((key, made), *self._known[: self._most - 1])
        return made
