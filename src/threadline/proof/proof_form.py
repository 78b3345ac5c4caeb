"""The form of a proof file: required entries, their types, and freedom from contradiction.

Anybody can write a file with a valid hash. Therefore the claims of a proof (whether the work is in
specification, and at which level) are derived from its criteria, and its criteria must equal the
criteria of the specification. Only the measured values are accepted without a check, because only a
simulation can give them. Proving again shows whether they are right, since equal proofs have equal
bytes, and a signature shows who wrote them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from types import UnionType
from typing import Any

from threadline.base.arrays import finite
from threadline.base.option_defaults import MOST_REPEATS, MOST_RUNS
from threadline.commands.plan import Plan
from threadline.proof.kinds.variants import REJECTS, UNANSWERED
from threadline.verdict import Spec
from threadline.verdict.demands import with_needle
from threadline.verdict.each_run import CONFIDENCE, at_least, clopper_pearson, limit_of, unit_of
from threadline.verdict.measure import MeasureKind
from threadline.verdict.registry import MEASURES
from threadline.verdict.switch_run import steps_judged
from threadline.verdict.types import Criterion, Level, Status, level_of

_Form = Mapping[str, Any] | list[Any] | type | UnionType
"""Form of a value: a mapping from entry to form, a list with the form of all items, or a type."""
_MACHINE: _Form = {"name": str, "reference": str, "par": str | None, "sha256": str}
_CRITERION: _Form = {
    "name": str,
    "axis": str | None,
    "status": str,
    "required": bool,
    "measured": float | int | None,
    "limit": float | int | None,
    "unit": str,
}
_PROOF: Mapping[str, _Form] = {
    "threadline": str,
    "level": str,
    "runs": int,
    "machines": int,
    "job": {"name": str, "file": str, "sha256": str},
    "machine": _MACHINE,
    "actual": dict | None,  # as "machine", if present
    "options": {"given": dict, "sha256": str},
    "spec": {"name": str, "file": str | None, "sha256": str},
    "commands": {"kind": str, "sha256": str},
    "verdict": {"passed": bool, "simulated": bool, "criteria": [_CRITERION]},
}
_HASHED = ("job", "machine", "actual", "options", "spec", "commands")
_SHA256 = re.compile("[0-9a-f]{64}")
_MOST_MACHINES = 1_000_000
"""Largest accepted number of machines, far more than ``--tolerances`` and ``--yield`` judge."""
_TOLERANCES: _Form = {
    "worst_share": float | int | None,
    "worst_criterion": str,
    "searched": int,
    "drawn": int,
    "passed": int,
    "at_least": float | int,
    "confidence": float | int,
}
_ROUNDED = 1e-9
"""Allowed rounding error of a value at an end of its range, and of a recomputed bound."""
_MOST = 1e100
"""Largest accepted value, far beyond what any criterion can measure."""
_OF_MACHINES = (REJECTS, UNANSWERED)
"""Criteria over many machines together, which no specification names."""


def malformed_entry(content: Mapping[str, Any]) -> str:
    """Return the name of the first entry that is missing or has a wrong type; empty if none is.

    Parameters
    ----------
    content
        All entries of the file.
    """
    given = content.get("options")
    options = given.get("given") if isinstance(given, dict) else None
    verdict = content.get("verdict")
    ended = verdict.get("incomplete", "") if isinstance(verdict, dict) else ""
    return (
        _wrong(content, _PROOF, "")
        or ("" if content["actual"] is None else _wrong(content["actual"], _MACHINE, "actual"))
        or ("" if isinstance(ended, str) else "verdict.incomplete")
        or ("tolerances" in content and _wrong(content["tolerances"], _TOLERANCES, "tolerances"))
        or _wrong(options, dict.fromkeys(options or (), str), "options.given")
    )


def _wrong(value: object, form: _Form, entry_name: str) -> str:
    if isinstance(form, Mapping):
        if not isinstance(value, dict):
            return entry_name
        children = (
            (value.get(key, ...), entry_form, f"{entry_name}.{key}".lstrip("."))
            for key, entry_form in form.items()
        )
    elif isinstance(form, list):
        if not isinstance(value, list):
            return entry_name
        children = (
            (child, form[0], f"{entry_name}.{number}") for number, child in enumerate(value)
        )
    else:
        fits = isinstance(value, form) and (form is bool or not isinstance(value, bool))
        return "" if fits else entry_name
    return next(filter(None, (_wrong(*child) for child in children)), "")


def contradiction(content: Mapping[str, Any]) -> str:
    """Return how a proof of the right form contradicts itself; empty if it does not.

    Parameters
    ----------
    content
        All entries of the file.
    """
    return next(filter(None, _contradictions(content)), "")


def _contradictions(content: Mapping[str, Any]) -> Iterator[str]:
    verdict, level = content["verdict"], content["level"]
    runs, machines, criteria = content["runs"], content["machines"], verdict["criteria"]
    for what in _HASHED:
        part = content[what]
        if part is not None and not _SHA256.fullmatch(part["sha256"]):
            yield f"the sha256 of {what} is not one: {part['sha256'][:20]!r}"
    if runs < 1 or machines < 0:
        yield f"it counts {_shown(runs)} runs and {_shown(machines)} other machines"
    for number, most, what in (
        (runs, max(MOST_REPEATS, MOST_RUNS), "runs"),
        (machines, _MOST_MACHINES, "other machines"),
    ):
        if number > most:
            yield f"it counts {_shown(number)} {what}, and a verdict has at most {most}"
    if not criteria:
        yield "it has no criteria"
    if not verdict["simulated"]:
        yield "it says that its runs were not simulated"
    rows = [tuple(c.get(key) or "" for key in ("name", "axis", "step")) for c in criteria]
    for criterion, row in zip(criteria, rows, strict=True):
        yield _of_criterion(criterion)
        if rows.count(row) > 1:
            yield f"{_name(criterion)} is in it {rows.count(row)} times"
    limits = [c["limit"] for c in criteria if c["name"] == REJECTS]
    if level != Level.LIMITS:
        reached = level_of(runs, machines, limits[0] if limits else None)
        if level != reached:
            yield (
                f"its level is {level[:40]!r}, where {runs} runs and {machines} other machines "
                f"reach {reached.value!r}"
            )
    yield from _of_tolerances(content)
    yield from _of_rejects(criteria, machines)
    stated_pass, derived_pass = verdict["passed"], in_spec(content)
    if stated_pass and not derived_pass:
        yield f"it says that it passed, where {_against(criteria) or 'a run was not complete'}"
    if derived_pass and not stated_pass:
        yield "it says that it did not pass, where no criterion failed"


def _of_tolerances(content: Mapping[str, Any]) -> Iterator[str]:
    """Yield the contradictions in a proof's results for machines within the tolerances."""
    row, over_tolerances = content.get("tolerances"), content["level"] == Level.TOLERANCES
    if row is None or not over_tolerances:
        if over_tolerances or row is not None:
            entry_text = "no entry" if row is None else "an entry"
            yield f"its level is {content['level'][:40]!r}, and it has {entry_text} 'tolerances'"
        return
    drawn, passed, share = row["drawn"], row["passed"], row["worst_share"]
    if drawn != content["machines"] or row["searched"] < 1:
        yield (
            f"it counts {content['machines']} other machines, where {_shown(drawn)} were drawn and "
            f"{_shown(row['searched'])} searched"
        )
    elif not 0 <= passed <= drawn:
        yield f"{_shown(passed)} of {drawn} drawn machines are in specification"
    elif (
        not math.isclose(
            row["at_least"],
            at_least(passed, drawn, CONFIDENCE),
            rel_tol=_ROUNDED,
            abs_tol=_ROUNDED,
        )
        or row["confidence"] != CONFIDENCE
    ):
        yield (
            f"{passed} of {drawn} drawn machines show that at least "
            f"{at_least(passed, drawn):.4f} of all are in specification, with {CONFIDENCE:g} "
            "confidence, and it says another share"
        )
    if share is not None and share < 0.0:
        yield f"its worst machine uses the share {share:.4g} of a limit"
    if content["verdict"]["passed"] and passed < drawn:
        yield f"it says that it passed, where {drawn - passed} drawn machines are out of it"


