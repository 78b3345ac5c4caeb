"""The machine at the other end of a link: what it is asked before a run, and what it reports."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import LinkFaultError
from threadline.live.greeting import channels_told
from threadline.live.wire import Connection, Message, event_of
from threadline.machine import Machine
from threadline.signals import Channel, Event, RecordingBlock

_ANSWER_S = 60.0  # a machine may have to be built first


class FarEnd:
    """Asks the machine for one thing after another, and makes blocks of what it reports.

    Parameters
    ----------
    link
        The link to the machine, which has not greeted yet.
    machine
        The machine that the link must lead to.

    Attributes
    ----------
    channels
        What it reports, once it has greeted.
    """

    def __init__(self, link: Connection, machine: Machine) -> None:
        self._link, self._machine = link, machine
        self.channels: tuple[Channel, ...] = ()

    def greet(self) -> bool:
        """Hear who is there; return whether it is simulated.

        Raises
        ------
        LinkFaultError
            If nobody answers.
        CommandError
            If it is another machine, or speaks another protocol.
        """
        hello = self._expect("hello").head
        self.channels = channels_told(hello, self._machine)
        return bool(hello["simulated"])

    def enable(self) -> None:
        """Switch the drives on; a LinkFaultError if the machine refuses or is silent."""
        self._link.send(Message("enable"))
        self._expect("enabled")

    def disable(self) -> None:
        """Switch the drives off; nothing is answered."""
        self._link.send(Message("disable"))

    def home(self) -> IntArray:
        """Let the machine find where it is, and return that, in counts."""
        self._link.send(Message("home"))
        return np.array(self._expect("homed").head["position"], dtype=np.int64)

    def leave(self) -> None:
        """Say that nobody will send anything any more."""
        self._link.send(Message("leave"))

    def reported(self, report: Message, until: int | None) -> RecordingBlock:
        """Return samples and events of a report; no samples from the tick ``until`` on."""
        first = int(report.head["tick"])
        last = None if until is None else max(until - first, 0)
        samples = {
            name: np.asarray(values[:last], dtype=np.float64)
            for name, values in report.arrays.items()
        }
        return self._block(first, samples, *(event_of(told) for told in report.head["events"]))

    def silent(self, tick: int, event: Event) -> RecordingBlock:
        """Return an event at a tick of which nothing was reported."""
        return self._block(tick, {channel.name: np.empty(0) for channel in self.channels}, event)

    def _block(self, first: int, samples: dict[str, FloatArray], *events: Event) -> RecordingBlock:
        clock = self.channels[0].clock.name
        return RecordingBlock(first_tick={clock: first}, samples=samples, events=events)

    def _expect(self, kind: str) -> Message:
        message = self._link.receive(_ANSWER_S)
        while message is not None and message.kind == "report":  # of the run before
            message = self._link.receive(_ANSWER_S)
        if message is None:
            raise LinkFaultError(
                f"the machine did not answer: {kind!r} was due",
                remedy="Look whether it is switched on and connected.",
            )
        if message.kind != kind:
            why = message.head.get("why", f"it answered {message.kind!r}")
            raise LinkFaultError(f"the machine refused: {why}")
        return message
