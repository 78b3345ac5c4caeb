"""Simulates commands on a machine, and keeps the engines of the machines simulated last."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from math import ceil

import numpy as np

from threadline.base.arrays import FloatArray, IntArray, Recent
from threadline.dynamics.values import Values
from threadline.errors import OptionError
from threadline.files import (
    ChannelKind,
    Event,
    Recording,
    RecordingBlock,
    RunEnd,
    Stream,
    TickBlock,
    TickTable,
)
from threadline.machine import Machine
from threadline.twin.channels import encoder_phases, run_phases, tick_channels
from threadline.twin.kernel import Engine
from threadline.twin.prescribed import Advance, PositionSession, advances_of, position_channels
from threadline.twin.row_session import Rows, RowSession
from threadline.twin.session import Session

_MOST_VARIANTS = 64  # engines with more are not kept; three times the days of a repeated proof


@dataclass(frozen=True, slots=True, eq=False)
class _EngineKey:
    values: Values
    start_si: FloatArray
    least_rates: tuple[float, ...]

    def made(self) -> Engine:
        return Engine(self.values.machine, self.values, self.start_si, self.least_rates)


def _same_key(one: _EngineKey, other: _EngineKey) -> bool:
    own, others = one.values.replaced, other.values.replaced
    return (
        one.values.machine is other.values.machine
        and one.values.count == other.values.count
        and one.least_rates == other.least_rates
        and np.array_equal(one.start_si, other.start_si)
        and own.keys() == others.keys()
        and all(np.array_equal(own[path], others[path]) for path in own)
    )


_RECENT: Recent[_EngineKey, Engine] = Recent(8, _same_key)


def engine_of(values: Values, start_si: FloatArray, least_rates: tuple[float, ...] = ()) -> Engine:
    """Return an engine; the same one again for the same machine, numbers and start.

    A search simulates the same machine at every feed. An engine has no state of a run: any number
    of runs may share it, also at the same time.

    Parameters
    ----------
    values, start_si, least_rates
        See ``Engine``.

    Raises
    ------
    MachineError
        If the clocks or parts of the machine cannot be simulated.
    """
    key = _EngineKey(values, start_si, least_rates)
    return key.made() if values.count > _MOST_VARIANTS else _RECENT.of(key, key.made)


DEFAULT_SETTLE_S = 0.5
_MOST_ROWS = 1 << 16
_MOST_SAMPLES = 1 << 14
"""Largest number in one block. Larger blocks exceed the processor's cache."""
_MOST_OF_RUNS = 1 << 18
"""Samples times runs in one block. Smaller blocks do not fit a core's cache either, and each block
costs calls."""
_LEAST_ROWS = 256


def simulate(
    commands: TickTable,
    machine: Machine,
    *,
    encoder_phase: FloatArray | None = None,
    record_every: int = 1,
    settle_s: float = DEFAULT_SETTLE_S,
    quantised: bool = True,
    answers: Iterable[float] | None = None,
) -> Recording:
    """Simulate ``machine`` under ``commands``; the simulation runs while the recording is read.

    The machine starts at rest at ``commands.start_counts``. Sample k is taken at tick ``k *
    record_every``, before the controllers act; the commanded position at that instant is the sum of
    the previous rows, and the controllers follow it from then on. After the last row the commanded
    position stands still for ``settle_s``.

    Channels, per axis: ``X.commanded``, ``X.measured``, ``X.load`` and, if the axis has a frame,
    ``X.frame`` in m or rad; ``X.voltage`` at the amplifier's input in V; ``X.current`` in A and
    ``X.current_peak``, the value of largest magnitude since the previous sample. Then ``operation``
    and one channel for each input, which is 1 once a limit switch has cut its drive.

    A machine whose drives take positions has other channels: see ``PositionSession``.

    Parameters
    ----------
    encoder_phase
        (axes,) position of each encoder between two counts at the start, in [0, 1); 0.5 when None.
        For a stepper: its position within a full step.
    record_every
        Number of ticks from sample to sample.
    settle_s
        Time to simulate after the last row.
    quantised
        False to omit the rounding of encoders and DACs (not their limits), for comparisons.
    answers
        Duration of each stop and wait of the job, in order, s; rounded up to ticks. The commanded
        position stands still for that time and the plant is simulated on; every stop, wait and
        resumption is an event of the recording. When the durations are used up, the recording ends
        as stopped at the next stop or wait, after ``settle_s``. None ends each at once: the machine
        rests there only as long as planned.

    Raises
    ------
    MachineError
        If the clocks or parts of the machine cannot be simulated.
    OptionError
        If the commands are not for this machine, or an option is out of range.
    """
    check_commands(commands, machine, record_every, settle_s)
    options = RunOptions(
        phases=encoder_phases(machine, encoder_phase)[None],
        record_every=record_every,
        settle_s=settle_s,
        quantised=quantised,
        answers=answers,
    )
    if machine.takes_positions:
        return _position_recording(commands, machine, options)
    return _recording(commands, Values.of(machine), options)


