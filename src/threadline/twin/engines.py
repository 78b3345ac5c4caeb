"""The engines of what was simulated last: a search simulates the same machine at every feed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.plant.values import Values
from threadline.twin.kernel import Engine

_MOST = 8
_MOST_VARIANTS = 64  # of one engine: three times the days of a repeated proof


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Made:
    values: Values
    start_si: FloatArray
    least_rates: tuple[float, ...]
    engine: Engine

    def serves(self, values: Values, start_si: FloatArray, rates: tuple[float, ...]) -> bool:
        own, other = self.values.replaced, values.replaced
        return (
            self.values.machine is values.machine
            and self.values.count == values.count
            and self.least_rates == rates
            and np.array_equal(self.start_si, start_si)
            and own.keys() == other.keys()
            and all(np.array_equal(own[path], other[path]) for path in own)
        )


_kept: tuple[_Made, ...] = ()


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
    global _kept  # noqa: PLW0603 - a memory of the process, replaced in one step
    for made in _kept:
        if made.serves(values, start_si, least_rates):
            return made.engine
    engine = Engine(values.machine, values, start_si, least_rates)
    if values.count <= _MOST_VARIANTS:
        made = _Made(values=values, start_si=start_si, least_rates=least_rates, engine=engine)
        _kept = (made, *_kept[: _MOST - 1])
    return engine