def _of_rejects(criteria: list[Any], machines: int) -> Iterator[str]:
    """Yield a contradiction if the share of rejects is below the bound for so many machines."""
    for criterion in criteria:
        measured = criterion["measured"]
        if criterion["name"] == REJECTS and measured is not None and machines > 0:
            best = 1.0 - clopper_pearson(machines, machines)[0]
            if measured < best - _ROUNDED:
                yield (
                    f"its rejects are {measured:.4g}, and {machines} machines cannot show less "
                    f"than {best:.4g}"
                )


def in_spec(content: Mapping[str, Any]) -> bool:
    """Return whether the criteria of a proof give a passed verdict."""
    verdict = content["verdict"]
    return not verdict.get("incomplete") and not _against(verdict["criteria"])


def _against(criteria: list[Any]) -> str:
    """Return which criterion prevents a pass, and how; empty if none does."""
    for criterion in criteria:
        status = criterion["status"]
        if status == Status.FAILED:
            return f"{_name(criterion)} failed"
        if status == Status.NOT_MEASURED and criterion["required"]:
            return f"{_name(criterion)} is required and was not measured"
    return ""


def _shown(number: int) -> str:
    if abs(number) < 10**12:
        return str(number)
    return "more than 1e12" if number > 0 else "less than -1e12"


