"""The corners of a contour (turns within less than a stitch, in any drawing style), and its legs.

After travel to a contour the machine swings: a speed v that ends at once leaves an amplitude of
``v / w`` in a mode of ``w`` rad/s. The default travel speed leaves an amplitude of half the
placement in the slowest mode. The default rest lasts until the amplitude in every mode is a tenth
of the placement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray, Recent
from threadline.dynamics.linear_model import Oscillation
from threadline.dynamics.without_loop import modes_held
from threadline.errors import JobError, Place
from threadline.geometry.arclength import ArcTable
from threadline.geometry.curves import Pieces
from threadline.jobs.seam.settings import MOST_SETTLE_S, Stitching
from threadline.machine import Machine

_EDGE_SHARE = 0.05  # share of a turn left out at each end when the turn's length is measured
_CHORD_RAD = math.radians(30.0)  # twelve sides to a circle
_CHORD_STITCHES = 2.0
_FINE_M = 1e-7
_CHUNK = 4096
_SAMPLES = np.linspace(0.0, 1.0, 33)


def corners(table: ArcTable, closed: bool, settings: Stitching) -> tuple[FloatArray, FloatArray]:
    """Return the places and the angles of the corners of a contour.

    A corner is a turn by at least the settings' corner angle within the least stitch: a joint, a
    fillet, a chamfer or the tip of a hairpin. A longer turn is a bend. Three or more joints also
    form a bend, as its chords, if they are at most two stitches apart and turn to the same side by
    similar angles of at most 30 degrees.

    Returns
    -------
    at_m, turn_rad
        (n,) increasing lengths along the contour, and angles in (0, pi]. The start of a closed
        contour may be a corner; the ends of an open contour are not corners.
    """
    if len(table.pieces) == 1 and table.pieces.is_line[0]:
        return np.empty(0), np.empty(0)
    first, last = table.pieces.end_directions()
    turn = _turn_angles(np.roll(last, 1, axis=0), first)
    joints_m = table.piece_begins_m()[:-1]
    if not closed:
        turn[0] = 0.0
    least_rad = settings.corner_angle_rad
    is_joint = np.abs(turn) > 1e-9
    at_joint, turn_joint = joints_m[is_joint], turn[is_joint]
    is_corner = np.abs(turn_joint) >= least_rad
    is_corner &= ~drawn_as_chords(
        at_joint, turn_joint, _CHORD_STITCHES * settings.stitch_length_m, _CHORD_RAD
    )
    at_bend, turn_bend = _tight_bends(table, settings.least_m / least_rad)
    at_all = np.concatenate([at_joint, at_bend])
    turn_all = np.concatenate([turn_joint, turn_bend])
    order = np.argsort(at_all, kind="stable")
    at_all, turn_all = at_all[order], turn_all[order]
    turn_at = dict(
        zip(at_joint[is_corner].tolist(), np.abs(turn_joint[is_corner]).tolist(), strict=True)
    )
    for begin, end in tight_turns(at_all, turn_all, least_rad, settings.least_m):
        if begin == end:  # ``is_corner`` above decides about a single joint
            continue
        inside = slice(begin, end + 1)
        for at_m in at_all[inside].tolist():
            turn_at.pop(at_m, None)
        angle = turn_all[inside]
        total = float(angle.sum())
        largest = int(np.argmax(np.abs(angle)))
        if abs(angle[largest]) < 0.5 * abs(total):  # no dominant joint: take the middle of the turn
            largest = int(np.searchsorted(np.cumsum(angle) / total, 0.5))
        turn_at[float(at_all[begin + largest])] = min(abs(total), math.pi)
    places = np.array(sorted(turn_at), dtype=np.float64)
    return places, np.array([turn_at[place] for place in places.tolist()], dtype=np.float64)


def _turn_angles(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the (n,) signed angles from directions ``before`` to directions ``after``."""
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return np.asarray(np.arctan2(cross, (before * after).sum(axis=1)))


