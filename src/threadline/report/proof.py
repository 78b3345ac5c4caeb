"""Reports of proofs and comparisons of every kind: a table of the functions that write them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from threadline.commands.plan import Motion, Scheduled, Stitched
from threadline.report.comparison import write_motion_comparison
from threadline.report.document import Printed
from threadline.report.motion import write_motion
from threadline.report.stitched import write_stitched, write_stitched_comparison
from threadline.report.switching import write_switching, write_switching_comparison

if TYPE_CHECKING:
    from threadline.search import Comparison
    from threadline.search.report_data import ReportData


@dataclass(frozen=True, slots=True, kw_only=True)
class KindReport:
    """Functions that report one kind of work.

    Parameters
    ----------
    write
        Writes the report of a proof into a folder; returns the path of the HTML page.
    compare
        Writes the report of a comparison, with the printed tables, into a folder.
    """

    write: Callable[[ReportData, Path], Path]
    compare: Callable[[Comparison, Path, Sequence[Printed]], Path]


REPORTS: Mapping[type, KindReport] = {
    Motion: KindReport(write=write_motion, compare=write_motion_comparison),
    Scheduled: KindReport(write=write_switching, compare=write_switching_comparison),
    Stitched: KindReport(write=write_stitched, compare=write_stitched_comparison),
}
"""Report functions by the type of ``Plan.intent``, one for every ``Kind.intent`` in ``KINDS``."""


def write_report(studied: ReportData, folder: Path) -> Path:
    """Write the report of a proof into ``folder``; return the path of the HTML page.

    ``threadline.search.report_data`` describes the content of ``studied``.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    return REPORTS[type(studied.proof.plan.intent)].write(studied, folder)


def write_comparison(found: Comparison, folder: Path, tables: Sequence[Printed]) -> Path:
    """Write the report of a comparison with the printed ``tables``: title, header, rows.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    return REPORTS[type(found.proofs[0].plan.intent)].compare(found, folder, tables)