def _name(criterion: Mapping[str, Any]) -> str:
    return f"{criterion['name']} {criterion['axis'] or ''}".strip()[:60]


def _of_criterion(criterion: Mapping[str, Any]) -> str:
    """Return how the status of a criterion contradicts its measured value and its limit."""
    name, measured, limit = _name(criterion), criterion["measured"], criterion["limit"]
    measure_kind = MEASURES.get(criterion["name"])
    if measure_kind is None and criterion["name"] not in _OF_MACHINES:
        return f"there is no criterion {name!r}"
    status = criterion["status"]
    if status not in {*Status}:
        return f"{name} has the unknown status {status[:40]!r}"
    range_text = _out_of_range(criterion, measure_kind)
    if range_text:
        return range_text
    if measured is None:
        # An infinite time is written as null, and fails any limit.
        endless = criterion["unit"] == "s" and status == (
            Status.REPORTED if limit is None else Status.FAILED
        )
        expected = status if endless else Status.NOT_MEASURED
    elif measure_kind is not None:
        expected = measure_kind.status(measured, limit)
    else:
        expected = Status.PASSED if limit is not None and measured <= limit else Status.FAILED
    if status == expected:
        return ""
    measure = "nothing measured" if measured is None else f"{measured:.6g}"
    limit_text = "no limit" if limit is None else f"a limit of {limit:.6g}"
    return f"{name} is {status!r} with {measure} under {limit_text}, which is {expected.value!r}"


def _out_of_range(criterion: Mapping[str, Any], kind: MeasureKind | None) -> str:
    """Return which value or limit lies outside the range of its criterion; empty if none does."""
    name, measured = _name(criterion), criterion["measured"]
    for number in (measured, criterion["limit"]):
        if number is not None and abs(number) > _MOST:
            return f"{name} has a number beyond {_MOST:g}"
    least, most = (0.0, 1.0) if kind is None else (kind.least, kind.most)
    if measured is None or least - _ROUNDED <= measured <= most + _ROUNDED:
        return ""
    end_text = f"less than {least:g}" if measured < least else f"more than {most:g}"
    return f"{name} is {measured:.6g}, and it cannot be {end_text}"


