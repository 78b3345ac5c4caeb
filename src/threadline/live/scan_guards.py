"""Guards of a run of switched cylinders: the first check of a report that fails is a fault."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

from threadline.arrays import FloatArray
from threadline.live.lateness import Lateness
from threadline.machine import Machine

_FREE = frozenset(("light-grid", "enable"))
"""Kinds of contacts that are on while the machine may move."""


class ScanGuards:
    """Checks the reports of one run.

    Parameters
    ----------
    machine
        Machine with the contacts, and the interlocks of its outputs.
    """

    def __init__(self, machine: Machine) -> None:
        self._lateness = Lateness()
        contacts = machine.contacts.items()
        self._grids = [name for name, contact in contacts if contact.kind in _FREE]
        self._needs = {name: output.needs for name, output in machine.outputs.items()}
        ends = [(name, one) for name, one in contacts if one.cylinder and one.beyond and one.at]
        self._both = [
            (str(one.cylinder), first, second)
            for (first, one), (second, other) in combinations(ends, 2)
            if one.cylinder == other.cylinder and one.beyond != other.beyond
        ]

    def trip(
        self,
        tick: int,  # noqa: ARG002
        samples: Mapping[str, FloatArray],
        late: bool,
        late_periods: float,
    ) -> str:
        """Return the text of the fault in a report; empty where there is none.

        Parameters
        ----------
        samples
            (n,) samples of each channel.
        late, late_periods
            Whether the report came late, and by how many of its periods.
        """
        if why := self._lateness.trip(late, late_periods):
            return why
        for grid in self._grids:
            if not samples[grid].all():
                return f"{grid} is off: a broken beam, or no enable"
        for cylinder, first, second in self._both:
            if (samples[first] * samples[second]).any():
                return f"{first} and {second} are on together: a contact of cylinder {cylinder}"
        for name, needed in self._needs.items():
            for contact in needed:
                if (samples[name] * (1.0 - samples[contact])).any():
                    return f"{name} is on, and {contact}, which it needs, is not"
        return ""
