"""The impulse response of a closed loop, from the references of an axis to its load."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from threadline.arrays import FloatArray, Locked, read_only
from threadline.machine import Machine
from threadline.plant.loop import Loop, axis_loops
from threadline.plant.values import Values
from threadline.recent import Recent

_DECAY = 1e-5  # share of the slowest pole's motion at which the response is cut off
_MOST_TICKS = 50_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer(Locked):
    """The response of the load of one axis to its references, as a finite impulse response.

    Parameters
    ----------
    axis
        Name of the axis.
    period_s
        Tick of its controller.
    taps
        (n,) response of the load, 0 to n - 1 ticks after a unit impulse of the reference; their sum
        is 1.
    """

    axis: str
    period_s: float
    taps: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "taps", read_only(self.taps, "taps", ndim=1))

    @property
    def memory_s(self) -> float:
        """Time for which a reference acts on the load."""
        return len(self.taps) * self.period_s

    @cached_property
    def moments(self) -> tuple[float, float]:
        """First and half of the second moment of the taps, s and s^2.

        A load whose reference r changes slowly is at ``r - first r' + second r''``; ``first`` is
        the lag.
        """
        time_s = np.arange(len(self.taps)) * self.period_s
        return float(self.taps @ time_s), 0.5 * float(self.taps @ time_s**2)

    def load(self, reference: FloatArray) -> FloatArray:
        """Return the (k,) positions of the load at the ticks of (k,) references.

        Parameters
        ----------
        reference
            (k,) m or rad, one at each tick of the controller; before them the load rests at the
            first.
        """
        start = reference[0]
        return np.asarray(start + _filtered(reference - start, self.taps))


def _filtered(values: FloatArray, taps: FloatArray) -> FloatArray:
    """Return (k,) values behind a filter of (n,) taps, by overlapped parts and their transforms.

    scipy.signal has the same (``oaconvolve``) and takes a second to import: a fifth of a short job.
    """
    size = 1 << (4 * len(taps) - 1).bit_length()
    step = size - len(taps) + 1
    parts = np.zeros((-(-len(values) // step), step))
    parts.ravel()[: len(values)] = values
    answers = np.fft.irfft(np.fft.rfft(parts, size) * np.fft.rfft(taps, size), size)
    found = np.ascontiguousarray(answers[:, :step])
    found[1:, : size - step] += answers[:-1, step:]  # what a part leaves to the next one
    return found.ravel()[: len(values)]


_RECENT: Recent[Machine, dict[str, Answer]] = Recent(8, lambda a, b: a is b or a == b)


def answers_of(machine: Machine, values: Values | None = None) -> dict[str, Answer]:
    """Return the response of every axis of ``machine`` that has a loop, by name.

    Where axes share bodies, the references of the other axes are 0.

    Parameters
    ----------
    values
        Replaced numbers, of which the first variant is used.
    """
    if values is not None:
        return _answers(machine, values)
    # Each start of a run and each plan of a search asks for those of the same machine.
    return dict(_RECENT.of(machine, lambda: _answers(machine, None)))


def _answers(machine: Machine, values: Values | None) -> dict[str, Answer]:
    return {axis: _answer(loop) for axis, loop in axis_loops(machine, values).items()}


def _answer(loop: Loop) -> Answer:
    closed = loop.closed()
    slowest = min(max(closed.spectral_radius, 1e-3), 1.0 - 1e-9)
    ticks = min(int(np.ceil(np.log(_DECAY) / np.log(slowest))) + 20, _MOST_TICKS)
    reference = np.zeros((ticks, len(loop.filters)))
    reference[0, loop.index] = loop.counts_per_unit
    taps = closed.respond(reference)[:, closed.outputs.index(f"{loop.axis}.load")]
    # The load comes to its reference: what was cut off is made up for by the scale.
    return Answer(axis=loop.axis, period_s=closed.period_s, taps=taps / taps.sum())
