"""The engines of what was simulated last: a search simulates the same machine at every feed."""

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
    Ended,
    Event,
    Recording,
    RecordingBlock,
    Stream,
    TickBlock,
    TickTable,
)
from threadline.machine import Machine
from threadline.twin.channels import encoder_phases, run_phases, tick_channels
from threadline.twin.kernel import Engine
from threadline.twin.prescribed import Advance, ToldSession, advances_of, told_channels
from threadline.twin.row_session import Rows, RowSession
from threadline.twin.session import Session

_MOST_VARIANTS = 64  # of an engine that is kept: three times the days of a repeated proof


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    values: Values
    start_si: FloatArray
    least_rates: tuple[float, ...]

    def made(self) -> Engine:
        return Engine(self.values.machine, self.values, self.start_si, self.least_rates)


def _alike(one: _Asked, other: _Asked) -> bool:
    own, others = one.values.replaced, other.values.replaced
    return (
        one.values.machine is other.values.machine
        and one.values.count == other.values.count
        and one.least_rates == other.least_rates
        and np.array_equal(one.start_si, other.start_si)
        and own.keys() == others.keys()
        and all(np.array_equal(own[path], others[path]) for path in own)
    )


_RECENT: Recent[_Asked, Engine] = Recent(8, _alike)


def engine_of(values: Values, start_si: FloatArray, least_rates: tuple[float, ...] = ()) -> Engine:
    """Return an engine, the one that was made before for the same machine, numbers and start.

    Engines hold no state of a run: any number of runs, side by side too, may share one.

    Parameters
    ----------
    values, start_si, least_rates
        As ``Engine`` takes them.

    Raises
    ------
    MachineError
        If the machine's clocks or parts cannot be simulated.
    """
    asked = _Asked(values, start_si, least_rates)
    return asked.made() if values.count > _MOST_VARIANTS else _RECENT.of(asked, asked.made)


