"""Impulse trains and the flexible modes that they are made for.

Conventions of this package:

* ``frequency_hz`` is the *undamped* natural frequency, omega = 2 pi f;
* the residual vibration ``V`` is normalised to one unit impulse, each measured as an envelope
  at its own last impulse: 1 is the unshaped command, 0 is silence;
* ``insensitivity`` is (f_hi - f_lo) / f of the interval around f where V stays at the tolerance
  or below it;
* the damping ratio is held while the frequency sweeps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray, Locked, read_only
from threadline.errors import OptionError, PlanError

MAX_DAMPING_RATIO = 0.3
"""Designs without a closed form need a damping ratio below this; above it a shaper gains little."""

MOST_DAMPED = 0.99
"""Bound of every damping ratio; a mode with a ratio closer to 1 does not ring."""

MIN_HZ, MAX_HZ = 1e-6, 1e9
"""Range of frequencies, Hz, in which the square and the period neither overflow nor underflow."""


class ShaperError(PlanError):
    """A shaper could not be designed, or its simulation disagreed with the design."""

    code = "SHAPER"


@dataclass(frozen=True, slots=True)
class FlexibleMode:
    """One mode that rings.

    Parameters
    ----------
    frequency_hz
        Undamped natural frequency, Hz, from 1e-6 to 1e9.
    damping_ratio
        Dimensionless, in [0, 0.99).

    Raises
    ------
    OptionError
        If either is outside its range.
    """

    frequency_hz: float
    damping_ratio: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.frequency_hz) and self.frequency_hz > 0.0):
            raise OptionError(
                f"mode: frequency_hz must be positive, got {self.frequency_hz!r}",
                remedy="Give the undamped natural frequency in hertz.",
            )
        if not MIN_HZ <= self.frequency_hz <= MAX_HZ:
            raise OptionError(
                f"mode: frequency_hz must be from {MIN_HZ:g} to {MAX_HZ:g}, got "
                f"{self.frequency_hz!r}",
                remedy="No machine rings as slowly or as fast.",
            )
        if not 0.0 <= self.damping_ratio < MOST_DAMPED:
            raise OptionError(
                f"mode {self.frequency_hz:g} Hz: the damping ratio must be in "
                f"[0, {MOST_DAMPED:g}), got {self.damping_ratio!r}",
                remedy="A ratio is dimensionless: the real part of an eigenvalue divided by "
                "its modulus, not the real part itself.",
            )

    def refuse_much_damping(self, what: str) -> None:
        """Raise an error if the mode has too much damping for a design without closed form.

        Raises
        ------
        OptionError
            If the damping ratio is at or above ``MAX_DAMPING_RATIO``; ``what`` is its subject.
        """
        if self.damping_ratio >= MAX_DAMPING_RATIO:
            raise OptionError(
                f"{what}: the damping ratio must be in [0, {MAX_DAMPING_RATIO:g}), got "
                f"{self.damping_ratio!r}",
                remedy="Kinds in closed form take more: zv, mzv, zvd, zvdd. A ratio is "
                "dimensionless: the real part of an eigenvalue divided by its modulus, not the "
                "real part itself.",
            )

    @property
    def damped_period_s(self) -> float:
        """Period of the ringing, 1 / (f sqrt(1 - zeta^2))."""
        return 1.0 / (self.frequency_hz * math.sqrt(1.0 - self.damping_ratio**2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shaper(Locked):
    """Impulse train that a command is convolved with; both arrays are read-only.

    Parameters
    ----------
    amplitudes
        Shape ``(n,)``, dimensionless. Every design sums to 1; a hand-made train need not.
    times_s
        Shape ``(n,)``, s, strictly increasing, the first 0.
    name
        Name for tables and messages.
    """

    amplitudes: FloatArray
    times_s: FloatArray
    name: str = "custom"

    def __post_init__(self) -> None:
        object.__setattr__(self, "amplitudes", read_only(self.amplitudes, "amplitudes", ndim=1))
        object.__setattr__(self, "times_s", read_only(self.times_s, "times_s", ndim=1))
        if len(self.amplitudes) != len(self.times_s) or not len(self.times_s):
            raise OptionError(
                f"shaper '{self.name}': {len(self.amplitudes)} amplitudes for "
                f"{len(self.times_s)} times; there must be one each, and at least one"
            )
        if self.times_s[0] != 0.0 or bool(np.any(np.diff(self.times_s) <= 0.0)):
            raise OptionError(
                f"shaper '{self.name}': times_s must start at 0 and increase strictly, "
                f"got {self.times_s.tolist()}"
            )

    @property
    def duration_s(self) -> float:
        """Time of the last impulse, s: shaping makes every move longer by it."""
        return float(self.times_s[-1])

    @property
    def centroid_s(self) -> float:
        """Mean delay sum(A t) / sum(A), s; it is the delay of motion at constant speed."""
        return float(self.amplitudes @ self.times_s / self.amplitudes.sum())

    @property
    def levels(self) -> FloatArray:
        """Partial sums, shape ``(n,)``: the levels that a shaped unit step passes through."""
        return np.cumsum(self.amplitudes)

    @property
    def over_level(self) -> float:
        """Largest distance of a shaped unit step from [0, 1]; 0 if the step never leaves it."""
        levels = self.levels
        return float(max(0.0, -levels.min(), levels.max() - 1.0))


UNSHAPED = Shaper(amplitudes=np.ones(1), times_s=np.zeros(1), name="unshaped")
"""The identity: one unit impulse at 0."""
