"""The report of a comparison of interpolations and feeds, one figure after another."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from threadline.doubts import doubts_of_all
from threadline.foreign_messages import grouped
from threadline.pipeline import Proof
from threadline.report.document import Document, Printed, Table
from threadline.report.figures import moves, path_figure, profile_figure
from threadline.report.motion import shared_facts, summary_facts
from threadline.report.overlay import Case, overlays, turns_s
from threadline.report.publish import write_document
from threadline.report.style import figure_style
from threadline.report.traces import Traces, collect
from threadline.verdict import closing_of_all

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from threadline.search import Comparison


def write_motion_comparison(found: Comparison, folder: Path, tables: Sequence[Printed]) -> Path:
    """Write the report of a comparison into ``folder``; return the path of the HTML page.

    Parameters
    ----------
    tables
        The tables as they were printed: title, header, rows.
    """
    first = found.proofs[0]
    with figure_style():
        figures: dict[str, Figure] = {}
        captions: dict[str, str] = {}
        cases: list[Case] = []
        for proof in found.proofs:
            traces = collect(proof)
            if traces.stride > 1:  # the figures of turning points need every sample there
                traces = collect(proof, turns_s(traces))
            label = f"{proof.plan.motion.path.interpolation}, feed {proof.plan.options['feed']}"
            stem = label.replace(", feed ", "-").replace(" ", "").replace("/", "-per-")
            for name, figure in _figures(proof, traces).items():
                # On a line of its own: beside the title stands the legend.
                figure.axes[0].set_title(f"{label}:\n{figure.axes[0].get_title(loc='left')}")
                figures[f"{stem}-{name}"] = figure
                captions[f"{stem}-{name}"] = (
                    f"{label}. Programmed, planned and actual; lines are told apart by dash."
                    f"{traces.run.words(proof)}"
                )
            cases.append((label, proof, traces))
        first_figures, first_captions = overlays(cases)
        figures, captions = first_figures | figures, first_captions | captions
        good = all(proof.verdict.passed for proof in found.proofs)
        document = Document(
            title=f"{first.plan.job.name} on {first.plan.machine.name}: comparison",
            subtitle=first.plan.machine.title,
            verdicts=[(closing_of_all([proof.verdict for proof in found.proofs]), good)],
            warnings=grouped(doubts_of_all(found.proofs)),
            tables=[Table(title=t, header=h, rows=r) for t, h, r in tables],
            figures=figures,
            captions=captions,
            facts=_facts(cases),
        )
        return write_document(document, folder, "comparison")


def _facts(cases: list[Case]) -> list[tuple[str, str]]:
    """Return the facts that all cases share, then the planner's facts case by case."""
    first = cases[0][1]
    found = [*shared_facts(first, ("interpolation", "feed"))]
    for number, (label, proof, _) in enumerate(cases, start=1):
        said = ", ".join(f"{key} {value}" for key, value in summary_facts(proof))
        found.append((f"case {number}", f"{label}; {said}" if said else label))
    return found


def _figures(proof: Proof, traces: Traces) -> dict[str, Figure]:
    machine = proof.plan.machine
    moving = [axis for axis in traces.drawn_axes if moves(traces, axis)]
    linear = [axis for axis in moving if machine.axes[axis].kind == "linear"]
    figures = {f"profile-{axis}": profile_figure(proof, traces, axis) for axis in linear}
    if len(linear) > 1:
        figures[f"path-{linear[0]}{linear[1]}"] = path_figure(proof, traces, linear[0], linear[1])
    return figures