def _tight_bends(table: ArcTable, radius_m: float) -> tuple[FloatArray, FloatArray]:
    """Return places and turns along every piece with a bend tighter than ``radius_m``."""
    pieces = table.pieces
    curved = np.flatnonzero(~pieces.is_line)
    tight, peak_bends = [], []
    for start in range(0, len(curved), _CHUNK):
        index = curved[start : start + _CHUNK]
        u = np.tile(_SAMPLES, len(index))
        _, speed, second_derivative = pieces.evaluate(np.repeat(index, len(_SAMPLES)), u, 2)
        cross = np.abs(
            speed[:, 0] * second_derivative[:, 1] - speed[:, 1] * second_derivative[:, 0]
        )
        speed3 = np.hypot(*speed.T) ** 3
        is_tight = (cross * radius_m > speed3) | (speed3 == 0.0)
        # A curve may turn back between two samples.
        turns_back = np.abs(_turn_angles(speed[:-1], speed[1:])) > 0.5
        is_tight[1:] |= turns_back & (u[1:] > 0.0)
        chosen = is_tight.reshape(len(index), -1).any(axis=1)
        tight.append(index[chosen])
        peak_bends.append(
            np.hypot(*second_derivative.T).reshape(len(index), -1).max(axis=1)[chosen]
        )
    if not tight or not sum(map(len, tight)):
        return np.empty(0), np.empty(0)
    return _turning(table, np.concatenate(tight), np.concatenate(peak_bends))


