r"""Weights of an average over time after which many machines have the speed that was meant.

Feed-forward plans for the machine as its file says. One with other masses or stiffnesses leaves the
load ringing after each change of speed, by as much as the intended motion excites its mode. The
average over time that smooths a motion for the inverse has many weights, and only their sum and
first moment are needed to keep straight lines and times. The rest is free, and linear: the answer
of every machine to a change of speed is a weighted sum of its answers to one shifted spline.

.. math:: \min_w \epsilon, \quad |S_k(t) - [t > 0]| \le \epsilon \text{ for } |t| \ge T / 2,
          \quad S_k(t) = \sum_i w_i B_k(t - i h)

over all machines k, where ``B_k`` is the answer to a run-up that the spline alone has smoothed and
T is the time in which the load may change its speed. Within it the speed is there at ``T / 4`` and
not yet at ``-T / 4`` (:data:`STILL`, :data:`THERE`), and the current stays within that of the
amplifiers. The linear program is solved on the instants that bind: those that its result violates
are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
from threadline.control.corner_machines import CornerResponse
from threadline.errors import PlanError

STILL, THERE = 0.0095, 0.955
"""Largest share of a step that is there half of its time before its middle, and least share of it
that every machine has half of its time after: 1 % and 95 % are asked of seams."""
_FIRST_ROWS = 512  # every so many instants are in the first program
_MOST_ROUNDS = 40
_CLOSE = 2e-4  # of the step: no instant is violated by more
_MEAN_S = 0.0021  # over which a speed is taken, and a little more
_SEEN = 8.0  # times the change: so long after it a load is looked at
_SPIKES = 1e-4  # worth of the largest weight against the largest error


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepOfSpeed:
    """The largest change of speed of one axis, and the machines that are to follow it.

    Parameters
    ----------
    speed
        m/s or rad/s.
    room
        How far a load may go before a start, and after a stop, m or rad: by so much one axis may
        move while the path is along another.
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
class RunUp:
    """A change of speed from rest as it is programmed: at ``at_s`` comes ``share`` of it.

    A stop is the same backwards.

    Parameters
    ----------
    at_s
        (n,) times from the start.
    share
        (n,) with the sum 1.
    change_s
        Time in which the load may do it: half of it after the start, and half of it before a stop.
    """

    at_s: FloatArray
    share: FloatArray
    change_s: float

    @property
    def middle_s(self) -> float:
        """Mean time of the change."""
        return float(self.at_s @ self.share)

    def spectrum(self, omega_rad_s: FloatArray, sign: float) -> NDArray[np.complex128]:
        """Return the (k,) spectrum of its acceleration; ``sign`` -1 is that of a stop."""
        turn = np.exp(-1j * sign * omega_rad_s[:, None] * self.at_s)
        return np.asarray(turn @ self.share)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustWeights:
    """The weights that were found.

    Parameters
    ----------
    weights
        (count,) of samples ``step_s`` apart, the one that acts first first, with the sum 1.
    error
        Largest error of the speed of any machine outside the time that a step may take, in parts
        of the step.
    """

    weights: FloatArray
    error: float


@dataclass(slots=True)
class _Band:
    """Rows ``low - eps <= R w <= high + eps``; eps only where they are soft."""

    R: FloatArray
    low: FloatArray
    high: FloatArray
    soft: bool


def frequencies_rad_s(period_s: float, count: int) -> FloatArray:
    """Return the frequencies of ``count`` samples; 0 is replaced by next to nothing."""
    omega = 2.0 * np.pi * np.fft.rfftfreq(count, period_s)
    omega[0] = 1e-3 * omega[1]
    return np.asarray(omega)


def robust_weights(
    axis: StepOfSpeed,
    run_up: RunUp,
    *,
    count: int,
    step_s: float,
    degree: int,
    grid_s: float,
    samples: int,
) -> RobustWeights | None:
    """Return the weights of which all machines leave the least error; None where there are none.

    There are none where the current is too little for the change of speed in its time.

    Parameters
    ----------
    count, step_s
        Number of weights, and the time between samples.
    degree
        Of the uniform B-spline whose control points the averages are.
    grid_s, samples
        Instants at which the answers are looked at; ``machines`` are given at
        ``frequencies_rad_s(grid_s, samples)``.
    """
    omega = frequencies_rad_s(grid_s, samples)
    spline = np.sinc(omega * step_s / (2.0 * np.pi)) ** (degree + 1)
    shift_s: FloatArray = np.asarray((np.arange(count) - 0.5 * (count - 1)) * step_s)
    early = samples // 2
    t: FloatArray = np.asarray((np.arange(samples) - early) * grid_s)
    turn = np.exp(-1j * omega[:, None] * (shift_s + early * grid_s))
    bands: list[_Band] = []
    for sign in (1.0, -1.0):
        shape = (spline * run_up.spectrum(omega, sign))[:, None] * turn
        for index, one in enumerate(axis.machines):
            bands += _bands(axis, one, index == 0, t, run_up, sign, shape)
    return _least(bands, np.asarray(shift_s / step_s))


