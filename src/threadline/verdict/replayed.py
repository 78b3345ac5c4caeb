"""The replayed fibre of runs and of planned motions, on their product."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from threading import local

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.errors import JobError, Place
from threadline.files import ChannelKind, Recording
from threadline.jobs.tensions import tensions_of
from threadline.machine.tool import Tool
from threadline.verdict.samples import Block, Setting
from threadline.winding.laying import LAID
from threadline.winding.product import Product, Ring, product_of_text
from threadline.winding.replay import (
    LONGEST_M,
    STRAIGHT_M,
    Fibre,
    Replay,
    Thinning,
    eye_columns,
    moves_of,
)
from threadline.winding.surface import Surface

_FINE_M = 5e-4  # longest chord of the designed fibre
_DRAWS = 20_000_717  # seed of the products within their tolerances


def product_of(plan: Plan) -> Product | None:
    """Return the product of a plan; None for a plan without one."""
    text = plan.options.get("product")
    return None if text is None else product_of_text(text)


NUMBERS = ("mandrel.radius_error", "mandrel.at", "band.width", "mandrel.slip", "friction.value")
"""Numbers of a product that vary within its tolerances, as its file names them."""
_PARTS = "product_parts"
_ONE = (0.0,) * len(NUMBERS)


def toleranced(product: Product) -> IntArray:
    """Return which of ``NUMBERS`` have a tolerance in a product."""
    own = (product.radius_error, product.at, product.width, product.slip, product.friction)
    return np.flatnonzero([number.tolerance > 0.0 for number in own])


def product_words(product: Product, parts: Mapping[str, float]) -> str:
    """Return the numbers of a product in words, with ``parts`` of their tolerances, by name."""
    own = (product.radius_error, product.at, product.width, product.slip, product.friction)
    words = []
    for name, number in zip(NUMBERS, own, strict=True):
        value = number.si + parts.get(name, 0.0) * number.tolerance
        if name not in parts:
            continue
        turns = name == "mandrel.slip"
        unit = "" if name == "friction.value" else " deg" if turns else " mm"
        scale = 1.0 if not unit else 360.0 if turns else 1e3
        words.append(f"{name} = {scale * value:.6g}{unit}")
    return ", ".join(words)


def product_at_random(index: IntArray) -> FloatArray:
    """Return (k, 5) parts of the tolerances of ``NUMBERS`` for (k,) drawn products."""
    rows = [np.random.default_rng((_DRAWS, n)).uniform(-1.0, 1.0, len(NUMBERS)) for n in index]
    return np.array(rows).reshape(-1, len(NUMBERS))


def with_products(recording: Recording, parts: FloatArray) -> Recording:
    """Return a recording whose runs have products at (runs or 1, 5) parts of the tolerances."""
    return replace(recording, origin={**recording.origin, _PARTS: json.dumps(parts.tolist())})


def of_product(recordings: Sequence[Recording], parts: Sequence[float]) -> Sequence[Recording]:
    """Return recordings whose runs have one product, at (5,) parts of the tolerances."""
    if not any(parts):
        return recordings
    return [with_products(one, np.array([parts])) for one in recordings]


def _products_of(recording: Recording) -> list[tuple[float, ...] | None]:
    """Return the parts of the product of each run; None for the product as specified."""
    text = recording.origin.get(_PARTS)
    if text is None:
        return [None] * recording.runs
    rows = [tuple(map(float, row)) for row in json.loads(text)]
    return [rows[min(run, len(rows) - 1)] for run in range(recording.runs)]


@dataclass(frozen=True, slots=True, eq=False)
class WoundJob:
    """A product, and the eye of the machine that winds it.

    Parameters
    ----------
    parts
        Where ``NUMBERS`` lie in their tolerances, -1 to 1; None for the product as specified.
    further_m
        Distance by which the eye is further out than its axis shows.
    """

    product: Product
    tool: Tool
    axes: tuple[str, ...]
    parts: tuple[float, ...] | None = None
    further_m: float = 0.0

    def _off(self, number: int) -> float:
        return (self.parts or _ONE)[number]

    @property
    def surface(self) -> Surface:
        """The mandrel with its radius error."""
        error = self.product.radius_error
        by = error.si + self._off(0) * error.tolerance
        return self.product.surface if by == 0.0 else self.product.surface.grown(by)

    @property
    def at_m(self) -> float:
        """Machine position of the mandrel's left end."""
        return self.product.at.si + self._off(1) * self.product.at.tolerance

    @property
    def width_m(self) -> float:
        """Width of the band."""
        return self.product.width.si + self._off(2) * self.product.width.tolerance

    @property
    def slip(self) -> float:
        """Share by which the mandrel lags behind the axis that turns it."""
        return self.product.slip.si + self._off(3) * self.product.slip.tolerance

    @property
    def friction(self) -> float:
        """Friction beyond which the fibre's place is unknown; without ``parts`` its lower end."""
        if self.parts is None:
            return least_friction(self.product)
        return self.product.friction.si + self._off(4) * self.product.friction.tolerance

    @property
    def rings(self) -> tuple[Ring, ...]:
        """The other rotating parts, measured from the mandrel's left end."""
        found, tool = list(self.product.rings), self.tool
        for name, stop, sign in (("chuck", tool.chuck, -1.0), ("tailstock", tool.tailstock, 1.0)):
            if stop is not None:
                face = stop.at.si - self.at_m
                begin, end = sorted((face, face + sign * stop.length.si))
                found.append(Ring(f"the {name}", begin, end, stop.radius.si))
        return tuple(found)

    def eyes(self, positions: FloatArray) -> FloatArray:
        """Return (n, 6) coordinates of the eye from the mandrel's left end."""
        columns = eye_columns(self.tool, self.axes, positions)
        columns[:, 0] *= 1.0 - self.slip
        columns[:, 1] -= self.at_m
        columns[:, 2] += self.further_m
        return columns

    @property
    def reach_m(self) -> float:
        """Largest radius of the mandrel."""
        return float(self.surface.r[:, 0].max())

    def replay(self) -> Replay:
        """Return a replay before its first sample."""
        return Replay(self.surface, self.tool, self.friction, self.product.tied)


