"""A switch schedule on its machine: what the PLC switches and what the cylinders make of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import OptionError, RecordingError
from threadline.machine import Machine
from threadline.machine.pneumatics import Cylinder
from threadline.signals import (
    Channel,
    ChannelKind,
    Clock,
    Event,
    Recording,
    RecordingBlock,
    Stream,
    SwitchSchedule,
)
from threadline.signals.clock import common_period_s
from threadline.twin.switching_cylinder import CylinderTwin

SAMPLE_S = Fraction(1, 1000)
_MAX_STALL_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SwitchOptions:
    """How a schedule is run.

    Parameters
    ----------
    after_s
        How long the simulation goes on behind the end of the schedule.
    break_s
        When a beam of the light grid is broken: the next scan switches everything off. None for
        never.
    inputs
        Contacts that no cylinder closes, and what they read; the others are true until they are
        waited for, and then what is waited for.
    """

    after_s: float = 1.0
    break_s: float | None = None
    inputs: Mapping[str, bool] | None = None


def simulate_switching(
    commands: SwitchSchedule, machine: Machine, options: SwitchOptions | None = None
) -> Recording:
    """Return what happens when ``machine`` plays ``commands`` once.

    Channels, every millisecond: per cylinder the stroke (``X.load``), what the valves ask for
    (``X.commanded``), the level (``X.level``) and the frame (``X.frame``); every output and
    contact; the operation. Events tell when each wait was over.

    Raises
    ------
    RecordingError
        If an input does not come within a minute, or the schedule is not for this machine.
    """
    if commands.machine_sha256 != machine.sha256:
        raise RecordingError(
            "the schedule was made for another machine file", remedy="Compile it again."
        )
    used = options or SwitchOptions()
    if used.after_s < 0.0:
        raise OptionError(f"after_s must not be negative, got {used.after_s!r}")
    run = _Run(commands, machine, used)
    block = run.block()
    return Recording(
        channels=run.channels,
        blocks=Stream(lambda: _once(block)),
        simulated=True,
        machine_sha256=machine.sha256,
        job_sha256=commands.job_sha256,
    )


def _once(block: RecordingBlock) -> Iterator[RecordingBlock]:
    yield block


def _level(cylinder: Cylinder, on: Mapping[str, int]) -> float:
    total = 0.0
    for way, sign in ((cylinder.forward, 1.0), (cylinder.back, -1.0)):
        if on[way.valve]:
            total += sign * sum(flow.si for name, flow in way.flows.items() if on[name])
    return total


class _Run:
    """One run; lives only as long as ``simulate_switching`` runs."""

    def __init__(self, commands: SwitchSchedule, machine: Machine, options: SwitchOptions) -> None:
        self.commands, self.machine, self.options = commands, machine, options
        delays = {n: c.delay.exact_s or Fraction(0) for n, c in machine.cylinders.items()}
        period = commands.clock.period_s
        step = common_period_s([period, SAMPLE_S, *(d for d in delays.values() if d)])
        self.step_s, self.per_scan = float(step), int(period / step)
        self.per_sample = int(SAMPLE_S / step)
        self.delay_steps = {n: int(d / step) for n, d in delays.items()}
        self.twins = {n: CylinderTwin(machine, n, float(step)) for n in machine.cylinders}
        self.clock = Clock("twin", SAMPLE_S)
        self.channels = tuple(self._channels())
        self.rows: list[list[float]] = []
        self.events: list[Event] = []
        self.on = dict.fromkeys(commands.outputs, 0)
        self.asked = dict.fromkeys(machine.cylinders, 0.0)
        self.operation = 0
        self.free = dict(options.inputs or {})
        self.levels: dict[str, list[float]] = {n: [] for n in machine.cylinders}

    def _channels(self) -> Iterator[Channel]:
        for axis in self.machine.cylinders:
            for name, kind, unit in (
                ("load", ChannelKind.LOAD, "m"),
                ("commanded", ChannelKind.COMMANDED, "m"),
                ("level", ChannelKind.OUTPUT, ""),
                ("frame", ChannelKind.FRAME, "m"),
            ):
                yield Channel(
                    name=f"{axis}.{name}", kind=kind, unit=unit, clock=self.clock, axis=axis
                )
        for output in self.commands.outputs:
            yield Channel(name=output, kind=ChannelKind.OUTPUT, unit="", clock=self.clock)
        for contact in self.machine.contacts:
            yield Channel(name=contact, kind=ChannelKind.INPUT, unit="", clock=self.clock)
        yield Channel(name="operation", kind=ChannelKind.OPERATION, unit="", clock=self.clock)

    def _contact(self, name: str, time_s: float) -> bool:
        contact = self.machine.contacts[name]
        if contact.kind == "light-grid":
            return self.options.break_s is None or time_s < self.options.break_s
        if contact.cylinder is None:
            return self.free.get(name, True)
        assert contact.at is not None
        place = self.twins[contact.cylinder].stroke_m
        return place <= contact.at.si if contact.beyond == "below" else place >= contact.at.si

    def block(self) -> RecordingBlock:
        commands, period_s = self.commands, float(self.commands.clock.period_s)
        waits = [e for e in commands.events if e.kind == "wait"]
        rows = list(zip(commands.ticks.tolist(), commands.levels, commands.operation, strict=True))
        tick = scan = stalled = 0
        while tick < commands.duration_ticks:
            now_s = scan * period_s
            if not all(
                self._contact(n, now_s)
                for n, c in self.machine.contacts.items()
                if c.kind == "light-grid"
            ):
                break
            while rows and rows[0][0] <= tick:
                _, values, operation = rows.pop(0)
                self.on = dict(zip(commands.outputs, values.tolist(), strict=True))
                self.operation = int(operation)
            held = bool(waits) and waits[0].tick <= tick
            if held and waits[0].name not in (self.options.inputs or {}):
                # What no cylinder closes comes, or goes, when it is waited for.
                self.free[waits[0].name] = bool(waits[0].value)
            if held and self._contact(waits[0].name, now_s) == bool(waits[0].value):
                done = waits.pop(0)
                self.events.append(
                    Event(
                        tick=int(scan * self.per_scan / self.per_sample),
                        kind="wait",
                        operation=done.operation,
                        name=done.name,
                        value=done.value,
                    )
                )
                held, stalled = False, 0
            if held:
                stalled += 1
                if stalled * period_s > _MAX_STALL_S:
                    raise RecordingError(
                        f"the input {waits[0].name!r} did not become "
                        f"{'on' if waits[0].value else 'off'} within {_MAX_STALL_S:g} s",
                        remedy="Let an end switch close before the very end of the stroke.",
                    )
            else:
                tick += 1
            self._scan(now_s)
            scan += 1
        self.on = dict.fromkeys(commands.outputs, 0)
        for extra in range(max(1, round(self.options.after_s / period_s))):
            self._scan((scan + extra) * period_s)
        columns = np.array(self.rows).T
        samples = {c.name: columns[i] for i, c in enumerate(self.channels)}
        return RecordingBlock(
            first_tick={self.clock.name: 0}, samples=samples, events=tuple(self.events)
        )

    def _scan(self, now_s: float) -> None:
        """Advance by one scan with the outputs as they are."""
        wanted = {n: _level(c, self.on) for n, c in self.machine.cylinders.items()}
        for k in range(self.per_scan):
            if (len(self.levels[next(iter(wanted))])) % self.per_sample == 0:
                self._sample(now_s + k * self.step_s, wanted)
            for name, twin in self.twins.items():
                history = self.levels[name]
                history.append(wanted[name])
                at = len(history) - 1 - self.delay_steps[name]
                self.asked[name] += wanted[name] * self.step_s * self._speed(name)
                twin.advance(history[at] if at >= 0 else 0.0)

    def _speed(self, name: str) -> float:
        return self.machine.cylinders[name].speed.si

    def _sample(self, time_s: float, wanted: Mapping[str, float]) -> None:
        row: list[float] = []
        for name, twin in self.twins.items():
            row += [twin.stroke_m, self.asked[name], wanted[name], twin.frame_m]
        row += [float(v) for v in self.on.values()]
        row += [float(self._contact(n, time_s)) for n in self.machine.contacts]
        row.append(float(self.operation))
        self.rows.append(row)


def ringing_m(
    recording: Recording, axis: str, from_s: float, pole: complex, periods: float = 2.0
) -> float:
    """Return the amplitude with which the frame of ``axis`` rings at ``from_s``, m.

    A decaying sine of the given pole and a constant are fitted to ``periods`` of it.

    Parameters
    ----------
    pole
        1/s, of the mode that rings, imaginary part positive.
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
