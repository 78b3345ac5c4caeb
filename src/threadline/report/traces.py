"""Choice of the run that a figure shows: the one with the worst value of a criterion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.files import Recording
from threadline.motion.timing import Trajectory
from threadline.motion.timing.types import TrajectoryReader
from threadline.proof.pipeline import Proof
from threadline.verdict import Result, Verdict, as_intended
from threadline.verdict.along import contour_along
from threadline.verdict.blocks import judged_blocks, setting_of
from threadline.verdict.samples import Block


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnRun:
    """The run that a figure shows.

    Parameters
    ----------
    recording
        Recording of this run alone.
    number
        Its number, as in ``Result.run``: from 1, runs of other machines last.
    worst_of
        The criterion that is worst in this run; empty where no run is worse than another, and the
        first one is drawn.
    """

    recording: Recording
    number: int
    worst_of: str

    def words(self, proof: Proof) -> str:
        """Return the sentence for a caption; empty where only one run was judged."""
        if len(proof.judged) == proof.judged[0].runs == 1:
            return ""
        why = f", in which {self.worst_of} is worst" if self.worst_of else ""
        return f" Drawn is {run_words(proof.verdict, self.number)}{why}."


def run_words(verdict: Verdict, number: int) -> str:
    """Return the name of a run in a caption: a run of the machine, or a machine in tolerance."""
    if number <= verdict.runs:
        return f"run {number} of {verdict.runs}"
    return f"machine {number - verdict.runs} of {verdict.machines} within the tolerances"


def drawn_run(proof: Proof, names: Sequence[str]) -> DrawnRun:
    """Return the run that is worst in the first of the criteria in which runs differ.

    Parameters
    ----------
    names
        Criteria that the figure marks or shows, the most important first.
    """
    for name in names:
        worst = worst_result(proof.verdict, name)
        if worst is not None and worst.run is not None:
            return DrawnRun(recording=proof.run(worst.run), number=worst.run, worst_of=name)
    return DrawnRun(recording=proof.recording, number=1, worst_of="")


def worst_result(verdict: Verdict, name: str) -> Result | None:
    """Return the result of ``name`` that is nearest to, or furthest over, its limit."""
    results = [
        r
        for r in verdict.results
        if r.name == name and r.measured is not None and r.time_s is not None
    ]
    if not results:
        return None
    return max(results, key=lambda r: abs(r.measured or 0.0) / (r.limit or 1.0))


def envelope(
    time_s: FloatArray, values: FloatArray, stretches: int = 800
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return starts of stretches of time, (k,), and their least and largest values, (k,) each.

    A stretch includes the first value of the next one, so that the drawn bands have no gap. The
    last entry of all three is that of the last sample; NaN is left out.

    Parameters
    ----------
    time_s, values
        (n,) each, times increasing.
    """
    width_s = max(float(time_s[-1] - time_s[0]), 1e-9) / stretches
    number = ((time_s - time_s[0]) / width_s).astype(np.int64)
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    low, high = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
    low[:-1] = np.fmin(low[:-1], values[starts[1:]])
    high[:-1] = np.fmax(high[:-1], values[starts[1:]])
    return (
        np.append(time_s[starts], time_s[-1]),
        np.append(low, low[-1]),
        np.append(high, high[-1]),
    )


def extremes(columns: FloatArray, stretch: IntArray) -> NDArray[np.bool_]:
    """Return (n,) True where one of the (n, m) ``columns`` is at an extreme of its stretch.

    ``stretch`` is the (n,) number of each row's stretch. The first and the last row are True.
    """
    keep = np.zeros(len(columns), dtype=bool)
    keep[[0, -1]] = True
    edges = [0, *(np.flatnonzero(np.diff(stretch)) + 1).tolist(), len(columns)]
    across = np.isfinite(columns).all(axis=0)
    for begin, end in pairwise(edges):
        part = columns[begin:end, across]
        if part.size:
            keep[begin + np.concatenate([part.argmin(axis=0), part.argmax(axis=0)])] = True
    return keep