def simulate_runs(
    commands: TickTable,
    values: Values,
    *,
    encoder_phase: FloatArray | None = None,
    settle_s: float = DEFAULT_SETTLE_S,
    kinds: Collection[ChannelKind] = tuple(ChannelKind),
    least_rates: tuple[float, ...] = (),
) -> Recording:
    """Simulate runs of a machine side by side, each with different numbers, as one recording.

    Each run gives the same bits as ``simulate`` for a machine with those numbers; stops and waits
    end at once. Memory grows with the number of runs, not with the length of the commands.

    Parameters
    ----------
    values
        Numbers of the runs. All runs must have the same dead times; see ``Values.by_delay``.
    encoder_phase
        (runs, axes) for each run, or (axes,) for all; 0.5 when None.
    kinds
        Kinds of the channels to record.
    least_rates
        For each connected piece, a rate in 1/s: the time steps are at least as short as for that
        rate. With the maxima of ``fastest_rates`` over all runs, the result of a run is the same to
        the bit, whichever other runs are simulated beside it.

    Raises
    ------
    MachineError, OptionError
        As ``simulate``; while the recording is read, if a run has no solution.
    """
    machine = values.machine
    check_commands(commands, machine, 1, settle_s)
    options = RunOptions(
        phases=run_phases(machine, encoder_phase, values.count),
        record_every=1,
        settle_s=settle_s,
        quantised=True,
        answers=None,
        kinds=tuple(kinds),
    )
    return _recording(commands, values, options, least_rates)


def fastest_rates(commands: TickTable, values: Values) -> tuple[FloatArray, ...]:
    """Return, for each connected piece of a machine, the (runs,) fastest rate of each run, 1/s.

    The fastest of the runs simulated side by side sets the time steps of all.

    Raises
    ------
    MachineError
        If one of the runs cannot be simulated.
    """
    start = commands.start_counts / commands.counts_per_unit
    return Engine(values.machine, values, start).rates


def _recording(
    commands: TickTable, values: Values, options: RunOptions, least_rates: tuple[float, ...] = ()
) -> Recording:
    machine, start = values.machine, commands.start_counts / commands.counts_per_unit
    engine = engine_of(values, start, least_rates)
    return Recording(
        channels=tick_channels(machine, options.record_every, options.kinds),
        blocks=Stream(_blocks, engine, values, commands, options),
        job_sha256=commands.job_sha256,
        machine_sha256=machine.sha256,
        simulated=True,
        runs=values.count,
    )


def session_of(machine: Machine, start_counts: IntArray) -> RowSession:
    """Return a session for a machine with axes, with the defaults of ``simulate``."""
    if machine.takes_positions:
        return PositionSession(machine, start_counts=start_counts)
    return Session(machine, start_counts=start_counts)


def _position_recording(commands: TickTable, machine: Machine, options: RunOptions) -> Recording:
    return Recording(
        channels=position_channels(machine, options.record_every),
        blocks=Stream(_position_blocks, advances_of(machine), machine, commands, options),
        job_sha256=commands.job_sha256,
        machine_sha256=machine.sha256,
        simulated=True,
    )


