"""Machine limits that are measured on the recording, too, and not only on the plan.

A plan is measured exactly, between samples too; a recording only by samples of positions. A machine
vibrates about its command, so a recording fails a velocity limit only if it exceeds the limit by
more than ``ALLOWED_SHARE``, and the travel only by more than the placement tolerance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.files import ChannelKind
from threadline.verdict.each_run import unit_of
from threadline.verdict.finding import RunFindings, Worst
from threadline.verdict.measure import Measure, MeasureKind, OfRun
from threadline.verdict.one_pass import Findings, Key
from threadline.verdict.samples import Block, Setting, enough_of
from threadline.verdict.types import Result, Spec, Status

ALLOWED_SHARE = 0.1
"""Share of a velocity limit by which a recording may exceed it."""
OVER_S = 0.02
"""Time over which the velocity of a recording is averaged, against noise of its positions."""
_JUMP = 2.0  # times a velocity limit: a faster motion comes from missing samples
_PLACEMENT = "contour_error"
_PLACED_M = 1e-3  # placement tolerance at the tool, without a specification
_POSITIONS = (ChannelKind.TOOL, ChannelKind.LOAD, ChannelKind.MEASURED)


def _positions(block: Block, column: int) -> FloatArray | None:
    """Return the (n, runs) positions of an axis: of tool or load, else of the axis's encoder."""
    for values in (block.actual, block.own):
        if values is not None and not np.isnan(values[0, :, column]).all():
            return np.asarray(values[:, :, column])
    return None


class _OfAxes:
    """Keeps the largest value of each axis and run."""

    def __init__(self, setting: Setting) -> None:
        count = len(setting.axes)
        self._worst = [Worst(setting.runs, count, axis) for axis in setting.axes]

    def offer(
        self, column: int, values: FloatArray, block: Block, first: int, note: str = ""
    ) -> None:
        """Take (n, runs) values of an axis; the first belongs to sample ``first`` of the block."""
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

    def finish(self) -> Sequence[RunFindings]:
        found = (worst.found() for worst in self._worst)
        return [one for one in found if not np.isnan(one.value).all()]


class _Reach(_OfAxes):
    """Overshoot of the travel, per axis; negative if room is left."""

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
    """Largest mean velocity per axis, over ``OVER_S`` or, if longer, the sampling interval."""

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
            note = f"over {1e3 * self._over_s:.4g} ms, {ALLOWED_SHARE:.0%} over the limit allowed"
            self.offer(column, speed, block, len(values) - len(speed), note)


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
    """Return the key of a measure of this module; no criterion of a specification has it."""
    return kind.name, (("recording", 1.0),)


def kinds_of(spec: Spec, *, recorded: bool) -> dict[Key, MeasureKind]:
    """Return the measures of this module that the criteria of a specification need.

    For a run simulated for this verdict, only ``travel``: its velocity follows from the plan.
    """
    names = {criterion.name for criterion in spec.criteria}
    kinds = (TRAVEL, VELOCITY) if recorded else (TRAVEL,)
    return {key_of(kind): kind for kind in kinds if kind.name in names}


def with_recording(
    result: Result, findings: Findings, plan: Plan, spec: Spec, *, shown: bool
) -> Result:
    """Return the result of the plan, or the recording's result in its place.

    A failure of the plan stays. Otherwise a failure of the recording replaces it, and so does a
    pass of the recording where that is ``shown``.

    Parameters
    ----------
    result
        Result of the plan, with its limit.
    shown
        Whether a pass of the recording is shown in place of the plan's result, as for complete
        recordings of a real machine.
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
    if status is not Status.FAILED and not (shown and worst.value is not None):
        return of_plan
    beyond = worst.value is not None and worst.value > 0.0
    note = worst.note or ("beyond, more than placement may be off" if beyond else "room left")
    if kind is VELOCITY and worst.value is not None and worst.value > _JUMP * limit:
        note += "; a jump, as where lines of a file without times are missing"
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
    """Return the limit for a recording: the plan's limit, with an allowance for vibration."""
    assert result.limit is not None
    if result.name == VELOCITY.name:
        return result.limit * (1.0 + ALLOWED_SHARE)
    placed = [c.limit for c in spec.criteria if c.name == _PLACEMENT and c.limit is not None]
    axis = plan.motion.axes.index(result.axis)
    per_unit = float(plan.motion.programmed.radius_m[axis])
    return result.limit + max(placed, default=_PLACED_M) / per_unit
