"""Which limit a motion uses most, and when: of axes, drives, loops and the feed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.machine import Machine
from threadline.motion.path.types import PlannedPath
from threadline.motion.timing.optimal.along_path import along_shares
from threadline.motion.timing.optimal.fastest_motion import follower_of
from threadline.motion.timing.optimal.followers import Follower, Past
from threadline.motion.timing.optimal.motion_limits import axis_limits, demands_of
from threadline.motion.timing.types import Trajectory

SAMPLES = 4001
BINDS = 0.97
"""Share of a limit above which it counts as binding: elements and barrier leave less unused."""
KINDS = ("velocity", "acceleration", "jerk", "current", "voltage", "lag", "feed")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Binding:
    """How much of each kind of limit a motion uses.

    Parameters
    ----------
    time_s
        (n,) evenly spaced instants.
    shares
        (n,) used shares of each kind of limit, for the axis with the largest; a kind without limits
        is left out.
    """

    time_s: FloatArray
    shares: Mapping[str, FloatArray]

    @property
    def binds(self) -> dict[str, float]:
        """Share of the time in which each kind of limit binds."""
        return {kind: float((share >= BINDS).mean()) for kind, share in self.shares.items()}


def binding(
    trajectory: Trajectory,
    path: PlannedPath,
    machine: Machine,
    contour_m: float = np.inf,
    *,
    of_loads: bool = False,
) -> Binding:
    """Return which limits bind a trajectory that was timed as the fastest.

    Parameters
    ----------
    path
        The path, with its feeds.
    machine, contour_m, of_loads
        As in the timing.
    """
    time_s = np.linspace(0.0, trajectory.duration_s, SAMPLES)
    rates = [trajectory(time_s, order) for order in (1, 2, 3)]
    limits = axis_limits(machine, trajectory.axes, path.radius_m)
    shares: dict[str, FloatArray] = {}
    for kind, rate, limit in zip(
        KINDS, rates, (limits.velocity, limits.acceleration, limits.jerk), strict=False
    ):
        if np.isfinite(limit).any():
            shares[kind] = np.asarray((np.abs(rate) / limit).max(axis=1))
    if limits.deceleration is not None:
        speeding = rates[0] * rates[1] > 0.0
        limit = np.where(speeding, *limits.accelerations)
        shares["acceleration"] = np.asarray((np.abs(rates[1]) / limit).max(axis=1))
    if limits.along is not None:
        for key, share in along_shares(rates[0], rates[1], rates[2], limits.along).items():
            kind = key if key in KINDS else "acceleration"
            shares[kind] = np.maximum(share, shares.get(kind, 0.0))
    commanded, winding, current = (
        np.abs(rates[0] * need[:, 0] + rates[1] * need[:, 1]).max(axis=1)
        for need in demands_of(machine, trajectory.axes, of_loads=of_loads)
    )
    for kind, share in (("current", current), ("voltage", np.maximum(commanded, winding))):
        if share.any():
            shares[kind] = np.asarray(share)
    if np.isfinite(contour_m):
        follower = follower_of(path, machine, contour_m)
        shares["lag"] = _strayed(trajectory, follower, time_s)
    speed = np.linalg.norm(rates[0] * path.radius_m, axis=1)
    feed = _feed(path, time_s, speed)
    if feed is not None:
        shares["feed"] = feed
    return Binding(time_s=time_s, shares=shares)


def _strayed(trajectory: Trajectory, follower: Follower, time_s: FloatArray) -> FloatArray:
    """Return the (n,) shares of the allowed contour error that a motion uses at (n,) times."""
    past = Past(follower.memory_s)
    shares = np.zeros(len(time_s))
    for block in trajectory:
        strays = follower.strays(past, block)
        inside = (time_s >= block.start_s[0]) & (time_s <= block.end_s)
        shares[inside] = np.maximum(shares[inside], strays.worst(time_s[inside]))
        past.add(block)
    return shares


def _feed(path: PlannedPath, time_s: FloatArray, speed: FloatArray) -> FloatArray | None:
    """Return the (n,) shares of the feed, None where no piece has one.

    The place on the path is found from the travelled length: pieces are followed in order.
    """
    ends, feeds, length_m = [np.zeros(1)], [], 0.0
    for block in path:
        lengths_m = _lengths(block.coefficients, path.radius_m)
        ends.append(length_m + np.cumsum(lengths_m))
        length_m = float(ends[-1][-1])
        feeds.append(lengths_m / np.where(block.nominal_s > 0.0, block.nominal_s, np.inf))
    feed = np.concatenate(feeds) if feeds else np.zeros(0)
    if not feed.any():
        return None
    travelled_m = np.concatenate(
        [[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time_s))]
    )
    travelled_m *= length_m / travelled_m[-1] if travelled_m[-1] > 0.0 else 1.0
    piece = np.searchsorted(np.concatenate(ends), travelled_m, side="right") - 1
    programmed = feed[np.clip(piece, 0, len(feed) - 1)]
    return np.asarray(
        np.divide(speed, programmed, out=np.zeros_like(speed), where=programmed > 0.0)
    )


def _lengths(coefficients: FloatArray, radius_m: FloatArray) -> FloatArray:
    """Return the (n,) lengths of pieces at the tool, by Gauss's three points."""
    places = 0.5 + 0.5 * np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
    weights = np.array([5.0, 8.0, 5.0]) / 18.0
    order = np.arange(1, coefficients.shape[1])
    total = np.zeros(len(coefficients))
    for place, weight in zip(places.tolist(), weights.tolist(), strict=True):
        powers = order * place ** (order - 1)
        rate = np.einsum("k,nka->na", powers, coefficients[:, 1:]) * radius_m
        total += weight * np.linalg.norm(rate, axis=1)
    return total