DEFAULT_SETTLE_S = 0.5
_MOST_ROWS = 1 << 16
_MOST_SAMPLES = 1 << 14
"""In one block: more of them leave the processor's cache and are paged in anew for each block."""
_MOST_OF_RUNS = 1 << 18
"""Samples times runs of one block: no block of use fits a core's cache, and each costs calls."""
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
    """Simulate ``machine`` under ``commands``; nothing runs until the recording is read.

    The machine starts at rest at ``commands.start_counts``. Sample k is taken at the instant of
    tick ``k * record_every``, before the controllers act on it; the commanded position at that
    instant is the sum of the rows before it, and the controllers follow it from then on. After
    the last row the command stands still for ``settle_s``.

    Channels, per axis: ``X.commanded``, ``X.measured``, ``X.load`` and, where it has one,
    ``X.frame`` in m or rad; ``X.voltage`` at the amplifier's input in V; ``X.current`` in A and
    ``X.current_peak``, the value of largest magnitude since the sample before. Then ``operation``
    and one channel for each input, 1 from the instant at which a switch has cut its drive.

    A machine whose drives are told positions has other channels: see ``ToldSession``.

    Parameters
    ----------
    encoder_phase
        (axes,) where between two counts each encoder stands at the start, in [0, 1); 0.5, the
        middle, when None. Of a stepper where in a full step.
    record_every
        Ticks from sample to sample.
    settle_s
        How long to go on after the last row.
    quantised
        False leaves out the rounding of encoders and DACs (not their limits): for comparisons.
    answers
        How long the operator, or what is waited for, keeps each stop and wait of the job, in
        order: s, rounded up to ticks. The commands stand still so long and the plant goes on; the
        recording tells of every stop, wait and resumption. When they run out the recording ends
        at the next one, stopped, after ``settle_s``. None answers each at once: the machine rests
        there as long as the plan has it.

    Raises
    ------
    MachineError
        If the machine's clocks or parts cannot be simulated.
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
    if machine.told_positions:
        return _told_recording(commands, machine, options)
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
    """Simulate runs of a machine side by side, each with numbers of its own, as one recording.

    Each does what ``simulate`` does with a machine of those numbers, to the bit; stops and waits
    are answered at once. Memory grows with the number of runs, not with the length of the commands.

    Parameters
    ----------
    values
        Numbers of the runs. All runs have the same dead times; ``Values.by_delay`` groups others.
    encoder_phase
        (runs, axes) of each run, or (axes,); 0.5 when None.
    kinds
        Kinds of the channels to record.
    least_rates
        For each connected piece, 1/s: time steps are at least as fine as for that rate. With those
        of ``fastest_rates`` over all runs, the result of a run does not depend, to the bit, on
        which others are simulated beside it.

    Raises
    ------
    MachineError, OptionError
        As ``simulate``; while it is read, if one of the runs has no answer.
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

    The fastest of those that go side by side sets the time steps of all.

    Raises
    ------
    MachineError
        If one of the runs cannot be simulated.
    """
    start = commands.start_counts / commands.counts_per_unit
    return Engine(values.machine, values, start).rates


def _recording(
    commands: TickTable,
    values: Values,
    options: RunOptions,
    least_rates: tuple[float, ...] = (),
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
    """Return a session of a machine with axes, as one run of ``simulate`` makes it."""
    if machine.told_positions:
        return ToldSession(machine, start_counts=start_counts)
    return Session(machine, start_counts=start_counts)


def _told_recording(commands: TickTable, machine: Machine, options: RunOptions) -> Recording:
    return Recording(
        channels=told_channels(machine, options.record_every),
        blocks=Stream(_told_blocks, advances_of(machine), machine, commands, options),
        job_sha256=commands.job_sha256,
        machine_sha256=machine.sha256,
        simulated=True,
    )


def check_commands(
    commands: TickTable, machine: Machine, record_every: int, settle_s: float
) -> None:
    """Refuse commands that are not for this machine, and options out of range."""
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
    """How the machine is simulated."""

    phases: FloatArray
    record_every: int
    settle_s: float
    quantised: bool
    answers: Iterable[float] | None
    kinds: tuple[ChannelKind, ...] = tuple(ChannelKind)

    @property
    def most_rows(self) -> int:
        """How many rows make one block."""
        of_runs = max(_MOST_OF_RUNS // len(self.phases), _LEAST_ROWS)
        return min(_MOST_ROWS, min(_MOST_SAMPLES, of_runs) * self.record_every)


def _blocks(
    engine: Engine, values: Values, commands: TickTable, options: RunOptions
) -> Iterator[RecordingBlock]:
    """Run a session over the commands and its settling; every reading starts anew."""
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


def _told_blocks(
    advances: tuple[Advance, ...], machine: Machine, commands: TickTable, options: RunOptions
) -> Iterator[RecordingBlock]:
    """Do the same with a machine whose drives are told positions."""
    session = ToldSession(
        machine,
        start_counts=commands.start_counts,
        phases=options.phases[0],
        record_every=options.record_every,
        advances=advances,
    )
    yield from run_over(session, commands, options)


def run_over(session: Rows, commands: TickTable, options: RunOptions) -> Iterator[RecordingBlock]:
    """Yield the blocks of a new session until it has settled, or failed."""
    tick_s = float(commands.clock.period_s)
    owed: tuple[Event, ...] = ()
    # One more than the settling ticks: the instant at which the last of them ends.
    settling = _pause(session, ceil(options.settle_s / tick_s) + 1, options.most_rows)
    for block in chain(_parts(session, commands, options), settling):
        owed += block.events
        if len(block.samples["operation"]):
            yield replace(block, events=owed)
            owed = ()
        if session.failed:
            return


def _pause(session: Rows, ticks: int, most: int) -> Iterator[RecordingBlock]:
    """Let the plant go on for ``ticks`` without new rows; blocks of at most ``most`` ticks."""
    for at in range(0, ticks, most):
        yield session.advance(ticks=min(most, ticks - at))


def _parts(session: Rows, commands: TickTable, options: RunOptions) -> Iterator[RecordingBlock]:
    """Yield the blocks of a run of the commands, which halts at stops and waits until answered."""
    answers = None if options.answers is None else iter(options.answers)
    for block in _pieces(commands, options.most_rows):
        parts = [session.advance(block)]
        while session.halted is not None:
            delay_s = 0.0 if answers is None else next(answers, None)
            if delay_s is None:
                yield _joined(parts)
                halted = f"{session.halted.kind} {session.halted.name}".strip()
                session.finish(Ended.STOPPED, f"nobody answered the {halted}")
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
    """Yield the commands in blocks of ``most`` rows at most."""
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
    """Return one block of some that follow each other without a pause."""
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
