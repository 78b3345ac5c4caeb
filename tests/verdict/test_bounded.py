"""Memory does not grow with the length of the job."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from tests.made import Made
from threadline.path.types import PieceBlock, VertexBlock
from threadline.signals import ChannelKind, RecordingBlock
from threadline.trajectory.types import TrajectoryBlock
from threadline.verdict import judge, load_spec

from .builders import TICK_S, follow, plan_through, record

PER_MOVE = 10
CHUNK = 400  # moves per block: an X-Y staircase of 0.1 mm that turns back after every chunk
HALF = np.column_stack([np.ceil(np.arange(CHUNK + 1) / 2), np.floor(np.arange(CHUNK + 1) / 2)])
OUT = 1e-4 * HALF
BACK = OUT[::-1]


def long_job(chunks: int):
    """Return a plan and a recording that are made while they are read."""
    plan = plan_through(OUT, move_s=PER_MOVE * TICK_S)
    count = len(OUT) - 1

    def operations(chunk: int):
        return chunk * count + np.arange(count)

    def shape(chunk: int):
        return OUT if chunk % 2 == 0 else BACK

    def vertices():
        for chunk in range(chunks):
            skip = 1 if chunk else 0  # a chunk begins where the one before it ended
            part = shape(chunk)[skip:]
            operation = np.concatenate([[0] * (1 - skip), operations(chunk)]).astype(np.int64)
            zeros = np.zeros(len(part), dtype=np.int64)
            yield VertexBlock(
                positions=part,
                operation=operation,
                nominal_s=np.full(len(part), PER_MOVE * TICK_S),
                rest=zeros,
                dwell_s=np.zeros(len(part)),
                line=operation + 1,
            )

    def coefficients(chunk: int):
        return np.stack([shape(chunk)[:-1], np.diff(shape(chunk), axis=0)], axis=1)

    def pieces():
        for chunk in range(chunks):
            zeros = np.zeros(count, dtype=np.int64)
            yield PieceBlock(
                coefficients=coefficients(chunk),
                operation=operations(chunk),
                nominal_s=np.full(count, PER_MOVE * TICK_S),
                rest_after=zeros,
                dwell_s=np.zeros(count),
                line=operations(chunk) + 1,
            )

    def motion():
        for chunk in range(chunks):
            yield TrajectoryBlock(
                start_s=(chunk * count + np.arange(count)) * PER_MOVE * TICK_S,
                duration_s=np.full(count, PER_MOVE * TICK_S),
                coefficients=coefficients(chunk),
                operation=operations(chunk),
            )

    def samples():
        for chunk in range(chunks):
            commanded, operation = follow(shape(chunk), PER_MOVE, standstill=-1)
            yield RecordingBlock(
                first_tick={"servo": chunk * count * PER_MOVE},
                samples={
                    "X.load": commanded[:, 0] + (2e-4 if chunk == chunks // 2 else 0.0),
                    "Y.load": commanded[:, 1],
                    "X.commanded": commanded[:, 0],
                    "Y.commanded": commanded[:, 1],
                    "operation": operation + chunk * count,
                },
            )

    plan = replace(
        plan,
        intent=replace(
            plan.motion,
            programmed=replace(plan.motion.programmed, blocks=Made(vertices)),
            path=replace(plan.motion.path, blocks=Made(pieces)),
            trajectory=replace(plan.motion.trajectory, blocks=Made(motion)),
        ),
    )
    kinds = {ChannelKind.LOAD: np.zeros((1, 2)), ChannelKind.COMMANDED: np.zeros((1, 2))}
    recording = replace(record(("X", "Y"), kinds, np.zeros(1)), blocks=Made(samples))
    return plan, recording


def peak_and_verdict(chunks: int):
    plan, recording = long_job(chunks)
    spec = load_spec(None, plan.machine)
    tracemalloc.start()
    verdict = judge([recording], plan, spec)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak, verdict


def test_ten_times_the_job_needs_no_more_memory() -> None:
    """A judge that kept the samples would need ten times as much; a quarter is for the heap."""
    peak_and_verdict(4)  # compiles, fills caches
    short, _ = peak_and_verdict(4)
    long, verdict = peak_and_verdict(40)
    assert long < 1.25 * short
    # The fault in the middle chunk is found, with its place.
    found = verdict.result("contour_error")
    # X is 0.2 mm aside for a chunk: at its turning point nothing of the path is nearer than that.
    assert found.measured == pytest.approx(2e-4, abs=1e-12)
    assert found.operation == pytest.approx(20 * CHUNK, abs=CHUNK)
    assert verdict.result("tracking_error", "X").measured == pytest.approx(2e-4, abs=1e-12)
