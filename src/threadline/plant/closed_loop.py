"""What the load of an axis does for its references: the answer of the closed loop, tick by tick."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from threadline.arrays import FloatArray, Locked, read_only
from threadline.machine import Machine
from threadline.plant.loop import Loop, axis_loops
from threadline.plant.values import Values

_DECAY = 1e-5  # of the slowest pole: later nothing is left of a reference
_MOST_TICKS = 50_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer(Locked):
    """The answer of one load to references of one axis.

    Parameters
    ----------
    axis
        Its name.
    period_s
        From tick to tick of its controller.
    taps
        (n,) load per reference of the same unit, n ticks before; their sum is 1.
    """

    axis: str
    period_s: float
    taps: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "taps", read_only(self.taps, "taps", ndim=1))

    @property
    def memory_s(self) -> float:
        """After it nothing is left of a reference."""
        return len(self.taps) * self.period_s

    @cached_property
    def moments(self) -> tuple[float, float]:
        """First and half of the second moment of the taps, s and s^2.

        A slow motion r arrives as ``r - first r' + second r''``; ``first`` is the lag.
        """
        time_s = np.arange(len(self.taps)) * self.period_s
        return float(self.taps @ time_s), 0.5 * float(self.taps @ time_s**2)

    def load(self, reference: FloatArray) -> FloatArray:
        """Return the (k,) load at the ticks of (k,) references; before them it stood at the first.

        Parameters
        ----------
        reference
            m or rad, one at each tick of the controller.
        """
        from scipy.signal import oaconvolve

        start = reference[0]
        moved = oaconvolve(reference - start, self.taps)[: len(reference)]
        return np.asarray(start + moved)


def answers_of(machine: Machine, values: Values | None = None) -> dict[str, Answer]:
    """Return the answer of every axis of ``machine`` that has a loop.

    Where axes share bodies, each is answered with the others held at rest.

    Parameters
    ----------
    values
        Replaced numbers; the first variant is taken.
    """
    loops = axis_loops(machine, values)
    return {axis: _answer(loop) for axis, loop in loops.items()}


def _answer(loop: Loop) -> Answer:
    closed = loop.closed()
    slowest = min(max(closed.spectral_radius, 1e-3), 1.0 - 1e-9)
    ticks = min(int(np.ceil(np.log(_DECAY) / np.log(slowest))) + 20, _MOST_TICKS)
    reference = np.zeros((ticks, len(loop.filters)))
    reference[0, loop.index] = loop.counts_per_unit
    taps = closed.respond(reference)[:, closed.outputs.index(f"{loop.axis}.load")]
    # What was cut off is a rounding: the load comes to where it is told.
    return Answer(axis=loop.axis, period_s=closed.period_s, taps=taps / taps.sum())
