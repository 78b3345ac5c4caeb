"""Numbers of a machine by their dotted names, with replacements for several variants."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray, Locked, read_only
from threadline.base.wording import nearest
from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.machine.numbers import with_numbers
from threadline.machine.quantity import Quantity

_TABLES = (
    "bodies", "links", "drives", "sensors", "controllers", "inputs", "cylinders", "contacts",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Values(Locked):
    """The numbers of ``machine``, with some of them replaced in each of ``count`` variants.

    Parameters
    ----------
    machine
        Machine with the structure and all other numbers.
    replaced
        Dotted name of a number, such as ``"bodies.x.inertia"`` -> its (count,) SI values.
    count
        Number of variants; 1 without replacements.

    Raises
    ------
    OptionError
        If a name is not the name of a number of this machine, or the lengths differ.
    """

    machine: Machine
    replaced: Mapping[str, FloatArray]
    count: int

    @classmethod
    def of(cls, machine: Machine, replaced: Mapping[str, FloatArray] | None = None) -> Values:
        """Return ``machine`` with numbers ``replaced``: dotted name -> (count,) SI values.

        Raises
        ------
        OptionError
            If a name is not the name of a number of this machine, or the lengths differ.
        """
        replacements = {
            k: read_only(np.atleast_1d(v), k, ndim=1) for k, v in (replaced or {}).items()
        }
        known = number_paths(machine) if replacements else ()
        for path in replacements:
            if path not in known:
                raise OptionError(
                    f"machine {machine.name!r} has no number {path!r}",
                    remedy=nearest(path, known, "It has"),
                )
        lengths = {len(v) for v in replacements.values()} or {1}
        if len(lengths) > 1:
            raise OptionError(f"variants have different lengths: {sorted(lengths)}")
        return cls(machine, replacements, lengths.pop())

    def at(self, path: str, quantity: Quantity | None) -> FloatArray | float:
        """Return the (count,) values of ``path``, else the machine's ``quantity`` (0 if None)."""
        if path in self.replaced:
            return self.replaced[path]
        return 0.0 if quantity is None else quantity.si

    def by_delay(self) -> list[tuple[Values, IntArray]]:
        """Return the variants grouped by dead time, each group with its (k,) indices.

        The variants of a simulated batch must have equal dead times, because dead times determine
        the instants at which a simulation stops. In each group the dead times are numbers of
        ``machine`` and not of ``replaced``.
        """
        delay_paths = self._late()
        if not delay_paths:
            return [(self, np.arange(self.count))]
        other_values = {path: v for path, v in self.replaced.items() if path not in delay_paths}
        groups = []
        for places in self.places_by_delay():
            delays = {path: float(self.replaced[path][places[0]]) for path in delay_paths}
            group_values = {path: values[places] for path, values in other_values.items()}
            machine = with_numbers(self.machine, delays)
            groups.append((Values(machine, group_values, len(places)), places))
        return groups

    def places_by_delay(self) -> list[IntArray]:
        """Return the (k,) indices of each group of ``by_delay``."""
        delay_paths = self._late()
        if not delay_paths:
            return [np.arange(self.count)]
        rows = np.stack([self.replaced[path] for path in delay_paths], axis=1)
        _, group_index = np.unique(rows, axis=0, return_inverse=True)
        order = np.argsort(group_index.ravel(), kind="stable")
        return np.split(order, np.cumsum(np.bincount(group_index.ravel()))[:-1])

    def _late(self) -> list[str]:
        """Return the names of the dead times that vary."""
        return [path for path in self.replaced if path.endswith(".delay")]

    def slice(self, start: int, stop: int) -> Values:
        """Return the variants from ``start`` up to ``stop``."""
        part = {k: v[start:stop] for k, v in self.replaced.items()}
        return Values(self.machine, part, min(stop, self.count) - start)


def number_paths(machine: Machine) -> tuple[str, ...]:
    """Return the dotted names of all numbers that variants of a machine may replace."""
    return tuple(_paths(machine))


def _paths(machine: Machine) -> Iterator[str]:
    for table in _TABLES:
        for name, part in getattr(machine, table).items():
            yield from _numbers(part, f"{table}.{name}")
    if machine.spool is not None:
        yield from _numbers(machine.spool, "spool")
    # Without ``load``, the load is the position of the sensor, so ``counts`` affects it.
    yield from (f"axes.{name}.counts" for name, axis in machine.axes.items() if axis.load is None)


def _numbers(part: Any, path: str) -> Iterator[str]:
    for field in fields(part):
        value = getattr(part, field.name)
        field_path = f"{path}.{field.name}"
        if isinstance(value, Quantity):
            yield field_path
        elif isinstance(value, dict):
            yield from (f"{field_path}.{k}" for k, v in value.items() if isinstance(v, Quantity))
        elif is_dataclass(value):
            yield from _numbers(value, field_path)
