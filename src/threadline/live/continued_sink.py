"""The recording of a continued run: its samples have the instants that they have in the whole job.

A judge sees from that what the recording does not hold: what comes before it was not measured.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from threadline.live.kept import Sink
from threadline.live.states import Cause, State
from threadline.machine import Machine
from threadline.signals import Channel, ChannelKind, Event, RecordingBlock

_OF_RUNS = frozenset(("hold", "resume", "late", "completed", "stopped", "fault", "plan"))
"""Kinds of events that a run tells of, and not the commands."""


class ContinuedSink:
    """Hands on samples and events from the operation on at which the work begins again.

    Parameters
    ----------
    sink
        Receives them.
    machine
        Whose ticks are counted.
    left_out
        Ticks of the whole commands that were left out.
    operation
        What belongs to operations before it was done dry, and is no work.
    """

    def __init__(self, sink: Sink, machine: Machine, left_out: int, operation: int) -> None:
        self._sink, self._operation = sink, operation
        self._left_out_s: Fraction = left_out * machine.command_clock.period_s
        self._channels: tuple[Channel, ...] = ()
        self._works = False

    def begin(self, channels: tuple[Channel, ...], simulated: bool) -> None:
        """Hand on the channels."""
        self._channels = channels
        self._sink.begin(channels, simulated)

    def state(self, tick: int, state: State, cause: Cause, text: str) -> None:
        """Hand on a change of state."""
        self._sink.state(tick, state, cause, text)

    def block(self, block: RecordingBlock) -> None:
        """Hand on a block, later by what was left out, without what is no work."""
        gone = 0 if self._works else self._dry(block)
        clock = self._channels[0]
        later = round(self._left_out_s / clock.clock.period_s)
        first = block.first_tick[clock.clock.name] + later + gone * clock.stride
        self._sink.block(
            replace(
                block,
                first_tick={clock.clock.name: first},
                samples={name: values[gone:] for name, values in block.samples.items()},
                events=tuple(
                    self._later(event, later)
                    for event in block.events
                    if self._works or event.kind in _OF_RUNS
                ),
            )
        )

    def _later(self, event: Event, ticks: int) -> Event:
        """Return an event with its tick and its time in the whole job."""
        by_s = float(self._left_out_s) if event.kind == "plan" else 0.0
        return replace(event, tick=event.tick + ticks, value=event.value + by_s)

    def _dry(self, block: RecordingBlock) -> int:
        """Return how many samples at the beginning of a block are of operations before the work."""
        told = next(c for c in self._channels if c.kind is ChannelKind.OPERATION)
        works = np.flatnonzero(block.samples[told.name] >= self._operation)
        self._works = len(works) > 0
        return int(works[0]) if self._works else len(block.samples[told.name])
