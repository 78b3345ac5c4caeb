"""The report of a learned job: error and used limits over the repeats."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from threadline.report.document import Document, Table, options_facts, origin_facts
from threadline.report.publish import write_document
from threadline.report.style import figure_style
from threadline.search.learned_job import LearnedJob
from threadline.verdict import closing, verdict_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEADER = ("run", "in spec", "of the limit", "tightest", "error", "current", "gain", "note")
_COLOURS = ("C0", "C1", "C2", "C3", "C4", "C5", "C6", "C7")


def table_name(best: int) -> str:
    """Return the name of the table that run ``best`` played; run 0 played the plan's own table."""
    return f"table of run {best}" if best else "table of the plan, unchanged"


def repeat_rows(found: LearnedJob, machine: int) -> list[list[str]]:
    """Return a row for each repeat on one of the machines, as ``HEADER`` names its cells."""
    rows = []
    for run in found.machines[machine][1].repeats:
        worst = run.verdict.tightest
        note = run.note or ("" if run.followed else "worse: undone")
        rows.append(
            [
                "plan" if not run.number else str(run.number),
                "yes" if run.verdict.passed else "no",
                f"{100.0 * run.share:.0f} %",
                "-" if worst is None else worst.name,
                f"{1e3 * run.error_m:.4g} mm",
                "-" if run.current is None else f"{100.0 * run.current:.0f} %",
                f"{run.gain:.3g}" if run.number else "-",
                note,
            ]
        )
    return rows


def learning_figure(found: LearnedJob) -> Figure:
    """Return a figure of error and used share of the tightest limit over the repeats."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 5.4), layout="constrained")
    error_panel, share_panel = figure.subplots(2, 1, sharex=True)
    for (name, learned), colour in zip(found.machines, _COLOURS, strict=False):
        numbers = [run.number for run in learned.repeats]
        for axes, values in (
            (error_panel, [1e3 * run.error_m for run in learned.repeats]),
            (share_panel, [100.0 * run.share for run in learned.repeats]),
        ):
            axes.plot(numbers, values, color=colour, lw=1.0, label=name)
            for run, value in zip(learned.repeats, values, strict=True):
                filled = colour if run.followed else "white"
                axes.plot(run.number, value, "o", ms=4, mec=colour, mfc=filled)
    error_panel.set_yscale("log")
    error_panel.set_ylabel("error of the head, rms [mm]")
    share_panel.axhline(100.0, color="0.4", lw=0.8, ls="--")
    share_panel.set_ylabel("used of the tightest limit [%]")
    share_panel.set_xlabel("repeat (0: the table as planned)")
    share_panel.set_ylim(bottom=0.0)
    share_panel.legend(fontsize=7, loc="upper right")
    return figure


def write_learning(found: LearnedJob, folder: Path, command: str) -> Path:
    """Write the report into ``folder``; return the path of its HTML page.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    with figure_style():
        plan, tables = found.base, []
        for machine_index, (name, learned) in enumerate(found.machines):
            tables.append(
                Table(
                    title=f"Repeats: {name}",
                    header=HEADER,
                    rows=repeat_rows(found, machine_index),
                    words=("tightest",),
                )
            )
            header, rows = verdict_rows(learned.proof.verdict)
            tables.append(
                Table(title=f"The {table_name(learned.best)}: {name}", header=header, rows=rows)
            )
        document = Document(
            title=f"{plan.job.name} on {plan.machine.name}, learned",
            subtitle=f"{plan.machine.title}; plan {plan.planned_with}",
            verdicts=verdicts(found),
            tables=tables,
            figures={"learning": learning_figure(found)},
            captions={
                "learning": "Error and used share of the tightest limit of every run; open marks: "
                "runs that got worse and were undone."
            },
            facts=[
                *origin_facts(plan.machine, plan.job),
                *options_facts(plan.options, plan.machine, ("table",)),
                ("command", command),
                *filter_facts(found),
            ],
        )
        return write_document(document, folder, "learning")


def verdicts(found: LearnedJob) -> Sequence[tuple[str, bool]]:
    """Return the verdict on the best table, or how many machines are in specification."""
    if len(found.machines) == 1:
        return [(closing(found.machines[0][1].proof.verdict), found.passed)]
    passed = sum(learned.passed for _, learned in found.machines)
    return [
        (
            f"{passed} of {len(found.machines)} machines are in specification with their tables",
            found.passed,
        )
    ]


def filter_facts(found: LearnedJob) -> list[tuple[str, str]]:
    """Return the learning filter of every axis in words."""
    facts = []
    learned = found.machines[0][1]
    for learning_filter in learned.filters:
        band_hz = learning_filter.unlearned_hz
        text = f"gain {learned.rules.gain:g}, low-pass {learning_filter.low_pass_hz:.3g} Hz"
        if band_hz is not None:
            text += (
                f"; nothing is learned from {band_hz[0]:.3g} to {band_hz[1]:.3g} Hz, where "
                "machines within the tolerances answer too differently"
            )
        facts.append((f"learning filter {learning_filter.axis}", text))
    return facts
