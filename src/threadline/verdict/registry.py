"""Every measure by the name that a specification calls it."""

from __future__ import annotations

from threadline.signals import ChannelKind
from threadline.verdict import (
    demands,
    electrical,
    repeat,
    ripple,
    settling,
    stitches,
    switch_measures,
    turning,
)
from threadline.verdict.contour import start_contour
from threadline.verdict.measure import MeasureKind
from threadline.verdict.tracking import start_tracking

_ACTUAL = (ChannelKind.TOOL, ChannelKind.LOAD)
_OPERATION = (ChannelKind.OPERATION,)
_COMMANDED = (ChannelKind.COMMANDED,)

PLAN_DEMANDS = ("travel", "velocity", "acceleration", "jerk")

_KINDS = (
    MeasureKind(
        name="contour_error",
        dimension="tool",
        per_axis=False,
        follows=True,
        needs=(_ACTUAL, _OPERATION),
        start=start_contour,
    ),
    MeasureKind(
        name="turning_point_error",
        dimension="tool",
        per_axis=True,
        follows=True,
        needs=(_ACTUAL, _OPERATION),
        start=turning.start_turning,
        options=turning.OPTIONS,
    ),
    MeasureKind(
        name="repeatability",
        dimension="tool",
        per_axis=False,
        follows=True,
        needs=(_ACTUAL, _OPERATION),
        of_many=repeat.measure_repeatability,
        options=repeat.OPTIONS,
    ),
    # A sum of increments may end a rounding beyond the travel.
    MeasureKind(
        name="travel",
        dimension="axis",
        per_axis=True,
        allowance=1e-9,
        of_switching=switch_measures.travel,
    ),
    MeasureKind(name="velocity", dimension="axis/s", per_axis=True, slack=demands.SLACK),
    MeasureKind(name="acceleration", dimension="axis/s^2", per_axis=True, slack=demands.SLACK),
    MeasureKind(name="jerk", dimension="axis/s^3", per_axis=True, slack=demands.SLACK),
    MeasureKind(name="path_deviation", dimension="tool", per_axis=False),
    MeasureKind(name="shaping_deviation", dimension="tool", per_axis=False),
    MeasureKind(
        name="tracking_error",
        dimension="axis",
        per_axis=True,
        follows=True,
        needs=(_COMMANDED, (*_ACTUAL, ChannelKind.MEASURED)),
        start=start_tracking,
    ),
    MeasureKind(
        name="velocity_ripple",
        dimension="ratio",
        per_axis=False,
        follows=True,
        needs=(_ACTUAL, _OPERATION),
        start=ripple.start_ripple,
        options=ripple.OPTIONS,
    ),
    MeasureKind(
        name="stitch_length_error",
        dimension="ratio",
        per_axis=False,
        follows=True,
        needs=(_ACTUAL,),
        start=stitches.start_length,
        options=stitches.OPTIONS,
    ),
    MeasureKind(
        name="stitch_placement_error",
        dimension="tool",
        per_axis=False,
        follows=True,
        needs=(_ACTUAL,),
        start=stitches.start_placement,
        options=stitches.OPTIONS,
    ),
    MeasureKind(
        name="needle_time_error",
        dimension="ratio",
        per_axis=False,
        follows=True,
        needs=(_ACTUAL,),
        start=stitches.start_needle,
        options=stitches.OPTIONS,
    ),
    MeasureKind(
        name="residual_vibration",
        dimension="tool",
        per_axis=True,
        follows=True,
        needs=(_ACTUAL, _COMMANDED),
        start=settling.start_residual,
        of_switching=switch_measures.residual_vibration,
        options=settling.RESIDUAL_OPTIONS,
    ),
    MeasureKind(
        name="settling_time",
        dimension="time",
        per_axis=False,
        follows=True,
        needs=(_ACTUAL, _COMMANDED),
        start=settling.start_settling,
        of_switching=switch_measures.settling_time,
        options=settling.SETTLING_OPTIONS,
    ),
    MeasureKind(
        name="dac_saturation",
        dimension="ratio",
        per_axis=True,
        needs=((ChannelKind.VOLTAGE,),),
        start=electrical.start_dac_saturation,
    ),
    MeasureKind(
        name="current_peak",
        dimension="current",
        per_axis=True,
        needs=((ChannelKind.CURRENT,),),
        start=electrical.start_current_peak,
    ),
    MeasureKind(
        name="current_rms",
        dimension="current",
        per_axis=True,
        needs=((ChannelKind.CURRENT,),),
        start=electrical.start_current_rms,
    ),
    MeasureKind(
        name="end_position_error",
        dimension="axis",
        per_axis=True,
        of_switching=switch_measures.end_position_error,
    ),
    MeasureKind(
        name="cycle_time",
        dimension="time",
        per_axis=False,
        of_switching=switch_measures.cycle_time,
    ),
    MeasureKind(
        name="switching_order",
        dimension="ratio",
        per_axis=False,
        of_switching=switch_measures.switching_order,
    ),
    MeasureKind(
        name="switching_error",
        dimension="time",
        per_axis=False,
        of_switching=switch_measures.switching_error,
    ),
    # Recorded instants are sums of periods: a rounding is no fault.
    MeasureKind(
        name="switching_dwell",
        dimension="time",
        per_axis=False,
        allowance=1e-9,
        of_switching=switch_measures.switching_dwell,
    ),
    MeasureKind(
        name="valve_conflict",
        dimension="time",
        per_axis=False,
        of_switching=switch_measures.valve_conflict,
    ),
    MeasureKind(
        name="over_level",
        dimension="ratio",
        per_axis=False,
        allowance=1e-9,
        of_switching=switch_measures.over_level,
    ),
)
SWITCHING_LIMITS = ("switching_order", "switching_dwell", "valve_conflict", "over_level")
"""Measures of an on/off machine whose limit is the machine's own."""
MEASURES: dict[str, MeasureKind] = {kind.name: kind for kind in _KINDS}
