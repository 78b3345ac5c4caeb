"""Simulates a switch schedule: the outputs of the PLC, and the motion of the cylinders."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.dynamics.values import Values
from threadline.errors import OptionError, RecordingError
from threadline.files import (
    Channel,
    ChannelKind,
    Clock,
    Event,
    Recording,
    RecordingBlock,
    Stream,
    SwitchSchedule,
)
from threadline.machine import Machine
from threadline.machine.pneumatics import TIMES
from threadline.twin.switching_cylinder import Cylinders, cylinders_of
from threadline.twin.switching_run import (
    CALMING,
    CREEP_NUMBERS,
    NEVER,
    PER_CYLINDER,
    PHASE,
    RUNNING,
    STALLED,
    UNBOUNDED,
    WAIT,
    Orders,
    Record,
    Units,
    begin,
    flows_of,
    run,
    units_of,
)

SAMPLE_S = Fraction(1, 1000)
_MAX_STALL_S = 60.0
_SAMPLES = 1 << 13
"""Samples in a block of a recording; more only if a single scan has more."""
_SCANS_DRAWN = 4093
"""Number of scans with drawn delays; then the delays repeat."""
_AT_ONCE = 128
"""Number of variants whose tables are in memory at the same time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SwitchOptions:
    """Options of a simulation.

    Parameters
    ----------
    after_s
        Time to simulate after the end of the schedule.
    break_s
        Instant at which a beam of the light grid is broken: the next scan switches everything off.
        None for never.
    inputs
        Values of the contacts that no cylinder closes, by name. A contact without a value is true,
        and a wait sets it to the expected value.
    scans
        Seed of the instants at which scans begin, within the jitter of the machine file. None:
        every scan begins on time.
    """

    after_s: float = 1.0
    break_s: float | None = None
    inputs: Mapping[str, bool] | None = None
    scans: int | None = None


def simulate_switching(
    commands: SwitchSchedule, machine: Machine, options: SwitchOptions | None = None
) -> Recording:
    """Simulate ``machine`` playing ``commands`` once; the simulation runs while it is read.

    Channels, every millisecond: per cylinder the stroke (``X.load``), the stroke commanded by the
    valves (``X.commanded``), the flow level (``X.level``) and the frame (``X.frame``); every output
    and contact; the operation. The events give the end of each wait.

    Raises
    ------
    MachineError
        If a cylinder has no equations, or a time is not a whole number of ticks.
    RecordingError
        If the schedule is not for this machine; while the recording is read, if an input does not
        come within a minute.
    """
    (recording,) = simulate_switchings(commands, machine, None, options)
    return recording


def simulate_switchings(
    commands: SwitchSchedule,
    machine: Machine,
    variants: Mapping[str, FloatArray] | None,
    options: SwitchOptions | None = None,
) -> Iterator[Recording]:
    """Yield the recording of each variant of ``machine`` under ``commands``, in order.

    The tables of many variants are made together. Each recording is simulated while it is read. It
    is the same as the recording of a machine with the numbers of the variant.

    Parameters
    ----------
    variants
        (V,) SI values for each replaced number of the machine file, by its path, such as
        ``"cylinders.X.delay"``.

    Raises
    ------
    OptionError
        If a path does not exist, or the numbers of values differ.
    MachineError, RecordingError
        As ``simulate_switching``.
    """
    if commands.machine_sha256 != machine.sha256:
        raise RecordingError(
            "the schedule was made for another machine file", remedy="Compile it again."
        )
    used = options or SwitchOptions()
    if used.after_s < 0.0:
        raise OptionError(f"after_s must not be negative, got {used.after_s!r}")
    values = Values.of(machine, variants)
    channels = tuple(switching_channels(commands.outputs, machine))
    for first in range(0, values.count, _AT_ONCE):
        part = values.slice(first, first + _AT_ONCE)
        cylinders = cylinders_of(machine, tuple(machine.cylinders), part, float(SAMPLE_S))
        for k in range(part.count):
            orders = orders_of(commands, machine, used, part.slice(k, k + 1))
            yield Recording(
                channels=channels,
                blocks=Stream(_read, commands, channels, orders, cylinders, k, used),
                simulated=True,
                machine_sha256=machine.sha256,
                job_sha256=commands.job_sha256,
            )


def switching_channels(outputs: Sequence[str], machine: Machine) -> Iterator[Channel]:
    """Yield the channels of a recording, in the order of its columns."""
    clock = Clock("twin", SAMPLE_S)
    for axis, cylinder in machine.cylinders.items():
        length = "m" if cylinder.kind == "linear" else "rad"
        for name, kind, unit in (
            ("load", ChannelKind.LOAD, length),
            ("commanded", ChannelKind.COMMANDED, length),
            ("level", ChannelKind.OUTPUT, ""),
            ("frame", ChannelKind.FRAME, "m"),
        ):
            yield Channel(name=f"{axis}.{name}", kind=kind, unit=unit, clock=clock, axis=axis)
    for contact in machine.contacts:
        yield Channel(name=contact, kind=ChannelKind.INPUT, unit="", clock=clock)
    for output in outputs:
        yield Channel(name=output, kind=ChannelKind.OUTPUT, unit="", clock=clock)
    yield Channel(name="operation", kind=ChannelKind.OPERATION, unit="", clock=clock)


