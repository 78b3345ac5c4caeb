"""The samples that a figure shows: the run with the worst value, and the error along the job."""

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
from threadline.verdict.blocks import find_first, judged_blocks, setting_of
from threadline.verdict.registry import MEASURES
from threadline.verdict.samples import Block
from threadline.verdict.window import PathWindow


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnRun:
    """The run that a figure shows.

    Parameters
    ----------
    recording
        Recording of this run alone.
    number
        Number of the run, as in ``Result.run``: from 1, runs of the worst machine last.
    worst_of
        The criterion that is worst in this run; empty if all runs are equal, and the first is
        drawn.
    """

    recording: Recording
    number: int
    worst_of: str

    def words(self, proof: Proof) -> str:
        """Return a sentence for the caption; empty if only one run was judged."""
        if len(proof.judged) == proof.judged[0].runs == 1:
            return ""
        why = f", in which {self.worst_of} is worst" if self.worst_of else ""
        return f" Drawn is {run_words(proof.verdict, self.number)}{why}."


def run_words(verdict: Verdict, number: int) -> str:
    """Return the name of a run for a caption: a run of the machine, or a machine in tolerance."""
    if number <= verdict.runs:
        return f"run {number} of {verdict.runs}"
    return f"run {number - verdict.runs} of the worst machine found within the tolerances"


def drawn_run(proof: Proof, names: Sequence[str]) -> DrawnRun:
    """Return the worst run by the first criterion in which the runs differ.

    Parameters
    ----------
    names
        Criteria shown in the figure, the most important first.
    """
    for name in names:
        worst = worst_result(proof.verdict, name)
        if worst is not None and worst.run is not None:
            return DrawnRun(recording=proof.run(worst.run), number=worst.run, worst_of=name)
    return DrawnRun(recording=proof.recording, number=1, worst_of="")


