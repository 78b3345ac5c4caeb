"""Times of stitches for a needle that slows down with the head, so that they keep their length.

The sewing motor turns once a stitch. Head speed v and needle speed v / length are therefore
coupled, and the lower of the limits of head and motor applies to both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
from threadline.jobs.seam.settings import Accelerations, Stitching
from threadline.sizing import corner_error_m


def end_speed_m_s(
    turn_rad: float | None, settings: Stitching, accelerations: Accelerations
) -> float:
    """Return the largest speed in m/s at the end of a leg: 0 at a rest.

    At a corner of interpolated motion it is the speed at which the corner is missed by the
    placement (``corner_error_m``).
    """
    if turn_rad is None or settings.motion == "discrete":
        return 0.0
    at_one = corner_error_m(1.0, accelerations.up, turn_rad, accelerations.down)
    fastest = np.sqrt(settings.placement_m / at_one) if at_one > 0.0 else np.inf
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
        (n + 1,) curvature of the seam where the stitches begin and end; the head goes no faster
        there than ``sqrt(a / curvature)``, a being the smaller of the accelerations.
    settings, accelerations
        Settings of the seam, with the limit of the needle, and accelerations of the head.
    ends_m_s
        Speeds at the two ends of the leg.
    short
        (n,) whether a bend shortens a stitch; the head is slower there, so that the needle does not
        exceed its speed.

    Notes
    -----
    The speeds between stitches are the fastest that the limits allow, by one pass forwards and
    one backwards over ``v'^2 <= v^2 + 2 a l``, a being the deceleration
    backwards. Each stitch then takes the least time between its two speeds: up to a peak, at most
    the programmed speed, and down again.
    """
    needle = settings.needle_acceleration_hz_s * settings.stitch_length_m
    a, d = (min(along, needle) for along in accelerations)
    limit = np.minimum(
        settings.speed_m_s**2, min(accelerations) / np.maximum(np.abs(bend_1_m), 1e-12)
    )
    own = np.where(short, (settings.needle_speed_hz * lengths_m) ** 2, np.inf)
    limit = np.minimum(limit, np.minimum(np.append(own, np.inf), np.append(np.inf, own)))
    squared = limit.copy()
    squared[0] = min(squared[0], ends_m_s[0] ** 2)
    squared[-1] = min(squared[-1], ends_m_s[1] ** 2)
    # min over j <= i of squared[j] + 2 a (s_i - s_j): a running minimum of squared - 2 a s.
    rise = 2.0 * a * np.concatenate([[0.0], np.cumsum(lengths_m)])
    squared = np.minimum.accumulate(squared - rise) + rise
    fall = (rise[-1] - rise) * (d / a)
    squared = np.minimum.accumulate((squared - fall)[::-1])[::-1] + fall
    squared = np.maximum(squared, 0.0)
    before, after = squared[:-1], squared[1:]
    peak = (d * before + a * after + 2.0 * a * d * lengths_m) / (a + d)
    peak = np.minimum(peak, np.maximum(np.minimum(limit[:-1], limit[1:]), _larger(squared)))
    top, v0, v1 = np.sqrt(peak), np.sqrt(before), np.sqrt(after)
    ramps = (peak - before) / (2.0 * a) + (peak - after) / (2.0 * d)
    times = (top - v0) / a + (top - v1) / d + np.maximum(lengths_m - ramps, 0.0) / top
    return np.asarray(times)


def _larger(squared: FloatArray) -> FloatArray:
    """Return the (n,) larger of each two neighbours."""
    return np.maximum(squared[:-1], squared[1:])
