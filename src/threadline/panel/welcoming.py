"""What a client is told that has said who it is: the machine, its link, and what it takes."""

from __future__ import annotations

from threadline.kinds import kind_of
from threadline.live.executor import LEASE_S
from threadline.live.jogging import manual_feed
from threadline.live.link_operated import AtLink
from threadline.live.sim_process import SLOWER
from threadline.live.ways import way_of
from threadline.machine import Machine
from threadline.panel import protocol as say
from threadline.panel.control import CONTROL_LEASE_S
from threadline.panel.project_programs import untaught
from threadline.panel.wound_on import mandrel_of


def welcome_of(machine: Machine, client: int, link: str, far_end: AtLink) -> say.Welcome:
    """Return the welcome of the client of a number."""
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
        by_hand=way_of(machine).by_hand,
        options=list(kind_of(machine).planned_by),
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
        mandrel=mandrel_of(machine),
        jog_lease_s=LEASE_S,
        control_lease_s=CONTROL_LEASE_S,
    )
