"""Legs of a seam from corner to corner, and those of the lock stitches, sewn forth and back."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.drawing.arclength import ArcTable
from threadline.errors import JobError, Place
from threadline.jobs.seam.corners import corners
from threadline.jobs.seam.settings import Stitching


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """A stretch of a contour without corners.

    Parameters
    ----------
    begin_m, end_m
        Lengths along the contour, backwards when ``end_m`` is less; a closed contour goes on
        past its length.
    begin_turn_rad, end_turn_rad
        Angle of the corner at each end; None where the head rests: at the ends of the seam and
        where a lock turns back.
    lock
        Whether the leg is part of the lock stitches.
    """

    begin_m: float
    end_m: float
    begin_turn_rad: float | None
    end_turn_rad: float | None
    lock: bool = False

    @property
    def length_m(self) -> float:
        """Length along the contour."""
        return abs(self.end_m - self.begin_m)


def seam_legs(table: ArcTable, closed: bool, settings: Stitching, place: Place) -> list[Leg]:
    """Return the legs of a seam in the order in which they are sewn.

    Raises
    ------
    JobError
        If the start, the end or a lock lies outside the contour.
    """
    begin_m, end_m = _range(table.length_m, closed, settings, place)
    at_m, turn_rad = corners(table, closed, settings)
    if closed:
        laps = table.length_m * np.arange(3)
        at_m = (at_m[None, :] + laps[:, None]).ravel()
        turn_rad = np.tile(turn_rad, 3)
    slack = 1e-9
    inside = (at_m > begin_m + slack) & (at_m < end_m - slack)
    marks = [begin_m, *at_m[inside].tolist(), end_m]
    turns: list[float | None] = [None, *turn_rad[inside].tolist(), None]
    legs = [
        Leg(
            begin_m=marks[k], end_m=marks[k + 1], begin_turn_rad=turns[k], end_turn_rad=turns[k + 1]
        )
        for k in range(len(marks) - 1)
    ]
    first_m = _lock_length(settings.lock_start, "lock_start", legs[0], settings, place)
    last_m = _lock_length(settings.lock_end, "lock_end", legs[-1], settings, place)
    return [
        *_lock(begin_m, begin_m + first_m),
        *legs,
        *_lock(end_m, end_m - last_m),
    ]


def _range(length_m: float, closed: bool, settings: Stitching, place: Place) -> tuple[float, float]:
    begin_m = settings.start_m or 0.0
    end_m = settings.end_m
    if end_m is None:
        end_m = begin_m + length_m if closed else length_m
    limit_m = begin_m + 2.0 * length_m if closed else length_m
    if not begin_m < (length_m if closed else end_m) or end_m > limit_m * (1.0 + 1e-12):
        raise JobError(
            f"the seam runs from {begin_m * 1e3:.6g} to {end_m * 1e3:.6g} mm of a contour of "
            f"{length_m * 1e3:.6g} mm",
            place=place,
            remedy="Correct start and end.",
        )
    return begin_m, min(end_m, limit_m)


def _lock_length(stitches: int, key: str, leg: Leg, settings: Stitching, place: Place) -> float:
    length_m = stitches * settings.stitch_length_m
    if length_m > leg.length_m:
        most = math.floor(leg.length_m / settings.stitch_length_m)
        raise JobError(
            f"{key} of {stitches} stitches is longer than the leg of {leg.length_m * 1e3:.6g} mm "
            "that it lies on",
            place=place,
            remedy=f"Lock with at most {most} stitches, or start elsewhere.",
        )
    return length_m


def _lock(here_m: float, there_m: float) -> list[Leg]:
    """Return the two legs from one place to another and back; none where they are equal."""
    if here_m == there_m:
        return []
    ends = [(here_m, there_m), (there_m, here_m)]
    return [
        Leg(begin_m=a, end_m=b, begin_turn_rad=None, end_turn_rad=None, lock=True) for a, b in ends
    ]
