"""Times of the moves of the 1994 controller: at the feed, in whole ticks, and from rest to rest."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray

CUBIC_PEAK_VELOCITY = 1.5  # Cv of the law 3u^2 - 2u^3


def chord_time_s(
    displacement: FloatArray, nominal_s: FloatArray, velocity_limit: FloatArray
) -> FloatArray:
    """Return the (n,) times of chords at their feeds, or at the velocity limits where rapid.

    Parameters
    ----------
    displacement
        (n, axes) m or rad.
    nominal_s
        (n,) times at the feeds; 0 for rapid moves.
    velocity_limit
        (axes,) m/s or rad/s.
    """
    rapid = ~(nominal_s > 0)
    if not rapid.any():
        return nominal_s
    time_s = nominal_s.copy()
    time_s[rapid] = (np.abs(displacement[rapid]) / velocity_limit).max(axis=1)
    return time_s


def whole_ticks_s(time_s: FloatArray, tick_s: float) -> FloatArray:
    """Return times rounded up to whole ticks, as the 1994 controller stored them.

    So no axis is faster than its feed (filament winding thesis, section 9.5).
    """
    # A travel time of whole ticks must not become a tick longer by rounding.
    return np.asarray(np.ceil(time_s / tick_s * (1 - 1e-9)) * tick_s)


def rest_to_rest_s(chord_s: FloatArray) -> FloatArray:
    """Return the (n,) times of moves from rest to rest whose peak velocity is that of ``chord_s``.

    The velocity is a parabola over time, the profile with the least heat in the motor (filament
    winding thesis, sections 5 and 8.6).
    """
    return CUBIC_PEAK_VELOCITY * chord_s
