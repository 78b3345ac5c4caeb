"""Measures of the laid fibre, by the replay of a run or of the planned motion on its product.

``criteria_of`` returns the criteria that a winder's product, and the spool of its fibre, add to a
specification.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.machine.spool import Spool
from threadline.verdict.finding import Finding, RunFindings, Worst
from threadline.verdict.laid_error import Apart
from threadline.verdict.measure import Measure, Option
from threadline.verdict.pattern import NEVER_KNOWN, CoverageGap, PatternClosure
from threadline.verdict.replayed import (
    Wound,
    WoundJob,
    least_friction,
    planned_fibre,
    shared_replays,
    wound_job,
)
from threadline.verdict.samples import Block, Setting
from threadline.verdict.types import Criterion
from threadline.winding.laying import BRIDGED, LIFTED, WAITING
from threadline.winding.product import Product

_NO_PRODUCT = "no product: give --product NAME.wind.toml"
EVENNESS_OPTIONS = {"over": Option(unit="s", default=0.02, above_0=True)}
_AT_REST_M_S = 1e-4  # speed of the fibre below which it rests: no winding is as slow
_LEAST_M = 5e-5  # limit on lifted and bridged lengths: a tow is thicker
MOST_VARIATION = 0.05
"""Largest allowed variation of the tension, from section 2.4 of the winder thesis."""


Values = Callable[[Wound, int], FloatArray]
"""Returns (n,) values of a run, NaN where there is none."""
Note = Callable[[Wound, int, int], str]
"""Returns a remark on the value of a run at a sample."""


class _Largest:
    """The largest value of each run."""

    def __init__(self, runs: int, axes: int, values: Values, note: Note | None = None) -> None:
        self._worst = Worst(runs, axes, note=NEVER_KNOWN)
        self._values, self._note, self._axes = values, note, axes

    def take(self, runs: Sequence[Wound]) -> None:
        """Take the next samples of every run."""
        most, time_s = np.full(len(runs), np.nan), np.full(len(runs), np.nan)
        operation = np.full(len(runs), -1, dtype=np.int64)
        position, note = np.zeros((len(runs), self._axes)), np.full(len(runs), "", dtype=object)
        for run, samples in enumerate(runs):
            values = self._values(samples, run)
            safe = np.where(np.isnan(values), -np.inf, values)
            at = int(safe.argmax()) if len(safe) else -1
            if at < 0 or not safe[at] > self._worst.value[run]:
                continue
            most[run] = safe[at]
            time_s[run], position[run] = samples.time_s[at], samples.position[at]
            if samples.operation is not None:
                operation[run] = self._operations(samples.operation, run)[at]
            if self._note is not None:
                note[run] = self._note(samples, run, at)
        self._worst.offer(most, time_s=time_s, operation=operation, position=position, note=note)

    def _operations(self, operation: IntArray, run: int) -> IntArray:  # noqa: ARG002
        """Return the operation that each value belongs to."""
        return operation

    def found(self) -> RunFindings:
        """Return the worst of each run."""
        return self._worst.found()


class _Lifted(_Largest):
    """The longest fibre that is unwound at once, at the operation where the unwinding begins."""

    def __init__(self, runs: int, axes: int) -> None:
        super().__init__(runs, axes, _lifted)
        self._begun: IntArray = np.full(runs, -1, dtype=np.int64)
        self._began: list[IntArray] = [np.empty(0, dtype=np.int64)] * runs

    def take(self, runs: Sequence[Wound]) -> None:
        """Take the next samples of every run."""
        for run, samples in enumerate(runs):
            if samples.operation is None or not len(samples.operation):
                continue
            lifted = samples.fibre.state == LIFTED
            first = lifted & ~np.concatenate([[self._begun[run] >= 0], lifted[:-1]])
            began = _held(np.where(first, samples.operation, -1), self._begun[run])
            self._begun[run] = began[-1] if lifted[-1] else -1
            self._began[run] = began
        super().take(runs)

    def _operations(self, operation: IntArray, run: int) -> IntArray:
        began = self._began[run]
        return np.where(began >= 0, began, operation)


def _held(values: IntArray, before: int) -> IntArray:
    """Return (n,) values with -1 replaced by the previous value."""
    known = np.concatenate([[True], values >= 0])
    places = np.maximum.accumulate(np.where(known, np.arange(len(known)), 0))
    return np.concatenate([[before], values])[places][1:]


class _OfRun:
    """A measure that takes the samples of the shared replays."""

    def __init__(
        self, setting: Setting, taking: _Largest | CoverageGap | PatternClosure | _Evenness
    ) -> None:
        self._shared, self._taking = shared_replays(setting), taking

    def feed(self, block: Block) -> None:
        """Take the next samples."""
        self._taking.take(self._shared.samples(block))

    def finish(self) -> Sequence[RunFindings]:
        """Return the worst of each run."""
        self._taking.take(self._shared.rest())
        return [self._taking.found()]


class _Absent:
    """A measure of a run without a product."""

    def __init__(self, runs: int, why: str) -> None:
        self._runs, self._why = runs, why

    def feed(self, block: Block) -> None:
        """Do nothing."""

    def finish(self) -> Sequence[RunFindings]:
        """Return the reason for every run."""
        return [RunFindings.alike(Finding(value=None, note=self._why), self._runs)]


def _steer(samples: Wound, _run: int) -> FloatArray:
    fibre = samples.fibre
    return np.where(fibre.known, np.abs(fibre.steer), np.nan)


def _wobble(samples: Wound, _run: int, at: int) -> str:
    """Return in words how much the steering varies at a sample, and a step that would halve it."""
    fibre = samples.fibre
    low, high = float(fibre.least[at]), float(fibre.most[at])
    if not np.isfinite(high - low) or high - low < 1e-3:
        return ""
    before = np.flatnonzero(np.isfinite(fibre.steer[:at]))
    step = fibre.length_m[at] - (fibre.length_m[before[-1]] if len(before) else np.nan)
    halved = f"; steps of {5e2 * step:.2g} mm would halve that" if np.isfinite(step) else ""
    return f"it wobbles from {1e2 * low:.1f} to {1e2 * high:.1f} %{halved}"


def _bridged(samples: Wound, _run: int) -> FloatArray:
    fibre = samples.fibre
    return np.where(fibre.known, np.where(fibre.state == BRIDGED, fibre.bridge_m, 0.0), np.nan)


def _lifted(samples: Wound, _run: int) -> FloatArray:
    fibre = samples.fibre
    return np.where(fibre.known | (fibre.lifted_m > 0.0), fibre.lifted_m, np.nan)


def _free(samples: Wound, _run: int) -> FloatArray:
    fibre = samples.fibre
    return np.where(fibre.known, fibre.free_m, np.nan)


def _slack(samples: Wound, _run: int) -> FloatArray:
    fibre = samples.fibre
    return np.where(fibre.state == WAITING, np.nan, fibre.slack_m)


def _paid_out(samples: Wound, _run: int) -> FloatArray:
    fibre, step_s = samples.fibre, np.diff(samples.time_s, prepend=samples.before_s)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(fibre.known, np.abs(fibre.used_m) / step_s, np.nan)


class _Evenness:
    """Standard deviation of the speed of the fibre over its mean, of each run.

    Speeds are means over ``over_s``, from the first known place to the last fibre drawn: a rest in
    between counts, the rest at the end does not.
    """

    def __init__(self, runs: int, axes: int, over_s: float) -> None:
        self._worst = Worst(runs, axes, note=NEVER_KNOWN)
        self._over_s = over_s
        # Time and drawn length from the beginning of the open window on; None: nothing is known.
        self._open: list[tuple[FloatArray, FloatArray] | None] = [None] * runs
        # Number, sum and sum of squares of the speeds; the same since the fibre last moved.
        self._sums, self._still = np.zeros((runs, 3)), np.zeros((runs, 3))

    def take(self, runs: Sequence[Wound]) -> None:
        """Take the next samples of every run."""
        for run, samples in enumerate(runs):
            known = samples.fibre.known
            ends = np.flatnonzero(np.diff(known.astype(np.int8), prepend=0, append=0))
            if not len(known):
                continue  # a block whose samples all wait for the next ones
            if not known[0]:
                self._open[run] = None
            before_s = np.concatenate([[samples.before_s], samples.time_s])
            for begin, end in ends.reshape(-1, 2).tolist():
                drawn = np.cumsum(samples.fibre.used_m[begin:end])
                time_s, length = self._open[run] or (before_s[begin : begin + 1], np.zeros(1))
                time_s = np.concatenate([time_s, samples.time_s[begin:end]])
                length = np.concatenate([length, length[-1] + drawn])
                self._open[run] = self._windows(run, time_s, length)
                if end < len(known):
                    self._open[run] = None

    def _windows(
        self, run: int, time_s: FloatArray, length: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Add the whole windows of a stretch; return the rest of the stretch."""
        count = int((time_s[-1] - time_s[0]) / self._over_s + 1e-9)
        edges = time_s[0] + self._over_s * np.arange(count + 1)
        drawn = np.interp(edges, time_s, length)
        self._add(run, np.diff(drawn) / self._over_s)
        rest = time_s > edges[-1]
        return (
            np.concatenate([edges[-1:], time_s[rest]]),
            np.concatenate([drawn[-1:], length[rest]]),
        )

    def _add(self, run: int, speeds: FloatArray) -> None:
        if not len(speeds):
            return
        moving = np.flatnonzero(speeds > _AT_REST_M_S)
        drawn = int(moving[-1]) + 1 if len(moving) else 0
        if drawn:
            self._sums[run] += self._still[run] + _powers(speeds[:drawn])
            self._still[run] = 0.0
        self._still[run] += _powers(speeds[drawn:])

    def found(self) -> RunFindings:
        """Return the unevenness of each run."""
        values, notes = [], []
        for count, total, squares in self._sums.tolist():
            mean = total / count if count else np.nan
            even = mean > 0.0
            values.append(np.sqrt(max(squares / count - mean**2, 0.0)) / mean if even else np.nan)
            notes.append(f"mean {1e3 * mean:.4g} mm/s" if even else "")
        self._worst.offer(np.array(values), note=np.array(notes, dtype=object))
        return self._worst.found()


