"""The report of ``equal``: the differences of every file from the plan, and over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.readback.equal import HEADER, Equal, Equality
from threadline.readback.equal_found import UNITS
from threadline.report.document import Document, Table, options_facts, origin_facts
from threadline.report.publish import write_document
from threadline.report.style import ACTUAL, LIMIT, figure_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_EACH_IN = 1.7
_ON_PAGE = 5  # largest number of targets in one figure
_PLACE, _TIME = HEADER.index("place"), HEADER.index("time")  # the column of the limit follows each


def difference_figure(found: Sequence[Equal]) -> Figure:
    """Draw the differences of files in place and in time over the time of the plan, with limits.

    Parameters
    ----------
    found
        Rows that have a curve.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 0.6 + _EACH_IN * len(found)), layout="constrained")
    panels = figure.subplots(len(found), 2, squeeze=False, sharex=True)
    for (place_panel, time_panel), target in zip(panels, found, strict=True):
        assert target.curve is not None
        factor, unit = UNITS[target.unit]
        _panel(
            place_panel, target.curve.time_s, target.curve.place, target.place_limit, (factor, unit)
        )
        late_s = target.curve.late_s
        _panel(time_panel, target.curve.time_s, late_s, target.time_limit_s, (1e3, "ms"))
        row = target.row()
        for panel, column in ((place_panel, _PLACE), (time_panel, _TIME)):
            if not panel.lines:
                _without_curve(panel, row[column], row[column + 1])
        place_panel.set_title(f"{target.target}: place, {target.verdict}")
        time_panel.set_title(f"{target.target}: time")
    for panel in panels[-1]:
        panel.set_xlabel("time of the plan [s]")
    return figure


def _panel(
    panel: Axes,
    time_s: FloatArray,
    values: FloatArray | None,
    limit: float | None,
    unit: tuple[float, str],
) -> None:
    """Draw one difference between its limits; leave the panel empty without any."""
    factor, name = unit
    if values is None or limit is None or not len(values):
        return
    scaled = factor * values
    panel.plot(time_s, scaled, **ACTUAL)
    limit_height = factor * limit
    for bound in (limit_height,) if scaled.min() >= 0.0 else (-limit_height, limit_height):
        panel.axhline(bound, **LIMIT)
    panel.annotate(
        f"limit {limit_height:.3g} {name}", (1.0, limit_height), xycoords=("axes fraction", "data"),
        ha="right", va="bottom", fontsize=7,
    )  # fmt: skip
    span = max(limit_height, float(np.abs(scaled).max())) or 1.0
    panel.set_ylim(0.0 - (1.3 * span if scaled.min() < 0.0 else 0.05 * span), 1.35 * span)
    panel.set_ylabel(f"[{name}]")


def _without_curve(panel: Axes, largest: str, limit: str) -> None:
    """Write into a panel that only the largest difference of the job is known, or nothing."""
    text = "not compared"
    if largest != "-":
        text = f"largest difference {largest}, limit {limit}\n(of the whole job: no curve)"
    panel.text(0.5, 0.5, text, ha="center", va="center", transform=panel.transAxes)
    panel.set_yticks([])


def _remarks(found: Sequence[Equal]) -> list[Table]:
    """Return the table of the remarks; none without remarks."""
    rows = [[target.target, target.remark] for target in found if target.remark]
    header = ("target", "remark")
    return [Table(title="Remarks", header=header, rows=rows, words=("remark",))] if rows else []


def write_equality(found: Equality, folder: Path, command: str) -> Path:
    """Write the report into ``folder``; return the path of its HTML page.

    Raises
    ------
    OptionError, OSError
        If the folder cannot be written.
    """
    plan = found.plan
    with_curves = [target for target in found.targets if target.curve is not None]
    with figure_style():
        figures = {
            f"differences-{first // _ON_PAGE + 1}": difference_figure(
                with_curves[first : first + _ON_PAGE]
            )
            for first in range(0, len(with_curves), _ON_PAGE)
        }
        caption = (
            "Difference of each file from the plan over the time of the plan: place on the left, "
            "time on the right. Dotted: the limit."
        )
        document = Document(
            title=f"{plan.job.name} on {plan.machine.name}",
            subtitle="the files of controllers beside the plan",
            verdicts=[(found.closing(), found.passed)],
            facts=[
                *origin_facts(plan.machine, plan.job),
                *options_facts(plan.options, plan.machine),
                ("command", command),
            ],
            tables=[
                Table(
                    title="Differences and their limits",
                    header=HEADER,
                    rows=[r.row() for r in found.targets],
                    words=("read by", "verdict", "worst"),
                ),
                *_remarks(found.targets),
            ],
            figures=figures,
            captions=dict.fromkeys(figures, caption),
        )  # fmt: skip
        return write_document(document, folder, "equal")
