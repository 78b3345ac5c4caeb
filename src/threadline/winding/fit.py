"""Why the place of a program's fibre is never known, and which mandrel radius would fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.machine.tool import Tool
from threadline.winding.laying import KNOWN_AFTER, LAID, LIFTED
from threadline.winding.replay import Fibre, Replay
from threadline.winding.surface import Surface

_MAX_EYES = 4000  # positions of the eye with which radii are tried
_COARSE_RADII, _FINE_RADII, _ROUNDS = 15, 5, 3
_OFF_M = 5e-4  # between the eye and the largest mandrel that is tried
_NEARLY_ALL = 0.99  # share of the fibre that must be steered within the friction
_NO_FRICTION_LIMIT = 1e9
_NEARLY = 0.25, 3.0  # band widths by which a pattern that is nearly closed misses its begin
_LEAST_TURN = 1e-3  # rad; less is no turn


class Witness:
    """The motion of a program about its mandrel, to explain why its fibre is never known.

    Parameters
    ----------
    surface
        Surface of the mandrel.
    payout_m
        Along, across and up from the eye's carrier to the pay-out point at yaw and roll 0, m.
    """

    def __init__(self, surface: Surface, payout_m: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        self._surface, self._payout_m = surface, payout_m
        u = np.linspace(0.0, surface.length_m, 2001)
        self._x, self._r = (values[:, 0] for values in surface.at(u))
        self._turn = np.array([np.inf, -np.inf])
        self._along = np.array([np.inf, -np.inf])
        self._room_m = np.inf  # least radial distance from mandrel to eye; negative inside it
        self._inside, self._beside, self._count = 0, 0, 0
        self._in_a_row, self._longest = 0.0, 0.0
        self._last: FloatArray | None = None
        self._free_m = np.inf
        self._length_m = 0.0
        self.eyes: list[FloatArray] = []

    def take(self, eyes: FloatArray, fibre: Fibre) -> None:
        """Take the next (n, 6) coordinates of the eye, and the fibre there."""
        if not len(eyes):
            return
        chain = eyes if self._last is None else np.vstack([self._last, eyes])
        self._last = chain[-1:]
        is_turning = np.diff(chain[:, 0]) != 0.0
        # Both ends of a block that turns it: a program may be a single block.
        of_turning = np.append(is_turning, False) | np.insert(is_turning, 0, False)
        eyes = chain
        if sum(map(len, self.eyes)) < _MAX_EYES:
            self.eyes.append(eyes[of_turning][:_MAX_EYES])
        # Only while it turns: the eye may come from anywhere.
        eyes = eyes[of_turning]
        along, across, up = self.payout_points(eyes)
        for ends, column in ((self._turn, eyes[:, 0]), (self._along, along)):
            ends[0] = min(ends[0], float(column.min(initial=np.inf)))
            ends[1] = max(ends[1], float(column.max(initial=-np.inf)))
        over_mandrel = (along >= self._x[0]) & (along <= self._x[-1])
        room_m = np.hypot(across, up) - np.interp(along, self._x, self._r)
        self._count += len(eyes)
        self._beside += int((~over_mandrel).sum())
        self._inside += int((room_m[over_mandrel] < 0.0).sum())
        self._room_m = min(self._room_m, float(room_m[over_mandrel].min(initial=np.inf)))
        is_laid = fibre.state == LAID
        length = np.where(is_laid, fibre.length_m, np.nan)
        steps = np.diff(length, prepend=self._length_m if is_laid[0] else np.nan)
        shares = np.where(np.isfinite(steps), steps / np.maximum(fibre.free_m, 1e-9), np.nan)
        self._length_m = float(fibre.length_m[-1]) if is_laid[-1] else self._length_m
        # Sums that begin anew where nothing is laid.
        is_broken = np.isnan(shares)
        free_lengths = np.cumsum(np.where(is_broken, 0.0, shares))
        run_begin = np.maximum.accumulate(np.where(is_broken, free_lengths, -self._in_a_row))
        self._longest = max(self._longest, float((free_lengths - run_begin).max()))
        self._in_a_row = float(free_lengths[-1] - run_begin[-1])
        self._free_m = min(self._free_m, float(np.nanmin(fibre.free_m, initial=np.inf)))

    def payout_points(self, eyes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the (n,) places of the pay-out point along, across and up, m, for (n, 6) eyes.

        They are those that ``eye.centre`` computes in the replay.
        """
        sin, cos = np.sin(eyes[:, 4:6]), np.cos(eyes[:, 4:6])
        x, y, z = self._payout_m
        forward, up = x * cos[:, 1] + z * sin[:, 1], z * cos[:, 1] - x * sin[:, 1]
        return (
            eyes[:, 1] + forward * cos[:, 0] - y * sin[:, 0],
            eyes[:, 2] + forward * sin[:, 0] + y * cos[:, 0],
            eyes[:, 3] + up,
        )

    def reason(self) -> str:
        """Explain why the place of the fibre is never known."""
        if not self._turn[1] - self._turn[0] > _LEAST_TURN:
            return "the mandrel never turns, so that nothing is laid"
        if self._beside == self._count:
            low, high = 1e3 * self._along
            return (
                f"the eye stays beside the mandrel, at {low:.4g} to {high:.4g} mm from its left "
                f"end, and the mandrel is {1e3 * self._x[-1]:.4g} mm long: is [mandrel] at right?"
            )
        if self._inside:
            widest = 1e3 * (float(self._r.max()) + self._room_m)
            return (
                f"the eye is up to {-1e3 * self._room_m:.3g} mm inside the mandrel; a mandrel of "
                f"{widest:.4g} mm at its widest would fit at most"
            )
        return (
            f"laid are at most {self._longest:.1f} free lengths in a row, needed are "
            f"{KNOWN_AFTER:g}, and the free length is {1e3 * self._free_m:.3g} mm or more: wind on "
            "longer, or say where the fibre is tied"
        )

    def fit(self, tool: Tool, friction: float, tied: float | None) -> str:
        """Say which radius of the mandrel would fit the program; empty if none is found."""
        if not self.eyes or not self._turn[1] - self._turn[0] > _LEAST_TURN:
            return ""
        eyes = np.vstack(self.eyes)[:_MAX_EYES]
        larger_m = fitting_radius(self._surface, tool, eyes, friction, tied, self._room_m)
        if larger_m is None:
            return ""
        widest = 1e3 * (float(self._r.max()) + larger_m)
        size = "smaller" if larger_m < 0.0 else "larger"
        return (
            f"the program would fit a mandrel with a radius {abs(1e3 * larger_m):.2g} mm {size}, "
            f"{widest:.4g} mm at its widest"
        )


