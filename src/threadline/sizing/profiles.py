"""Speed profiles of a move, and the error of interpolated motion at a corner.

A head moves along the unit vector d1 at speed v and then along d2, after a turn by the angle theta
(0: straight, pi: back). In discrete motion the head stops in the corner. In interpolated motion the
head begins to accelerate along d2 when it begins to decelerate along d1. Its position p, relative
to the corner, is ::

    p(t) = -(v - a_d t)^2 / (2 a_d) d1  +  a_a t^2 / 2 d2

With a_d = a_a = a both legs last v/a, the path is a parabola whose axis bisects the corner, and its
apex, at half the time, is the point nearest to the corner ::

    e = |p(v / 2a)| = v^2 / (8 a) |d2 - d1| = v^2 sin(theta / 2) / (4 a)

which is sqrt(2) v^2 / (8 a) at a right angle: eqs 2.4 to 2.7 of the stitcher thesis.

The heat in the armature is proportional to the mean square of the torque, and therefore of the
acceleration. For a distance D in a time T the mean square acceleration is smallest, 12 D^2 / T^4,
for a parabolic speed. The efficiency of a profile is this minimum / its mean square acceleration:
0.75 for the triangle, 0.889 for the trapezoid of thirds and 1 for the parabola, as in section 6.3
(Figure 6-3) of the filament winding thesis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


def corner_error_m(
    speed_m_s: float,
    acceleration_m_s2: float,
    turn_rad: float,
    deceleration_m_s2: float | None = None,
) -> float:
    """Return the smallest distance of interpolated motion from a corner, in m.

    Parameters
    ----------
    speed_m_s
        Speed before and after the corner.
    acceleration_m_s2
        Acceleration along the leg after the corner.
    turn_rad
        Angle by which the direction turns, 0 to pi; a right angle is pi / 2.
    deceleration_m_s2
        Deceleration along the leg before the corner; equal to the acceleration when None.

    Raises
    ------
    ValueError
        If an acceleration is not above 0 or the angle is outside 0 to pi.
    """
    from scipy.optimize import minimize_scalar

    _check(acceleration_m_s2, turn_rad)
    if deceleration_m_s2 is None or deceleration_m_s2 == acceleration_m_s2:
        return speed_m_s**2 * math.sin(turn_rad / 2.0) / (4.0 * acceleration_m_s2)
    _check(deceleration_m_s2, turn_rad)
    up_s, down_s = speed_m_s / acceleration_m_s2, speed_m_s / deceleration_m_s2

    def distance_m(time_s: float) -> float:
        left = (speed_m_s - deceleration_m_s2 * time_s) ** 2 / (2.0 * deceleration_m_s2)
        if time_s > up_s:  # the second leg reaches its speed before the first leg stops
            right = speed_m_s * (time_s - up_s / 2.0)
        else:
            right = acceleration_m_s2 * time_s**2 / 2.0
        return math.sqrt(left**2 + right**2 - 2.0 * left * right * math.cos(turn_rad))

    # After the first leg has stopped the head only moves away from the corner; before that the
    # distance has a single minimum.
    nearest = minimize_scalar(
        distance_m, bounds=(0.0, down_s), method="bounded", options={"xatol": 1e-12 * down_s}
    )
    return float(nearest.fun)


def corner_speed_m_s(error_m: float, acceleration_m_s2: float, turn_rad: float) -> float:
    """Return the speed in m/s at which interpolated motion misses the corner by ``error_m``.

    It is infinite for a straight path. Raises ValueError for an acceleration not above 0 and for a
    turn outside 0 to pi.
    """
    _check(acceleration_m_s2, turn_rad)
    bend = math.sin(turn_rad / 2.0)
    return math.inf if bend == 0.0 else math.sqrt(4.0 * acceleration_m_s2 * error_m / bend)


def corner_acceleration_m_s2(speed_m_s: float, error_m: float, turn_rad: float) -> float:
    """Return the acceleration in m/s^2 at which interpolated motion misses a corner by ``error_m``.

    Raises ValueError for an error not above 0 and for a turn outside 0 to pi.
    """
    _check(error_m, turn_rad)
    return speed_m_s**2 * math.sin(turn_rad / 2.0) / (4.0 * error_m)


def ramp_acceleration_m_s2(
    speed_m_s: float, stitch_length_m: float, ramp_stitches: float = 2.0
) -> float:
    """Return the acceleration in m/s^2 that reaches the speed within ``ramp_stitches`` stitches.

    The needle makes ``v / length`` stitches a second throughout, so k stitches take ``k length /
    v`` and ``a = v^2 / (k length)``; the head travels ``k / 2`` stitch lengths in that time. The
    default is two stitches: the quality rule of the stitcher thesis does not judge the length of
    the two stitches next to a corner. Raises ValueError for a stitch length or number of stitches
    not above 0.
    """
    _check(stitch_length_m, 0.0)
    _check(ramp_stitches, 0.0)
    return speed_m_s**2 / (ramp_stitches * stitch_length_m)


def _check(positive: float, turn_rad: float) -> None:
    if not positive > 0.0:
        raise ValueError(f"accelerations, errors and lengths are above 0, got {positive!r}")
    if not 0.0 <= turn_rad <= math.pi:
        raise ValueError(f"a corner turns by 0 to pi rad, got {turn_rad!r}")


_LEAST = 12.0  # mean square acceleration of the parabola, D^2 / T^4


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedProfile:
    """A speed profile over unit distance in unit time.

    Parameters
    ----------
    name
        ``triangular``, ``trapezoidal`` or ``parabolic``.
    ramp
        Share of the time for each ramp of the trapezoid: 1/3 heats the motor least, 1/2 is the
        triangle. Other profiles ignore it.

    Raises
    ------
    ValueError
        If the name is unknown, or the ramp of a trapezoid is not above 0 and at most 0.5.
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
        """Heat of the parabola divided by the heat of this profile."""
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
        acceleration with speed and with friction average to 0; the product of speed and friction
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
