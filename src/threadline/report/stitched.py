"""The figures of an embroidery design: margins of stitches, lengths of moves, speed."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.wording import grouped
from threadline.base.writing import staged_file, together
from threadline.commands.plan import Plan
from threadline.files import Recording
from threadline.proof.pipeline import Proof
from threadline.proof.recorded import warnings_of, warnings_of_all
from threadline.report.document import (
    Document,
    Printed,
    Table,
    changes,
    options_facts,
    origin_facts,
    run_facts,
)
from threadline.report.lines import stitch_rows
from threadline.report.publish import write_document
from threadline.report.seam import stitch_lines
from threadline.report.style import ACTUAL, AXES, PLANNED, figure_style, new_figure
from threadline.report.traces import DrawnRun, drawn_run, run_words
from threadline.verdict import closing, closing_of_all, verdict_rows
from threadline.verdict.stitch_run import StitchRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from threadline.search import Comparison
    from threadline.search.report_data import ReportData


_THIN, _THICK = 0.35, 2.4
_LEVELS = 5
_OUT = "#D55E00"
_CLOTH = "0.82"
_GREYS = (0.1, 0.45, 0.25, 0.6)
_MINUTE = 60.0
_SLOWEST = "all as slow as the slowest stitch alone"


def design_figure(proof: Proof, recording: Recording) -> Figure:
    """Draw the design as sewn in a run; each stitch is shaded by its used share of the limit."""
    from matplotlib.collections import LineCollection

    plan = proof.plan
    run = StitchRun(recording, plan)
    shares_used, limit_text = _shares_used(proof, run)
    figure, panel = new_figure((7.2, 7.0))
    places_mm = np.vstack((np.array(plan.job.start), plan.stitched.places_m)) * 1e3
    segments = np.stack((places_mm[:-1], places_mm[1:]), axis=1)
    travel = plan.stitched.turns.moves.needle == 0
    panel.add_collection(
        LineCollection(list(segments[travel]), colors="0.5", linestyles=":", linewidths=0.9)
    )
    stitch_segments = segments[run.turns]
    edges = np.linspace(0.0, 1.0, _LEVELS + 1)
    for level in range(_LEVELS):
        band_low, band_high = edges[level], edges[level + 1]
        is_last = level == _LEVELS - 1
        in_band = (shares_used >= band_low) & (
            (shares_used < band_high) | (is_last & (shares_used <= 1.0))
        )
        share = level / (_LEVELS - 1)
        panel.add_collection(
            LineCollection(
                list(stitch_segments[in_band]),
                colors=[_shade(share)],
                linewidths=_THIN + share * (_THICK - _THIN),
                label=f"{100 * band_low:.0f} to {100 * band_high:.0f} % {limit_text}: "
                f"{int(in_band.sum())}",
                zorder=2 + level,
            )
        )
    over_limit = shares_used > 1.0
    panel.add_collection(
        LineCollection(list(stitch_segments[over_limit]), colors=_OUT, linewidths=_THICK, zorder=8)
    )
    middles = stitch_segments[over_limit].mean(axis=1)
    panel.plot(
        middles[:, 0], middles[:, 1], linestyle="none", marker="x", color="black",
        markersize=4, markeredgewidth=0.8, zorder=9,
    )  # fmt: skip
    panel.plot(
        [], [], color=_OUT, linewidth=_THICK, marker="x", markersize=4, markeredgecolor="black",
        markeredgewidth=0.8, label=f"over it: {int(over_limit.sum())}",
    )  # fmt: skip
    _finish(figure, panel)
    return figure


def threads_figure(plan: Plan) -> Figure:
    """Draw the design as embroidered: each block in the colour of its thread, and numbered.

    A block whose colour is not in the file gets a grey that no other block has.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.patheffects import withStroke

    stitched = plan.stitched
    figure, panel = new_figure((7.2, 7.0))
    panel.set_facecolor(_CLOTH)
    panel.grid(visible=False)
    places_mm = stitched.places_m * 1e3
    segments = np.stack((places_mm[:-1], places_mm[1:]), axis=1)
    for thread in stitched.sewn:
        in_block = (stitched.turns.block == thread.block)[1:] & (stitched.frame_moves == 1)[1:]
        first_mm = places_mm[(stitched.turns.block == thread.block) & (stitched.turns.stitch > 0)][
            0
        ]
        grey = str(_GREYS[(thread.block - 1) % len(_GREYS)])
        panel.add_collection(
            LineCollection(
                list(segments[in_block]),
                colors=grey if thread.thread is None else thread.thread.rgb,
                linewidths=1.2,
                # An edge makes white thread visible on a light cloth, and every thread in print.
                path_effects=[withStroke(linewidth=1.7, foreground="0.3")],
                label=f"{thread.block}  {thread.thread or 'colour unknown'}: {thread.stitches} "
                f"stitches, {thread.thread_m:.4g} m, {thread.duration_s:.4g} s",
            )
        )
        panel.annotate(
            str(thread.block), first_mm, fontsize=7, ha="center", va="center",
            bbox={"boxstyle": "circle,pad=0.15", "fc": "white", "ec": "black", "lw": 0.5},
        )  # fmt: skip
    _finish(figure, panel)
    return figure


