"""A verdict for machines (one JSON object) and for people (rows of a table)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from threadline import __version__
from threadline.plan import Plan, SwitchPlan
from threadline.signals import TickTable
from threadline.targets.schedule_moves import shaping_words
from threadline.units import without_noise
from threadline.verdict.types import Result, Status, Verdict

_SHOWN = {
    "m": (1e3, "mm"),
    "m/s": (1e3, "mm/s"),
    "rad": (180.0 / math.pi, "deg"),
    "rad/s": (180.0 / math.pi, "deg/s"),
    "rad/s^2": (180.0 / math.pi, "deg/s^2"),
    "rad/s^3": (180.0 / math.pi, "deg/s^3"),
    "s": (1e3, "ms"),
}


ON_OFF = "on-off"
"""Stands where other plans have an interpolation."""


def verdict_json(verdict: Verdict, plan: Plan | SwitchPlan) -> dict[str, Any]:
    """Return what ``prove --json`` prints; SI units, ``None`` for what is not a finite number."""
    commands = plan.commands
    if isinstance(plan, SwitchPlan):
        interpolation, duration_s = ON_OFF, plan.duration_s
    else:
        interpolation, duration_s = plan.interpolation, plan.trajectory.duration_s
    return {
        "job": plan.job.name,
        "machine": plan.machine.name,
        "interpolation": interpolation,
        "passed": verdict.passed,
        "duration_s": duration_s,
        "ticks": commands.tick_count() if isinstance(commands, TickTable) else None,
        "criteria": criteria_json(verdict),
        "job_sha256": plan.job.sha256,
        "machine_sha256": plan.machine.sha256,
        "threadline": __version__,
        "simulated": verdict.simulated,
        "options": dict(plan.options),
        **_feed_forward_json(plan),
        **_shaping_json(plan),
    }


def _feed_forward_json(plan: Plan | SwitchPlan) -> dict[str, Any]:
    if isinstance(plan, SwitchPlan) or not plan.feed_forward:
        return {}
    begin_s, end_s = plan.motion_s
    return {
        "motion": {"begin_s": begin_s, "end_s": end_s, "duration_s": end_s - begin_s},
        "feed_forward": [
            {
                "axis": demand.axis,
                "current_a": demand.current_a,
                "current_limit_a": _finite(demand.current_limit_a),
                "current_at_s": demand.current_at_s,
                "volts": demand.volts,
                "volt_limit": demand.volt_limit,
                "bound_by": demand.bound_by,
                "share": demand.share,
            }
            for demand in plan.feed_forward
        ],
    }


def motion_lines(plan: Plan) -> list[str]:
    """Return the line that says how long the motion is, where the table is longer."""
    if not plan.feed_forward:
        return []
    begin_s, end_s = plan.motion_s
    return [
        f"Motion:               {end_s - begin_s:.4g} s, from {begin_s:.3f} s to {end_s:.3f} s of "
        f"a table of {plan.trajectory.duration_s:.4g} s: feed-forward begins before it and goes "
        "on until what it set swinging has decayed"
    ]


def shaping_rows(plan: SwitchPlan) -> list[list[str]]:
    """Return every cylinder and how it is shaped: a bare kind was made for its own mode."""
    if "shaper" not in plan.options:
        return []
    shaping = plan.scheduled.shaping
    return [[axis, shaping_words(shaping.get(axis))] for axis in plan.machine.cylinders]


def _shaping_json(plan: Plan | SwitchPlan) -> dict[str, Any]:
    if isinstance(plan, Plan) or "shaper" not in plan.options:
        return {}
    return {
        "shaping": {
            axis: {
                "shaper": shaping.shaper.name,
                "modes": [
                    {"frequency_hz": m.frequency_hz, "damping_ratio": m.damping_ratio}
                    for m in shaping.modes
                ],
            }
            for axis, shaping in plan.scheduled.shaping.items()
        }
    }


def criteria_json(verdict: Verdict) -> list[dict[str, Any]]:
    """Return the criteria as ``prove --json`` lists them."""
    return [_criterion(result) for result in verdict.results]


def _criterion(result: Result) -> dict[str, Any]:
    return {
        "name": result.name,
        "axis": result.axis,
        **({"step": result.step} if result.step else {}),
        "measured": _finite(result.measured),
        "limit": _finite(result.limit),
        "unit": result.unit,
        "status": result.status.value,
        "time_s": result.time_s,
        "job_line": result.job_line,
        "passes": list(result.passes),
        "operation": result.operation,
        "position": None if result.position is None else list(result.position),
        "required": result.required,
        "note": result.note,
    }


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def closing(verdict: Verdict) -> str:
    """Return the line under a verdict for people.

    A verdict that fails only because something required was not measured says so: nothing was
    found out of specification, and nothing proved.
    """
    missing = dict.fromkeys(r.name for r in verdict.results if r.status is Status.NOT_MEASURED)
    if verdict.passed:
        count = len(missing)
        plural = "criterion" if count == 1 else "criteria"
        return "IN SPEC" + (f" ({count} {plural} not measured)" if count else "")
    if any(r.status is Status.FAILED for r in verdict.results):
        return "OUT OF SPEC"
    lacking = dict.fromkeys(r.name.replace("_", " ") for r in verdict.results if _lacking(r))
    were = "was" if len(lacking) == 1 else "were"
    return f"NOT PROVEN: {' and '.join(lacking)} {were} not measured"


def verdict_rows(
    verdict: Verdict, *, every_axis: bool = False
) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of the table for people, in mm, degrees, ms.

    Parameters
    ----------
    verdict
        Its results keep their order.
    every_axis
        One row per axis; else one per criterion, that of the worst axis and step. Where some were
        not measured it is the worst of the others, with a note; if they had to be, with a row of
        theirs.
    """
    header = ["criterion", "axis", "measured", "limit", "status", "at", "line", "note"]
    if every_axis:
        results: Sequence[Result] = verdict.results
    else:
        names = dict.fromkeys((r.name, r.unit) for r in verdict.results)
        results = [
            row
            for key in names
            for row in _worst([r for r in verdict.results if (r.name, r.unit) == key])
        ]
    return header, [_row(result) for result in results]


