"""Unit-magnitude shapers for several modes at once, the shortest there is.

A step that is shaped by such a train is a level that is 0 or 1 from instant to instant, and 1 in
the end. The shortest train for given constraints is therefore a time-optimal switching: with the
level free in [0, 1] on a grid, the least violation within a duration is a linear program, it falls
as the duration grows, and the level that the program leaves is 0 or 1 but for the cells in which
it switches. Bisection gives the seed, Newton's method the exact times. Unit-magnitude trains that
are convolved are longer, or leave [0, 1] where their pulses overlap.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import OptionError
from threadline.shaping.apart import check_apart
from threadline.shaping.direct import Requirement
from threadline.shaping.linear_program import minimise
from threadline.shaping.newton import newton
from threadline.shaping.oscillator import prove
from threadline.shaping.response import Rows, ZeroOf, pole, zero_rows
from threadline.shaping.types import Shaper, ShaperError

_GRIDS = (240, 330, 170, 480)
_SMALL = 1e-8


def direct_unit_magnitude(
    requirements: Sequence[Requirement], *, name: str = "um-direct"
) -> Shaper:
    """Shortest train of amplitudes +1 -1 ... +1 that silences every mode.

    Parameters
    ----------
    requirements
        With tolerance 0; ``derivatives`` makes a mode robust, as UM-ZVD is.
    name
        Of the shaper.

    Returns
    -------
    Shaper
        Levels 0 and 1 alone; constraints met to 1e-10 and proved by simulation.

    Raises
    ------
    OptionError
        If there is no requirement, one has a tolerance, or the modes are too far apart.
    ShaperError
        If a program fails, or the proof does.
    """
    if not requirements:
        raise OptionError("unit-magnitude shaper: at least one requirement is needed")
    for r in requirements:
        if r.tolerance > 0.0:
            raise OptionError(
                f"unit-magnitude shaper: the requirement at {r.mode.frequency_hz:g} Hz has a "
                "tolerance, only exact zeros are solved directly",
                remedy="Ask for derivatives instead, or take um-ei or um-2ei for one mode.",
            )
    check_apart([r.mode for r in requirements])
    unit = 1.0 / min(r.mode.frequency_hz for r in requirements)
    zeros: list[ZeroOf] = [
        (r.mode.frequency_hz * unit, pole(r.mode.damping_ratio), order)
        for r in dict.fromkeys(requirements)
        for order in range(r.derivatives + 1)
    ]
    failures = []
    for points in _GRIDS:
        try:
            times = _polish(_seed(zeros, points), zeros)
            break
        except ShaperError as error:
            failures.append(error)
    else:
        raise failures[0]
    amplitudes = np.where(np.arange(len(times)) % 2 == 0, 1.0, -1.0)
    shaper = Shaper(amplitudes=amplitudes, times_s=times * unit, name=name)
    for r in requirements:
        at = np.array([r.mode.frequency_hz])
        prove(shaper, at, r.mode.damping_ratio, np.zeros(1), at_most=True)
    return shaper


def _least(zeros: Sequence[ZeroOf], duration: float, points: int) -> tuple[float, FloatArray]:
    """Least violation within ``duration``, in periods, and the (points,) levels."""
    edges = np.linspace(0.0, duration, points + 1)
    rows, bounds = [], []
    for by_impulse in zero_rows(zeros, edges - duration):
        by_level = by_impulse[:-1] - by_impulse[1:]
        rest = by_impulse[-1]
        for turned, constant in ((by_level.real, rest.real), (by_level.imag, rest.imag)):
            rows += [turned, -turned]
            bounds += [-constant, constant]
    solved = minimise(
        np.append(np.zeros(points), 1.0),
        equal=(np.zeros((1, points + 1)), np.zeros(1)),
        below=(np.hstack((np.array(rows), -np.ones((len(rows), 1)))), np.array(bounds)),
        bounds=[(0.0, 1.0)] * points + [(0.0, None)],
        what="unit-magnitude shaper",
    )
    return float(solved.x[-1]), solved.x[:-1]


def _seed(zeros: Sequence[ZeroOf], points: int) -> FloatArray:
    """Switching times of the shortest feasible duration on a grid, from 0."""
    low, high = 0.0, 0.5 * len(zeros)
    for _ in range(6):
        if _least(zeros, high, points)[0] <= _SMALL:
            break
        low, high = high, 1.5 * high
    else:
        raise ShaperError(f"unit-magnitude shaper: no train within {high:.3g} periods")
    while high - low > 1e-4 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _least(zeros, middle, points)[0] <= _SMALL else (middle, high)
    _, levels = _least(zeros, high, points)
    times = switchings_of(levels, high / points)
    # As many times as equations: what is more are slivers of a cell, on and off again.
    while len(times) - 1 > 2 * len(zeros):
        narrow = int(np.argmin(np.diff(times)))
        times = np.delete(times, [narrow, narrow + 1])
    shifted: FloatArray = times - times[0]
    return shifted


def switchings_of(levels: FloatArray, cell: float) -> FloatArray:
    """Return when levels of cells of one length switch between 0 and 1, at first from 0.

    Parameters
    ----------
    levels
        (n,) in [0, 1], between 0 before them and 1 behind.
    cell
        Duration of each.
    """
    padded = np.concatenate(([0.0], levels, [1.0]))
    rounded = np.rint(padded)
    found = []
    for k in np.flatnonzero(np.diff(rounded)):
        # A cell that is partly on belongs to the level beside it.
        a, b = padded[k], padded[k + 1]
        late = (1.0 - b) - a if rounded[k + 1] > rounded[k] else b - (1.0 - a)
        found.append((k + late) * cell)
    times = np.array(found)
    shifted: FloatArray = times - times[0]
    return shifted


def _polish(seed: FloatArray, zeros: Sequence[ZeroOf]) -> FloatArray:
    """Solve the constraints exactly from a seed."""
    amplitudes = np.where(np.arange(len(seed)) % 2 == 0, 1.0, -1.0)

    def system(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        times = np.concatenate(([0.0], x))
        stacks = []
        for s in dict.fromkeys(zero[1] for zero in zeros):
            rows = Rows(amplitudes, times, s, free_amplitudes=False, unknown_frequencies=0)
            for f, other, order in zeros:
                if other == s:
                    rows.zero(f, order=order)
            stacks.append(rows.system())
        return np.concatenate([r for r, _ in stacks]), np.concatenate([j for _, j in stacks])

    solved = np.concatenate(([0.0], newton(system, seed[1:], "unit-magnitude shaper")))
    if len(solved) % 2 == 0 or bool(np.any(np.diff(solved) <= 0.0)):
        raise ShaperError(
            "unit-magnitude shaper: the design did not converge (its switchings changed order)",
            remedy="Change a mode a little.",
        )
    if float(np.abs(solved - seed).max()) > 0.05:
        raise ShaperError("unit-magnitude shaper: the design left the optimum that was found")
    return solved
