"""A verdict for machines (one JSON object) and for people (rows of a table)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from threadline import __version__
from threadline.base.arrays import finite
from threadline.commands.plan import Plan
from threadline.units import without_noise
from threadline.verdict.demands import VELOCITY_STEPS
from threadline.verdict.types import (
    REPEATED_RUNS,
    Change,
    Disturbance,
    Level,
    OverTolerances,
    Result,
    SearchedDays,
    Status,
    Verdict,
)

_LARGEST_SHARE = 10.0  # largest share of a limit that is shown as a figure
_NEARLY_ALL = 0.99  # above this share of a limit, and below all of it, a figure has a decimal
_ROUNDING = 1e-11  # of a share
HAPPENED = "What changed the motion"
_IN_SECONDS = 10.0  # longer times are shown in s: in ms they would have an exponent
_SHOWN = {
    "m": (1e3, "mm"),
    "m/s": (1e3, "mm/s"),
    "rad": (180.0 / math.pi, "deg"),
    "rad/s": (180.0 / math.pi, "deg/s"),
    "rad/s^2": (180.0 / math.pi, "deg/s^2"),
    "rad/s^3": (180.0 / math.pi, "deg/s^3"),
    "s": (1e3, "ms"),
}


def verdict_json(verdict: Verdict, plan: Plan) -> dict[str, Any]:
    """Return the content of ``prove --json``; SI units, ``None`` for values that are not finite."""
    return {
        "job": plan.job.name,
        "machine": plan.machine.name,
        "interpolation": plan.interpolation,
        "passed": verdict.passed,
        "duration_s": plan.duration_s,
        "feed_mode": plan.job.feed_rule or None,
        "nominal_s": plan.nominal_s,
        "ticks": plan.commands.tick_count(),
        "criteria": criteria_json(verdict),
        "job_sha256": plan.job.sha256,
        "machine_sha256": plan.machine.sha256,
        "threadline": __version__,
        "simulated": verdict.simulated,
        "level": verdict.level.value,
        "runs": verdict.runs,
        "covers": verdict.covers,
        "machines": verdict.machines,
        **tolerances_json(verdict),
        **({"ends": verdict.ends} if verdict.ends else {}),
        **({"band": verdict.band} if verdict.band else {}),
        "tightest": _tightest_json(verdict.tightest),
        "incomplete": verdict.incomplete,
        "late_ticks": verdict.late_ticks,
        "events": [_disturbance(one) for one in verdict.disturbances],
        "options": dict(plan.options),
        **plan.intent.json_entries(plan.options),
        **({"continuous": steady} if (steady := continuous(verdict, plan)) else {}),
    }


def continuous(verdict: Verdict, plan: Plan) -> dict[str, float]:
    """Return ``cycle_s`` and ``pieces_per_hour`` of continuous production.

    Both hold from the second cycle on, simulated or recorded. Empty if the first cycle is like all
    others, or the cycle time was not measured.
    """
    # Only move lists have a cycle time.
    found = [r.measured for r in verdict.results if r.name == "cycle_time"]
    if not found or found[0] is None or plan.scheduled.single is None:
        return {}
    return {"cycle_s": found[0], "pieces_per_hour": 3600.0 / found[0]}


def _tightest_json(result: Result | None) -> dict[str, Any] | None:
    if result is None or result.measured is None or not result.limit:
        return None
    share = finite(result.measured / result.limit)
    return {"name": result.name, "axis": result.axis, "share_of_limit": share}


def tolerances_json(verdict: Verdict) -> dict[str, Any]:
    """Return one entry with the searched and the drawn machines, and one with searched days."""
    found, days = verdict.tolerances, verdict.days
    of_days = {} if days is None else {"days": {**asdict(days), "share": finite(days.share)}}
    if found is None:
        return of_days
    return of_days | {
        "tolerances": {
            "worst_share": finite(found.share),
            "worst_criterion": found.criterion,
            "searched": found.searched,
            "drawn": found.drawn,
            "passed": found.passed,
            "at_least": found.least,
            "confidence": found.confidence,
        }
    }


def criteria_json(verdict: Verdict) -> list[dict[str, Any]]:
    """Return the criteria as in ``prove --json``."""
    return [_criterion(result) for result in verdict.results]


def _criterion(result: Result) -> dict[str, Any]:
    return {
        "name": result.name,
        "axis": result.axis,
        **({"step": result.step} if result.step else {}),
        "measured": finite(result.measured),
        "limit": finite(result.limit),
        "unit": result.unit,
        "status": result.status.value,
        "time_s": result.time_s,
        "job_line": result.job_line,
        "passes": list(result.passes),
        "operation": result.operation,
        "position": None if result.position is None else list(result.position),
        "run": result.run,
        "of": result.of,
        "required": result.required,
        "note": result.note,
    }


def _disturbance(one: Disturbance) -> dict[str, Any]:
    return {
        "kind": one.change.value,
        "text": one.text,
        "axis": one.axis,
        "time_s": finite(one.time_s),
        "job_line": one.job_line,
        "operation": one.operation,
        "run": one.run,
    }


def _cuts(verdict: Verdict) -> list[str]:
    """Return the text about the first limit switch that cut a motor; usually empty."""
    cuts = [one.words for one in verdict.disturbances if one.change is Change.LIMIT_SWITCH]
    return cuts[:1]


def happened_lines(verdict: Verdict) -> list[str]:
    """Return a line for each event that changed the motion of the runs, with time and line."""
    return [f"{HAPPENED}: {one.words}" for one in verdict.disturbances]


def happened_rows(verdict: Verdict) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of a table of events that changed the motion of the runs."""
    rows = [
        [
            one.text,
            "-" if one.time_s is None else f"{one.time_s:.3f} s",
            str(one.job_line or "-"),
            str(one.run or "-"),
        ]
        for one in verdict.disturbances
    ]
    return [HAPPENED.lower(), "at", "line", "run"], rows


