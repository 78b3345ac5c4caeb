"""The report of one proof."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from threadline.pipeline import Proof
from threadline.report.document import (
    Document,
    Table,
    options_facts,
    origin_facts,
    write_document,
)
from threadline.report.figures import all_figures
from threadline.report.seam import seam_figure
from threadline.report.style import figure_style
from threadline.report.traces import collect
from threadline.targets import calculate
from threadline.units import without_noise
from threadline.verdict import closing, motion_lines, verdict_rows


def write_report(proof: Proof, folder: Path) -> Path:
    """Write the report of ``proof`` into ``folder``; return the path of the HTML page.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    plan = proof.plan
    with figure_style():
        traces = collect(proof)
        header, rows = verdict_rows(proof.verdict)
        figures = all_figures(proof, traces)
        seam = seam_figure(proof)
        if seam is not None:
            figures = {"seam": seam, **figures}
        thinned = "" if traces.stride == 1 else f" One sample in {traces.stride} is drawn."
        document = Document(
            title=f"{plan.job.name} on {plan.machine.name}",
            subtitle=f"{plan.machine.title}; interpolation {plan.planned_with}, "
            f"feed {plan.options.get('feed', 'programmed')}",
            verdicts=[(closing(proof.verdict), proof.verdict.passed)],
            warnings=plan.job.warnings,
            tables=[
                Table(title="Criteria", header=header, rows=rows),
                Table(
                    title="The job",
                    header=("", ""),
                    rows=[
                        [part.strip() for part in line.split(":", 1)]
                        for line in [*motion_lines(plan), *calculate(plan).lines()]
                    ],
                ),
            ],
            figures=figures,
            captions={
                name: _caption(name) + ("" if name == "seam" else thinned) for name in figures
            },
            facts=facts(proof),
        )
        return write_document(document, folder, "report")


def facts(proof: Proof) -> list[tuple[str, str]]:
    """Return what is needed to make a proof again."""
    return [*shared_facts(proof), *summary_facts(proof)]


def shared_facts(proof: Proof, leave_out: Sequence[str] = ()) -> list[tuple[str, str]]:
    """Return versions, files and options, but for options that are told elsewhere."""
    plan = proof.plan
    return [
        *origin_facts(plan.machine, plan.job),
        ("simulated", "yes" if proof.verdict.simulated else "no, recorded live"),
        *options_facts(plan.options, plan.machine, leave_out),
    ]


def summary_facts(proof: Proof) -> list[tuple[str, str]]:
    """Return what the planner says of its path."""
    return [(key, f"{without_noise(value):g}") for key, value in proof.plan.path.summary.items()]


def _caption(name: str) -> str:
    if name == "seam":
        return (
            "Each mark is a needle-down, its shape and size by how much of its limits the stitch "
            "uses: the length error, unless it is exempt, or the distance from the seam."
        )
    if name.startswith("path-"):
        return "Programmed points, planned path, and where the driven mass went."
    if name.startswith("profile-"):
        return (
            "Planned and actual displacement, velocity and acceleration; actual velocity and "
            "acceleration are differences over one tick. Where the planned velocity steps, its "
            "acceleration is infinite, and not drawn."
        )
    return (
        "Contour and tracking error along the job with the worst place and its program line, and "
        "each measured figure as a share of its limit. The contour error is the largest of each "
        "two-thousandth of the job."
    )
