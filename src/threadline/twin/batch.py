"""Many variants of one machine under the same commands, in one call."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil
from os import cpu_count

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.dynamics.values import Values
from threadline.errors import MachineError, OptionError
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
from threadline.twin.channels import encoder_phases, run_phases
from threadline.twin.kernel import NEVER, Engine, Reading, Run, Signal
from threadline.twin.prescribed import Advance, PositionSession, advances_of, position_channels
from threadline.twin.simulate import DEFAULT_SETTLE_S, RunOptions, check_commands, run_over

_AT_ONCE = 2048
_MOST_ROWS = 1 << 16
_MOST_BYTES = 1 << 27
"""Largest memory of samples before they are sorted into channels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BatchResult:
    """Results of a batch of V variants; axes in the order of the machine file.

    Parameters
    ----------
    axes
        Names.
    worst_error
        (V, axes) largest |commanded - load| at any tick, m or rad.
    end
        (V, axes) load at the last tick, m or rad.
    lowest, highest
        (V, axes) smallest and largest load position from ``window_s`` on, m or rad; None if
        ``window_s`` is.
    current_peak
        (V, axes) current of largest magnitude, A; None if it was not watched or if ``channels``
        were sampled (which may include ``X.current_peak``).
    ticks
        Simulated ticks per variant.
    slow_ticks, events
        Advances, over all variants and axes, with a possible change of mode, and actual changes.
    samples
        Per requested channel: (samples, V), m or rad, V or A.
    """

    axes: tuple[str, ...]
    worst_error: FloatArray
    end: FloatArray
    lowest: FloatArray | None
    highest: FloatArray | None
    current_peak: FloatArray | None
    ticks: int
    slow_ticks: int
    events: int
    samples: Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchOptions:
    """Options of a batch.

    Parameters
    ----------
    settle_s
        Simulated time after the last row.
    window_s
        ``lowest`` and ``highest`` are recorded from this time on; None omits them.
    channels
        Channels to sample every ``record_every`` ticks, out of ``"X.load"``, ``"X.measured"``,
        ``"X.voltage"``, ``"X.current"``, ``"X.current_peak"``.
    record_every
        Number of ticks from sample to sample.
    watch_current
        False omits ``current_peak``, for speed.
    quantised
        False omits the rounding of encoders and DACs.
    threads
        Cores to use; None for all.
    """

    settle_s: float = DEFAULT_SETTLE_S
    window_s: float | None = None
    channels: tuple[str, ...] = ()
    record_every: int = 1
    watch_current: bool = True
    quantised: bool = True
    threads: int | None = None


_USUAL = BatchOptions()


def simulate_batch(
    commands: TickTable,
    machine: Machine,
    variants: Mapping[str, FloatArray] | None = None,
    *,
    encoder_phase: FloatArray | None = None,
    options: BatchOptions = _USUAL,
) -> BatchResult:
    """Simulate variants of ``machine`` that differ in some numbers, under the same ``commands``.

    Each variant gives the same result as ``simulate`` with a machine of those numbers. Memory grows
    with the number of variants, not with the length of the commands, unless channels are requested.

    Parameters
    ----------
    variants
        Path of a number of the machine file, such as ``"bodies.x.friction"``, to its (V,) SI
        values.
    encoder_phase
        (V, axes) or (axes,) position of each encoder between two counts; None: 0.5.

    Raises
    ------
    OptionError
        If a path or channel does not exist, or lengths differ.
    MachineError
        If a variant cannot be simulated.
    """
    check_commands(commands, machine, options.record_every, options.settle_s)
    values = Values.of(machine, variants)
    count, phases = _phases(machine, values, encoder_phase)
    if values.count != count:
        values = Values(machine, values.replaced, count)
    parts, order = [], []
    for sharing, places in values.by_delay():
        batch = _Batch(commands, sharing.machine, options)
        parts += [
            batch.run(sharing.slice(at, at + _AT_ONCE), phases[places[at : at + _AT_ONCE]])
            for at in range(0, sharing.count, _AT_ONCE)
        ]
        order.append(places)
    return _joined(parts, np.argsort(np.concatenate(order)))


def _phases(
    machine: Machine, values: Values, encoder_phase: FloatArray | None
) -> tuple[int, FloatArray]:
    given = None if encoder_phase is None else np.asarray(encoder_phase, dtype=np.float64)
    if given is None or given.ndim == 1:
        one = encoder_phases(machine, given)
        return values.count, np.broadcast_to(one, (values.count, len(one)))
    if given.ndim != 2 or given.shape[1] != len(machine.axes):
        raise OptionError(
            f"encoder_phase has shape {given.shape}, expected (variants, {len(machine.axes)})"
        )
    if values.replaced and len(given) != values.count:
        raise OptionError(f"{len(given)} encoder phases for {values.count} variants")
    if not ((given >= 0.0) & (given < 1.0)).all():
        raise OptionError("encoder_phase must lie in [0, 1)")
    return len(given), given


