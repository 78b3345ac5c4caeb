"""Limits of the machine that a recording is held against itself, and not only its plan.

A plan is measured between samples, exactly. What the machine made of it is seen in samples of a
position. A machine rings about its command, so a recording breaks a limit where it exceeds it by
more than ``ALLOWED_SHARE``, or its travel by more than placement is allowed to be off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.files import ChannelKind
from threadline.verdict.each_run import unit_of
from threadline.verdict.finding import Found, Worst
from threadline.verdict.measure import Measure, MeasureKind, OfRun
from threadline.verdict.one_pass import Findings, Key
from threadline.verdict.samples import Block, Setting, enough_of
from threadline.verdict.types import Result, Spec, Status

ALLOWED_SHARE = 0.1
"""Share of a limit of velocity by which a recording may exceed it."""
OVER_S = 0.02
"""Time over which the velocity of a recording is taken: noise of its positions says nothing."""
_PLACEMENT = "contour_error"
_PLACED_M = 1e-3  # at the tool, where no specification says how far placement may be off
_POSITIONS = (ChannelKind.TOOL, ChannelKind.LOAD, ChannelKind.MEASURED)


def _positions(block: Block, column: int) -> FloatArray | None:
    """Return the (n, runs) positions of an axis: of its tool or load, else of its own encoder."""
    for values in (block.actual, block.own):
        if values is not None and not np.isnan(values[0, :, column]).all():
            return np.asarray(values[:, :, column])
    return None


class _OfAxes:
    """The largest of a figure of every axis and run."""

    def __init__(self, setting: Setting) -> None:
        count = len(setting.axes)
        self._worst = [Worst(setting.runs, count, axis) for axis in setting.axes]

    def offer(
        self, column: int, values: FloatArray, block: Block, first: int, note: str = ""
    ) -> None:
        """Take (n, runs) values of an axis; the first is of sample ``first`` of the block."""
        known = np.where(np.isnan(values), -np.inf, values)
        worst = self._worst[column]
        if len(known) and worst.is_beaten(known.max(axis=0)):
            at = known.argmax(axis=0)
            worst.offer(
                known[at, np.arange(known.shape[1])],
                time_s=block.time_s[first + at],
                operation=block.operations_at(first + at),
                position=block.positions_at(first + at),
                note=note,
            )

    def finish(self) -> Sequence[Found]:
        found = (worst.found() for worst in self._worst)
        return [one for one in found if not np.isnan(one.value).all()]


class _Reach(_OfAxes):
    """Per axis: how far it goes beyond its travel, negative where room is left."""

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        machine = setting.plan.machine
        rows = [machine.axis_names.index(axis) for axis in setting.axes]
        self._travel = machine.travel[rows]

    def feed(self, block: Block) -> None:
        for column, (low, high) in enumerate(self._travel):
            values = _positions(block, column)
            if values is None or not np.isfinite((low, high)).all():
                continue
            self.offer(column, np.maximum(values - high, low - values), block, 0)


class _Speed(_OfAxes):
    """Per axis: the largest mean velocity over ``OVER_S``, or from sample to sample if longer."""

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        self._every = enough_of(OVER_S, setting.interval_s)
        interval_s = self._every * setting.interval_s
        self._span = max(round(OVER_S / interval_s), 1)
        self._over_s = self._span * interval_s
        self._tails: dict[int, FloatArray] = {}

    def feed(self, block: Block) -> None:
        block = block.every(self._every)
        for column in range(len(self._worst) if len(block) else 0):
            values = _positions(block, column)
            if values is None:
                continue
            tail = self._tails.get(column, values[:0])
            whole = np.concatenate([tail, values])
            self._tails[column] = whole[-self._span :]
            speed = np.abs(whole[self._span :] - whole[: -self._span]) / self._over_s
            said = f"over {1e3 * self._over_s:.4g} ms, {ALLOWED_SHARE:.0%} over the limit allowed"
            self.offer(column, speed, block, len(values) - len(speed), said)


def _start_reach(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    return _Reach(setting)


def _start_speed(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    return _Speed(setting)


TRAVEL = MeasureKind(
    name="travel",
    dimension="axis",
    per_axis=True,
    of_worst=True,
    allowance=1e-9,
    reads=(OfRun(run=Setting, start=_start_reach, needs=(_POSITIONS,)),),
)
VELOCITY = MeasureKind(
    name="velocity",
    dimension="axis/s",
    per_axis=True,
    of_worst=True,
    reads=(OfRun(run=Setting, start=_start_speed, needs=(_POSITIONS,)),),
)


def key_of(kind: MeasureKind) -> Key:
    """Return the key of a measure here, which no criterion of a specification has."""
    return kind.name, (("recording", 1.0),)


def kinds_of(spec: Spec, *, recorded: bool) -> dict[Key, MeasureKind]:
    """Return the measures here for the criteria of a specification.

    Of a run that was simulated for its verdict only ``travel``: its velocity follows from its plan.
    """
    asked = {criterion.name for criterion in spec.criteria}
    kinds = (TRAVEL, VELOCITY) if recorded else (TRAVEL,)
    return {key_of(kind): kind for kind in kinds if kind.name in asked}


def with_recording(
    result: Result, findings: Findings, plan: Plan, spec: Spec, *, complete: bool, recorded: bool
) -> Result:
    """Return a result of the plan, or that of the recording in its place.

    What the plan breaks stays. What the recording breaks takes its place, and so does, of a
    recording, what it was measured to keep to its end.

    Parameters
    ----------
    result
        Of the plan, with its limit.
    complete
        Whether the runs came to their end.
    recorded
        Whether recordings are judged, and not runs that were simulated for the verdict.
    """
    of_plan = replace(result, of="plan")
    kind = {one.name: one for one in (TRAVEL, VELOCITY)}.get(result.name)
    found = [
        one
        for one in (findings.get(key_of(kind), ()) if kind is not None else ())
        if one.axis == result.axis
    ]
    if kind is None or not found or result.limit is None or result.status is Status.FAILED:
        return of_plan
    unit = unit_of(kind, result.axis, plan)
    limit = _limit(result, plan, spec)
    worst = found[0].worst().in_unit(unit).under(limit, kind.status)
    status = kind.status(worst.value, limit)
    if status is not Status.FAILED and not (recorded and complete and worst.value is not None):
        return of_plan
    beyond = worst.value is not None and worst.value > 0.0
    note = worst.note or ("beyond, more than placement may be off" if beyond else "room left")
    return replace(
        result,
        measured=worst.value,
        limit=limit,
        status=status,
        time_s=worst.time_s,
        operation=worst.operation,
        job_line=worst.job_line,
        position=worst.position,
        note=note,
        of="recording",
    )


def _limit(result: Result, plan: Plan, spec: Spec) -> float:
    """Return what a recording may reach where a plan may reach the limit of ``result``."""
    assert result.limit is not None
    if result.name == VELOCITY.name:
        return result.limit * (1.0 + ALLOWED_SHARE)
    placed = [c.limit for c in spec.criteria if c.name == _PLACEMENT and c.limit is not None]
    axis = plan.motion.axes.index(result.axis)
    per_unit = float(plan.motion.programmed.radius_m[axis])
    return result.limit + max(placed, default=_PLACED_M) / per_unit