def least_friction(product: Product) -> float:
    """Return the lower end of the product's friction."""
    return product.friction.si - product.friction.tolerance


def wound_job(plan: Plan, parts: tuple[float, ...] | None = None) -> WoundJob | None:
    """Return the product of a plan with the machine's eye; None for a plan without one."""
    product, tool = product_of(plan), plan.machine.tool
    if product is None or tool is None:
        return None
    return WoundJob(product, tool, plan.axes, parts)


@dataclass(frozen=True, slots=True, eq=False)
class Wound:
    """Consecutive samples of a run with its replayed fibre.

    ``position``, (n, axes), is the position to report: the command, if recorded. ``eyes`` is (n, 6)
    as ``eye_columns``; ``before_s`` is the time of the sample before, NaN if there is none.
    """

    time_s: FloatArray
    operation: IntArray | None
    position: FloatArray
    fibre: Fibre
    eyes: FloatArray
    before_s: float = np.nan


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Consecutive samples of a run before the replay: (n, axes) to replay, and to report."""

    time_s: FloatArray
    operation: IntArray | None
    places: FloatArray
    position: FloatArray

    def __len__(self) -> int:
        return len(self.time_s)

    def rows(self, part: slice | NDArray[np.bool_]) -> _Samples:
        operation = None if self.operation is None else self.operation[part]
        return _Samples(self.time_s[part], operation, self.places[part], self.position[part])

    def joined(self, more: _Samples) -> _Samples:
        operation = None
        if self.operation is not None and more.operation is not None:
            operation = np.concatenate([self.operation, more.operation])
        return _Samples(
            np.concatenate([self.time_s, more.time_s]),
            operation,
            np.vstack([self.places, more.places]),
            np.vstack([self.position, more.position]),
        )


class _RunReplay:
    """The replay of a run at the samples that ``Thinning`` keeps.

    The last sample waits for the next ones: they decide whether it is kept, and whether more
    samples are judged together with it. So the result does not depend on the size of blocks.
    """

    def __init__(self, job: WoundJob) -> None:
        self._job, self._replay = job, job.replay()
        self._thinning = Thinning(job.tool, job.axes, job.reach_m)
        self._waiting: _Samples | None = None
        self._before_s = np.nan

    def feed(self, read: _Samples) -> Wound:
        """Return the samples that are known to be kept."""
        if self._waiting is not None:
            read = self._waiting.joined(read)
        if not len(read):
            return self._replayed(read, None)
        group = read.operation
        alike = np.zeros(len(read), dtype=np.int64) if group is None else group
        kept = self._thinning.kept(read.time_s, alike, read.places)
        self._waiting = read.rows(slice(-1, None))
        return self._replayed(read.rows(kept), None if group is None else int(group[-1]))

    def rest(self) -> Wound:
        """Return the sample that waits at the end of a run, if it is kept."""
        waiting = self._waiting
        if waiting is None:
            places = np.empty((0, len(self._job.axes)))
            waiting = _Samples(np.empty(0), None, places, places)
        kept = slice(None) if self._thinning.waits else slice(0)
        return self._replayed(waiting.rows(kept), None)

    def _replayed(self, read: _Samples, behind: int | None) -> Wound:
        eyes = self._job.eyes(read.places)
        fibre = self._replay.feed(eyes, read.operation, behind)
        found = Wound(read.time_s, read.operation, read.position, fibre, eyes, self._before_s)
        if len(read):
            self._before_s = float(read.time_s[-1])
        return found


class SharedReplays:
    """The replays of the parallel runs of a recording, shared by all its measures."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.jobs = [wound_job(setting.plan, one) for one in _products_of(setting.recording)]
        self._replays = [_RunReplay(job) for job in self.jobs if job is not None]
        self._block: Block | None = None
        self._found: Sequence[Wound] = ()
        self._rest: Sequence[Wound] | None = None

    def samples(self, block: Block) -> Sequence[Wound]:
        """Return the samples of a block in each run; replayed once."""
        if block is self._block:
            return self._found
        assert block.actual is not None
        found = []
        for run, replay in enumerate(self._replays):
            places = np.ascontiguousarray(block.actual[:, run])
            position = block.actual[:, 0] if block.commanded is None else block.commanded
            found.append(replay.feed(_Samples(block.time_s, block.operation, places, position)))
        self._block, self._found = block, found
        return found

    def rest(self) -> Sequence[Wound]:
        """Return the sample that waits at the end of each run."""
        if self._rest is None:
            self._rest = [replay.rest() for replay in self._replays]
        return self._rest


