r"""Robust moving averages: smoothing weights with little vibration over all tolerances.

Feed-forward plans for the nominal machine. On a machine with other masses or stiffnesses the load
vibrates after each change of speed, because the intended motion excites its mode. The moving
average that smooths a motion for the inverse has many weights. Only the sum and the first moment of
the weights are fixed, which preserves straight lines and times. Otherwise the weights are free, and
the problem is linear: the response of every machine to a change of speed is a weighted sum of its
responses to shifted splines.

.. math:: \min_w \epsilon, \quad |S_k(t) - 1| \le \epsilon \text{ once the speed must be constant},
          \quad S_k(t) = \sum_i w_i B_k(t - i h)

over all machines k, where ``B_k`` is the response to a step of speed at time 0 that is smoothed
only by the spline. A stop is a start in reversed time. There are further constraints: the load
reaches its speed in time after its departure (:data:`STILL`, :data:`THERE`), it stays near its
position while another axis moves, and the current stays within the limits of the amplifiers. The
linear program contains only the binding instants: instants at which its result violates a
constraint are added, and the program is solved again.

Every program is feasible, because all hard constraints share an excess variable. Its cost is so
high that it is 0 if possible. If it exceeds a margin, there are no admissible weights. Programs
that may be infeasible are avoided because HiGHS often fails on them, here with nearly equal
neighbouring rows; it also fails on some feasible programs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.base.linear_programs import QUICK
from threadline.dynamics.inverse import CornerResponse
from threadline.errors import PlanError

Answers = dict[CornerResponse, tuple[FloatArray, FloatArray | None]]
"""(samples, count) responses of each machine to a step of speed, one per weight: load speed / step,
and current / step in A s/m or A s/rad (None without a coil)."""


def frequencies_rad_s(period_s: float, count: int) -> FloatArray:
    """Return the (count // 2 + 1,) frequencies, rad/s, of the real Fourier transform of samples.

    The frequency 0 is replaced by a very low frequency.
    """
    omega = 2.0 * np.pi * np.fft.rfftfreq(count, period_s)
    omega[0] = 1e-3 * omega[1]
    return np.asarray(omega)


@dataclass(frozen=True, slots=True, kw_only=True)
class WeightGrid:
    """Instants of the weights, and of the responses from which the weights are computed.

    Parameters
    ----------
    count, step_s
        Number of weights, and the time from weight to weight.
    degree
        Degree of the uniform B-spline whose control points are the averages; its knots are
        ``step_s`` apart.
    grid_s, samples
        Spacing and number of the instants of responses; the responses of machines are sampled at
        ``frequencies_rad_s(grid_s, samples)``.
    """

    count: int
    step_s: float
    degree: int
    grid_s: float
    samples: int

    @property
    def shift_s(self) -> FloatArray:
        """(count,) instants of the weights, s; their mean is 0."""
        return np.asarray((np.arange(self.count) - 0.5 * (self.count - 1)) * self.step_s)

    @property
    def instants_s(self) -> FloatArray:
        """(samples,) instants of the responses around the step, s."""
        return np.asarray((np.arange(self.samples) - self.samples // 2) * self.grid_s)


def _answer_steps(answers: Answers, machines: Sequence[CornerResponse], grid: WeightGrid) -> None:
    """Add the missing responses of ``machines`` to ``answers``."""
    missing = [machine for machine in machines if machine not in answers]
    if not missing:
        return
    samples = grid.samples
    omega = frequencies_rad_s(grid.grid_s, samples)
    spline = np.sinc(omega * grid.step_s / (2.0 * np.pi)) ** (grid.degree + 1)
    delay_s = grid.shift_s + samples // 2 * grid.grid_s
    weight_spectrum = spline[:, None] * np.exp(-1j * omega[:, None] * delay_s)

    def speed_steps(answer: NDArray[np.complex128]) -> FloatArray:
        return np.asarray(
            np.cumsum(np.fft.irfft(answer[:, None] * weight_spectrum, samples, axis=0), axis=0)
        )

    for machine in missing:
        current = None if machine.current_s_a_m is None else speed_steps(machine.current_s_a_m)
        answers[machine] = speed_steps(machine.load), current


STILL, THERE, ACROSS = 0.0065, 0.953, 0.1
"""Speeds as shares of the intended speed: largest speed of the nominal load that counts as rest;
smallest speed of every machine that counts as reached; largest speed of a load while another axis
moves. Seams require 1 % and 95 % for the first two. A tenth of the speed across the path makes the
speed along the path 0.5 % higher."""
_THERE_RESERVE = 0.012  # share of the speed that is added to THERE if it costs little
_FIRST_ROWS = 2048  # every n-th instant is in the first program; violated instants are added
_MOST_ROUNDS = 100
_MAX_VIOLATION = 1e-6  # largest violation at any instant, as a share of the step
_LEAST_COST_RISE = 1e-9  # a smaller increase of the cost, as a share, does not count
_DROPPED_RESERVE = (
    0.01  # instants with more reserve, as a share of the step, leave the next program
)
MEAN_S = 0.0021
"""Time over which a speed is measured, with a small reserve, s."""
_LOAD_CHECK_TIMES = 16.0  # the load is checked for so many times the time of a change after it
_CURRENT_CHECK_TIMES = (
    4.0  # the current is checked so many times the time of a change before and after it
)
_ERROR, _SHARE, _LATE, _EXCESS = 0, 1, 2, 4
"""Indices of slacks: constant speed, current, reached speed, and all hard constraints (4). Index 3
is the largest weight."""
_LATE_COSTS = 0.1  # cost of a speed not yet reached, relative to the largest error
_CURRENT_COST = 0.05  # cost of the share of the current, relative to the largest error
_LARGEST_WEIGHT_COST = 1e-4  # cost of the largest weight, relative to the largest error
_WEIGHT_COST = 1e-5
"""Cost of the magnitude of a weight, relative to the largest error; it rises to twice this number
for the last weight. It makes the optimum unique and independent of rounding if many sets of weights
have the same error."""
_EXCESS_COSTS = 1000.0
"""Cost of the excess of hard constraints: an excess of ``_MARGIN`` costs as much as an error of a
tenth of the speed, with which the weights would be useless."""
_MARGIN = 1e-4  # allowed violation of a hard constraint, as a share of speed, room or current
_MAX_WEIGHT = 10.0  # bound on weights; actual weights are below 0.3
_MAX_COST = 1.0 + _CURRENT_COST + _LATE_COSTS * _THERE_RESERVE + _EXCESS_COSTS * _MARGIN
"""Cost above which a program is abandoned: the error is then as large as the speed, or the excess
exceeds the margin. The cost of the weights is negligible."""
_MAX_ROW_VIOLATION = (
    0.5 * _MAX_VIOLATION
)  # a solution is rejected if it violates a row of its program by more


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepOfSpeed:
    """The largest change of speed of one axis, and the machines that must follow it.

    Parameters
    ----------
    speed
        Change of speed, m/s or rad/s.
    room
        Allowed motion of the load, before a start and after a stop, while the path is along another
        axis, m or rad.
    current_limit_a
        Available current; infinite for no limit.
    machines
        The machines; the first one is the nominal machine of the plan.
    """

    speed: float
    room: float
    current_limit_a: float
    machines: Sequence[CornerResponse]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChangeOfSpeed:
    """Requirements on a start (a step of speed at time 0), or on a stop in reversed time.

    Parameters
    ----------
    stop
        Whether the change is a stop.
    early_s, still_s
        The nominal load may depart ``early_s`` before time 0. It must be at rest from ``still_s``
        before time 0 until its departure; before that it may swing back.
    within_s
        Time from the departure until every machine has the speed.
    even_s
        Time after time 0 from which the speed must be constant.
    aside_s
        Another axis moves until ``aside_s`` before time 0; until then the load must stay within
        ``room``.
    share
        Smallest and largest planned speed, as shares of the intended speed.
    mean_s
        Time over which the mean speed must be constant; 0 if the speed itself must be constant. If
        it is above 0, neither the time to reach the speed nor the rest before the start is
        constrained.
    swing
        Largest speed of the nominal load before its departure, as a share of the intended speed.
    """

    stop: bool
    early_s: float
    still_s: float
    within_s: float
    even_s: float
    aside_s: float = 0.0
    share: tuple[float, float] = (1.0, 1.0)
    mean_s: float = 0.0
    swing: float = np.inf


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustWeights:
    """Optimal weights of a moving average.

    Parameters
    ----------
    weights
        (count,) weights of samples ``step_s`` apart, in order of time, with the sum 1.
    error
        Largest speed error of any machine while the speed must be constant, as a share of the
        speed.
    cost
        Value of the objective: the error, plus small terms for current and weights.
    slack
        Slacks of the constraints, in the order of the program's unknowns.
    """

    weights: FloatArray
    error: float
    cost: float
    slack: FloatArray


@dataclass(slots=True)
class _Band:
    """Constraints ``low - slack <= R w <= high + slack``, where slack is a sum of unknowns."""

    R: FloatArray
    low: FloatArray
    high: FloatArray
    slacks: tuple[int, ...] = (_EXCESS,)


def robust_weights(
    axis: StepOfSpeed,
    changes: Sequence[ChangeOfSpeed],
    grid: WeightGrid,
    *,
    near: RobustWeights | None = None,
    dearest: float = np.inf,
    kept: Answers | None = None,
) -> RobustWeights | None:
    """Return the weights with the smallest error over all machines; None if infeasible.

    The problem is infeasible if the available current is too low for the change of speed in the
    given time.

    Parameters
    ----------
    changes
        The changes that use the weights: a start, a stop or both.
    grid
        Instants of the weights and of the responses.
    near
        Weights of a similar problem: the first program contains their binding instants, so that
        fewer programs are needed. The result is the same.
    dearest
        Cost from which on the result is None.
    kept
        Cache of responses from calls with the same ``grid``; this call adds to it.

    Raises
    ------
    PlanError
        If the solver fails, or too many programs are needed.
    """
    answers = {} if kept is None else kept
    _answer_steps(answers, axis.machines, grid)
    bands = [
        band
        for change in changes
        for index, machine in enumerate(axis.machines)
        for band in _bands(axis, machine, index == 0, grid.instants_s, change, answers[machine])
    ]
    return _least_error_weights(
        bands, np.asarray(grid.shift_s / grid.step_s), near, min(dearest, _MAX_COST)
    )


def _least_error_weights(
    bands: Sequence[_Band], shift: FloatArray, start: RobustWeights | None, dearest: float
) -> RobustWeights | None:
    """Return the weights with first moment 0 over ``shift`` and the smallest error over all bands.

    The result is None if the hard constraints cannot be met, or if the cost reaches ``dearest``.
    """
    # Unknowns: positive parts of the weights, negative parts, then the slacks, including the
    # magnitude of the largest weight.
    count = len(shift)
    size = _WEIGHT_COST * (1.0 + np.arange(count) / count)
    cost = np.concatenate(
        [size, size, [1.0, _CURRENT_COST, _LATE_COSTS, _LARGEST_WEIGHT_COST * count, _EXCESS_COSTS]]
    )
    width, weight_columns = len(cost), 2 * count
    moment_rows = np.zeros((2, width))
    moment_rows[:, :weight_columns] = _signed_columns(np.vstack([np.ones(count), shift]))
    largest_rows = np.zeros((count, width))
    largest_rows[:, :weight_columns] = np.hstack([np.eye(count), np.eye(count)])
    largest_rows[:, weight_columns + 3] = -1.0
    bounds = [(0.0, _MAX_WEIGHT)] * weight_columns
    bounds += [(0.0, np.inf), (0.0, 1.0), (0.0, _THERE_RESERVE), (0.0, np.inf), (0.0, np.inf)]
    chosen_instants = [np.arange(0, len(band.R), _FIRST_ROWS) for band in bands]
    if start is not None:
        chosen_instants = [
            np.union1d(
                instants,
                np.flatnonzero(
                    _peaks(_violation(band, start.weights, start.slack), -_DROPPED_RESERVE)
                ),
            )
            for instants, band in zip(chosen_instants, bands, strict=True)
        ]
    lower_bound = -np.inf
    for _ in range(_MOST_ROUNDS):
        rows, limits = [largest_rows], [np.zeros(count)]
        for band, instants in zip(bands, chosen_instants, strict=True):
            for sign, bound in ((1.0, band.high[instants]), (-1.0, -band.low[instants])):
                is_finite = np.isfinite(bound)
                program_rows = np.zeros((int(is_finite.sum()), width))
                program_rows[:, :weight_columns] = _signed_columns(
                    sign * band.R[instants][is_finite]
                )
                for slack in band.slacks:
                    program_rows[:, weight_columns + slack] = -1.0
                rows.append(program_rows)
                limits.append(bound[is_finite])
        unknowns = _solved(cost, np.vstack(rows), np.concatenate(limits), moment_rows, bounds)
        weights, slacks = (
            unknowns[:count] - unknowns[count:weight_columns],
            unknowns[weight_columns:],
        )
        total_cost = float(cost @ unknowns)
        if total_cost >= dearest:
            return None  # more instants can only increase the cost
        violations = [_violation(band, weights, slacks) for band in bands]
        peaks = [np.flatnonzero(_peaks(violation)) for violation in violations]
        if not any(len(peak_instants) for peak_instants in peaks):
            if slacks[_EXCESS] > _MARGIN:
                return None
            return RobustWeights(
                weights=weights, error=float(slacks[_ERROR]), cost=total_cost, slack=slacks
            )
        # Instants are dropped only while the cost rises, so that no program is repeated.
        cost_rises = total_cost > lower_bound + _LEAST_COST_RISE
        lower_bound = max(total_cost, lower_bound)
        chosen_instants = [
            np.union1d(
                instants[violation[instants] > -_DROPPED_RESERVE] if cost_rises else instants,
                peak_instants,
            )
            for instants, violation, peak_instants in zip(
                chosen_instants, violations, peaks, strict=True
            )
        ]
    raise PlanError(
        f"averages for machines within their tolerances: no convergence in {_MOST_ROUNDS} linear "
        "programs",
        remedy="Give another --smoothing.",
    )


def _solved(
    cost: FloatArray,
    rows: FloatArray,
    limits: FloatArray,
    moment_rows: FloatArray,
    bounds: Sequence[tuple[float, float]],
) -> FloatArray:
    """Return the optimal unknowns, after checking all rows.

    The program is feasible; if one algorithm fails, another is tried.
    """
    from scipy.optimize import linprog

    for method in ("highs-ds", "highs-ipm"):
        options = QUICK if method == "highs-ds" else None
        result = linprog(
            cost, rows, limits, moment_rows, [1.0, 0.0], bounds, method=method, options=options
        )
        if result.x is not None and result.status == 0:
            unknowns: FloatArray = np.asarray(result.x)
            violation = max(
                float((rows @ unknowns - limits).max()), abs(float(moment_rows[0] @ unknowns) - 1.0)
            )
            if max(violation, abs(float(moment_rows[1] @ unknowns))) <= _MAX_ROW_VIOLATION:
                return unknowns
    raise PlanError(
        "averages for machines within their tolerances: the solver failed on a feasible "
        f"linear program ({result.message})",
        remedy="Give another --smoothing.",
    )


def _signed_columns(of_weights: FloatArray) -> FloatArray:
    """Return the columns of the positive and of the negative parts of the weights."""
    return np.hstack([of_weights, -of_weights])


def _violation(band: _Band, weights: FloatArray, slack: FloatArray) -> FloatArray:
    """Return the violation of a band at each instant, negative inside the band."""
    result = band.R @ weights
    allowed = float(slack[list(band.slacks)].sum())
    return np.maximum(result - band.high, band.low - result) - allowed


def _peaks(violation: FloatArray, limit: float = _MAX_VIOLATION) -> NDArray[np.bool_]:
    """Return a mask of the local maxima of a band's violation that exceed ``limit``."""
    before, after = np.append(-np.inf, violation[:-1]), np.append(violation[1:], -np.inf)
    return np.asarray((violation > limit) & (violation >= before) & (violation >= after))


def _bands(
    axis: StepOfSpeed,
    machine: CornerResponse,
    planned: bool,
    instants_s: FloatArray,
    change: ChangeOfSpeed,
    answer: tuple[FloatArray, FloatArray | None],
) -> list[_Band]:
    """Return the constraints of one machine, from its response to steps of speed."""
    S, current = answer
    if change.stop:
        # In reversed time a stop is a start. The weights have the sum 1.
        last = len(instants_s) - 1  # the mirror image of instant 0 would lie one instant outside
        S = 1.0 - S[np.concatenate([[last], np.arange(last, 0, -1)])]
    low_share, high_share = change.share
    # A speed is measured as a mean over ``MEAN_S``, so it must last for this time.
    due_s = change.within_s - change.early_s
    reached_index = np.flatnonzero((instants_s >= due_s - MEAN_S) & (instants_s <= due_s))
    even_index = np.flatnonzero(
        (instants_s >= change.even_s) & (instants_s <= _LOAD_CHECK_TIMES * change.within_s)
    )
    even_high = np.ones(len(even_index))
    even_response = S[even_index]
    if change.mean_s:
        # Means begin one sample after each instant; means beyond the samples are ignored.
        mean_samples = max(round(change.mean_s / (instants_s[1] - instants_s[0])), 1)
        mean_end = np.minimum(even_index + mean_samples, len(instants_s) - 1)
        summed = np.cumsum(S, axis=0)
        even_response = (summed[mean_end] - summed[even_index]) / (mean_end - even_index)[:, None]
    bands: list[_Band] = []
    if not change.mean_s:
        bands.append(
            _Band(
                S[reached_index] * low_share,
                *_at_least(THERE + _THERE_RESERVE, len(reached_index)),
                (_LATE, _EXCESS),
            )
        )
    bands += [
        _Band(even_response * low_share, *_at_least(1.0, len(even_index)), (_ERROR,)),
        _Band(even_response * high_share, -np.inf * even_high, even_high, (_ERROR,)),
    ]
    if planned and not change.mean_s:
        rest_index = np.flatnonzero(
            (instants_s >= -change.still_s) & (instants_s <= -change.early_s)
        )
        bands.append(_Band(S[rest_index], *_within(STILL, len(rest_index))))
    if planned and np.isfinite(change.swing):
        before_start = np.flatnonzero(instants_s <= -change.early_s)
        bands.append(_Band(S[before_start], *_within(change.swing, len(before_start))))
    # While another axis moves at constant speed, motion across its path adds to the load's speed.
    across_response = S[instants_s <= -(change.aside_s + change.within_s)]
    bands.append(_Band(across_response, *_within(ACROSS, len(across_response))))
    moved_share = np.cumsum(S[instants_s <= -change.aside_s], axis=0) * (
        (instants_s[1] - instants_s[0]) * axis.speed / axis.room
    )
    bands.append(_Band(moved_share, *_within(1.0, len(moved_share))))
    limited = np.isfinite(axis.current_limit_a) and axis.speed > 0.0
    if machine.current_s_a_m is not None and current is not None and limited:
        # Shares of the limit, so that all rows have similar magnitudes.
        near_change = np.abs(instants_s) <= _CURRENT_CHECK_TIMES * change.within_s
        share = current[near_change] * (axis.speed / axis.current_limit_a)
        # A stop removes the current of the motion, which already uses part of the limit.
        cruise = float(machine.current_s_a_m[0].real) * axis.speed if change.stop else 0.0
        level = np.full(int(near_change.sum()), cruise / axis.current_limit_a)
        bands.append(_Band(share, level, level, (_SHARE, _EXCESS)))
    return bands


def _at_least(bound: float, count: int) -> tuple[FloatArray, FloatArray]:
    return np.full(count, bound), np.full(count, np.inf)


def _within(bound: float, count: int) -> tuple[FloatArray, FloatArray]:
    return np.full(count, -bound), np.full(count, bound)
