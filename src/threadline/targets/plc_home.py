"""The way home: a sequence that brings every cylinder to its start from wherever it stands.

One cylinder after the other, in the order that the job's ``home`` says or in which its moves bring
them back, each with the smallest level that its flow controls make, until its own end switch says
that it is there. Then it is pressed home for as long as its whole stroke takes: a switch that is
stuck on, with the piston anywhere, sends no other cylinder on its way before this one is home.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from threadline.errors import Place, PlanError
from threadline.machine import Machine
from threadline.machine.pneumatics import Way
from threadline.targets.plc_net import NetPlace
from threadline.targets.plc_watch import switches_of
from threadline.targets.schedule import Scheduled

HOMING = "homing"
_AMPLE = 2.0
_SPARE_S = 1.0
_WHOLE = 1.2  # strokes
_SAME_M = 1e-6


def home_places(scheduled: Scheduled, after: int, scan_ms: int) -> tuple[NetPlace, ...]:
    """Return the places of the way home, numbered from ``after`` on.

    Raises
    ------
    PlanError
        If a cylinder has no end switch at its start, or starts elsewhere than at 0.
    """
    machine = scheduled.machine
    air = tuple(n for n, o in machine.outputs.items() if o.kind == "soft-start")
    ramps = [o.ramp.si for o in machine.outputs.values() if o.ramp is not None]
    now_ms = _scans_ms(max(ramps, default=0.0), scan_ms)
    places = [_place(after + 1, air, now_ms, None)]
    for axis in home_order(scheduled):
        cylinder = machine.cylinders[axis]
        name = home_switch(machine, axis)
        level, flows = slowest(cylinder.back)
        on = (*air, cylinder.back.valve, *flows)
        speed = level * cylinder.speed.si
        calm_s = cylinder.rest_s(forward=False)
        late_s = _AMPLE * (cylinder.stroke.si / speed + calm_s) + _SPARE_S
        places.append(
            _place(after + len(places) + 1, on, now_ms + round(1000 * late_s), (name, True))
        )
        pressed_s = _WHOLE * cylinder.stroke.si / speed + calm_s
        now_ms = _scans_ms(pressed_s, scan_ms)
        places.append(_place(after + len(places) + 1, on, now_ms, None))
    return tuple(places)


def _place(
    number: int, on: tuple[str, ...], due_ms: int, wait: tuple[str, bool] | None
) -> NetPlace:
    return NetPlace(number=number, step=HOMING, on=on, due_ms=due_ms, wait=wait)


def _scans_ms(time_s: float, scan_ms: int) -> int:
    return math.ceil(1000.0 * time_s / scan_ms - 1e-9) * scan_ms


def home_order(scheduled: Scheduled) -> tuple[str, ...]:
    """Return the cylinders in the order in which they come back.

    That of the list's ``home``; without it the order in which the list moves each for the last
    time: a list ends at its start, so that its last moves are the way back. What never moves comes
    first.

    Raises
    ------
    PlanError
        If the list lets a cylinder move only with another at its start, and brings it home before.
    """
    last = {move.axis: move.first_tick for move in scheduled.moves}
    order = scheduled.job.home
    if not order:
        return tuple(sorted(scheduled.machine.cylinders, key=lambda axis: last.get(axis, -1)))
    for axis, other in _needed(scheduled):
        if order.index(axis) < order.index(other):
            raise PlanError(
                f"home = {', '.join(order)} brings {axis} back before {other}, and the list moves "
                f"{axis} only with {other} at its start",
                place=Place(scheduled.job.file),
                remedy=f"Write {other} before {axis}.",
            )
    return order


def _needed(scheduled: Scheduled) -> Iterator[tuple[str, str]]:
    """Yield (cylinder, other) where the list moves the first only with the second at its start."""
    at = dict(zip(scheduled.job.axes, scheduled.job.start, strict=True))
    start, moving = dict(at), {move.axis for move in scheduled.moves}
    away: set[tuple[str, str]] = set()
    for move in scheduled.moves:
        away |= {(move.axis, o) for o in moving - {move.axis} if abs(at[o] - start[o]) > _SAME_M}
        at[move.axis] += (1.0 if move.forward else -1.0) * move.levels.wanted_m
    for axis in sorted(moving):
        for other in sorted(moving - {axis}):
            # Each only with the other at home: their order is the user's.
            if (axis, other) not in away and (other, axis) in away:
                yield axis, other


def home_switch(machine: Machine, axis: str) -> str:
    """Return the end switch that is on where a cylinder starts, the nearest to its start.

    Raises
    ------
    PlanError
        If there is none.
    """
    near = {
        n: c.at.si
        for n, c in switches_of(machine, axis).items()
        if c.beyond == "below" and c.at is not None
    }
    if not near:
        raise PlanError(
            f"no contact tells that {axis} is home, so that nothing could bring it there",
            remedy=f'Add a contact with cylinder = "{axis}", beyond = "below" to the machine file.',
        )
    return min(near, key=lambda name: near[name])


def slowest(way: Way) -> tuple[float, tuple[str, ...]]:
    """Return the smallest level above 0 of one sense, and the flow controls that make it."""
    sets = {flows: level for flows, level in way.levels().items() if level > 0.0}
    flows = min(sets, key=lambda chosen: sets[chosen])
    return sets[flows], flows
