"""The pieces of a path, with their speed limits by feed and by smoothing in time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.motion.path.durations import Smoothing

_ALONG = 1e-4  # least weight of the part of q_uu along the path, squared
_HAT = 0.25  # share of the larger curvature: the smaller curvature at the end of a corner's piece
_CUSP = 1e-5  # share of the size of a piece: an end with a slower rate is a cusp
_TAILS = 20.0  # times the cut by the smoothing's tails: a smaller tolerance counts as fine
_ZONES = 6  # most lengths over which curves of different speed reach into a straight piece
_ALIKE = 1.1  # zones whose lengths differ by less are merged
_WIDE = 1.11  # so that a cap may hold a little farther than necessary
_NEAR = 1e-10  # share of a straight piece: it is not cut closer to its ends


@dataclass(frozen=True, slots=True, kw_only=True)
class Allowance:
    """Permitted cut of a curve by the smoothing, at the tool.

    Parameters
    ----------
    smoothing, radius
        As for the path.
    slack_m
        Deviation that the average over time may cause, m.
    reach_s
        Time before and after a curve for which its speed must be kept.
    top_m_s
        Highest speed at the tool that the velocity limits allow, m/s.
    """

    smoothing: Smoothing
    radius: FloatArray
    slack_m: float
    reach_s: float
    top_m_s: float


def allowance(
    smoothing: Smoothing,
    radius: FloatArray,
    room_m: float,
    limit_v: FloatArray,
    limit_a: FloatArray,
) -> Allowance:
    """Return the use of the tolerance ``room_m``.

    The weights of the smoothing reach a little beyond the average. A large tolerance has room for
    the effect of an acceleration there; with a small tolerance the speed must be even up to there.
    """
    tail_m = smoothing.tail_s2 * float(size(limit_a, radius))
    is_fine = room_m < _TAILS * tail_m
    return Allowance(
        smoothing=smoothing,
        radius=radius,
        slack_m=room_m if is_fine else room_m - tail_m,
        reach_s=smoothing.reach_s if is_fine else smoothing.width_s / 2.0,
        top_m_s=float(size(limit_v, radius)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Pieces:
    """Consecutive pieces of one run.

    Parameters
    ----------
    c
        (n, 4, axes) coefficients.
    straight
        (n,) 0/1.
    feed, smooth
        (n,) largest u'^2 by the feed, and by the permitted cut of the smoothing.
    ahead, behind
        (n,) part of the length over which the curvature falls towards the end, and the start.
    length
        (n,) m at the tool.
    leave, enter
        (n,) m at the tool: |q_u| at the end and at the start; times u' it is the speed there.
    operation
        (n,) int.
    whole
        (n,) 0/1: a straight piece that was not divided yet.
    """

    c: FloatArray
    straight: IntArray
    feed: FloatArray
    smooth: FloatArray
    ahead: FloatArray
    behind: FloatArray
    length: FloatArray
    leave: FloatArray
    enter: FloatArray
    operation: IntArray
    whole: IntArray

    def __len__(self) -> int:
        return len(self.c)

    def take(self, rows: slice | IntArray) -> Pieces:
        """Return the pieces at ``rows``."""
        return Pieces(**{name: getattr(self, name)[rows] for name in _COLUMNS})


_COLUMNS = (
    "c", "straight", "feed", "smooth", "ahead", "behind", "length", "leave", "enter",
    "operation", "whole",
)  # fmt: skip


def join(parts: list[Pieces]) -> Pieces:
    """Return the pieces of all ``parts`` in a row."""
    return Pieces(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS}
    )


def prepare(
    c: FloatArray, nominal_s: FloatArray, operation: IntArray, allowed: Allowance
) -> Pieces:
    """Return pieces with their caps, each as if it were alone."""
    if c.shape[1] < 4:
        c = np.concatenate([c, np.zeros((len(c), 4 - c.shape[1], c.shape[2]))], axis=1)
    straight = ~np.any(c[:, 2:], axis=(1, 2))
    first_bend, last_bend = _cutting(c, allowed.radius)
    largest = np.where(straight, 0.0, np.maximum(first_bend, last_bend))
    with np.errstate(divide="ignore", invalid="ignore"):
        feed = np.where(nominal_s > 0, 1.0 / nominal_s**2, np.inf)
        smooth = 2.0 * allowed.slack_m / (allowed.smoothing.variance_s2 * largest)
        ahead = np.where(largest > 0, 1.0 - last_bend / largest, 0.0)
        behind = np.where(largest > 0, 1.0 - first_bend / largest, 0.0)
    # In a corner between straight pieces the acceleration rises and falls evenly over the
    # time 2 / u'; the average keeps the fraction 1 - width u' / 8 of its peak (3/4 at least).
    lone_corner = np.zeros(len(c), dtype=bool)
    lone_corner[1:-2] = straight[:-3] & ~straight[1:-2] & ~straight[2:-1] & straight[3:]
    lone_corner[1:-2] &= (behind[1:-2] > 1.0 - _HAT) & (ahead[2:-1] > 1.0 - _HAT)
    lone_corner[2:-1] |= lone_corner[1:-2]
    kept_share = 1.0 - np.minimum(allowed.smoothing.width_s * np.sqrt(smooth) / 8.0, 0.25)
    enter, leave = size(c[:, 1], allowed.radius), size(slope(c), allowed.radius)
    middle = size(c[:, 1] + c[:, 2], allowed.radius)
    return Pieces(
        c=c,
        straight=straight.astype(np.int64),
        feed=feed,
        smooth=np.where(lone_corner, smooth / kept_share, smooth),
        ahead=ahead,
        behind=behind,
        length=(enter + middle + leave) / 3.0,
        leave=leave,
        enter=enter,
        operation=operation,
        whole=straight.astype(np.int64),
    )


def divide(pieces: Pieces, allowed: Allowance, *, is_last: bool) -> Pieces:
    """Cut straight pieces where the speed of a curve before or after them may be left.

    The last piece stays whole unless the run ends there (``is_last``): the next piece is not known.
    """
    is_due = pieces.whole == 1
    if not is_last:
        is_due[-1] = False
    reach_s, top_m_s = allowed.reach_s, allowed.top_m_s
    rows, start, stop = _cut(is_due, pieces.smooth, _extents(pieces), reach_s, top_m_s)
    share = stop - start
    is_cut = np.bincount(rows, minlength=len(pieces))[rows] > 1
    parts = pieces.take(rows)
    c = parts.c.copy()
    c[is_cut, 0] += start[is_cut, None] * c[is_cut, 1]
    c[is_cut, 1] *= share[is_cut, None]
    return Pieces(
        c=c,
        straight=parts.straight,
        feed=parts.feed / share**2,
        smooth=parts.smooth,
        ahead=parts.ahead,
        behind=parts.behind,
        length=parts.length * share,
        leave=parts.leave * share,
        enter=parts.enter * share,
        operation=parts.operation,
        whole=np.where(is_due[rows], 0, parts.whole),
    )


def caps(pieces: Pieces, factor: FloatArray, allowed: Allowance) -> FloatArray:
    """Return the (n,) largest u'^2, with the requirements of nearby curves."""
    cap = np.minimum(pieces.feed, pieces.smooth)
    reach_s, top_m_s = allowed.reach_s, allowed.top_m_s
    _spread(cap, pieces.smooth, factor, _extents(pieces), reach_s, top_m_s)
    return cap


