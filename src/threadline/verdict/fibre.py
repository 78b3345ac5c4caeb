"""Measures of the laid fibre, by the replay of a run or of the planned motion on its product."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from threading import local

import numpy as np
from scipy.spatial import cKDTree

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.commands.plan import Plan
from threadline.machine.parts import Tool
from threadline.verdict.finding import Finding, Found, Worst
from threadline.verdict.measure import Measure
from threadline.verdict.samples import Block, Setting
from threadline.verdict.types import Criterion
from threadline.winding.laying import BRIDGED, WAITING
from threadline.winding.product import Product, product_of_text
from threadline.winding.raster import Raster
from threadline.winding.replay import Fibre, Replay, eye_columns
from threadline.winding.surface import Surface

_NO_PRODUCT = "no product: give --product NAME.wind.toml"
_NEVER = (
    "the fibre is never known: nothing is laid on this mandrel for five free lengths in a row; is "
    "it the mandrel of this program?"
)
_PER_PIECE = 8  # points on a planned piece
_DRAWS = 20_000_717  # seed of the products within their tolerances
_NEAR_M = 0.02  # laid fibre beside a place where the designed fibre is looked for
_FINE_M = 5e-4  # longest chord of the designed fibre
_OUTLINE = 8193  # places of the meridian for the distance of the eye


def product_of(plan: Plan) -> Product | None:
    """Return the product of a plan; None for a plan without one."""
    text = plan.options.get("product")
    return None if text is None else product_of_text(text)


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    """A product beside the eye of its machine.

    Parameters
    ----------
    number
        Number of a product drawn within its tolerances; None for the product as it is.
    """

    product: Product
    tool: Tool
    axes: tuple[str, ...]
    number: int | None = None

    @property
    def _draws(self) -> FloatArray:
        """(3,) of -1 to 1: errors of the radius, of the place and of the width of the band."""
        if self.number is None:
            return np.zeros(3)
        return np.random.default_rng((_DRAWS, self.number)).uniform(-1.0, 1.0, 3)

    @property
    def surface(self) -> Surface:
        """The mandrel with its error of radius."""
        error = self.product.radius_error
        by = error.si + float(self._draws[0]) * error.tolerance
        return self.product.surface if by == 0.0 else self.product.surface.grown(by)

    @property
    def at_m(self) -> float:
        """Machine place of its left end."""
        return self.product.at.si + float(self._draws[1]) * self.product.at.tolerance

    @property
    def width_m(self) -> float:
        """Width of the band."""
        return self.product.width.si + float(self._draws[2]) * self.product.width.tolerance

    def eyes(self, positions: FloatArray) -> FloatArray:
        """Return (n, 6) coordinates of the eye from the mandrel's left end."""
        columns = eye_columns(self.tool, self.axes, positions)
        columns[:, 1] -= self.at_m
        return columns

    def replay(self) -> Replay:
        """Return a replay that has read nothing."""
        return Replay(self.surface, self.tool, least_friction(self.product), self.product.tied)


def least_friction(product: Product) -> float:
    """Return the lower end of the product's friction."""
    return product.friction.si - product.friction.tolerance


def _job(plan: Plan, number: int | None = None) -> _Job | None:
    product, tool = product_of(plan), plan.machine.tool
    if product is None or tool is None:
        return None
    return _Job(product, tool, plan.axes, number)


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Consecutive samples of parallel runs with their replayed fibres."""

    time_s: FloatArray
    operation: IntArray | None
    actual: FloatArray
    fibres: Sequence[Fibre]
    eyes: Sequence[FloatArray]


class _Shared:
    """The replays of the parallel runs of a recording, which all measures of it share."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        drawn = setting.recording.origin.get("drawn")
        numbers = [None if drawn is None else int(drawn) + run for run in range(setting.runs)]
        self.jobs = [_job(setting.plan, number) for number in numbers]
        self._replays = [None if job is None else job.replay() for job in self.jobs]
        self._block: Block | None = None
        self._found: _Samples | None = None

    def samples(self, block: Block) -> _Samples:
        """Return the samples of a block; replayed once."""
        if block is self._block and self._found is not None:
            return self._found
        assert block.actual is not None
        fibres, eyes = [], []
        for run, (job, replay) in enumerate(zip(self.jobs, self._replays, strict=True)):
            assert job is not None and replay is not None
            eyes.append(job.eyes(np.ascontiguousarray(block.actual[:, run])))
            fibres.append(replay.feed(eyes[-1], block.operation))
        actual = block.actual[:, 0] if block.commanded is None else block.commanded
        self._block = block
        self._found = _Samples(block.time_s, block.operation, actual, fibres, eyes)
        return self._found


