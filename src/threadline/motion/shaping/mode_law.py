"""The law made for a mode: the shortest window that keeps the residual over a band of frequency.

The acceleration is a spline of degree 2 on even knots. Its coefficients bound the acceleration, the
coefficients of its derivative bound the jerk, and the coefficients of its integral bound the
velocity. So limits and monotonicity are rows of a linear program that hold at all times, not only
at samples. The complex residual at a frequency (:mod:`threadline.motion.shaping.law_residual`) is
linear in the coefficients. Its magnitude is bounded by the sides of a regular polygon inside the
circle. For a given window, the program finds the least residual over the band. Bisection finds the
shortest window whose least residual is small enough.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, pi, sqrt

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError
from threadline.motion.laws import Law, law_of_velocity
from threadline.motion.shaping.law_residual import residual_m
from threadline.motion.shaping.solvers import InfeasibleError, minimise
from threadline.motion.shaping.types import FlexibleMode, ShaperError

RAMPS = 16.0
"""The default jerk reaches full acceleration from zero in the rigid window divided by this."""
_COEFFICIENTS = 80
_LEVELS = 160
_FREQUENCIES = 50  # number per turn of the phase between the ends of the band, over the window
MOST_FREQUENCIES = 161
_USED_RESIDUAL = 0.996  # share of the residual: between two frequencies it may be a little larger
_SIDES = 16
_CHECKED = 41
_LEAST = 1e-6  # share of the move: least residual; the tolerance of the solver is a tenth of it
_STEP_S = 5e-5
_LONGEST = 12.0  # periods of the mode by which a window may exceed 1.25 rigid windows
_PERIODS = (0.02, 12.0)  # least and largest rigid window, in periods of the mode

ProgressCall = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Demand:
    """Requirements on a law.

    Parameters
    ----------
    mode
        Mode at the middle of the band.
    band
        Half width of the band as a share of the frequency: 0.1 is +-10 %.
    move_m, residual_m
        Length of the move and amplitude allowed when it ends, m.
    acceleration_m_s2, jerk_m_s3
        Limits; the jerk limit may be infinite.
    """

    mode: FlexibleMode
    band: float
    move_m: float
    residual_m: float
    acceleration_m_s2: float
    jerk_m_s3: float

    def __post_init__(self) -> None:
        for what, value in (
            ("move", self.move_m),
            ("residual", self.residual_m),
            ("acceleration", self.acceleration_m_s2),
            ("jerk", self.jerk_m_s3),
        ):
            if not value > 0.0 or (what != "jerk" and not np.isfinite(value)):
                raise OptionError(f"law for a mode: the {what} must be positive, got {value:g}")
        if self.residual_m < _LEAST * self.move_m:
            raise OptionError(
                f"law for a mode: the residual of {self.residual_m * 1e3:g} mm is less than a "
                f"millionth of the move of {self.move_m * 1e3:g} mm, which no program resolves",
                remedy="Allow more.",
            )
        periods = self.rigid_s * self.mode.frequency_hz
        if not _PERIODS[0] <= periods <= _PERIODS[1]:
            raise OptionError(
                f"law for a mode: within {self.acceleration_m_s2:g} m/s^2 a rigid machine takes "
                f"{self.rigid_s:.3g} s, {periods:.3g} periods of the mode; it must be from "
                f"{_PERIODS[0]:g} to {_PERIODS[1]:g}",
                remedy="A mode so much slower or faster than the move rings alike by any law.",
            )
        if not 0.0 <= self.band < 1.0:
            raise OptionError(f"law for a mode: the band must be in [0, 1), got {self.band:g}")

    @property
    def rigid_s(self) -> float:
        """Shortest window of a rigid machine: full acceleration, then full deceleration."""
        return 2.0 * sqrt(self.move_m / self.acceleration_m_s2)


def usual_jerk_m_s3(move_m: float, acceleration_m_s2: float) -> float:
    """Return the jerk that reaches the acceleration in a 16th of the rigid window.

    In the rigid window this is Cj = 64. For comparison, Cj is 60 for 3-4-5 and 69 for modified
    sine.
    """
    return acceleration_m_s2 * RAMPS / (2.0 * sqrt(move_m / acceleration_m_s2))


@dataclass(frozen=True, slots=True, kw_only=True)
class MadeLaw:
    """A law made for a mode, and bounds to compare it with.

    Parameters
    ----------
    law, window_s
        The law and its window.
    simulated_m
        Largest amplitude over the band in an integration independent of the program.
    acceleration_m_s2, jerk_m_s3, velocity_m_s
        Peaks.
    free_levels_s
        Shortest window for the same band, s, if the acceleration may step between its limits.
    time_optimal_s
        Shortest window, s, for the mode's exact frequency, if the acceleration may step.
    """

    demand: Demand
    law: Law
    window_s: float
    simulated_m: float
    velocity_m_s: float
    acceleration_m_s2: float
    jerk_m_s3: float
    free_levels_s: float
    time_optimal_s: float


def made_law(demand: Demand, progress: ProgressCall | None = None) -> MadeLaw:
    """Return the law for ``demand`` with the shortest window.

    Raises
    ------
    ShaperError
        If no window up to 1.25 rigid windows and 12 periods of the mode suffices, a program fails,
        or the simulation exceeds the demand.
    """
    smooth = _Spline(demand, _COEFFICIENTS, 2)
    window_s = _shortest(smooth, demand, progress, "law for the mode", 0.0)
    coefficients = smooth.solve(window_s)[1]
    law = _law(smooth, coefficients)
    simulated = simulate_band(law, demand, window_s)
    scale = demand.move_m / window_s
    peaks_si = [law.velocity * scale, law.acceleration * scale / window_s]
    jerk = (law.jerk or np.inf) * scale / window_s**2
    if simulated > demand.residual_m or peaks_si[1] > 1.001 * demand.acceleration_m_s2:
        raise ShaperError(
            f"law for the mode: a simulation finds {simulated * 1e3:.4g} mm after the move and "
            f"{peaks_si[1]:.4g} m/s^2, more than the {demand.residual_m * 1e3:g} mm and "
            f"{demand.acceleration_m_s2:g} m/s^2 that it was made for"
        )
    stepping = Demand(
        mode=demand.mode, band=demand.band, move_m=demand.move_m, residual_m=demand.residual_m,
        acceleration_m_s2=demand.acceleration_m_s2, jerk_m_s3=np.inf,
    )  # fmt: skip
    exact = Demand(
        mode=demand.mode, band=0.0, move_m=demand.move_m, residual_m=demand.residual_m,
        acceleration_m_s2=demand.acceleration_m_s2, jerk_m_s3=np.inf,
    )  # fmt: skip
    return MadeLaw(
        demand=demand, law=law, window_s=window_s, simulated_m=simulated, velocity_m_s=peaks_si[0],
        acceleration_m_s2=peaks_si[1], jerk_m_s3=jerk,
        free_levels_s=_shortest(
            _Spline(stepping, _LEVELS, 0), stepping, progress, "free levels", 0.5
        ),
        time_optimal_s=_shortest(_Spline(exact, _LEVELS, 0), exact, progress, "time-optimal", 0.8),
    )  # fmt: skip


def simulate_band(law: Law, demand: Demand, window_s: float) -> float:
    """Return the largest amplitude over the band at the end of the move, m, by integration.

    scipy's DOP853 integrates the relative position and velocity of the load; the base has the
    acceleration of the law.
    """
    from scipy.integrate import solve_ivp

    omega = 2.0 * pi * _band(demand, _CHECKED)
    zeta, count = demand.mode.damping_ratio, len(omega)

    def rates(t: float, state: FloatArray) -> FloatArray:
        base = float(law(t / window_s, 2)[0]) * demand.move_m / window_s**2
        q, speed = state[:count], state[count:]
        return np.concatenate((speed, -base - 2.0 * zeta * omega * speed - omega**2 * q))

    solution = solve_ivp(
        rates, (0.0, window_s), np.zeros(2 * count), method="DOP853", rtol=1e-8,
        atol=1e-9 * demand.move_m, max_step=window_s / 100.0,
    )  # fmt: skip
    q, speed = solution.y[:count, -1], solution.y[count:, -1]
    damped = omega * sqrt(1.0 - zeta**2)
    return float(np.hypot(q, (speed + zeta * omega * q) / damped).max())


def outside(made: MadeLaw, ratios: FloatArray) -> FloatArray:
    """Return the residuals, m, of the made law at the mode times ``ratios``, shape (n,)."""
    demand = made.demand
    window = np.array([made.window_s])
    zeta = demand.mode.damping_ratio
    return np.array(
        [
            residual_m(
                made.law,
                FlexibleMode(ratio * demand.mode.frequency_hz, zeta),
                demand.move_m,
                window,
            )[0]
            for ratio in ratios.tolist()
        ]
    )


def _band(demand: Demand, count: int) -> FloatArray:
    f = demand.mode.frequency_hz
    if demand.band == 0.0:
        return np.array([f])
    return np.linspace(f * (1.0 - demand.band), f * (1.0 + demand.band), count)


class _Spline:
    """The linear program for splines of one degree; only some of its data depends on the window."""

    def __init__(self, demand: Demand, count: int, degree: int) -> None:
        self.demand, self.count, self.degree = demand, count, degree
        inner_knots = np.linspace(0.0, 1.0, count - degree + 1)
        self.knots = np.concatenate((np.zeros(degree), inner_knots, np.ones(degree)))
        nodes, weights = np.polynomial.legendre.leggauss(6)
        half_widths = 0.5 * np.diff(inner_knots)
        self.u = ((inner_knots[:-1] + half_widths)[:, None] + half_widths[:, None] * nodes).ravel()
        self.weights = (half_widths[:, None] * weights).ravel()
        from scipy.interpolate import BSpline

        self.basis = BSpline.design_matrix(self.u, self.knots, degree).toarray()
        spans = self.knots[degree + 1 : degree + 1 + count] - self.knots[:count]
        # The velocity is a spline of the next degree; this matrix gives its coefficients.
        self.velocity = np.cumsum(np.eye(count) * spans / (degree + 1), axis=0)
        self.rise = (self.weights * (1.0 - self.u)) @ self.basis

    def residual_rows(self, window_s: float) -> FloatArray:
        """Return (rows, count) residual over the wanted one, by frequency and direction."""
        d = self.demand
        phase_turns = 2.0 * d.band * d.mode.frequency_hz * window_s
        count = int(min(max(5.0, np.ceil(_FREQUENCIES * phase_turns)), MOST_FREQUENCIES))
        omega = 2.0 * pi * _band(d, count)
        zeta = d.mode.damping_ratio
        damped = omega * sqrt(1.0 - zeta**2)
        pole = zeta * omega + 1j * damped
        weighted_decay = np.exp(-window_s * pole[:, None] * (1.0 - self.u)) * self.weights
        relative_rows = (weighted_decay @ self.basis) * (
            d.move_m / (window_s * damped * _USED_RESIDUAL * d.residual_m)
        )[:, None]
        angles = 2.0 * pi * np.arange(_SIDES) / _SIDES
        # A residual within the sides of a polygon inside the circle is within the circle.
        sides = np.exp(-1j * angles)[:, None, None] * relative_rows / cos(pi / _SIDES)
        return np.asarray(sides.real.reshape(-1, self.count))

    def solve(self, window_s: float) -> tuple[float, FloatArray]:
        """Return the least residual over the wanted one, and the (count,) coefficients."""
        d, n = self.demand, self.count
        residual = self.residual_rows(window_s)
        rows = [np.hstack((residual, -np.ones((len(residual), 1))))]
        values = [np.zeros(len(residual))]
        rows.append(np.hstack((-self.velocity[:-1], np.zeros((n - 1, 1)))))
        values.append(np.zeros(n - 1))
        if self.degree and np.isfinite(d.jerk_m_s3):
            spans = self.knots[self.degree + 1 : self.degree + n] - self.knots[1:n]
            slopes = np.diff(np.eye(n), axis=0) * self.degree / spans[:, None]
            bound = d.jerk_m_s3 * window_s**3 / d.move_m
            for sign in (1.0, -1.0):
                rows.append(np.hstack((sign * slopes, np.zeros((n - 1, 1)))))
                values.append(np.full(n - 1, bound))
        bound = d.acceleration_m_s2 * window_s**2 / d.move_m
        end_bounds = (0.0, 0.0) if self.degree else (-bound, bound)
        equal = np.zeros((2, n + 1))
        equal[0, :n], equal[1, :n] = self.rise, self.velocity[-1]
        solution = minimise(
            np.append(np.zeros(n), 1.0),
            equal=(equal, np.array([1.0, 0.0])),
            below=(np.vstack(rows), np.concatenate(values)),
            bounds=[end_bounds, *[(-bound, bound)] * (n - 2), end_bounds, (0.0, None)],
            what="law for the mode",
            seconds=30.0,
        )
        return float(solution.x[-1]), solution.x[:-1]


def _shortest(
    spline: _Spline, demand: Demand, progress: ProgressCall | None, what: str, progress_begun: float
) -> float:
    """Return the shortest window in which the program keeps the residual, to 0.05 ms."""

    def suffices(window_s: float) -> bool:
        try:
            return spline.solve(window_s)[0] <= 1.0
        except InfeasibleError:
            return False

    low, high = 0.999 * demand.rigid_s, 1.25 * demand.rigid_s
    longest_s = high + _LONGEST / demand.mode.frequency_hz
    while not suffices(high):
        if high > longest_s:
            raise ShaperError(
                f"{what}: no window up to {longest_s * 1e3:.4g} ms keeps "
                f"{demand.residual_m * 1e3:g} mm over +-{demand.band * 100:g} % of "
                f"{demand.mode.frequency_hz:g} Hz",
                remedy="Allow more acceleration, more residual or a narrower band.",
            )
        low, high = high, 1.5 * high
    first_width = high - low
    while high - low > _STEP_S:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if suffices(middle) else (middle, high)
        if progress is not None:
            share = np.log(first_width / (high - low)) / np.log(first_width / _STEP_S)
            progress(what, min(1.0, progress_begun + 0.2 * float(share)))
    return high


def _law(spline: _Spline, coefficients: FloatArray) -> Law:
    """Return the law of a solution; no coefficient of its velocity is negative: it is monotone."""
    degree = spline.degree + 1
    velocity = np.maximum(np.concatenate(([0.0], spline.velocity @ coefficients)), 0.0)
    velocity[-1] = 0.0
    knots = np.concatenate(([0.0], spline.knots, [1.0]))
    return law_of_velocity("made", knots, velocity, degree)
