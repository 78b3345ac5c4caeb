"""Judges of machine variants, in batches or one by one.

Variants are judged in parts of some hundred, with several parts at once. Each part is simulated
block by block and measured on the way, so that memory depends only on the parts under way. A
variant's result is the same to the bit in any part and with any number of threads.
"""

from __future__ import annotations

import ctypes
import hashlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from os import cpu_count
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.workers import Done, answers, workers
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
from threadline.verdict.pattern import raster_bytes
from threadline.verdict.replayed import with_products

_OneMachine = tuple[FloatArray, FloatArray | None]
"""Parts of one machine, and (1, 5) parts of its product."""


def bits_of(found: EachRun) -> bytes:
    """Return a digest of every value, limit and name of a result."""
    digest = hashlib.sha256()
    for row in found.rows:
        digest.update(f"{row.name} {row.axis} {row.step} {row.limit!r} ".encode())
        digest.update(np.ascontiguousarray(row.values, dtype="<f8").tobytes())
    return digest.digest()


class SerialJudge:
    """Simulates and judges machines within the tolerances one by one, under the plan's commands.

    At the start every encoder stands in the middle of a count.

    Parameters
    ----------
    judge
        A judge of this plan by this spec, to reuse its measures of the plan; None: a new one.
    """

    def __init__(self, plan: Plan, spec: Spec, judge: Judge | None = None) -> None:
        keep_freed_memory()
        self._plan, self._spec = plan, spec
        self._judge = Judge(plan, spec) if judge is None else judge

    def judged(
        self, parts: FloatArray, done: Done | None = None, products: FloatArray | None = None
    ) -> EachRun:
        """Return the results of machines at (k, n) parts of their tolerances.

        A machine that cannot be simulated, or that waits forever for an input, fails every
        criterion that has a limit: the measured value is infinite.

        Parameters
        ----------
        done
            Called with 1 after each machine.
        products
            (k, 5) parts of the tolerances of each machine's product, as ``with_products``; None for
            the product as it is.
        """
        return EachRun.joined(list(self._answers([(parts, products)], done, len(parts) == 1)))

    def judged_each(
        self, batches: Iterable[tuple[FloatArray, FloatArray | None]], done: Done | None = None
    ) -> Iterator[EachRun]:
        """Yield the results of each batch; a batch has parts and products as in ``judged``."""
        sizes: deque[int] = deque()

        def noting_sizes() -> Iterator[tuple[FloatArray, FloatArray | None]]:
            for parts, products in batches:
                sizes.append(len(parts))
                yield parts, products

        results = self._answers(noting_sizes(), done, here=False)
        for first_result in results:
            yield EachRun.joined([first_result, *islice(results, sizes.popleft() - 1)])

    def _answers(
        self,
        batches: Iterable[tuple[FloatArray, FloatArray | None]],
        done: Done | None,
        here: bool,
    ) -> Iterator[EachRun]:
        items = (
            (row, None if products is None else products[k, None])
            for parts, products in batches
            for k, row in enumerate(parts)
        )
        return answers(self, items, done, here=here)

    def answer(self, item: _OneMachine, done: Done | None = None) -> EachRun:
        """Return the result of one machine with its product."""
        try:
            result = self._one(*item)
        except (MachineError, RecordingError):
            result = self._own.without_answer()
        if done is not None:
            done(1)
        return result

    def machines(self, _item: _OneMachine) -> int:
        """Return 1: machines are judged one by one."""
        return 1

    def known(self) -> bytes:
        """Return the bits of the result of the plan's own machine."""
        return bits_of(self._own)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return SerialJudge, (self._plan, self._spec)

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
"""Size, in bytes, from which an array gets its own memory mapping; the largest value of glibc."""
_FREE_MEMORY = 512 << 20