class _Extents(NamedTuple):
    """Lengths of pieces, which decide how far the speed of a curve must be kept; see ``Pieces``."""

    length: FloatArray
    leave: FloatArray
    enter: FloatArray
    straight: IntArray
    ahead: FloatArray
    behind: FloatArray


def _extents(pieces: Pieces) -> _Extents:
    return _Extents(
        pieces.length, pieces.leave, pieces.enter, pieces.straight, pieces.ahead, pieces.behind
    )


def slope(c: FloatArray) -> FloatArray:
    """Return the (n, axes) derivative at the end of each piece."""
    derivative = c[:, 1] + 2.0 * c[:, 2]
    for power in range(3, c.shape[1]):
        derivative += float(power) * c[:, power]
    return np.asarray(derivative)


def bend(c: FloatArray) -> FloatArray:
    """Return the (n, axes) second derivative at the end of each piece."""
    second_derivative = 2.0 * c[:, 2]
    for power in range(3, c.shape[1]):
        second_derivative += float(power * (power - 1)) * c[:, power]
    return np.asarray(second_derivative)


def size(vectors: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the lengths at the tool of (..., axes) vectors."""
    return np.asarray(np.sqrt(_sum((vectors * radius) ** 2)))


def _sum(values: FloatArray) -> FloatArray:
    """Return the (...) sums over the axes of (..., axes) values.

    The axes are added one after another: numpy is slow along a short inner dimension.
    """
    total: FloatArray = values[..., 0].copy()
    for axis in range(1, values.shape[-1]):
        total += values[..., axis]
    return total


def factors(c: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the (n,) ratios of u'^2 after and before the joint after each piece, 1 at the end.

    The path is smooth in a common parameter, so its derivatives give the ratio; at a cusp, where
    the axes turn back and the first derivative vanishes, the second derivatives do.
    """
    rate_before, rate_after = size(slope(c[:-1]), radius), size(c[1:, 1], radius)
    largest = np.abs(c[:, 1:] * radius).max(axis=(1, 2), initial=0.0)
    cusp = (rate_before < _CUSP * largest[:-1]) | (rate_after < _CUSP * largest[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (rate_before / rate_after) ** 2
        turning = size(bend(c[:-1]), radius) / size(2.0 * c[1:, 2], radius)
    return np.append(np.where(cusp, turning, ratio), 1.0)


def _cutting(c: FloatArray, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the (n,) sizes of q_uu at both ends at the tool; its part along the path counts less.

    A shift along the path is no deviation, unless the path turns back there.
    """
    rate_start, rate_end = c[:, 1] * radius, slope(c) * radius
    rates = np.sqrt(_sum(rate_start**2)), np.sqrt(_sum(rate_end**2))
    no_cusp = np.minimum(*rates) > _CUSP * np.maximum(*rates)
    along = _sum(rate_start * rate_end) / np.where(no_cusp, rates[0] * rates[1], 1.0)
    share = (1.0 - np.where(no_cusp, np.clip(along, 0.0, 1.0), 0.0)) ** 2 + _ALONG
    ends = []
    for q_u, q_uu in ((rate_start, 2.0 * c[:, 2] * radius), (rate_end, bend(c) * radius)):
        rate2 = _sum(q_u**2)
        along_part = (_sum(q_u * q_uu) / np.where(rate2 > 0, rate2, 1.0))[:, None] * q_u
        ends.append(np.sqrt(_sum((q_uu - along_part) ** 2) + share * _sum(along_part**2)))
    return ends[0], ends[1]


@njit()
def _note(zones, reach):  # type: ignore[no-untyped-def]
    """Note a zone of length ``reach``; zones of nearly the same length are merged."""
    for k in range(len(zones)):
        if zones[k] == 0.0:
            zones[k] = reach
            return
        if reach <= zones[k] <= reach * _ALIKE or zones[k] <= reach <= zones[k] * _ALIKE:
            zones[k] = max(zones[k], reach)
            return
    longest = 0
    for k in range(1, len(zones)):  # argmax() and max() take longer to compile than all of this
        if zones[k] > zones[longest]:
            longest = k
    zones[longest] = max(reach, zones[longest])


@njit()
def _cut(due, cap, extents, reach, top):  # type: ignore[no-untyped-def]
    """Return row, start and end in [0, 1] of every part of every piece."""
    length, leave, enter, straight, ahead, behind = extents
    count = len(cap)
    begin, end = np.zeros((count, _ZONES)), np.zeros((count, _ZONES))
    for i in range(count):
        if straight[i] or np.sqrt(cap[i]) * length[i] >= top:
            continue
        reach_m = np.sqrt(cap[i]) * leave[i] * reach
        passed_m = ahead[i] * length[i]
        for j in range(i + 1, count):
            if passed_m >= reach_m:
                break
            if straight[j] and reach_m - passed_m < length[j]:
                _note(begin[j], reach_m - passed_m)
            passed_m += length[j]
        reach_m = np.sqrt(cap[i]) * enter[i] * reach
        passed_m = behind[i] * length[i]
        for j in range(i - 1, -1, -1):
            if passed_m >= reach_m:
                break
            if straight[j] and reach_m - passed_m < length[j]:
                _note(end[j], reach_m - passed_m)
            passed_m += length[j]
    most_parts = count * (2 * _ZONES + 1)
    rows, start, stop = (
        np.empty(most_parts, dtype=np.int64),
        np.empty(most_parts),
        np.empty(most_parts),
    )
    n = 0
    places = np.empty(2 * _ZONES)
    for i in range(count):
        part_begin = 0.0
        if due[i]:
            place_count = 0
            for k in range(_ZONES):
                if begin[i, k] > 0.0:
                    places[place_count] = begin[i, k] / length[i]
                    place_count += 1
                if end[i, k] > 0.0:
                    places[place_count] = 1.0 - end[i, k] / length[i]
                    place_count += 1
            for k in range(1, place_count):  # np.sort() takes as long to compile as all of this
                place, m = places[k], k
                while m > 0 and places[m - 1] > place:
                    places[m] = places[m - 1]
                    m -= 1
                places[m] = place
            for place in places[:place_count]:
                if place > part_begin + _NEAR and place < 1.0 - _NEAR:
                    rows[n], start[n], stop[n] = i, part_begin, place
                    n += 1
                    part_begin = place
        rows[n], start[n], stop[n] = i, part_begin, 1.0
        n += 1
    return rows[:n], start[:n], stop[:n]


@njit()
def _spread(cap, own_cap, factor, extents, reach, top):  # type: ignore[no-untyped-def]
    """Apply the cap of a curved piece to all pieces within reach of the smoothing."""
    length, leave, enter, straight, ahead, behind = extents
    for i in range(len(own_cap)):
        if straight[i] or np.sqrt(own_cap[i]) * length[i] >= top:
            continue
        reach_m = np.sqrt(own_cap[i]) * leave[i] * reach
        x = own_cap[i]
        passed_m = ahead[i] * length[i]
        for j in range(i + 1, len(own_cap)):
            # A straight piece beyond the reach was cut without need.
            if passed_m >= reach_m or (straight[j] and passed_m + length[j] > reach_m * _WIDE):
                break
            x = x * factor[j - 1]
            cap[j] = min(cap[j], x)
            passed_m += length[j]
        reach_m = np.sqrt(own_cap[i]) * enter[i] * reach
        x = own_cap[i]
        passed_m = behind[i] * length[i]
        for j in range(i - 1, -1, -1):
            if passed_m >= reach_m or (straight[j] and passed_m + length[j] > reach_m * _WIDE):
                break
            x = x / factor[j]
            cap[j] = min(cap[j], x)
            passed_m += length[j]
