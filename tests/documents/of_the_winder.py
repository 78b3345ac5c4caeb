"""The quick commands of docs/results.md."""

from __future__ import annotations

import re
from typing import Any

from tools import winder_claims

from tests.documents.quick import Answer, Figures, Quick, at, contour, of, seconds, turning

DOCUMENT = "results.md"
CONE = "threadline prove examples/cone-dome-cylinder.prg -m lathe-winder"
COMPARED = (
    "threadline compare examples/x-180.prg -m lathe-winder --interpolation "
    'linear,b-spline,b-spline-pulled,auto --feed "10 count/tick,80 count/tick" '
    "--report reports/compare"
)
EYE = (
    "threadline compare examples/cone-dome-cylinder.prg -m lathe-winder --no-fastest "
    '--interpolation linear,b-spline,b-spline-pulled --feed "10 count/tick,40 count/tick" '
    "--report reports/eye"
)
OPTIMAL = "threadline prove JOB -m lathe-winder --interpolation optimal"
AS_OPTIMAL = [
    "prove", "examples/x-180.prg", "-m", "lathe-winder", "--interpolation", "optimal",
    "--feed", "1000 count/tick",
]  # fmt: skip

path, repeated = of("path_deviation"), of("repeatability")
ALL_OF_OPTIMAL = [seconds, contour, turning, repeated]
OF_COMPARED = [seconds, of("tracking_error", "X"), contour, turning, path]
OF_EYE = [seconds, contour, turning, path]


def cases(wanted: list[Answer], rows: list[str]) -> list[Figures]:
    """Return the figures of the proofs of a comparison, row by row."""

    def of_case(number: int, found: Answer) -> Answer:
        def figure(said: Any) -> float:
            return found(said["proofs"][number])

        return figure

    return [Figures(said, [of_case(k, found) for found in wanted]) for k, said in enumerate(rows)]


def claims() -> dict[str, list[list[str]]]:
    """Return tables of the winder's claims."""
    return {
        "7-5": [list(row) for row in winder_claims.figure_7_5()],
        "10-3": [list(row) for row in winder_claims.figure_10_3()],
        "alone": [list(row) for row in winder_claims.proportional_only()],
    }


def number(table: str, row: int, column: int, place: int = 0) -> Answer:
    """Return what finds a number of a cell of a table."""

    def found(said: Any) -> float:
        return float(re.findall(r"[+-]?\d+(?:\.\d+)?", said[table][row][column])[place])

    return found


def step_of(row: int) -> list[Answer]:
    """Settling, both, overshoot and the twin's settling of a row of Figure 7-5."""
    return [
        number("7-5", row, 3), number("7-5", row, 3, 1), number("7-5", row, 4),
        number("7-5", row, 5),
    ]  # fmt: skip


def short(row: int) -> Answer:
    """Return what finds how far a row of Figure 10-3 stops short of its point."""
    past = number("10-3", row, 3)
    return lambda said: -past(said)


def settled_alone(said: Any) -> float:
    """Return the longest settling time of P alone by voltage, ms."""
    cells = [cell for row in said["alone"] if row[0] == "voltage" for cell in row[2:]]
    return max(float(cell.split("/")[1].split()[0]) for cell in cells)


WHOLE = Quick(
    DOCUMENT,
    f"{CONE} --interpolation optimal --report reports/demo",
    [
        Figures("to spare: {} of 0.5 mm in {} s, for its timing", [contour, seconds]),
        Figures(
            "| cone-dome-cylinder | none: its own feed | {} | {} | {} | {} | in spec |",
            ALL_OF_OPTIMAL,
        ),
    ],
)
"""The slowest of all, run where others want the same plan: ``test_one_plan.py``."""

