"""Blocks made by a function of a test, which need not be sent anywhere as those of a stream do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any


class Made:
    """Reads as a stream does: each reading calls ``function`` anew."""

    def __init__(self, function: Callable[[], Iterator[Any]]) -> None:
        self._function = function

    def __iter__(self) -> Iterator[Any]:
        return self._function()
