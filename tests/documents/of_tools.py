"""The tools that print tables of the documents within a few seconds of processor time."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ToolTable:
    """A tool, as its document says it, and the function that prints the rows.

    ``headers`` is how many of the printed rows are headers.
    """

    document: str
    said: str
    module: str
    function: str
    headers: int


SHAPING, RESULTS = "results-shaping.md", "tools.shaper_results"
TABLES = [
    ToolTable(SHAPING, "python -m tools.shaper_results facts", RESULTS, "facts", 1),
    ToolTable(SHAPING, "python -m tools.shaper_results robustness", RESULTS, "robustness", 2),
    ToolTable(SHAPING, "python -m tools.shaper_results optimal", RESULTS, "optimal", 2),
    ToolTable(SHAPING, "python -m tools.shaper_results rounding", RESULTS, "rounding", 1),
    ToolTable(SHAPING, "python -m tools.shaper_results moves", RESULTS, "moves", 1),
    ToolTable(
        "results-onoff.md",
        "python -m tools.onoff_results break",
        "tools.onoff_results",
        "broken",
        1,
    ),
]