QUICK = [
    Quick(
        DOCUMENT,
        "python -m tools.winder_claims",
        [
            Figures("-8.9 | {} to {} (460 to 610) | {} (0) | {} (212) |", step_of(0)),
            Figures("12.5j) | {} to {} (160 to 187) | {} (0.2) | {} (122) |", step_of(1)),
            Figures("50.0j | {} to {} (92 to 150) | {} (14) | {} (61) |", step_of(2)),
            Figures(
                "linear at 36 mm/s {} short (0.47), at 72 mm/s {} (0.95), at 108 mm/s {} (1.42); "
                "at 289 mm/s {} short with the transformer of 4 A and {} without its limit",
                [short(0), short(1), short(2), short(3), short(7)],
            ),
            Figures(
                "| by voltage (section 7.3) | {} | {} | {} |",
                [number("10-3", 3, column) for column in (3, 4, 5)],
            ),
            Figures(
                "0.8 A/V assumed | {} (checked: 7 to 23) | {} | {} |",
                [number("10-3", 11, column) for column in (3, 4, 5)],
            ),
            Figures(
                "| by current, inertias as printed | {} | {} | {} |",
                [number("10-3", 19, column) for column in (3, 4, 5)],
            ),
            Figures("by voltage P alone settles within {} ms.", [settled_alone]),
        ],
        instead=["tools.winder_claims"],
        tool=claims,
    ),
    Quick(
        DOCUMENT,
        COMPARED,
        cases(
            OF_COMPARED,
            [
                "| linear | 10 | {} | {} | {} | {} short | {} | in spec |",
                "| linear | 80 | {} | {} | {} | {} short | {} | out |",
                "| b-spline | 10 | {} | {} | {} | {} short | {} | out |",
                "| b-spline | 80 | {} | {} | {} | {} short | {} | out |",
                "| b-spline-pulled | 10 | {} | {} | {} | {} past | {} | in spec |",
                "| b-spline-pulled | 80 | {} | {} | {} | {} past | {} | in spec |",
                "| auto | 10 | {} | {} | {} | {} | {} | in spec |",
                "| auto | 80 | {} | {} | {} | {} | {} | out |",
            ],
        ),
        more=["--nominal", "--no-fastest"],
        status=1,
    ),
    Quick(
        DOCUMENT,
        COMPARED,
        cases(
            [contour],
            [
                "| linear | 10 | 0.463 in spec | {} in spec |",
                "| linear | 80 | 3.091 out | {} out |",
                "| b-spline | 10 | 8.573 out | {} out |",
                "| b-spline | 80 | 9.058 out | {} out |",
                "| b-spline-pulled | 10 | 0.006 in spec | {} in spec |",
                "| b-spline-pulled | 80 | 0.185 in spec | {} in spec |",
                "| auto | 10 | 0.433 in spec | {} in spec |",
                "| auto | 80 | 0.847 out | {} out |",
            ],
        ),
        more=["--no-fastest"],
        status=1,
    ),
    Quick(
        DOCUMENT,
        EYE,
        cases(
            OF_EYE,
            [
                "| linear | 10 | {} | {} | {} | {} | in spec |",
                "| linear | 40 | {} | {} | {} | {} | out |",
                "| b-spline | 10 | {} | {} | {} | {} | out |",
                "| b-spline | 40 | {} | {} | {} | {} | out |",
                "| b-spline-pulled | 10 | {} | {} | {} | {} | out |",
                "| b-spline-pulled | 40 | {} | {} | {} | {} | out |",
            ],
        ),
        more=["--nominal"],
        status=1,
    ),
    WHOLE,
    Quick(
        DOCUMENT,
        CONE,
        [
            Figures("| contour error | {} mm, the worst of 20 runs;", [contour]),
            Figures(
                "| turning point error | {} mm, Y, the worst of 20 runs (limit 0.5) |",
                [of("turning_point_error", "Y")],
            ),
            Figures("| path deviation | {} mm (tolerance 0.1) |", [path]),
            Figures("repeatability {} mm over 20 runs", [repeated]),
        ],
    ),
    Quick(
        DOCUMENT,
        f"{CONE} --interpolation linear",
        [Figures("| 0.323 | 0.000 | in spec | in spec, {} mm | out, 0.96 mm |", [contour])],
    ),
    Quick(
        DOCUMENT,
        CONE,
        [
            Figures("one run {} mm at line 23 (limit 0.5) |", [contour]),
            Figures("| ticks in all | {} ({} s at the normal feed", [at("ticks"), seconds]),
        ],
        more=["--nominal"],
    ),
    Quick(
        DOCUMENT,
        OPTIMAL,
        [
            Figures(
                '| x-180 | `--feed "1000 count/tick"` | {} | {} | {} | {} | in spec |',
                ALL_OF_OPTIMAL,
            )
        ],
        instead=AS_OPTIMAL,
    ),
    Quick(
        DOCUMENT,
        OPTIMAL,
        [
            Figures(
                '| x-180 | the same, `--contour "0.44538 mm"`, which `fastest` finds '
                "| {} | {} | {} | {} | in spec |",
                ALL_OF_OPTIMAL,
            )
        ],
        instead=[*AS_OPTIMAL, "--contour", "0.44538 mm"],
    ),
    Quick(
        DOCUMENT,
        OPTIMAL,
        [
            Figures(
                "| x-180 | the same feed, `--feed-forward` | {} (motion 0.791) | {} | {} | {} "
                "| in spec |",
                ALL_OF_OPTIMAL,
            )
        ],
        instead=[*AS_OPTIMAL, "--feed-forward"],
    ),
    Quick(
        DOCUMENT,
        OPTIMAL,
        [
            Figures(
                '| x-180 | the same, `--feed-forward --smoothing "5 ms" --contour "0.45 mm"` '
                "| {} (motion 0.786) | {} | {} | {} | in spec |",
                ALL_OF_OPTIMAL,
            )
        ],
        instead=[*AS_OPTIMAL, "--feed-forward", "--smoothing", "5 ms", "--contour", "0.45 mm"],
    ),
    Quick(
        DOCUMENT,
        OPTIMAL,
        [Figures("| 0.805 | 0.386 | 0.386 | 0.011 | in spec | out, {} mm |", [contour])],
        instead=[*AS_OPTIMAL, "--tolerances"],
        status=1,
    ),
    Quick(
        DOCUMENT,
        OPTIMAL,
        [
            Figures(
                "| 0.780 (motion 0.791) | 0.147 | 0.147 | 0.011 | in spec | out, {} mm |", [contour]
            )
        ],
        instead=[*AS_OPTIMAL, "--feed-forward", "--tolerances"],
        status=1,
    ),
]
