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
from threadline.targets.homing import Homing, home_stage
from threadline.targets.plc_net import NetPlace
from threadline.targets.plc_watch import Watch
from threadline.targets.schedule import Scheduled, ScheduledMove

HOMING = "homing"
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
    now_ms = air_ms(machine, scan_ms)
    places = [_place(after + 1, air, now_ms, None)]
    for axis in home_order(scheduled):
        stage = home_stage(machine, axis)
        on, late_ms = (*air, *stage.on), _scans_ms(stage.late_s, scan_ms)
        wait = (stage.switch, True)
        places.append(_place(after + len(places) + 1, on, now_ms + late_ms, wait))
        now_ms = _scans_ms(stage.pressed_s, scan_ms)
        places.append(_place(after + len(places) + 1, on, now_ms, None))
    return tuple(places)


def air_ms(machine: Machine, scan_ms: int) -> int:
    """Return how long the soft start takes to bring the air up, ms, whole scans."""
    return _scans_ms(max(output.ramp_s for output in machine.outputs.values()), scan_ms)


def home_watches(places: tuple[NetPlace, ...], machine: Machine) -> list[dict[str, Watch]]:
    """Return what the end switches must say in each place of the way home.

    Nothing is known of a cylinder before its own switch has come; from then on it stands at its
    start, also while others come back.
    """
    found: list[dict[str, Watch]] = []
    home: dict[str, Watch] = {}
    for place in places:
        found.append(dict(home))
        axis = machine.contacts[place.wait[0]].cylinder if place.wait is not None else None
        if axis is not None:
            home[axis] = Watch(axis=axis, begin_m=0.0, end_m=0.0)
    return found


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
    first, and what an interlock needs at home before what needs it.

    Raises
    ------
    PlanError
        If the list or an interlock lets a cylinder move only with another at its start, and the
        list brings it home before.
    """
    last = {move.axis: move.first_tick for move in scheduled.moves}
    order = scheduled.job.home
    if not order:
        wanted = sorted(scheduled.machine.cylinders, key=lambda axis: last.get(axis, -1))
        return tuple(_behind_needed(wanted, scheduled.machine))
    for axis, other in _needed(scheduled):
        if order.index(axis) < order.index(other):
            raise PlanError(
                f"home = {', '.join(order)} brings {axis} back before {other}, and the list moves "
                f"{axis} only with {other} at its start",
                place=Place(scheduled.job.file),
                remedy=f"Write {other} before {axis}.",
            )
    for axis, other, name in _locked(scheduled.machine):
        if order.index(axis) < order.index(other):
            raise PlanError(
                f"home = {', '.join(order)} brings {axis} back before {other}, and {axis} moves "
                f"only with {name} on",
                place=Place(scheduled.job.file),
                remedy=f"Write {other} before {axis}.",
            )
    return order


def _locked(machine: Machine) -> Iterator[tuple[str, str, str]]:
    """Yield (cylinder, other, switch) where an interlock has the first wait for the second."""
    for axis, cylinder in machine.cylinders.items():
        for name in cylinder.needs:
            contact = machine.contacts[name]
            if contact.cylinder is not None and contact.beyond == "below":
                yield axis, contact.cylinder, name


def _behind_needed(wanted: list[str], machine: Machine) -> Iterator[str]:
    """Yield cylinders in their order, but each behind those that its interlock needs at home."""
    left = list(wanted)
    while left:
        waits = {axis for axis, other, _ in _locked(machine) if other in left and other != axis}
        # Where each waits for another, none could come first: the order stays.
        first = next((axis for axis in left if axis not in waits), left[0])
        left.remove(first)
        yield first


def _needed(scheduled: Scheduled) -> Iterator[tuple[str, str]]:
    """Yield (cylinder, other) where the list moves the first only with the second at its start."""
    at = dict(zip(scheduled.job.axes, scheduled.job.start, strict=True))
    start, moving = dict(at), {move.axis for move in scheduled.moves}
    away: set[tuple[str, str]] = set()
    both: list[ScheduledMove | Homing] = [*scheduled.moves, *scheduled.homings]
    for move in sorted(both, key=lambda one: one.first_tick):
        away |= {(move.axis, o) for o in moving - {move.axis} if abs(at[o] - start[o]) > _SAME_M}
        at[move.axis] = 0.0 if isinstance(move, Homing) else move.end_m
    for axis in sorted(moving):
        for other in sorted(moving - {axis}):
            # Each only with the other at home: their order is the user's.
            if (axis, other) not in away and (other, axis) in away:
                yield axis, other