def closing(verdict: Verdict) -> str:
    """Return the line under a verdict for people: result, level, and smallest margin.

    A verdict that fails only because a required criterion was not measured says so: nothing was
    found out of specification, and nothing proved. If the machine keeps its limits and no other
    measured criterion has a limit, the line says only that.
    """
    level = _level(verdict)
    missing = dict.fromkeys(r.name for r in verdict.results if r.status is Status.NOT_MEASURED)
    if verdict.passed:
        about = [level]
        if not verdict.answers and verdict.level is not Level.LIMITS:
            about.append(_unasked(verdict))
        about += _corner_jumps(verdict)
        if verdict.tightest is not None:
            about += _used_beside(verdict.tightest, verdict)
        about += _cuts(verdict)
        if missing:
            plural = "criterion" if len(missing) == 1 else "criteria"
            about.append(f"{len(missing)} {plural} not measured")
        if verdict.late_ticks:
            about.append(f"{verdict.late_ticks} ticks late")
        return f"{'IN SPEC' if verdict.answers else 'LIMITS KEPT'} ({'; '.join(about)})"
    if any(r.status is Status.FAILED for r in verdict.results):
        worst = verdict.tightest
        about = [level]
        if worst is not None and worst.status is Status.FAILED:
            about += _used_beside(worst, verdict)
        about += _cuts(verdict)
        return f"OUT OF SPEC ({'; '.join(about)})"
    if verdict.incomplete:
        return f"NOT PROVEN ({level}): {verdict.incomplete}"
    lacking = dict.fromkeys(r.name.replace("_", " ") for r in verdict.results if _lacking(r))
    were = "was" if len(lacking) == 1 else "were"
    return f"NOT PROVEN ({level}): {' and '.join(lacking)} {were} not measured"


def in_a_word(verdict: Verdict) -> str:
    """Return a verdict for a table: the first word or two of :func:`closing`."""
    if verdict.passed:
        return "in spec" if verdict.answers else "limits kept"
    failed = any(result.status is Status.FAILED for result in verdict.results)
    return "OUT" if failed else "not proven"


def word_of_json(content: Mapping[str, Any]) -> str:
    """Return the first word or two of :func:`closing` for a verdict that was written as JSON."""
    if content["passed"]:
        return "limits kept" if content.get("level") == Level.LIMITS else "in spec"
    failed = any(one["status"] == Status.FAILED for one in content["criteria"])
    return "out of spec" if failed else "not proven"


def closing_of_all(verdicts: Sequence[Verdict]) -> str:
    """Return the line under several verdicts: how many are in spec, and at which level.

    If the verdicts judge only the limits of the machines, the line says only that they are kept.
    """
    good = sum(verdict.passed for verdict in verdicts)
    what = "in spec" if any(verdict.answers for verdict in verdicts) else "within the limits"
    levels = dict.fromkeys(
        _level(verdict) if verdict.level is Level.LIMITS else f"{_level(verdict)} each"
        for verdict in verdicts
    )
    how_many = "every case" if good == len(verdicts) else f"{good} of {len(verdicts)} cases"
    return f"{how_many} {what} ({', '.join(levels)})"


