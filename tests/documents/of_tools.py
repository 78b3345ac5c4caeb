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
    ToolTable(SHAPING, "python tools/shaper_results.py facts", RESULTS, "facts", 1),
    ToolTable(SHAPING, "python tools/shaper_results.py robustness", RESULTS, "robustness", 2),
    ToolTable(SHAPING, "python tools/shaper_results.py optimal", RESULTS, "optimal", 2),
    ToolTable(SHAPING, "python tools/shaper_results.py rounding", RESULTS, "rounding", 1),
    ToolTable(SHAPING, "python tools/shaper_results.py moves", RESULTS, "moves", 1),
    ToolTable(
        "results-onoff.md",
        "python tools/onoff_results.py break",
        "tools.onoff_results",
        "broken",
        1,
    ),
]