def fitting_radius(
    surface: Surface, tool: Tool, eyes: FloatArray, friction: float, tied: float | None,
    room_m: float,
) -> float | None:  # fmt: skip
    """Return by how much a mandrel's radius would have to be larger to fit a program, m.

    Several radii are tried; the best one has the least mean steering. Returns None if the mandrel's
    own radius is about as good, or no radius keeps the steering within the friction.

    Parameters
    ----------
    eyes
        (n, 6) coordinates of the eye from the mandrel's left end.
    room_m
        Least radial distance from mandrel to eye, m.
    """

    def steering(larger_m: float) -> tuple[float, float]:
        """Return the mean steering of a mandrel, and the share of fibre that keeps its place."""
        replay = Replay(surface.grown(larger_m), tool, _NO_FRICTION_LIMIT, tied)
        fibre = replay.feed(eyes)
        weight = np.abs(np.diff(fibre.length_m, prepend=np.nan))
        steer = np.abs(fibre.steer)
        judged = np.isfinite(steer) & np.isfinite(weight) & fibre.known
        if not judged.any():
            return np.inf, 0.0
        bad = float(np.where(fibre.state == LIFTED, weight, 0.0)[np.isfinite(weight)].sum())
        weight, steer = weight[judged], np.minimum(steer[judged], 1.0)
        whole = float(weight.sum()) + bad
        mean = (float(weight @ steer) + bad) / whole
        return mean, float(weight[steer <= friction].sum()) / whole

    low = -0.8 * surface.least_radius_m
    high = min(room_m, float(surface.r[:, 0].max())) - _OFF_M
    if not low < high:
        return None
    radii_m = np.linspace(low, high, _COARSE_RADII)
    best_m, mean, share = 0.0, *steering(0.0)
    present_mean = mean
    for _ in range(_ROUNDS):
        for larger_m in radii_m.tolist():
            tried_mean, tried_share = steering(larger_m)
            if tried_mean < mean:
                best_m, mean, share = larger_m, tried_mean, tried_share
        step = float(radii_m[1] - radii_m[0])
        finer_m = np.linspace(best_m - step, best_m + step, _FINE_RADII + 2)[1:-1]
        radii_m = finer_m[(finer_m > low) & (finer_m < high)]
        if len(radii_m) < 2:
            break
    if share < _NEARLY_ALL or mean > 0.5 * present_mean or best_m == 0.0:
        return None
    return best_m


def turn_error(off: float, whole: float, bands: float) -> str:
    """Say which error of the mandrel's turn would leave a pattern nearly closed; empty if none.

    Parameters
    ----------
    off, whole
        Angle by which the circuit after the last one would miss the first one, and angle of all
        circuits, rad.
    bands
        ``off`` in widths of the band.
    """
    if not _NEARLY[0] < bands < _NEARLY[1]:
        return ""
    size = "far" if off * whole > 0.0 else "little"
    return (
        f": a one-sided overlap or gap, as of a mandrel that turns {abs(off / whole):.2%} too "
        f"{size}, by its steps per degree or by slip on its shaft"
    )
