"""The machine at the far end of a link: its greeting, requests to it, and its reports."""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Mapping
from fractions import Fraction
from math import ceil
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import CommandError, LinkFaultError
from threadline.files import Channel, ChannelKind, Clock, Event, RecordingBlock
from threadline.live.wire import PROTOCOL, Connection, Message, event_of
from threadline.machine import Machine


def greeting(machine: Machine, channels: tuple[Channel, ...]) -> dict[str, Any]:
    """Return the head of a simulated machine's greeting."""
    return {
        "protocol": PROTOCOL,
        "machine": machine.name,
        "machine_sha256": machine.sha256,
        "period": str(channels[0].clock.period_s),
        "clock": channels[0].clock.name,
        "simulated": True,
        "channels": [
            {"name": c.name, "kind": c.kind.value, "unit": c.unit, "axis": c.axis,
             "stride": c.stride}
            for c in channels
        ],
    }  # fmt: skip


def channels_of_greeting(greeting: Mapping[str, Any], machine: Machine) -> tuple[Channel, ...]:
    """Return the channels in a greeting.

    Raises
    ------
    CommandError
        If the greeting comes from another machine than ``machine``, or has another protocol.
    """
    if greeting["protocol"] != PROTOCOL:
        raise CommandError(
            f"the link speaks protocol {greeting['protocol']}, this program {PROTOCOL}",
            remedy="Use the same version at either end.",
        )
    if greeting["machine_sha256"] != machine.sha256:
        raise CommandError(
            f"the link leads to {greeting['machine']} (sha256 "
            f"{greeting['machine_sha256'][:12]}), the plan is for {machine.name} "
            f"({machine.sha256[:12]})",
            remedy="Give the machine file of the machine at the link.",
        )
    clock = Clock(str(greeting["clock"]), Fraction(greeting["period"]))
    return tuple(
        Channel(
            name=c["name"], kind=ChannelKind(c["kind"]), unit=c["unit"], axis=c["axis"],
            stride=int(c["stride"]), clock=clock,
        )
        for c in greeting["channels"]
    )  # fmt: skip


def samples_per_tick(machine: Machine, channels: tuple[Channel, ...]) -> Fraction:
    """Return the number of samples of a recording per tick of the commands."""
    return machine.command_clock.period_s / channels[0].clock.period_s


_ANSWER_S = 60.0
_GREETING_S = 300.0  # a new computer may have to compile the machine first


class FarEnd:
    """Sends requests to the machine one by one, and turns its reports into recording blocks.

    Parameters
    ----------
    link
        The link to the machine, which has not sent its greeting yet.
    machine
        The machine that must be at the end of the link.

    Attributes
    ----------
    channels
        Channels that the machine reports; empty until it has greeted.
    """

    def __init__(self, link: Connection, machine: Machine) -> None:
        self._link, self._machine = link, machine
        self.channels: tuple[Channel, ...] = ()
        self._per_tick = Fraction(1)

    def greet(self) -> bool:
        """Receive the greeting of the machine; return whether it is simulated.

        Raises
        ------
        LinkFaultError
            If the machine does not answer.
        CommandError
            If it is another machine, or speaks another version of the protocol.
        """
        hello = self._expect("hello", _GREETING_S).head
        self.channels = channels_of_greeting(hello, self._machine)
        self._per_tick = samples_per_tick(self._machine, self.channels)
        return bool(hello["simulated"])

    def enable(self) -> None:
        """Switch the drives on; raise LinkFaultError if the machine refuses or is silent."""
        self._link.send(Message("enable"))
        self._expect("enabled")

    def disable(self) -> None:
        """Switch the drives off; there is no answer."""
        self._link.send(Message("disable"))

    def home(
        self, wakes: int, stopped: Callable[[], bool]
    ) -> tuple[IntArray, dict[str, float]] | None:
        """Home the machine; return its (axes,) position in counts, or None if it was stopped.

        Besides the position it returns the values that the machine reports with its answer, by
        channel name: a machine with cylinders reports its pistons, contacts and outputs.

        Parameters
        ----------
        wakes
            Descriptor that is readable when a stop may have been requested.
        stopped
            Processes commands; returns whether one was a stop.

        Raises
        ------
        LinkFaultError
            If the machine refuses, or does not answer.
        """
        self._link.send(Message("home"))
        stop_sent, until_s = False, time.monotonic() + _ANSWER_S
        while (left_s := until_s - time.monotonic()) > 0.0:
            if not self._link.waiting:
                select.select([wakes, self._link.fileno()], [], [], left_s)
            if not stop_sent and stopped():
                stop_sent = True
                self._link.send(Message("stop-home"))
            message = self._link.receive(0.0)
            if message is None and self._link.lost:
                break
            if message is None or _left_over(message):
                continue
            if stop_sent:  # homed or not: the result is no longer needed
                return None
            homed = self._as(message, "homed")
            reported = {name: float(a[-1]) for name, a in homed.arrays.items() if len(a)}
            return np.array(homed.head["position"], dtype=np.int64), reported
        raise _silent("homed")

    def leave(self) -> None:
        """Tell the machine that the executor leaves."""
        self._link.send(Message("leave"))

    def reported(self, report: Message, until: int | None) -> RecordingBlock:
        """Return a report's samples before the tick ``until`` of the commands, and its events."""
        first = int(report.head["sample"])
        sample_count = None if until is None else max(ceil(until * self._per_tick) - first, 0)
        samples = {name: np.asarray(a, np.float64) for name, a in report.arrays.items()}
        if sample_count is not None:
            samples = {name: values[:sample_count] for name, values in samples.items()}
        return self._block(first, samples, *(event_of(row) for row in report.head["events"]))

    def lost(self, tick: int, why: str) -> RecordingBlock:
        """Return a block with a fault event at a tick of the commands, without samples."""
        sample = ceil(tick * self._per_tick)
        no_samples = {channel.name: np.empty(0) for channel in self.channels}
        return self._block(
            sample, no_samples, Event(tick=sample, kind="fault", operation=-1, name=why)
        )

    def _block(self, first: int, samples: dict[str, FloatArray], *events: Event) -> RecordingBlock:
        clock = self.channels[0].clock.name
        return RecordingBlock(first_tick={clock: first}, samples=samples, events=events)

    def _expect(self, kind: str, within_s: float = _ANSWER_S) -> Message:
        message = self._link.receive(within_s)
        while message is not None and _left_over(message):
            message = self._link.receive(within_s)
        if message is None:
            raise _silent(kind)
        return self._as(message, kind)

    def _as(self, message: Message, kind: str) -> Message:
        """Return a message, which must be of the given kind."""
        if message.kind != kind:
            why = message.head.get("why", f"it answered {message.kind!r}")
            raise LinkFaultError(f"the machine refused: {why}")
        return message


def _silent(kind: str) -> LinkFaultError:
    return LinkFaultError(
        f"the machine did not answer with {kind!r}",
        remedy="Check that it is switched on and connected.",
    )


def _left_over(message: Message) -> bool:
    """Return whether a message is left over from the previous run."""
    return message.kind == "report" or message.head.get("what") == "refill"