_LATEST = local()


def _shared(setting: Setting) -> _Shared:
    """Return the replays of a run: the measures of a run are started one after the other."""
    latest: _Shared | None = getattr(_LATEST, "shared", None)
    if latest is None or latest.setting is not setting:
        latest = _Shared(setting)
        _LATEST.shared = latest
    return latest


Values = Callable[[_Samples, int], FloatArray]
"""Returns (n,) values of a run, NaN where there is none."""


class _Largest:
    """The largest value of each run."""

    def __init__(
        self, runs: int, axes: int, values: Values, note: Callable[[Fibre, int], str] | None = None
    ) -> None:
        self._worst = Worst(runs, axes, note=_NEVER)
        self._values, self._note = values, note

    def take(self, samples: _Samples) -> None:
        """Take the next samples."""
        rows = [self._values(samples, run) for run in range(len(samples.fibres))]
        values = np.column_stack(rows)
        safe = np.where(np.isnan(values), -np.inf, values)
        at = safe.argmax(axis=0)
        most = safe[at, np.arange(len(at))]
        if not self._worst.is_beaten(most):
            return
        notes = [
            "" if self._note is None else self._note(fibre, int(row))
            for fibre, row in zip(samples.fibres, at, strict=True)
        ]
        self._worst.offer(
            np.where(np.isneginf(most), np.nan, most),
            time_s=samples.time_s[at],
            operation=None if samples.operation is None else samples.operation[at],
            position=samples.actual[at],
            note=np.array(notes, dtype=object),
        )

    def found(self) -> Found:
        """Return the worst of each run."""
        return self._worst.found()


class _OfRun:
    """A measure that takes the samples of the shared replays."""

    def __init__(self, setting: Setting, taking: _Largest | _Covering) -> None:
        self._shared, self._taking = _shared(setting), taking

    def feed(self, block: Block) -> None:
        """Take the next samples."""
        self._taking.take(self._shared.samples(block))

    def finish(self) -> Sequence[Found]:
        """Return the worst of each run."""
        return [self._taking.found()]


class _Absent:
    """A measure of a run without a product."""

    def __init__(self, runs: int, why: str) -> None:
        self._runs, self._why = runs, why

    def feed(self, block: Block) -> None:
        """Do nothing."""

    def finish(self) -> Sequence[Found]:
        """Return the reason for every run."""
        return [Found.alike(Finding(value=None, note=self._why), self._runs)]


def _steer(samples: _Samples, run: int) -> FloatArray:
    fibre = samples.fibres[run]
    return np.where(fibre.known, np.abs(fibre.steer), np.nan)


def _wobble(fibre: Fibre, at: int) -> str:
    """Say how far the steering wobbles in a block, and which step would halve it."""
    low, high = float(fibre.least[at]), float(fibre.most[at])
    if not np.isfinite(high - low) or high - low < 1e-3:
        return ""
    before = np.flatnonzero(np.isfinite(fibre.steer[:at]))
    step = fibre.length_m[at] - (fibre.length_m[before[-1]] if len(before) else np.nan)
    halved = f"; steps of {5e2 * step:.2g} mm would halve that" if np.isfinite(step) else ""
    return f"it wobbles from {1e2 * low:.1f} to {1e2 * high:.1f} %{halved}"


