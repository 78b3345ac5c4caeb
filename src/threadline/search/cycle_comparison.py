"""Cycles of an on/off machine side by side: unshaped, shaped, and found by searches."""

from __future__ import annotations

from dataclasses import dataclass

from threadline.errors import PlanError, RecordingError
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, plan_job, prove_plan
from threadline.search.cycle import FastestCycle, cycle_s
from threadline.search.cycle_robust import MEASURE, BandRun, RobustCycle, band_machines, over_band
from threadline.search.move_list import overlapped, with_choices
from threadline.search.paced import Question
from threadline.verdict import Verdict

SHAPERS = ("none", "zv", "um-zv", "um-zvd", "um-ei", "um-2ei", "zv*um-2ei")
"""Compared shapers, each for all moves and designed for the machine's own modes."""


AS_LISTED = "unshaped, as listed"


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleRow:
    """One cycle of the comparison.

    Parameters
    ----------
    name
        Name of the moves' commands.
    cycle_s
        Duration of the cycle on the machine of the file.
    worst_m, passed
        Largest residual vibration of the file's machine in one run, and whether it is in spec.
    over_m, over_passed
        Residual vibration and verdict over all machines of the band; None without a band.
    """

    name: str
    cycle_s: float
    worst_m: float
    passed: bool
    over_m: float | None
    over_passed: bool | None


def compare_cycles(
    question: Question, found: FastestCycle, robust: RobustCycle | None
) -> tuple[CycleRow, ...]:
    """Return rows for the unshaped cycle, for one shaper on every move, and for the found cycles.

    All rows but the first overlap moves where the list allows it. The shaper row shows the shaper
    with the shortest cycle in spec on the machine of the file. With a band another row shows the
    shaper with the shortest cycle in spec on all machines of the band. Where no shaper is in spec,
    the row shows the shaper with the least vibration.
    """
    machine, spec, progress = question.machine, question.spec, question.progress
    machines = () if question.band is None else band_machines(machine, question.band)
    rows = {}
    overlapped_job = overlapped(with_choices(question.job, {}, {}), machine)
    for number, name in enumerate(SHAPERS):
        if progress is not None:
            progress("cycles side by side", number / len(SHAPERS))
        try:
            plan = plan_job(overlapped_job, machine, Options(shaper=name))
            proof = prove_plan(plan, spec, None, NOMINAL, question.actual)
            band_runs = over_band(plan, spec, machines)
        except (PlanError, RecordingError):
            continue  # the valves cannot make the command, or the cycle never ends
        rows[name] = _row(name, cycle_s(proof), proof.verdict, band_runs)
    listed_proof = found.unshaped
    shown = [
        _row(
            AS_LISTED,
            cycle_s(listed_proof),
            listed_proof.verdict,
            over_band(listed_proof.plan, spec, machines),
        )
    ]
    if "none" in rows and rows["none"].cycle_s < shown[0].cycle_s:
        shown.append(rows["none"])
    shaped = [row for name, row in rows.items() if name != "none"]
    if shaped:
        best_rows = [_best(shaped, [row.passed for row in shaped])]
        if machines:
            best_rows.append(_best(shaped, [bool(row.over_passed) for row in shaped]))
        shown += dict.fromkeys(best_rows)
    if found.job is not None:
        band_runs = over_band(found.proof.plan, spec, machines)
        shown.append(
            _row("found for the machine", cycle_s(found.proof), found.proof.verdict, band_runs)
        )
    if robust is not None and robust.job is not None:
        proof = robust.proof
        shown.append(_row("found for the band", cycle_s(proof), proof.verdict, robust.over))
    return tuple(shown)


def _best(rows: list[CycleRow], passed: list[bool]) -> CycleRow:
    if any(passed):
        passing = [row for row, ok in zip(rows, passed, strict=True) if ok]
        return min(passing, key=lambda row: row.cycle_s)
    return min(rows, key=lambda row: row.worst_m if row.over_m is None else row.over_m)


def _row(
    name: str, duration_s: float, verdict: Verdict, band_runs: tuple[BandRun, ...]
) -> CycleRow:
    vibrations_m = [
        r.measured for r in verdict.results if r.name == MEASURE and r.measured is not None
    ]
    return CycleRow(
        name="unshaped, overlapped" if name == "none" else name,
        cycle_s=duration_s,
        worst_m=max(vibrations_m, default=0.0),
        passed=verdict.passed,
        over_m=max((run.worst_m for run in band_runs), default=None),
        over_passed=all(run.verdict.passed for run in band_runs) if band_runs else None,
    )
