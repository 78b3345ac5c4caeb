"""Every measure by its name in a specification."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from threadline.commands.plan import Motion, Plan, Stitched
from threadline.files import ChannelKind
from threadline.verdict import demands, electrical, repeat, seam, settling, switch_measures, turning
from threadline.verdict import demands as lost_steps
from threadline.verdict import settling as ripple
from threadline.verdict import stitch_run as stitch_measures
from threadline.verdict import stitch_run as stitches
from threadline.verdict.advance import start_progress
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
from threadline.verdict.samples import Setting
from threadline.verdict.stitch_run import StitchRun
from threadline.verdict.switch_run import SwitchRun
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


_DIMENSIONS: Mapping[str, Dimension] = {
    "slip_tendency": "ratio",
    "fibre_speed": "tool/s",
    "fibre_speed_variation": "ratio",
}
"""Dimensions of the measures of a fibre that are no lengths."""
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
)
_DEMANDS = OfPlan(intent=Motion, measure=demands.measure_demands)
_TABLES = OfPlan(intent=Stitched, measure=stitch_measures.measure_tables)

_KINDS = (
    MeasureKind(
        name="contour_error",
        dimension="tool",
        per_axis=False,
        of_worst=True,
        reads=(_moved(start_contour, _ACTUAL, _OPERATION),),
    ),
    MeasureKind(
        name="progress_error",
        dimension="tool",
        per_axis=False,
        of_worst=True,
        reads=(_moved(start_progress, _ACTUAL, _OPERATION),),
    ),
    MeasureKind(
        name="turning_point_error",
        dimension="tool",
        per_axis=True,
        reads=(_moved(turning.start_turning, _ACTUAL, _OPERATION),),
        options=turning.OPTIONS,
    ),
    MeasureKind(
        name="repeatability",
        dimension="tool",
        per_axis=False,
        reads=(
            OfRuns(
                run=Setting,
                in_step=repeat.start_in_step,
                start=repeat.start_repeatability,
                needs=(_ACTUAL, _OPERATION),
                follows=True,
            ),
            OfRuns(run=SwitchRun, in_step=whole_runs(switch_measures.repeatability)),
        ),
        options=repeat.OPTIONS,
    ),
    # Measured on plans or on runs, by intent: a path or step tables tell beforehand how far they
    # go, a schedule does not. The allowance is for rounded sums that end beyond the travel.
    MeasureKind(
        name="travel",
        least=-math.inf,
        dimension="axis",
        per_axis=True,
        allowance=1e-9,
        reads=(_DEMANDS, _switched(switch_measures.travel), _TABLES),
    ),
    MeasureKind(
        name="velocity", dimension="axis/s", per_axis=True, slack=demands.SLACK, reads=(_DEMANDS,)
    ),
    MeasureKind(
        name="acceleration",
        dimension="axis/s^2",
        per_axis=True,
        slack=demands.SLACK,
        reads=(_DEMANDS,),
    ),
    MeasureKind(
        name=BRAKING,
        dimension="axis/s^2",
        per_axis=True,
        slack=demands.SLACK,
        reads=(OfPlan(intent=Motion, measure=measure_braking),),
    ),
    MeasureKind(
        name="jerk", dimension="axis/s^3", per_axis=True, slack=demands.SLACK, reads=(_DEMANDS,)
    ),
    MeasureKind(
        name=PATH_USE,
        dimension="ratio",
        per_axis=False,
        slack=demands.SLACK,
        reads=(OfPlan(intent=Motion, measure=measure_path_use),),
    ),
    MeasureKind(
        name="path_deviation",
        dimension="tool",
        per_axis=False,
        reads=(OfPlan(intent=Motion, measure=_path_deviation),),
    ),
    MeasureKind(
        name="shaping_deviation",
        dimension="tool",
        per_axis=False,
        reads=(OfPlan(intent=Motion, measure=_shaping_deviation),),
    ),
    MeasureKind(
        name="tracking_error",
        dimension="axis",
        per_axis=True,
        of_worst=True,
        reads=(_moved(start_tracking, _COMMANDED, (*_ACTUAL, ChannelKind.MEASURED)),),
    ),
    MeasureKind(
        name="velocity_ripple",
        dimension="ratio",
        per_axis=False,
        of_worst=True,
        reads=(_moved(ripple.start_ripple, _ACTUAL, _OPERATION),),
        options=ripple.OPTIONS,
    ),
    MeasureKind(
        name="stitch_length_error",
        dimension="ratio",
        per_axis=False,
        reads=(_moved(stitches.start_length, _ACTUAL),),
        options=stitches.OPTIONS,
    ),
    MeasureKind(
        name="stitch_speed_error",
        dimension="ratio",
        per_axis=False,
        reads=(_moved(stitches.start_speed, _ACTUAL),),
        options=stitches.SPEED_OPTIONS,
    ),
    MeasureKind(
        name="stitches_to_speed",
        dimension="stitch",
        per_axis=False,
        reads=(_moved(start_to_speed, _ACTUAL, _COMMANDED),),
        options=RISE_OPTIONS,
    ),
    MeasureKind(
        name="stitches_from_needle",
        dimension="stitch",
        per_axis=False,
        reads=(_moved(start_from_needle, _ACTUAL, _COMMANDED),),
        options=NEEDLE_OPTIONS,
    ),
    MeasureKind(
        name="stitch_placement_error",
        dimension="tool",
        per_axis=False,
        reads=(_moved(stitches.start_placement, _ACTUAL),),
        options=stitches.OPTIONS,
    ),
    MeasureKind(
        name="seam_error",
        dimension="tool",
        per_axis=False,
        reads=(_moved(seam.start_seam, _ACTUAL),),
        options=stitches.OPTIONS,
    ),
    MeasureKind(
        name="needle_time_error",
        dimension="ratio",
        per_axis=False,
        reads=(_moved(stitches.start_needle, _ACTUAL),),
        options=stitches.OPTIONS,
    ),
    MeasureKind(
        name=NEEDLE_USE,
        dimension="ratio",
        per_axis=False,
        slack=demands.SLACK,
        reads=(OfPlan(intent=Motion, measure=measure_needle_use),),
    ),
    MeasureKind(
        name="residual_vibration",
        dimension="tool",
        per_axis=True,
        reads=(
            _moved(
                settling.start_residual, _ACTUAL, _COMMANDED, of_every_axis=ChannelKind.COMMANDED
            ),
            _switched(switch_measures.residual_vibration),
        ),
        options=settling.RESIDUAL_OPTIONS,
    ),
    MeasureKind(
        name="settling_time",
        dimension="time",
        per_axis=False,
        reads=(
            _moved(settling.start_settling, _ACTUAL, _COMMANDED),
            _switched(switch_measures.settling_time),
        ),
        options=settling.SETTLING_OPTIONS,
    ),
    MeasureKind(
        name="dac_saturation",
        most=1.0,
        dimension="ratio",
        per_axis=True,
        reads=(_moved(electrical.start_dac_saturation, (ChannelKind.VOLTAGE,), follows=False),),
    ),
    MeasureKind(
        name="step_loss",
        dimension="ratio",
        per_axis=True,
        of_worst=True,
        reads=(_moved(lost_steps.start_step_loss, (ChannelKind.TORQUE_SHARE,), follows=False),),
    ),
    MeasureKind(
        name="current_peak",
        dimension="current",
        per_axis=True,
        of_worst=True,
        reads=(_moved(electrical.start_current_peak, (ChannelKind.CURRENT,), follows=False),),
    ),
    MeasureKind(
        name="current_rms",
        dimension="current",
        per_axis=True,
        reads=(_moved(electrical.start_current_rms, (ChannelKind.CURRENT,), follows=False),),
    ),
    MeasureKind(
        name="end_position_error",
        dimension="axis",
        per_axis=True,
        reads=(_switched(switch_measures.end_position_error),),
    ),
    MeasureKind(
        name="cycle_time",
        dimension="time",
        per_axis=False,
        reads=(_switched(switch_measures.cycle_time),),
    ),
    MeasureKind(
        name="switching_order",
        most=1.0,
        dimension="ratio",
        per_axis=False,
        reads=(_switched(switch_measures.switching_order),),
    ),
    MeasureKind(
        name="switching_error",
        dimension="time",
        per_axis=False,
        reads=(_switched(switch_measures.switching_error),),
    ),
    # Recorded instants are sums of periods: allow for rounding.
    MeasureKind(
        name="switching_dwell",
        dimension="time",
        per_axis=False,
        allowance=1e-9,
        reads=(_switched(switch_measures.switching_dwell),),
    ),
    MeasureKind(
        name="valve_conflict",
        dimension="time",
        per_axis=False,
        reads=(_switched(switch_measures.valve_conflict),),
    ),
    MeasureKind(
        name="over_level",
        dimension="ratio",
        per_axis=False,
        allowance=1e-9,
        reads=(_switched(switch_measures.over_level),),
    ),
    MeasureKind(
        name="stitch_residual",
        dimension="axis",
        per_axis=True,
        of_worst=True,
        reads=(_sewn(stitch_measures.stitch_residual, ChannelKind.LOAD),),
    ),
    MeasureKind(
        name="servo_force",
        dimension="ratio",
        per_axis=True,
        of_worst=True,
        reads=(_sewn(stitch_measures.servo_force, ChannelKind.TORQUE_SHARE),),
    ),
    MeasureKind(
        name="window_use",
        dimension="ratio",
        per_axis=False,
        slack=demands.SLACK,
        reads=(_TABLES,),
    ),
    MeasureKind(name="step_rate", dimension="rate", per_axis=True, reads=(_TABLES,)),
    MeasureKind(name="fetch_use", dimension="ratio", per_axis=False, reads=(_TABLES,)),
)
MEASURES: dict[str, MeasureKind] = {kind.name: kind for kind in (*_KINDS, *_FIBRE)}


def needed_channels(spec: Spec) -> tuple[ChannelKind, ...]:
    """Return the kinds of channels that the criteria of ``spec`` read from a simulated machine.

    If a criterion accepts several kinds of channel, the load is taken; with its velocity where the
    way between samples counts.
    """
    needs = (need for criterion in spec.criteria for need in MEASURES[criterion.name].needs)
    found = {kind for n in needs for kind in ((ChannelKind.LOAD,) if ChannelKind.LOAD in n else n)}
    bows = any(criterion.name in FOLLOWED for criterion in spec.criteria)
    return tuple(sorted(found | {ChannelKind.LOAD} | ({ChannelKind.VELOCITY} if bows else set())))