def keep_freed_memory() -> None:
    """Let the C library of Linux keep freed memory for later allocations.

    By default the library returns free memory at the end of the heap to the system at once, and
    arrays of some megabytes lie there. A loop that makes and drops such arrays therefore requests,
    clears and returns every page again and again, which takes a fifth of the time of judging many
    machines. The peak memory stays unchanged. Other C libraries keep their settings.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return
    mallopt(_MMAP_THRESHOLD, _LARGEST)
    mallopt(_TRIM_THRESHOLD, _FREE_MEMORY)
    mallopt(_ARENA_MAX, 1)  # threads reuse each other's freed memory


AT_ONCE = 256
"""Largest number of variants per part. They share calculations, and their samples fit the cache."""
_LEAST_WOUND = 16
"""Smallest number of variants with products per part, if there are so many. The calculation that
they share costs about as much as these variants."""
_WOUND_BYTES = 256 << 20
"""Memory for the rasters of a part; each variant with a product has its own raster."""

CACHED_S = 300.0
"""Longest job that is kept in memory between judgements, whatever its number of ticks, in s."""
CACHED_TICKS = 500_000
"""Most ticks of a longer job that is kept as well: a winding of an hour has ticks of 5 ms."""


def cached_in_memory(plan: Plan) -> Plan:
    """Return a plan with job, path, trajectory and commands in memory, if the job is short."""
    tick_s = float(plan.commands.clock.period_s)
    if plan.duration_s > max(CACHED_S, CACHED_TICKS * tick_s):
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Variants:
    """V machines to be judged.

    Parameters
    ----------
    numbers
        Dotted name of a number of the machine file -> its (V,) SI values; at least one number.
    phases
        (V, axes) position of each encoder between two counts at the start, 0 to 1; None: 0.5.
    products
        (V, 5) parts of the tolerances of each variant's product, as ``with_products``; None for
        the product as it is.
    """

    numbers: Mapping[str, FloatArray]
    phases: FloatArray | None = None
    products: FloatArray | None = None

    @property
    def count(self) -> int:
        """Number of machines."""
        return len(next(iter(self.numbers.values())))

    def taken(self, index: IntArray) -> Variants:
        """Return the machines with the (k,) numbers ``index``."""
        return Variants(
            numbers={path: values[index] for path, values in self.numbers.items()},
            phases=None if self.phases is None else self.phases[index],
            products=None if self.products is None else self.products[index],
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
        Number of parts that are simulated at once; None: the number of cores.
    extremes
        Numbers of machines whose fastest rates bound the rates of all machines to be judged. With
        them, a machine's result is the same to the bit, whichever machines share its part. None:
        results may differ by rounding.

    Raises
    ------
    SpecError
        If a criterion names an unknown measure.
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
        plan = cached_in_memory(plan)
        self.plan, self._spec = plan, spec
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
        """Return the result of every variant; the arguments are the fields of ``Variants``.

        A variant cannot be simulated if its motion grows without bound or its modes change without
        end. It then fails every criterion that has a limit: the measured value is infinite.

        Parameters
        ----------
        done
            Called while a part is simulated and at its end, with the number of variants judged
            since the last call; a part of the motion counts as a fraction.
        """
        values = Values.of(self._machine, variants)  # refuses a path that is not a number
        machines = Variants(numbers=values.replaced, phases=phases, products=products)
        part_indices = list(self._places(machines, whole=True))
        items = (machines.taken(index) for index in part_indices)
        results = answers(self, items, done, threads=self._threads, here=len(part_indices) == 1)
        return _in_order(list(results), part_indices)

    def judged_each(
        self, batches: Iterable[Variants], done: Done | None = None
    ) -> Iterator[EachRun]:
        """Yield the result of each batch; the next batches begin before the first has ended."""
        indices_waiting: deque[list[IntArray]] = deque()

        def items() -> Iterator[Variants]:
            for batch in batches:
                indices_waiting.append(list(self._places(batch, whole=False)))
                yield from (batch.taken(index) for index in indices_waiting[-1])

        results = answers(self, items(), done, threads=self._threads)
        for first_result in results:
            part_indices = indices_waiting.popleft()
            yield _in_order([first_result, *islice(results, len(part_indices) - 1)], part_indices)

    def answer(self, item: Variants, done: Done | None = None) -> EachRun:
        """Return the results of one part, whose variants all have the same dead times."""
        ((values, _),) = Values.of(self._machine, item.numbers).by_delay()
        so_far = _SoFar(values.count, self.plan, done)
        return self._part(values, item.phases, item.products, so_far)

    def machines(self, item: Variants) -> int:
        """Return the number of variants in a part."""
        return item.count

    def known(self) -> bytes:
        """Return the bits of the result of the plan's own machine."""
        return bits_of(self._own)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        state = self.plan, self._spec, self._machine, self._settle_s, self._rates
        return _runs_judge, state

    def _wound_at_once(self, count: int) -> int:
        """Return the number of variants per part, for ``count`` variants with products."""
        most = min(AT_ONCE, max(_WOUND_BYTES // max(self._raster_bytes, 1), 1))
        return min(most, max(-(-count // self._threads), _LEAST_WOUND))

    @cached_property
    def _raster_bytes(self) -> int:
        return raster_bytes(self.plan)

    @cached_property
    def _own(self) -> EachRun:
        """Result of the plan's own machine."""
        own_run = simulate_runs(
            self._table, Values.of(self.plan.machine), settle_s=self._settle_s, kinds=self._kinds
        )
        return self.judge.each(own_run)

    def _places(self, variants: Variants, *, whole: bool) -> Iterator[IntArray]:
        """Yield the indices of each part of the variants; dead times are equal within a part.

        Parameters
        ----------
        whole
            Whether no other variants are judged at the same time. The variants are then divided so
            that every worker gets a part.
        """
        has_products = variants.products is not None
        at_once = self._wound_at_once(variants.count) if has_products else AT_ONCE
        remote_workers = workers()
        if whole and remote_workers is not None and self._rates:
            at_once = min(at_once, max(-(-variants.count // remote_workers.cores), 1))
        for same_delay in Values.of(self._machine, variants.numbers).places_by_delay():
            for begin in range(0, len(same_delay), at_once):
                yield same_delay[begin : begin + at_once]

    def _part(
        self,
        values: Values,
        phases: FloatArray | None,
        products: FloatArray | None,
        so_far: _SoFar,
    ) -> EachRun:
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
            reported = replace(recording, blocks=_Told(recording.blocks, so_far))
            result = self.judge.each(reported)
            so_far.tell(1.0)
            return result
        except MachineError:
            # One variant that cannot be simulated ends the simulation of its whole part: halve the
            # part until this variant is alone.
            if values.count == 1:
                so_far.tell(1.0)
                return self._own.without_answer()
            half_count = values.count // 2
            so_far.tell(0.0)
            halves = [
                self._part(
                    values.slice(rows.start, rows.stop),
                    None if phases is None else phases[rows],
                    None if products is None else products[rows],
                    _SoFar(rows.stop - rows.start, self.plan, so_far.done),
                )
                for rows in (slice(0, half_count), slice(half_count, values.count))
            ]
            return EachRun.joined(halves)


def _runs_judge(
    plan: Plan, spec: Spec, machine: Machine, settle_s: float, rates: tuple[float, ...]
) -> RunsJudge:
    """Return the copy of a judge for another process, in which one thread judges a part."""
    judge = RunsJudge(plan, spec, machine, settle_s=settle_s, threads=1)
    judge._rates = rates
    return judge


def _in_order(results: list[EachRun], part_indices: list[IntArray]) -> EachRun:
    """Return the results of parts at their ``part_indices``, in the order of the variants."""
    return EachRun.joined(results).taken(np.argsort(np.concatenate(part_indices), kind="stable"))


class _SoFar:
    """Reports progress of a part: the judged share of its motion times its number of variants."""

    def __init__(self, count: int, plan: Plan, done: Done | None) -> None:
        self._count, self._plan, self.done, self._share = count, plan, done, 0.0

    def tell(self, share: float) -> None:
        """Report the growth of the judged share of the motion since the last report, if any."""
        if share > self._share and self.done is not None:
            self.done(self._count * (share - self._share))
            self._share = share

    def read(self, block: RecordingBlock) -> None:
        """Report that a block was judged; reading it a second time reports nothing."""
        clock = self._plan.commands.clock
        done_s = float(clock.time_s(block.first_tick.get(clock.name, 0)))
        self.tell(min(done_s / max(self._plan.duration_s, 1e-9), 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class _Told:
    """The blocks of a recording, re-iterable; each block read is reported to ``so_far``."""

    blocks: Iterable[RecordingBlock]
    so_far: _SoFar

    def __iter__(self) -> Iterator[RecordingBlock]:
        for block in self.blocks:
            yield block
            self.so_far.read(block)


def _without_delays(machine: Machine, numbers: Mapping[str, FloatArray]) -> Values:
    """Return the numbers except dead times, which do not affect the rates."""
    return Values.of(machine, {k: v for k, v in numbers.items() if not k.endswith(".delay")})
