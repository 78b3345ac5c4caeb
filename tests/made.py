"""Blocks made by a function of a test, which need not be sent anywhere as those of a stream do.

And those of a recording, read once for all that a test wants of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from threadline.files import Recording


class Made:
    """Reads like a stream: each reading calls ``function`` anew."""

    def __init__(self, function: Callable[[], Iterator[Any]]) -> None:
        self._function = function

    def __iter__(self) -> Iterator[Any]:
        return self._function()


def read_once(recording: Recording) -> Recording:
    """Return a recording with its blocks in memory.

    Otherwise each requested channel would read them all: from a file, or by a new simulation.
    """
    return replace(recording, blocks=tuple(recording))
