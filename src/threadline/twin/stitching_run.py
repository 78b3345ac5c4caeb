"""The linear system of a machine whose drives follow steps, and its simulation.

One matrix exponential advances the state from sample to sample. A step at the time tau before a
sample adds ``integral_0^tau exp(A s) ds B``. The power series of this integral in tau needs only
sums of powers of tau.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import ceil
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.dynamics.prescribed import prescribed
from threadline.errors import MachineError
from threadline.files import StepPlay, StepTable, StitchBlock
from threadline.files.step_play import concatenated_intervals
from threadline.machine import Machine
from threadline.machine.sources import PulseServo

_TERMS = 20
_NORM = 1.0  # most of rate times interval; the remainder of the series is then below 1e-18
_MOST_PARTS = 1024


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Driven:
    """A machine whose drives follow steps, as one linear system that advances by intervals.

    The m states are, for each connected piece, its own states, then positions and speeds of its
    servos. A is the number of axes.

    Parameters
    ----------
    step
        (m, m) transition matrix of the state over an interval.
    held
        (m, A) effect over an interval of one step before the interval.
    series
        (terms, m, A) effect at the end of an interval of one step within it: coefficients of the
        powers of the fraction of the interval that follows the step.
    loads
        (A, m) position of each axis, m or rad, from the state.
    forces
        (A, m) force of each drive, N or N m, from the state.
    commanded
        (A,) force of each drive per commanded m or rad.
    limit
        (A,) force limit of each drive, N or N m.
    scale
        (A,) m or rad of each drive per step.
    parts
        Number of intervals from sample to sample.
    """

    step: FloatArray
    held: FloatArray
    series: FloatArray
    loads: FloatArray
    forces: FloatArray
    commanded: FloatArray
    limit: FloatArray
    scale: FloatArray
    parts: int


def driven_of(machine: Machine) -> Driven:
    """Return the linear system of ``machine`` for the simulation of step tables.

    Raises
    ------
    MachineError
        If an axis is not moved by a pulse servo, or a part is not linear.
    """
    for name, axis in machine.axes.items():
        if not isinstance(machine.position_sources.get(axis.drive), PulseServo):
            raise MachineError(
                f"axes.{name} is not moved by a pulse-servo, which step tables are played on",
                place=machine.place,
                remedy='Give it a drive of kind = "pulse-servo".',
            )
    names = machine.axis_names
    pieces = prescribed(machine)
    size = sum(len(piece.states) + 2 * len(piece.drives) for piece in pieces)
    rates, entry = np.zeros((size, size)), np.zeros((size, len(names)))
    loads, forces = np.zeros((len(names), size)), np.zeros((len(names), size))
    commanded, limit, scale = (np.zeros(len(names)) for _ in range(3))
    first = 0
    for piece in pieces:
        n = len(piece.states)
        columns = np.arange(first, first + n + 2 * len(piece.drives))
        rates[first : first + n, columns] = piece.rates
        for k, drive in enumerate(piece.drives):
            source = machine.position_sources[drive]
            assert isinstance(source, PulseServo)
            at = next(names.index(a) for a in piece.axes if machine.axes[a].drive == drive)
            w = 2.0 * np.pi * source.bandwidth.si
            place, speed = columns[n + k], columns[n + len(piece.drives) + k]
            rates[place, speed] = 1.0
            rates[speed, place], rates[speed, speed] = -w * w, -2.0 * w
            entry[speed, at] = w * w
            # The drive moves its own mass and the network.
            forces[at, columns] = -piece.pulls[k]
            forces[at] += piece.inertia[k] * rates[speed]
            commanded[at] = piece.inertia[k] * w * w
            limit[at] = source.torque_limit.si
            scale[at] = 1.0 / source.counts
        for index, name in enumerate(piece.axes):
            loads[names.index(name), columns] = piece.loads[index]
        first = int(columns[-1]) + 1
    sample_s = float(machine.tick_clock.period_s)
    parts = _parts(rates, sample_s, machine)
    step, series = _powers(rates, entry, sample_s / parts)
    return Driven(
        step=step,
        held=series.sum(axis=0),
        series=series,
        loads=loads,
        forces=forces,
        commanded=commanded,
        limit=limit,
        scale=scale,
        parts=parts,
    )


def _parts(rates: FloatArray, sample_s: float, machine: Machine) -> int:
    """Return the number of intervals per sample for which the series is exact."""
    fastest = float(np.abs(np.linalg.eigvals(rates)).max())
    parts = ceil(fastest * sample_s / _NORM)
    if parts > _MOST_PARTS:
        raise MachineError(
            f"{machine.name} vibrates at {fastest / (2.0 * np.pi):.4g} Hz, too fast for samples of "
            f"{sample_s * 1e3:g} ms",
            place=machine.place,
            remedy="Give its drives a shorter clock, or leave out the part that vibrates so fast.",
        )
    return max(1, parts)


def _powers(
    rates: FloatArray, entry: FloatArray, interval_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the transition matrix over an interval, and ``A^k B T^(k+1) / (k+1)!`` for all k."""
    terms, power = [], entry * interval_s
    for k in range(1, _TERMS + 1):
        terms.append(power)
        power = rates @ power * (interval_s / (k + 1))
    return np.asarray(expm(rates * interval_s)), np.stack(terms)


