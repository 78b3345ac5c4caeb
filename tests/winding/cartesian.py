"""A fibre on an implicit surface in Cartesian coordinates, independent of the replay.

A taut string leaves the surface F = 0 at P towards the eye E, so grad F(P) . (E - P) = 0. Its time
derivative with P' = s' t gives s'. Nothing here knows meridians, curvatures or winding angles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from threadline.base.arrays import FloatArray


@dataclass(frozen=True)
class Quadric:
    """The function F(P) = (P - centre)^T diag(weights) (P - centre) - level."""

    weights: FloatArray
    centre: FloatArray
    level: float

    def gradient(self, point: FloatArray) -> FloatArray:
        return 2.0 * self.weights * (point - self.centre)

    def along(self, direction: FloatArray) -> float:
        """Return t^T H t."""
        return float(2.0 * (self.weights * direction * direction).sum())


def cylinder(radius: float) -> Quadric:
    return Quadric(np.array([0.0, 1.0, 1.0]), np.zeros(3), radius**2)


def ellipsoid(centre: float, height: float, radius: float) -> Quadric:
    weights = np.array([1.0 / height**2, 1.0 / radius**2, 1.0 / radius**2])
    return Quadric(weights, np.array([centre, 0.0, 0.0]), 1.0)


def cone(apex: float, slope: float) -> Quadric:
    """Return the cone r = slope * (x - apex)."""
    return Quadric(np.array([-(slope**2), 1.0, 1.0]), np.array([apex, 0.0, 0.0]), 0.0)


def eye_in_mandrel(columns: FloatArray) -> FloatArray:
    """Return (3,) the eye in the mandrel's frame: along, across and up, turned back by the turn."""
    turn, along, across, up = columns[:4]
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([along, across * cos + up * sin, up * cos - across * sin])


@dataclass(frozen=True)
class Roller:
    """A roller: its centre and axis on the carrier, its radius, and the direction to its side."""

    centre: FloatArray
    axis: FloatArray
    radius: float
    side: FloatArray

    def leaves(self, columns: FloatArray, point: FloatArray) -> FloatArray:
        """Return (3,) the point where the fibre leaves the roller, in the mandrel's frame.

        Roll turns up to along about across, yaw turns along to across about up. The tangent to the
        circle is searched as a root, on the used side.
        """
        turn, yaw, roll = columns[0], columns[4], columns[5]
        carrier = Rotation.from_rotvec([0.0, 0.0, yaw]) * Rotation.from_rotvec([0.0, roll, 0.0])
        mandrel = Rotation.from_rotvec([-turn, 0.0, 0.0])
        middle = mandrel.apply(columns[1:4] + carrier.apply(self.centre))
        axis = mandrel.apply(carrier.apply(self.axis))
        side = mandrel.apply(carrier.apply(self.side))
        to = point - middle
        to = to - axis * (axis @ to)
        near = to / np.linalg.norm(to)
        over = side - axis * (axis @ side) - near * (near @ side)
        over = over / np.linalg.norm(over)

        def place(angle: float) -> FloatArray:
            return np.asarray(middle + self.radius * (np.cos(angle) * near + np.sin(angle) * over))

        def edge(angle: float) -> float:
            return float((place(angle) - middle) @ (point - place(angle)))

        return place(brentq(edge, 0.0, 0.5 * np.pi, xtol=1e-15, rtol=1e-15))


def laid(
    surface: Quadric,
    columns: Callable[[float], FloatArray],
    start: FloatArray,
    until: float,
    roller: Roller | None = None,
) -> Callable[[FloatArray], FloatArray]:
    """Return a function of times, (n,), to places (n, 3) of the laid point of the fibre."""

    def seen(time: float, point: FloatArray) -> FloatArray:
        if roller is None:
            return eye_in_mandrel(columns(time))
        return roller.leaves(columns(time), point)

    def rates(time: float, point: FloatArray) -> FloatArray:
        step = 1e-6 if roller is None else 1e-5
        eye = seen(time, point)
        velocity = (seen(time + step, point) - seen(time - step, point)) / (2.0 * step)
        away = eye - point
        free = float(np.linalg.norm(away))
        tangent = away / free
        speed = -float(velocity @ surface.gradient(point)) / (free * surface.along(tangent))
        return speed * tangent

    found = solve_ivp(
        rates, (0.0, until), start, method="DOP853", rtol=1e-10, atol=1e-13, max_step=0.05,
        dense_output=True,
    )  # fmt: skip
    return lambda times: np.asarray(found.sol(times).T)


def tangent_at(surface: Quadric, eye: FloatArray, along: float, radius: float) -> FloatArray:
    """Return the point of a circle of the surface at which the eye sees it edge-on, ahead of it."""
    at = float(np.arctan2(eye[2], eye[1]))

    def point(angle: float) -> FloatArray:
        return np.array([along, radius * np.cos(angle), radius * np.sin(angle)])

    def edge(angle: float) -> float:
        return float(surface.gradient(point(angle)) @ (eye - point(angle)))

    return point(brentq(edge, at - np.pi / 2 - 0.3, at, xtol=1e-14))