_LATEST = local()
_ROUNDING = 1e-9


def shared_replays(setting: Setting) -> SharedReplays:
    """Return the shared replays of a run: its measures are started one after the other."""
    latest: SharedReplays | None = getattr(_LATEST, "shared", None)
    if latest is None or latest.setting is not setting:
        latest = SharedReplays(setting)
        _LATEST.shared = latest
    return latest


def with_beginning(plan: Plan) -> Plan:
    """Return a plan whose machine knows how its fibre is tied, if a mandrel is mounted.

    The operator ties the fibre so that it leads to the eye from where the program begins to lay it.
    The machine also gets the setting of the spool's brake for each layer. A plan that lays no fibre
    gets no direction of the tied fibre.

    Raises
    ------
    JobError
        If the brake cannot be set to a tension that the job asks for.
    """
    job, mandrel = wound_job(plan), plan.machine.mounted
    if job is None or mandrel is None:
        return plan
    mandrel = replace(mandrel, brakes=_brakes(plan))
    plan = replace(plan, machine=replace(plan.machine, mounted=mandrel))
    for samples in programmed_fibre(plan, job):
        laid = np.flatnonzero(samples.fibre.state == LAID)
        if not len(laid):
            continue
        at, replay = int(laid[0]), job.replay()
        leads = replay.leads(samples.eyes[at], samples.fibre.u[at], samples.fibre.angle[at])
        tied = replace(mandrel, leads=tuple(leads.tolist()))
        return replace(plan, machine=replace(plan.machine, mounted=tied))
    return plan


def _brakes(plan: Plan) -> tuple[tuple[int, float], ...]:
    """Return operations and the share of the brake's torque from each on; empty if it is fixed."""
    spool = plan.machine.spool
    if spool is None or spool.most_torque is None:
        return ()
    found, most = [], spool.most_torque.si
    for operation, tension_n in tensions_of(plan.job):
        torque = spool.torque_for(tension_n)
        if not 0.0 < torque <= most * (1.0 + _ROUNDING):
            line = plan.intent.lines_of(plan.job, [operation]).get(operation, 0)
            raise JobError(
                f"a tension of {tension_n:.4g} N needs a torque of {torque:.4g} N m, and the brake "
                f"of {plan.machine.name} can be set from above 0 to {most:.4g} N m",
                place=Place(plan.job.file, line) if line else Place(plan.job.file),
                remedy="Ask for another tension, or correct spool.most_torque and the spring arm.",
            )
        found.append((operation, torque / spool.torque.si))
    return tuple(found)