def _bridged(samples: _Samples, run: int) -> FloatArray:
    fibre = samples.fibres[run]
    return np.where(fibre.known, np.where(fibre.state == BRIDGED, fibre.bridge_m, 0.0), np.nan)


def _lifted(samples: _Samples, run: int) -> FloatArray:
    fibre = samples.fibres[run]
    return np.where(fibre.known | (fibre.lifted_m > 0.0), fibre.lifted_m, np.nan)


def _free(samples: _Samples, run: int) -> FloatArray:
    fibre = samples.fibres[run]
    return np.where(fibre.known, fibre.free_m, np.nan)


def _slack(samples: _Samples, run: int) -> FloatArray:
    fibre = samples.fibres[run]
    return np.where(fibre.state == WAITING, np.nan, fibre.slack_m)


def _paid_out(samples: _Samples, run: int) -> FloatArray:
    fibre, step_s = samples.fibres[run], np.diff(samples.time_s, prepend=np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(fibre.known, np.abs(fibre.used_m) / step_s, np.nan)


class _Near:
    """How far the eye comes nearer to the mandrel than the product allows."""

    def __init__(self, jobs: Sequence[_Job]) -> None:
        self._trees, self._outlines, self._wanted = [], [], []
        for job in jobs:
            surface = job.surface
            x, r = surface.at(np.linspace(0.0, surface.length_m, _OUTLINE))
            self._outlines.append((x[:, 0], r[:, 0]))
            self._trees.append(cKDTree(np.column_stack([x[:, 0], r[:, 0]])))
            self._wanted.append(job.product.clearance or 0.0)

    def __call__(self, samples: _Samples, run: int) -> FloatArray:
        eyes, (x, r) = samples.eyes[run], self._outlines[run]
        place = np.column_stack([eyes[:, 1], np.hypot(eyes[:, 2], eyes[:, 3])])
        distance = np.asarray(self._trees[run].query(place)[0])
        inside = (place[:, 0] > x[0]) & (place[:, 0] < x[-1])
        inside &= place[:, 1] < np.interp(place[:, 0], x, r)
        signed = np.where(inside, -distance, distance)
        return np.asarray(np.maximum(self._wanted[run] - signed, 0.0))


@njit(nogil=True)
def _off_design(
    points: FloatArray, operation: IntArray, design: FloatArray, of: IntArray, state: IntArray
) -> FloatArray:
    """Return (n,) distances of points to the designed fibre, searched in order along it.

    ``design`` is (m, 4): place and laid length; ``of`` its operations; ``state`` the chord of the
    point before, -1 for none.
    """
    found = np.full(len(points), np.nan)
    near = state[0]
    for i in range(len(points)):
        if np.isnan(points[i, 0]):
            continue
        if near < 0:
            near = min(np.searchsorted(of, operation[i]), len(design) - 2)
        low, high = near, near
        while low > 0 and design[near, 3] - design[low, 3] < _NEAR_M:
            low -= 1
        while high < len(design) - 2 and design[high, 3] - design[near, 3] < _NEAR_M:
            high += 1
        best = np.inf
        for k in range(low, high + 1):
            span, along = 0.0, 0.0
            for j in range(3):
                d = design[k + 1, j] - design[k, j]
                span += d * d
                along += d * (points[i, j] - design[k, j])
            share = min(max(along / span, 0.0), 1.0) if span > 0.0 else 0.0
            away = 0.0
            for j in range(3):
                d = points[i, j] - design[k, j] - share * (design[k + 1, j] - design[k, j])
                away += d * d
            if away < best:
                best, near = away, k
        found[i] = np.sqrt(best)
    state[0] = near
    return found


def _points(surface: Surface, fibre: Fibre) -> FloatArray:
    """Return (n, 3) places in the mandrel's frame; NaN where they are not known."""
    u = np.where(fibre.known, fibre.u, 0.0)
    x, r = (values[:, 0] for values in surface.at(u))
    places = np.column_stack([x, r * np.cos(fibre.angle), r * np.sin(fibre.angle)])
    places[~fibre.known] = np.nan
    return places


class _Apart:
    """Distance between the laid fibre and the fibre of the program."""

    def __init__(self, plan: Plan, jobs: Sequence[_Job]) -> None:
        job = _job(plan)
        assert job is not None
        rows, operations = [], []
        for samples in _programmed(plan, job):
            fibre = samples.fibres[0]
            points = _points(job.surface, fibre)
            kept = np.isfinite(points[:, 0])
            rows.append(np.column_stack([points, fibre.length_m])[kept])
            assert samples.operation is not None
            operations.append(samples.operation[kept])
        self._design = np.vstack(rows) if rows else np.empty((0, 4))
        self._of = np.concatenate(operations) if rows else np.empty(0, dtype=np.int64)
        self._surfaces = [job.surface for job in jobs]
        self._state = [np.full(1, -1, dtype=np.int64) for _ in jobs]

    def __call__(self, samples: _Samples, run: int) -> FloatArray:
        fibre = samples.fibres[run]
        if len(self._design) < 2 or samples.operation is None:
            return np.full(len(fibre), np.nan)
        points = _points(self._surfaces[run], fibre)
        return np.asarray(
            _off_design(points, samples.operation, self._design, self._of, self._state[run])
        )


def _programmed(plan: Plan, job: _Job) -> Iterator[_Samples]:
    """Yield the replay of the programmed path, with several points on long chords."""
    replay, last = job.replay(), None
    reach = float(job.surface.r[:, 0].max())
    for block in plan.motion.programmed:
        if not len(block):
            continue
        vertices = np.asarray(block.positions)
        before = vertices[:1] if last is None else last
        chain = np.vstack([before, vertices])
        last = chain[-1:]
        eyes = job.eyes(chain)
        way = np.abs(np.diff(eyes, axis=0))
        size = np.maximum(np.hypot(reach * way[:, 0], way[:, 1]), way[:, 2])
        count = np.maximum(np.ceil(size / _FINE_M), 1.0).astype(np.int64)
        row = np.repeat(np.arange(len(count)), count)
        within = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[row]
        points = chain[row] + within[:, None] * (chain[row + 1] - chain[row])
        operation = np.asarray(block.operation)[row]
        eyes = job.eyes(points)
        times = np.full(len(points), np.nan)
        yield _Samples(times, operation, points, [replay.feed(eyes, operation)], [eyes])


def _planned_samples(plan: Plan, job: _Job) -> Iterator[_Samples]:
    """Yield the replay of the planned motion."""
    replay = job.replay()
    for block in plan.motion.trajectory:
        if not len(block):
            continue
        order = block.coefficients.shape[1]
        count = _PER_PIECE if order > 2 else 1
        powers = (np.arange(1, count + 1) / count)[:, None] ** np.arange(order)
        points = np.einsum("uk,nka->nua", powers, block.coefficients)
        points = points.reshape(-1, points.shape[2])
        operation = np.maximum.accumulate(np.repeat(block.operation, count))
        eyes = job.eyes(points)
        times = np.full(len(points), np.nan)
        yield _Samples(times, operation, points, [replay.feed(eyes, operation)], [eyes])


class _Covering:
    """The largest gap between the bands of each run."""

    def __init__(self, jobs: Sequence[_Job], axes: int) -> None:
        self._worst = Worst(len(jobs), axes, note=_NEVER)
        self._rasters = []
        for job in jobs:
            begin, end = job.product.covered or (0.0, 0.0)
            self._rasters.append(Raster(job.surface, job.width_m, begin, end))

    def take(self, samples: _Samples) -> None:
        """Lay the bands of the next samples."""
        for raster, fibre in zip(self._rasters, samples.fibres, strict=True):
            operation = samples.operation
            lines = np.zeros(len(fibre), dtype=np.int64) if operation is None else operation
            raster.lay(fibre.u, fibre.angle, fibre.winding, fibre.known, lines)

    def found(self) -> Found:
        """Return the largest gap of each run, beside the operation that laid the band there."""
        gaps = [raster.gap() for raster in self._rasters]
        self._worst.offer(
            np.array([gap.width_m for gap in gaps]),
            operation=np.array([gap.operation for gap in gaps]),
            note=np.array([gap.words for gap in gaps], dtype=object),
        )
        return self._worst.found()


_OF_FIBRE: Mapping[str, tuple[Values, Callable[[Fibre, int], str] | None]] = {
    "slip_tendency": (_steer, _wobble),
    "bridging": (_bridged, None),
    "lifting": (_lifted, None),
    "free_length": (_free, None),
    "slack": (_slack, None),
    "fibre_speed": (_paid_out, None),
}


def starter(name: str) -> Callable[[Setting, Mapping[str, float]], Measure]:
    """Return the starter of a measure of the laid fibre."""

    def start(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
        runs, axes, plan = setting.runs, len(setting.axes), setting.plan
        shared = _shared(setting)
        jobs = [job for job in shared.jobs if job is not None]
        if not jobs:
            return _Absent(runs, _NO_PRODUCT)
        if name == "coverage_gap":
            if jobs[0].product.covered is None:
                return _Absent(runs, "the product names no [coverage]")
            return _OfRun(setting, _Covering(jobs, axes))
        if name == "clearance":
            return _OfRun(setting, _Largest(runs, axes, _Near(jobs)))
        if name == "laid_error":
            return _OfRun(setting, _Largest(runs, axes, _Apart(plan, jobs)))
        values, note = _OF_FIBRE[name]
        return _OfRun(setting, _Largest(runs, axes, values, note))

    return start


MEASURED = (*_OF_FIBRE, "clearance", "laid_error", "coverage_gap")
"""Names of the measures of a run."""
PLANNED = ("planned_slip_tendency", "planned_bridging", "planned_lifting", "planned_coverage_gap")
"""Names of the measures of the planned motion."""


def measure_planned(plan: Plan) -> dict[str, list[Finding]]:
    """Return the measures of the fibre that the planned motion lays."""
    job = _job(plan)
    if job is None:
        return {name: [Finding(value=None, note=_NO_PRODUCT)] for name in PLANNED}
    axes = len(plan.axes)
    taking: dict[str, _Largest | _Covering] = {
        f"planned_{name}": _Largest(1, axes, *_OF_FIBRE[name])
        for name in ("slip_tendency", "bridging", "lifting")
    }
    if job.product.covered is not None:
        taking["planned_coverage_gap"] = _Covering([job], axes)
    for samples in _planned_samples(plan, job):
        for one in taking.values():
            one.take(samples)
    return {name: [one.found().worst()] for name, one in taking.items()}


_LEAST_M = 5e-5  # lifted or bridged: a tow is thicker


def criteria_of(product: Product) -> tuple[Criterion, ...]:
    """Return the criteria that a product asks for, beside those of the specification."""
    slip = least_friction(product)
    wanted: dict[str, float | None] = {
        "planned_slip_tendency": slip,
        "planned_bridging": _LEAST_M,
        "planned_lifting": _LEAST_M,
        "slip_tendency": slip,
        "bridging": _LEAST_M,
        "lifting": _LEAST_M,
        "clearance": 0.0,
        "slack": product.take_up,
        "laid_error": None,
        "free_length": None,
        "fibre_speed": None,
    }
    if product.covered is not None:
        wanted |= {"planned_coverage_gap": product.gap, "coverage_gap": product.gap}
    return tuple(
        Criterion(name=name, limit=limit, required=limit is not None)
        for name, limit in wanted.items()
    )
