r"""Trajectories smoothed in time: moving averages as cubic or quintic splines.

The motion is sampled every ``step_s``; weighted averages of its samples are the control points of a
uniform B-spline in time. Symmetric weights with sum 1 cause no delay.

A quintic spline has four continuous derivatives, enough for the inverse of an axis. By default,
four moving averages of nine samples each are applied in turn. Together they form one kernel of the
width ``38 step_s``, the same for all axes, so that straight paths stay straight. The motion passes
a corner of angle ``turn`` taken at speed v within :math:`v\,E|t|\sin(turn/2)`, where E\|t\| of the
kernel is 0.111 of its width.

A cubic spline limits the jerk: every sample is averaged with the ``count - 1`` samples before it.
If the motion keeps |v| <= V and |a| <= A, so do its averages and the spline. The jerk, which is the
change of the acceleration over the width of the average, is at most 2 A / (count step_s). No
sampling enters these bounds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, floor

import numpy as np

from threadline.base.arrays import FloatArray, IntArray, Locked, read_only
from threadline.errors import OptionError
from threadline.files import Stream
from threadline.jobs.operations import Dwell, Job, Move
from threadline.motion.path.bspline import bspline_coefficients
from threadline.motion.path.durations import Smoothing
from threadline.motion.timing.types import Trajectory, TrajectoryBlock

DEGREE = 5
_AVERAGES, _SAMPLES = 4, 9
STEPS = _AVERAGES * (_SAMPLES - 1) + DEGREE + 1
"""Width of the kernel in sampling steps."""
CHUNK = 8192
MOST_CACHED = 1 << 16
_STILL = 1e-9  # of the fastest speed so far


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Averages(Locked):
    """Weights of the samples of a motion in the control points of its spline.

    Parameters
    ----------
    weights
        (2 m + 1, axes), or (2 m + 1, 1) for all axes alike; each column has the sum 1.
    step_s
        Time between samples.
    starts, stops
        Weights for steps from rest and to rest, of the same shape and first moment; None if they
        are equal to ``weights``.
    """

    weights: FloatArray
    step_s: float
    starts: FloatArray | None = None
    stops: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in ("weights", "starts", "stops"):
            weights = getattr(self, name)
            if weights is None:
                continue
            object.__setattr__(self, name, read_only(weights, name, ndim=2))
            if len(weights) % 2 == 0:
                raise ValueError(f"the number of weights must be odd, got {len(weights)}")
            if weights.shape != self.weights.shape:
                raise ValueError(f"{name} must have the shape of weights, got {weights.shape}")

    @property
    def width_s(self) -> float:
        """Width in time over which one instant of the motion affects the average."""
        return (len(self.weights) + DEGREE) * self.step_s

    @property
    def before(self) -> int:
        """Number of samples before an interval that affect it."""
        return len(self.weights) // 2 + DEGREE // 2

    @property
    def after(self) -> int:
        """Number of samples after the beginning of an interval that affect it."""
        return self.before + 1


def even_averages(width_s: float) -> Averages:
    """Return the four moving averages whose kernel has the width ``width_s``.

    Raises
    ------
    OptionError
        If the width is not above zero.
    """
    if not (np.isfinite(width_s) and width_s > 0.0):
        raise OptionError(f"the width of the averages must be above 0 s, got {width_s!r}")
    return Averages(weights=averaging_weights()[:, None], step_s=width_s / STEPS)


def averaging_weights() -> FloatArray:
    """Return the (2 m + 1,) weights of the samples in a control point; they sum to 1."""
    weights = np.ones(1)
    for _ in range(_AVERAGES):
        weights = np.convolve(weights, np.full(_SAMPLES, 1.0 / _SAMPLES))
    return weights


def spline_basis() -> FloatArray:
    """Return the (DEGREE + 1, DEGREE + 1) matrix from control points to powers of u in [0, 1]."""
    from scipy.interpolate import BSpline, PPoly

    element = BSpline.basis_element(np.arange(DEGREE + 2.0))
    pieces = PPoly.from_spline((element.t, element.c, element.k))
    start = int(np.searchsorted(pieces.x, 0.0))
    pieces_used = pieces.c[::-1, start : start + DEGREE + 1]
    return np.asarray(pieces_used[:, ::-1])


def held_trajectory(
    trajectory: Trajectory, job: Job, width_s: float, before_s: float, after_s: float
) -> Trajectory:
    """Return ``trajectory`` with the rests that averages over ``width_s`` need.

    Parameters
    ----------
    job
        If anything other than a move or an empty dwell comes between two moves, the motion rests
        for ``width_s`` more, so that it has really come to rest when that happens.
    before_s, after_s
        Rest before the motion begins, and after its end, s.
    """
    return Trajectory(
        axes=trajectory.axes,
        historical=trajectory.historical,
        blocks=Stream(_held, trajectory, job, width_s, before_s, after_s),
    )


def averaged_trajectory(held: Trajectory, averages: Averages) -> Trajectory:
    """Return the averages of a trajectory.

    Parameters
    ----------
    held
        It must stand for half of the width of ``averages`` at both ends.
    """
    if held.duration_s / averages.step_s <= MOST_CACHED:
        # A short motion is computed once and kept, as it is read many times.
        return Trajectory(axes=held.axes, blocks=Stream.of(list(_averaged(held, averages))))
    return Trajectory(axes=held.axes, blocks=Stream(_averaged, held, averages))


def _rests(job: Job) -> Iterator[int]:
    """Yield the index of the first operation of every group that needs the machine at rest."""
    first_index: int | None = None
    for index, operation in enumerate(job):
        if isinstance(operation, Move):
            if first_index is not None:
                yield first_index
            first_index = None
        elif first_index is None and not (
            isinstance(operation, Dwell) and operation.duration_s == 0.0
        ):
            first_index = index


def _held(
    trajectory: Trajectory, job: Job, width_s: float, before_s: float, after_s: float
) -> Iterator[TrajectoryBlock]:
    rests = _rests(job)
    rest = next(rests, None)
    now_s = 0.0
    standstill: tuple[FloatArray, int] | None = None  # its last standstill, and the operation
    for block in trajectory:
        if not len(block):
            continue
        if standstill is None:
            standstill = (block.coefficients[0, 0], int(block.operation[0]))
            yield _still(*standstill, now_s, before_s)
            now_s += before_s
        operation_before = np.concatenate([[standstill[1]], block.operation[:-1]])
        first = 0
        # Only where operations are skipped can there be anything between two moves.
        for piece in np.flatnonzero(block.operation > operation_before + 1).tolist():
            needs_rest = False
            while rest is not None and rest < block.operation[piece]:
                needs_rest |= rest > operation_before[piece]
                rest = next(rests, None)
            if not needs_rest:
                continue
            if piece > first:
                yield _moved(block, first, piece, now_s)
                now_s += float(block.start_s[piece] - block.start_s[first])
                standstill = (
                    block.coefficients[piece - 1].sum(axis=0),
                    int(block.operation[piece - 1]),
                )
            first = piece
            yield _still(*standstill, now_s, 0.5 * width_s)
            yield _still(
                standstill[0], int(block.operation[piece]), now_s + 0.5 * width_s, 0.5 * width_s
            )
            now_s += width_s
        yield _moved(block, first, len(block), now_s)
        now_s += block.end_s - float(block.start_s[first])
        standstill = (block.coefficients[-1].sum(axis=0), int(block.operation[-1]))
    if standstill is not None:
        yield _still(*standstill, now_s, after_s)


def _moved(block: TrajectoryBlock, begin: int, end: int, start_s: float) -> TrajectoryBlock:
    part = slice(begin, end)
    return TrajectoryBlock(
        start_s=block.start_s[part] - block.start_s[begin] + start_s,
        duration_s=block.duration_s[part],
        coefficients=block.coefficients[part],
        operation=block.operation[part],
    )


def _still(
    position: FloatArray, operation: int, start_s: float, duration_s: float
) -> TrajectoryBlock:
    return TrajectoryBlock(
        start_s=np.array([start_s]),
        duration_s=np.array([duration_s]),
        coefficients=np.asarray(position, dtype=np.float64)[None, None],
        operation=np.array([operation]),
    )


def _averaged(held: Trajectory, averages: Averages) -> Iterator[TrajectoryBlock]:
    basis, step_s = spline_basis(), averages.step_s
    ahead, behind = averages.before, averages.after
    samples: FloatArray | None = None  # samples from number ``done - ahead`` on
    operations: IntArray = np.empty(0, dtype=np.int64)
    done = sample_count = operation_count = 0
    end_s = 0.0
    end_position: FloatArray = np.empty(0)
    ends = _EndsOfSpeed(averages)
    for block in held:
        ends.read(block)
        if samples is None:
            samples = np.tile(block.coefficients[0, 0], (ahead, 1))
        end_s = block.end_s
        while True:
            new_numbers = np.arange(sample_count, sample_count + CHUNK)
            inside_count = int(np.searchsorted(new_numbers * step_s, end_s))
            if inside_count:
                samples = np.concatenate(
                    [samples, block.evaluate(np.asarray(new_numbers[:inside_count] * step_s))]
                )
                sample_count += inside_count
            middles_s = (np.arange(operation_count, sample_count + 1) + 0.5) * step_s
            middles_s = middles_s[: np.searchsorted(middles_s, end_s)]
            piece = np.searchsorted(block.start_s, middles_s, side="right") - 1
            operations = np.concatenate([operations, block.operation[np.maximum(piece, 0)]])
            operation_count += len(middles_s)
            ready_count = min(sample_count - done - behind, operation_count - done)
            if ready_count > 0:
                yield _spline(samples, operations, done, ready_count, averages, basis, ends)
                samples, operations = samples[ready_count:], operations[ready_count:]
                done += ready_count
            if inside_count < CHUNK:
                break
        end_position = block.coefficients[-1].sum(axis=0)
    if samples is None:
        return
    count = ceil(end_s / step_s - 1e-9) - done
    missing_count = count + ahead + behind - len(samples)
    samples = np.concatenate([samples, np.tile(end_position, (max(missing_count, 0), 1))])
    operations = np.concatenate(
        [operations, np.repeat(operations[-1:], max(count - len(operations), 0))]
    )
    if count > 0:
        yield _spline(samples, operations, done, count, averages, basis, ends)


def _spline(
    samples: FloatArray,
    operations: IntArray,
    done: int,
    count: int,
    averages: Averages,
    basis: FloatArray,
    ends: _EndsOfSpeed,
) -> TrajectoryBlock:
    """Return pieces ``done`` to ``done + count``; ``samples`` begins ``before`` samples earlier."""
    step_s = averages.step_s
    controls = np.zeros((count + DEGREE, samples.shape[1]))
    # Relative to the first sample, so that rest is exactly rest.
    offsets = samples[: count + averages.before + averages.after] - samples[0]
    for shift, weight in enumerate(averages.weights):
        controls += weight * offsets[shift : shift + len(controls)]
    ends.add_to(controls, done - DEGREE // 2)
    windows = np.stack([controls[i : i + count] for i in range(DEGREE + 1)], axis=1)
    coefficients = np.einsum("ki,nia->nka", basis, windows)
    coefficients[:, 0] += samples[0]
    still = (np.ptp(windows, axis=1) == 0.0).all(axis=1)
    coefficients[still, 1:] = 0.0
    return TrajectoryBlock(
        start_s=np.asarray((done + np.arange(count)) * step_s),
        duration_s=np.full(count, step_s),
        coefficients=coefficients,
        operation=operations[:count],
    )


class _EndsOfSpeed:
    """Corrects control points near steps from rest and to rest, which have weights of their own.

    A step of the velocity by dv at the time t adds ``dv max(0, s - t)`` to every sample s. Two sets
    of weights with equal sum and first moment differ by that only near the step.
    """

    def __init__(self, averages: Averages) -> None:
        self._step_s = averages.step_s
        end_weights = (averages.starts, averages.stops)
        self._more = [
            None if weights is None else weights - averages.weights for weights in end_weights
        ]
        self._half = len(averages.weights) // 2
        self._still = True  # at the end of the read part
        self._last: FloatArray = np.zeros(1)
        self._fastest = 0.0
        self._due: list[tuple[int, FloatArray]] = []  # first control point, and the corrections

    def read(self, block: TrajectoryBlock) -> None:
        """Find the steps of the next block."""
        if all(extra_weights is None for extra_weights in self._more) or not len(block):
            return
        lasts_s = block.duration_s[:, None]
        power = np.arange(block.coefficients.shape[1])[:, None]
        slope = block.coefficients * power
        begin_velocity = (slope[:, 1] if len(power) > 1 else 0.0 * slope[:, 0]) / lasts_s
        end_velocity = slope.sum(axis=1) / lasts_s
        begin_speed, end_speed = (
            np.linalg.norm(begin_velocity, axis=1),
            np.linalg.norm(end_velocity, axis=1),
        )
        self._fastest = max(self._fastest, float(begin_speed.max()), float(end_speed.max()))
        still_speed = _STILL * self._fastest
        rests_before = np.append(self._still, end_speed[:-1] <= still_speed)
        for k in np.flatnonzero(rests_before & (begin_speed > still_speed)).tolist():
            self._step(0, float(block.start_s[k]), begin_velocity[k])
        rests_after = np.append(begin_speed[1:] <= still_speed, False)
        for k in np.flatnonzero(rests_after & (end_speed > still_speed)).tolist():
            self._step(1, float(block.start_s[k + 1]), -end_velocity[k])
        if not self._still and not rests_before[0] and begin_speed[0] <= still_speed:
            self._step(1, float(block.start_s[0]), -self._last)
        self._still, self._last = bool(end_speed[-1] <= still_speed), end_velocity[-1]

    def _step(self, kind: int, at_s: float, velocity_step: FloatArray) -> None:
        extra_weights = self._more[kind]
        if extra_weights is None:
            return
        first_control = floor(at_s / self._step_s) - self._half
        sample = (
            np.arange(first_control - self._half, first_control + 3 * self._half + 2) * self._step_s
        )
        ramp = np.maximum(sample - at_s, 0.0)
        change = np.stack(
            [
                np.correlate(ramp, column)
                for column in np.broadcast_to(
                    extra_weights, (len(extra_weights), len(velocity_step))
                ).T
            ],
            axis=1,
        )
        self._due.append((first_control, change * velocity_step))

    def add_to(self, controls: FloatArray, first: int) -> None:
        """Add due corrections to control points, the first of them around sample ``first``."""
        end = first + len(controls)
        self._due = [
            (control, change) for control, change in self._due if control + len(change) > first
        ]
        for control, change in self._due:
            begin, stop = max(control, first), min(control + len(change), end)
            if begin < stop:
                controls[begin - first : stop - first] += change[begin - control : stop - control]


def denser(weights: FloatArray, times: int) -> FloatArray:
    """Return the weights of the same averages for samples ``times`` as dense; one column per axis.

    A uniform B-spline of degree d is a sum of narrower ones, with the weights of d + 1 moving
    averages over their steps (the two-scale relation of splines).
    """
    mask = np.ones(1)
    for _ in range(DEGREE + 1):
        mask = np.convolve(mask, np.full(times, 1.0 / times))
    spread = np.zeros(((len(weights) - 1) * times + 1, weights.shape[1]))
    spread[::times] = weights
    return np.stack([np.convolve(column, mask) for column in spread.T], axis=1)


class Smoother:
    """Turns the samples of one motion from rest to rest, in pieces, into spline pieces."""

    def __init__(self, smoothing: Smoothing, start: FloatArray, operation: int) -> None:
        self._count = smoothing.count
        self._lag = (smoothing.count - 1) // 2
        # Before the first sample the axes stand still.
        self._raw = np.tile(start, (self._count - 1, 1))
        self._controls = np.tile(start, (2, 1))
        self._labels = np.full(self._lag + 2, operation, dtype=np.int64)

    def extend(self, samples: FloatArray, operation: IntArray) -> tuple[FloatArray, IntArray]:
        """Return the (n, 4, axes) coefficients and (n,) operations that ``samples`` complete."""
        all_samples = np.concatenate([self._raw, samples])
        sample_count = len(samples)
        mean = np.zeros_like(samples)
        for shift in range(self._count):
            mean += all_samples[shift : shift + sample_count]
        controls = np.concatenate([self._controls, mean / self._count])
        operations = np.concatenate([self._labels, operation])
        self._raw = all_samples[len(all_samples) - (self._count - 1) :]
        pieces = len(controls) - 3
        if pieces <= 0:
            self._controls, self._labels = controls, operations
            return np.zeros((0, 4, samples.shape[1])), np.zeros(0, dtype=np.int64)
        self._controls = controls[-3:]
        # Control j averages samples that lie half the width earlier; piece j is between controls
        # j + 1 and j + 2.
        piece_operations = operations[2 : 2 + pieces]
        self._labels = operations[pieces:]
        return bspline_coefficients(controls), piece_operations

    def finish(self, end: FloatArray, operation: int) -> tuple[FloatArray, IntArray]:
        """Return the remaining pieces once the axes stand still at ``end``."""
        count = self._count + 2
        return self.extend(np.tile(end, (count, 1)), np.full(count, operation, dtype=np.int64))
