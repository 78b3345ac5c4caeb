"""Speed profiles of a move from rest to rest, with the torque and heat that they ask of the motor.

The heat in the armature is proportional to the mean square of the torque, hence of the
acceleration. For a distance D in a time T the mean square acceleration is least, 12 D^2 / T^4, when
the speed is a parabola. The efficiency of a profile is that least value over its own: 0.75 for the
triangle, 0.889 for the trapezoid of thirds and 1 for the parabola, as in section 6.3 (Figure 6-3)
of the filament winding thesis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_LEAST = 12.0  # mean square acceleration of the parabola, D^2 / T^4


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedProfile:
    """A speed profile over unit distance in unit time.

    Parameters
    ----------
    name
        ``triangular``, ``trapezoidal`` or ``parabolic``.
    ramp
        Share of the time that each ramp of the trapezoid takes: 1/3 heats the motor least, 1/2 is
        the triangle. The other profiles ignore it.

    Raises
    ------
    ValueError
        If there is no profile of that name, or the ramps of a trapezoid take no time or all of it.
    """

    name: str
    ramp: float = 1.0 / 3.0

    def __post_init__(self) -> None:
        if self.name not in PROFILES:
            raise ValueError(f"no profile {self.name!r}; there are {', '.join(PROFILES)}")
        if self.name == "trapezoidal" and not 0.0 < self.ramp <= 0.5:
            raise ValueError(f"a ramp takes more than 0 and at most half of the time: {self.ramp}")

    @property
    def _ramp(self) -> float:
        return 0.5 if self.name == "triangular" else self.ramp

    @property
    def peak_speed(self) -> float:
        """Largest speed, in D / T."""
        return 1.5 if self.name == "parabolic" else 1.0 / (1.0 - self._ramp)

    @property
    def peak_acceleration(self) -> float:
        """Largest acceleration, in D / T^2."""
        if self.name == "parabolic":
            return 6.0
        return 1.0 / (self._ramp * (1.0 - self._ramp))

    @property
    def mean_square_acceleration(self) -> float:
        """Mean of the squared acceleration, in D^2 / T^4."""
        if self.name == "parabolic":
            return _LEAST
        return 2.0 * self._ramp * self.peak_acceleration**2

    @property
    def mean_square_speed(self) -> float:
        """Mean of the squared speed, in D^2 / T^2."""
        if self.name == "parabolic":
            return 1.2
        return self.peak_speed**2 * (1.0 - 4.0 * self._ramp / 3.0)

    @property
    def efficiency(self) -> float:
        """Least heat over the heat of this profile."""
        return _LEAST / self.mean_square_acceleration

    def rms_torque(
        self,
        distance: float,
        time_s: float,
        inertia: float,
        damping: float = 0.0,
        friction: float = 0.0,
        dwell_s: float = 0.0,
    ) -> float:
        """Return the root mean square torque over a move and the dwell after it.

        The torque is ``inertia`` times acceleration, plus ``damping`` times speed, plus
        ``friction``; in the dwell it is 0. Over a move from rest to rest the products of
        acceleration with speed and with friction average to 0, the product of speed and friction
        does not. All arguments are in SI units of one coordinate, linear (N, m) or rotary (N m,
        rad).
        """
        mean = distance / time_s
        square = (
            inertia**2 * self.mean_square_acceleration * (mean / time_s) ** 2
            + damping**2 * self.mean_square_speed * mean**2
            + friction**2
            + 2.0 * damping * friction * mean
        )
        return math.sqrt(square * time_s / (time_s + dwell_s))

    def peak_torque(
        self,
        distance: float,
        time_s: float,
        inertia: float,
        damping: float = 0.0,
        friction: float = 0.0,
    ) -> float:
        """Return the largest torque of a move, in the units of ``rms_torque``."""
        speed = self.peak_speed * distance / time_s
        acceleration = self.peak_acceleration * distance / time_s**2
        if self.name != "parabolic":  # at the end of the ramp
            return inertia * acceleration + damping * speed + friction
        # At w = 1 - 2 t / T the torque is inertia a w + damping v (1 - w^2) + friction.
        push, drag = inertia * acceleration, damping * speed
        w = min(1.0, push / (2.0 * drag)) if drag > 0.0 else 1.0
        return push * w + drag * (1.0 - w**2) + friction


PROFILES = ("triangular", "trapezoidal", "parabolic")
