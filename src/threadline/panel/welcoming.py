"""The greeting of a client, and the axes, inputs and outputs in a machine's latest report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from threadline.base.arrays import IntArray
from threadline.files import Channel, ChannelKind
from threadline.live.executor import LEASE_S
from threadline.live.jogging import manual_feed
from threadline.live.kinds_run import run_kind_of
from threadline.live.links import AtLink
from threadline.live.sim_process import SLOWER
from threadline.machine import Machine
from threadline.panel import protocol as say
from threadline.panel.control import CONTROL_LEASE_S
from threadline.panel.message_parts import Cylinder, EndSwitch
from threadline.panel.programs import untaught
from threadline.panel.protocol import Mandrel
from threadline.proof.kinds import kind_of
from threadline.proof.option_form import Door, Group
from threadline.proof.option_table import options_for

_RAW = f".{ChannelKind.SENSOR.value}"
_STATES = (ChannelKind.INPUT, ChannelKind.OUTPUT)
_PLACES = (ChannelKind.COMMANDED, ChannelKind.MEASURED, ChannelKind.LOAD)
_LEVEL = tuple(one.name for one in options_for("panel", Door.PANEL, [Group.LEVEL]))


def positions(
    channels: Iterable[Channel],
    latest: Mapping[str, float],
    machine: Machine,
    position_counts: IntArray | None,
) -> dict[str, list[float | None]]:
    """Return commanded, measured and load position of all axes, SI; None if not known.

    No position is known for an axis that is not homed, although its encoder has a reading.

    Parameters
    ----------
    channels
        Channels that the machine reports.
    latest
        The last sample of each, by its name.
    machine, position_counts
        The machine, and its (axes,) commanded position in counts, for channels not reported yet;
        None if it is not homed.
    """
    by_axis: dict[str, list[float | None]] = {name: [None, None, None] for name in machine.axes}
    if position_counts is not None:
        for name, position in zip(
            machine.axes, (position_counts / machine.counts_per_unit).tolist(), strict=True
        ):
            by_axis[name][0] = position
    for channel in channels:
        if position_counts is None and channel.axis in machine.axes:
            continue
        if channel.kind in _PLACES and channel.axis:
            row = by_axis.setdefault(channel.axis, [None, None, None])
            column = _PLACES.index(channel.kind)
            row[column] = latest.get(channel.name, row[column])
    return by_axis


def signals(channels: Iterable[Channel], latest: Mapping[str, float]) -> dict[str, float]:
    """Return the state of every input and output that was reported."""
    return {
        channel.name: latest[channel.name]
        for channel in channels
        if channel.kind in _STATES and not channel.axis and channel.name in latest
    }


def readings(
    channels: Iterable[Channel], latest: Mapping[str, float]
) -> dict[str, tuple[float, str]]:
    """Return value and SI unit of each reported quantity that belongs to no axis.

    Readings of sensors (``x_pot.sensor``, in V) are for the controller, and are left out.
    """
    return {
        channel.name: (latest[channel.name], channel.unit)
        for channel in channels
        if channel.unit
        and not channel.axis
        and not channel.name.endswith(_RAW)
        and channel.name in latest
    }


def mandrel_of(machine: Machine) -> Mandrel | None:
    """Return the mandrel of a machine: its first rotary axis beside a linear one; None without.

    Without a profile in the machine file, its radius is the radius at which the rotary axis acts.
    """
    linear = [name for name, axis in machine.axes.items() if axis.kind == "linear"]
    for (name, axis), radius_m in zip(machine.axes.items(), machine.radius_m, strict=True):
        if axis.kind != "rotary" or not linear:
            continue
        if axis.profile is None:
            return Mandrel(axis=name, along=linear[0], at=[0.0], radius=[float(radius_m)])
        return Mandrel(
            axis=name,
            along=axis.profile.along,
            at=[place.si for place in axis.profile.at],
            radius=[radius.si for radius in axis.profile.radius],
        )
    return None


def welcome_of(machine: Machine, client: int, link: str, far_end: AtLink) -> say.Welcome:
    """Return the welcome message for the client with a number."""
    speeds = {}
    if machine.axes:
        tick_s = float(machine.tick_clock.period_s)
        feeds = manual_feed(machine) / machine.counts_per_unit / tick_s
        speeds = dict(zip(machine.axes, feeds.tolist(), strict=True))
    return say.Welcome(
        client=client,
        machine=machine.name,
        title=machine.title,
        link=link,
        simulated=link in ("sim", SLOWER),
        label=far_end.label,
        lacks=dict(far_end.lacks),
        notes=list(far_end.notes),
        untaught=untaught(machine),
        feed_override=not run_kind_of(machine).no_override,
        by_hand=run_kind_of(machine).by_hand,
        options=[*kind_of(machine).planned_by, *_LEVEL],
        normal_feed=machine.operator is not None,
        axes=[
            say.Axis(
                name=name,
                unit="m" if axis.kind == "linear" else "rad",
                low=None if axis.travel is None else axis.travel[0].si,
                high=None if axis.travel is None else axis.travel[1].si,
                manual_feed=speeds[name],
            )
            for name, axis in machine.axes.items()
        ],
        cylinders=cylinders_of(machine),
        inputs=list(machine.contacts),
        outputs=list(machine.outputs),
        mandrel=mandrel_of(machine),
        console=far_end.console,
        jog_lease_s=LEASE_S,
        control_lease_s=CONTROL_LEASE_S,
    )


def cylinders_of(machine: Machine) -> list[Cylinder]:
    """Return the cylinders of a machine with their outputs and their contacts."""
    return [
        Cylinder(
            name=name,
            unit="rad" if one.kind == "rotary" else "m",
            stroke=one.stroke.si,
            forward=[one.forward.valve, *one.forward.flows],
            back=[one.back.valve, *one.back.flows],
            contacts=[
                EndSwitch(name=contact, at=switch.at.si, beyond=switch.beyond)
                for contact, switch in machine.contacts.items()
                if switch.cylinder == name and switch.at is not None and switch.beyond is not None
            ],
        )
        for name, one in machine.cylinders.items()
    ]
