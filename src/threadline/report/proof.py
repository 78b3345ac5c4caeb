"""Reports of proofs and comparisons of every kind: a table of the functions that write them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from threadline.commands.plan import Motion, Scheduled, Stitched
from threadline.proof.pipeline import Proof
from threadline.report.comparison import write_motion_comparison
from threadline.report.document import Printed
from threadline.report.motion import about_motion, specification_lines, write_motion
from threadline.report.stitched import about_stitched, write_stitched, write_stitched_comparison
from threadline.report.switching import about_switching, write_switching, write_switching_comparison

if TYPE_CHECKING:
    from threadline.search import Comparison
    from threadline.search.studied import Studied


@dataclass(frozen=True, slots=True, kw_only=True)
class KindReport:
    """Functions that report one kind of work.

    Parameters
    ----------
    write
        Writes the report of a proof into a folder; returns the path of the HTML page.
    about
        Returns the lines of text below the verdict.
    compare
        Writes the report of a comparison, with the printed tables, into a folder.
    """

    write: Callable[[Studied, Path], Path]
    about: Callable[[Proof], list[str]]
    compare: Callable[[Comparison, Path, Sequence[Printed]], Path]


REPORTS: Mapping[type, KindReport] = {
    Motion: KindReport(write=write_motion, about=about_motion, compare=write_motion_comparison),
    Scheduled: KindReport(
        write=write_switching, about=about_switching, compare=write_switching_comparison
    ),
    Stitched: KindReport(
        write=write_stitched, about=about_stitched, compare=write_stitched_comparison
    ),
}
"""By the type of ``Plan.intent``; one for every ``Kind.intent`` in ``KINDS``."""


def write_report(studied: Studied, folder: Path) -> Path:
    """Write the report of a proof into ``folder``; return the path of the HTML page.

    ``threadline.search.studied`` describes the content of ``studied``.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    return REPORTS[type(studied.proof.plan.intent)].write(studied, folder)


def about(proof: Proof) -> list[str]:
    """Return the lines of text below the verdict of a proof."""
    return [*specification_lines(proof), *REPORTS[type(proof.plan.intent)].about(proof)]


def write_comparison(found: Comparison, folder: Path, tables: Sequence[Printed]) -> Path:
    """Write the report of a comparison with the printed ``tables``: title, header, rows.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    return REPORTS[type(found.proofs[0].plan.intent)].compare(found, folder, tables)
