"""Variants of a machine within its tolerances: drawn, at corners, or one number at a time.

A *part* is the relative position of a number in its tolerance: -1 at the lower end, 0 at the
nominal value, 1 at the upper end. A normally distributed number may go further, to ``FARTHEST``
standard deviations. Every choice of k variants gives (k, n) parts for the n numbers of
``uncertain(machine)``. ``numbers_at`` converts parts into the numbers of a batch, and ``variant``
converts a row of parts into a machine with the same numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product

import numpy as np

from threadline.base.arrays import FloatArray, IntArray, Recent
from threadline.errors import OptionError
from threadline.machine.load import place_in
from threadline.machine.model import NUMBERED, Machine
from threadline.machine.numbers import is_whole, number_at, with_numbers
from threadline.machine.parts import SupplyCut
from threadline.machine.pneumatics import TIMES
from threadline.machine.quantity import Provenance, Quantity
from threadline.machine.tables import matches, quantities

MOST_CORNERS = 12
"""Largest number n of varying numbers for ``corners``, which returns 2^n variants."""
SUPPLY_CUT = "supply_cut"
"""Name of the input that ``coasting`` adds: it is 1 when the supply of the drive is cut."""
FARTHEST = 3.0
"""Standard deviations at which a normal distribution is cut off."""
_PER_PART = 2.0
"""Standard deviations per tolerance."""
_DELAY_STEPS = 100
"""Dead times vary in hundredths of their tolerance, so that they stay exact fractions of a second.
"""
DRAWN_STEPS = 5
"""Drawn dead times vary in fifths of their tolerance, because machines with equal dead times are
simulated together. A mean over the tolerance is then a sum by the trapezoidal rule, whose error is
proportional to the square of the step."""
_MACHINE = (
    "bodies.*", "links.*", "drives.*", "sensors.*", "controllers.*", "inputs.*", "cylinders.*",
    "contacts.*", "spool.*",
)  # fmt: skip
_COUNTS = "axes.*.counts"
_FRICTION, _STICTION = ".friction", ".stiction"
_PLANNED = (
    "tick_budget", "axes.*.velocity", "axes.*.acceleration", "axes.*.deceleration", "axes.*.jerk",
    "axes.*.travel.*", "axes.*.stroke", "axes.*.working_velocity", "outputs.*", "plc.*", "path.*",
    "tool.*", "operator.*",
)  # fmt: skip
"""Numbers that affect only plans; they keep their nominal values in every variant."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Uncertain:
    """A number that varies, or a group of numbers that vary together.

    Parameters
    ----------
    name
        Name of the group, or the dotted name of the number.
    numbers
        Dotted names of its numbers in the file.
    normal
        Whether its distribution is normal, truncated at 3 standard deviations, which are 1.5
        tolerances. Otherwise it is uniform.
    """

    name: str
    numbers: tuple[str, ...]
    normal: bool

    @property
    def farthest(self) -> float:
        """Its largest deviation, in tolerances."""
        return FARTHEST / _PER_PART if self.normal else 1.0


def coasting(machine: Machine, axis: str, at_si: float) -> Machine:
    """Return the machine with an input ``SUPPLY_CUT`` that cuts the drive of an axis.

    Parameters
    ----------
    at_si
        Position at and beyond which the drive has no supply, m or rad.
    """
    unit = "m" if machine.axes[axis].kind == "linear" else "rad"
    at = Quantity(si=at_si, unit=unit, tolerance_si=0.0, provenance=Provenance.ASSUMED)
    switch = SupplyCut(
        kind="limit-switch",
        axis=axis,
        at=at,
        beyond="above",
        cuts=machine.controller_of(axis).drive,
    )
    return replace(machine, inputs={**machine.inputs, SUPPLY_CUT: switch})


def uncertain(machine: Machine) -> tuple[Uncertain, ...]:
    """Return the n numbers and groups of ``machine`` that vary, in the order of its file.

    A group is at the position of its first number. Limits that affect only plans (velocity, travel,
    the shortest dwell of a valve) do not vary.

    Raises
    ------
    OptionError
        If a number has a tolerance but no variant can change it.
    """
    # Cached, because every variant of a machine needs these numbers.
    return _RECENT.of(machine, lambda: _uncertain(machine))


_RECENT: Recent[Machine, tuple[Uncertain, ...]] = Recent(4, lambda a, b: a is b)


def _uncertain(machine: Machine) -> tuple[Uncertain, ...]:
    rules = machine.tolerances
    paths_of: dict[str, list[str]] = {}
    for path, quantity in _numbers(machine):
        if quantity.tolerance_si == 0.0 or matches(path, rules.exclude):
            continue
        if matches(path, _PLANNED):
            continue
        _check(machine, path)
        group = next((n for n, m in rules.groups.items() if matches(path, m)), path)
        paths_of.setdefault(group, []).append(path)
    return tuple(
        Uncertain(name=name, numbers=tuple(paths), normal=_normal(machine, name, paths))
        for name, paths in paths_of.items()
    )


