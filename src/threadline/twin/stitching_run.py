"""Plays the steps of a block of turns on a linear system, from sample to sample: compiled."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit
from threadline.signals import StepPlay, StepTable, StitchBlock
from threadline.signals.step_play import one_behind_the_other
from threadline.twin.stitching_machine import Driven


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Library:
    """All step tables of a program, one behind the other.

    Parameters
    ----------
    times
        Timer counts from the start of the window to each step, table behind table.
    begins
        (k + 1,) index at which each of the k tables begins in ``times``, and the length of that.
    """

    times: IntArray
    begins: IntArray

    @classmethod
    def of(cls, commands: StepPlay) -> Library:
        """Return the tables of ``commands``."""
        return _joined(commands.library)


@lru_cache(maxsize=1)
def _joined(tables: tuple[StepTable, ...]) -> Library:
    """Return the tables one behind the other; a proof plays the same ones in all of its runs."""
    intervals, begins = one_behind_the_other(tables)
    times = np.cumsum(intervals)
    before = np.concatenate(([0], times[begins[1:] - 1]))
    return Library(
        times=times - np.repeat(before, np.diff(begins, append=len(times))),
        begins=np.append(begins, len(times)),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Played:
    """Where a run is; ``play`` changes all of it in place.

    Parameters
    ----------
    state
        (m,) state of the frame.
    steps
        (A,) steps given so far.
    turn, at
        (A,) turn of the block whose table each axis plays, and number of its next step.
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
    """Return (n, m) states and (n, A) steps given, at n samples; advance ``played``.

    Parameters
    ----------
    samples
        Index of the first sample, number of samples, and ticks from one to the next. A sample is
        taken before the steps that are due at its instant.
    """
    first, count, every = samples
    scale = np.ones(len(block))
    if commands.counted_by == "angle":
        scale = block.window / float(commands.window_angle)
    states = np.empty((count, len(played.state)))
    steps = np.empty((count, len(played.steps)))
    # Transposed: what is summed runs along the memory, and the order of the sums stays.
    _run(
        np.ascontiguousarray(driven.step.T),
        np.ascontiguousarray((driven.held * driven.scale).T),
        np.ascontiguousarray((driven.series * driven.scale).transpose(0, 2, 1)),
        driven.parts,
        library.times, library.begins, block.begin, scale, block.table, block.sign,
        float(first * every), float(every), played.state, played.steps, played.turn, played.at,
        states, steps,
    )  # fmt: skip
    return states, steps


def _forward(
    step: FloatArray, held: FloatArray, series: FloatArray, parts: int,
    times: IntArray, begins: IntArray, begin: IntArray, scale: FloatArray,
    table: IntArray, sign: IntArray,
    from_tick: float, every: float, state: FloatArray, given: FloatArray,
    turn: IntArray, at: IntArray, states: FloatArray, steps: FloatArray,
) -> None:  # fmt: skip
    """Go through the samples; each axis is at step ``at`` of the table of its ``turn``."""
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


_run = njit(nogil=True)(_forward)