def _powers(speeds: FloatArray) -> FloatArray:
    return np.array([len(speeds), speeds.sum(), (speeds**2).sum()])


class Near:
    """By how much eye, arm and free fibre come nearer to rotating parts than the product allows."""

    def __init__(self, jobs: Sequence[WoundJob]) -> None:
        from threadline.winding.clearance import Clearance

        self._runs = [
            Clearance(
                job.surface, job.rings, job.tool, job.product.clearance or 0.0,
                job.width_m * (job.product.thickness or 0.0), job.width_m,
            )
            for job in jobs
        ]  # fmt: skip

    def __call__(self, samples: Wound, run: int) -> FloatArray:
        """Return (n,) lengths, m, by which a run is too near; 0 where it was nearer before."""
        return self._runs[run].feed(samples.eyes, samples.fibre)

    def words(self, run: int, at: int) -> str:
        """Return in words which bodies are too near at a sample of the latest block."""
        one = self._runs[run]
        return one.words(int(one.pair[at])) if one.too_near else ""


_OF_FIBRE: Mapping[str, tuple[Values, Note | None]] = {
    "slip_tendency": (_steer, _wobble),
    "bridging": (_bridged, None),
    "free_length": (_free, None),
    "slack": (_slack, None),
    "fibre_speed": (_paid_out, None),
}