def _finish(figure: Figure, panel: Axes) -> None:
    """Label a drawing of the cloth, at one scale on both axes."""
    panel.set_aspect("equal", adjustable="datalim")
    panel.autoscale_view()
    panel.set_xlabel("X mm")
    panel.set_ylabel("Y mm")
    figure.legend(loc="outside lower center", ncols=2)


def _shade(share: float) -> tuple[float, float, float]:
    """Return a colour from light blue at 0 to black at 1, which also gets darker in grey print."""
    light, dark = np.array([0.60, 0.78, 0.92]), np.array([0.0, 0.05, 0.15])
    red, green, blue = (light + share * (dark - light)).tolist()
    return red, green, blue


def _shares_used(proof: Proof, run: StitchRun) -> tuple[FloatArray, str]:
    """Return (s,) used shares of the limit, stitch by stitch, and the name of the limit."""
    limits = [
        result.limit
        for axis in proof.plan.axes
        for result in proof.verdict.results
        if result.name == "stitch_residual" and result.axis == axis
    ]
    residual = run.sewn.residual_m
    if len(limits) == len(proof.plan.axes) and all(limits):
        share = np.nanmax(residual / np.array(limits, dtype=np.float64), axis=1)
        return share, "of the limit"
    return np.nanmax(residual, axis=1) / float(np.nanmax(residual)), "of the largest residual"


def moves_figure(plan: Plan) -> Figure:
    """Draw the histogram of the lengths of the moves."""
    stitched = plan.stitched
    unit_mm = stitched.pace.tables.unit.si * 1e3
    units = np.abs(stitched.turns.moves.units).max(axis=1)[stitched.frame_moves == 1]
    figure, panel = new_figure((7.2, 3.0))
    counts = np.bincount(units)
    panel.bar(
        unit_mm * np.arange(len(counts)), counts, width=0.9 * unit_mm, color="#0072B2",
        edgecolor="black", linewidth=0.3,
    )  # fmt: skip
    panel.set_yscale("symlog", linthresh=1.0)
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel("move, longer axis, mm")
    panel.set_ylabel("stitches")
    return figure


