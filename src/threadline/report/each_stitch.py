"""Every stitch of a proof as a row of a table, for a spreadsheet: ``report-stitches.csv``."""

from __future__ import annotations

from collections.abc import Iterator
from math import isnan

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.pipeline import Proof
from threadline.signals import Recording
from threadline.verdict.stitch_measures import step_rates_hz, window_uses
from threadline.verdict.stitch_run import StitchRun

_MINUTE = 60.0
_ROWS = 4096


def stitch_lines(proof: Proof, recording: Recording) -> Iterator[str]:
    """Yield the lines of the table, the names of its columns first.

    The table has a row for each turn of the shaft in which the needle enters. Residual and force
    are those of ``recording``; "residual of any day" is the planner's largest forecast over the
    dampings that the modes have on different days. Values that were not recorded are empty.
    """
    plan = proof.plan
    stitched, run = plan.stitched, StitchRun(recording, plan)
    turns, pace, sewn = stitched.turns, stitched.pace, run.sewn
    limits = _limits(proof)
    share = np.max(sewn.residual_m / limits, axis=1)
    uses = window_uses(stitched)
    window_s = turns.window * float(stitched.commands.clock.period_s)
    numbers: list[tuple[str, IntArray]] = [
        ("block", turns.block), ("stitch", turns.stitch), ("record", turns.line)
    ]  # fmt: skip
    any_day = pace.most_swings_m(turns.moves, turns.turn_s)
    columns: list[tuple[str, FloatArray]] = []
    for k, axis in enumerate(plan.axes):
        columns.append((f"{axis} [mm]", stitched.places_m[run.turns, k] * 1e3))
        way = turns.moves.units[run.turns, k] * pace.tables.unit.si
        columns.append((f"move {axis} [mm]", np.asarray(way * 1e3)))
    columns += [
        ("speed [stitch/min]", _MINUTE / turns.turn_s[run.turns]),
        ("window [ms]", np.asarray(window_s[run.turns] * 1e3)),
        ("window_use", uses[run.turns]),
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
        part = slice(first, first + _ROWS)
        whole = [values[run.turns[part]].tolist() for _, values in numbers]
        cells = [values[part].tolist() for _, values in columns]
        for row in zip(*whole, *cells, strict=True):
            yield ",".join(_cell(value) for value in row)


def _limits(proof: Proof) -> FloatArray:
    """Return (A,) limits of the residual, m; NaN where there is none."""
    found = {
        result.axis: result.limit
        for result in proof.verdict.results
        if result.name == "stitch_residual" and result.limit
    }
    return np.array([found.get(axis, np.nan) for axis in proof.plan.axes], dtype=np.float64)


def _cell(value: float) -> str:
    if isinstance(value, int):
        return str(value)
    return "" if isnan(value) else f"{value:.6g}"