def _level(verdict: Verdict) -> str:
    if verdict.level is Level.LIMITS:
        return f"{verdict.level}: placement is not proven, the machine file has no dynamics"
    text = f"{verdict.level}: {verdict.runs} run{'s' if verdict.runs > 1 else ''}"
    if verdict.runs > REPEATED_RUNS and not verdict.recorded:
        text += f", at least {math.floor(1000.0 * verdict.covers) / 10.0:g} % of all runs"
    if verdict.tolerances is not None:
        text += f"; {'; '.join(_of_machines(verdict.tolerances))}"
    elif verdict.machines:
        text += f", {verdict.machines} machine{'s' if verdict.machines > 1 else ''} within them"
    if verdict.days is not None:
        found, kind = verdict.days, "machines and days" if verdict.days.machines else "days"
        text += f"; {_about_worst(f'the worst of {found.searched} {kind} of a search', found)}"
    if verdict.ends:
        text += f", {verdict.ends} at the ends of the tolerances of loads and springs, one run each"
    if verdict.band:
        text += f", {verdict.band} with modes all over the band, one run each"
    if verdict.wanted_yield is not None:
        text += f", wanted yield {100.0 * verdict.wanted_yield:.6g} %"
    return text


def _of_machines(found: OverTolerances) -> list[str]:
    """Return the text about the worst machine searched and the drawn machines."""
    about = [_about_worst(f"the worst of {found.searched} machines searched", found)]
    if found.drawn:
        least = math.floor(1000.0 * found.least + 1e-9) / 10.0
        about.append(
            f"{found.passed} of {found.drawn} drawn machines in spec, so at least {least:g} % of "
            f"all, with {100.0 * found.confidence:g} % confidence"
        )
    return about


def _about_worst(worst: str, found: OverTolerances | SearchedDays) -> str:
    if not found.criterion:
        return f"{worst} is in spec"
    if found.share is None:
        return f"{worst} fails {found.criterion}"
    digits = 1 if isinstance(found, SearchedDays) else 0  # often within 1 % of the limit
    return f"{worst} uses {percent_used(found.share, digits)} of {found.criterion}"


def _used_beside(result: Result, verdict: Verdict) -> list[str]:
    """Return the used share of a result's limit, unless the result is the worst machine's."""
    of_worst = verdict.tolerances and verdict.tolerances.share
    return [] if of_worst and of_worst == _share(result) else [_used(result)]


def _share(result: Result) -> float:
    assert result.measured is not None and result.limit
    return result.measured / result.limit


def _used(result: Result) -> str:
    """Return the used share of a result's limit, rounded up: 100 % is never less."""
    assert result.measured is not None and result.limit
    name = " ".join(filter(None, (result.name, result.axis, result.step)))
    share = max(result.measured, 0.0) / result.limit
    if math.isinf(share):  # such as the settling time of a tool that never settles
        return f"{name} is beyond any multiple of its limit"
    return f"{percent_used(share)} of {name} used"


def percent_used(share: float, digits: int = 0) -> str:
    """Return the used share of a limit, in per cent, rounded up.

    A result never reads better than it is: 100 % is never more than the limit. Between 99 and
    100 % it has a decimal, so that a result within its limit does not read as one at its limit.
    Above ten times the limit the exact figure is omitted: something else must be wrong then.
    >>> percent_used(0.9401), percent_used(1.0), percent_used(1.0004), percent_used(0.9401, 1)
    ('95 %', '100 %', '101 %', '94.1 %')
    >>> percent_used(0.99), percent_used(0.9914), percent_used(0.9996)
    ('99 %', '99.2 %', '100.0 %')
    >>> percent_used(10.0), percent_used(112137.9)
    ('1000 %', 'more than 1000 %')
    """
    if share > _LARGEST_SHARE:
        return f"more than {100.0 * _LARGEST_SHARE:.0f} %"
    if _NEARLY_ALL + _ROUNDING < share < 1.0 - _ROUNDING:
        digits = max(digits, 1)
    fine = 10.0**digits
    return f"{math.ceil(100.0 * share * fine - 1e-9) / fine:.{digits}f} %"


_CORNERS_JUMP = (
    "corners jump in speed, as on the controller, beyond limits of acceleration and jerk"
)


def _corner_jumps(verdict: Verdict) -> list[str]:
    """Return a line about limits of the machine that a plan need not keep; usually empty."""
    steps = any(r.hard and r.limit is None and VELOCITY_STEPS in r.note for r in verdict.results)
    if verdict.answers or not steps:
        return []
    return [_CORNERS_JUMP]


def _unasked(verdict: Verdict) -> str:
    """Return why a verdict judges nothing beyond the limits of the machine."""
    names = dict.fromkeys(r.name for r in verdict.results if r.limit is not None and not r.hard)
    if names:
        were = "was" if len(names) == 1 else "were"
        return f"{' and '.join(names)} {were} not measured"
    return "the specification sets no other limit"


