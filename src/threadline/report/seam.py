"""The seam of a proof: a table with all stitches, ``report-stitches.csv``, and a figure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import isnan
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.files import Recording
from threadline.proof.pipeline import Proof
from threadline.report.style import WORST, new_figure
from threadline.report.traces import DrawnRun, drawn_run, worst_result
from threadline.verdict import Criterion, SewnStitches, percent_used, sewn_stitches
from threadline.verdict.stitch_run import StitchRun, step_rates_hz, window_uses

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MINUTE = 60.0
_ROWS = 4096


def stitch_lines(proof: Proof, recording: Recording) -> Iterator[str]:
    """Yield the lines of the table, the names of its columns first.

    The table has a row for each turn of the shaft in which the needle enters. Residual and force
    are from ``recording``. "Residual of any day" is the largest residual that the planner forecasts
    over the different dampings of the modes. Values that were not recorded are empty.
    """
    plan = proof.plan
    stitched, run = plan.stitched, StitchRun(recording, plan)
    turns, pace, sewn = stitched.turns, stitched.pace, run.sewn
    limits = _limits(proof)
    share = np.max(sewn.residual_m / limits, axis=1)
    window_shares = window_uses(stitched)
    window_s = turns.window * float(stitched.commands.clock.period_s)
    numbers: list[tuple[str, IntArray]] = [
        ("block", turns.block), ("stitch", turns.stitch), ("record", turns.line)
    ]  # fmt: skip
    any_day = pace.most_swings_m(turns.moves, turns.turn_s)
    columns: list[tuple[str, FloatArray]] = []
    for k, axis in enumerate(plan.axes):
        columns.append((f"{axis} [mm]", stitched.places_m[run.turns, k] * 1e3))
        move_m = turns.moves.units[run.turns, k] * pace.tables.unit.si
        columns.append((f"move {axis} [mm]", np.asarray(move_m * 1e3)))
    columns += [
        ("speed [stitch/min]", _MINUTE / turns.turn_s[run.turns]),
        ("window [ms]", np.asarray(window_s[run.turns] * 1e3)),
        ("window_use", window_shares[run.turns]),
    ]
    for k, axis in enumerate(plan.axes):
        columns += [
            (f"step_rate {axis} [Hz]", step_rates_hz(stitched, k)[run.turns]),
            (f"stitch_residual {axis} [mm]", sewn.residual_m[:, k] * 1e3),
            (f"servo_force {axis}", sewn.force[:, k]),
        ]
    columns += [
        ("residual of any day [mm]", any_day[run.turns] * 1e3),
        ("limit used", share),
        ("alone it can at [stitch/min]", _MINUTE / pace.needed_turns_s(turns.moves)[run.turns]),
    ]
    yield ",".join([*(name for name, _ in numbers), *(name for name, _ in columns)])
    for first in range(0, len(run.turns), _ROWS):
        rows = slice(first, first + _ROWS)
        number_cells = [values[run.turns[rows]].tolist() for _, values in numbers]
        cells = [values[rows].tolist() for _, values in columns]
        for row in zip(*number_cells, *cells, strict=True):
            yield ",".join(_cell(value) for value in row)


def _limits(proof: Proof) -> FloatArray:
    """Return (A,) limits of the residual, m; NaN for none."""
    by_axis = {
        result.axis: result.limit
        for result in proof.verdict.results
        if result.name == "stitch_residual" and result.limit
    }
    return np.array([by_axis.get(axis, np.nan) for axis in proof.plan.axes], dtype=np.float64)


def _cell(value: float) -> str:
    if isinstance(value, int):
        return str(value)
    return "" if isnan(value) else f"{value:.6g}"


_LENGTH, _PLACE = 0.05, 5e-4  # limits if the specification has none: share, m (stitcher's thesis)
MAX_DRAWN = 20_000
ABOUT = 20  # stitches before and after the worst that are all drawn

# Per band of stitches: label, upper end of the share of the limit, marker, area, colour, filled.
_BANDS: tuple[tuple[str, float, str, float, str, bool], ...] = (
    ("uses half of the limit or less", 0.5, "o", 7.0, "#0072B2", False),
    ("within 20 % margin", 0.8, "o", 16.0, "#0072B2", True),
    ("less than 20 % margin", 1.0, "s", 26.0, "#E69F00", True),
    ("out of spec", np.inf, "X", 58.0, "#D55E00", True),
)


_SHARES = ("stitch_length_error", "contour_error")
"""The criteria whose share of the limit the figure shows for each stitch."""


def seam_run(proof: Proof) -> DrawnRun:
    """Return the run with the stitch that has the largest used share of a limit."""
    worst_results = [
        w for w in (worst_result(proof.verdict, name) for name in _SHARES) if w is not None
    ]
    worst_used = max(
        worst_results, key=lambda w: abs(w.measured or 0.0) / (w.limit or np.inf), default=None
    )
    return drawn_run(proof, [] if worst_used is None else [worst_used.name])


def seam_figure(proof: Proof, recording: Recording) -> Figure | None:
    """Draw the points at which the needle went down in a run; None for a job without stitches.

    The used share of a stitch is the larger of two ratios to a limit: its distance from the seam,
    and its length error unless the stitch is exempt.
    """
    length, place = _criterion(proof, "stitch_length_error"), _criterion(proof, "contour_error")
    delay_s = 0.0 if length is None else length.options.get("delay", 0.0)
    length_limit = (length.limit if length else None) or _LENGTH
    place_limit = (place.limit if place else None) or _PLACE
    sewn = sewn_stitches(proof.plan, recording, delay_s)
    drawn, counts = _stitches_to_draw(_columns(run, length_limit, place_limit) for run in sewn)
    if not len(drawn):
        return None
    number, contour, exempt = (drawn[:, k].astype(int) for k in range(3))
    points, seam, by_length, by_place = drawn[:, 3:5], drawn[:, 5:7], drawn[:, 7], drawn[:, 8]
    share = np.maximum(by_length, by_place)
    judged = exempt == 0

    figure, (plan, graph) = new_figure((7.2, 7.4), 2, height_ratios=[3, 2])
    _draw(plan, points, seam, contour, share, counts, number)
    names = proof.plan.job.axes
    plan.set_xlabel(f"{names[0]} [mm]")
    plan.set_ylabel(f"{names[1]} [mm]")
    plan.set_title("The seam: where the needle went down")
    figure.legend(*plan.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    graph.plot(
        number, 100.0 * by_place, color="black", lw=1.0, linestyle=(0, (4, 1.5)),
        label=f"distance from the seam, of {place_limit * 1e3:g} mm",
    )  # fmt: skip
    graph.plot(
        number[judged], 100.0 * by_length[judged], linestyle="none", marker="|", markersize=7,
        color="#0072B2", label=f"length off by, of {length_limit * 100:.3g} % (exempt left out)",
    )  # fmt: skip
    graph.axhline(100.0, color="#D55E00", linestyle=(0, (1, 1.5)), lw=1.4)
    graph.set_ylim(0.0, max(120.0, 110.0 * float(share.max())))
    graph.set_xlabel("stitch")
    graph.set_ylabel("share of the limit [%]")
    graph.set_title("Every stitch", pad=16)
    graph.legend(loc="lower left", bbox_to_anchor=(0.0, 0.99), ncols=2, borderaxespad=0.0)
    return figure


def _columns(run: SewnStitches, length_limit: float, place_limit: float) -> FloatArray:
    """Return (n, 8) columns: contour, exempt; needle and seam X, Y in mm; two limit shares."""
    exempt = run.stitches.exempt
    return np.column_stack(
        [
            run.stitches.contour,
            exempt,
            run.actual[:, :2, 0] * 1e3,
            run.stitches.point[:, :2] * 1e3,
            np.where(exempt, 0.0, np.abs(run.length_error[:, 0]) / length_limit),
            run.placement_m[:, 0] / place_limit,
        ]
    )


def _stitches_to_draw(runs: Iterable[FloatArray]) -> tuple[FloatArray, IntArray]:
    """Return the stitches to draw, (m, 9), and the number of all stitches in each band.

    If there are many, every second, fourth and so on is drawn, and ``ABOUT`` stitches on both
    sides of the worst. A row is the number of the stitch and its row of ``_columns``.
    """
    bounds = np.array([high for _, high, *_ in _BANDS[:-1]])
    counts = np.zeros(len(_BANDS), dtype=np.int64)
    thinned: list[FloatArray] = []
    about_worst: FloatArray = np.empty((0, 9))
    count, step, worst = 0, 1, -1.0
    for columns in runs:
        rows = np.column_stack([count + np.arange(len(columns)), columns])
        share = rows[:, 7:].max(axis=1)
        counts += np.bincount(np.searchsorted(bounds, share), minlength=len(_BANDS))
        if len(rows) and share.max() > worst:
            worst_index = int(share.argmax())
            worst, about_worst = (
                float(share[worst_index]),
                rows[max(worst_index - ABOUT, 0) : worst_index + ABOUT + 1],
            )
        count += len(rows)
        thinned.append(rows[rows[:, 0] % step == 0])
        while sum(map(len, thinned)) > MAX_DRAWN:
            step *= 2
            thinned_rows = np.concatenate(thinned)
            thinned = [thinned_rows[thinned_rows[:, 0] % step == 0]]
    all_drawn = np.concatenate([about_worst, *thinned])
    return all_drawn[np.unique(all_drawn[:, 0], return_index=True)[1]], counts


def _draw(
    panel: Axes,
    points: FloatArray,
    seam: FloatArray,
    contour: IntArray,
    share: FloatArray,
    counts: IntArray,
    number: IntArray,
) -> None:
    for k in np.unique(contour):
        line = seam[contour == k]
        label = "seam" if k == contour[0] else None
        panel.plot(line[:, 0], line[:, 1], color="0.55", lw=0.7, zorder=1, label=label)
    band_low = -1.0
    for (label, high, marker, area, colour, filled), count in zip(
        _BANDS, counts.tolist(), strict=True
    ):
        in_band = (share > band_low) & (share <= high)
        band_low = high
        if not in_band.any():
            continue
        panel.scatter(
            points[in_band, 0],
            points[in_band, 1],
            s=area,
            marker=marker,
            facecolors=colour if filled else "white",
            edgecolors=colour if not filled else "black",
            linewidths=0.9 if not filled else 0.4,
            zorder=2 + high if np.isfinite(high) else 4,
            label=f"{label}: {count}",
        )
    worst = int(np.argmax(share))
    panel.plot(
        points[worst : worst + 1, 0], points[worst : worst + 1, 1],
        label=f"worst: stitch {number[worst]}, {percent_used(float(share[worst]))} of its limit",
        **{**WORST, "markerfacecolor": "none", "marker": "o", "markersize": 13},
    )  # fmt: skip
    panel.set_aspect("equal", adjustable="datalim")
    panel.margins(0.06)


def _criterion(proof: Proof, name: str) -> Criterion | None:
    return next((c for c in proof.spec.criteria if c.name == name), None)
