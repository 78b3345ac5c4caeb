"""Checks of a seam: warnings, and errors if the machine cannot sew the seam."""

from __future__ import annotations

import math

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import JobError, LimitError, Place
from threadline.geometry.contours import Contour, point_text
from threadline.geometry.self_crossing import crossings, flatten
from threadline.jobs.seam.settings import Accelerations, Stitching
from threadline.jobs.seam.sewing import SewnContour, StitchBlock
from threadline.machine import Machine
from threadline.sizing import corner_error_m, ramp_acceleration_m_s2

_SLACK_M = 1e-9
_CROSSING_TOLERANCE_M = 1e-5


def head_accelerations_m_s2(
    settings: Stitching, axes: tuple[str, str], machine: Machine
) -> tuple[Accelerations, list[str]]:
    """Return the accelerations for planning a seam, and warnings about them.

    The accelerations come from the settings, or else from the two-stitch rule, and do not exceed
    the limit of the weaker axis.
    """
    rule = ramp_acceleration_m_s2(settings.speed_m_s, settings.stitch_length_m)
    up = settings.acceleration_m_s2 or rule
    down = settings.deceleration_m_s2 or up
    wanted = max(up, down)
    warnings = []
    for axis in axes:
        limits = machine.axes[axis]
        if limits.velocity.si < settings.speed_m_s * (1.0 - 1e-9):
            warnings.append(
                f"{settings.needle_speed_hz:g} stitches/s of {settings.stitch_length_m * 1e3:g} mm "
                f"are {settings.speed_m_s * 1e3:.4g} mm/s; axis {axis} does "
                f"{limits.velocity.si * 1e3:.4g} mm/s"
            )
        if limits.acceleration.si < wanted * (1.0 - 1e-9):
            warnings.append(
                f"to be at speed within two stitches takes {wanted:.4g} m/s^2; axis {axis} does "
                f"{limits.acceleration.si:.4g} m/s^2"
            )
    machine_limit = machine.least_acceleration(axes)
    return Accelerations(min(up, machine_limit), min(down, machine_limit)), warnings


def crossing_warnings(contour: Contour, seam: str, file: str) -> list[str]:
    """Return a warning if the contour crosses itself."""
    if len(contour.pieces) == 1 and contour.pieces.is_line[0]:
        return []
    begin, end, piece = flatten(contour.pieces, _CROSSING_TOLERANCE_M)
    first, second, at_first, _, complete = crossings(begin, end, contour.closed)
    if not len(first):
        if complete:
            return []
        return [f"{file}: seam {seam!r} is too large to be searched for crossings of itself"]
    k, j = int(first[0]), int(second[0])
    crossing = begin[k] + at_first[0] * (end[k] - begin[k])
    lines = [int(contour.pieces.line[piece[i]]) for i in (k, j)]
    more_than = "" if complete else "more than "
    return [
        f"{Place(file, lines[0])}: seam {seam!r} crosses or touches itself at "
        f"{more_than}{len(first)} "
        f"places, first at {point_text(crossing)} (the line of {lines[1]} in the file)"
    ]


def corner_warnings(sewn: SewnContour, machine_acceleration_m_s2: float) -> list[str]:
    """Return a warning if interpolated motion misses corners by more than the placement."""
    settings = sewn.settings
    if settings.motion != "interpolated" or settings.needle != "constant":
        return []
    turns = [leg.end_turn_rad for leg in sewn.legs if leg.end_turn_rad is not None]
    errors = [corner_error_m(settings.speed_m_s, machine_acceleration_m_s2, t) for t in turns]
    missed = [(e, t) for e, t in zip(errors, turns, strict=True) if e > settings.placement_m]
    if not missed:
        return []
    error, turn = max(missed)
    return [
        f"{sewn.place}: seam {sewn.seam!r}: at {settings.speed_m_s * 1e3:.4g} mm/s and "
        f"{machine_acceleration_m_s2:.4g} m/s^2 interpolated motion misses {len(missed)} corners "
        "by "
        f"more than {settings.placement_m * 1e3:.3g} mm, a turn of {math.degrees(turn):.3g} "
        f'degrees by {error * 1e3:.3g} mm; slow the needle, or set motion = "discrete"'
    ]