def times_of(machine: Machine, period_s: Fraction, values: Values) -> Units:
    """Return the periods and times of one variant in whole units."""
    late = {
        path: float(values.replaced[path][0]) for path in values.replaced if path.endswith(TIMES)
    }
    return units_of(machine, period_s, SAMPLE_S, late)


def orders_of(
    commands: SwitchSchedule,
    machine: Machine,
    options: SwitchOptions,
    values: Values,
    units: Units | None = None,
) -> Orders:
    """Return schedule, contacts and times of one variant as arrays for the compiled code.

    ``units`` is the result of ``times_of``, if it is known already.
    """

    def number(path: str, own: float) -> float:
        return float(values.replaced[path][0]) if path in values.replaced else own

    axes = list(machine.cylinders)
    most = max(len(flows_of(cylinder)) for cylinder in machine.cylinders.values())
    waits = [event for event in commands.events if event.kind == "wait"]
    states = states_of(commands.levels, openings(waits, commands))
    flowing = np.zeros((len(states), len(axes), most))
    for column, (axis, cylinder) in enumerate(machine.cylinders.items()):
        for place, (valve, flow, sign) in enumerate(flows_of(cylinder)):
            sense = "forward" if sign > 0.0 else "back"
            own = cylinder.way(sign > 0.0).flows[flow].si
            size = sign * number(f"cylinders.{axis}.{sense}.flows.{flow}", own)
            columns = [commands.outputs.index(valve), commands.outputs.index(flow)]
            flowing[:, column, place] = size * states[:, columns].all(axis=1)
    creeps = {creep.tick: creep for creep in commands.creeps}
    longest = int(_MAX_STALL_S / float(commands.clock.period_s) + 1e-9)
    numbers = np.zeros((len(waits), CREEP_NUMBERS), dtype=np.int64)
    for index, wait in enumerate(waits):
        one = creeps.get(wait.tick)
        numbers[index] = (
            (0, 0, 0, 0, longest)
            if one is None
            else (one.first, one.every, one.opens, one.rest, one.most)
        )
    begin_creeps = len(commands.ticks) + 1
    names = list(machine.contacts)
    closes, at, above = [], [], []
    for name, contact in machine.contacts.items():
        inside = contact.cylinder is not None and contact.kind != "light-grid"
        grid = -2 if contact.kind == "light-grid" else -1
        closes.append(axes.index(str(contact.cylinder)) if inside else grid)
        at.append(0.0 if contact.at is None else number(f"contacts.{name}.at", contact.at.si))
        above.append(contact.beyond != "below")
    given = options.inputs or {}
    period_s = commands.clock.period_s
    units = units or times_of(machine, period_s, values)
    late = _late_scans(machine, options.scans, units.scan)

    def whole(numbers: list[int] | list[bool]) -> IntArray:
        return np.array(numbers, dtype=np.int64).reshape(len(numbers))

    return Orders(
        ticks=np.array(commands.ticks, dtype=np.int64),
        level=flowing[:begin_creeps].sum(axis=2),
        flowing=flowing[:begin_creeps],
        wait_tick=whole([event.tick for event in waits]),
        wait_contact=whole([names.index(event.name) for event in waits]),
        wait_value=whole([bool(event.value) for event in waits]),
        wait_given=whole([event.name in given for event in waits]),
        wait_creep=numbers,
        creep_level=flowing[begin_creeps:].sum(axis=2),
        creep_flowing=flowing[begin_creeps:],
        contact_cylinder=whole(closes),
        contact_at=np.array(at, dtype=np.float64),
        contact_above=whole(above),
        duration=commands.duration_ticks,
        after=max(1, round(options.after_s / float(period_s))),
        break_s=NEVER if options.break_s is None else options.break_s,
        period_s=float(period_s),
        step_s=float(SAMPLE_S),
        scan=units.scan,
        sample=units.sample,
        late=late,
        room=(units.scan + int(np.ptp(late))) // units.sample + 2,
        opened=units.opened,
        shut=units.shut,
        share=units.share,
    )


def _late_scans(machine: Machine, seed: int | None, scan: int) -> IntArray:
    """Return the delays of scans in units of the machine, drawn evenly within the jitter."""
    assert machine.plc is not None
    if seed is None or machine.plc.jitter is None:
        return np.zeros(1, dtype=np.int64)
    most = int(machine.plc.jitter.si * scan)
    return np.random.default_rng(seed).integers(-most, most + 1, _SCANS_DRAWN)