def check_commands(
    commands: TickTable, machine: Machine, record_every: int, settle_s: float
) -> None:
    """Raise an error if the commands are not for this machine, or an option is out of range."""
    if commands.axes != machine.axis_names:
        raise OptionError(
            f"the commands are for axes {', '.join(commands.axes)}, "
            f"the machine {machine.name} has {', '.join(machine.axis_names) or 'none with a loop'}",
            remedy="Give one with the same axes.",
        )
    if commands.clock.period_s != machine.tick_clock.period_s:
        raise OptionError(
            f"the commands have a tick of {float(commands.clock.period_s)} s, "
            f"the machine one of {float(machine.tick_clock.period_s)} s"
        )
    if not np.allclose(commands.counts_per_unit, machine.counts_per_unit, rtol=1e-12, atol=0):
        raise OptionError("the commands have other counts per unit than the machine")
    if record_every < 1:
        raise OptionError(f"record_every must be at least 1, got {record_every}")
    if not 0 <= settle_s <= 3600:
        raise OptionError(f"settle_s must lie in 0 ... 3600 s, got {settle_s}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunOptions:
    """Options of a simulation; see ``simulate``."""

    phases: FloatArray
    record_every: int
    settle_s: float
    quantised: bool
    answers: Iterable[float] | None
    kinds: tuple[ChannelKind, ...] = tuple(ChannelKind)

    @property
    def most_rows(self) -> int:
        """Largest number of rows in one block."""
        of_runs = max(_MOST_OF_RUNS // len(self.phases), _LEAST_ROWS)
        return min(_MOST_ROWS, min(_MOST_SAMPLES, of_runs) * self.record_every)


def _blocks(
    engine: Engine, values: Values, commands: TickTable, options: RunOptions
) -> Iterator[RecordingBlock]:
    """Yield the blocks of a new session; each reading of the recording starts one."""
    machine = engine.machine
    session = Session(
        machine,
        start_counts=commands.start_counts,
        encoder_phase=options.phases,
        record_every=options.record_every,
        quantised=options.quantised,
        values=values,
        kinds=options.kinds,
        engine=engine,
    )
    yield from run_over(session, commands, options)


def _position_blocks(
    advances: tuple[Advance, ...], machine: Machine, commands: TickTable, options: RunOptions
) -> Iterator[RecordingBlock]:
    """Yield the blocks of a new session of a machine whose drives take positions."""
    session = PositionSession(
        machine,
        start_counts=commands.start_counts,
        phases=options.phases[0],
        record_every=options.record_every,
        advances=advances,
    )
    yield from run_over(session, commands, options)


def run_over(session: Rows, commands: TickTable, options: RunOptions) -> Iterator[RecordingBlock]:
    """Yield the blocks of a session until it has settled, or failed."""
    tick_s = float(commands.clock.period_s)
    owed: tuple[Event, ...] = ()
    # One tick more than the settling time, for a sample at its end.
    settling = _pause(session, ceil(options.settle_s / tick_s) + 1, options.most_rows)
    for block in chain(_parts(session, commands, options), settling):
        owed += block.events
        if len(block.samples["operation"]):
            yield replace(block, events=owed)
            owed = ()
        if session.failed:
            return


def _pause(session: Rows, ticks: int, most: int) -> Iterator[RecordingBlock]:
    """Simulate ``ticks`` without new rows, in blocks of at most ``most`` ticks."""
    for at in range(0, ticks, most):
        yield session.advance(ticks=min(most, ticks - at))


def _parts(session: Rows, commands: TickTable, options: RunOptions) -> Iterator[RecordingBlock]:
    """Yield the blocks of the commands, with the pauses at stops and waits."""
    answers = None if options.answers is None else iter(options.answers)
    for block in _pieces(commands, options.most_rows):
        parts = [session.advance(block)]
        while session.halted is not None:
            delay_s = 0.0 if answers is None else next(answers, None)
            if delay_s is None:
                yield _joined(parts)
                halted = f"{session.halted.kind} {session.halted.name}".strip()
                session.finish(RunEnd.STOPPED, f"nobody answered the {halted}")
                return
            if not delay_s >= 0.0:
                raise OptionError(f"answers must be delays of 0 s or more, got {delay_s}")
            ticks = ceil(delay_s / float(commands.clock.period_s))
            if ticks:
                yield _joined(parts)
                yield from _pause(session, ticks, options.most_rows)
                parts = []
            session.resume()
            parts.append(session.advance())
        yield _joined(parts)
    session.finish()


def _pieces(commands: TickTable, most: int) -> Iterator[TickBlock]:
    """Yield the commands in blocks of at most ``most`` rows."""
    for block in commands:
        if len(block) <= most:
            yield block
            continue
        for at in range(0, len(block), most):
            rows = slice(at, at + most)
            first, last = block.first_tick + at, rows.stop >= len(block)
            yield TickBlock(
                first_tick=first,
                counts=block.counts[rows],
                operation=block.operation[rows],
                events=tuple(
                    e for e in block.events
                    if (not at or e.tick >= first) and (last or e.tick < first + most)
                ),
            )  # fmt: skip


def _joined(parts: list[RecordingBlock]) -> RecordingBlock:
    """Return consecutive blocks joined into one."""
    if len(parts) == 1:
        return parts[0]
    return RecordingBlock(
        first_tick=parts[0].first_tick,
        samples={
            name: np.concatenate([part.samples[name] for part in parts])
            for name in parts[0].samples
        },
        events=tuple(event for part in parts for event in part.events),
    )
