"""A clock that counts the angle of a shaft, with the speed at which the shaft turns."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import pairwise
from math import isqrt

import numpy as np

from threadline.arrays import FloatArray

TIME_BOUND_S = Fraction(1, 10**15)
"""How far a time that is no fraction may be off: the instant of an angle in a ramp."""


@dataclass(frozen=True, slots=True)
class ShaftClock:
    """A clock whose ticks are steps of a shaft's angle; the speed of the shaft gives them times.

    Angles are exact fractions of a turn, whole ones counts of the clock. The speed is linear in
    time between the knots of its schedule and constant behind the last, so that the angle at a
    time is an exact fraction. The time of an angle is exact where the speed is constant, and in a
    ramp, where it is the root of a quadratic, at most ``TIME_BOUND_S`` early: then the angle at
    that time is at most as much early as the shaft turns in it.

    Commands are counted in it; recordings stay on clocks of time.

    >>> clock = ShaftClock("main", 3600, (Fraction(0),), (Fraction(2),))
    >>> clock.time_of(1800), clock.angle_at(Fraction(1, 4)), clock.ticks_at(Fraction(1, 4))
    (Fraction(1, 4), Fraction(1, 2), 1800)

    Parameters
    ----------
    name
        As in the machine file.
    steps_per_turn
        Ticks in a turn, 1 at least.
    times_s
        Knots of the schedule, s, rising from 0.
    turns_per_s
        Speed at each: not negative, never 0 at two in a row, and not at the last.
    """

    name: str
    steps_per_turn: int
    times_s: tuple[Fraction, ...]
    turns_per_s: tuple[Fraction, ...]
    _turns: tuple[Fraction, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        who = f"shaft {self.name!r}"
        if self.steps_per_turn < 1:
            raise ValueError(f"{who}: steps per turn must be 1 or more, got {self.steps_per_turn}")
        if len(self.times_s) != len(self.turns_per_s) or not self.times_s:
            raise ValueError(
                f"{who}: {len(self.times_s)} times and {len(self.turns_per_s)} speeds; there must "
                "be as many, one at least"
            )
        if self.times_s[0] != 0 or any(b <= a for a, b in pairwise(self.times_s)):
            raise ValueError(f"{who}: the times of its schedule must rise from 0 s")
        if min(self.turns_per_s) < 0:
            raise ValueError(f"{who}: it turns backwards, at {min(self.turns_per_s)} turns/s")
        if self.turns_per_s[-1] == 0 or any(a == b == 0 for a, b in pairwise(self.turns_per_s)):
            raise ValueError(f"{who}: it stands still, so that an angle has no time of its own")
        turns = [Fraction(0)]
        for (t0, t1), (v0, v1) in zip(
            pairwise(self.times_s), pairwise(self.turns_per_s), strict=True
        ):
            turns.append(turns[-1] + (v0 + v1) * (t1 - t0) / 2)
        object.__setattr__(self, "_turns", tuple(turns))

    def angle_at(self, time_s: Fraction) -> Fraction:
        """Return the angle in turns at a time in s, exactly; before 0 the shaft stands at 0."""
        if time_s <= 0:
            return Fraction(0)
        k = bisect_right(self.times_s, time_s) - 1
        since = time_s - self.times_s[k]
        return self._turns[k] + since * (self.turns_per_s[k] + self._rate(k) * since / 2)

    def ticks_at(self, time_s: Fraction) -> int:
        """Return the last tick at or before a time in s."""
        return int(self.angle_at(time_s) * self.steps_per_turn // 1)

    def time_of(self, tick: int) -> Fraction:
        """Return the time in s of a tick: exact, or in a ramp at most ``TIME_BOUND_S`` early.

        Raises
        ------
        ValueError
            If the tick is negative.
        """
        if tick < 0:
            raise ValueError(f"shaft {self.name!r}: tick {tick} is before the start")
        angle = Fraction(tick, self.steps_per_turn)
        k = bisect_right(self._turns, angle) - 1
        left, speed, rate = angle - self._turns[k], self.turns_per_s[k], self._rate(k)
        if left == 0:
            return self.times_s[k]
        if rate == 0:
            return self.times_s[k] + left / speed
        # The stable root, 2 left / (v + sqrt(v^2 + 2 rate left)), rounded up in the denominator.
        square = speed * speed + 2 * rate * left
        since = 2 * left / (speed + _root_above(square, speed, left))
        return self.times_s[k] + since

    def times_s_of(self, first: int, count: int) -> FloatArray:
        """Return (count,) times in s of consecutive ticks, each rounded once."""
        return np.array([float(self.time_of(tick)) for tick in range(first, first + count)])

    def _rate(self, k: int) -> Fraction:
        if k + 1 == len(self.times_s):
            return Fraction(0)
        gained = self.turns_per_s[k + 1] - self.turns_per_s[k]
        return gained / (self.times_s[k + 1] - self.times_s[k])


def _root_above(square: Fraction, speed: Fraction, left: Fraction) -> Fraction:
    """Return a fraction at or above the root, so near that the time is within its bound.

    With a denominator d the root is at most 1/d above; the time 2 left / (v + root) then falls by
    less than 2 left / (v + root)^2 / d.
    """
    least = speed + Fraction(isqrt(square.numerator * square.denominator), square.denominator)
    # Where the root is below one part of its own denominator, no less than that part.
    least = max(least, Fraction(1, square.denominator))
    fine = 2 * left / (least * least) / TIME_BOUND_S
    scale = max(1, -(-fine.numerator // fine.denominator))
    whole = square.numerator * scale * scale
    root = isqrt(whole // square.denominator)
    exact = root * root * square.denominator == whole
    return Fraction(root if exact else root + 1, scale)
