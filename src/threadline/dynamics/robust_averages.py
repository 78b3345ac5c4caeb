r"""Answers of machines to steps of speed that a spline smooths, shifted by each of many weights.

Feed-forward plans for the machine as its file says. One with other masses or stiffnesses leaves the
load ringing after each change of speed, by as much as the intended motion excites its mode. The
average over time that smooths a motion for the inverse has many weights, and only their sum and
first moment are needed to keep straight lines and times. The rest is free, and linear: the answer
of every machine to a change of speed is a weighted sum of its answers to one shifted spline.

.. math:: \min_w \epsilon, \quad |S_k(t) - 1| \le \epsilon \text{ from the time on at which the
          speed has to be even}, \quad S_k(t) = \sum_i w_i B_k(t - i h)

over all machines k, where ``B_k`` is the answer to a step of speed at 0 that the spline alone has
smoothed. A stop is a start backwards in time. The speed is there soon enough after the load
departed (:data:`STILL`, :data:`THERE`), the load does not stray while another axis moves, and the
current stays within that of the amplifiers. The linear program is solved on the instants that bind:
those that its result violates are added.

Every program has a solution: what is not an error has to be kept, and one excess by which all of it
may be left is so dear that it is 0 where that is possible. There are no weights where it is more
than a stated margin. A program that may have no solution is one that HiGHS often ends without an
answer, here where neighbouring rows are alike; and it does so, too, with some that have one.
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
"""(samples, count) answers of each machine to steps of speed, one for each weight: of its load over
the speed, and of its current in A s/m or A s/rad, None without a coil."""


def frequencies_rad_s(period_s: float, count: int) -> FloatArray:
    """Return the frequencies of ``count`` samples; 0 is replaced by next to nothing."""
    omega = 2.0 * np.pi * np.fft.rfftfreq(count, period_s)
    omega[0] = 1e-3 * omega[1]
    return np.asarray(omega)


def answer_steps(
    answers: Answers,
    machines: Sequence[CornerResponse],
    shift_s: FloatArray,
    *,
    step_s: float,
    degree: int,
    grid_s: float,
    samples: int,
) -> None:
    """Put the answers of those of ``machines`` that have none yet into ``answers``.

    Parameters
    ----------
    shift_s
        (count,) by which each weight shifts the step.
    step_s, degree
        Of the uniform B-spline, its knots so far apart.
    grid_s, samples
        Instants about the step; ``machines`` are given at ``frequencies_rad_s(grid_s, samples)``.
    """
    new = [one for one in machines if one not in answers]
    if not new:
        return
    omega = frequencies_rad_s(grid_s, samples)
    spline = np.sinc(omega * step_s / (2.0 * np.pi)) ** (degree + 1)
    shape = spline[:, None] * np.exp(-1j * omega[:, None] * (shift_s + samples // 2 * grid_s))

    def steps(answer: NDArray[np.complex128]) -> FloatArray:
        return np.asarray(np.cumsum(np.fft.irfft(answer[:, None] * shape, samples, axis=0), axis=0))

    for one in new:
        current = None if one.current_s_a_m is None else steps(one.current_s_a_m)
        answers[one] = steps(one.load), current


STILL, THERE, ACROSS = 0.0065, 0.953, 0.1
"""Largest share of its speed with which the planned load stands, least share of the wanted speed
that every machine has where it has its speed, and largest share with which a load moves while
another axis has its speed: 1 % and 95 % are asked of seams, and a tenth across adds 0.5 %."""
_SPARE = 0.012  # of the wanted speed: so much more is there where it costs little
_FIRST_ROWS = 2048  # every so many instants are in the first program; the next ones find theirs
_MOST_ROUNDS = 100
_CLOSE = 1e-6  # of the step: no instant is violated by more
_RISES = 1e-9  # of the cost
_NEAR = 0.01  # of the step: instants that are further within are left out of the next program
MEAN_S = 0.0021
"""Time over which a speed is taken, and a little more."""
_SEEN = 16.0  # times the time for a change: so long after it a load is looked at
_LOOKED = 4.0  # times it: so long before and after it a current is
_ERROR, _SHARE, _LATE, _EXCESS = 0, 1, 2, 4
"""Slacks: of the even speed, of the current, of what is there; 3 is the size of the largest weight;
of all that has to be kept."""
_LATE_COSTS = 0.1  # worth of what is not there against the largest error
_DRIVEN = 0.05  # worth of the share of the current against the largest error
_SPIKES = 1e-4  # worth of the largest weight against the largest error
_SIZE = 1e-5
"""Worth of the size of a weight, twice that of the last, against the largest error: where many
weights leave the same error and spikes alike these are definite ones, whatever the last digits."""
_EXCESS_COSTS = 1000.0
"""Worth of what is left of bands that have to be kept: with an excess of the margin at this price
the least error without it is a tenth of the speed larger, which serves nobody."""
_MARGIN = 1e-4  # of speed, room or current: bands that are left by no more are kept
_LARGEST = 10.0  # weight; those that are found are below 0.3
_DEAREST = 1.0 + _DRIVEN + _LATE_COSTS * _SPARE + _EXCESS_COSTS * _MARGIN
"""Cost above which a program is given up: the error is all of the speed, or the margin is left. The
weights have next to no part in it."""
_KEPT = 0.5 * _CLOSE  # a solution that leaves a row of its own program by more is none


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepOfSpeed:
    """The largest change of speed of one axis, and the machines that are to follow it.

    Parameters
    ----------
    speed
        m/s or rad/s.
    room
        How far a load may go while the path is along another axis, before a start and after a
        stop, m or rad.
    current_limit_a
        That may be used; infinite where there is no limit.
    machines
        The first is the one for which is planned.
    """

    speed: float
    room: float
    current_limit_a: float
    machines: Sequence[CornerResponse]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChangeOfSpeed:
    """What is asked of a start, a step of speed at the time 0; of a stop the same backwards.

    Parameters
    ----------
    stop
        Whether it is a stop.
    early_s, still_s
        How long before 0 the planned load may depart, and from when on it stands until then; before
        that it may swing back.
    within_s
        Time from its departure in which every machine has the speed.
    even_s
        From then on the speed is even.
    aside_s
        Until so long before 0 another axis moves, and the load must not stray.
    share
        Least and largest of the speeds that are planned, in parts of the wanted one.
    mean_s
        Time over which the mean of the speed is to be even, 0 where the speed itself is. With it
        nothing is asked of when the speed is there, nor that the load stands before.
    """

    stop: bool
    early_s: float
    still_s: float
    within_s: float
    even_s: float
    aside_s: float = 0.0
    share: tuple[float, float] = (1.0, 1.0)
    mean_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustWeights:
    """The weights that were found.

    Parameters
    ----------
    weights
        (count,) of samples ``step_s`` apart, the one that acts first first, with the sum 1.
    error
        Largest error of the speed of any machine where it has to be even, in parts of the wanted
        speed.
    cost
        What was made least: the error, and a little of what drives and weights are asked for.
    slack
        By which bands were left, in the order of the program's unknowns.
    """

    weights: FloatArray
    error: float
    cost: float
    slack: FloatArray


@dataclass(slots=True)
class _Band:
    """Rows ``low - slack <= R w <= high + slack``, the slack being the sum of those unknowns."""

    R: FloatArray
    low: FloatArray
    high: FloatArray
    slacks: tuple[int, ...] = (_EXCESS,)


def robust_weights(
    axis: StepOfSpeed,
    changes: Sequence[ChangeOfSpeed],
    *,
    count: int,
    step_s: float,
    degree: int,
    grid_s: float,
    samples: int,
    near: RobustWeights | None = None,
    dearest: float = np.inf,
    kept: Answers | None = None,
) -> RobustWeights | None:
    """Return the weights of which all machines leave the least error; None where there are none.

    There are none where the current is too little for the change of speed in its time.

    Parameters
    ----------
    changes
        That the weights are to serve: a start, a stop or both.
    count, step_s
        Number of weights, and the time between samples.
    degree
        Of the uniform B-spline whose control points the averages are.
    grid_s, samples
        Instants at which the answers are looked at; ``machines`` are given at
        ``frequencies_rad_s(grid_s, samples)``.
    near
        Weights of a problem that is much like this one: the first program has the instants that
        bind them, and fewer programs are solved. The result is the same.
    dearest
        Cost from which on weights are of no use, so that none are returned.
    kept
        Answers of machines from calls with the same ``count``, ``step_s``, ``degree``, ``grid_s``
        and ``samples``; this call's are put there.

    Raises
    ------
    PlanError
        If a program has no answer, or too many are needed.
    """
    shift_s: FloatArray = np.asarray((np.arange(count) - 0.5 * (count - 1)) * step_s)
    middle = samples // 2
    t: FloatArray = np.asarray((np.arange(samples) - middle) * grid_s)
    answers = {} if kept is None else kept
    answer_steps(
        answers, axis.machines, shift_s,
        step_s=step_s, degree=degree, grid_s=grid_s, samples=samples,
    )  # fmt: skip
    bands = [
        band
        for change in changes
        for index, one in enumerate(axis.machines)
        for band in _bands(axis, one, index == 0, t, change, answers[one])
    ]
    return _least(bands, np.asarray(shift_s / step_s), near, min(dearest, _DEAREST))


def _least(
    bands: Sequence[_Band], shift: FloatArray, near: RobustWeights | None, dearest: float
) -> RobustWeights | None:
    """Return the weights, of the moment 0 about ``shift``, with the least error over all bands.

    None where bands that have to be kept cannot be, or at a cost of ``dearest`` and more.
    """
    # Unknowns: what weights are above 0, what they are below it, then the slacks, and among them
    # the size of the largest weight.
    count = len(shift)
    size = _SIZE * (1.0 + np.arange(count) / count)
    cost = np.concatenate([size, size, [1.0, _DRIVEN, _LATE_COSTS, _SPIKES * count, _EXCESS_COSTS]])
    width, first = len(cost), 2 * count
    sums = np.zeros((2, width))
    sums[:, :first] = _both(np.vstack([np.ones(count), shift]))
    spikes = np.zeros((count, width))
    spikes[:, :first] = np.hstack([np.eye(count), np.eye(count)])
    spikes[:, first + 3] = -1.0
    bounds = [(0.0, _LARGEST)] * first
    bounds += [(0.0, np.inf), (0.0, 1.0), (0.0, _SPARE), (0.0, np.inf), (0.0, np.inf)]
    chosen = [np.arange(0, len(band.R), _FIRST_ROWS) for band in bands]
    if near is not None:
        chosen = [
            np.union1d(at, np.flatnonzero(_peaks(_over(band, near.weights, near.slack), -_NEAR)))
            for at, band in zip(chosen, bands, strict=True)
        ]
    least = -np.inf
    for _ in range(_MOST_ROUNDS):
        rows, limits = [spikes], [np.zeros(count)]
        for band, at in zip(bands, chosen, strict=True):
            for sign, bound in ((1.0, band.high[at]), (-1.0, -band.low[at])):
                kept = np.isfinite(bound)
                part = np.zeros((int(kept.sum()), width))
                part[:, :first] = _both(sign * band.R[at][kept])
                for slack in band.slacks:
                    part[:, first + slack] = -1.0
                rows.append(part)
                limits.append(bound[kept])
        found = _solved(cost, np.vstack(rows), np.concatenate(limits), sums, bounds)
        weights, slacks = found[:count] - found[count:first], found[first:]
        reached = float(cost @ found)
        if reached >= dearest:
            return None  # more instants make it dearer still
        over = [_over(band, weights, slacks) for band in bands]
        peaks = [np.flatnonzero(_peaks(one)) for one in over]
        if not any(len(new) for new in peaks):
            if slacks[_EXCESS] > _MARGIN:
                return None
            return RobustWeights(
                weights=weights, error=float(slacks[_ERROR]), cost=reached, slack=slacks
            )
        # What is left out may come back: the least cost rises from program to program, so that
        # none is met twice.
        rises = reached > least + _RISES
        least = max(reached, least)
        chosen = [
            np.union1d(at[one[at] > -_NEAR] if rises else at, new)
            for at, one, new in zip(chosen, over, peaks, strict=True)
        ]
    raise PlanError(
        f"averages for machines within their tolerances: {_MOST_ROUNDS} linear programs do not "
        "settle",
        remedy="Give another --smoothing.",
    )


def _solved(
    cost: FloatArray,
    rows: FloatArray,
    limits: FloatArray,
    sums: FloatArray,
    bounds: Sequence[tuple[float, float]],
) -> FloatArray:
    """Return the unknowns of the least cost, whose rows are checked here.

    The program has a solution; where one algorithm has none, another is asked.
    """
    from scipy.optimize import linprog

    for method in ("highs-ds", "highs-ipm"):
        how = QUICK if method == "highs-ds" else None
        found = linprog(cost, rows, limits, sums, [1.0, 0.0], bounds, method=method, options=how)
        if found.x is not None and found.status == 0:
            unknowns: FloatArray = np.asarray(found.x)
            off = max(float((rows @ unknowns - limits).max()), abs(float(sums[0] @ unknowns) - 1.0))
            if max(off, abs(float(sums[1] @ unknowns))) <= _KEPT:
                return unknowns
    raise PlanError(
        "averages for machines within their tolerances: a linear program that has a solution was "
        f"not solved ({found.message})",
        remedy="Give another --smoothing.",
    )


def _both(of_weights: FloatArray) -> FloatArray:
    """Return the columns of what weights are above 0, and of what they are below it."""
    return np.hstack([of_weights, -of_weights])


def _over(band: _Band, weights: FloatArray, slack: FloatArray) -> FloatArray:
    """Return by how much a band is left at each instant, negative within it."""
    value = band.R @ weights
    allowed = float(slack[list(band.slacks)].sum())
    return np.maximum(value - band.high, band.low - value) - allowed


def _peaks(over: FloatArray, above: float = _CLOSE) -> NDArray[np.bool_]:
    """Say at which instants a band is left by more than elsewhere in their neighbourhood."""
    before, after = np.append(-np.inf, over[:-1]), np.append(over[1:], -np.inf)
    return np.asarray((over > above) & (over >= before) & (over >= after))


def _bands(
    axis: StepOfSpeed,
    one: CornerResponse,
    planned: bool,
    t: FloatArray,
    change: ChangeOfSpeed,
    answer: tuple[FloatArray, FloatArray | None],
) -> list[_Band]:
    """Return what is asked of one machine, with its answer to steps of speed."""
    S, current = answer
    if change.stop:
        # Backwards in time a stop is a start. The weights have the sum 1.
        last = len(t) - 1  # its opposite would be one further
        S = 1.0 - S[np.concatenate([[last], np.arange(last, 0, -1)])]
    least, most = change.share
    # A speed is seen as a mean: it has to last as long.
    due = change.within_s - change.early_s
    there = np.flatnonzero((t >= due - MEAN_S) & (t <= due))
    even = np.flatnonzero((t >= change.even_s) & (t <= _SEEN * change.within_s))
    asked = np.ones(len(even))
    seen = S[even]
    if change.mean_s:
        # From a sample after each instant on; what lasts beyond the samples is not looked at.
        lasts = max(round(change.mean_s / (t[1] - t[0])), 1)
        until = np.minimum(even + lasts, len(t) - 1)
        run = np.cumsum(S, axis=0)
        seen = (run[until] - run[even]) / (until - even)[:, None]
    bands: list[_Band] = []
    if not change.mean_s:
        bands.append(
            _Band(S[there] * least, *_at_least(THERE + _SPARE, len(there)), (_LATE, _EXCESS))
        )
    bands += [
        _Band(seen * least, *_at_least(1.0, len(even)), (_ERROR,)),
        _Band(seen * most, -np.inf * asked, asked, (_ERROR,)),
    ]
    if planned and not change.mean_s:
        still = np.flatnonzero((t >= -change.still_s) & (t <= -change.early_s))
        bands.append(_Band(S[still], *_within(STILL, len(still))))
    # While another axis has its even speed, what this one adds across makes the load faster.
    across = S[t <= -(change.aside_s + change.within_s)]
    bands.append(_Band(across, *_within(ACROSS, len(across))))
    way = np.cumsum(S[t <= -change.aside_s], axis=0) * ((t[1] - t[0]) * axis.speed / axis.room)
    bands.append(_Band(way, *_within(1.0, len(way))))
    limited = np.isfinite(axis.current_limit_a) and axis.speed > 0.0
    if one.current_s_a_m is not None and current is not None and limited:
        # In parts of the limit, so that all rows are of one size.
        near = np.abs(t) <= _LOOKED * change.within_s
        share = current[near] * (axis.speed / axis.current_limit_a)
        # A stop takes away what the motion needed, which is at the limit's side already.
        cruise = float(one.current_s_a_m[0].real) * axis.speed if change.stop else 0.0
        level = np.full(int(near.sum()), cruise / axis.current_limit_a)
        bands.append(_Band(share, level, level, (_SHARE, _EXCESS)))
    return bands


def _at_least(bound: float, count: int) -> tuple[FloatArray, FloatArray]:
    return np.full(count, bound), np.full(count, np.inf)


def _within(bound: float, count: int) -> tuple[FloatArray, FloatArray]:
    return np.full(count, -bound), np.full(count, bound)
