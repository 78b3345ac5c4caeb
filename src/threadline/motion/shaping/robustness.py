"""The tolerance of a shaper to differences between a machine and its model.

Frequencies are undamped, V is normalised to one unit impulse, and the damping ratio is constant
over a frequency sweep.

A positive train never amplifies: V <= 1 at every frequency. A unit-magnitude train has 3 to 7
impulses of full size, which add up at some frequency above its mode.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError
from threadline.motion.shaping.response import crossing, residual_vibration, vibration_of
from threadline.motion.shaping.types import FlexibleMode, Shaper

_GRID_POINTS_A_STEP = 16384  # number of grid points per step
_SLACK = 1.0 + 1e-8
"""Factor on the tolerance: designed humps touch it, and rounding must not end the band there."""


@dataclass(frozen=True, slots=True)
class Insensitivity:
    """The interval of frequency around the mode in which V stays within the tolerance.

    Parameters
    ----------
    low_hz, high_hz
        Ends of the interval; both are the modelled frequency if V exceeds the tolerance there.
    frequency_hz
        The modelled frequency.
    tolerance
        The permitted V.
    """

    low_hz: float
    high_hz: float
    frequency_hz: float
    tolerance: float

    @property
    def value(self) -> float:
        """(f_hi - f_lo) / f."""
        return (self.high_hz - self.low_hz) / self.frequency_hz


def insensitivity(shaper: Shaper, mode: FlexibleMode, tolerance: float = 0.05) -> Insensitivity:
    """Return the interval around the mode in which V <= ``tolerance``, with ends to 1e-12 of f.

    The upper end is searched up to 10 f. The grid has a hundredth of the finest ripple that a train
    of this duration can have. Every maximum near the tolerance is refined, so that no hump above
    the tolerance is missed.

    Raises
    ------
    OptionError
        If ``tolerance`` is not in (0, 1).
    """
    if not 0.0 < tolerance < 1.0:
        raise OptionError(f"insensitivity: tolerance must be in (0, 1), got {tolerance!r}")
    f0, zeta, limit = mode.frequency_hz, mode.damping_ratio, tolerance * _SLACK

    def excess(f: float) -> float:
        return float(residual_vibration(shaper, f, zeta)) - limit

    if vibration_of(shaper, mode) > limit:
        return Insensitivity(f0, f0, f0, tolerance)
    step = 0.01 * min(f0, 1.0 / max(shaper.duration_s, 0.1 / f0))
    ends = []
    for end in (0.0, 10.0 * f0):
        count = max(2, int(np.ceil(abs(end - f0) / step)))
        crossings = (
            _first_crossing(excess, grid, residual_vibration(shaper, grid, zeta), limit)
            for grid in _stretches(f0, end, count)
        )
        ends.append(next((f for f in crossings if f is not None), end))
    return Insensitivity(ends[0], ends[1], f0, tolerance)


def _stretches(begin: float, end: float, count: int) -> Iterator[FloatArray]:
    """Yield the points of a grid of ``count`` steps; neighbouring stretches share a point.

    The crossing is usually in the first stretch. For a long train on a fast mode, a grid over the
    whole range would have millions of points.
    """
    for first_step in range(0, count, _GRID_POINTS_A_STEP):
        step_numbers = np.arange(
            max(first_step - 1, 0), min(first_step + _GRID_POINTS_A_STEP + 1, count) + 1
        )
        yield np.maximum(
            begin + (end - begin) / count * step_numbers, 0.0
        )  # a rounding below 0 is clamped


def _first_crossing(
    excess: Callable[[float], float], grid: FloatArray, v: FloatArray, limit: float
) -> float | None:
    """Return the first frequency of the (n,) ``grid`` at which V exceeds the limit, or None.

    ``v`` holds the (n,) values of V on the grid.
    """
    from scipy.optimize import minimize_scalar

    exceeding = np.flatnonzero(v > limit)
    stop = int(exceeding[0]) if len(exceeding) else len(grid) - 1
    maxima = np.flatnonzero((v[1:stop] >= v[: stop - 1]) & (v[1:stop] > v[2 : stop + 1])) + 1
    for i in maxima[v[maxima] > 0.98 * limit]:
        low, high = sorted((float(grid[i - 1]), float(grid[i + 1])))
        maximum = minimize_scalar(
            lambda f: -excess(f), bounds=(low, high), method="bounded", options={"xatol": 1e-12}
        )
        if -maximum.fun > 0.0:
            return crossing(excess, float(grid[i - 1]), float(maximum.x), xtol=1e-14)
    if not len(exceeding):
        return None
    return crossing(excess, float(grid[stop - 1]), float(grid[stop]), xtol=1e-14)


_FREQUENCIES_A_STEP = 65536  # number of frequencies per step
# V of an undamped train is periodic. Of peaks that are equal but for rounding, the lowest frequency
# is reported.
_ALIKE = 1.0 + 1e-9
SEARCHED_RATIO = (1.5, 10.0)
"""Range of f / f_mode that is searched for amplification."""


@dataclass(frozen=True, slots=True)
class HigherModes:
    """Excitation above the shaped mode.

    Parameters
    ----------
    peak
        Largest V over 1.5 to 10 times the shaped frequency, at the mode's damping.
    peak_hz
        Frequency of the largest V; the lowest of equal peaks.
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
    """Return how strongly ``shaper``, made for ``mode``, excites everything above it.

    Parameters
    ----------
    shaper
        The impulse train.
    mode
        The mode that it was made for.
    known
        Other modes of the machine; every mode above ``mode`` is judged by itself.
    """
    ripple = 0.02 / max(shaper.duration_s * mode.frequency_hz, 0.1)
    low, high = SEARCHED_RATIO
    peak, peak_hz = 0.0, low * mode.frequency_hz
    count = int(np.ceil((high - low) / ripple)) + 1
    for first_step in range(0, count, _FREQUENCIES_A_STEP):
        step_numbers = np.arange(first_step, min(first_step + _FREQUENCIES_A_STEP, count))
        f = mode.frequency_hz * (low + ripple * step_numbers)
        v = residual_vibration(shaper, f, mode.damping_ratio)
        largest = float(v.max())
        if largest > peak * _ALIKE:
            peak, peak_hz = largest, float(f[int(np.argmax(v * _ALIKE >= largest))])
    gains = ((m, vibration_of(shaper, m)) for m in known if m.frequency_hz > mode.frequency_hz)
    excited = tuple((m, gain) for m, gain in gains if gain > 1.0 + 1e-9)
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
