"""A plan and a recording of any length, both made while they are read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.made import Made
from threadline.files import ChannelKind, RecordingBlock, TickBlock
from threadline.jobs.operations import Feed, FeedMode, Move, Source
from threadline.motion.path.types import PieceBlock, VertexBlock
from threadline.motion.timing.types import TrajectoryBlock

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
            skip = 1 if chunk else 0  # a chunk begins where the previous one ended
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

    def rows():
        for chunk in range(chunks):
            yield TickBlock(
                first_tick=chunk * count * PER_MOVE,
                counts=np.zeros((count * PER_MOVE, 2), dtype=np.int64),
                operation=np.repeat(operations(chunk), PER_MOVE),
            )

    def moves():
        feed = Feed(FeedMode.FASTEST_AXIS, 0.1)
        for chunk in range(chunks):
            for line, point in enumerate(shape(chunk)[1:].tolist(), start=chunk * count + 1):
                yield Move(tuple(point), feed, Source("by-hand.prg", line))

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
        job=replace(plan.job, operations=Made(moves)),
        commands=replace(plan.commands, blocks=Made(rows)),
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
