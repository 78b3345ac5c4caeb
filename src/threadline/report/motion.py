"""The report of a proof with axes: facts, lines below the verdict, circuits, captions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from threadline.base.wording import grouped
from threadline.motion.timing.optimal.binding import BINDS
from threadline.proof.pipeline import Proof
from threadline.proof.recorded import warnings_of
from threadline.report.document import (
    Document,
    Table,
    changes,
    options_facts,
    origin_facts,
    run_facts,
)
from threadline.report.figures import all_figures, binding_lines, binding_of, strips_figure
from threadline.report.lines import count_circuits, feed_lines, motion_lines, specification_lines
from threadline.report.publish import write_document
from threadline.report.seam import seam_figure, seam_run
from threadline.report.style import figure_style
from threadline.report.traces import collect
from threadline.report.unrolled import winding_caption, winding_figures
from threadline.report.wound import planned_sheet
from threadline.units import without_noise
from threadline.verdict import closing, verdict_rows

if TYPE_CHECKING:
    from threadline.search.report_data import ReportData


def write_motion(studied: ReportData, folder: Path) -> Path:
    """Write the report of a proof into ``folder``; return the path of the HTML page.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    proof = studied.proof
    plan = proof.plan
    with figure_style():
        traces = collect(proof)
        sewn_run = seam_run(proof)
        header, rows = verdict_rows(proof.verdict)
        figures = all_figures(proof, traces)
        binding_limits = binding_of(plan)
        if binding_limits is not None:
            figures["limits"] = strips_figure(plan, binding_limits)
        seam = seam_figure(proof, sewn_run.recording)
        if seam is not None:
            figures = {"seam": seam, **figures}
        wound, files_beside, band_tables = winding_figures(proof)
        figures = {**wound, **figures}
        thinned = "" if traces.stride == 1 else thinned_words(traces.stride)
        thinned += traces.run.words(proof)
        document = Document(
            title=f"{plan.job.name} on {plan.machine.name}",
            subtitle=f"{plan.machine.title}; interpolation {plan.planned_with}, "
            f"feed {plan.options.get('feed', 'programmed')}",
            verdicts=[(closing(proof.verdict), proof.verdict.passed)],
            warnings=grouped(warnings_of(proof)),
            tables=[
                Table(title="Criteria", header=header, rows=rows),
                *band_tables,
                *planned_sheet(plan),
                *changes(proof.verdict),
                Table(
                    title="The job",
                    header=("", ""),
                    rows=[
                        [part.strip() for part in line.split(":", 1)]
                        for line in [
                            *specification_lines(proof),
                            *feed_lines(plan),
                            *motion_lines(plan),
                            *([] if binding_limits is None else binding_lines(binding_limits)),
                            *count_circuits(plan).lines(),
                        ]
                    ],
                ),
            ],
            figures=figures,
            beside=files_beside,
            captions={
                name: _caption(name, known=bool(traces.actual))
                + (sewn_run.words(proof) if name == "seam" else "" if name in wound else thinned)
                for name in figures
            },
            facts=facts(proof),
        )
        return write_document(document, folder, "report")


def facts(proof: Proof) -> list[tuple[str, str]]:
    """Return the facts with which a proof can be repeated: versions, files, options, planner."""
    return [*shared_facts(proof), *summary_facts(proof)]


def shared_facts(proof: Proof, leave_out: Sequence[str] = ()) -> list[tuple[str, str]]:
    """Return versions, files and options, without the options in ``leave_out``."""
    plan = proof.plan
    return [
        *origin_facts(plan.machine, plan.job),
        ("simulated", "yes" if proof.verdict.simulated else "no, recorded live"),
        *run_facts(proof.recording),
        *options_facts(plan.options, plan.machine, leave_out),
    ]


def summary_facts(proof: Proof) -> list[tuple[str, str]]:
    """Return the planner's facts about its path."""
    summary = proof.plan.motion.path.summary
    return [(key, f"{without_noise(value):g}") for key, value in summary.items()]


def thinned_words(stride: int) -> str:
    """Return a sentence for the caption of a trace thinned by ``stride``; empty for 1."""
    return (
        f" Of every {stride} samples those at an extreme of position, velocity, acceleration "
        "(planned or actual) or tracking error are drawn, profiles as the band between them; about "
        "the places that are marked, every sample."
    )


def _caption(name: str, *, known: bool) -> str:
    """Return the caption of a figure; ``known`` says whether the load positions are known."""
    if name.startswith("winding-"):
        return winding_caption(name)
    if name == "seam":
        return (
            "Each mark is a needle-down, its shape and size by how much of its limits the stitch "
            "uses: the length error, unless it is exempt, or the distance from the seam."
        )
    if name.startswith("path-"):
        actual_text = (
            ", and where the driven mass went" if known else "; where the mass went is not known"
        )
        return f"Programmed points, planned path{actual_text}."
    if name.startswith("profile-"):
        actual = "; actual velocity and acceleration are differences over one tick" if known else ""
        return (
            f"Planned {'and actual ' if known else ''}displacement, velocity and acceleration"
            f"{actual}. Where the planned velocity steps, its "
            "acceleration is infinite, and not drawn."
        )
    if name == "tension":
        return (
            "Tension of the fibre at the eye. The mean counts from where the place of the fibre is "
            "known, without the first fibre drawn; before it, the spool comes to its speed."
        )
    if name == "criteria":
        return (
            "Each figure as a share of its limit. The place of the driven mass is not known: the "
            "machine file has no dynamics."
        )
    if name == "limits":
        return (
            "How much of each limit the planned motion uses, of the axis that uses most of its "
            f"own; black where it is {BINDS:.0%} or more. The lag is the deviation of the loops, "
            "as a share of the allowed contour; volts and current are shares of their limits less "
            "the reserve."
        )
    return (
        "Contour and tracking error along the job with the worst place and its program line, and "
        "each measured figure as a share of its limit. The contour error is the largest of each "
        "two-thousandth of the job."
    )
