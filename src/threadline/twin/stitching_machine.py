"""A machine whose drives follow steps as one linear system: its matrices from sample to sample.

Between two samples the state goes on by one matrix exponential; a step that comes tau before the
sample adds ``integral_0^tau exp(A s) ds B``, whose power series in tau needs no more than sums of
powers.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from scipy.linalg import expm

from threadline.arrays import FloatArray
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.sources import PulseServo
from threadline.plant.prescribed import prescribed

_TERMS = 20
_NORM = 1.0  # of the rates over an interval: the series then ends below 1e-18
_MOST_PARTS = 1024


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Driven:
    """A machine whose drives follow steps, as one linear system that is advanced by intervals.

    The m states are those of each connected piece, followed by position and speed of its servos;
    A is the number of axes.

    Parameters
    ----------
    step
        (m, m) transition matrix of the state over an interval.
    held
        (m, A) what each step that was given before an interval adds to the state over it.
    series
        (terms, m, A) what a step within an interval adds to the state at its end: coefficients of
        the powers of the part of the interval that is left when the step comes.
    loads
        (A, m) position of each axis, in its own units.
    forces
        (A, m) force of each drive, N or N m, that follows from the state.
    told
        (A,) force of each drive per commanded m or rad.
    limit
        (A,) force that each drive has, N or N m.
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
    told: FloatArray
    limit: FloatArray
    scale: FloatArray
    parts: int


def driven_of(machine: Machine) -> Driven:
    """Return the linear system of ``machine``, by which step tables are played.

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
    told, limit, scale = (np.zeros(len(names)) for _ in range(3))
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
            # It gives what its own mass and the network ask for.
            forces[at, columns] = -piece.pulls[k]
            forces[at] += piece.inertia[k] * rates[speed]
            told[at] = piece.inertia[k] * w * w
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
        told=told,
        limit=limit,
        scale=scale,
        parts=parts,
    )


def _parts(rates: FloatArray, sample_s: float, machine: Machine) -> int:
    """Return how many intervals to cut a sample into, so that the series is exact."""
    fastest = float(np.abs(np.linalg.eigvals(rates)).max())
    parts = ceil(fastest * sample_s / _NORM)
    if parts > _MOST_PARTS:
        raise MachineError(
            f"{machine.name} rings at {fastest / (2.0 * np.pi):.4g} Hz, too fast for samples of "
            f"{sample_s * 1e3:g} ms",
            place=machine.place,
            remedy="Give its drives a shorter clock, or leave out what rings so fast.",
        )
    return max(1, parts)


def _powers(
    rates: FloatArray, entry: FloatArray, interval_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the state's step over an interval, and (terms, m, A) ``A^k B T^(k+1) / (k+1)!``."""
    terms, power = [], entry * interval_s
    for k in range(1, _TERMS + 1):
        terms.append(power)
        power = rates @ power * (interval_s / (k + 1))
    return np.asarray(expm(rates * interval_s)), np.stack(terms)
