"""The engines of what was simulated last: a search simulates the same machine at every feed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.plant.values import Values
from threadline.recent import Recent
from threadline.twin.kernel import Engine

_MOST_VARIANTS = 64  # of an engine that is kept: three times the days of a repeated proof


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    values: Values
    start_si: FloatArray
    least_rates: tuple[float, ...]

    def made(self) -> Engine:
        return Engine(self.values.machine, self.values, self.start_si, self.least_rates)


def _alike(one: _Asked, other: _Asked) -> bool:
    own, others = one.values.replaced, other.values.replaced
    return (
        one.values.machine is other.values.machine
        and one.values.count == other.values.count
        and one.least_rates == other.least_rates
        and np.array_equal(one.start_si, other.start_si)
        and own.keys() == others.keys()
        and all(np.array_equal(own[path], others[path]) for path in own)
    )


_RECENT: Recent[_Asked, Engine] = Recent(8, _alike)


def engine_of(values: Values, start_si: FloatArray, least_rates: tuple[float, ...] = ()) -> Engine:
    """Return an engine, the one that was made before for the same machine, numbers and start.

    Engines hold no state of a run: any number of runs, side by side too, may share one.

    Parameters
    ----------
    values, start_si, least_rates
        As ``Engine`` takes them.

    Raises
    ------
    MachineError
        If the machine's clocks or parts cannot be simulated.
    """
    asked = _Asked(values, start_si, least_rates)
    return asked.made() if values.count > _MOST_VARIANTS else _RECENT.of(asked, asked.made)