def starter(name: str) -> Callable[[Setting, Mapping[str, float]], Measure]:
    """Return the starter of a measure of the laid fibre."""

    def start(setting: Setting, options: Mapping[str, float]) -> Measure:
        runs, axes, plan = setting.runs, len(setting.axes), setting.plan
        shared = shared_replays(setting)
        jobs = [job for job in shared.jobs if job is not None]
        if not jobs:
            return _Absent(runs, _NO_PRODUCT)
        if name == "coverage_gap":
            if jobs[0].product.covered is None:
                return _Absent(runs, "the product names no [coverage]")
            return _OfRun(setting, CoverageGap(jobs, axes))
        if name == "pattern_closure":
            return _OfRun(setting, PatternClosure(jobs, axes))
        if name == "clearance":
            near = Near(jobs)
            noted = _Largest(runs, axes, near, lambda _, run, at: near.words(run, at))
            return _OfRun(setting, noted)
        if name == "laid_error":
            return _OfRun(setting, _Largest(runs, axes, Apart(plan, jobs)))
        if name == "fibre_speed_variation":
            return _OfRun(setting, _Evenness(runs, axes, options["over"]))
        if name == "lifting":
            return _OfRun(setting, _Lifted(runs, axes))
        values, note = _OF_FIBRE[name]
        return _OfRun(setting, _Largest(runs, axes, values, note))

    return start