class _Interval(NamedTuple):
    """The linear system of ``Driven`` over an interval, transposed: sums run along the memory.

    Parameters
    ----------
    step
        (m, m) transition matrix.
    held
        (A, m) effect of one step before the interval.
    series
        (terms, A, m) effect of one step within the interval.
    parts
        Number of intervals from sample to sample.
    """

    step: FloatArray
    held: FloatArray
    series: FloatArray
    parts: int


class _Turns(NamedTuple):
    """The turns of a block; n turns.

    Parameters
    ----------
    begin
        (n,) tick at which each window begins.
    scale
        (n,) ticks in a timer count.
    table, sign
        (n, A) index of each step table, -1 for no move, and direction of its steps.
    """

    begin: IntArray
    scale: FloatArray
    table: IntArray
    sign: IntArray


class Library(NamedTuple):
    """All step tables of a program in one array.

    Parameters
    ----------
    times
        Timer counts from the start of the window to each step, for all tables in order.
    begins
        (k + 1,) index in ``times`` at which each of the k tables begins, and the length of
        ``times``.
    """

    times: IntArray
    begins: IntArray

    @classmethod
    def of(cls, commands: StepPlay) -> Library:
        """Return the tables of ``commands``."""
        return _joined(commands.library)


@lru_cache(maxsize=1)
def _joined(tables: tuple[StepTable, ...]) -> Library:
    """Return the joined tables; cached, because a proof plays the same ones in all its runs."""
    intervals, begins = concatenated_intervals(tables)
    times = np.cumsum(intervals)
    before = np.concatenate(([0], times[begins[1:] - 1]))
    return Library(
        times=times - np.repeat(before, np.diff(begins, append=len(times))),
        begins=np.append(begins, len(times)),
    )


class Played(NamedTuple):
    """State of a run; ``play`` changes it in place.

    Parameters
    ----------
    state
        (m,) state of the linear system.
    steps
        (A,) steps so far.
    turn, at
        (A,) index of the turn whose table each axis plays, and of the next step in the table.
    """

    state: FloatArray
    steps: FloatArray
    turn: IntArray
    at: IntArray

    @classmethod
    def at_rest(cls, states: int, axes: int) -> Played:
        """Return the state of a run before its first step."""
        begin = np.zeros((2, axes), dtype=np.int64)
        return cls(state=np.zeros(states), steps=np.zeros(axes), turn=begin[0], at=begin[1])


def play(
    driven: Driven,
    library: Library,
    played: Played,
    block: StitchBlock,
    commands: StepPlay,
    samples: tuple[int, int, int],
) -> tuple[FloatArray, FloatArray]:
    """Return (n, m) states and (n, A) steps so far, at n samples; advance ``played``.

    Parameters
    ----------
    samples
        Index of the first sample, number of samples, and ticks from sample to sample. A sample is
        taken before the steps at the same instant.
    """
    first, count, every = samples
    scale = np.ones(len(block))
    if commands.counted_by == "angle":
        scale = block.window / float(commands.window_angle)
    states = np.empty((count, len(played.state)))
    steps = np.empty((count, len(played.steps)))
    interval = _Interval(
        np.ascontiguousarray(driven.step.T),
        np.ascontiguousarray((driven.held * driven.scale).T),
        np.ascontiguousarray((driven.series * driven.scale).transpose(0, 2, 1)),
        driven.parts,
    )
    turns = _Turns(block.begin, scale, block.table, block.sign)
    ticks = float(first * every), float(every)
    _forward(interval, library, turns, played, ticks, states, steps)
    return states, steps


@njit(nogil=True)
def _forward(
    system: _Interval, library: Library, turns: _Turns, played: Played,
    ticks: tuple[float, float], states: FloatArray, steps: FloatArray,
) -> None:  # fmt: skip
    """Fill ``states`` and ``steps``; each axis is at step ``at`` in the table of its ``turn``.

    Parameters
    ----------
    ticks
        First tick, and ticks from sample to sample.
    """
    step, held, series, parts = system
    times, begins = library
    begin, scale, table, sign = turns
    state, given, turn, at = played
    from_tick, every = ticks
    terms, axes, size = series.shape
    sums = np.zeros((axes, terms))
    fresh = np.zeros(size)
    interval = every / parts
    for k in range(len(states)):
        for i in range(size):
            states[k, i] = state[i]
        for a in range(axes):
            steps[k, a] = given[a]
        for part in range(parts):
            end = from_tick + k * every + (part + 1) * interval
            for i in range(size):
                fresh[i] = 0.0
            for j in range(size):
                value = state[j]
                for i in range(size):
                    fresh[i] += step[j, i] * value
            for a in range(axes):
                value = given[a]
                for i in range(size):
                    fresh[i] += held[a, i] * value
            for a in range(axes):
                some = False
                while turn[a] < len(begin):
                    which = table[turn[a], a]
                    if which < 0 or at[a] >= begins[which + 1] - begins[which]:
                        turn[a] += 1
                        at[a] = 0
                        continue
                    due = begin[turn[a]] + times[begins[which] + at[a]] * scale[turn[a]]
                    if due >= end:
                        break
                    if not some:
                        some = True
                        for n in range(terms):
                            sums[a, n] = 0.0
                    left = (end - due) / interval
                    power = float(sign[turn[a], a])
                    given[a] += power
                    for n in range(terms):
                        power *= left
                        sums[a, n] += power
                    at[a] += 1
                if some:
                    for n in range(terms):
                        value = sums[a, n]
                        for i in range(size):
                            fresh[i] += series[n, a, i] * value
            for i in range(size):
                state[i] = fresh[i]
