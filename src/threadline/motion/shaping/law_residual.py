"""Residual vibration after a motion law: one mode on a base that follows the law exactly.

The load on the base obeys ``q'' + 2 zeta omega q' + omega**2 q = -y''``, q its position relative to
the base and y the motion of the base. After the move q rings down with the envelope

    R exp(-zeta omega (t - T)),  R = h / (T omega_d) |integral s''(u) exp(-p T (1 - u)) du|,

p = zeta omega + i omega_d, integral over [0, 1]; R is the residual amplitude of this module. It is
computed by Gauss-Legendre quadrature on the stretches on which the law is smooth.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, pi, sqrt

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.errors import OptionError
from threadline.motion.laws import Law, gauss
from threadline.motion.shaping.types import FlexibleMode

_RADIANS, _POINTS = 6.0, 16  # phase of the mode, and number of nodes, per panel: exact to rounding
_LITTLE, _FEW_POINTS = 0.5, 6
_PER_PERIOD = 32  # number of windows tried per period of the mode
_CHUNK = 2_000_000
_FINER = 16  # factor on the number of windows in a scan for all lengths at once
_SHORTEST = 1e-2  # periods in the shortest window of that scan, in which the load hardly moves
_FINEST = 1e-6  # share of the move: least residual of a search
_MOST_PERIODS = 3000.0
_SHORTEST_M, _LONGEST_M = 1e-9, 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class Ringing:
    """Residual vibration of a law after a move.

    Parameters
    ----------
    law
        The law.
    residual_m
        Amplitude at the end of the move.
    worst_m, worst_window_s
        The largest amplitude over this and all longer windows, and the window of that amplitude.
    window_s
        The shortest window such that it and all longer windows keep the wanted residual and
        acceleration; None without a wanted residual.
    """

    law: Law
    residual_m: float
    worst_m: float
    worst_window_s: float
    window_s: float | None = None


def swing(law: Law, mode: FlexibleMode, window_s: FloatArray) -> ComplexArray:
    """Return the (n,) residual vibration at the end of a move of 1 m, for (n,) windows, s.

    The imaginary part of the complex number Z is the position of the load relative to its base. It
    continues as ``Z exp(-p t)`` after the move, and the residuals of several moves add up.
    """
    omega = 2.0 * pi * mode.frequency_hz
    damped = omega * sqrt(1.0 - mode.damping_ratio**2)
    pole = mode.damping_ratio * omega + 1j * damped
    edges = law.edges
    largest_phase = omega * float(window_s.max(initial=0.0)) * float(np.diff(edges).max())
    # On a short stretch of a table the law is a cubic and the phase of the mode hardly changes, so
    # few nodes are enough.
    points = _POINTS if largest_phase > _LITTLE else _FEW_POINTS
    u, weights = gauss(edges, max(1, ceil(largest_phase / _RADIANS)), points)
    weighted_acceleration = law(u, 2) * weights
    out = np.empty(window_s.shape, dtype=np.complex128)
    rows = max(1, _CHUNK // len(u))
    for k in range(0, len(window_s), rows):
        windows = window_s[k : k + rows]
        integrals = np.exp(-pole * np.outer(windows, 1.0 - u)) @ weighted_acceleration
        out[k : k + rows] = integrals / (windows * damped)
    return out


def residual_m(law: Law, mode: FlexibleMode, move_m: float, window_s: FloatArray) -> FloatArray:
    """Return the residual amplitudes, m, for windows of shape (n,), s."""
    return np.asarray(move_m * np.abs(swing(law, mode, window_s)))


def lasting_windows_s(
    law: Law, mode: FlexibleMode, moves_m: FloatArray, residual: float, longest_s: float = np.inf
) -> FloatArray:
    """Return (n,) the shortest windows such that all longer windows keep the residual, s.

    One scan of windows, 512 per period of the mode, serves all moves: the amplitude is proportional
    to the length. If no window up to ``longest_s`` keeps the residual, the result is ``longest_s``.

    Parameters
    ----------
    moves_m
        (n,) lengths, m, 0 or more; the result is 0 for a move so short that every window keeps the
        residual.
    residual
        Amplitude, m.
    longest_s
        Longer windows are not scanned, s.
    """
    longest_move_m = float(moves_m.max(initial=0.0))
    if longest_move_m == 0.0:
        return np.zeros(len(moves_m))
    shortest_s = _SHORTEST / mode.frequency_hz
    coarse_windows = _grid(law, mode, longest_move_m, shortest_s, residual, longest_s)
    windows = np.linspace(shortest_s, float(coarse_windows[-1]), _FINER * len(coarse_windows))
    # The largest amplitude over a window and all longer windows decreases with the window.
    worst = np.maximum.accumulate(np.abs(swing(law, mode, windows))[::-1])[::-1]
    allowed = np.divide(residual, moves_m, out=np.full(len(moves_m), np.inf), where=moves_m > 0.0)
    window_index = np.searchsorted(-worst, -allowed)
    return np.where(window_index > 0, windows[np.minimum(window_index, len(windows) - 1)], 0.0)


def ringing(
    law: Law,
    mode: FlexibleMode,
    move_m: float,
    window_s: float,
    *,
    residual: float | None = None,
    acceleration: float = np.inf,
) -> Ringing:
    """Return the residual vibration of ``law`` after a move of ``move_m`` in ``window_s``.

    Parameters
    ----------
    residual
        Allowed amplitude, m, for the search of the shortest window; None for no search.
    acceleration
        Largest acceleration of the law in that window, m/s^2.

    Raises
    ------
    OptionError
        If a number is not positive or unrealistic, the time is far from the period of the mode, or
        the residual too small to search for.
    """
    for what, value in (("move", move_m), ("time", window_s), ("residual", residual)):
        if value is not None and not (0.0 < value < np.inf):
            raise OptionError(f"the {what} must be positive, got {value:g}")
    if not _SHORTEST_M <= move_m <= _LONGEST_M:
        raise OptionError(
            f"the move must be from {_SHORTEST_M:g} to {_LONGEST_M:g} m, got {move_m:g} m"
        )
    period = 1.0 / mode.frequency_hz
    if not 1e-3 * period <= window_s <= _MOST_PERIODS * period:
        raise OptionError(
            f"the time of {window_s:g} s is {window_s / period:.3g} periods of the mode, it must "
            f"be from 0.001 to {_MOST_PERIODS:g}",
            remedy="A mode so much slower or faster than the move rings alike by any law.",
        )
    windows_near = np.linspace(window_s, window_s + 3.0 * period, 3 * _PER_PERIOD + 1)
    residuals_near = residual_m(law, mode, move_m, windows_near)
    least_worst = max(float(residuals_near.max()), _FINEST * move_m)
    longer_windows = _grid(law, mode, move_m, window_s, least_worst)
    longer_residuals = residual_m(law, mode, move_m, longer_windows)
    worst_index = int(np.argmax(longer_residuals))
    worst, worst_at = _peak(law, mode, move_m, longer_windows, worst_index)
    shortest = None
    if residual is not None:
        shortest = max(
            _window_for(law, mode, move_m, residual), sqrt(law.acceleration * move_m / acceleration)
        )
    return Ringing(
        law=law, residual_m=float(residuals_near[0]), worst_m=worst, worst_window_s=worst_at,
        window_s=shortest,
    )  # fmt: skip


def _bound_s(law: Law, mode: FlexibleMode, move_m: float, residual: float) -> float:
    """Return a window, s, such that all longer windows have less than ``residual``, m.

    The integral in the docstring of the module is at most V2 / (omega T), where V2 is the total
    variation of s''. If the jerk is finite, it is also at most V3 / (omega T)^2, where V3 is the
    total variation of s'''.
    """
    u = np.linspace(0.0, 1.0, 8001)
    omega = 2.0 * pi * mode.frequency_hz
    damped = omega * sqrt(1.0 - mode.damping_ratio**2)

    def variation(derivative: int) -> float:
        return float(np.abs(np.diff(law(u, derivative), prepend=0.0, append=0.0)).sum())

    windows = [sqrt(move_m * variation(2) / (damped * omega * residual))]
    if law.jerk is not None:
        windows.append((move_m * variation(3) / (damped * omega**2 * residual)) ** (1.0 / 3.0))
    return 1.01 * min(windows)


def _grid(
    law: Law,
    mode: FlexibleMode,
    move_m: float,
    window_s: float,
    residual: float,
    longest_s: float = np.inf,
) -> FloatArray:
    """Return (n,) windows, s, from ``window_s`` to the window whose bound is ``residual``."""
    bound = min(_bound_s(law, mode, move_m, residual), longest_s)
    end = max(bound, window_s + 1.0 / mode.frequency_hz)
    periods = (end - window_s) * mode.frequency_hz
    if periods > _MOST_PERIODS:
        raise OptionError(
            f"law {law.name}: a residual of {residual:.3g} m is reached for certain only after "
            f"{periods:.3g} periods of the mode, at most {_MOST_PERIODS:g} are looked at",
            remedy="Ask for a larger residual.",
        )
    return np.linspace(window_s, end, ceil(periods * _PER_PERIOD) + 1)


def _peak(
    law: Law, mode: FlexibleMode, move_m: float, windows: FloatArray, at: int
) -> tuple[float, float]:
    """Return the largest residual near ``windows[at]``, m, and its window, s."""
    low, high = windows[max(at - 1, 0)], windows[min(at + 1, len(windows) - 1)]
    for _ in range(3):
        fine = np.linspace(low, high, 33)
        values = residual_m(law, mode, move_m, fine)
        best_index = int(np.argmax(values))
        low, high = fine[max(best_index - 1, 0)], fine[min(best_index + 1, 32)]
    return float(values[best_index]), float(fine[best_index])


def _window_for(law: Law, mode: FlexibleMode, move_m: float, residual: float) -> float:
    """Return the shortest window, s, such that all longer ones have at most ``residual``."""
    shortest_s = 0.25 / mode.frequency_hz
    windows = _grid(law, mode, move_m, shortest_s, residual)
    residuals = residual_m(law, mode, move_m, windows)
    exceeding = np.flatnonzero(residuals > residual)
    # If the residual exceeds the limit only between two windows, its peak is beside a local
    # maximum.
    lobes = 1 + np.flatnonzero(
        (residuals[1:-1] >= residuals[:-2]) & (residuals[1:-1] >= residuals[2:])
    )
    last_exceeding = int(exceeding[-1]) if len(exceeding) else 0
    for lobe in lobes[(lobes > last_exceeding) & (residuals[lobes] > 0.98 * residual)][::-1]:
        value, peak_window_s = _peak(law, mode, move_m, windows, int(lobe))
        if value > residual:
            return _crossing(law, mode, move_m, residual, peak_window_s, float(windows[lobe + 1]))
    if not len(exceeding):
        return shortest_s
    return _crossing(
        law,
        mode,
        move_m,
        residual,
        float(windows[last_exceeding]),
        float(windows[min(last_exceeding + 1, len(windows) - 1)]),
    )


def _crossing(
    law: Law, mode: FlexibleMode, move_m: float, residual: float, low: float, high: float
) -> float:
    for _ in range(40):
        middle = 0.5 * (low + high)
        exceeds = residual_m(law, mode, move_m, np.array([middle]))[0] > residual
        low, high = (middle, high) if exceeds else (low, middle)
    return high
