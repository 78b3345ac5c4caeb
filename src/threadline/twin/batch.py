"""Many variants of one machine under the same commands, in one call."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from math import ceil
from os import cpu_count

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import MachineError, OptionError
from threadline.machine import Machine
from threadline.plant.network import piecewise_linear
from threadline.plant.values import Values
from threadline.signals import TickTable
from threadline.twin.lanes import EVENTS, SLOW
from threadline.twin.prepare import Prepared, State, new_state, prepare
from threadline.twin.shape import AXIS_ROWS, Layout
from threadline.twin.simulate import DEFAULT_SETTLE_S, check_commands, encoder_phases

_CACHE_BYTES = 16_000
"""What a block of variants may take: it should stay in the fastest memory."""
_WIDTH = 8
_WORST, _LOWEST, _HIGHEST, _LAST, _ = range(len(AXIS_ROWS))
_NEVER = 1 << 62
_AT_ONCE = 2048
_MOST_ROWS = 1 << 16
_MOST_BYTES = 1 << 27
"""Of samples before they are sorted into channels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BatchResult:
    """What became of each variant; V variants, axes in the order of the machine file.

    Parameters
    ----------
    axes
        Names.
    worst_error
        (V, axes) largest |commanded - load| at any tick, m or rad.
    end
        (V, axes) load at the last tick, m or rad.
    lowest, highest
        (V, axes) smallest and largest load from ``window_s`` on, m or rad; None without it.
    current_peak
        (V, axes) current of largest magnitude, A; None when it was not watched, and when
        ``channels`` were sampled (``X.current_peak`` is one of them).
    ticks
        Ticks simulated of each variant.
    slow_ticks, events
        Advances of all variants and axes in which a mode changed or might have, and changes.
    samples
        Per channel asked for: (samples, V), m or rad, V or A.
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


def simulate_batch(
    commands: TickTable,
    machine: Machine,
    variants: Mapping[str, FloatArray] | None = None,
    *,
    encoder_phase: FloatArray | None = None,
    settle_s: float = DEFAULT_SETTLE_S,
    window_s: float | None = None,
    channels: tuple[str, ...] = (),
    record_every: int = 1,
    watch_current: bool = True,
    quantised: bool = True,
    threads: int | None = None,
) -> BatchResult:
    """Simulate variants of ``machine`` that differ in some numbers, all under ``commands``.

    A variant does what ``simulate`` does with a machine of those numbers, by the same arithmetic.
    Memory grows with the number of variants, not with the length of the commands, unless
    ``channels`` are asked for.

    Parameters
    ----------
    variants
        Path of a number of the machine file, such as ``"bodies.x.friction"``, to its (V,) SI
        values.
    encoder_phase
        (V, axes) or (axes,) where between two counts each encoder stands; 0.5 when None.
    settle_s
        How long to go on after the last row.
    window_s
        ``lowest`` and ``highest`` are kept from this time on; None leaves them out.
    channels
        Of ``"X.load"``, ``"X.measured"``, ``"X.voltage"``, ``"X.current"``, ``"X.current_peak"``:
        those to be kept, one sample every ``record_every`` ticks.
    watch_current
        False leaves ``current_peak`` out, for speed.
    quantised
        False leaves out the rounding of encoders and DACs.
    threads
        Cores to use; all when None.

    Raises
    ------
    OptionError
        If a path or channel does not exist, or lengths differ.
    MachineError
        If a variant cannot be simulated.
    """
    check_commands(commands, machine, record_every, settle_s)
    values = Values.of(machine, variants)
    count, phases = _phases(machine, values, encoder_phase)
    if values.count != count:
        values = Values(machine, values.replaced, count)
    batch = _Batch(
        commands,
        machine,
        settle_s,
        window_s,
        channels,
        record_every,
        watch_current,
        quantised,
    )
    with ThreadPoolExecutor(threads or cpu_count() or 1) as pool:
        workers = threads or cpu_count() or 1
        parts = [
            batch.run(
                values.slice(at, at + _AT_ONCE),
                phases[at : at + _AT_ONCE],
                pool,
                workers,
            )
            for at in range(0, count, _AT_ONCE)
        ]
    return _joined(parts)


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
    """What all parts of a batch share."""

    commands: TickTable
    machine: Machine
    settle_s: float
    window_s: float | None
    channels: tuple[str, ...]
    every: int
    watch_current: bool
    quantised: bool

    def run(
        self, values: Values, phases: FloatArray, pool: ThreadPoolExecutor, workers: int
    ) -> BatchResult:
        machine = self.machine
        start_si = self.commands.start_counts / self.commands.counts_per_unit
        pieces = tuple(
            prepare(machine, piece, values) for piece in piecewise_linear(machine, values, start_si)
        )
        wanted = self._columns(pieces)
        owner = {axis.controller: i for i, axis in enumerate(machine.axes.values())}
        peak = self.watch_current or any(".current" in c for c in self.channels)
        states = []
        for piece in pieces:
            at = [owner.get(c) for c in piece.piece.group.controllers]
            phase = np.stack(
                [np.full(values.count, 0.5) if i is None else phases[:, i] for i in at],
                1,
            )
            states.append(
                new_state(
                    machine, piece, phase, *_lanes(piece, values.count, peak, self.quantised),
                    peak=peak, quantised=self.quantised,
                )
            )  # fmt: skip
        tick_s = float(machine.tick_clock.period_s)
        window = _NEVER if self.window_s is None else ceil(self.window_s / tick_s)
        kept: dict[str, list[FloatArray]] = {name: [] for name in self.channels}
        ticks = 0
        for position in self._positions(self._rows_at_once(states, wanted)):
            count = self._run_rows(states, position, ticks, window, pool, workers, wanted, kept)
            ticks += count
        return self._result(states, values.count, ticks, kept)

    def _run_rows(
        self,
        states: list[State],
        position: IntArray,
        tick: int,
        window: int,
        pool: ThreadPoolExecutor,
        workers: int,
        wanted: list[list[tuple[str, int, float, float]]],
        kept: dict[str, list[FloatArray]],
    ) -> int:
        samples = -(-(tick + len(position)) // self.every) - -(-tick // self.every)
        for state, columns in zip(states, wanted, strict=True):
            prepared, blocks = state.prepared, len(state.clock)
            references = np.zeros((len(position), len(state.shape.controllers)))
            names = self.machine.axis_names
            for axis, controller in zip(
                prepared.piece.group.axes, prepared.axis_controller, strict=True
            ):
                references[:, controller] = position[:, names.index(axis)]
            shape = (blocks, samples if columns else 0, prepared.columns, state.shape.lanes)
            records = np.zeros(shape)
            # More parts than cores: a core that others use too must not keep the rest waiting.
            cuts = np.linspace(0, blocks, 8 * workers + 1).astype(int)
            jobs = [
                pool.submit(
                    state.run, a, b, references, self.every * bool(columns), window, records
                )
                for a, b in pairwise(cuts)
                if a < b
            ]
            for job in jobs:
                job.result()
            for name, column, scale, offset in columns:
                part = records[:, :, column].transpose(1, 0, 2).reshape(samples, -1)
                kept[name].append(offset + scale * part)
        return len(position)

    def _rows_at_once(
        self, states: list[State], wanted: list[list[tuple[str, int, float, float]]]
    ) -> int:
        rows = _MOST_ROWS
        for state, columns in zip(states, wanted, strict=True):
            if columns:
                lanes = len(state.clock) * state.shape.lanes
                samples = max(1, _MOST_BYTES // (8 * state.prepared.columns * lanes))
                rows = min(rows, samples * self.every)
        return rows

    def _positions(self, most: int) -> Iterator[IntArray]:
        """Yield (n, axes) commanded counts from the start, n at most, at the ticks' instants."""
        position = np.zeros(len(self.machine.axes), dtype=np.int64)
        for block in self.commands:
            for at in range(0, len(block), most):
                after = position + np.cumsum(block.counts[at : at + most], axis=0)
                yield np.concatenate((position[None], after[:-1]))
                position = after[-1]
        left = ceil(self.settle_s / float(self.machine.tick_clock.period_s)) + 1
        while left:
            count = min(left, most)
            yield np.broadcast_to(position, (count, len(position)))
            left -= count

    def _columns(self, pieces: tuple[Prepared, ...]) -> list[list[tuple[str, int, float, float]]]:
        """Return, per piece, the channels asked for: name, column of the kernel, scale, offset."""
        found, known = [], []
        for piece in pieces:
            group = piece.piece.group
            loads = 2 * len(group.controllers)
            currents = loads + 2 * len(group.axes)
            offers = {}
            for index, name in enumerate(group.axes):
                scale = self.machine.axes[name].counts.si
                start = self.commands.start_counts[self.machine.axis_names.index(name)] / scale
                controller = int(piece.axis_controller[index])
                drive = int(piece.control.drive[controller])
                offers[f"{name}.measured"] = (2 * controller, 1.0 / scale, start)
                offers[f"{name}.voltage"] = (2 * controller + 1, 1.0, 0.0)
                offers[f"{name}.load"] = (loads + 2 * index, 1.0, start)
                offers[f"{name}.current"] = (currents + 2 * drive, 1.0, 0.0)
                offers[f"{name}.current_peak"] = (currents + 2 * drive + 1, 1.0, 0.0)
            found.append([(c, *offers[c]) for c in self.channels if c in offers])
            known += list(offers)
        for channel in self.channels:
            if channel not in known:
                raise OptionError(
                    f"no channel {channel!r}", remedy=f"There are {', '.join(known)}."
                )
        return found

    def _result(
        self,
        states: list[State],
        count: int,
        ticks: int,
        kept: dict[str, list[FloatArray]],
    ) -> BatchResult:
        names = self.machine.axis_names
        table = np.zeros((count, len(names), len(AXIS_ROWS)))
        peak = np.zeros((count, len(names)))
        for state in states:
            group = state.prepared.piece.group
            measures, peaks = state.measures()[:count], state.peaks()[:count]
            if state.failure() or not np.isfinite(measures[:, :, _WORST]).all():
                raise MachineError(
                    f"axes {', '.join(group.axes)}: a variant has no answer: its motion grows "
                    "without bound, or its modes change without end",
                    remedy="Keep the variants nearer to the machine.",
                )
            for index, name in enumerate(group.axes):
                at = names.index(name)
                start = self.commands.start_counts[at] / self.commands.counts_per_unit[at]
                table[:, at] = measures[:, index]
                table[:, at, [_LOWEST, _HIGHEST, _LAST]] += start
                drive = int(state.prepared.control.drive[state.prepared.axis_controller[index]])
                peak[:, at] = peaks[:, drive]
        return BatchResult(
            axes=names,
            worst_error=table[:, :, _WORST],
            end=table[:, :, _LAST],
            lowest=None if self.window_s is None else table[:, :, _LOWEST],
            highest=None if self.window_s is None else table[:, :, _HIGHEST],
            current_peak=peak if self.watch_current and not self.channels else None,
            ticks=ticks,
            slow_ticks=sum(int(s.counts[:, SLOW].sum()) for s in states),
            events=sum(int(s.counts[:, EVENTS].sum()) for s in states),
            samples={name: np.concatenate(parts)[:, :count] for name, parts in kept.items()},
        )


def _lanes(prepared: Prepared, variants: int, peak: bool, quantised: bool) -> tuple[int, int]:
    """Return how many variants in a block, what fits the fastest memory, and in a vector."""
    if variants < _WIDTH:
        return 1, 1
    rows = Layout(prepared.shape(1, 1, peak=peak, quantised=quantised)).rows
    fitting = (lanes for lanes in (64, 32, 16) if 8 * rows * lanes <= _CACHE_BYTES)
    return next(fitting, _WIDTH), _WIDTH


def _joined(parts: list[BatchResult]) -> BatchResult:
    def rows(name: str) -> FloatArray:
        return np.concatenate([getattr(part, name) for part in parts])

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
            name: np.concatenate([part.samples[name] for part in parts], axis=1)
            for name in parts[0].samples
        },
    )
