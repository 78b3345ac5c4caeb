"""``threadline fastest --band``: a cycle for a band of modes, and cycles side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from threadline.cli.output import print_table, say
from threadline.errors import OptionError
from threadline.report.document import Printed
from threadline.search.cycle import cycle_s
from threadline.search.cycle_beside import BesideRow
from threadline.search.cycle_robust import RobustCycle
from threadline.typed_number import parse_number
from threadline.verdict import closing, criteria_json, verdict_rows


def parse_band(text: str) -> float:
    """Return the half width of a band, ``"20 %"`` of the frequency, as a share: 0.2.

    Raises
    ------
    OptionError
        If it is not above 0 % and at most 60 %.
    """
    value = parse_number("band", text, "", "20 %")
    if not 0.0 < value <= 0.6:
        raise OptionError(
            f"band {text!r} must be above 0 % and at most 60 % of the frequency",
            remedy='Modes that may be a fifth off to either side are "20 %".',
        )
    return value


def robust_table(robust: RobustCycle, title: str, band: float) -> Printed:
    """Return the moves of the cycle found for the band ``band`` (half width, a share)."""
    header = ["step", "axis", "mm", "unshaped s", "bound s", "found s", "over the bound"]
    rows = [
        [
            move.step,
            move.axis,
            f"{move.distance_m * 1e3:g}",
            f"{move.unshaped_s:.3f}",
            f"{move.bound_s:.3f}",
            f"{move.command_s:.3f}",
            f"{move.command_s / move.bound_s - 1.0:.1%}",
        ]
        for move in robust.moves
    ]
    unshaped, bound, found = (
        sum(getattr(move, name) for move in robust.moves)
        for name in ("unshaped_s", "bound_s", "command_s")
    )
    sums = [f"{unshaped:.3f}", f"{bound:.3f}", f"{found:.3f}", f"{found / bound - 1.0:.1%}"]
    rows.append(["all moves", "", "", *sums])
    return f"{title}: commands for modes within {band * 100:g} %, move by move", header, rows


def show_robust(robust: RobustCycle, table: Printed) -> None:
    """Print the cycle that was found for a band: ``robust_table`` and what holds over it."""
    print_table(*table)
    say(
        "bound: the shortest on the same scan with levels free between 0 and 1, this move alone "
        "and all that may ring its own; no valves are faster"
    )
    for move in robust.moves:
        say(f"{move.step}, {move.axis}: {move.levels}")
    modes = ", ".join(
        f"{axis} {low:.2f} to {high:.2f} Hz" for axis, (low, high) in robust.frequencies_hz.items()
    )
    worst = max(robust.over, key=lambda run: run.worst_m)
    over = (
        f"at most {worst.worst_m * 1e3:.4g} mm ring on {len(robust.over)} machines, one run each, "
        f"with modes of {modes}; the most at {worst.relative * 100:+.3g} %"
    )
    if robust.job is None:
        say(f"no cycle in spec all over the band was found ({robust.tried} tried): {over}")
        return
    say(
        f"fastest for the band: a cycle of {cycle_s(robust.proof):.3f} s, "
        f"{robust.tried} cycles tried on the twin; {over}"
    )
    print_table("verdict of the machine as its file says", *verdict_rows(robust.proof.verdict))
    say(closing(robust.proof.verdict))


def beside_table(rows: Sequence[BesideRow], title: str, band: float | None) -> Printed:
    """Return one table of several cycles: a row each, with the verdicts of both machines."""
    header = ["cycle", "s", "rings mm", "as typed"]
    if band is not None:
        header += [f"rings mm, +-{band * 100:g} %", "all over it"]
    table = []
    for row in rows:
        cells = [row.name, f"{row.cycle_s:.3f}", f"{row.worst_m * 1e3:.3f}", _words(row.passed)]
        if row.over_m is not None and row.over_passed is not None:
            cells += [f"{row.over_m * 1e3:.3f}", _words(row.over_passed)]
        table.append(cells)
    return f"{title}: cycles side by side, one run each", header, table


def _words(passed: bool) -> str:
    return "in spec" if passed else "out"


def robust_json(robust: RobustCycle) -> dict[str, Any]:
    """Return the cycle found for the band as JSON content."""
    return {
        "best": None if robust.job is None else cycle_s(robust.proof),
        "tried": robust.tried,
        "frequencies_hz": {axis: list(ends) for axis, ends in robust.frequencies_hz.items()},
        "verdict": {
            "passed": robust.proof.verdict.passed,
            "level": robust.proof.verdict.level.value,
            "criteria": criteria_json(robust.proof.verdict),
        },
        "over": [
            {"relative": run.relative, "worst_m": run.worst_m, "passed": run.verdict.passed}
            for run in robust.over
        ],
        "moves": [
            {
                "step": move.step,
                "axis": move.axis,
                "job_line": move.job_line,
                "distance_m": move.distance_m,
                "levels": move.levels,
                "command_s": move.command_s,
                "unshaped_s": move.unshaped_s,
                "bound_s": move.bound_s,
            }
            for move in robust.moves
        ],
    }


def beside_json(rows: Sequence[BesideRow]) -> list[dict[str, Any]]:
    """Return the table of several cycles as JSON content."""
    return [
        {
            "name": row.name,
            "cycle_s": row.cycle_s,
            "worst_m": row.worst_m,
            "passed": row.passed,
            "over_m": row.over_m,
            "over_passed": row.over_passed,
        }
        for row in rows
    ]