def not_drawn(machine: Machine) -> dict[str, str]:
    """Return the numbers with a tolerance that do not vary, each with its reason."""
    reasons = {}
    for path, quantity in _numbers(machine):
        if quantity.tolerance_si == 0.0:
            continue
        if matches(path, machine.tolerances.exclude):
            reasons[path] = "excluded by the machine file"
        elif matches(path, _PLANNED):
            reasons[path] = "it affects only plans"
    return reasons


def check_uncertain(machine: Machine) -> tuple[Uncertain, ...]:
    """Return the numbers and groups of ``machine`` that vary; refuse a machine without any.

    Raises
    ------
    OptionError
        If nothing varies, or a number cannot vary.
    """
    varying = uncertain(machine)
    if not varying:
        raise OptionError(
            f"no number of {machine.name} has a tolerance",
            place=machine.place,
            remedy='Write tolerances in the machine file: "111 kg +- 10 %".',
        )
    return varying


def drawn(machine: Machine, seed: int, index: IntArray) -> FloatArray:
    """Return the (k, n) parts of the variants ``index`` in the random sequence of a seed.

    A variant depends only on seed and index, so it is the same bit for bit in any order, any
    section of the sequence and any number of processes. The generator is the counter-based Philox,
    keyed by both (Salmon and others, "Parallel random numbers: as easy as 1, 2, 3", 2011). Dead
    times take ``DRAWN_STEPS`` values on each side of the nominal one.

    Parameters
    ----------
    seed
        Whole number from 0 to 2**64 - 1.
    index
        (k,) numbers of variants in the sequence, from 0.

    Raises
    ------
    OptionError
        If seed or index is negative or too large, or a number cannot vary.
    """
    from scipy.special import ndtr, ndtri  # slow to import, and needed by few commands

    numbers = uncertain(machine)
    indices = [int(i) for i in np.asarray(index).ravel()]
    for value, what in ((seed, "seed"), *((i, "index") for i in indices)):
        if not 0 <= value < 1 << 64:
            raise OptionError(f"the {what} of a variant is {value}, not from 0 to 2**64 - 1")
    parts = np.empty((len(indices), len(numbers)))
    for row, one in zip(parts, indices, strict=True):
        key = np.array([seed, one], dtype=np.uint64)
        row[:] = np.random.Generator(np.random.Philox(key=key)).random(len(numbers))
    normal = np.array([number.normal for number in numbers], dtype=bool)
    low, high = ndtr(-FARTHEST), ndtr(FARTHEST)
    normal_parts = ndtri(low + (high - low) * parts[:, normal]) / _PER_PART
    parts = 2.0 * parts - 1.0
    parts[:, normal] = normal_parts
    is_time = np.array([all(path.endswith(TIMES) for path in one.numbers) for one in numbers], bool)
    parts[:, is_time] = np.round(DRAWN_STEPS * parts[:, is_time]) / DRAWN_STEPS
    return parts


def corners(machine: Machine) -> FloatArray:
    """Return the (2**n, n) parts of all corners: each number at its lower (-1) or upper (1) end.

    Every combination is a row; the first number changes slowest.

    Raises
    ------
    OptionError
        If more than ``MOST_CORNERS`` numbers vary.
    """
    numbers = uncertain(machine)
    if len(numbers) > MOST_CORNERS:
        raise OptionError(
            f"{len(numbers)} numbers of {machine.name!r} vary, too many for all corners; "
            f"at most {MOST_CORNERS}",
            place=machine.place,
            remedy="Exclude some under [tolerances], or group numbers that vary together.",
        )
    return np.array(list(product((-1.0, 1.0), repeat=len(numbers)))).reshape(-1, len(numbers))


def one_at_a_time(machine: Machine) -> FloatArray:
    """Return (2 n, n) parts: one number at its lower or upper end, all others nominal."""
    count = len(uncertain(machine))
    parts = np.zeros((2 * count, count))
    parts[np.arange(0, 2 * count, 2), np.arange(count)] = -1.0
    parts[np.arange(1, 2 * count, 2), np.arange(count)] = 1.0
    return parts


def numbers_at(machine: Machine, parts: FloatArray) -> dict[str, FloatArray]:
    """Return the numbers of a batch of variants: dotted name -> (k,) SI values.

    Parameters
    ----------
    parts
        (k, n) parts of the numbers.

    Raises
    ------
    ValueError
        If the number of columns of ``parts`` is wrong.
    """
    part_rows = np.atleast_2d(np.asarray(parts, dtype=np.float64))
    numbers = uncertain(machine)
    if part_rows.shape[1] != len(numbers):
        raise ValueError(
            f"parts are for {part_rows.shape[1]} numbers, the machine has {len(numbers)}"
        )
    values = {}
    for column, number in zip(part_rows.T, numbers, strict=True):
        for path in number.numbers:
            quantity = number_at(machine, path)
            if path.endswith(TIMES):
                # Few, of many machines.
                distinct_parts, part_index = np.unique(column, return_inverse=True)
                delays = [float(_delay(quantity, part)) for part in distinct_parts]
                values[path] = np.array(delays)[part_index.ravel()]
            else:
                values[path] = quantity.si + column * quantity.tolerance_si
    for path in [name for name in values if name.endswith(_STICTION)]:
        # Stiction is never below friction, even where their tolerances overlap.
        friction_path = path.removesuffix(_STICTION) + _FRICTION
        friction_si = values.get(friction_path, number_at(machine, friction_path).si)
        values[path] = np.maximum(values[path], friction_si)
    return values


