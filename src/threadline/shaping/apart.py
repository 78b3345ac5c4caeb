"""Modes far apart: how far at most, and from where on each has a train of its own.

A train that serves two modes lasts about a period of the slower one, and places its impulses within
a hundredth of a period of the faster one. A grid for both grows with their ratio, and what there is
to gain by designing them together shrinks with it: convolving the two trains is longer by the
shorter of them, at most.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from threadline.errors import OptionError
from threadline.shaping.types import FlexibleMode

MOST_APART = 1e3
"""Ratio of the fastest mode to the slowest: the modes of one machine are nearer each other."""


def check_apart(modes: Sequence[FlexibleMode]) -> None:
    """Refuse modes that no train serves together.

    Raises
    ------
    OptionError
        If the fastest is more than ``MOST_APART`` times as fast as the slowest.
    """
    found = sorted(mode.frequency_hz for mode in modes)
    if found and found[-1] > MOST_APART * found[0]:
        raise OptionError(
            f"modes at {found[0]:g} Hz and {found[-1]:g} Hz: the ratio {found[-1] / found[0]:.4g} "
            f"is beyond {MOST_APART:g}, and no controller plays one train for both",
            remedy="Check their units, or shape one of them and leave out the other.",
        )


def groups(modes: Sequence[FlexibleMode], ratio: float) -> Iterator[list[int]]:
    """Yield the places of modes that follow each other within ``ratio``, the slowest first."""
    order = sorted(range(len(modes)), key=lambda k: modes[k].frequency_hz)
    group = order[:1]
    for slower, faster in pairwise(order):
        if modes[faster].frequency_hz > ratio * modes[slower].frequency_hz:
            yield group
            group = []
        group.append(faster)
    if group:
        yield group
