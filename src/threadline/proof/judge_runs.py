"""Judges of machine variants, in batches or one by one.

Variants are judged in parts of some hundred, with several parts at once. Each part is simulated
block by block and measured on the way, so that memory depends only on the parts under way. A
variant's result is the same to the bit in any part and with any number of threads.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, replace
from functools import cached_property
from os import cpu_count
from threading import Lock

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.dynamics.values import Values
from threadline.errors import MachineError, RecordingError
from threadline.files import ChannelKind, RecordingBlock, Stream, tick_table
from threadline.machine import Machine
from threadline.machine.variants import uncertain, variant
from threadline.proof.kinds import kind_of
from threadline.proof.kinds.variants import with_machine_hash
from threadline.twin import fastest_rates, simulate_runs
from threadline.twin.simulate import DEFAULT_SETTLE_S
from threadline.verdict import EachRun, Judge, Spec, needed_channels
from threadline.verdict.replayed import with_products

Done = Callable[[float], None]
"""Called with the number of judged machines since the call before; a part of one counts, too."""


class AloneJudge:
    """Judges machines within the tolerances of a plan's machine, one by one, under its commands.

    Encoders stand in the middle of a count.

    Parameters
    ----------
    judge
        A judge of this plan by this spec, to reuse its measures of the plan; None: a new one.
    """

    def __init__(self, plan: Plan, spec: Spec, judge: Judge | None = None) -> None:
        self._plan = plan
        self._judge = Judge(plan, spec) if judge is None else judge

    def judged(
        self,
        parts: FloatArray,
        done: Done | None = None,
        products: FloatArray | None = None,
    ) -> EachRun:
        """Return the results of machines at (k, n) parts of their tolerances.

        A machine that cannot be simulated, or that never ends a wait, fails every criterion with a
        limit, with an infinite value.

        Parameters
        ----------
        done
            Called with 1 after each machine.
        products
            (k, 5) parts of the tolerances of each machine's product, as ``with_products``; None for
            the product as it is.
        """
        found = []
        for number, row in enumerate(parts):
            try:
                found.append(self._one(row, None if products is None else products[number, None]))
            except (MachineError, RecordingError):
                found.append(self._own.without_answer())
            if done is not None:
                done(1)
        return EachRun.joined(found)

    def why_not(self, parts: FloatArray) -> str:
        """Return why a machine at (n,) parts cannot be simulated to its end; empty if it can."""
        machine = variant(self._plan.machine, parts)
        commands = with_machine_hash(self._plan.commands, machine)
        try:
            for _ in kind_of(machine).simulate(commands, machine):
                pass
        except (MachineError, RecordingError) as error:
            return error.message
        return ""

    @cached_property
    def _own(self) -> EachRun:
        """Result of the plan's own machine."""
        return self._one(np.zeros(len(uncertain(self._plan.machine))))

    def _one(self, row: FloatArray, product: FloatArray | None = None) -> EachRun:
        plan = self._plan
        machine = variant(plan.machine, row)
        run = kind_of(machine).simulate(with_machine_hash(plan.commands, machine), machine)
        return self._judge.each(run if product is None else with_products(run, product))


_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8  # parameters of mallopt, malloc.h
_LARGEST = 32 << 20
"""Size from which an array gets a mapping of its own, bytes; glibc's largest value."""
_KEPT = 512 << 20