def verdict_rows(
    verdict: Verdict, *, every_axis: bool = False
) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of the table for people, in mm, degrees, ms.

    Parameters
    ----------
    verdict
        Its results keep their order.
    every_axis
        One row per axis; otherwise one per criterion, for the worst axis and step, without the
        zeros of axes that never move (the verdict has these, too). If some axes were not measured,
        the row is the worst of the others, with a note; a required one gets its own row.
    """
    header = ["criterion", "axis", "measured", "limit", "status", "at", "line", "note"]
    if every_axis:
        results: Sequence[Result] = verdict.results
    else:
        moving = of_moving_axes(verdict.results)
        names = dict.fromkeys((r.name, r.unit) for r in moving)
        results = [
            row for key in names for row in _worst([r for r in moving if (r.name, r.unit) == key])
        ]
    return header, [_row(_of_what(result, verdict)) for result in results]


def _of_what(result: Result, verdict: Verdict) -> Result:
    """Return a result, with a note if a recording is judged and the value comes from the plan.

    A limit of the plan that was measured on the recording has a note, too.
    """
    if result.of == "run" or (result.of == "plan" and not verdict.recorded):
        return result
    room = result.name == "travel" and result.measured is not None and result.measured < 0.0
    text = "" if room else result.note
    return replace(result, note="; ".join(filter(None, (f"of the {result.of}", text))))


def of_moving_axes(results: Sequence[Result]) -> list[Result]:
    """Return the results except results of axes that rest while another moves.

    An axis rests if its motion never has a speed. Results that failed, were not measured or are not
    0 stay, because another axis may shake this one. Its remaining travel is left out.
    """
    speeds = {r.axis: r.measured for r in results if r.name == "velocity"}
    still = {axis for axis, v in speeds.items() if v is not None and without_noise(v) == 0.0}
    if len(still) == len(speeds):
        return list(results)
    of_no_interest = (Status.PASSED, Status.REPORTED)
    return [
        r
        for r in results
        if r.axis not in still
        or r.status not in of_no_interest
        or not (r.name == "travel" or without_noise(r.measured or 0.0, r.limit) == 0.0)
    ]


def _worst(results: Sequence[Result]) -> list[Result]:
    """Return the worst result of one criterion, and the first required one that is missing.

    The note of the worst counts results that are not measured and not required.
    """
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
    text = f"{len(absent)} of {len(results)} not measured" + (f" ({why})" if why else "")
    return [replace(worst, note="; ".join(filter(None, (worst.note, text))))]


def _row(result: Result) -> list[str]:
    measured, note = result.measured, result.note
    if result.name == "travel" and measured is not None and measured < 0.0:
        # Within the travel the figure is 0, and the note gives the travel that is left.
        room = shown(without_noise(-measured), result.unit)
        of = f"{note}; " if note.startswith("of the ") else ""
        measured, note = 0.0, f"{of}{room} of travel left"
    elif result.name == "travel" and measured == 0.0:
        note = note or "up to the end of the travel"
    return [
        result.name,
        result.axis,
        "-" if measured is None else _figure(replace(result, measured=measured)),
        "-" if result.limit is None else shown(result.limit, result.unit),
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
    """Return header and rows of the results of each step of a move list.

    One row per step, in order; one column per measure and axis with results by step.
    """
    of_steps = [r for r in verdict.results if r.step]
    columns = list(dict.fromkeys((r.name, r.axis) for r in of_steps))
    cells = {(r.step, r.name, r.axis): r for r in of_steps}
    header = ["step", *(" ".join((n, a)).strip() for n, a in columns)]
    rows = []
    for step in dict.fromkeys(r.step for r in of_steps):
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
    """Return the measured value for people: rounding errors are 0 unless they fail a limit."""
    assert result.measured is not None
    value = result.measured
    if result.status is not Status.FAILED:
        value = without_noise(value, result.limit)
    return shown(value, result.unit)


def shown(value: float, unit: str) -> str:
    """Return an SI value for people: in mm, degrees, ms, per cent."""
    if math.isinf(value):
        return "never" if unit == "s" else "unbounded"
    if not unit:
        return f"{float(f'{100.0 * value:.3g}'):g} %"  # 1250 %, not 1.25e+03 %
    if unit == "s" and abs(value) >= _IN_SECONDS:
        return f"{value:.5g} s"
    factor, name = _SHOWN.get(unit, (1.0, unit))
    return f"{value * factor:.4g} {name}"
