"""A recording and its plan, thinned to what a figure can show, in one pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.pipeline import Proof
from threadline.plan import Plan
from threadline.signals import ChannelKind, Recording
from threadline.verdict import as_intended
from threadline.verdict.along import contour_along

MAX_SAMPLES = 20_000
MAX_VERTICES = 20_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Traces:
    """What is drawn.

    Parameters
    ----------
    time_s
        (n,) instants of the samples.
    commanded, actual
        Per axis: (n,) m or rad. ``actual`` is the load where there is one, else the encoder.
    velocity, acceleration
        Per axis: (n,) differences of ``actual`` over the recording's own ticks, SI.
    planned
        Per axis: (n, 3) position, velocity and acceleration of the trajectory.
    vertices, vertex_operation
        (m, axes) programmed vertices and (m,) their operation.
    stride
        Every ``stride``-th sample of the recording was kept.
    contour
        (k,) times and (k,) contour errors, m, each the largest of a stretch of the job; None
        where it could not be measured.
    """

    time_s: FloatArray
    commanded: dict[str, FloatArray]
    actual: dict[str, FloatArray]
    velocity: dict[str, FloatArray]
    acceleration: dict[str, FloatArray]
    planned: dict[str, FloatArray]
    vertices: FloatArray
    stride: int
    contour: tuple[FloatArray, FloatArray] | None = None


def collect(proof: Proof) -> Traces:
    """Read recording, trajectory and programmed path once each and thin them."""
    plan, recording = proof.plan, as_intended(proof.recording, proof.plan)
    ticks = int(plan.motion.trajectory.duration_s / float(plan.machine.tick_clock.period_s)) + 1
    stride = max(1, -(-ticks // MAX_SAMPLES))
    time_s, commanded, actual, velocity, acceleration = _recorded(recording, plan, stride)
    values = [plan.motion.trajectory(time_s, derivative) for derivative in range(3)]
    planned = {
        axis: np.stack([v[:, column] for v in values], axis=1)
        for column, axis in enumerate(plan.motion.trajectory.axes)
    }
    return Traces(
        time_s=time_s,
        commanded=commanded,
        actual=actual,
        velocity=velocity,
        acceleration=acceleration,
        planned=planned,
        vertices=_vertices(plan),
        stride=stride,
        contour=contour_along(recording, plan, proof.spec.lag_s),
    )


def _recorded(
    recording: Recording, plan: Plan, stride: int
) -> tuple[
    FloatArray,
    dict[str, FloatArray],
    dict[str, FloatArray],
    dict[str, FloatArray],
    dict[str, FloatArray],
]:
    axes = plan.motion.trajectory.axes
    shown = {
        axis: recording.find(ChannelKind.LOAD, axis) or recording.find(ChannelKind.MEASURED, axis)
        for axis in axes
    }
    wanted = {axis: recording.find(ChannelKind.COMMANDED, axis) for axis in axes}
    times: list[FloatArray] = []
    kept: dict[str, dict[str, list[FloatArray]]] = {
        what: {axis: [] for axis in axes} for what in ("commanded", "actual", "v", "a")
    }
    tail: dict[str, FloatArray] = {}
    for block in recording:
        first = True
        for axis in axes:
            channel, command = shown[axis], wanted[axis]
            if channel is None:
                continue
            samples = block.samples[channel.name]
            period_s = float(channel.clock.period_s) * channel.stride
            joined = np.concatenate([tail.get(axis, samples[:1].repeat(2)), samples])
            tail[axis] = joined[-2:]
            start = block.first_tick[channel.clock.name] // channel.stride
            pick = np.arange((-start) % stride, len(samples), stride)
            kept["actual"][axis].append(samples[pick])
            kept["v"][axis].append((np.diff(joined)[1:] / period_s)[pick])
            kept["a"][axis].append((np.diff(joined, 2) / period_s**2)[pick])
            if command is not None:
                kept["commanded"][axis].append(block.samples[command.name][pick])
            if first:
                instants = channel.clock.times_s(
                    block.first_tick[channel.clock.name], len(samples), channel.stride
                )
                times.append(instants[pick])
                first = False
    joined_up = {
        what: {axis: np.concatenate(parts) for axis, parts in by_axis.items() if parts}
        for what, by_axis in kept.items()
    }
    time_s = np.concatenate(times) if times else np.empty(0)
    return time_s, joined_up["commanded"], joined_up["actual"], joined_up["v"], joined_up["a"]


def _vertices(plan: Plan) -> FloatArray:
    parts: list[FloatArray] = []
    count = 0
    for block in plan.motion.programmed:
        parts.append(block.positions)
        count += len(block)
        if count >= MAX_VERTICES:
            break
    return np.concatenate(parts)[:MAX_VERTICES] if parts else np.empty((0, 0))
