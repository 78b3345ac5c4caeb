"""Every measure by its name in a specification."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from threadline.commands.plan import Motion, Plan, Stitched
from threadline.files import ChannelKind
from threadline.verdict import demands, electrical, repeat, seam, settling, switch_measures, turning
from threadline.verdict import stitch_run as stitches
from threadline.verdict.bow import FOLLOWED
from threadline.verdict.contour import start_contour
from threadline.verdict.demands import (
    BRAKING,
    NEEDLE_USE,
    PATH_USE,
    measure_braking,
    measure_needle_use,
    measure_path_use,
)
from threadline.verdict.deviation import measure_path_deviation, measure_shaping_deviation
from threadline.verdict.fibre import EVENNESS_OPTIONS, MEASURED, PLANNED, measure_planned, starter
from threadline.verdict.finding import Finding
from threadline.verdict.measure import (
    Dimension,
    Measure,
    MeasureKind,
    OfPlan,
    OfRun,
    OfRuns,
    whole,
    whole_runs,
)
from threadline.verdict.progress_error import start_progress
from threadline.verdict.samples import Setting
from threadline.verdict.stitch_run import StitchRun
from threadline.verdict.switch_run import SwitchRun
from threadline.verdict.tension import OPTIONS as TENSION_OPTIONS
from threadline.verdict.tension import start_variation
from threadline.verdict.to_speed import NEEDLE_OPTIONS, start_from_needle, start_to_speed
from threadline.verdict.to_speed import OPTIONS as RISE_OPTIONS
from threadline.verdict.tracking import start_tracking
from threadline.verdict.types import Spec

_ACTUAL = (ChannelKind.TOOL, ChannelKind.LOAD)
_OPERATION = (ChannelKind.OPERATION,)
_COMMANDED = (ChannelKind.COMMANDED,)


def _path_deviation(plan: Plan) -> dict[str, list[Finding]]:
    return {"path_deviation": measure_path_deviation(plan)}


def _shaping_deviation(plan: Plan) -> dict[str, list[Finding]]:
    return {"shaping_deviation": measure_shaping_deviation(plan)}


def _moved(
    start: Callable[[Setting, Mapping[str, float]], Measure],
    *needs: tuple[ChannelKind, ...],
    follows: bool = True,
    of_every_axis: ChannelKind | None = None,
) -> OfRun[Setting]:
    """Return a measure of a run of axes with a path."""
    return OfRun(
        run=Setting, start=start, needs=needs, follows=follows, of_every_axis=of_every_axis
    )


def _switched(
    measure: Callable[[SwitchRun, Mapping[str, float]], Sequence[Finding]],
) -> OfRun[SwitchRun]:
    """Return a measure of a run of an on/off machine."""
    return OfRun(run=SwitchRun, start=whole(measure))


def _sewn(
    measure: Callable[[StitchRun, Mapping[str, float]], Sequence[Finding]], needs: ChannelKind
) -> OfRun[StitchRun]:
    """Return a measure of a run of an embroidery machine."""
    return OfRun(run=StitchRun, start=whole(measure), needs=((needs,),))


def _kind(
    name: str, dimension: Dimension, *reads: Any, per_axis: bool = False, **more: Any
) -> MeasureKind:
    return MeasureKind(name=name, dimension=dimension, per_axis=per_axis, reads=reads, **more)


_DIMENSIONS: Mapping[str, Dimension] = {
    "slip_tendency": "ratio",
    "fibre_speed": "tool/s",
    "fibre_speed_variation": "ratio",
}
"""Dimensions of the fibre measures other than lengths."""
_FIBRE = (
    *(
        MeasureKind(
            name=name,
            dimension=_DIMENSIONS.get(name.removeprefix("planned_"), "tool"),
            per_axis=False,
            reads=(OfPlan(intent=Motion, measure=measure_planned),),
        )
        for name in PLANNED
    ),
    *(
        MeasureKind(
            name=name,
            dimension=_DIMENSIONS.get(name, "tool"),
            per_axis=False,
            of_worst=name not in {"pattern_closure", "coverage_gap", "fibre_speed_variation"},
            options=EVENNESS_OPTIONS if name == "fibre_speed_variation" else {},
            reads=(_moved(starter(name), _ACTUAL, _OPERATION),),
        )
        for name in MEASURED
    ),
    MeasureKind(
        name="tension_variation",
        dimension="ratio",
        per_axis=False,
        options=TENSION_OPTIONS,
        reads=(_moved(start_variation, (ChannelKind.TENSION,), _ACTUAL, _OPERATION),),
    ),
)
_DEMANDS = OfPlan(intent=Motion, measure=demands.measure_demands)
_TABLES = OfPlan(intent=Stitched, measure=stitches.measure_tables)

_KINDS = (
    _kind("contour_error", "tool", _moved(start_contour, _ACTUAL, _OPERATION), of_worst=True),
    _kind("progress_error", "tool", _moved(start_progress, _ACTUAL, _OPERATION), of_worst=True),
    _kind(
        "turning_point_error", "tool", _moved(turning.start_turning, _ACTUAL, _OPERATION),
        per_axis=True, options=turning.OPTIONS,
    ),
    _kind(
        "repeatability", "tool", OfRuns(run=Setting, in_step=repeat.start_in_step,
        start=repeat.start_repeatability, needs=(_ACTUAL, _OPERATION), follows=True),
        OfRuns(run=SwitchRun, in_step=whole_runs(switch_measures.repeatability)),
        options=repeat.OPTIONS,
    ),
    # Measured on plans or on runs, by intent: the reach of a path or of step tables is known
    # beforehand, the reach of a schedule is not. The allowance covers rounded sums.
    _kind(
        "travel", "axis", _DEMANDS, _switched(switch_measures.travel), _TABLES, per_axis=True,
        least=-math.inf, allowance=1e-9,
    ),
    _kind("velocity", "axis/s", _DEMANDS, per_axis=True, slack=demands.SLACK),
    _kind("acceleration", "axis/s^2", _DEMANDS, per_axis=True, slack=demands.SLACK),
    _kind(
        BRAKING, "axis/s^2", OfPlan(intent=Motion, measure=measure_braking), per_axis=True,
        slack=demands.SLACK,
    ),
    _kind("jerk", "axis/s^3", _DEMANDS, per_axis=True, slack=demands.SLACK),
    _kind(PATH_USE, "ratio", OfPlan(intent=Motion, measure=measure_path_use), slack=demands.SLACK),
    _kind("path_deviation", "tool", OfPlan(intent=Motion, measure=_path_deviation)),
    _kind("shaping_deviation", "tool", OfPlan(intent=Motion, measure=_shaping_deviation)),
    _kind(
        "tracking_error", "axis",
        _moved(start_tracking, _COMMANDED, (*_ACTUAL, ChannelKind.MEASURED)), per_axis=True,
        of_worst=True,
    ),
    _kind(
        "velocity_ripple", "ratio", _moved(settling.start_ripple, _ACTUAL, _OPERATION),
        of_worst=True, options=settling.OPTIONS,
    ),
    _kind(
        "stitch_length_error", "ratio", _moved(stitches.start_length, _ACTUAL),
        options=stitches.OPTIONS,
    ),
    _kind(
        "stitch_speed_error", "ratio", _moved(stitches.start_speed, _ACTUAL),
        options=stitches.SPEED_OPTIONS,
    ),
    _kind(
        "stitches_to_speed", "stitch", _moved(start_to_speed, _ACTUAL, _COMMANDED),
        options=RISE_OPTIONS,
    ),
    _kind(
        "stitches_from_needle", "stitch", _moved(start_from_needle, _ACTUAL, _COMMANDED),
        options=NEEDLE_OPTIONS,
    ),
    _kind(
        "stitch_placement_error", "tool", _moved(stitches.start_placement, _ACTUAL),
        options=stitches.OPTIONS,
    ),
    _kind("seam_error", "tool", _moved(seam.start_seam, _ACTUAL), options=stitches.OPTIONS),
    _kind(
        "needle_time_error", "ratio", _moved(stitches.start_needle, _ACTUAL),
        options=stitches.OPTIONS,
    ),
    _kind(
        NEEDLE_USE, "ratio", OfPlan(intent=Motion, measure=measure_needle_use),
        slack=demands.SLACK,
    ),
    _kind(
        "residual_vibration", "tool", _moved(settling.start_residual, _ACTUAL, _COMMANDED,
        of_every_axis=ChannelKind.COMMANDED), _switched(switch_measures.residual_vibration),
        per_axis=True, options=settling.RESIDUAL_OPTIONS,
    ),
    _kind(
        "settling_time", "time", _moved(settling.start_settling, _ACTUAL, _COMMANDED),
        _switched(switch_measures.settling_time), options=settling.SETTLING_OPTIONS,
    ),
    _kind(
        "dac_saturation", "ratio",
        _moved(electrical.start_dac_saturation, (ChannelKind.VOLTAGE,), follows=False),
        per_axis=True, most=1.0,
    ),
    _kind(
        "step_loss", "ratio",
        _moved(demands.start_step_loss, (ChannelKind.TORQUE_SHARE,), follows=False),
        per_axis=True, of_worst=True,
    ),
    _kind(
        "current_peak", "current",
        _moved(electrical.start_current_peak, (ChannelKind.CURRENT,), follows=False),
        per_axis=True, of_worst=True,
    ),
    _kind(
        "current_rms", "current",
        _moved(electrical.start_current_rms, (ChannelKind.CURRENT,), follows=False), per_axis=True,
    ),
    _kind(
        "end_position_error", "axis", _switched(switch_measures.end_position_error), per_axis=True,
    ),
    _kind("cycle_time", "time", _switched(switch_measures.cycle_time)),
    _kind("switching_order", "ratio", _switched(switch_measures.switching_order), most=1.0),
    _kind("switching_error", "time", _switched(switch_measures.switching_error)),
    # Recorded instants are sums of periods: allow for rounding.
    _kind("switching_dwell", "time", _switched(switch_measures.switching_dwell), allowance=1e-9),
    _kind("valve_conflict", "time", _switched(switch_measures.valve_conflict)),
    _kind("over_level", "ratio", _switched(switch_measures.over_level), allowance=1e-9),
    _kind(
        "stitch_residual", "axis", _sewn(stitches.stitch_residual, ChannelKind.LOAD),
        per_axis=True, of_worst=True,
    ),
    _kind(
        "servo_force", "ratio", _sewn(stitches.servo_force, ChannelKind.TORQUE_SHARE),
        per_axis=True, of_worst=True,
    ),
    _kind("window_use", "ratio", _TABLES, slack=demands.SLACK),
    _kind("step_rate", "rate", _TABLES, per_axis=True),
    _kind("fetch_use", "ratio", _TABLES),
)  # fmt: skip
MEASURES: dict[str, MeasureKind] = {kind.name: kind for kind in (*_KINDS, *_FIBRE)}


def needed_channels(spec: Spec) -> tuple[ChannelKind, ...]:
    """Return the kinds of channels that the criteria of ``spec`` read from a simulated machine.

    If a criterion accepts several kinds of channel, the load is taken; with its velocity, if the
    measure follows the loads between samples.
    """
    needs = (need for criterion in spec.criteria for need in MEASURES[criterion.name].needs)
    found = {kind for n in needs for kind in ((ChannelKind.LOAD,) if ChannelKind.LOAD in n else n)}
    bows = any(criterion.name in FOLLOWED for criterion in spec.criteria)
    return tuple(sorted(found | {ChannelKind.LOAD} | ({ChannelKind.VELOCITY} if bows else set())))