def _worst(results: Sequence[Result]) -> list[Result]:
    """Return the worst of the results of one criterion, and what hides behind it."""
    absent = [r for r in results if r.status is Status.NOT_MEASURED]
    measured = [r for r in results if r.status is not Status.NOT_MEASURED]
    if not measured or not absent:
        return [max(results, key=lambda result: result.severity)]
    worst = max(measured, key=lambda result: result.severity)
    lacking = [r for r in absent if r.required]
    if lacking:
        return [worst, lacking[0]]
    first = " ".join((absent[0].axis, absent[0].step)).strip()
    why = f"{first}: {absent[0].note}".strip(": ")
    told = f"{len(absent)} of {len(results)} not measured" + (f" ({why})" if why else "")
    return [replace(worst, note="; ".join(filter(None, (worst.note, told))))]


def _row(result: Result) -> list[str]:
    measured, note = result.measured, result.note
    if result.name == "travel" and measured is not None and measured < 0.0:
        # For people a travel that is kept is exceeded by nothing.
        room = _shown(without_noise(-measured), result.unit)
        measured, note = 0.0, f"{room} of room left"
    return [
        result.name,
        result.axis,
        "-" if measured is None else _figure(replace(result, measured=measured)),
        "-" if result.limit is None else _shown(result.limit, result.unit),
        result.status.value + (" (required)" if _lacking(result) else ""),
        "-" if result.time_s is None else f"{result.time_s:.3f} s",
        _line(result),
        f"{result.step}: {note}".removesuffix(": ") if result.step else note,
    ]


def _line(result: Result) -> str:
    if result.job_line is None:
        return "-"
    passes = f" (pass {'.'.join(map(str, result.passes))})" if result.passes else ""
    return f"{result.job_line}{passes}"


def step_rows(verdict: Verdict) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of what each step of a move list leaves, measure by measure.

    One row per step, in order; one column per measure and axis that is told of steps.
    """
    told = [r for r in verdict.results if r.step]
    columns = list(dict.fromkeys((r.name, r.axis) for r in told))
    cells = {(r.step, r.name, r.axis): r for r in told}
    header = ["step", *(" ".join((n, a)).strip() for n, a in columns)]
    rows = []
    for step in dict.fromkeys(r.step for r in told):
        row = [step]
        for column in columns:
            result = cells.get((step, *column))
            if result is None or result.measured is None:
                row.append("-" if result is None else "not measured")
                continue
            failed = result.status is Status.FAILED
            row.append(_figure(result) + (" (failed)" if failed else ""))
        rows.append(row)
    return header, rows


def _lacking(result: Result) -> bool:
    return result.required and result.status is Status.NOT_MEASURED


def _figure(result: Result) -> str:
    """Return what was measured for people: 0 for rounding, unless it is what fails."""
    assert result.measured is not None
    value = result.measured
    if result.status is not Status.FAILED:
        value = without_noise(value, result.limit)
    return _shown(value, result.unit)


def _shown(value: float, unit: str) -> str:
    if math.isinf(value):
        return "never" if unit == "s" else "unbounded"
    if not unit:
        return f"{100.0 * value:.3g} %"
    factor, name = _SHOWN.get(unit, (1.0, unit))
    return f"{value * factor:.4g} {name}"