def _read(
    commands: SwitchSchedule,
    channels: tuple[Channel, ...],
    orders: Orders,
    cylinders: Cylinders,
    variant: int,
    options: SwitchOptions,
) -> Iterator[RecordingBlock]:
    """Yield the blocks of one run."""
    bank, motion, progress = cylinders.bank(variant), cylinders.at_rest(variant), begin(orders)
    waits = [event for event in commands.events if event.kind == "wait"]
    states = states_of(commands.levels, openings(waits, commands))
    contacts = [c.name for c in channels if c.kind is ChannelKind.INPUT]
    for name, value in (options.inputs or {}).items():
        if name in contacts:
            progress.free[contacts.index(name)] = value
    room = max(_SAMPLES, orders.room)
    columns = PER_CYLINDER * len(orders.share) + len(orders.contact_cylinder)
    out, rows = np.empty((room, columns)), np.empty((room, 2), dtype=np.int64)
    over = np.empty((len(waits), 2), dtype=np.int64)
    first = 0
    while progress.plc[PHASE] in {RUNNING, CALMING}:
        count, wait_count = run(orders, progress, bank, motion, Record(out, rows, over), UNBOUNDED)
        _refuse_stall(commands, progress.plc)
        yield run_block(
            channels,
            (out[:count], rows[:count], over[:wait_count]),
            (commands.outputs, states, commands.operation, waits),
            first,
        )
        first += count


def run_block(
    channels: Sequence[Channel],
    ran: tuple[FloatArray, IntArray, IntArray],
    logged: tuple[Sequence[str], IntArray, IntArray, Sequence[Event]],
    first: int,
) -> RecordingBlock:
    """Return a block with the results of ``run``.

    Parameters
    ----------
    ran
        The filled parts of its ``out``, ``rows`` and ``over``.
    logged
        Outputs, their (R + 1 + W, outputs) ``states_of``, (R,) operations, and the waits.
    first
        Index of the first sample.
    """
    (out, rows, over), (outputs, states, operations, waits) = ran, logged
    # Before the first row the operation is 0.
    operation = np.concatenate(([0], operations)).astype(np.float64)
    measured = dict(zip((c.name for c in channels), out.T.copy(), strict=False))
    on = states[rows[:, 0] + 1].T.astype(np.float64)
    return RecordingBlock(
        first_tick={channels[0].clock.name: first},
        samples={
            **measured,
            **dict(zip(outputs, on, strict=True)),
            "operation": operation[rows[:, 1] + 1],
        },
        events=tuple(
            Event(
                tick=int(tick),
                kind="wait",
                operation=waits[index].operation,
                name=waits[index].name,
                value=waits[index].value,
            )
            for index, tick in over
        ),
    )


def openings(waits: Sequence[Event], commands: SwitchSchedule) -> IntArray:
    """Return the (W, outputs) state of the outputs during an opening in each wait."""
    creeps = {creep.tick: creep.levels for creep in commands.creeps}
    none = (0,) * len(commands.outputs)
    levels = [creeps.get(wait.tick, none) for wait in waits]
    return np.array(levels, dtype=np.int64).reshape(len(levels), len(none))


def states_of(levels: IntArray, opened: IntArray) -> IntArray:
    """Return all states of the outputs: all off, states of the rows, states of ``openings``."""
    return np.vstack((np.zeros_like(levels, shape=(1, levels.shape[1])), levels, opened))


def stall_of(wait: Event, commands: SwitchSchedule) -> str:
    """Return the reason why a schedule ended at a wait."""
    creep = commands.creep_at(wait.tick)
    most_s = _MAX_STALL_S if creep is None else creep.most * float(commands.clock.period_s)
    return (
        f"the input {wait.name!r} did not become {'on' if wait.value else 'off'} within "
        f"{most_s:g} s"
    )


def _refuse_stall(commands: SwitchSchedule, plc: IntArray) -> None:
    if plc[PHASE] != STALLED:
        return
    wait = [event for event in commands.events if event.kind == "wait"][plc[WAIT]]
    raise RecordingError(
        stall_of(wait, commands),
        remedy="Let an end switch close before the very end of the stroke.",
    )


def ringing_m(
    recording: Recording, axis: str, from_s: float, pole: complex, periods: float = 2.0
) -> float:
    """Return the amplitude of the vibration of the frame of ``axis`` at ``from_s``, m.

    A decaying sine with the given pole, and a constant, are fitted over ``periods`` periods.

    Parameters
    ----------
    pole
        Pole of the vibrating mode with positive imaginary part, 1/s.
    """
    times, values = recording.samples(f"{axis}.frame")
    end = from_s + periods * 2.0 * np.pi / pole.imag
    chosen = (times >= from_s - 1e-9) & (times <= end)
    if np.count_nonzero(chosen) < 10 or times[-1] < end - 2e-3:
        raise RecordingError(
            f"the recording ends before {end:.3f} s; {periods:g} periods are needed",
            remedy="Simulate longer after the schedule.",
        )
    t = times[chosen] - from_s
    decay = np.exp(pole.real * t)
    columns: FloatArray = np.stack(
        [decay * np.cos(pole.imag * t), decay * np.sin(pole.imag * t), np.ones_like(t)], axis=1
    )
    found = np.linalg.lstsq(columns, values[chosen], rcond=None)[0]
    return float(np.hypot(found[0], found[1]))
