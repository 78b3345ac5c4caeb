"""What a shaper does to modes above the one it was made for.

A positive train never amplifies: V <= 1 everywhere. A switched one has 3 to 7 impulses of full
size, and somewhere above its mode they add up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from threadline.shaping.types import FlexibleMode, Shaper
from threadline.shaping.vibration import residual_vibration, vibration_of

_STRETCH = 65536  # frequencies that are looked at together
# An undamped train's V repeats: of peaks alike but for rounding the lowest is told, everywhere.
_ALIKE = 1.0 + 1e-9
SEARCHED_RATIO = (1.5, 10.0)
"""Range of f / f_mode that is searched."""


@dataclass(frozen=True, slots=True)
class HigherModes:
    """Excitation above the shaped mode.

    Parameters
    ----------
    peak
        Largest V over 1.5 to 10 times the shaped frequency, at the mode's damping.
    peak_hz
        Where; the lowest of peaks alike.
    excited
        The machine's known modes that the shaper amplifies, each with its V.
    warnings
        Sentences for the user; empty when nothing is amplified.
    """

    peak: float
    peak_hz: float
    excited: tuple[tuple[FlexibleMode, float], ...]
    warnings: tuple[str, ...]


def check_higher_modes(
    shaper: Shaper, mode: FlexibleMode, known: Sequence[FlexibleMode] = ()
) -> HigherModes:
    """Find how much ``shaper``, made for ``mode``, excites everything above it.

    Parameters
    ----------
    shaper
        Any train.
    mode
        The mode that it was made for.
    known
        Other modes of the machine; those above ``mode`` are judged one by one.
    """
    ripple = 0.02 / max(shaper.duration_s * mode.frequency_hz, 0.1)
    low, high = SEARCHED_RATIO
    peak, peak_hz = 0.0, low * mode.frequency_hz
    count = int(np.ceil((high - low) / ripple)) + 1
    for first in range(0, count, _STRETCH):
        at = np.arange(first, min(first + _STRETCH, count))
        f = mode.frequency_hz * (low + ripple * at)
        v = residual_vibration(shaper, f, mode.damping_ratio)
        most = float(v.max())
        if most > peak * _ALIKE:
            peak, peak_hz = most, float(f[int(np.argmax(v * _ALIKE >= most))])
    judged = ((m, vibration_of(shaper, m)) for m in known if m.frequency_hz > mode.frequency_hz)
    excited = tuple((m, gain) for m, gain in judged if gain > 1.0 + 1e-9)
    warnings = [
        f"shaper '{shaper.name}' excites the mode at {m.frequency_hz:.4g} Hz {gain:.2f} times "
        "as much as the unshaped command"
        for m, gain in excited
    ]
    if peak > 1.0 + 1e-9:
        warnings.append(
            f"shaper '{shaper.name}' amplifies up to {peak:.2f} times between {low:g} and "
            f"{high:g} times {mode.frequency_hz:.4g} Hz, worst at {peak_hz:.4g} Hz: "
            "make sure that no mode lies there"
        )
    return HigherModes(peak, peak_hz, excited, tuple(warnings))
