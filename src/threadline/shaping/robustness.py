"""How far a machine may differ from its model before a shaper stops working.

Frequencies are undamped, V is normalised to one unit impulse, and the damping ratio is held
while the frequency sweeps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from threadline.arrays import FloatArray, Locked, read_only
from threadline.errors import OptionError
from threadline.shaping.sign_changes import crossing
from threadline.shaping.types import FlexibleMode, Shaper
from threadline.shaping.vibration import residual_vibration, vibration_of

_STRETCH = 16384  # points of a grid that are looked at together
_SLACK = 1.0 + 1e-8
"""Designed humps touch the tolerance; rounding must not make a gap of that."""


@dataclass(frozen=True, slots=True, eq=False)
class SensitivityMap(Locked):
    """V over frequency and damping.

    Parameters
    ----------
    frequency_hz, damping_ratio
        Axes, shapes ``(m,)`` and ``(k,)``.
    vibration
        Shape ``(k, m)``: a row is a curve over frequency at one damping ratio.
    """

    frequency_hz: FloatArray
    damping_ratio: FloatArray
    vibration: FloatArray

    def __post_init__(self) -> None:
        for name, ndim in (("frequency_hz", 1), ("damping_ratio", 1), ("vibration", 2)):
            object.__setattr__(self, name, read_only(getattr(self, name), name, ndim=ndim))


def sensitivity_map(
    shaper: Shaper, frequency_hz: ArrayLike, damping_ratio: ArrayLike
) -> SensitivityMap:
    """V of ``shaper`` on every pair of frequency (Hz, (m,)) and damping ratio ((k,)).

    A curve is a map with one damping ratio, or with one frequency.
    """
    f = np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
    z = np.atleast_1d(np.asarray(damping_ratio, dtype=np.float64))
    return SensitivityMap(f, z, residual_vibration(shaper, f[None, :], z[:, None]))


@dataclass(frozen=True, slots=True)
class Insensitivity:
    """The interval of frequency around the mode in which V stays within the tolerance.

    Parameters
    ----------
    low_hz, high_hz
        Its ends; both the modelled frequency where V is above the tolerance even there.
    frequency_hz
        The modelled frequency.
    tolerance
        The V that is allowed.
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
    """Interval around the mode in which V <= ``tolerance``, its ends to 1e-12 of f.

    The upper end is looked for up to 10 f. Crossings are found on a grid of a hundredth of the
    finest ripple that a train of this length can have, and every maximum near the tolerance
    is refined, so that a hump above it isn't stepped over.

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
    """Yield the points of a grid of ``count`` steps, each stretch with a point of its neighbours.

    The crossing is near the mode as a rule: of a long train beside a fast mode a grid of the whole
    range would have millions of points.
    """
    for first in range(0, count, _STRETCH):
        at = np.arange(max(first - 1, 0), min(first + _STRETCH + 1, count) + 1)
        yield np.maximum(begin + (end - begin) / count * at, 0.0)  # a rounding below 0 is 0


def _first_crossing(
    excess: Callable[[float], float], grid: FloatArray, v: FloatArray, limit: float
) -> float | None:
    """Return where V, ``v`` on the (n,) ``grid``, first exceeds the limit; None if nowhere."""
    from scipy.optimize import minimize_scalar

    over = np.flatnonzero(v > limit)
    stop = int(over[0]) if len(over) else len(grid) - 1
    tops = np.flatnonzero((v[1:stop] >= v[: stop - 1]) & (v[1:stop] > v[2 : stop + 1])) + 1
    for i in tops[v[tops] > 0.98 * limit]:
        low, high = sorted((float(grid[i - 1]), float(grid[i + 1])))
        found = minimize_scalar(
            lambda f: -excess(f), bounds=(low, high), method="bounded", options={"xatol": 1e-12}
        )
        if -found.fun > 0.0:
            return crossing(excess, float(grid[i - 1]), float(found.x), xtol=1e-14)
    if not len(over):
        return None
    return crossing(excess, float(grid[stop - 1]), float(grid[stop]), xtol=1e-14)