def keep_freed_memory() -> None:
    """Let the C library of Linux keep freed memory for later allocations.

    By default it returns the end of its memory to the system as soon as it is free, and arrays of
    some megabytes lie there. In a loop that makes and drops such arrays, every page is requested,
    cleared and returned again: a fifth of the time of judging many machines. The peak memory stays
    unchanged. Other C libraries keep their settings.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return
    mallopt(_MMAP_THRESHOLD, _LARGEST)
    mallopt(_TRIM_THRESHOLD, _KEPT)
    mallopt(_ARENA_MAX, 1)  # threads reuse each other's freed memory


AT_ONCE = 256
"""Variants per part: they share common calculations, and their samples fit the cache."""
_AT_ONCE_WOUND = 32
"""The same with products."""

KEPT_S = 300.0
"""Longest job that is kept in memory while it is judged repeatedly."""


def kept_in_memory(plan: Plan) -> Plan:
    """Return a plan with job, path, trajectory and commands in memory, if the job is short."""
    if plan.duration_s > KEPT_S:
        return plan
    motion, table = plan.motion, tick_table(plan.commands)
    trajectory, programmed = motion.trajectory, motion.programmed
    return replace(
        plan,
        job=replace(plan.job, operations=Stream.of(plan.job)),
        intent=replace(
            motion,
            programmed=replace(programmed, blocks=Stream.of(programmed.blocks)),
            trajectory=replace(trajectory, blocks=Stream.of(trajectory.blocks)),
        ),
        commands=replace(table, blocks=Stream.of(table)),
    )


class RunsJudge:
    """Judges variants of ``machine`` under the commands of ``plan``.

    Parameters
    ----------
    plan
        Plan whose commands every variant gets.
    spec
        Specification with the criteria.
    machine
        Machine whose numbers the variants replace; None: the plan's machine.
    settle_s
        Simulated time after the last row.
    threads
        Number of parts under way at once; None: the number of cores.
    extremes
        Numbers of machines whose fastest rates bound the rates of all machines to be judged. With
        them, a machine's result is the same to the bit, whichever others share its part. None:
        results may differ by rounding.

    Raises
    ------
    SpecError
        If a criterion names no measure.
    """

    def __init__(
        self,
        plan: Plan,
        spec: Spec,
        machine: Machine | None = None,
        *,
        settle_s: float = DEFAULT_SETTLE_S,
        threads: int | None = None,
        extremes: Mapping[str, FloatArray] | None = None,
    ) -> None:
        keep_freed_memory()
        plan = kept_in_memory(plan)
        self.plan = plan
        self.judge = Judge(plan, spec)
        self._table = tick_table(plan.commands)
        self._machine = plan.machine if machine is None else machine
        self._settle_s = settle_s
        self._threads = threads or cpu_count() or 1
        self._rates: tuple[float, ...] = ()
        if extremes is not None:
            rates = fastest_rates(self._table, _without_delays(self._machine, extremes))
            self._rates = tuple(float(rate.max()) for rate in rates)
        self._kinds = (ChannelKind.COMMANDED, ChannelKind.OPERATION, *needed_channels(spec))

    def judged(
        self,
        variants: Mapping[str, FloatArray],
        phases: FloatArray | None = None,
        done: Done | None = None,
        products: FloatArray | None = None,
    ) -> EachRun:
        """Return the result of every variant.

        A variant that cannot be simulated, because its motion grows without bound or its modes
        change without end, fails every criterion with a limit, with an infinite value.

        Parameters
        ----------
        variants
            Path of a number of the machine file to its (V,) SI values, at least one of them.
        phases
            (V, axes) place of each encoder between two counts; 0.5 when None.
        done
            Called as a part is read and after it, with the number of its variants since.
        products
            (V, 5) parts of the tolerances of each variant's product, as ``with_products``; None for
            the product as it is.
        """
        values = Values.of(self._machine, variants)
        # Each run with a product keeps a raster of its own, of some megabytes.
        at_once = AT_ONCE if products is None else min(AT_ONCE, _AT_ONCE_WOUND)
        parts = list(self._parts(values, at_once))
        lock = Lock()

        def told(count: float) -> None:
            if done is not None:
                with lock:
                    done(count)

        def part(of: tuple[Values, IntArray]) -> EachRun:
            some, places = of
            own = None if phases is None else phases[places]
            product = None if products is None else products[places]
            return self._part(some, own, product, told)

        # A thread of a pool has no context of its own: progress is told to the command that asked.
        contexts = [copy_context() for _ in parts]
        with ThreadPoolExecutor(self._threads) as pool:
            found = list(pool.map(lambda context, of: context.run(part, of), contexts, parts))
        order = np.argsort(np.concatenate([places for _, places in parts]), kind="stable")
        return EachRun.joined(found).taken(order)

    @cached_property
    def _own(self) -> EachRun:
        """Result of the plan's own machine."""
        own = simulate_runs(
            self._table,
            Values.of(self.plan.machine),
            settle_s=self._settle_s,
            kinds=self._kinds,
        )
        return self.judge.each(own)

    def _parts(self, values: Values, at_once: int) -> Iterator[tuple[Values, IntArray]]:
        """Yield the variants in parts with one dead time, each part with its indices among all."""
        for sharing, places in values.by_delay():
            for at in range(0, sharing.count, at_once):
                yield sharing.slice(at, at + at_once), places[at : at + at_once]

    def _part(
        self, values: Values, phases: FloatArray | None, products: FloatArray | None, told: Done
    ) -> EachRun:
        so_far = _SoFar(values.count, self.plan, told)
        try:
            recording = simulate_runs(
                self._table,
                values,
                encoder_phase=phases,
                settle_s=self._settle_s,
                kinds=self._kinds,
                least_rates=self._rates,
            )
            if products is not None:
                recording = with_products(recording, products)
            watched = replace(recording, blocks=_Told(recording.blocks, so_far))
            whole = self.judge.each(watched)
            so_far.tell(1.0)
            return whole
        except MachineError:
            # One variant without an answer ends its whole part: halve the part until it is alone.
            if values.count == 1:
                so_far.tell(1.0)
                return self._own.without_answer()
            half = values.count // 2
            so_far.tell(0.0)
            found = [
                self._part(
                    values.slice(rows.start, rows.stop),
                    None if phases is None else phases[rows],
                    None if products is None else products[rows],
                    told,
                )
                for rows in (slice(0, half), slice(half, values.count))
            ]
            return EachRun.joined(found)


class _SoFar:
    """Tells how many variants of a part were judged since it last told: a share of its motion."""

    def __init__(self, count: int, plan: Plan, told: Done) -> None:
        self._count, self._plan, self._told, self._share = count, plan, told, 0.0

    def tell(self, share: float) -> None:
        """Tell that a share of the motion was judged, if it is more than was told."""
        if share > self._share:
            self._told(self._count * (share - self._share))
            self._share = share

    def read(self, block: RecordingBlock) -> None:
        """Tell that a block was judged; a second reading tells nothing new."""
        clock = self._plan.commands.clock
        done_s = float(clock.time_s(block.first_tick.get(clock.name, 0)))
        self.tell(min(done_s / max(self._plan.duration_s, 1e-9), 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class _Told:
    """The blocks of a recording, which tell that they were read; they can be read again."""

    blocks: Iterable[RecordingBlock]
    so_far: _SoFar

    def __iter__(self) -> Iterator[RecordingBlock]:
        for block in self.blocks:
            yield block
            self.so_far.read(block)


def _without_delays(machine: Machine, numbers: Mapping[str, FloatArray]) -> Values:
    """Return the numbers without dead times, which do not affect the rates."""
    return Values.of(machine, {k: v for k, v in numbers.items() if not k.endswith(".delay")})