def programmed_fibre(plan: Plan, job: WoundJob) -> Iterator[Wound]:
    """Yield the replay of the programmed path, with several points on long chords."""
    replay, last, reach = job.replay(), None, job.reach_m
    for block in plan.motion.programmed:
        if not len(block):
            continue
        vertices = np.asarray(block.positions)
        before = vertices[:1] if last is None else last
        chain = np.vstack([before, vertices])
        last = chain[-1:]
        eyes = job.eyes(chain)
        step = np.abs(np.diff(eyes, axis=0))
        size = np.maximum(np.hypot(reach * step[:, 0], step[:, 1]), step[:, 2])
        count = np.maximum(np.ceil(size / _FINE_M), 1.0).astype(np.int64)
        row, within = _divided(count)
        points = chain[row] + within[:, None] * (chain[row + 1] - chain[row])
        operation = np.asarray(block.operation)[row]
        eyes = job.eyes(points)
        times = np.full(len(points), np.nan)
        yield Wound(times, operation, points, replay.feed(eyes, operation), eyes)


_LOADS = (ChannelKind.TOOL, ChannelKind.LOAD)


def recorded_fibre(recording: Recording, job: WoundJob) -> Wound | None:
    """Return the replay of a recording of one run; None without a position of every axis."""
    operation = recording.find(ChannelKind.OPERATION)
    channels = [
        next((c for kind in _LOADS if (c := recording.find(kind, axis)) is not None), None)
        for axis in job.axes
    ]
    if operation is None or any(channel is None for channel in channels):
        return None
    names = [channel.name for channel in channels if channel is not None]
    rows, times = [], []
    for block in recording.blocks:
        row = [block.samples[name] for name in (operation.name, *names) if name in block.samples]
        if len(row) != 1 + len(names) or len({part.shape for part in row}) > 1:
            return None
        rows.append(row)
        ticks = block.first_tick[operation.clock.name] + operation.stride * np.arange(len(row[0]))
        times.append(float(operation.clock.period_s) * ticks)
    columns = [np.concatenate(column) for column in zip(*rows, strict=True)]
    if not columns or columns[0].ndim != 1:
        return None
    of, places = columns[0].astype(np.int64), np.column_stack(columns[1:])
    eyes = job.eyes(places)
    return Wound(np.concatenate(times), of, places, job.replay().feed(eyes, of), eyes)


def planned_fibre(plan: Plan, job: WoundJob) -> Iterator[Wound]:
    """Yield the replay of the planned motion, at points with a chord error of at most 5 um."""
    replay, scale = _RunReplay(job), moves_of(job.tool, job.axes, job.reach_m)
    for block in plan.motion.trajectory:
        if not len(block):
            continue
        order = block.coefficients.shape[1]
        size = np.abs(block.coefficients) * scale
        length = np.linalg.norm(size[:, 1:].sum(axis=1), axis=1)
        # The chord error over a share h of a piece is at most h^2 / 8 of its second derivative.
        second = np.arange(order) * (np.arange(order) - 1.0)
        bent = np.linalg.norm(np.tensordot(size, second, axes=(1, 0)), axis=1)
        count = np.maximum(np.ceil(length / LONGEST_M), np.ceil(np.sqrt(bent / (8.0 * STRAIGHT_M))))
        row, share = _divided(np.maximum(count, 1.0).astype(np.int64))
        points = np.zeros((len(row), block.coefficients.shape[2]))
        for power in range(order - 1, -1, -1):
            points = points * share[:, None] + block.coefficients[row, power]
        operation = np.maximum.accumulate(block.operation)[row]
        times = block.start_s[row] + share * block.duration_s[row]
        yield _timeless(replay.feed(_Samples(times, operation, points, points)))
    yield _timeless(replay.rest())


def _divided(count: IntArray) -> tuple[IntArray, FloatArray]:
    """Return the row of each part, for rows with (n,) parts, and the share where the part ends."""
    row = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[row]
    return row, share


def _timeless(samples: Wound) -> Wound:
    """Return samples of a plan without times: messages name their lines instead."""
    return replace(samples, time_s=np.full(len(samples.time_s), np.nan))