class StitchCheck:
    """Collects the faults of a seam's stitches in one pass over the stitches."""

    def __init__(self, sewn: SewnContour, axes: tuple[str, str], machine: Machine) -> None:
        self.sewn = sewn
        self.axes = axes
        self.machine = machine
        self.off = 0
        self.worst = (0.0, "")
        self.short: list[tuple[float, str]] = []
        self.along_m_s2 = math.inf  # head acceleration limit of a needle that follows

    def add(self, block: StitchBlock) -> None:
        """Check one block of stitches.

        Raises
        ------
        LimitError
            If a stitch lies outside the travel of an axis.
        JobError
            If the drawn line bows out of a stitch by more than the placement.
        """
        self._travel(block.points, np.append(block.line[:1], block.line))
        settings = self.sewn.settings
        if settings.follows:
            least_m = float(block.target_m.min())
            self.along_m_s2 = min(self.along_m_s2, settings.needle_acceleration_hz_s * least_m)
        file = self.sewn.place.file
        relative = block.lengths_m / block.target_m - 1.0
        is_off = ~block.exempt & (np.abs(relative) > settings.tolerance * (1.0 + 1e-9))
        self.off += int(is_off.sum())
        if is_off.any():
            k = int(np.argmax(np.where(is_off, np.abs(relative), 0.0)))
            if abs(relative[k]) > abs(self.worst[0]):
                where = f"{Place(file, int(block.line[k]))}, at {point_text(block.points[k + 1])}"
                self.worst = (float(relative[k]), where)
        self._unsewn(block)
        if block.leg.length_m < settings.stitch_length_m * (1.0 - settings.tolerance):
            where = f"{Place(file, int(block.line[0]))}, at {point_text(block.points[0])}"
            self.short.append((block.leg.length_m, where))

    def _unsewn(self, block: StitchBlock) -> None:
        """Refuse a stitch if the drawn line bows out of it by more than the placement."""
        settings, file = self.sewn.settings, self.sewn.place.file
        k = int(np.argmax(block.bulge_m))
        if block.bulge_m[k] > settings.placement_m:
            raise JobError(
                f"seam {self.sewn.seam!r}: the drawn line bows {block.bulge_m[k] * 1e3:.3g} mm out "
                f"of a stitch of {block.lengths_m[k] * 1e3:.3g} mm at "
                f"{point_text(block.points[k + 1])}, more than the placement of "
                f"{settings.placement_m * 1e3:.3g} mm, and would not be sewn",
                place=Place(file, int(block.line[k])),
                remedy="Lower least_stitch or bow, or shorten the stitches.",
            )

    def reach(self) -> None:
        """Check the ends and the middle of every piece before any stitch is placed.

        A seam with a start or an end of its own is not checked here, but stitch by stitch.

        Raises
        ------
        LimitError
            If one of these points lies outside the travel of an axis.
        """
        pieces = self.sewn.table.pieces
        piece = np.repeat(np.arange(len(pieces)), 3)
        points = pieces.evaluate(piece, np.tile([0.0, 0.5, 1.0], len(pieces)))[0]
        if self.sewn.settings.start_m is None and self.sewn.settings.end_m is None:
            self._travel(points, pieces.line[piece])

    def _travel(self, points: FloatArray, line: IntArray) -> None:
        for column, axis in enumerate(self.axes):
            low, high = self.machine.travel[self.machine.axis_names.index(axis)]
            values = points[:, column]
            outside = np.flatnonzero((values < low - _SLACK_M) | (values > high + _SLACK_M))
            if not len(outside):
                continue
            k = int(outside[0])
            value = float(values[k])
            limit = float(low if value < low else high)
            raise LimitError(
                f"seam {self.sewn.seam!r} reaches {axis} {value * 1e3:.6g} mm; the travel ends "
                f"at {limit * 1e3:.6g} mm",
                axis=axis,
                quantity="travel",
                value_si=value,
                limit_si=limit,
                place=Place(self.sewn.place.file, int(line[k])),
                remedy="Move the drawing: [drawing] origin in the seam file.",
            )

    def warnings(self) -> list[str]:
        """Return the warnings about the checked stitches."""
        texts = []
        name = f"seam {self.sewn.seam!r}"
        settings = self.sewn.settings
        if self.off:
            texts.append(
                f"{self.worst[1]}: {name}: {self.off} stitches are more than "
                f"{settings.tolerance * 100:g} % off their length, the worst "
                f"{self.worst[0] * 100:+.3g} %"
            )
        if self.short:
            length, where = min(self.short)
            texts.append(
                f"{where}: {name}: {len(self.short)} legs between corners are shorter than a "
                f"stitch, the shortest {length * 1e3:.3g} mm; each gets a stitch at both ends"
            )
        return texts