MAX_SAMPLES = 20_000
MAX_VERTICES = 2_000
AROUND_SAMPLES = 2_000
"""Number of samples on both sides of a marked place that are all drawn."""
AROUND_OPERATIONS = 50
"""Number of operations on both sides of a marked place whose points are all drawn."""
MARKED = ("contour_error", "tracking_error")
"""The criteria whose worst place is marked in a figure."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Traces:
    """Samples of a recording and its plan for figures.

    Parameters
    ----------
    time_s
        (n,) instants of the samples that were kept, increasing.
    whole
        (n,) True where no sample was left out before this one.
    commanded, actual
        Per axis: (n,) m or rad. ``actual`` is the position that the judge uses: that of the tool or
        the load where the recording has one, else that of the encoder.
    velocity, acceleration
        Per axis: (n,) differences of ``actual`` over the recording's own ticks, SI.
    planned
        Per axis: (n, 3) position, velocity and acceleration of the trajectory.
    vertices
        (m, axes) programmed vertices.
    stride
        Number of samples of a stretch, of which the extremes were kept; 1 where all were kept.
    run
        The run that is drawn: the one in which the first of ``MARKED`` is worst.
    contour
        (k,) times and (k,) contour errors, m, each the largest of a stretch of the job; None
        where it could not be measured.
    """

    time_s: FloatArray
    whole: npt.NDArray[np.bool_]
    commanded: dict[str, FloatArray]
    actual: dict[str, FloatArray]
    velocity: dict[str, FloatArray]
    acceleration: dict[str, FloatArray]
    planned: dict[str, FloatArray]
    vertices: FloatArray
    stride: int
    run: DrawnRun
    contour: tuple[FloatArray, FloatArray] | None = None

    @property
    def drawn_axes(self) -> tuple[str, ...]:
        """The axes whose motion is known; of a machine without dynamics all, as planned."""
        return tuple(self.actual or self.planned)


def collect(proof: Proof, around_s: Sequence[float] = ()) -> Traces:
    """Read the run with the worst place, its trajectory and the programmed path, and thin them.

    Of every stretch of a long recording those samples are kept at which an axis has an extreme of
    position, velocity or acceleration, planned or actual, or of tracking error: a peak of a single
    sample stays. Near the places that figures mark every sample is kept.

    Parameters
    ----------
    proof
        Its plan has axes with a path.
    around_s
        More instants, s, near which every sample is kept.
    """
    plan, run = proof.plan, drawn_run(proof, MARKED)
    recording = as_intended(run.recording, plan)
    axes = plan.motion.trajectory.axes
    setting = setting_of(plan, recording)
    marked = [worst_result(proof.verdict, name) for name in MARKED]
    places = [result for result in marked if result is not None]
    times_s = [*around_s, *(r.time_s for r in places if r.time_s is not None)]
    samples = plan.motion.trajectory.duration_s / setting.interval_s + 1.0
    stride = 1 if samples <= MAX_SAMPLES else int(np.ceil(14 * len(axes) * samples / MAX_SAMPLES))
    blocks = judged_blocks(recording, axes, 0, None)
    parts = list(_kept(blocks, plan.motion.trajectory, setting.interval_s, stride, times_s))
    number, time_s, commanded, actual, velocity, acceleration, planned = (
        np.concatenate([part[column] for part in parts]) for column in range(7)
    )

    def by_axis(columns: FloatArray) -> dict[str, FloatArray]:
        seen = np.flatnonzero(np.isfinite(columns).any(axis=0)).tolist()
        return {axes[k]: columns[:, k] for k in seen}

    return Traces(
        time_s=time_s,
        whole=np.diff(number, prepend=number[:1] - 1.0) == 1.0,
        commanded=by_axis(commanded),
        actual=by_axis(actual),
        velocity=by_axis(velocity),
        acceleration=by_axis(acceleration),
        planned={axis: planned[:, :, k] for k, axis in enumerate(axes)},
        vertices=_vertices(plan, [r.operation for r in places if r.operation is not None]),
        stride=stride,
        run=run,
        contour=contour_along(recording, plan, proof.spec.lag_s),
    )


def _kept(
    blocks: Iterator[Block],
    trajectory: Trajectory,
    interval_s: float,
    stride: int,
    around_s: Sequence[float],
) -> Iterator[tuple[FloatArray, ...]]:
    """Yield block by block the kept samples' number, time, command, positions and their plan.

    Numbers and times are (n,), command, position, velocity and acceleration (n, axes), the plan
    (n, 3, axes): position, velocity, acceleration. A signal that the recording lacks is NaN.
    """
    before: FloatArray | None = None
    reader = TrajectoryReader(trajectory)
    for block in blocks:
        moved = block.actual if block.actual is not None else block.own
        actual, commanded = None if moved is None else moved[:, 0], block.commanded
        shape = next(c.shape for c in (actual, commanded) if c is not None)
        nothing = np.full(shape, np.nan)
        actual = nothing if actual is None else actual
        commanded = nothing if commanded is None else commanded
        joined = np.concatenate(
            [actual[:1].repeat(2, axis=0) if before is None else before, actual]
        )
        before = joined[-2:]
        velocity = np.diff(joined, axis=0)[1:] / interval_s
        acceleration = np.diff(joined, 2, axis=0) / interval_s**2
        number = block.first + np.arange(len(actual))
        planned = reader.ladder(block.due_s, 3)
        reader.drop(float(block.due_s[0]))
        if block.slow is not None:
            pass_slowly(planned, block.due_s - block.time_s, interval_s)
        keep = np.ones(len(actual), dtype=bool)
        if stride > 1:
            told = planned.reshape(len(planned), -1)
            shown = [actual, velocity, acceleration, actual - commanded, told]
            keep = extremes(np.concatenate(shown, axis=1), number // stride)
            for place_s in around_s:
                keep |= np.abs(block.time_s - place_s) <= AROUND_SAMPLES * interval_s
        yield (
            number[keep].astype(np.float64),
            block.time_s[keep],
            commanded[keep],
            actual[keep],
            velocity[keep],
            acceleration[keep],
            planned[keep],
        )


def pass_slowly(planned: FloatArray, ahead_s: FloatArray, interval_s: float) -> None:
    """Give (n, 3, axes) planned velocity and acceleration the rate at which they were run.

    Where rows were held a motion x(p) of the plan's time p has the velocity x' p' and the
    acceleration x'' p'^2 + x' p''.

    Parameters
    ----------
    ahead_s
        (n,) the plan's time less the recording's, s; it falls in a hold.
    """
    if len(ahead_s) < 2:
        return
    more = np.gradient(ahead_s, interval_s)
    rate, change = 1.0 + more[:, None], np.gradient(more, interval_s)[:, None]
    planned[:, 2] = planned[:, 2] * rate**2 + planned[:, 1] * change
    planned[:, 1] *= rate


def _vertices(plan: Plan, around: Sequence[int]) -> FloatArray:
    """Return programmed vertices, (m, axes) and in no order: all of them where there are few.

    Of many, every second, fourth and so on is taken, those near a place in ``around``, and those
    that are outermost in an axis.
    """
    near: list[FloatArray] = []
    others: list[FloatArray] = []
    outermost: FloatArray | None = None
    count, step = 0, 1
    for block in plan.motion.programmed:
        if not len(block):
            continue
        close = np.zeros(len(block), dtype=bool)
        for operation in around:
            close |= np.abs(block.operation - operation) <= AROUND_OPERATIONS
        taken = ~close & ((count + np.arange(len(block))) % step == 0)
        count += len(block)
        near.append(block.positions[close])
        others.append(block.positions[taken])
        seen = block.positions if outermost is None else np.vstack([outermost, block.positions])
        outermost = seen[np.concatenate([seen.argmin(axis=0), seen.argmax(axis=0)])]
        if sum(map(len, others)) > MAX_VERTICES:
            others, step = [np.concatenate(others)[::2]], 2 * step
    if outermost is None:
        return np.empty((0, 0))
    return np.concatenate([*near, *others, *([outermost] if step > 1 else [])])
