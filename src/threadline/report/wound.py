"""The sheet of a winding as a page to print, and as tables in the report of a proof."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from threadline.commands.plan import Plan
from threadline.files import tick_table
from threadline.jobs.winding.build_up import Laid, design
from threadline.jobs.winding.job import is_winding
from threadline.jobs.winding.layers import Winding, layers_of_text
from threadline.jobs.winding.sheet import Sheet, sheet_of, sheet_warnings, wound_laminate
from threadline.report.document import Document, Table, origin_facts
from threadline.report.publish import write_document


def sheet_tables(sheet: Sheet, laid: Sequence[Laid]) -> list[Table]:
    """Return the sheet of a winding and its laminate as tables."""
    tables = [
        Table(
            title="Sheet", header=sheet.header(), rows=sheet.table(), note=sheet.note(),
            words=("material",),
        )
    ]  # fmt: skip
    laminate = wound_laminate(laid)
    if laminate is not None:
        tables.append(
            Table(title="Laminate at the largest radius", header=("", ""), rows=laminate.rows())
        )
    return tables


def write_sheet(winding: Winding, laid: Sequence[Laid], folder: Path) -> Path:
    """Write the sheet of a winding into a folder; return the path of the HTML page.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    sheet = sheet_of(winding, laid)
    product = winding.product
    document = Document(
        title=product.name,
        subtitle="what is wound, without a machine",
        verdicts=[],
        warnings=sheet_warnings(winding, sheet),
        tables=sheet_tables(sheet, laid),
        figures={},
        captions={},
        facts=[*origin_facts(), ("product", winding.path.name)],
    )
    return write_document(document, folder, "sheet")


def planned_sheet(plan: Plan) -> list[Table]:
    """Return the tables of a planned winding, with the times of the plan; none for other jobs."""
    text = plan.options.get("product")
    if text is None or not is_winding(Path(plan.job.file)):
        return []
    winding = layers_of_text(Path(plan.job.file), text)
    laid = design(winding)
    return sheet_tables(sheet_of(winding, laid, layer_times(plan, winding)), laid)


def layer_times(plan: Plan, winding: Winding) -> dict[int, float] | None:
    """Return the planned time of each layer, s, by layer number; None if layers share a line.

    The moves to the first point, and the joins between layers, count for the layer that follows
    them.
    """
    lines = np.array([operation.source.line for operation in plan.job], dtype=np.int64)
    layer_lines, layer_of = np.unique(lines, return_inverse=True)
    if len(layer_lines) != len(winding.layers):
        return None
    ticks = np.zeros(len(layer_lines))
    for block in tick_table(plan.commands):
        ticks += np.bincount(layer_of[block.operation], minlength=len(layer_lines))
    period_s = float(plan.machine.tick_clock.period_s)
    return {number: period_s * count for number, count in enumerate(ticks.tolist(), start=1)}