def variant(machine: Machine, parts: FloatArray) -> Machine:
    """Return the machine with its numbers at ``parts``, shape (n,).

    Its numbers equal the result of ``numbers_at`` to the bit, and its hash is unique. Commands use
    the nominal counts per unit in every variant; if the counts per unit of an axis vary, the same
    commands move its load to another position.
    """
    numbers = {name: float(values[0]) for name, values in numbers_at(machine, parts).items()}
    count_scales = {name: numbers.pop(name) for name in list(numbers) if matches(name, (_COUNTS,))}
    new_machine = with_numbers(machine, {**numbers, **count_scales})
    axes = dict(machine.axes)
    for name in count_scales:
        axis = name.split(".")[1]
        axes[axis] = replace(machine.axes[axis], load=load_by_counts(new_machine, axis))
    return replace(new_machine, axes=axes)


def load_by_counts(machine: Machine, axis: str) -> dict[str, Quantity]:
    """Return the load of an axis by its own counts, for commands in another machine's counts.

    The weight of each body is its weight in the encoder of the axis divided by the counts per unit
    of ``machine``. If a machine with other counts per unit gets these weights, its load moves like
    the load of ``machine``.
    """
    counts = machine.axes[axis].counts
    unit = {"count/m": "m", "count/rad": "rad"}[counts.unit]
    return {
        body: replace(q, si=q.si / counts.si, unit=_per(unit, q.unit), tolerance_si=0.0)
        for body, q in _counted(machine, axis).items()
    }


def _counted(machine: Machine, axis: str) -> Mapping[str, Quantity]:
    """Return the bodies whose motion an axis counts, each with its counts per unit.

    These are the bodies that the encoder reads, or the body of the stepper or pulse servo.
    """
    source = machine.source_of(axis)
    if source is None:
        return machine.sensors[machine.controller_of(axis).sensor].reads
    unit = "count/rad" if machine.bodies[source.body].kind == "rotary" else "count/m"
    return {source.body: replace(machine.axes[axis].counts, si=source.counts, unit=unit)}


def _numbers(machine: Machine) -> list[tuple[str, Quantity]]:
    return [pair for table in NUMBERED for pair in quantities(getattr(machine, table), table)]


def _check(machine: Machine, path: str) -> None:
    reason = ""
    if path.startswith("clocks."):
        reason = "all times are counted in clock periods"
    elif matches(path, (_COUNTS,)):
        if machine.axes[path.split(".")[1]].load is not None:
            reason = "its load defines the position, not its counts"
    elif not matches(path, _MACHINE):
        reason = "no part of the simulated machine depends on it"
    elif is_whole(machine, path):
        reason = "it must be a whole number"
    if reason:
        raise OptionError(
            f"{path} has a tolerance but cannot vary: {reason}",
            place=place_in(machine, path),
            remedy="Make it exact, or name it under [tolerances] exclude.",
        )


def _normal(machine: Machine, name: str, paths: list[str]) -> bool:
    is_normal = [matches(path, machine.tolerances.normal) for path in paths]
    if any(is_normal) and not all(is_normal):
        raise OptionError(
            f"the group {name!r} varies together, but {paths[is_normal.index(True)]} is normal and "
            f"{paths[is_normal.index(False)]} is not",
            remedy="Name all of them under [tolerances] normal, or none.",
        )
    for path in paths if any(is_normal) else ():
        quantity = number_at(machine, path)
        if 0.0 < quantity.si <= quantity.tolerance_si * FARTHEST / _PER_PART:
            raise OptionError(
                f"{path} would reach zero at {FARTHEST:g} standard deviations of "
                f"{quantity.tolerance_si / _PER_PART:.4g} {quantity.unit}".rstrip(),
                place=place_in(machine, path),
                remedy="Give it a smaller tolerance, or remove it from [tolerances] normal.",
            )
    return any(is_normal)


def _per(axis_unit: str, reads_unit: str) -> str:
    """Return the unit of a weight in ``load``, for an axis and a body that are in m or rad each."""
    body_unit = reads_unit.removeprefix("count/")
    return "" if body_unit == axis_unit else f"{axis_unit}/{body_unit}"


def _delay(quantity: Quantity, part: float) -> Fraction:
    """Return a dead time at a part of its tolerance, as an exact fraction of a second."""
    exact = Fraction(0) if quantity.exact_s is None else quantity.exact_s
    step = Fraction(quantity.tolerance_si).limit_denominator(10**9) / _DELAY_STEPS
    return exact + round(part * _DELAY_STEPS) * step