def pace_figure(plan: Plan) -> Figure:
    """Draw speed and time along the design."""
    stitched = plan.stitched
    figure, (speed_panel, time_panel) = new_figure((7.2, 4.6), 2, sharex=True)
    number = np.arange(1, len(stitched.turns) + 1)
    speed_panel.plot(number, _MINUTE / stitched.turns.turn_s, drawstyle="steps-mid", **ACTUAL)
    slowest_s = stitched.slowest_s / len(number)
    speed_panel.axhline(_MINUTE / slowest_s, label=_SLOWEST, **PLANNED)
    speed_panel.set_ylabel("stitches a minute")
    speed_panel.set_ylim(bottom=0.0)
    time_panel.plot(number, np.cumsum(stitched.turns.turn_s), label="as planned", **ACTUAL)
    time_panel.plot(number, slowest_s * number, label=_SLOWEST, **PLANNED)
    time_panel.set_ylabel("s")
    time_panel.set_xlabel("turn of the shaft")
    figure.legend(*time_panel.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def speeds_figure(plans: Sequence[Plan]) -> Figure:
    """Draw the speed along the design for each plan."""
    figure, panel = new_figure((7.2, 3.6))
    for plan, style in zip(plans, cycle(AXES), strict=False):
        turns = plan.stitched.turns
        number = np.arange(1, len(turns) + 1)
        label = f"{plan.planned_with}: {plan.duration_s:.4g} s"
        panel.plot(number, _MINUTE / turns.turn_s, drawstyle="steps-mid", label=label, **style)
    panel.set_xlabel("turn of the shaft")
    panel.set_ylabel("stitches a minute")
    panel.set_ylim(bottom=0.0)
    figure.legend(loc="outside lower center", ncols=1)
    return figure


_CAPTIONS = {
    "design": "The design as it is sewn. A stitch is drawn the thicker and the darker, the more of "
    "the limit it uses; a cross marks a stitch out of spec; along dotted lines the needle is up.",
    "threads": "The design in the colours of its threads, numbered where each begins, with the "
    "length and the time of each.",
    "moves": "The number of moves of each length, along the axis with the longer way. The longest "
    "moves need the slowest turns, since the frame swings for longest behind them.",
    "pace": "The speed of the shaft at each stitch, and the time until then. Dashed: the highest "
    "speed that leaves the slowest stitch, planned alone, enough time.",
}
_DRAWN = ("stitch_residual",)
_THREADS_HEADER = ["block", "thread", "stitches", "length m", "time s"]
STITCHES = "report-stitches.csv"
"""File in the folder of the page, with a row for each stitch."""
_WORST = 10
_LEFT_OUT = ("feed-mode", "limits", "interpolation")
"""Options without effect on a frame that moves from stitch to stitch by a motion law."""


def write_stitched(studied: ReportData, folder: Path) -> Path:
    """Write the report of a proof into ``folder``; return the path of the HTML page.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    proof = studied.proof
    plan, run = proof.plan, drawn_run(proof, _DRAWN)
    header, rows = verdict_rows(proof.verdict)
    with figure_style():
        figures = {
            "design": design_figure(proof, run.recording),
            "threads": threads_figure(plan),
            "moves": moves_figure(plan),
            "pace": pace_figure(plan),
        }
        document = Document(
            title=f"{plan.job.name} on {plan.machine.name}",
            subtitle=f"{plan.machine.title}; {plan.planned_with}",
            verdicts=[(closing(proof.verdict), proof.verdict.passed)],
            warnings=grouped(warnings_of(proof)),
            tables=[
                Table(title="Criteria", header=header, rows=rows),
                *changes(proof.verdict),
                Table(title="Stitches", header=["", ""], rows=stitch_rows(plan)),
                Table(title="Threads", header=_THREADS_HEADER, rows=_thread_rows(plan)),
                _worst_table(proof, run),
            ],
            figures=figures,
            captions={**_CAPTIONS, "design": _CAPTIONS["design"] + run.words(proof)},
            facts=_facts(proof),
        )
        with together():
            page = write_document(document, folder, "report")
            with staged_file(folder / STITCHES) as file:
                file.writelines(f"{line}\n".encode() for line in stitch_lines(proof, run.recording))
        return page


def write_stitched_comparison(found: Comparison, folder: Path, tables: Sequence[Printed]) -> Path:
    """Write the report of a comparison of laws or speeds; return the path of the HTML page."""
    first = found.proofs[0].plan
    all_passed = all(proof.verdict.passed for proof in found.proofs)
    with figure_style():
        figures: dict[str, Figure] = {"speeds": speeds_figure([p.plan for p in found.proofs])}
        captions = {"speeds": "Speed of the shaft along the design, case by case."}
        for number, proof in enumerate(found.proofs, start=1):
            run = drawn_run(proof, _DRAWN)
            figures[f"design-{number}"] = design_figure(proof, run.recording)
            captions[f"design-{number}"] = (
                f"{proof.plan.planned_with}. {_CAPTIONS['design']}{run.words(proof)}"
            )
        document = Document(
            title=f"{first.job.name} on {first.machine.name}: comparison",
            subtitle=first.machine.title,
            verdicts=[(closing_of_all([proof.verdict for proof in found.proofs]), all_passed)],
            warnings=grouped(warnings_of_all(found.proofs)),
            tables=[Table(title=t, header=h, rows=r) for t, h, r in tables],
            figures=figures,
            captions=captions,
            facts=[
                *_facts(found.proofs[0]),
                *(
                    (f"case {n}", proof.plan.planned_with)
                    for n, proof in enumerate(found.proofs, start=1)
                ),
            ],
        )
        return write_document(document, folder, "comparison")


def _thread_rows(plan: Plan) -> list[list[str]]:
    return [
        [
            str(one.block),
            str(one.thread or "not in the file"),
            str(one.stitches),
            f"{one.thread_m:.4g}",
            f"{one.duration_s:.4g}",
        ]
        for one in plan.stitched.sewn
    ]


def _worst_table(proof: Proof, drawn: DrawnRun) -> Table:
    """Return a table of the stitches with the largest errors in the drawn run, worst first."""
    plan = proof.plan
    run = StitchRun(drawn.recording, plan)
    turns, residual = plan.stitched.turns, run.sewn.residual_m
    needed_s = plan.stitched.pace.needed_turns_s(turns.moves)
    largest = np.nan_to_num(np.nanmax(residual, axis=1), nan=-1.0)
    rows = []
    for stitch in np.argsort(-largest)[:_WORST].tolist():
        turn = int(run.turns[stitch])
        move_texts = " ".join(
            f"{axis}{value * plan.stitched.pace.tables.unit.si * 1e3:+.4g}"
            for axis, value in zip(plan.axes, turns.moves.units[turn].tolist(), strict=True)
        )
        rows.append(
            [
                turns.name(turn),
                str(turns.line[turn]),
                move_texts,
                f"{largest[stitch] * 1e3:.4f}",
                f"{_MINUTE / turns.turn_s[turn]:.4g}",
                f"{_MINUTE / needed_s[turn]:.4g}",
            ]
        )
    header = ["stitch", "record", "move mm", "residual mm", "stitches/min", "alone it can at"]
    run_text = f", {run_words(proof.verdict, drawn.number)}" if drawn.words(proof) else ""
    return Table(
        title=f"The stitches that are farthest off{run_text}",
        header=header,
        rows=rows,
        note=f"All stitches of that run are in {STITCHES}, which lies beside this page.",
    )


def _facts(proof: Proof) -> list[tuple[str, str]]:
    plan = proof.plan
    commands = plan.stitched.commands
    return [
        *origin_facts(plan.machine, plan.job),
        ("simulated", "yes" if proof.verdict.simulated else "no, recorded live"),
        *run_facts(proof.recording),
        ("tables", f"{len(commands.library)}, counted by {commands.counted_by}"),
        ("law", plan.stitched.law.name),
        *options_facts(plan.options, plan.machine, _LEFT_OUT),
    ]
