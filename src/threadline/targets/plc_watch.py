"""What the end switches of every cylinder must say in each place of a sequence.

A cylinder stands at a place that its moves name, or goes from one to another. Standing, every one
of its switches is known. Going, none of the far end may come before the piston can be there, and
those of the near end must be gone once it has had ample time to leave.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from threadline.machine import Machine
from threadline.machine.pneumatics import Contact
from threadline.targets.plc_net import NetPlace, PetriNet
from threadline.targets.schedule import Scheduled, ScheduledMove

_EARLIEST = 0.5  # of the time that the commanded speed alone needs
_AMPLE = 2.0  # times the time that leaving takes with dead time and lags
_SAME_M = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Watch:
    """One cylinder in one place: from where to where; both the same where it stands.

    Parameters
    ----------
    axis, begin_m, end_m
        The cylinder and its way.
    early_ms
        Since the origin of the place: before it no switch of the far end is believed.
    gone_ms
        Since the origin: after it no switch of the near end may be on.
    arrived
        Whether a switch of the far end was waited for on this way: what follows may rely on it,
        though the piston still goes the last bit.
    """

    axis: str
    begin_m: float
    end_m: float
    early_ms: int = 0
    gone_ms: int = 0
    arrived: bool = False

    @property
    def stands(self) -> bool:
        """Whether the cylinder stands."""
        return abs(self.end_m - self.begin_m) <= _SAME_M


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedPlace:
    """A place with what the program calls it.

    Parameters
    ----------
    place
        Of the net.
    name, due
        Constants: its number, and the time at which it is left or its input is late.
    note
        What happens until its time has come, for people.
    watch
        What the end switches of each cylinder must say, as far as that is known.
    bounds
        Of each cylinder on its way two constants: before the first its far end is not believed,
        after the second its near end must be off.
    """

    place: NetPlace
    name: str
    due: str
    note: str
    watch: Mapping[str, Watch]
    bounds: Mapping[str, tuple[str, str]]


def switches_of(machine: Machine, axis: str) -> dict[str, Contact]:
    """Return the end switches of a cylinder."""
    return {n: c for n, c in machine.contacts.items() if c.cylinder == axis and c.at is not None}


def reads(contact: Contact, place_m: float) -> bool | None:
    """Return what an end switch says of a piston at ``place_m``; None within its tolerance."""
    assert contact.at is not None
    if abs(place_m - contact.at.si) <= contact.at.tolerance_si:
        return None
    return (place_m < contact.at.si) == (contact.beyond == "below")


def watches(scheduled: Scheduled, net: PetriNet) -> list[dict[str, Watch]]:
    """Return for every place of the net the watch of each cylinder that has end switches."""
    machine = scheduled.machine
    ways = {axis: _moves_since(scheduled, axis, -1) for axis in scheduled.axes}
    found: list[dict[str, Watch]] = []
    for number, place in enumerate(net.places):
        before = found[-1] if found else {}
        if scheduled.homings:
            ways = {a: _moves_since(scheduled, a, place.begin_tick) for a in scheduled.axes}
        now = {
            axis: _watch(machine, place, before.get(axis), axis, moves, net.scan_ms)
            for axis, moves in ways.items()
            if switches_of(machine, axis) and not _anywhere(scheduled, axis, place.begin_tick)
        }
        for axis, watch in now.items():
            last = before.get(axis)
            same = last is not None and (last.begin_m, last.end_m) == (watch.begin_m, watch.end_m)
            if same and not watch.stands and last is not None:
                came = last.arrived or _came(machine, net.places[number - 1], axis, watch.end_m)
                now[axis] = replace(watch, arrived=came)
        found.append(now)
    return found


def _came(machine: Machine, place: NetPlace, axis: str, end_m: float) -> bool:
    """Say whether a place waited for a switch of a cylinder that is on where its way ends."""
    if place.wait is None or not place.wait[1]:
        return False
    contact = machine.contacts[place.wait[0]]
    return contact.cylinder == axis and contact.at is not None and bool(reads(contact, end_m))


def _anywhere(scheduled: Scheduled, axis: str, tick: int) -> bool:
    """Say whether a cylinder may be anywhere at a scan: an operation brings it home, or will."""
    return any(
        one.axis == axis
        and tick < one.last_tick
        and (
            tick >= one.first_tick
            or not any(m.axis == axis and m.first_tick < one.first_tick for m in scheduled.moves)
        )
        for one in scheduled.homings
    )


def _moves_since(scheduled: Scheduled, axis: str, tick: int) -> list[ScheduledMove]:
    """Return the moves of a cylinder since an operation last brought it home."""
    homed = [h.last_tick for h in scheduled.homings if h.axis == axis and h.last_tick <= tick]
    since = max(homed, default=0)
    return [m for m in scheduled.moves if m.axis == axis and m.first_tick >= since]


def _watch(
    machine: Machine,
    place: NetPlace,
    before: Watch | None,
    axis: str,
    ways: list[ScheduledMove],
    scan_ms: int,
) -> Watch:
    begun = [way for way in ways if way.first_tick <= place.begin_tick]
    if not begun:
        start_m = ways[0].begin_m if ways else 0.0
        return Watch(axis=axis, begin_m=start_m, end_m=start_m)
    way, cylinder = begun[-1], machine.cylinders[axis]
    calm_ms = 1000.0 * cylinder.rest_s(way.forward)
    opens_ms = 1000.0 * cylinder.way(way.forward).opens_s
    rest_tick = way.last_tick + math.ceil(calm_ms / scan_ms - 1e-9)
    awaited = place.wait is not None and machine.contacts[place.wait[0]].cylinder == axis
    going = place.begin_tick < rest_tick or (
        awaited and before is not None and not before.stands and before.end_m == way.end_m
    )
    if not going:
        return Watch(axis=axis, begin_m=way.end_m, end_m=way.end_m)
    since_ms = (way.first_tick - place.origin_tick) * scan_ms
    early, gone = math.inf, 0.0
    for contact in switches_of(machine, axis).values():
        assert contact.at is not None
        first, last = reads(contact, way.begin_m), reads(contact, way.end_m)
        away_m = abs(contact.at.si - way.begin_m)
        if last and not first:
            reached = _commanded_ms(way, away_m - contact.at.tolerance_si, scan_ms)
            early = min(early, _EARLIEST * (1000.0 * cylinder.delay.si + opens_ms + reached))
        elif first and not last:
            reached = _commanded_ms(way, away_m + contact.at.tolerance_si, scan_ms)
            gone = max(gone, _AMPLE * (calm_ms + opens_ms + reached))
    return Watch(
        axis=axis,
        begin_m=way.begin_m,
        end_m=way.end_m,
        early_ms=max(0, since_ms + math.floor(early)) if math.isfinite(early) else 0,
        gone_ms=max(0, since_ms + math.ceil(gone)),
    )


def _commanded_ms(move: ScheduledMove, distance_m: float, scan_ms: int) -> float:
    """Return when the commanded speed alone has covered a distance, ms after it set in."""
    levels = move.levels
    edges = np.array(levels.ticks, dtype=np.float64) * scan_ms
    covered = np.concatenate(([0.0], np.cumsum(np.diff(edges) * np.array(levels.levels[:-1])))) * (
        levels.speed_m_s / 1000.0
    )
    return float(np.interp(max(distance_m, 0.0), covered, edges))
