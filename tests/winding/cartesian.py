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

from threadline.base.arrays import FloatArray


@dataclass(frozen=True)
class Quadric:
    """F(P) = (P - centre)^T diag(weights) (P - centre) - level."""

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
    """Return (3,) the eye in the mandrel's frame: along, across and up turned back by the turn."""
    turn, along, across, up = columns[:4]
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([along, across * cos + up * sin, up * cos - across * sin])


def laid(
    surface: Quadric, columns: Callable[[float], FloatArray], start: FloatArray, until: float
) -> Callable[[FloatArray], FloatArray]:
    """Return a function of times, (n,), to places (n, 3) of the point of the fibre that is laid."""

    def rates(time: float, point: FloatArray) -> FloatArray:
        step = 1e-6
        eye = eye_in_mandrel(columns(time))
        velocity = (eye_in_mandrel(columns(time + step)) - eye_in_mandrel(columns(time - step))) / (
            2.0 * step
        )
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
    """Return the point of a circle of the surface where the eye sees it edge-on, ahead of it."""
    at = float(np.arctan2(eye[2], eye[1]))

    def point(angle: float) -> FloatArray:
        return np.array([along, radius * np.cos(angle), radius * np.sin(angle)])

    def edge(angle: float) -> float:
        return float(surface.gradient(point(angle)) @ (eye - point(angle)))

    return point(brentq(edge, at - np.pi / 2 - 0.3, at, xtol=1e-14))