def worst_result(verdict: Verdict, name: str) -> Result | None:
    """Return the result of criterion ``name`` with the largest used share of its limit."""
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
    """Return (k,) starts of stretches of time, and their smallest and largest values, (k,) each.

    A stretch includes the first value of the next one, so that the drawn bands have no gap. The
    last entry of all three is the last sample. NaN is left out.

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
    """Return (n,) True for rows in which one of the (n, m) ``columns`` has an extreme.

    The extremes are taken over each stretch; ``stretch`` is the (n,) number of each row's stretch.
    The first and the last row are True.
    """
    keep = np.zeros(len(columns), dtype=bool)
    keep[[0, -1]] = True
    edges = [0, *(np.flatnonzero(np.diff(stretch)) + 1).tolist(), len(columns)]
    finite_columns = np.isfinite(columns).all(axis=0)
    for begin, end in pairwise(edges):
        stretch_rows = columns[begin:end, finite_columns]
        if stretch_rows.size:
            keep[
                begin + np.concatenate([stretch_rows.argmin(axis=0), stretch_rows.argmax(axis=0)])
            ] = True
    return keep


MAX_SAMPLES = 20_000
MAX_VERTICES = 2_000
_STRETCHES = 2_000
AROUND_SAMPLES = 2_000
"""Number of samples on both sides of a marked place that are always drawn."""
AROUND_OPERATIONS = 50
"""Number of operations on both sides of a marked place whose points are always drawn."""
MARKED = ("contour_error", "tracking_error")
"""The criteria whose worst place is marked in a figure."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Traces:
    """Samples of a recording and its plan for figures.

    Parameters
    ----------
    time_s
        (n,) instants of the kept samples, increasing.
    whole
        (n,) True if no sample was left out directly before this one.
    commanded, actual
        Per axis: (n,) m or rad. ``actual`` is the position used for the verdict: the position of
        tool or load if the recording has it, otherwise of the encoder.
    velocity, acceleration
        Per axis: (n,) differences of ``actual`` over the recording's own ticks, SI.
    planned
        Per axis: (n, 3) position, velocity and acceleration of the trajectory.
    vertices
        (m, axes) programmed vertices.
    stride
        Number of samples in a stretch, whose extremes were kept; 1 if all samples were kept.
    run
        The drawn run: the run in which the first of ``MARKED`` is worst.
    contour
        (k,) times and (k,) largest contour errors of the stretches of the job, m; None if it could
        not be measured.
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
        """The axes with known motion; for a machine without dynamics all axes, as planned."""
        return tuple(self.actual or self.planned)


def collect(proof: Proof, around_s: Sequence[float] = ()) -> Traces:
    """Read the worst run, its trajectory and the programmed path, and thin them.

    In every stretch of a long recording, the samples are kept at which an axis has an extreme of
    position, velocity or acceleration, planned or actual, or of tracking error, so a peak of a
    single sample remains. Near the places that figures mark, every sample is kept.

    Parameters
    ----------
    proof
        Proof of a plan that has axes with a path.
    around_s
        Additional instants near which every sample is kept, s.
    """
    plan, run = proof.plan, drawn_run(proof, MARKED)
    recording = as_intended(run.recording, plan)
    axes = plan.motion.trajectory.axes
    setting = setting_of(plan, recording)
    marked = [worst_result(proof.verdict, name) for name in MARKED]
    worst_results = [result for result in marked if result is not None]
    around_times_s = [*around_s, *(r.time_s for r in worst_results if r.time_s is not None)]
    samples = plan.motion.trajectory.duration_s / setting.interval_s + 1.0
    stride = 1 if samples <= MAX_SAMPLES else int(np.ceil(14 * len(axes) * samples / MAX_SAMPLES))
    blocks = judged_blocks(recording, axes, 0, None)
    parts = list(
        _samples_drawn(blocks, plan.motion.trajectory, setting.interval_s, stride, around_times_s)
    )
    number, time_s, commanded, actual, velocity, acceleration, planned = (
        np.concatenate([part[column] for part in parts]) for column in range(7)
    )

    def by_axis(columns: FloatArray) -> dict[str, FloatArray]:
        known_columns = np.flatnonzero(np.isfinite(columns).any(axis=0)).tolist()
        return {axes[k]: columns[:, k] for k in known_columns}

    return Traces(
        time_s=time_s,
        whole=np.diff(number, prepend=number[:1] - 1.0) == 1.0,
        commanded=by_axis(commanded),
        actual=by_axis(actual),
        velocity=by_axis(velocity),
        acceleration=by_axis(acceleration),
        planned={axis: planned[:, :, k] for k, axis in enumerate(axes)},
        vertices=_vertices(plan, [r.operation for r in worst_results if r.operation is not None]),
        stride=stride,
        run=run,
        contour=contour_along(recording, plan, proof.spec.lag_s),
    )


def _samples_drawn(
    blocks: Iterator[Block],
    trajectory: Trajectory,
    interval_s: float,
    stride: int,
    around_s: Sequence[float],
) -> Iterator[tuple[FloatArray, ...]]:
    """Yield, block by block, number, time, command, motion and plan of the kept samples.

    Numbers and times are (n,). Command, position, velocity and acceleration are (n, axes). The plan
    is (n, 3, axes): position, velocity, acceleration. A signal missing in the recording is NaN.
    """
    previous_positions: FloatArray | None = None
    reader = TrajectoryReader(trajectory)
    for block in blocks:
        positions = block.actual if block.actual is not None else block.own
        actual, commanded = None if positions is None else positions[:, 0], block.commanded
        shape = next(c.shape for c in (actual, commanded) if c is not None)
        unknown = np.full(shape, np.nan)
        actual = unknown if actual is None else actual
        commanded = unknown if commanded is None else commanded
        with_previous = np.concatenate(
            [
                actual[:1].repeat(2, axis=0) if previous_positions is None else previous_positions,
                actual,
            ]
        )
        previous_positions = with_previous[-2:]
        velocity = np.diff(with_previous, axis=0)[1:] / interval_s
        acceleration = np.diff(with_previous, 2, axis=0) / interval_s**2
        number = block.first + np.arange(len(actual))
        planned = reader.derivatives(block.due_s, 3)
        reader.drop(float(block.due_s[0]))
        if block.slow is not None:
            scale_to_run_rate(planned, block.due_s - block.time_s, interval_s)
        keep = np.ones(len(actual), dtype=bool)
        if stride > 1:
            planned_rows = planned.reshape(len(planned), -1)
            drawn_columns = [actual, velocity, acceleration, actual - commanded, planned_rows]
            keep = extremes(np.concatenate(drawn_columns, axis=1), number // stride)
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


def scale_to_run_rate(planned: FloatArray, ahead_s: FloatArray, interval_s: float) -> None:
    """Scale (n, 3, axes) planned velocity and acceleration to the rate at which they were run.

    During a hold, a motion x(p) of the plan's time p has the velocity x' p' and the acceleration
    x'' p'^2 + x' p''.

    Parameters
    ----------
    ahead_s
        (n,) plan's time minus recording's time, s; it decreases during a hold.
    """
    if len(ahead_s) < 2:
        return
    rate_excess = np.gradient(ahead_s, interval_s)
    rate, change = 1.0 + rate_excess[:, None], np.gradient(rate_excess, interval_s)[:, None]
    planned[:, 2] = planned[:, 2] * rate**2 + planned[:, 1] * change
    planned[:, 1] *= rate


def _vertices(plan: Plan, around: Sequence[int]) -> FloatArray:
    """Return (m, axes) programmed vertices in no particular order.

    If there are many, the result is every second, fourth and so on, the vertices near a place in
    ``around``, and the outermost vertices of each axis.
    """
    around_vertices: list[FloatArray] = []
    others: list[FloatArray] = []
    outermost: FloatArray | None = None
    count, step = 0, 1
    for block in plan.motion.programmed:
        if not len(block):
            continue
        is_around = np.zeros(len(block), dtype=bool)
        for operation in around:
            is_around |= np.abs(block.operation - operation) <= AROUND_OPERATIONS
        is_taken = ~is_around & ((count + np.arange(len(block))) % step == 0)
        count += len(block)
        around_vertices.append(block.positions[is_around])
        others.append(block.positions[is_taken])
        with_outermost = (
            block.positions if outermost is None else np.vstack([outermost, block.positions])
        )
        outermost = with_outermost[
            np.concatenate([with_outermost.argmin(axis=0), with_outermost.argmax(axis=0)])
        ]
        if sum(map(len, others)) > MAX_VERTICES:
            others, step = [np.concatenate(others)[::2]], 2 * step
    if outermost is None:
        return np.empty((0, 0))
    return np.concatenate([*around_vertices, *others, *([outermost] if step > 1 else [])])


def contour_along(
    recording: Recording, plan: Plan, lag_s: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return times, s, and distances of the tool from the programmed path, m, both (n,).

    There is the largest distance of each of ``_STRETCHES`` time intervals, and its time.

    Distances are measured from samples to chords, as in ``contour_error`` and with the same lag;
    missed programmed points are not included. The recording is read once, in bounded memory.

    Returns
    -------
    tuple or None
        None if the recording lacks a channel that the measure needs.
    """
    recording = as_intended(recording, plan)
    axes = plan.axes
    actual, operation = MEASURES["contour_error"].needs
    if find_first(recording, operation, "") is None:
        return None
    if any(find_first(recording, actual, axis) is None for axis in axes):
        return None
    setting = setting_of(plan, recording, lag_s)
    width_s = max(plan.motion.trajectory.duration_s + lag_s, setting.interval_s) / _STRETCHES
    largest2_m2 = np.full(_STRETCHES + 1, -1.0)
    time_s = np.zeros(_STRETCHES + 1)
    window = PathWindow(plan.motion.programmed)
    lag, resolution = setting.lag_samples, setting.resolution
    for block in judged_blocks(recording, axes, lag, window, resolution):
        distances2_m2 = block.nearest_on_surface[0][:, 0]
        stretch = np.minimum((block.due_s / width_s).astype(np.int64), _STRETCHES)
        # The largest distance of each interval is assigned last, and so it stays.
        order = np.argsort(distances2_m2, kind="stable")
        order = order[distances2_m2[order] > largest2_m2[stretch[order]]]
        largest2_m2[stretch[order]], time_s[stretch[order]] = (
            distances2_m2[order],
            block.time_s[order],
        )
    has_distance = largest2_m2 >= 0.0
    return time_s[has_distance], np.sqrt(largest2_m2[has_distance])
