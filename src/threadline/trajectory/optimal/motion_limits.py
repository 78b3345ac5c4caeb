"""What axes, drives and the tool may do."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from threadline.arrays import FloatArray
from threadline.trajectory.optimal.along_path import AlongPath

_LEAST_RAMP = 0.02  # of the time to the velocity's limit at that of the acceleration


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What the axes may do.

    Parameters
    ----------
    velocity, acceleration, jerk
        (axes,); a jerk may be infinite.
    demand
        (m, axes, 2) share of what the drive of an axis has to give (volts, current) that 1 m/s,
        and 1 m/s^2, of it needs; 0 for none. At an acceleration of its limit and no velocity, no
        demand may be above 1.
    deceleration
        (axes,) what an axis may brake with, where that is another limit than ``acceleration``.
    along
        What the tool may do along its path and across it.
    """

    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    demand: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 2)))
    deceleration: FloatArray | None = None
    along: AlongPath | None = None

    @property
    def sides(self) -> tuple[FloatArray, FloatArray]:
        """(axes,) limits of speeding up, and of braking."""
        braking = self.acceleration if self.deceleration is None else self.deceleration
        return self.acceleration, braking

    @property
    def largest_acceleration(self) -> FloatArray:
        """(axes,) the higher limit of speeding up and braking."""
        return np.maximum(*self.sides)

    def with_length(self) -> Limits:
        """Return the limits with those along the path as of one more axis: the way gone."""
        if self.along is None:
            return self
        own = self.along
        speeding, braking = (
            np.append(limit, along) for limit, along in zip(self.sides, own.sides, strict=True)
        )
        return replace(
            self,
            velocity=np.append(self.velocity, own.velocity),
            acceleration=speeding,
            jerk=np.append(self.jerk, own.jerk),
            demand=np.pad(self.demand, ((0, 0), (0, 1), (0, 0))),
            deceleration=None if np.array_equal(speeding, braking) else braking,
        )

    def ramp_s(self, fastest: FloatArray) -> float:
        """Return the time that the jerk takes to the limit of acceleration or velocity, about.

        It is that of the axis with the shortest, and no longer than any axis needs to the velocity
        that it reaches: a limit of velocity far above changes nothing.

        Parameters
        ----------
        fastest
            (axes,) velocities that the motion reaches.
        """
        to_limits = np.nanmin(self._ramps_s(self.velocity))
        return float(min(to_limits, np.nanmax(self._ramps_s(fastest))))

    def _ramps_s(self, velocity: FloatArray) -> FloatArray:
        """Return how long the jerk of each axis takes, NaN for an axis that has no limit at all."""
        with np.errstate(invalid="ignore"):
            by_jerk = np.fmin(self.acceleration / self.jerk, np.sqrt(velocity / self.jerk))
            by_acceleration = _LEAST_RAMP * velocity / self.acceleration
        return np.asarray(np.fmax(by_jerk, by_acceleration))