def _turning(
    table: ArcTable, index: IntArray, second_derivative: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return places and turns along the pieces ``index``, from directions at many places."""
    pieces: Pieces = table.pieces.take(index)
    parts = (
        np.ceil(np.sqrt(1.1 * second_derivative / (8.0 * _FINE_M)))
        .clip(8, 1 << 16)
        .astype(np.int64)
    )
    piece = np.repeat(np.arange(len(index)), parts + 1)
    first = np.repeat(np.cumsum(parts + 1) - (parts + 1), parts + 1)
    u = (np.arange(len(piece)) - first) / parts[piece]
    points, speed = pieces.evaluate(piece, u, 1)
    same_piece = piece[1:] == piece[:-1]
    step = np.diff(points, axis=0)
    at_rest = np.hypot(*speed.T) <= 1e-9 * np.maximum(np.append(np.hypot(*step.T), 0.0), 1e-300)
    speed[:-1][at_rest[:-1]] = step[at_rest[:-1]]
    chord = np.where(same_piece, np.hypot(*step.T), 0.0)
    covered = np.concatenate([[0.0], np.cumsum(chord)])
    begins = table.piece_begins_m()
    covered_in_piece = covered - covered[first]
    piece_chords = covered[first + parts[piece]] - covered[first]
    length = (begins[1:] - begins[:-1])[index][piece]
    at = begins[index][piece] + covered_in_piece / np.maximum(piece_chords, 1e-300) * length
    middle = 0.5 * (at[1:] + at[:-1])
    return middle[same_piece], _turn_angles(speed[:-1], speed[1:])[same_piece]


def tight_turns(
    at_m: FloatArray, turn_rad: FloatArray, least_rad: float, within_m: float
) -> list[tuple[int, int]]:
    """Return the stretches that turn like a corner: the first and last index of each stretch.

    Parameters
    ----------
    at_m, turn_rad
        (n,) places along the line, not decreasing, and the signed turn of the line at each place.
    least_rad, within_m
        Least angle and greatest length of a corner, in rad and m.
    """
    total = np.concatenate([[0.0], np.cumsum(turn_rad)])
    last = np.searchsorted(at_m, at_m + within_m, side="right") - 1
    first = np.arange(len(at_m))
    is_sharp = np.abs(total[last + 1] - total[first]) >= least_rad
    clusters: list[list[int]] = []
    for k in np.flatnonzero(is_sharp).tolist():
        if clusters and k <= clusters[-1][1]:
            clusters[-1][1] = max(clusters[-1][1], int(last[k]))
        else:
            clusters.append([k, int(last[k])])
    stretches = []
    for begin, end in clusters:
        # Ends with almost no turn do not belong to the corner.
        share = np.cumsum(turn_rad[begin : end + 1]) / (total[end + 1] - total[begin] or 1.0)
        inner_index = np.flatnonzero(
            (share >= _EDGE_SHARE) & (np.append(0.0, share[:-1]) <= 1.0 - _EDGE_SHARE)
        )
        if not len(inner_index):
            continue
        low, high = begin + int(inner_index[0]), begin + int(inner_index[-1])
        inner_turn = abs(total[high + 1] - total[low])
        if (
            inner_turn >= (1.0 - 3.0 * _EDGE_SHARE) * least_rad
            and at_m[high] - at_m[low] <= within_m
        ):
            stretches.append((low, high))
    return stretches


def drawn_as_chords(
    at_m: FloatArray, turn_rad: FloatArray, within_m: float, most_rad: float
) -> NDArray[np.bool_]:
    """Return (n,) whether each joint belongs to a bend drawn as chords.

    Such a bend has three or more joints, each at most ``within_m`` from the next, that turn to the
    same side by similar angles of at most ``most_rad``.
    """
    count = len(at_m)
    continues = np.zeros(max(count - 1, 0), dtype=np.bool_)
    size = np.abs(turn_rad)
    if count > 1:
        smaller, larger = np.minimum(size[:-1], size[1:]), np.maximum(size[:-1], size[1:])
        continues = (
            (np.diff(at_m) <= within_m)
            & (turn_rad[:-1] * turn_rad[1:] > 0.0)
            & (larger <= most_rad)
            & (larger <= 2.5 * smaller)  # a joint of curve and straight line has half the turn
        )
    is_chord = np.zeros(count, dtype=np.bool_)
    ends = [-1, *np.flatnonzero(~continues).tolist(), count - 1]
    for last_before, last in pairwise(ends):
        if last - last_before >= 3:
            is_chord[last_before + 1 : last + 1] = True
    return is_chord


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """A stretch of a contour without corners.

    Parameters
    ----------
    begin_m, end_m
        Lengths along the contour; the leg runs backwards if ``end_m`` is less. On a closed contour
        lengths may exceed the length of the contour.
    begin_turn_rad, end_turn_rad
        Angle of the corner at each end; None at an end where the head rests: at the ends of the
        seam and at the reversal of a lock.
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
        """Length of the leg along the contour."""
        return abs(self.end_m - self.begin_m)


def seam_legs(table: ArcTable, closed: bool, settings: Stitching, place: Place) -> list[Leg]:
    """Return the legs of a seam in the order of sewing.

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
    return [*_lock(begin_m, begin_m + first_m), *legs, *_lock(end_m, end_m - last_m)]


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


def _lock(begin_m: float, end_m: float) -> list[Leg]:
    """Return the two legs from one place to another and back; none if the places are equal."""
    if begin_m == end_m:
        return []
    ends = [(begin_m, end_m), (end_m, begin_m)]
    return [
        Leg(begin_m=a, end_m=b, begin_turn_rad=None, end_turn_rad=None, lock=True) for a, b in ends
    ]


_SWING_SHARE, _LEFT_SHARE = 0.5, 0.1
# A search reads the seam again for every speed, and the damping of a mode takes 64 pole sets.
_RECENT: Recent[tuple[Machine, tuple[str, ...]], tuple[Oscillation, ...]] = Recent(
    4, lambda a, b: a[0] is b[0] and a[1] == b[1]
)


def with_journeys(
    settings: Stitching, modes: tuple[Oscillation, ...], fastest_m_s: float
) -> Stitching:
    """Return ``settings`` with defaults for a missing travel speed and a missing rest.

    Parameters
    ----------
    settings
        Settings of the seam.
    modes
        Modes of the machine. Without modes the head travels at full speed and does not rest.
    fastest_m_s
        Highest speed of the machine.
    """
    omegas = [2.0 * math.pi * mode.frequency_hz for mode in modes]
    speed = settings.travel_speed_m_s
    if speed is None and omegas:
        speed = _SWING_SHARE * settings.placement_m * min(omegas)
    settle = settings.settle_s
    if settle is None:
        settle = 0.0
        for omega, mode in zip(omegas, modes, strict=True):
            reached_m_s = fastest_m_s if speed is None else min(speed, fastest_m_s)
            swings = reached_m_s / omega / (_LEFT_SHARE * settings.placement_m)
            if swings > 1.0 and mode.damping > 0.0:
                settle = max(settle, math.log(swings) / (mode.damping * omega))
    return replace(settings, travel_speed_m_s=speed, settle_s=min(settle, MOST_SETTLE_S))


def swinging_modes(machine: Machine, axes: tuple[str, ...]) -> tuple[Oscillation, ...]:
    """Return the modes of the axes while their motors hold still."""
    return _RECENT.of(
        (machine, axes), lambda: tuple(mode for axis in axes for mode in modes_held(machine, axis))
    )
