"""Days of a machine at given places in their ranges, also a different day for each machine.

A day is a set of values that vary from run to run, see ``vary.Days``.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.machine.model import Machine
from threadline.machine.numbers import number_at
from threadline.machine.vary import (
    FRICTION_OF_DAYS,
    SUPPLY_OF_DAYS,
    TENSION_OF_DAYS,
    Days,
    varied_numbers,
)

RANGES_OF_DAYS = 3
"""Number of ranges of a day besides encoder phases: friction, supply, and the brake of a spool."""
_RANGES = (FRICTION_OF_DAYS, SUPPLY_OF_DAYS, TENSION_OF_DAYS)


def within(ends: tuple[float, float], places: FloatArray) -> FloatArray:
    """Return (k,) factors at (k,) places in a range: 0 is its lower end, 1 its upper end."""
    return ends[0] + places * (ends[1] - ends[0])


def days_at(places: FloatArray) -> Days:
    """Return k days at (k, 3 + axes) places in their ranges, each from 0 to 1."""
    friction, supply, tension = (within(ends, places[:, k]) for k, ends in enumerate(_RANGES))
    return Days(
        friction=friction, supply=supply, tension=tension,
        phases=np.minimum(places[:, RANGES_OF_DAYS:], np.nextafter(1.0, 0.0)),
    )  # fmt: skip


def places_of_days(days: Days) -> FloatArray:
    """Return the (k, 3 + axes) places of k days in their ranges, each from 0 to 1."""
    factors = days.friction, days.supply, days.tension
    places = [
        (factor - low) / (high - low) for factor, (low, high) in zip(factors, _RANGES, strict=True)
    ]
    return np.concatenate([np.stack(places, axis=1), days.phases], axis=1)


def on_days(
    machine: Machine, numbers: Mapping[str, FloatArray], days: Days
) -> dict[str, FloatArray]:
    """Return the numbers of k machines on every day: (k days,) SI values, machine by machine.

    Parameters
    ----------
    numbers
        Dotted names and (k,) SI values of the numbers that differ from ``machine``.
    """
    by_day = {path: np.repeat(values, len(days)) for path, values in numbers.items()}
    count = len(next(iter(numbers.values())))
    return on_own_days(machine, by_day, days.taken(np.tile(np.arange(len(days)), count)))


def on_own_days(
    machine: Machine, numbers: Mapping[str, FloatArray], days: Days
) -> dict[str, FloatArray]:
    """Return the numbers of k machines, machine i on day i: (k,) SI values.

    Parameters
    ----------
    numbers
        As in ``on_days``.
    """
    numbers_by_path = dict(numbers)
    for path, values in varied_numbers(machine, days).items():
        is_varied = path in numbers_by_path
        numbers_by_path[path] = (
            numbers_by_path[path] * (values / number_at(machine, path).si) if is_varied else values
        )
    return numbers_by_path
