"""The greeting of a machine: its name and hash, its clock, and its channels."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from threadline.errors import CommandError
from threadline.live.wire import PROTOCOL
from threadline.machine import Machine
from threadline.signals import Channel, ChannelKind, Clock


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


def channels_told(told: Mapping[str, Any], machine: Machine) -> tuple[Channel, ...]:
    """Return the channels in a greeting.

    Raises
    ------
    CommandError
        If the greeting is that of another machine than ``machine``, or of another protocol.
    """
    if told["protocol"] != PROTOCOL:
        raise CommandError(
            f"the link speaks protocol {told['protocol']}, this program {PROTOCOL}",
            remedy="Use the same version at either end.",
        )
    if told["machine_sha256"] != machine.sha256:
        raise CommandError(
            f"the link leads to {told['machine']} (sha256 {told['machine_sha256'][:12]}), the "
            f"plan is for {machine.name} ({machine.sha256[:12]})",
            remedy="Give the machine file of the machine that is there.",
        )
    clock = Clock(str(told["clock"]), Fraction(told["period"]))
    return tuple(
        Channel(
            name=c["name"], kind=ChannelKind(c["kind"]), unit=c["unit"], axis=c["axis"],
            stride=int(c["stride"]), clock=clock,
        )
        for c in told["channels"]
    )  # fmt: skip


def samples_per_tick(machine: Machine, channels: tuple[Channel, ...]) -> Fraction:
    """Return how many samples of a recording come in a tick of the commands."""
    return machine.command_clock.period_s / channels[0].clock.period_s
