"""Compiled laying of the fibre: from the motion of the payout eye to the place of the fibre.

The fibre leaves the mandrel along its tangent t, and the eye is at the free length L along it. With
the normal n inwards, b = n x t and the eye's velocity v relative to the turning mandrel, the fibre
is laid at ``s' = (v . n) / (L k_n)`` and steered by ``k_g / k_n = (v . b) / (v . n)``. Only the
place of the laid point is integrated; the direction of the fibre there is the direction to the eye.
After each step a Newton step along the fibre puts the eye back into the tangent plane, so that
errors do not add up.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.winding.eye import ahead, centre
from threadline.winding.surface import meridian

LAID, LIFTED, BRIDGED, OFF, WAITING, SUNK = range(6)
"""States of a block, in this order: fibre laid; fibre unwound; fibre over a hollow; fibre off the
end of the mandrel; nothing laid yet; the eye is inside the mandrel, so that no straight fibre leads
to it.
"""
KNOWN_AFTER = 5.0
"""Free lengths after which a wrong start no longer counts: exp(-5) of its error is left."""
_ROTATION = 0.08  # rad, largest rotation in a step
_EYE_SHARE = 0.12  # largest motion of the eye in a step, as a share of the free length
_BENT = 0.15  # rad, largest bend of the fibre in a step
_MOST_STEPS = 10_000  # in a block
_SLACK_M = 5e-5  # length unwound in one go; less is no lifting, as a tow is thicker
_FLAT = 1e-6  # 1/m, least normal curvature on which a fibre lies
_WINDOW_M = 5e-4  # a block that lays less than this is judged with the blocks after it
_FIBRE_PLACES = 48  # places along the free fibre where it is compared with the mandrel
_ROUNDS = 8  # Newton steps to a tangent of mandrel and roller
_TAUT_RAD = 0.02  # rad between the fibre and the tangent plane: a taut fibre is in it
_FREE_SEARCHES = (
    16  # failed searches in successive blocks, before the eye must move on between searches
)
_WAIT_M = 1e-3  # travel of the eye before the next search, doubled by each failed search
_WAIT_SHARE = 0.25  # longest such travel, as a share of the eye's distance from the axis
_TOUCH_M = 1e-6  # a free fibre that is this much below the surface touches it


class Tables(NamedTuple):
    """A mandrel and an eye, for compiled code.

    Parameters
    ----------
    nodes, x, r
        The meridian, as in ``Surface``.
    payout
        (10,) components along, across and up from the carrier at yaw and roll 0. [0:3]: the pay-out
        point or the centre of the roller, m; [3:6]: axis of the roller; [6]: radius of the roller,
        m, negative where the fibre passes on the minus side; [7:10]: the direction across.
    friction
        Coefficient of friction; where the steering exceeds it, the fibre slips and its place is not
        known.
    convex
        Whether no straight line touches the mandrel in two places.
    """

    nodes: FloatArray
    x: FloatArray
    r: FloatArray
    payout: FloatArray
    friction: float
    convex: bool


class Laid(NamedTuple):
    """The fibre laid in each of n blocks; see ``replay.Fibre`` for the meaning.

    ``state`` is (n,), ``place`` (n, 10), ``steer`` (n, 3).
    """

    state: IntArray
    place: FloatArray
    steer: FloatArray


@njit(nogil=True)
def _rates(
    u: float, theta: float, q: FloatArray, v: FloatArray, tables: Tables, hint: int, out: FloatArray
) -> int:
    """Write the rates of laying at a place into ``out``; return the piece of the meridian.

    The 15 numbers of ``out`` become: rates of u and of the angle, rate of laying, v . b, v . n,
    k_n, free length, cosine and sine of the fibre's angle with the meridian, distance of the eye
    behind the tangent plane, radius, place along the axis, v . t, length along the meridian per u,
    angle of the fibre on the roller.
    """
    hint, x, r, cb, sb, bend, speed = meridian(tables.nodes, tables.x, tables.r, u, hint)
    dx, dr, ec, vx, vr, vc, wrap = ahead(x, r, theta + q[0], q, v, tables.payout)
    dm, dn = dx * cb + dr * sb, dx * sb - dr * cb
    vm, vn = vx * cb + vr * sb, vx * sb - vr * cb
    free = math.sqrt(dm * dm + ec * ec)
    ca, sa = dm / free, ec / free
    kn = bend * ca * ca + cb / r * sa * sa
    laying = vn / (free * kn)
    out[0] = laying * ca / speed
    out[1] = laying * sa / r
    out[2] = laying
    out[3] = ca * vc - sa * vm
    out[4] = vn
    out[5] = kn
    out[6] = free
    out[7] = ca
    out[8] = sa
    out[9] = dn
    out[10] = r
    out[11] = x
    out[12] = ca * vm + sa * vc
    out[13] = speed
    out[14] = wrap
    return hint


@njit(nogil=True)
def _steps(ds: float, out: FloatArray, v: FloatArray, radius: float) -> int:
    """Return the number of steps for a block with rates ``out`` at its start."""
    vn, vb, vt, free = out[4], out[3], out[12], out[6]
    speed = math.sqrt(vn * vn + vb * vb + vt * vt)
    by_rotation = max(abs(v[0]) / _ROTATION, speed / (_EYE_SHARE * free), abs(v[4]) / _ROTATION)
    by_bend = abs(ds) * max(abs(out[5]), 1.0 / radius) / _BENT
    count = max(by_rotation, by_bend, abs(v[5]) / _ROTATION)
    return int(min(max(math.ceil(count), 1.0), float(_MOST_STEPS)))


@njit(nogil=True)
def _meridian_at_x(
    x: float, place: float, tables: Tables, hint: int
) -> tuple[int, float, float, float, float]:
    """Return piece, u, x, radius and cosine of the meridian at the axial place ``x``.

    Beyond an end of the mandrel they are the values at that end. ``place`` and ``hint`` are a
    nearby u and its piece.
    """
    # Along the meridian x increases.
    while hint < len(tables.x) - 1 and tables.x[hint + 1, 0] <= x:
        hint += 1
    while hint > 0 and tables.x[hint, 0] > x:
        hint -= 1
    place = min(max(place, tables.nodes[hint]), tables.nodes[hint + 1])
    for _ in range(4):
        hint, px, r, cb, _sb, _, speed = meridian(tables.nodes, tables.x, tables.r, place, hint)
        place += (x - px) / (cb * speed)
        place = min(max(place, 0.0), tables.nodes[-1])
    return hint, place, px, r, cb


@njit(nogil=True)
def _eye_inside(u: float, theta: float, q: FloatArray, tables: Tables, hint: int) -> bool:
    """Return whether the pay-out point, seen from a laid point, is inside the mandrel."""
    hint, x0, r0, _, _, _, _ = meridian(tables.nodes, tables.x, tables.r, u, hint)
    dx, dr, dc = ahead(x0, r0, theta + q[0], q, q, tables.payout)[:3]
    hint, _, x, r, _ = _meridian_at_x(x0 + dx, u, tables, hint)
    return abs(x - x0 - dx) < 1e-6 and math.hypot(r0 + dr, dc) < r


@njit(nogil=True)
def _touches_ahead(
    u: float, theta: float, q: FloatArray, tables: Tables, hint: int, out: FloatArray
) -> bool:
    """Return whether the free fibre touches the mandrel ahead of the place where it leaves it.

    Then ``out`` becomes u and angle of the place that it touches, and the largest height, m, of
    the fibre over the hollow between.
    """
    hint, x0, r0, _, _, _, _ = meridian(tables.nodes, tables.x, tables.r, u, hint)
    dx, dr, dc = ahead(x0, r0, theta + q[0], q, q, tables.payout)[:3]
    deepest_m, at_u, at_angle, height, highest = 0.0, 0.0, 0.0, 0.0, 0.0
    place = u
    for k in range(1, _FIBRE_PLACES):
        share = k / _FIBRE_PLACES
        x = x0 + share * dx
        hint, place, px, r, cb = _meridian_at_x(x, place, tables, hint)
        radius = math.hypot(r0 + share * dr, share * dc)
        over_m = (radius - r) * cb
        if abs(px - x) > 1e-6:
            continue  # beyond the end of the mandrel
        highest = max(highest, over_m)
        if over_m < deepest_m:
            deepest_m, at_u, height = over_m, place, highest
            at_angle = theta + math.atan2(share * dc, r0 + share * dr)
    out[0], out[1], out[2] = at_u, at_angle, height
    return deepest_m < -_TOUCH_M and height > _TOUCH_M


@njit(nogil=True)
def _step(
    u: float, theta: float, q: FloatArray, v: FloatArray, h: float, tables: Tables,
    work: FloatArray, hint: int,
) -> tuple[float, float, float, int]:  # fmt: skip
    """Return place, angle, laid length and piece after a step of the share ``h`` of a block.

    The rows of ``work`` hold the rates at the start (the caller sets this row), twice in the
    middle, at the end, and at the corrected place.
    """
    w = work[5, :6]
    for j in range(6):
        w[j] = q[j] + v[j] * 0.5 * h
    hint = _rates(
        u + 0.5 * h * work[0, 0], theta + 0.5 * h * work[0, 1], w, v, tables, hint, work[1]
    )
    hint = _rates(
        u + 0.5 * h * work[1, 0], theta + 0.5 * h * work[1, 1], w, v, tables, hint, work[2]
    )
    for j in range(6):
        w[j] = q[j] + v[j] * h
    hint = _rates(u + h * work[2, 0], theta + h * work[2, 1], w, v, tables, hint, work[3])
    ds = h / 6.0 * (work[0, 2] + 2.0 * work[1, 2] + 2.0 * work[2, 2] + work[3, 2])
    u += h / 6.0 * (work[0, 0] + 2.0 * work[1, 0] + 2.0 * work[2, 0] + work[3, 0])
    theta += h / 6.0 * (work[0, 1] + 2.0 * work[1, 1] + 2.0 * work[2, 1] + work[3, 1])
    # Two corrections: the first one leaves an error of the square of its size.
    for _ in range(2):
        hint = _rates(u, theta, w, v, tables, hint, work[4])
        free = work[4, 6]
        correction = min(max(work[4, 9] / (free * work[4, 5]), -0.1 * free), 0.1 * free)
        u += correction * work[4, 7] / work[4, 13]
        theta += correction * work[4, 8] / work[4, 10]
        ds += correction
    return u, theta, ds, hint


@njit(nogil=True)
def lay(  # noqa: PLR0915 - one loop over the blocks; calls would cost a third of the speed
    eyes: FloatArray, group: IntArray, tables: Tables, start: FloatArray, laid: Laid, first: int
) -> int:
    """Lay the fibre over blocks; return the number of the block at which it needs a new start.

    Parameters
    ----------
    eyes
        (n + 1, 6) turn, along, across, up, yaw and roll at the ends of n blocks, linear between.
    group
        (n + 1,) group number of each block: the steering is averaged over consecutive blocks of a
        group. The last entry is the group of the block after them.
    tables
        Mandrel and eye.
    start
        (12,) state, which is updated: u, angle, laid length, free lengths laid since the place was
        unknown, length unwound since the fibre was last laid, piece of the meridian, slack;
        steering times laid length, laid length, least and largest steering since the last mean; 1
        if the place of the fibre was known when unwinding began.
    laid
        The fibre laid in each block; rows from ``first`` on are written.
    first
        Block to begin with.

    Returns
    -------
    int
        n, or the block in which the fibre ran off the mandrel or was unwound by a free length.
    """
    count = len(eyes) - 1
    work, v, q, touch = np.empty((6, 15)), np.empty(6), np.empty(6), np.empty(3)
    u, theta, length = start[0], start[1], start[2]
    free_lengths, unwound, hint, slack = start[3], start[4], int(start[5]), start[6]
    area, lengthwise, low, high = start[7], start[8], start[9], start[10]
    was_known = start[11]
    last = tables.nodes[-1]
    for i in range(first, count):
        for j in range(6):
            v[j] = eyes[i + 1, j] - eyes[i, j]
            q[j] = eyes[i, j]
        hint = _rates(u, theta, q, v, tables, hint, work[0])
        steps = _steps(work[0, 2], work[0], v, work[0, 10])
        h, length_before, free_before, wrap = 1.0 / steps, length, work[0, 6], work[0, 14]
        state, peeled_m, height, longest = LAID, 0.0, 0.0, work[0, 6]
        for step in range(steps):
            if step:
                for j in range(6):
                    q[j] = eyes[i, j] + v[j] * (step * h)
                hint = _rates(u, theta, q, v, tables, hint, work[0])
            u, theta, ds, hint = _step(u, theta, q, v, h, tables, work, hint)
            if not (work[4, 5] > _FLAT and work[0, 5] > _FLAT and math.isfinite(u + theta)):
                state, peeled_m = LIFTED, work[0, 6]
                break
            if u < 0.0 or u > last:
                state = OFF
                break
            if abs(work[4, 9]) > _TAUT_RAD * work[4, 6] and _eye_inside(
                u, theta, work[5], tables, hint
            ):
                state, free_lengths = SUNK, 0.0
                break
            length += ds
            lengthwise += ds
            # k_g / k_n is (v . b) / (v . n), and ds = (v . n) / (L k_n): their product is finite.
            for k, weight in ((0, 1.0), (2, 4.0), (3, 1.0)):
                area += h / 6.0 * weight * work[k, 3] / (work[k, 6] * work[k, 5])
                if work[k, 4] > 0.0:
                    ratio = work[k, 3] / work[k, 4]
                    low, high = min(low, ratio), max(high, ratio)
            longest = max(longest, work[4, 6])
            if ds > 0.0:
                free_lengths += ds / work[4, 6]
                unwound = max(unwound - ds, 0.0)
            else:
                if unwound == 0.0:
                    was_known = 1.0 if free_lengths >= KNOWN_AFTER else 0.0
                unwound -= ds
                peeled_m = max(peeled_m, unwound)
        if peeled_m > _SLACK_M:
            state = LIFTED
        if not tables.convex and state == LAID:
            for j in range(6):
                q[j] = eyes[i + 1, j]
            if _touches_ahead(u, theta, q, tables, hint, touch):
                state, height = BRIDGED, touch[2]
                u, theta = touch[0], touch[1]
        used_m = length - length_before + work[4, 6] - free_before
        if tables.payout[6] != 0.0:
            roller_turn = work[4, 14] - wrap
            used_m += tables.payout[6] * math.atan2(math.sin(roller_turn), math.cos(roller_turn))
        slack = max(slack - used_m, 0.0)
        mean_steer = math.nan
        group_ends = group[i + 1] != group[i]
        if group_ends and lengthwise >= _WINDOW_M:
            mean_steer = area / lengthwise
        laid.state[i] = state
        laid.place[i, 0] = u
        laid.place[i, 1] = theta
        laid.place[i, 2] = length
        laid.place[i, 3] = longest
        laid.place[i, 4] = free_lengths
        laid.place[i, 5] = height if state == BRIDGED else peeled_m
        laid.place[i, 6] = slack
        laid.place[i, 7] = math.atan2(work[4, 8], work[4, 7])
        laid.place[i, 8] = used_m
        laid.place[i, 9] = was_known
        laid.steer[i, 0] = mean_steer
        laid.steer[i, 1] = low
        laid.steer[i, 2] = high
        if state in (LIFTED, BRIDGED):
            free_lengths = 0.0
        if group_ends and not math.isnan(mean_steer):
            if abs(mean_steer) > tables.friction and free_lengths >= KNOWN_AFTER:
                free_lengths = 0.0
            area, lengthwise, low, high = 0.0, 0.0, math.inf, -math.inf
        is_lost = state == LIFTED and peeled_m >= work[4, 6]
        if state in (OFF, SUNK) or is_lost or not math.isfinite(u + theta):
            start[2], start[6] = length, slack
            return i
    start[0], start[1], start[2] = u, theta, length
    start[3], start[4], start[5], start[6] = free_lengths, unwound, float(hint), slack
    start[7], start[8], start[9], start[10] = area, lengthwise, low, high
    start[11] = was_known
    return count


@njit(nogil=True)
def leads(
    eye: FloatArray, state: FloatArray, tables: Tables, work: FloatArray, found: FloatArray
) -> None:
    """Write the length of fibre that the eye pays out per change of each of its coordinates.

    The laid point moves only along the fibre, so this length changes as the pay-out point moves
    along the fibre, seen from the turning mandrel. A tension T acts on coordinate k with the force
    or torque ``-T found[k]``.

    Parameters
    ----------
    eye
        (6,) turn, along, across, up, yaw and roll.
    state
        (12,) as in ``lay``.
    work
        (2, 15) work space.
    found
        (6,) m per m or rad.
    """
    unit_rate = work[1, :6]
    unit_rate[:] = 0.0
    for k in range(6):
        unit_rate[k] = 1.0
        _rates(state[0], state[1], eye, unit_rate, tables, int(state[5]), work[0])
        unit_rate[k] = 0.0
        found[k] = work[0, 12]


@njit(nogil=True)
def looks(eye: FloatArray, rate: FloatArray, tables: Tables, places: FloatArray) -> FloatArray:
    """Return the tangents from the eye to the mandrel at places u, on both sides of the axis.

    Parameters
    ----------
    eye, rate
        (6,) positions as in ``lay``, and their rates.
    places
        (m,) places u.

    Returns
    -------
    FloatArray
        (m, 2, 3) angle, v . n and v . b of each tangent; NaN where there is none.
    """
    tangents = np.full((len(places), 2, 3), np.nan)
    rates = np.empty(15)
    along, across, up = centre(eye, rate, tables.payout)[:3]
    distance_m = math.sqrt(across * across + up * up)
    eye_angle = math.atan2(up, across) - eye[0]
    hint = 0
    for i in range(len(places)):
        hint, x, r, cb, sb, _, _ = meridian(tables.nodes, tables.x, tables.r, places[i], hint)
        cos = (r + sb * (along - x) / cb) / distance_m
        if abs(cos) >= 1.0:
            continue
        for side in range(2):
            theta = eye_angle - math.acos(cos) if side == 0 else eye_angle + math.acos(cos)
            hint = _rates(places[i], theta, eye, rate, tables, hint, rates)
            # On a roller the pay-out point depends on the place of the tangent.
            for _ in range(_ROUNDS if tables.payout[6] != 0.0 else 0):
                correction = rates[9] / (cb * rates[6] * rates[8])
                theta += min(max(correction, -0.3), 0.3)
                hint = _rates(places[i], theta, eye, rate, tables, hint, rates)
            if rates[5] > _FLAT:
                tangents[i, side, 0] = theta
                tangents[i, side, 1] = rates[4]
                tangents[i, side, 2] = rates[3]
    return tangents


@njit(nogil=True)
def first_look(
    chain: FloatArray, at: int, tables: Tables, places: FloatArray, waited: FloatArray
) -> tuple[int, int, float]:
    """Return the first block from ``at`` on in which the eye can lay, row of place, angle.

    Of all ``places`` with a tangent the one with the least steering is taken. Without any, the
    block is the number of blocks and the row is -1. An eye beside the mandrel finds tangents in
    every block and loses the fibre at once. After ``_FREE_SEARCHES`` searches in a row the eye must
    therefore travel for a while before the next search (``_WAIT_M``, ``_WAIT_SHARE``).

    Parameters
    ----------
    waited
        (2,) state, which is updated: searches since fibre was laid over a whole block, and travel
        of the eye since the last search, m.
    """
    count = len(chain) - 1
    for block in range(at, count):
        rate = chain[block + 1] - chain[block]
        if not rate.any():
            continue
        if waited[0] > _FREE_SEARCHES:
            distance_m = math.hypot(chain[block, 2] + tables.payout[1], chain[block, 3])
            travel_m = math.sqrt(
                rate[1] ** 2 + rate[2] ** 2 + rate[3] ** 2 + (rate[0] * distance_m) ** 2
            )
            waited[1] += travel_m
            wait_factor = 2.0 ** min(waited[0] - _FREE_SEARCHES, 20.0)
            if waited[1] < min(_WAIT_M * wait_factor, _WAIT_SHARE * distance_m):
                continue
        waited[0] += 1.0
        waited[1] = 0.0
        tangents = looks(chain[block], rate, tables, places)
        least_steer, row, angle = math.inf, -1, 0.0
        for i in range(len(places)):
            for side in range(2):
                if tangents[i, side, 1] > 0.0:
                    steer = abs(tangents[i, side, 2] / tangents[i, side, 1])
                    if steer < least_steer:
                        least_steer, row, angle = steer, i, tangents[i, side, 0]
        if row >= 0:
            return block, row, angle
    return count, -1, 0.0