def _least(bands: Sequence[_Band], shift: FloatArray) -> RobustWeights | None:
    """Return the weights, of the moment 0 about ``shift``, with the least error over all bands."""
    from scipy.optimize import linprog

    # Unknowns: the weights, the error, and the size of the largest weight.
    count = len(shift)
    cost = np.append(np.zeros(count), [1.0, _SPIKES * count])
    sums = np.zeros((2, count + 2))
    sums[0, :count], sums[1, :count] = 1.0, shift
    spikes = np.zeros((2 * count, count + 2))
    spikes[:, :count] = np.vstack([np.eye(count), -np.eye(count)])
    spikes[:, -1] = -1.0
    chosen = [np.arange(0, len(band.R), _FIRST_ROWS) for band in bands]
    for _ in range(_MOST_ROUNDS):
        rows, limits = [spikes], [np.zeros(2 * count)]
        for band, at in zip(bands, chosen, strict=True):
            for sign, bound in ((1.0, band.high[at]), (-1.0, -band.low[at])):
                kept = np.isfinite(bound)
                part = np.zeros((int(kept.sum()), count + 2))
                part[:, :count] = sign * band.R[at][kept]
                part[:, -2] = -1.0 if band.soft else 0.0
                rows.append(part)
                limits.append(bound[kept])
        found = linprog(
            cost,
            A_ub=np.vstack(rows),
            b_ub=np.concatenate(limits),
            A_eq=sums,
            b_eq=[1.0, 0.0],
            bounds=[(None, None)] * count + [(0.0, None)] * 2,
            method="highs-ds",
        )
        if found.x is None:
            return None
        weights, error = np.asarray(found.x[:count]), float(found.x[-2])
        done = True
        for number, band in enumerate(bands):
            peaks = _violated(band, weights, error)
            if len(peaks):
                chosen[number] = np.union1d(chosen[number], peaks)
                done = False
        if done:
            return RobustWeights(weights=weights, error=error)
    raise PlanError(
        f"averages for machines within their tolerances: {_MOST_ROUNDS} linear programs do not "
        "settle",
        remedy="Give another --smoothing.",
    )


def _violated(band: _Band, weights: FloatArray, error: float) -> NDArray[np.intp]:
    """Return the rows at which a band is left by most, in their neighbourhood."""
    value = band.R @ weights
    over = np.maximum(value - band.high, band.low - value) - (error if band.soft else 0.0)
    before, after = np.append(-np.inf, over[:-1]), np.append(over[1:], -np.inf)
    return np.flatnonzero((over > _CLOSE) & (over >= before) & (over >= after))


def _bands(
    axis: StepOfSpeed,
    one: CornerResponse,
    planned: bool,
    t: FloatArray,
    run_up: RunUp,
    sign: float,
    shape: NDArray[np.complex128],
) -> list[_Band]:
    """Return what is asked of one machine at a start (``sign`` 1) or a stop (-1)."""

    def steps(answer: NDArray[np.complex128]) -> FloatArray:
        return np.asarray(np.cumsum(np.fft.irfft(answer[:, None] * shape, len(t), axis=0), axis=0))

    half, quarter, middle = 0.5 * run_up.change_s, 0.25 * run_up.change_s, sign * run_up.middle_s
    S = steps(one.load)
    # A speed is seen as a mean: it has to last as long.
    there = np.flatnonzero((t >= middle + quarter - _MEAN_S) & (t <= middle + quarter))
    still = np.flatnonzero((t >= middle - quarter) & (t <= middle - quarter + _MEAN_S))
    if sign > 0.0:
        out, level = np.flatnonzero(t >= half), 1.0
        bands = [_Band(S[there], *_at_least(THERE, len(there)), False)]
    else:
        out, level = np.flatnonzero(t <= -half), 0.0
        bands = [_Band(S[still], *_at_most(1.0 - THERE, len(still)), False)]
    out = out[np.abs(t[out]) <= _SEEN * run_up.change_s]
    exact = np.full(len(out), level)
    bands.append(_Band(S[out], exact, exact, True))
    if planned and sign > 0.0:
        bands.append(_Band(S[still[:1]], *_at_most(STILL, 1), False))
    elif planned:
        bands.append(_Band(S[there[-1:]], *_at_least(1.0 - STILL, 1), False))
    bands.append(_Band(*_strayed(S, t, sign, axis.speed / axis.room), False))
    if one.current_s_a_m is not None and np.isfinite(axis.current_limit_a) and axis.speed > 0.0:
        # In parts of the limit, so that all rows are of one size.
        share = steps(one.current_s_a_m) * (axis.speed / axis.current_limit_a)
        near = np.flatnonzero(np.abs(t) <= 2.0 * run_up.change_s)
        # A stop takes away what the motion needed, which is at the limit's side already.
        cruise = 0.0 if sign > 0.0 else float(one.current_s_a_m[0].real) * axis.speed
        level_a, most = cruise / axis.current_limit_a, np.ones(len(near))
        bands.append(_Band(share[near], level_a - most, level_a + most, False))
    return bands


def _at_least(bound: float, count: int) -> tuple[FloatArray, FloatArray]:
    return np.full(count, bound), np.full(count, np.inf)


def _at_most(bound: float, count: int) -> tuple[FloatArray, FloatArray]:
    return np.full(count, -np.inf), np.full(count, bound)


def _strayed(
    S: FloatArray, t: FloatArray, sign: float, per_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the way before a start, or that is left after a stop, in parts of its room."""
    step_s = float(t[1] - t[0])
    if sign > 0.0:
        rows = np.cumsum(S, axis=0)[t <= 0.0] * (step_s * per_s)
        end = np.zeros(len(rows))
    else:
        # The weights have the sum 1: what is left is the integral of 1 - S, from the end on.
        rows = -np.cumsum(S[::-1], axis=0)[::-1][t >= 0.0] * (step_s * per_s)
        end = -np.cumsum(np.ones(len(rows)))[::-1] * (step_s * per_s)
    return rows, end - 1.0, end + 1.0
