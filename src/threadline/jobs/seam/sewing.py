"""The stitches of a contour, and their times with a needle that slows down with the head.

The sewing motor turns once per stitch. If stitches keep their length, head speed v and needle speed
v / length are coupled, and the lower limit of head and motor applies to both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import JobError, Place
from threadline.geometry.arclength import ArcTable, arc_table
from threadline.geometry.contours import ZERO_LENGTH_M, Contour, point_text
from threadline.jobs.seam.corners import Leg, seam_legs
from threadline.jobs.seam.placement import bow_m, exempt_mask, place_leg, stitch_count, wrap
from threadline.jobs.seam.settings import Accelerations, Stitching
from threadline.sizing import corner_error_m


def end_speed_m_s(
    turn_rad: float | None, settings: Stitching, accelerations: Accelerations
) -> float:
    """Return the highest speed in m/s at the end of a leg: 0 at a rest.

    At a corner of interpolated motion, the head at this speed misses the corner by the placement
    (``corner_error_m``).
    """
    if turn_rad is None or settings.motion == "discrete":
        return 0.0
    error_at_1_m_s = corner_error_m(1.0, accelerations.up, turn_rad, accelerations.down)
    fastest = np.sqrt(settings.placement_m / error_at_1_m_s) if error_at_1_m_s > 0.0 else np.inf
    return float(min(settings.speed_m_s, fastest))


def stitch_times_s(
    lengths_m: FloatArray,
    bend_1_m: FloatArray,
    settings: Stitching,
    accelerations: Accelerations,
    ends_m_s: tuple[float, float],
    short: NDArray[np.bool_],
) -> FloatArray:
    """Return the (n,) time of each stitch of a leg.

    Parameters
    ----------
    lengths_m
        (n,) lengths of the stitches.
    bend_1_m
        (n + 1,) curvature of the seam at the stitch ends, 1/m. At these points the head speed is at
        most ``sqrt(a / curvature)``; a is the smaller of the accelerations.
    settings, accelerations
        Settings of the seam with the needle's limit, and accelerations of the head.
    ends_m_s
        Highest speeds at the two ends of the leg.
    short
        (n,) whether a bend shortens the stitch; the head slows down at a short stitch to keep the
        needle within its speed.

    Notes
    -----
    The speeds between stitches are the highest that the limits allow. One forward pass and one
    backward pass apply ``v'^2 <= v^2 + 2 a l``; the backward pass uses the deceleration for a. Each
    stitch then takes the least time between its two speeds: the speed rises to a peak, at most the
    programmed speed, and falls again.
    """
    needle_m_s2 = settings.needle_acceleration_hz_s * settings.stitch_length_m
    a, d = (min(along, needle_m_s2) for along in accelerations)
    limit = np.minimum(
        settings.speed_m_s**2, min(accelerations) / np.maximum(np.abs(bend_1_m), 1e-12)
    )
    short_squared = np.where(short, (settings.needle_speed_hz * lengths_m) ** 2, np.inf)
    limit = np.minimum(
        limit, np.minimum(np.append(short_squared, np.inf), np.append(np.inf, short_squared))
    )
    squared = limit.copy()
    squared[0] = min(squared[0], ends_m_s[0] ** 2)
    squared[-1] = min(squared[-1], ends_m_s[1] ** 2)
    # min over j <= i of squared[j] + 2 a (s_i - s_j) is a running minimum of squared - 2 a s.
    rise = 2.0 * a * np.concatenate([[0.0], np.cumsum(lengths_m)])
    squared = np.minimum.accumulate(squared - rise) + rise
    fall = (rise[-1] - rise) * (d / a)
    squared = np.minimum.accumulate((squared - fall)[::-1])[::-1] + fall
    squared = np.maximum(squared, 0.0)
    squared_before, squared_after = squared[:-1], squared[1:]
    peak = (d * squared_before + a * squared_after + 2.0 * a * d * lengths_m) / (a + d)
    peak = np.minimum(
        peak, np.maximum(np.minimum(limit[:-1], limit[1:]), _larger_of_neighbours(squared))
    )
    top, v0, v1 = np.sqrt(peak), np.sqrt(squared_before), np.sqrt(squared_after)
    ramps = (peak - squared_before) / (2.0 * a) + (peak - squared_after) / (2.0 * d)
    times = (top - v0) / a + (top - v1) / d + np.maximum(lengths_m - ramps, 0.0) / top
    return np.asarray(times)


def _larger_of_neighbours(squared: FloatArray) -> FloatArray:
    """Return the (n,) larger value of each pair of neighbours."""
    return np.maximum(squared[:-1], squared[1:])


_TURN_BACK_RAD = 2.5  # corner angle, a little below the angle at which the planner needs a rest
MAX_STITCHES = 5_000_000  # per contour: a leg with this many takes 0.5 GB


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StitchBlock:
    """The stitches of one leg.

    Parameters
    ----------
    leg
        Leg of the stitches.
    points
        (n + 1, 2) places of the needle in m; the first place is the end of the previous leg.
    lengths_m
        (n,) lengths of the stitches (chords).
    times_s
        (n,) time of each turn of the needle.
    exempt
        (n,) whether the stitch is one of the two stitches next to a corner or rest.
    target_m
        (n,) wanted lengths: the stitch length of the settings, or less at a bend.
    at_m
        (n + 1,) places of the needle as lengths along the contour. They decrease on the way back of
        a lock, and exceed the length of the contour in a second lap.
    bulge_m
        (n,) largest possible distance of the contour from the chord.
    line
        (n,) int: line in the file of the entity at the end of the stitch.
    rests
        Whether the head rests at the end of the leg.
    """

    leg: Leg
    points: FloatArray
    lengths_m: FloatArray
    times_s: FloatArray
    exempt: NDArray[np.bool_]
    target_m: FloatArray
    at_m: FloatArray
    bulge_m: FloatArray
    line: IntArray
    rests: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SewnContour:
    """A contour with all settings that determine its stitches.

    Parameters
    ----------
    seam
        Name of the seam.
    place
        Place in the drawing of the start of the contour.
    table, closed
        Curve in machine coordinates, and whether the curve is closed.
    legs
        Legs in the order of sewing.
    settings
        Settings of the seam.
    accelerations
        Accelerations of the head along the seam.
    """

    seam: str
    place: Place
    table: ArcTable
    closed: bool
    legs: tuple[Leg, ...]
    settings: Stitching
    accelerations: Accelerations

    def blocks(self) -> Iterator[StitchBlock]:
        """Yield the stitches of each leg.

        Raises
        ------
        JobError
            If a stitch has no length, because a loop is too small or the head is too slow.
        """
        for leg in self.legs:
            yield self._block(leg)

    def start(self) -> FloatArray:
        """Return the (2,) place of the first stitch, m."""
        at_m = np.array([self.legs[0].begin_m])
        on_m = wrap(at_m, self.table.length_m) if self.closed else at_m
        point: FloatArray = self.table.points(on_m)[0]
        return point

    def _block(self, leg: Leg) -> StitchBlock:
        settings = self.settings
        discrete = settings.motion == "discrete"
        halts = (discrete or leg.begin_turn_rad is None, discrete or leg.end_turn_rad is None)
        slows = settings.needle != "constant"
        # A slowed needle waits for the head, so no ramp shortens a stitch.
        ramps = (False, False) if slows else halts
        count = stitch_count(leg.length_m, settings, self.accelerations, ramps)
        if count > MAX_STITCHES:
            raise self._too_slow(leg, f"{count:.3g} stitches on it, limit {MAX_STITCHES}")
        at_m, points, short = place_leg(
            self.table, leg, self.closed, settings, self.accelerations, ramps
        )
        lengths, arcs = np.hypot(*np.diff(points, axis=0).T), np.abs(np.diff(at_m))
        if arcs.min() <= ZERO_LENGTH_M:
            raise self._too_slow(leg, f"a stitch of {arcs.min() * 1e3:.3g} mm")
        if lengths.min() <= ZERO_LENGTH_M:
            raise JobError(
                f"seam {self.seam!r}: a loop of {leg.length_m * 1e3:.3g} mm at "
                f"{point_text(points[0])} is too small for two stitches",
                place=self.place,
                remedy="Delete it, or lower least_stitch.",
            )
        on_m = wrap(at_m, self.table.length_m) if self.closed else at_m
        if slows:
            ends = (
                end_speed_m_s(leg.begin_turn_rad, settings, self.accelerations),
                end_speed_m_s(leg.end_turn_rad, settings, self.accelerations),
            )
            curvature = self.table.curvature(on_m)
            times = stitch_times_s(lengths, curvature, settings, self.accelerations, ends, short)
        else:
            times = np.full(len(lengths), 1.0 / settings.needle_speed_hz)
        middle = at_m[1:] - 0.25 * np.diff(at_m)
        piece, _ = self.table.locate(wrap(middle, self.table.length_m) if self.closed else middle)
        return StitchBlock(
            leg=leg,
            points=points,
            lengths_m=lengths,
            times_s=times,
            exempt=exempt_mask(len(lengths)),
            target_m=np.where(short, lengths, settings.stitch_length_m),
            at_m=at_m,
            bulge_m=bow_m(arcs, lengths),
            line=self.table.pieces.line[piece],
            rests=halts[1] or self._turns_back(leg),
        )

    def _turns_back(self, leg: Leg) -> bool:
        """Say whether a needle with an acceleration limit has to rest after a leg.

        If the line turns back, the speed of the head along its path has a kink.
        """
        limited = self.settings.follows and np.isfinite(self.settings.needle_acceleration_hz_s)
        return bool(limited and leg.end_turn_rad is not None and leg.end_turn_rad > _TURN_BACK_RAD)

    def _too_slow(self, leg: Leg, makes: str) -> JobError:
        return JobError(
            f"seam {self.seam!r}: at {min(self.accelerations):.3g} m/s^2 the head is so slow on a "
            f"leg of {leg.length_m * 1e3:.3g} mm that a needle of constant speed makes {makes}",
            place=self.place,
            remedy='Raise acceleration, lower needle_speed, or give needle = "follow" or "slowed".',
        )


def sewn_contour(
    contour: Contour, seam: str, file: str, settings: Stitching, accelerations: Accelerations
) -> SewnContour:
    """Return ``contour`` with its legs and settings.

    Raises
    ------
    JobError
        If the start, the end or a lock lies outside the contour, or the contour is too long.
    """
    pieces = contour.pieces.reverse() if settings.reverse else contour.pieces
    table = arc_table(pieces)
    place = Place(file, int(pieces.line[0]))
    count = table.length_m / settings.stitch_length_m
    if count > MAX_STITCHES:
        raise JobError(
            f"seam {seam!r} would be {count:.3g} stitches, limit {MAX_STITCHES}",
            place=place,
            remedy="Check the unit of the drawing, or split the seam.",
        )
    return SewnContour(
        seam=seam,
        place=place,
        table=table,
        closed=contour.closed,
        legs=tuple(seam_legs(table, contour.closed, settings, place)),
        settings=settings,
        accelerations=accelerations,
    )
