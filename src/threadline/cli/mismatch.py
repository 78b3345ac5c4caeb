"""``--mismatch`` of ``threadline fastest``: how fast machines within their tolerances can go."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from threadline.cli.fastest_asked import Asked
from threadline.cli.found import limit_words
from threadline.cli.output import print_table
from threadline.cli.outputs import check_outputs
from threadline.errors import OptionError
from threadline.pipeline import prove_plan
from threadline.plan import Plan
from threadline.report import write_report
from threadline.search.mismatch import Mismatch, Searched
from threadline.search.studied import studied
from threadline.verdict import Spec

ABOVE = 1.1
"""Highest feed that is tried, over the nominal best: other machines are rarely faster."""


def check_mismatch(mismatch: bool, actual: bool, report: Path | None) -> None:
    """Refuse --mismatch beside --actual, and a folder that no report can be written into.

    Raises
    ------
    OptionError
        If the options do not go together, or the report cannot be written.
    """
    if mismatch and actual:
        raise OptionError("--mismatch and --actual exclude each other", remedy="Give one of them.")
    check_outputs(folder=report)


def drawn_of(
    cells: Sequence[Mismatch], title: str, searched: Searched, asked: Asked
) -> Path | None:
    """Return the picture of a search over tolerances; None where nothing is drawn."""
    if asked.report is None or not asked.mismatch:
        return None
    from threadline.report.mismatch import write_mismatch  # slow to import: it draws

    return write_mismatch(cells, f"{title}\n(nominal: one run each)", searched, asked.report)


def report_of(plan: Plan, asked: Asked, spec: Spec | None = None) -> Path | None:
    """Prove the fastest again, and return the page of its report; None where none is asked for."""
    if asked.report is None:
        return None
    proof = prove_plan(plan, spec or asked.spec, trials=asked.trials, actual=asked.actual)
    return write_report(studied(proof), asked.report)


def mismatch_json(cells: list[Mismatch], drawn: Path | None) -> dict[str, Any]:
    """Return a search over tolerances as JSON content; nothing where there was none."""
    found = [
        {
            "mass": cell.mass,
            "stiffness": cell.stiffness,
            "best": cell.best,
            "intervals": [[i.low, i.high] for i in cell.intervals],
            "limited_by": cell.limited_by,
        }
        for cell in cells
    ]
    told: dict[str, Any] = {"mismatch": found} if found else {}
    return told | ({} if drawn is None else {"report": str(drawn)})


def show_mismatch(cells: list[Mismatch], title: str, searched: Searched) -> None:
    """Print the fastest for masses and stiffnesses at the ends of their tolerances."""
    names = {-1.0: "lower end", 0.0: "as in the file", 1.0: "upper end"}
    ranges = any(cell.intervals for cell in cells)
    rows = [
        [
            names[cell.mass],
            names[cell.stiffness],
            "none" if cell.best is None else f"{searched.per_unit * cell.best:.2f}",
            *([_in_spec(cell, searched)] if ranges else []),
            limit_words(cell.limited_by),
        ]
        for cell in cells
    ]
    best = f"{searched.best} {searched.unit}"
    all_of = [f"in spec {searched.unit}"] if ranges else []
    header = ["mass of loads", "stiffness of springs", best, *all_of, "limited by"]
    print_table(
        f"{title}: planned for the file, {searched.done} off its tolerances, one run each",
        header,
        rows,
    )


def _in_spec(cell: Mismatch, searched: Searched) -> str:
    """Return all that is in spec of what was tried: beneath the fastest there may be a gap."""
    scale = searched.per_unit
    return ", ".join(
        f"{scale * one.low:.2f}"
        if one.low == one.high
        else f"{scale * one.low:.2f} to {scale * one.high:.2f}"
        for one in sorted(cell.intervals, key=lambda one: one.low)
    )
