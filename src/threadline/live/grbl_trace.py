"""Position reports of a controller as a recording, with samples at even times between them."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.live.grbl_words import Program
from threadline.live.kept import Sink
from threadline.machine import Machine
from threadline.signals import Channel, ChannelKind, Clock, Ended, Event, RecordingBlock

_CLOCK = Clock("reports", Fraction(1, 100))


class ReportTrace:
    """Puts the reports of a run into a sink.

    A report says where the controller has stepped to, which is what it has commanded: nothing is
    measured. Samples lie on the straight line from report to report.

    Parameters
    ----------
    machine
        Machine with the axes.
    sink
        Receiver of the blocks.

    Attributes
    ----------
    tick
        Number of the next sample.
    channels
        A commanded position for each axis, and the operation that was under way.
    """

    def __init__(self, machine: Machine, sink: Sink) -> None:
        self._sink = sink
        places = (
            Channel(
                name=f"{name}.commanded",
                kind=ChannelKind.COMMANDED,
                unit="m" if axis.kind == "linear" else "rad",
                clock=_CLOCK,
                axis=name,
            )
            for name, axis in machine.axes.items()
        )
        operation = Channel(name="operation", kind=ChannelKind.OPERATION, unit="", clock=_CLOCK)
        self.channels: tuple[Channel, ...] = (*places, operation)
        self.tick = 0
        self._sample_s, self._before = 0.0, np.zeros(len(machine.axes))

    def begin(self, at: FloatArray) -> None:
        """Begin at a place, and tell the sink the channels."""
        self.again(at)
        self._sink.begin(self.channels, False)

    def again(self, at: FloatArray) -> None:
        """Begin another run at a place, with the channels that the sink knows."""
        self.tick, self._sample_s, self._before = 0, 0.0, at

    def record(
        self, now_s: float, at: FloatArray, begins: FloatArray, operations: IntArray
    ) -> None:
        """Record the samples up to a report.

        Parameters
        ----------
        now_s, at
            Time of the run, and the place.
        begins, operations
            (n,) shares of the way since the report before at which another line began, and (n + 1,)
            the operations that were under way.
        """
        period_s = float(_CLOCK.period_s)
        times = period_s * np.arange(self.tick, int(now_s / period_s) + 1)
        known = [self._sample_s, max(now_s, self._sample_s + 1e-9)]
        samples = {
            channel.name: np.interp(times, known, [self._before[k], at[k]])
            for k, channel in enumerate(self.channels[:-1])
        }
        shares = np.interp(times, known, [0.0, 1.0])
        under_way = operations[np.searchsorted(begins, shares, side="right")]
        samples[self.channels[-1].name] = under_way.astype(np.float64)
        if len(times):
            self._put(samples)
        self.tick += len(times)
        self._sample_s, self._before = now_s, at

    def end(self, ended: Ended, text: str) -> None:
        """Record how the run ended."""
        event = Event(tick=self.tick, kind=ended.value, operation=-1, name=text)
        self._put({channel.name: np.empty(0) for channel in self.channels}, event)

    def _put(self, samples: dict[str, FloatArray], *events: Event) -> None:
        first = {_CLOCK.name: self.tick}
        self._sink.block(RecordingBlock(first_tick=first, samples=samples, events=events))


def way_passed(
    program: Program,
    machine: Machine,
    places: tuple[FloatArray, FloatArray],
    executed: tuple[int, int],
) -> tuple[FloatArray, IntArray]:
    """Return where on the way from a report to the next lines began, and what was under way.

    Parameters
    ----------
    program, machine
        What is run, on what.
    places, executed
        Of the two reports: the (axes,) place, and how many lines were executed.

    Returns
    -------
    tuple
        (n,) shares of that way at which another line began, and (n + 1,) operations.
    """
    was, now = executed
    ways = np.vstack([places[0], *program.ends[was:now], places[1]]) * machine.radius_m
    gone = np.cumsum(np.linalg.norm(np.diff(ways, axis=0), axis=1))
    lines = np.minimum(np.arange(was, now + 1), len(program.operations) - 1)
    return gone[:-1] / max(gone[-1], 1e-12), program.operations[lines]
