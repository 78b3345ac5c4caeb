"""Kernel: one connected piece of a machine under its controllers, tick by tick."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from threadline.arrays import FloatArray, IntArray
from threadline.twin.modes import ModeCache, advance_watched, find_slot, settle
from threadline.twin.tables import ControlTables, OutputTables, PlantTables


class Grid(NamedTuple):
    """The schedule as arrays; see ``Schedule``."""

    first_action: IntArray
    actions: IntArray
    length: IntArray


class Loop(NamedTuple):
    """What persists from block to block; K controllers, R commands at most in one dead time."""

    z: FloatArray  # (N,) state, inputs, 1
    code: IntArray  # (E,)
    where: IntArray  # (3,) slot, step of the hyperperiod, ticks until the next sample
    error: FloatArray  # (K, 2) of the two ticks before
    output: FloatArray  # (K, 2) levels before rounding, of the two ticks before
    level: FloatArray  # (K,) the DAC
    under_way: FloatArray  # (K, R) levels in the dead time
    head: IntArray  # (K, 2) where the next is written and read
    phase: FloatArray  # (K,) of the encoder
    reference: FloatArray  # (K,) counts
    tripped: IntArray  # (inputs,)
    counts: IntArray  # (3,) slow advances, events, endless changes
    peak: FloatArray  # (drives,) largest current since the last sample


@njit(cache=True)
def control(tables: ControlTables, v: int, loop: Loop, k: int, quantised: bool) -> None:
    """Let controller k read its sensor, compute and hand on a DAC level."""
    counts = 0.0
    for j in range(len(loop.z)):
        counts += tables.sensor_row[v, k, j] * loop.z[j]
    if quantised:
        counts = np.floor(counts + loop.phase[k])
    error = loop.reference[k] - counts
    value = (
        tables.numerator[v, k, 0] * error
        + tables.numerator[v, k, 1] * loop.error[k, 0]
        + tables.numerator[v, k, 2] * loop.error[k, 1]
        - tables.denominator[v, k, 0] * loop.output[k, 0]
        - tables.denominator[v, k, 1] * loop.output[k, 1]
    )
    loop.error[k, 1] = loop.error[k, 0]
    loop.error[k, 0] = error
    level = np.rint(value) if quantised else value
    level = min(max(level, tables.level_low[v, k]), tables.level_high[v, k])
    if tables.zero_on_reversal[k] and level * loop.level[k] < 0.0:
        level = 0.0
    loop.output[k, 1] = loop.output[k, 0]
    loop.output[k, 0] = min(max(value, tables.level_low[v, k]), tables.level_high[v, k])
    loop.level[k] = level
    loop.under_way[k, loop.head[k, 0]] = level
    loop.head[k, 0] = (loop.head[k, 0] + 1) % loop.under_way.shape[1]


@njit(cache=True)
def arrive(tables: ControlTables, v: int, loop: Loop, k: int, n: int) -> None:
    """Let the oldest command of controller k take effect at its drive."""
    level = loop.under_way[k, loop.head[k, 1]]
    loop.head[k, 1] = (loop.head[k, 1] + 1) % loop.under_way.shape[1]
    held = level * tables.volt_per_level[v, k] * tables.gain[v, k]
    limit = tables.limit[v, k]
    loop.z[n + tables.drive[k]] = min(max(held, -limit), limit)


@njit(cache=True)
def _currents(plant, outputs, v, loop, out):  # type: ignore[no-untyped-def]
    for d in range(len(outputs.drive_element)):
        e = outputs.drive_element[d]
        total = 0.0
        for j in range(len(loop.z)):
            total += plant.law[v, e, loop.code[e], j] * loop.z[j]
        out[d] = total


@njit(cache=True)
def _note_peak(plant, outputs, v, loop, now):  # type: ignore[no-untyped-def]
    _currents(plant, outputs, v, loop, now)
    for d in range(len(now)):
        if abs(now[d]) > abs(loop.peak[d]):
            loop.peak[d] = now[d]


@njit(cache=True)
def _sample(plant, tables, outputs, v, loop, quantised, now, out):  # type: ignore[no-untyped-def]
    """Fill counts and volts per controller, load, frame, current, its peak, and inputs."""
    at = 0
    size = len(loop.z)
    for k in range(len(loop.level)):
        total = 0.0
        for j in range(size):
            total += tables.sensor_row[v, k, j] * loop.z[j]
        out[at] = np.floor(total + loop.phase[k]) if quantised else total
        at += 1
    for rows in (outputs.load, outputs.frame):
        for a in range(rows.shape[1]):
            total = 0.0
            for j in range(size):
                total += rows[v, a, j] * loop.z[j]
            out[at] = total
            at += 1
    for k in range(len(loop.level)):
        out[at] = loop.level[k] * tables.volt_per_level[v, k]
        at += 1
    _note_peak(plant, outputs, v, loop, now)
    for d in range(len(now)):
        out[at] = now[d]
        out[at + len(now)] = loop.peak[d]
        loop.peak[d] = 0.0
        at += 1
    at += len(now)
    for s in range(len(loop.tripped)):
        out[at] = loop.tripped[s]
        at += 1


@njit(cache=True)
def run_block(  # noqa: PLR0915
    plant: PlantTables,
    tables: ControlTables,
    outputs: OutputTables,
    grid: Grid,
    cache: ModeCache,
    loop: Loop,
    v: int,
    references: FloatArray,
    every: int,
    quantised: bool,
    records: FloatArray,
) -> int:
    """Run as many ticks as ``references`` (ticks, K) has rows; return how many samples were taken.

    Row i is the commanded position, in counts, at the instant of tick i. Sample 0 of a
    recording is tick 0, then one every ``every`` ticks, before the controllers act.
    """
    n = plant.base.shape[1]
    size = len(loop.z)
    guards = cache.guard.shape[1]
    y = np.zeros(size)
    D = np.zeros((13, n))
    q = np.zeros(13)
    now = np.zeros(len(outputs.drive_element))
    slot = find_slot(plant, v, cache, loop.code)
    step = loop.where[1]
    steps = len(grid.length)
    row = 0
    taken = 0
    while True:
        for a in range(grid.first_action[step], grid.first_action[step + 1]):
            what = grid.actions[a, 0]
            k = grid.actions[a, 1]
            if what == 0:
                if row == len(references):
                    loop.where[1] = step
                    return taken
                for c in range(references.shape[1]):
                    loop.reference[c] = references[row, c]
                row += 1
                if loop.where[2] == 0:
                    _sample(plant, tables, outputs, v, loop, quantised, now, records[taken])
                    taken += 1
                    loop.where[2] = every
                loop.where[2] -= 1
            elif what == 1:
                control(tables, v, loop, k, quantised)
            else:
                arrive(tables, v, loop, k, n)
        # The inputs may have jumped: the current that follows belongs to the mode then in force.
        slot = settle(plant, v, cache, slot, loop.code, loop.z, loop.tripped, loop.counts)
        _note_peak(plant, outputs, v, loop, now)
        index = grid.length[step]
        fast = cache.fast[slot, index]
        inside = True
        per = (fast.shape[0] - n) // max(1, guards)
        for w in range(guards):
            low = cache.low[slot, w]
            high = cache.high[slot, w]
            if low == -np.inf and high == np.inf:
                continue
            for i in range(n + w * per, n + w * per + 1 + 3 * cache.intervals[index]):
                total = 0.0
                for j in range(size):
                    total += fast[i, j] * loop.z[j]
                if total > high or total < low:
                    inside = False
                    break
            if not inside:
                break
        if inside:
            for i in range(n):
                total = 0.0
                for j in range(size):
                    total += fast[i, j] * loop.z[j]
                y[i] = total
            for i in range(n):
                loop.z[i] = y[i]
        else:
            slot = advance_watched(
                plant,
                v,
                cache,
                slot,
                loop.code,
                loop.z,
                y,
                cache.lengths[index],
                loop.tripped,
                loop.counts,
                D,
                q,
            )
        _note_peak(plant, outputs, v, loop, now)
        step += 1
        if step == steps:
            step = 0