def criteria_difference(content: Mapping[str, Any], plan: Plan, spec: Spec) -> str:
    """Return how the criteria of a proof differ from plan and specification; empty if they agree.

    Parameters
    ----------
    content
        All entries of the file; its hashes match ``plan`` and ``spec``.
    plan
        The proved plan.
    spec
        The specification by which the plan was judged.
    """
    limits_only = content["level"] == Level.LIMITS
    if limits_only and not plan.machine.without_dynamics:
        return f"its level is {content['level']!r}, and {plan.machine.name} has dynamics"
    for what, stated, hashed in (
        ("machine", content["machine"]["name"], plan.machine.name),
        ("specification", content["spec"]["name"], spec.name),
        ("kind of commands", content["commands"]["kind"], plan.machine.commanded_by),
    ):
        if stated != hashed:
            return f"its {what} is {stated[:40]!r}, and the hashed one {hashed!r}"
    criteria = with_needle(spec, plan.job).criteria
    rows = [c for c in content["verdict"]["criteria"] if c["name"] not in _OF_MACHINES]
    return next(
        filter(
            None,
            (
                *(_unasked(row, criteria, plan) for row in rows),
                *_missing(rows, criteria, plan),
                *_missing_steps(rows, criteria, plan),
                *_too_few_runs(rows, criteria, content["runs"]),
            ),
        ),
        "",
    )


def _unasked(row: Mapping[str, Any], criteria: tuple[Criterion, ...], plan: Plan) -> str:
    """Return how a criterion of a proof differs from the specification; empty if it agrees."""
    axis, step = row["axis"] or "", row.get("step", "")
    matching = [
        criterion
        for criterion in criteria
        if (criterion.name, criterion.axis or axis, criterion.step or step)
        == (row["name"], axis, step)
    ]
    if not matching:
        return f"{_name(row)} is no criterion of the specification"
    limits = [finite(limit_of(criterion, plan)) for criterion in matching]
    if row["limit"] not in limits:
        limit_texts = [
            "none" if limit is None else f"{limit:.6g}" for limit in (row["limit"], limits[0])
        ]
        return (
            f"the limit of {_name(row)} is {limit_texts[0]}, in the specification {limit_texts[1]}"
        )
    if row["required"] not in {criterion.required for criterion in matching}:
        return f"{_name(row)} is required in only one of proof and specification"
    unit = unit_of(MEASURES[row["name"]], axis, plan)
    if row["unit"] != unit:
        return f"{_name(row)} is measured in {unit or 'shares'}, not in {row['unit'][:20]!r}"
    return ""


def _missing(rows: list[Any], criteria: tuple[Criterion, ...], plan: Plan) -> Iterator[str]:
    """Yield the criteria of the specification, by axis or for the tool, that a proof lacks."""
    present = {(row["name"], row["axis"] or "") for row in rows}
    for criterion in criteria:
        axes: tuple[str, ...] = ("",)
        if MEASURES[criterion.name].per_axis:
            axes = (criterion.axis,) if criterion.axis else tuple(plan.axes)
        for axis in axes:
            idle = axis not in plan.axes and criterion.every_axis
            endless = axis in plan.machine.axes and plan.machine.axes[axis].endless
            if (axis and idle) or (criterion.name == "travel" and endless):
                continue
            if (criterion.name, axis) not in present:
                yield f"it lacks {f'{criterion.name} {axis}'.strip()}, which the specification asks"


def _missing_steps(rows: list[Any], criteria: tuple[Criterion, ...], plan: Plan) -> Iterator[str]:
    """Yield the steps of a move list that a proof lacks in a criterion judged step by step."""
    steps_by_criterion = steps_judged(plan)
    present = {(row["name"], row["axis"] or "", row.get("step") or "") for row in rows}
    stepped = {(name, axis) for name, axis, step in present if step}
    for criterion in criteria:
        for axis, step in steps_by_criterion.get(criterion.name, ()):
            if criterion.axis not in {"", axis} or criterion.step not in {"", step}:
                continue
            if (criterion.name, axis) in stepped and (criterion.name, axis, step) not in present:
                yield (
                    f"it lacks {' '.join(filter(None, (criterion.name, axis)))} of the step "
                    f"{step[:40]!r}"
                )


def _too_few_runs(rows: list[Any], criteria: tuple[Criterion, ...], runs: int) -> Iterator[str]:
    """Yield measured criteria that compare more runs than the proof has."""
    measured = {row["name"] for row in rows if row["measured"] is not None}
    for criterion in criteria:
        kind = MEASURES[criterion.name]
        if criterion.name in measured and kind.compares_runs:
            least = max(int(kind.with_defaults(criterion.options)["recordings"]), 2)
            if runs < least:
                yield f"{criterion.name} is measured, which needs {least} runs, and it has {runs}"
