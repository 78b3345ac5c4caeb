"""Position reports of a controller as a recording, with samples at even times between them."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from threadline.arrays import FloatArray
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
        A commanded position for each axis.
    """

    def __init__(self, machine: Machine, sink: Sink) -> None:
        self._sink = sink
        self.channels = tuple(
            Channel(
                name=f"{name}.commanded",
                kind=ChannelKind.COMMANDED,
                unit="m" if axis.kind == "linear" else "rad",
                clock=_CLOCK,
                axis=name,
            )
            for name, axis in machine.axes.items()
        )
        self.tick = 0
        self._sample_s, self._before = 0.0, np.zeros(len(machine.axes))

    def begin(self, at: FloatArray) -> None:
        """Begin at a place, and tell the sink the channels."""
        self.again(at)
        self._sink.begin(self.channels, False)

    def again(self, at: FloatArray) -> None:
        """Begin another run at a place, with the channels that the sink knows."""
        self.tick, self._sample_s, self._before = 0, 0.0, at

    def record(self, now_s: float, at: FloatArray) -> None:
        """Record the samples up to a report at the time ``now_s`` of the run."""
        period_s = float(_CLOCK.period_s)
        times = period_s * np.arange(self.tick, int(now_s / period_s) + 1)
        known = [self._sample_s, max(now_s, self._sample_s + 1e-9)]
        samples = {
            channel.name: np.interp(times, known, [self._before[k], at[k]])
            for k, channel in enumerate(self.channels)
        }
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
