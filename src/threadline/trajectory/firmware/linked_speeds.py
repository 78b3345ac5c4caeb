"""Speeds along the pieces that LinuxCNC runs, and the motion of each as polynomials in time.

A piece that goes on is left as fast as the pieces behind it allow, of which 50 are looked at
(``[TRAJ]ARC_BLEND_OPTIMIZATION_DEPTH``); the last one may yet lose half of its length, so that
the way to a stop at its end counts half. A piece of less than 10 ms changes its speed evenly
(``ARC_BLEND_RAMP_FREQ``).
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.compiled import njit
from threadline.trajectory.firmware.corner_choice import CYCLE_S, GOES_ON, OVERLAPS, overlap

AHEAD = 51  # pieces that are looked at, the last one included
_RAMP_S = 0.01
_INSTANT_S = 1e-12  # takes no time
_BEND = 0.05  # rad of an arc in one polynomial: 0.8 um of a radius of 10 mm, where it sets out


@njit()
def speeds_at_ends(extent, most, speed, rate, limit, ends):
    """Return the (m,) greatest speed at the end of each of m pieces.

    What F asks for does not count here, but where the next piece begins: where it falls, LinuxCNC
    is faster for a moment.
    """
    count = len(extent)
    found = np.zeros(count)
    for i in range(count - 1):
        if ends[i] != GOES_ON:
            continue
        newest = min(count - 1, i + AHEAD)
        able = 0.0
        for j in range(newest - 1, i - 1, -1):
            if ends[j] != GOES_ON:
                able = 0.0
                continue
            n = j + 1
            gain = 1.0 if n == newest else 2.0
            able = np.sqrt(able * able + gain * rate[n] * extent[n])
            here = speed[n] if n == newest else most[n]
            able = min(able, limit[j], most[j], here)
        found[i] = able
    return found


@njit()
def _phases(length, enter, top, leave, rate, evenly, time_s, change):
    """Write time and acceleration of three phases, and return the speed at the end.

    Parameters
    ----------
    length, enter, top, leave, rate : float
        Of a piece: length, first, greatest and last speed, acceleration.
    evenly : bool
        Whether the speed changes in one go.
    time_s, change : (3,)
        What is written.
    """
    time_s[:], change[:] = 0.0, 0.0
    longest = 2.0 * rate * length
    if leave * leave > enter * enter + longest:
        leave = np.sqrt(enter * enter + longest)
        evenly = True
    elif leave * leave < enter * enter - longest:
        leave = np.sqrt(enter * enter - longest)
        evenly = True
    if evenly and enter + leave > 0.0:
        time_s[0] = 2.0 * length / (enter + leave)
        change[0] = (leave - enter) / time_s[0]
        return leave
    peak = min(top, np.sqrt(0.5 * (enter * enter + leave * leave + longest)))
    peak = max(peak, leave)
    up, down = abs(peak * peak - enter * enter), peak * peak - leave * leave
    time_s[0], time_s[2] = abs(peak - enter) / rate, (peak - leave) / rate
    change[0], change[2] = (rate if peak > enter else -rate), -rate
    time_s[1] = max(0.0, length - (up + down) / (2.0 * rate)) / peak
    return leave


@njit()
def motion(
    move, radius, lead, extent, most, speed, rate, limit, ends, bow, cosine, rapid, tolerance, out,
    enter, entered, lasted, since,
):  # fmt: skip
    """Return rows of motion of the first ``out`` of m pieces.

    Parameters
    ----------
    move, radius, lead, extent, most, speed, rate, limit, ends : (m,)
        As in ``Links``.
    bow : (n,)
        Radius of each move, 0 of a line.
    cosine : (n - 1,)
        cos(theta) of the corners.
    rapid : (n,) bool
        Which moves are rapid.
    tolerance : float
        P of G64, 0 for none.
    out : int
        How many pieces.
    enter : float
        Speed at the start of the first piece, where the one before goes on.
    entered, lasted : float
        Speed that the first piece has by the time when the one before ends, and for how long both
        moved; 0 where they do not overlap.
    since : float
        Time since the last rest.

    Returns
    -------
    piece : (r,) int
        The piece of each row.
    row : (r, 7)
        Its time; where on the piece it begins, with what speed, and its acceleration; the same
        along the next piece, which may move too.
    enter, entered, lasted, since : float
        As above, of the piece behind.
    """
    leaves = speeds_at_ends(extent, most, speed, rate, limit, ends)
    round_ = np.where(radius > 0.0, radius, bow[move])
    bends = np.where(round_ > 0.0, (extent - lead) / np.where(round_ > 0.0, round_, 1.0), 0.0)
    room = 9 * out + int(np.ceil(bends[:out] / _BEND).sum())
    piece, row = np.zeros(room, np.int64), np.zeros((room, 7))
    time_s, change = np.zeros(3), np.zeros(3)
    r = 0
    for j in range(out):
        a = rate[j]
        place = 0.0
        if lasted > 0.0:
            enter, place = entered, entered * lasted - entered * entered / (2.0 * a)
        entered, lasted = 0.0, 0.0
        leave = min(leaves[j], speed[j])
        if ends[j] == GOES_ON:
            leave = min(leave, speed[j + 1])
        evenly = (
            ends[j] == GOES_ON
            and not rapid[move[j]]
            and leave > 1e-8
            and 2.0 * (extent[j] - place) < _RAMP_S * (enter + leave)
        )
        tail, rises, slope = 0.0, 0.0, 0.0
        if ends[j] == OVERLAPS and j + 1 < len(extent):
            n = j + 1
            slope = rate[n]
            reach = 0.5 * extent[n] if n == len(extent) - 1 else extent[n]
            slow, _ = overlap(
                a, extent[j], extent[j], speed[j], slope, extent[n], reach, speed[n],
                cosine[move[j]], tolerance,
            )  # fmt: skip
            left = extent[j] - place
            leave = min(slow, max(enter, min(speed[j], np.sqrt(a * left + 0.5 * enter * enter))))
            lasted, tail = leave / a, leave * leave / (2.0 * a)
            # The next speeds up as any move, and its own way to rest has room behind that.
            follow = min(speed[n], np.sqrt(slope * extent[n]))
            entered = min(follow, slope * lasted, extent[n] / lasted)
            rises = min(entered / slope, lasted)
        v = enter
        enter = _phases(extent[j] - place - tail, v, speed[j], leave, a, evenly, time_s, change)
        begin = r
        r, place = _alone(row, r, time_s, change, place, v, lead[j], round_[j])
        if lasted > 0.0:
            r = _together(row, r, place, enter, a, rises, lasted, slope)
            enter = 0.0
        piece[begin:r] = j
        since += time_s.sum() + lasted
        if ends[j] != GOES_ON and lasted == 0.0:
            # At rest to the end of the cycle.
            wait = CYCLE_S * np.ceil(since / CYCLE_S - 1e-6) - since
            since = 0.0
            if wait > _INSTANT_S:
                piece[r], row[r, 0], row[r, 1] = j, wait, place
                r += 1
    return piece[:r], row[:r], enter, entered, lasted, since


@njit()
def _alone(row, r, time_s, change, place, v, lead, radius):
    """Write the phases of a piece from row ``r`` on; return the row and the place behind them.

    Of an arc of ``radius`` behind a line ``lead`` they end with each bend.
    """
    for q in range(3):
        left_s = time_s[q]
        while left_s > _INSTANT_S:
            t = left_s
            if radius > 0.0:
                t = _until(place, v, change[q], lead, radius)
                if t > left_s - _INSTANT_S:
                    t = left_s
            row[r, 0], row[r, 1], row[r, 2], row[r, 3] = t, place, v, change[q]
            r += 1
            place += v * t + 0.5 * change[q] * t * t
            v += change[q] * t
            left_s -= t
    return r, place


@njit()
def _together(row, r, place, v, rate, rises, lasts, slope):
    """Write how a piece brakes to rest while the next speeds up; return the row behind."""
    for q in range(2):
        t = rises if q == 0 else lasts - rises
        if t > _INSTANT_S:
            row[r, 0], row[r, 1], row[r, 2], row[r, 3] = t, place, v, -rate
            if q == 0:
                row[r, 6] = slope
            else:
                row[r, 4], row[r, 5] = 0.5 * slope * rises * rises, slope * rises
            r += 1
            place += v * t - 0.5 * rate * t * t
            v -= rate * t
    return r


@njit()
def _until(place, v, change, lead, radius):
    """Return when a motion along an arc comes to the end of its line, or has gone by a bend."""
    if place < lead - 1e-9:
        way = lead - place
    else:
        step = radius * _BEND
        done = np.floor((place - lead) / step + 1e-6)
        way = lead + (done + 1.0) * step - place
    inside = v * v + 2.0 * change * way
    if inside <= 0.0:
        return np.inf
    return 2.0 * way / (v + np.sqrt(inside))