MEASURED = (
    *_OF_FIBRE, "fibre_speed_variation", "lifting", "clearance", "laid_error", "pattern_closure",
    "coverage_gap",
)  # fmt: skip
"""Names of the measures of a run."""
PLANNED = (
    "planned_slip_tendency", "planned_bridging", "planned_lifting", "planned_pattern_closure",
    "planned_coverage_gap",
)  # fmt: skip
"""Names of the measures of the planned motion."""


def measure_planned(plan: Plan) -> dict[str, list[Finding]]:
    """Return the measures of the fibre that the planned motion lays."""
    job = wound_job(plan)
    if job is None:
        return {name: [Finding(value=None, note=_NO_PRODUCT)] for name in PLANNED}
    axes = len(plan.axes)
    taking: dict[str, _Largest | CoverageGap | PatternClosure] = {
        f"planned_{name}": _Largest(1, axes, *_OF_FIBRE[name])
        for name in ("slip_tendency", "bridging")
    }
    taking["planned_lifting"] = _Lifted(1, axes)
    taking["planned_pattern_closure"] = PatternClosure([job], axes)
    if job.product.covered is not None:
        taking["planned_coverage_gap"] = CoverageGap([job], axes)
    from threadline.winding.fit import Witness

    witness = Witness(job.surface, job.tool.payout_m)
    for samples in planned_fibre(plan, job):
        witness.take(samples.eyes, samples.fibre)
        for one in taking.values():
            one.take([samples])
    found = {name: [one.found().worst()] for name, one in taking.items()}
    slip = found["planned_slip_tendency"][0]
    friction = least_friction(job.product)
    note = ""
    if slip.value is None:
        note = f"{NEVER_KNOWN}: {witness.reason()}"
    elif slip.value > friction:
        fit = witness.fit(job.tool, friction, job.product.tied)
        note = "; ".join(text for text in (slip.note, fit) if text)
    if note:
        found["planned_slip_tendency"] = [replace(slip, note=note)]
    return found


def criteria_of(
    product: Product, spool: Spool | None = None, tensions_n: Sequence[float] = ()
) -> tuple[Criterion, ...]:
    """Return the criteria that a product adds to the specification.

    The arm of a spool limits the slack, unless the product has a ``take_up``; and the tension may
    vary by ``MOST_VARIATION``. An adjustable brake follows the tensions of the layers: the smallest
    take-up of the arm at one of them counts.
    """
    slip = least_friction(product)
    take_up = product.take_up
    if take_up is None and spool is not None:
        follows = tensions_n if spool.most_torque is not None else ()
        take_up = min((spool.take_up_at(one) for one in follows), default=spool.take_up_m)
    limits: dict[str, float | None] = {
        "planned_slip_tendency": slip,
        "planned_bridging": _LEAST_M,
        "planned_lifting": _LEAST_M,
        "slip_tendency": slip,
        "bridging": _LEAST_M,
        "lifting": _LEAST_M,
        "clearance": 0.0,
        "slack": take_up,
        "laid_error": None,
        "free_length": None,
        "fibre_speed": None,
        "fibre_speed_variation": None,
        "planned_pattern_closure": None,
        "pattern_closure": None,
    }
    if product.covered is not None:
        limits |= {"planned_coverage_gap": product.gap, "coverage_gap": product.gap}
    found = [
        Criterion(name=name, limit=limit, required=limit is not None)
        for name, limit in limits.items()
    ]
    if spool is not None:
        # Not required: a real machine may have no sensor of the tension.
        found.append(Criterion(name="tension_variation", limit=MOST_VARIATION))
    return tuple(found)
