"""Convolution of shapers: one train with the effect of several, applied one after the other."""

from __future__ import annotations

import numpy as np

from threadline.errors import OptionError
from threadline.shaping.types import Shaper, ShaperError

COINCIDENT_S = 1e-12
"""Impulses closer than this are one: far below any tick, far above rounding."""

MOST_IMPULSES = 10_000
"""Trains multiply: without a bound, a few modes too many take minutes; no controller plays them."""


def convolve(*shapers: Shaper, name: str = "") -> Shaper:
    """Convolve shapers: durations add up, vibrations multiply.

    Parameters
    ----------
    *shapers
        At least one; one alone stays as it is.
    name
        Name of the result; the names joined by ``*`` if empty.

    Raises
    ------
    OptionError
        If there is none.
    ShaperError
        If the train would have more than ``MOST_IMPULSES``.
    """
    if not shapers:
        raise OptionError("convolution: at least one shaper is needed")
    amplitudes, times = shapers[0].amplitudes, shapers[0].times_s
    for other in shapers[1:]:
        if len(times) * len(other.times_s) > MOST_IMPULSES:
            raise ShaperError(
                f"convolution of {len(shapers)} shapers: more than {MOST_IMPULSES} impulses",
                remedy="Shape fewer modes, or all at once with the kind direct.",
            )
        amplitudes = np.outer(amplitudes, other.amplitudes).ravel()
        times = np.add.outer(times, other.times_s).ravel()
        order = np.argsort(times, kind="stable")
        amplitudes, times = amplitudes[order], times[order]
        starts = np.concatenate(([0], np.flatnonzero(np.diff(times) > COINCIDENT_S) + 1))
        amplitudes, times = np.add.reduceat(amplitudes, starts), times[starts]
    return Shaper(
        amplitudes=amplitudes,
        times_s=times,
        name=name or "*".join(shaper.name for shaper in shapers),
    )