@dataclass(frozen=True, slots=True)
class _Batch:
    """Work of all parts of a batch: one machine under the same commands."""

    commands: TickTable
    machine: Machine
    options: BatchOptions

    def run(self, values: Values, phases: FloatArray) -> BatchResult:
        commands, machine, options = self.commands, self.machine, self.options
        engine = Engine(machine, values, commands.start_counts / commands.counts_per_unit)
        sources = self._sources(engine)
        tick_s = float(machine.tick_clock.period_s)
        window = NEVER if options.window_s is None else ceil(options.window_s / tick_s)
        samples: dict[str, list[FloatArray]] = {name: [] for name in options.channels}
        peak = options.watch_current or any(".current" in c for c in options.channels)
        threads = options.threads or cpu_count() or 1
        started = engine.start(
            phases, watch_current=peak, quantised=options.quantised, threads=threads
        )
        with started as run:
            readings = {reading for reading, _, _ in sources.values()}
            for travelled in self._positions(self._rows_at_once(run, readings)):
                read = run.advance(travelled, readings, every=options.record_every, window=window)
                for name, (reading, scale, offset) in sources.items():
                    samples[name].append(offset + scale * read[reading])
        return self._result(run, samples)

    def _rows_at_once(self, run: Run, readings: set[Reading]) -> int:
        if not readings:
            return _MOST_ROWS
        return min(
            _MOST_ROWS,
            max(1, _MOST_BYTES // run.sample_bytes(readings)) * self.options.record_every,
        )

    def _positions(self, most: int) -> Iterator[IntArray]:
        """Yield (n, axes) commanded counts since the start, ``most`` ticks at a time."""
        position = np.zeros(len(self.machine.axes), dtype=np.int64)
        for block in self.commands:
            for at in range(0, len(block), most):
                after = position + np.cumsum(block.counts[at : at + most], axis=0)
                yield np.concatenate((position[None], after[:-1]))
                position = after[-1]
        left = ceil(self.options.settle_s / float(self.machine.tick_clock.period_s)) + 1
        while left:
            count = min(left, most)
            yield np.broadcast_to(position, (count, len(position)))
            left -= count

    def _sources(self, engine: Engine) -> dict[str, tuple[Reading, float, float]]:
        """Return the reading, scale and offset of each requested channel."""
        offers: dict[str, tuple[Reading, float, float]] = {}
        known = set(engine.readings())
        for at, (name, axis) in enumerate(self.machine.axes.items()):
            scale = axis.counts.si
            start = float(self.commands.start_counts[at] / scale)
            for channel, signal, factor, offset in (
                ("measured", Signal.READ, 1.0 / scale, start),
                ("voltage", Signal.VOLTS, 1.0, 0.0),
                ("load", Signal.LOAD, 1.0, start),
                ("current", Signal.CURRENT, 1.0, 0.0),
                ("current_peak", Signal.CURRENT_PEAK, 1.0, 0.0),
            ):
                if Reading(signal, name) in known:
                    offers[f"{name}.{channel}"] = (Reading(signal, name), factor, offset)
        for channel in self.options.channels:
            if channel not in offers:
                raise OptionError(
                    f"no channel {channel!r}", remedy=f"There are {', '.join(offers)}."
                )
        return {channel: offers[channel] for channel in self.options.channels}

    def _result(self, run: Run, samples: dict[str, list[FloatArray]]) -> BatchResult:
        names, commands = self.machine.axis_names, self.commands
        measures, failure = run.measures(), run.failure()
        answered = np.isfinite(measures.worst)
        if failure is not None or not answered.all():
            axes = failure[0] if failure else [names[i] for i in np.flatnonzero(~answered.all(0))]
            raise MachineError(
                f"axes {', '.join(axes)}: a variant has no solution: its motion grows "
                "without bound, or its modes change endlessly",
                remedy="Choose variants nearer to the machine.",
            )
        start = commands.start_counts / commands.counts_per_unit
        windowed = self.options.window_s is not None
        peak = self.options.watch_current and not self.options.channels
        return BatchResult(
            axes=names,
            worst_error=measures.worst,
            end=measures.last + start,
            lowest=measures.lowest + start if windowed else None,
            highest=measures.highest + start if windowed else None,
            current_peak=measures.current_peak if peak else None,
            ticks=run.tick,
            slow_ticks=run.slow_ticks,
            events=run.events,
            samples={name: np.concatenate(parts) for name, parts in samples.items()},
        )


def _joined(parts: list[BatchResult], order: IntArray) -> BatchResult:
    """Join the parts; variant k of the result is row ``order[k]`` of the concatenated parts."""

    def rows(name: str) -> FloatArray:
        return np.concatenate([getattr(part, name) for part in parts])[order]

    def rows_if_kept(name: str) -> FloatArray | None:
        return None if getattr(parts[0], name) is None else rows(name)

    return BatchResult(
        axes=parts[0].axes,
        worst_error=rows("worst_error"),
        end=rows("end"),
        lowest=rows_if_kept("lowest"),
        highest=rows_if_kept("highest"),
        current_peak=rows_if_kept("current_peak"),
        ticks=parts[0].ticks,
        slow_ticks=sum(part.slow_ticks for part in parts),
        events=sum(part.events for part in parts),
        samples={
            name: np.concatenate([part.samples[name] for part in parts], axis=1)[:, order]
            for name in parts[0].samples
        },
    )


_SHARED = (ChannelKind.COMMANDED, ChannelKind.OPERATION)
"""Kinds of channels that are the same in all runs."""


def simulate_position_runs(
    commands: TickTable, machines: Sequence[Machine], *, encoder_phase: FloatArray
) -> Recording | None:
    """Simulate machines with position-commanded drives together; the bits are as by ``simulate``.

    Parameters
    ----------
    machines
        Machines with the same parts and different numbers.
    encoder_phase
        (machines, axes) position of each stepper within a full step at the start.

    Returns
    -------
    Recording or None
        A recording with a run per machine; None if a belt may go slack, which would end one run
        before the others.
    """
    machine = machines[0]
    advances = tuple(advances_of(one) for one in machines)
    if any(advance.piece.belts for own in advances for advance in own):
        return None
    check_commands(commands, machine, 1, DEFAULT_SETTLE_S)
    options = RunOptions(
        phases=run_phases(machine, encoder_phase, len(machines)),
        record_every=1,
        settle_s=DEFAULT_SETTLE_S,
        quantised=True,
        answers=None,
    )
    return Recording(
        channels=position_channels(machine, 1),
        blocks=Stream(_position_runs_blocks, advances, tuple(machines), commands, options),
        job_sha256=commands.job_sha256,
        machine_sha256=machine.sha256,
        simulated=True,
        runs=len(machines),
    )


def _position_runs_blocks(
    advances: tuple[tuple[Advance, ...], ...],
    machines: tuple[Machine, ...],
    commands: TickTable,
    options: RunOptions,
) -> Iterator[RecordingBlock]:
    """Run sessions of all machines over the commands and the settling time."""
    sessions = [
        PositionSession(machine, start_counts=commands.start_counts, phases=phase, advances=own)
        for own, machine, phase in zip(advances, machines, options.phases, strict=True)
    ]
    yield from run_over(PositionRuns(sessions), commands, options)


class PositionRuns:
    """Sessions of machines with different numbers, under the same rows, as one recording.

    No session may fail, so that all have the same number of samples.

    Parameters
    ----------
    sessions
        At least one.
    """

    failed = False  # sessions cannot fail

    def __init__(self, sessions: Sequence[PositionSession]) -> None:
        self._sessions = tuple(sessions)

    @property
    def halted(self) -> Event | None:
        """The stop or wait at which the rows are halted."""
        return self._sessions[0].halted

    def resume(self) -> None:
        """Continue the rows after a stop, in every run."""
        for session in self._sessions:
            session.resume()

    def finish(self, ended: RunEnd = RunEnd.COMPLETED, text: str = "") -> None:
        """End the run: no more rows follow."""
        for session in self._sessions:
            session.finish(ended, text)

    def advance(self, rows: TickBlock | None = None, *, ticks: int | None = None) -> RecordingBlock:
        """Take rows and advance, as ``RowSession.advance``, with a column per run."""
        blocks = [session.advance(rows, ticks=ticks) for session in self._sessions]
        own = [c.name for c in self._sessions[0].channels if c.kind not in _SHARED]
        samples = dict(blocks[0].samples)
        # Memory order: instants, then axes of one kind, then runs.
        for ending in dict.fromkeys(name.rpartition(".")[2] for name in own):
            names = [name for name in own if name.rpartition(".")[2] == ending]
            whole = np.empty((len(samples[names[0]]), len(names), len(blocks)))
            for column, name in enumerate(names):
                for run, block in enumerate(blocks):
                    whole[:, column, run] = block.samples[name]
                samples[name] = whole[:, column]
        return replace(blocks[0], samples=samples)
