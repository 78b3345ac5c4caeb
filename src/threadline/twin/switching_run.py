"""Simulates the PLC of an on/off machine scan by scan, and the commands on their way to cylinders.

Time is counted in integers. Scan and sample are whole multiples of the unit of the machine. Each
cylinder has a finer unit: its dead time and the times of its valves are whole multiples, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import lcm
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.numbers import exact_time_s
from threadline.machine.pneumatics import Cylinder
from threadline.machine.quantity import Quantity
from threadline.twin.switching_cylinder import (
    SPEED,
    Bank,
    Motion,
    advance_share,
    exhaust,
    frame_of,
    stroke_of,
)

_MOST_UNIT = 1 << 50


@dataclass(frozen=True, slots=True)
class Units:
    """Periods, dead times and valve times of a machine as integers; see ``Orders``."""

    scan: int
    sample: int
    opened: IntArray
    shut: IntArray
    share: IntArray


def units_of(
    machine: Machine, scan_s: Fraction, sample_s: Fraction, times_s: Mapping[str, float]
) -> Units:
    """Return scan, sample, dead times and valve times as whole numbers of their units.

    Parameters
    ----------
    times_s
        Times of a variant that differ from the machine's, by their path in its file.

    Raises
    ------
    MachineError
        If a scan or one of the times has so many digits that no 64-bit count holds it.
    """
    whole = lcm(scan_s.denominator, sample_s.denominator)
    most = max(len(flows_of(cylinder)) for cylinder in machine.cylinders.values())
    opened, shut = np.zeros((2, len(machine.cylinders), most), dtype=np.int64)
    share = []

    def exact(path: str, own: Quantity | None) -> Fraction:
        if path in times_s:
            return exact_time_s(times_s[path])
        return Fraction(0) if own is None or own.exact_s is None else own.exact_s

    for row, (name, cylinder) in enumerate(machine.cylinders.items()):
        where = f"cylinders.{name}"
        delay = exact(f"{where}.delay", cylinder.delay)
        after = [
            (
                delay + exact(f"{where}.{sense}.opens", way.opens),
                delay + exact(f"{where}.{sense}.closes", way.closes),
            )
            for sense, way in (("forward", cylinder.forward), ("back", cylinder.back))
            for _ in way.flows
        ]
        times = [one for both in after for one in both]
        own = lcm(whole, *(one.denominator for one in times))
        if own * max(scan_s, sample_s, *times, Fraction(1)) > _MOST_UNIT:
            raise MachineError(
                f"cylinders.{name}: a dead time of {float(delay):.6g} s and a scan of "
                f"{float(scan_s):.6g} s have no common step above 1e-15 s",
                place=machine.place,
                remedy="Give them with fewer digits.",
            )
        for column, (late, early) in enumerate(after):
            opened[row, column], shut[row, column] = int(late * own), int(early * own)
        share.append(own // whole)
    return Units(
        int(scan_s * whole), int(sample_s * whole), opened, shut, np.array(share, dtype=np.int64)
    )


def flows_of(cylinder: Cylinder) -> list[tuple[str, str, float]]:
    """Return valve, flow control and direction of every flow of a cylinder, in order."""
    return [
        (way.valve, flow, sign)
        for way, sign in ((cylinder.forward, 1.0), (cylinder.back, -1.0))
        for flow in way.flows
    ]


RUNNING, CALMING, DONE, STALLED = 0, 1, 2, 3
TICK, SCAN, STALL, ROW, WAIT, PHASE, LEFT, SAMPLE, LATER = 0, 1, 2, 3, 4, 5, 6, 7, 8
OPENED, CREPT, PLC_STATE = 9, 10, 11
"""Whether an opening of a creep is on; scans of waiting before its latest opening, -1 for none."""
FIRST, EVERY, OPENS, REST, MOST, CREEP_NUMBERS = 0, 1, 2, 3, 4, 5
PER_CYLINDER = 4
"""Columns of a sample for each cylinder: stroke, stroke that the valves ask for, level, frame."""
UNBOUNDED = 1 << 62
"""A scan that no run reaches."""
_SHUT = 1e-12
"""A smaller flow level is a rounding error, and counts as 0."""
NEVER = 1e300


class Orders(NamedTuple):
    """Schedule, contacts and times of one variant: R rows, C cylinders, W waits, M contacts.

    Parameters
    ----------
    ticks, level
        (R,) scan at which each row begins; (R + 1, C) flow level of each cylinder, first with all
        outputs off, then in each row.
    flowing
        (R + 1, C, F) contribution of each flow control to the level, with the sign of its
        direction; 0 while it is closed, or its valve is.
    wait_tick, wait_contact, wait_value, wait_given
        (W,) scan, contact and expected value of each wait, and whether the caller has set the value
        of that contact.
    wait_creep
        (W, CREEP_NUMBERS) how a cylinder creeps in each wait, in scans; ``FIRST`` and the following
        constants are the columns. Without a creep ``OPENS`` is 0.
    creep_level, creep_flowing
        (W, C) and (W, C, F) as ``level`` and ``flowing``, during an opening.
    contact_cylinder, contact_at, contact_above
        (M,) cylinder that closes each contact, stroke at which the contact switches, m, and whether
        it is closed above or below that stroke. Cylinder -1: none; -2: the light grid.
    duration, after
        Length of the schedule, and simulated time after the end, in scans.
    break_s, period_s, step_s
        Instant at which the light grid is broken, period of a scan, and period of a sample, s.
    scan, sample
        Periods of scan and sample in units of the machine.
    late, room
        (J,) delay of each scan in those units, negative if it begins early, repeated; and the
        largest number of samples in a scan.
    opened, shut
        (C, F) time from a command to the change of the flow when a flow control or its valve opens,
        and when it closes, with the dead time of the cylinder; in units of the cylinder.
    share
        (C,) number of cylinder units in a unit of the machine.
    """

    ticks: IntArray
    level: FloatArray
    flowing: FloatArray
    wait_tick: IntArray
    wait_contact: IntArray
    wait_value: IntArray
    wait_given: IntArray
    wait_creep: IntArray
    creep_level: FloatArray
    creep_flowing: FloatArray
    contact_cylinder: IntArray
    contact_at: FloatArray
    contact_above: IntArray
    duration: int
    after: int
    break_s: float
    period_s: float
    step_s: float
    scan: int
    sample: int
    late: IntArray
    room: int
    opened: IntArray
    shut: IntArray
    share: IntArray


class Progress(NamedTuple):
    """State of the PLC.

    Parameters
    ----------
    plc
        (PLC_STATE,) integers; ``TICK``, ``SCAN`` and the following constants are the indices.
    free
        (M,) values of the contacts that no cylinder closes.
    followed_m
        (C,) stroke of each cylinder if it followed its valves without delay, m.
    arrival, coming
        (C, Q) instants and sizes of the level changes on their way to each cylinder, in the order
        of their instants.
    queue
        (C, 2) number of changes that were sent, and number that have arrived.
    commanded, last
        (C, F) last commanded contribution of each flow control to the level, and its arrival.
    """

    plc: IntArray
    free: IntArray
    followed_m: FloatArray
    arrival: IntArray
    coming: FloatArray
    queue: IntArray
    commanded: FloatArray
    last: IntArray


class Record(NamedTuple):
    """Output of ``run``.

    Parameters
    ----------
    out
        (samples, columns), with room for the samples of at least one scan.
    rows
        (samples, 2) current row of the schedule, and the latest row that was reached. -1 in the
        first column: all outputs are off; numbers after the last row: the opening of each wait. -1
        in the second column: before the first row.
    over
        (waits, 2) index of each wait that ended, and the sample at which it did.
    """

    out: FloatArray
    rows: IntArray
    over: IntArray


def begin(orders: Orders) -> Progress:
    """Return the progress at the start: nothing switched."""
    (count, most), rows = orders.opened.shape, len(orders.ticks)
    if orders.wait_creep[:, OPENS].any():
        # A scan sends at most one change, and each change is under way for a dead time.
        late = np.maximum(orders.opened, orders.shut).max(axis=1) // (orders.scan * orders.share)
        rows += int(late.max()) + 2
    plc = np.zeros(PLC_STATE, dtype=np.int64)
    plc[ROW] = plc[CREPT] = -1
    plc[LEFT] = orders.after
    return Progress(
        plc,
        np.ones(len(orders.contact_cylinder), dtype=np.int64),
        np.zeros(count),
        np.zeros((count, most * (rows + 3)), dtype=np.int64),
        np.zeros((count, most * (rows + 3))),
        np.zeros((count, 2), dtype=np.int64),
        np.zeros((count, most)),
        np.zeros((count, most), dtype=np.int64),
    )


def _contact(
    m: int, time_s: float, orders: Orders, progress: Progress, bank: Bank, motion: Motion
) -> bool:
    cylinder = orders.contact_cylinder[m]
    place = stroke_of(cylinder, bank, motion) if cylinder >= 0 else 0.0
    return closed(m, place, time_s, orders, progress.free)


def _closed(m: int, place: float, time_s: float, orders: Orders, free: IntArray) -> bool:
    """Return whether a contact is closed if its cylinder has the stroke ``place``."""
    cylinder = orders.contact_cylinder[m]
    if cylinder == -2:
        return bool(time_s < orders.break_s)
    if cylinder == -1:
        return bool(free[m] != 0)
    if orders.contact_above[m]:
        return bool(place >= orders.contact_at[m])
    return bool(place <= orders.contact_at[m])


def _switch(orders: Orders, progress: Progress, bank: Bank, motion: Motion) -> int:
    """Run the PLC at the start of a scan; return the index of the wait that ended, or -1."""
    plc = progress.plc
    if plc[PHASE] == CALMING:
        plc[ROW] = -1
        plc[OPENED] = 0
        return -1
    now_s = plc[SCAN] * orders.period_s
    for m in range(len(orders.contact_cylinder)):
        if orders.contact_cylinder[m] == -2 and not now_s < orders.break_s:
            plc[PHASE] = CALMING
            plc[ROW] = -1
            plc[OPENED] = 0
            return -1
    while plc[LATER] < len(orders.ticks) and orders.ticks[plc[LATER]] <= plc[TICK]:
        plc[ROW] = plc[LATER]
        plc[LATER] += 1
    w = plc[WAIT]
    held = w < len(orders.wait_tick) and orders.wait_tick[w] <= plc[TICK]
    over = -1
    if held:
        m = orders.wait_contact[w]
        if not orders.wait_given[w]:
            # A contact without a cylinder takes the expected value as soon as a wait needs it.
            progress.free[m] = orders.wait_value[w]
        there = contact(m, now_s, orders, progress, bank, motion) == (orders.wait_value[w] != 0)
        if creep(w, there, orders, plc):
            over = w
            plc[WAIT] += 1
            held = False
            plc[STALL] = 0
            plc[CREPT] = -1
        elif not there and plc[STALL] >= orders.wait_creep[w, MOST]:
            plc[PHASE] = STALLED
    if held:
        plc[STALL] += 1
    else:
        plc[TICK] += 1
    return over


def _creep(w: int, there: bool, orders: Orders, plc: IntArray) -> bool:
    """Open and shut the valves in a scan of wait ``w``; return whether the wait is over.

    ``there`` tells whether the input of the wait has the expected value.
    """
    own = orders.wait_creep[w]
    if own[OPENS] == 0:
        return there
    if plc[OPENED] and plc[STALL] < plc[CREPT] + own[OPENS]:
        return False  # an opening is finished, whatever the switch says
    plc[OPENED] = 0
    if there:
        return bool(plc[CREPT] < 0 or plc[STALL] >= plc[CREPT] + own[OPENS] + own[REST])
    next_one = own[FIRST] if plc[CREPT] < 0 else plc[CREPT] + own[EVERY]
    if next_one <= plc[STALL] < own[MOST]:
        plc[OPENED] = 1
        plc[CREPT] = plc[STALL]
    return False


def _move(
    c: int, begin: int, end: int, orders: Orders, progress: Progress, bank: Bank, motion: Motion
) -> None:
    """Advance cylinder ``c`` from instant ``begin`` to ``end``, both in its units."""
    whole = orders.sample * orders.share[c]
    now = begin
    queue = progress.queue[c]
    while queue[1] < queue[0] and progress.arrival[c, queue[1]] < end:
        at = progress.arrival[c, queue[1]]
        if at > now:
            advance_share(c, (at - now) / whole, orders.step_s, bank, motion)
            now = at
        level = motion.state[c, -2] + progress.coming[c, queue[1]]
        motion.state[c, -2] = level if abs(level) > _SHUT else 0.0
        queue[1] += 1
    advance_share(c, (end - now) / whole, orders.step_s, bank, motion)
    exhaust(c, bank, motion)


def _send(c: int, start: int, orders: Orders, progress: Progress) -> None:
    """Send the changes of a cylinder's flows in the current row, each with its delay.

    A flow control that is commanded to close before it has opened does not open.
    """
    row, creeps, wait = progress.plc[ROW] + 1, progress.plc[OPENED] != 0, progress.plc[WAIT]
    for f in range(orders.opened.shape[1]):
        flow = orders.creep_flowing[wait, c, f] if creeps else orders.flowing[row, c, f]
        commanded = progress.commanded[c, f]
        if flow == commanded:
            continue
        later = orders.opened[c, f] if abs(flow) > abs(commanded) else orders.shut[c, f]
        at = max(start * orders.share[c] + later, progress.last[c, f])
        progress.commanded[c, f], progress.last[c, f] = flow, at
        place, came = progress.queue[c, 0], progress.queue[c, 1]
        if place == progress.arrival.shape[1]:
            for k in range(place - came):
                progress.arrival[c, k] = progress.arrival[c, k + came]
                progress.coming[c, k] = progress.coming[c, k + came]
            place -= came
            progress.queue[c, 0], progress.queue[c, 1] = place, 0
        while place > progress.queue[c, 1] and progress.arrival[c, place - 1] > at:
            progress.arrival[c, place] = progress.arrival[c, place - 1]
            progress.coming[c, place] = progress.coming[c, place - 1]
            place -= 1
        progress.arrival[c, place], progress.coming[c, place] = at, flow - commanded
        progress.queue[c, 0] += 1


def _sample(
    at: int, time_s: float, record: Record, orders: Orders, progress: Progress, bank: Bank,
    motion: Motion,
) -> None:  # fmt: skip
    """Write row ``at`` of the record."""
    out, rows = record.out, record.rows
    count = len(orders.share)
    for c in range(count):
        out[at, PER_CYLINDER * c] = stroke_of(c, bank, motion)
        out[at, PER_CYLINDER * c + 1] = progress.followed_m[c]
        out[at, PER_CYLINDER * c + 2] = level_of(c, orders, progress.plc)
        out[at, PER_CYLINDER * c + 3] = frame_of(c, bank, motion)
    for m in range(len(orders.contact_cylinder)):
        place = out[at, PER_CYLINDER * max(orders.contact_cylinder[m], 0)]
        shut = closed(m, place, time_s, orders, progress.free)
        out[at, PER_CYLINDER * count + m] = 1.0 if shut else 0.0
    # While everything is off, the operation of the last row stays.
    rows[at, 0], rows[at, 1] = progress.plc[ROW], progress.plc[LATER] - 1
    if progress.plc[OPENED]:
        rows[at, 0] = len(orders.ticks) + progress.plc[WAIT]


def _level_of(c: int, orders: Orders, plc: IntArray) -> float:
    opened, row = plc[OPENED] != 0, plc[ROW] + 1
    level: float = orders.creep_level[plc[WAIT], c] if opened else orders.level[row, c]
    return level


def _run(
    orders: Orders, progress: Progress, bank: Bank, motion: Motion, record: Record, until: int
) -> tuple[int, int]:
    """Simulate scan by scan until the record may be full or the run ends; return two counts.

    The counts are the number of samples, and the number of waits that ended.

    Parameters
    ----------
    until
        Scan before which the function returns in any case.
    """
    plc, over = progress.plc, record.over
    most, period = orders.room, len(orders.late)
    filled, ended_waits = 0 * most, 0
    while plc[PHASE] <= CALMING and filled + most <= len(record.out) and plc[SCAN] < until:
        if plc[PHASE] == RUNNING and plc[TICK] >= orders.duration:
            plc[PHASE] = CALMING
        done = switch(orders, progress, bank, motion)
        if plc[PHASE] == STALLED:
            break
        even = plc[SCAN] * orders.scan
        # The first scan begins on time: nothing happens before it.
        start = even + (orders.late[plc[SCAN] % period] if plc[SCAN] else 0)
        if done >= 0:
            over[ended_waits, 0], over[ended_waits, 1] = done, start // orders.sample
            ended_waits += 1
        for c in range(len(orders.share)):
            send(c, start, orders, progress)
        now, stop = start, even + orders.scan + orders.late[(plc[SCAN] + 1) % period]
        while now < stop:
            if now == plc[SAMPLE] * orders.sample:
                time_s = plc[SCAN] * orders.period_s + (now - even) / orders.sample * orders.step_s
                sample(filled, time_s, record, orders, progress, bank, motion)
                filled += 1
                plc[SAMPLE] += 1
            then = min(stop, plc[SAMPLE] * orders.sample)
            step_s = (then - now) / orders.sample * orders.step_s
            for c in range(len(orders.share)):
                share = orders.share[c]
                level = level_of(c, orders, plc)
                progress.followed_m[c] += level * step_s * bank.numbers[c, SPEED]
                move(c, now * share, then * share, orders, progress, bank, motion)
            now = then
        plc[SCAN] += 1
        if plc[PHASE] == CALMING:
            plc[LEFT] -= 1
            if plc[LEFT] == 0:
                plc[PHASE] = DONE
    return filled, ended_waits


closed = njit(nogil=True)(_closed)
contact = njit(nogil=True)(_contact)
creep = njit(nogil=True)(_creep)
level_of = njit(nogil=True)(_level_of)
switch = njit(nogil=True)(_switch)
move = njit(nogil=True)(_move)
send = njit(nogil=True)(_send)
sample = njit(nogil=True)(_sample)
run = njit(nogil=True)(_run)
