"""The speeds that a shaft may take in a search, and their effect on the swing of its frame."""

from __future__ import annotations

from math import log
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray, IntArray

_COARSE = 0.03  # relative steps of the turn time beyond the fine grid
SLACK = 1.0 + 1e-12
"""Factor on limits, for rounding."""


class Speeds(NamedTuple):
    """A grid of turn times and the pairs that may follow each other; N times, P pairs.

    Parameters
    ----------
    turn_s
        (N,) turn times, rising, s.
    first
        (N,) index of the shortest turn that may follow.
    begin
        (N + 1,) index of the first pair of each turn; its pairs follow by rising turn time.
    pair_s
        (P,) time from the end of a window to the end of the next window, s.
    """

    turn_s: FloatArray
    first: IntArray
    begin: IntArray
    pair_s: FloatArray

    @classmethod
    def between(
        cls, ends_s: tuple[float, float, float], step: float, share: float, most: float
    ) -> Speeds:
        """Return the grid.

        Parameters
        ----------
        ends_s
            Shortest turn, end of the fine grid, and longest turn, s.
        step
            Relative step of the turn time on the fine grid.
        share
            Share of the window in a turn.
        most
            Largest change of the square of the speed from turn to turn, 1/s^2.
        """
        shortest, fine, longest = ends_s
        fine = min(max(fine, shortest * (1.0 + step)), longest)
        count = max(2, 1 + round(log(fine / shortest) / step))
        turn_s = np.geomspace(shortest, fine, count)
        if turn_s[-1] < longest:
            beyond = max(2, 1 + round(log(longest / turn_s[-1]) / _COARSE))
            turn_s = np.concatenate((turn_s, np.geomspace(turn_s[-1], longest, beyond)[1:]))
        turn_s[0], turn_s[-1] = shortest, longest
        squares = turn_s**-2.0
        near = np.abs(squares[:, None] - squares[None, :]) <= most * SLACK
        before, after = np.nonzero(near)
        rest = 2.0 * (1.0 - share) / (1.0 / turn_s[before] + 1.0 / turn_s[after])
        return cls(
            turn_s=turn_s,
            first=near.argmax(axis=1).astype(np.int64),
            begin=np.concatenate(([0], np.cumsum(near.sum(axis=1)))).astype(np.int64),
            pair_s=rest + share * turn_s[after],
        )

    @property
    def after(self) -> IntArray:
        """(P,) index of the following turn of each pair."""
        counts = np.diff(self.begin)
        number = np.arange(len(self.pair_s)) - np.repeat(self.begin[:-1], counts)
        return np.asarray(np.repeat(self.first, counts) + number)


class TurnMoves(NamedTuple):
    """The moves of a design turn by turn; n turns, A axes.

    Parameters
    ----------
    travels_m
        (n, A) travel of each turn, m.
    needle
        (n,) 1 where the needle enters.
    shortest_s
        (n,) shortest time of each turn, s.
    """

    travels_m: FloatArray
    needle: IntArray
    shortest_s: FloatArray


class Swings(NamedTuple):
    """The effect of each turn time on the swing; M columns, each a mode of an axis of a machine.

    The modes of one axis of one machine follow each other; their amplitudes add up.

    Parameters
    ----------
    poles
        (M,) decay and frequency of each mode, rad/s.
    fresh
        (N, M) swing at the end of a move of 1 m.
    late
        (N, M) share of the swing that is left when the needle enters.
    axis, last
        (M,) axis, and 1 if the column is the last of its axis and machine.
    named
        (A,) the column of each axis whose swing distinguishes states.
    """

    poles: ComplexArray
    fresh: ComplexArray
    late: FloatArray
    axis: IntArray
    last: IntArray
    named: IntArray
