"""The cases of a comparison in one figure: turning points of an axis, paths of two axes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from threadline.base.wording import grouped
from threadline.proof.pipeline import Proof
from threadline.proof.recorded import warnings_of_all
from threadline.report.document import Document, Printed, Table
from threadline.report.figures import moves, path_figure, profile_figure
from threadline.report.motion import shared_facts, summary_facts
from threadline.report.publish import write_document
from threadline.report.style import AXES, LIMIT, PROGRAMMED, figure_style, new_figure
from threadline.report.traces import Traces, collect
from threadline.verdict import closing_of_all

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from threadline.search import Comparison


Case: TypeAlias = tuple[str, Proof, Traces]
"""A label, the proof and its traces."""

_AROUND_S = 0.3
_TALL_IN = 8.6  # height of all panels together, which fits a page


def overlays(cases: list[Case]) -> tuple[dict[str, Figure], dict[str, str]]:
    """Return the figures that show all cases, and their captions, both by name."""
    figures: dict[str, Figure] = {}
    captions: dict[str, str] = {}
    _, proof, traces = cases[0]
    machine = proof.plan.machine
    linear = [
        axis
        for axis in traces.actual
        if moves(traces, axis) and machine.axes[axis].kind == "linear"
    ]
    for axis in linear:
        figures[f"turning-{axis}"] = turning_figure(cases, axis)
        captions[f"turning-{axis}"] = (
            "The carriage at the outermost programmed point with the largest error: above 0 it "
            "goes past the point (over-travel), below it stops short."
        )
    for first, second in pairwise(linear):
        figures[f"paths-{first}{second}"] = paths_figure(cases, first, second)
        captions[f"paths-{first}{second}"] = (
            "Path of the eye in each case, and the programmed points. The distance beyond the "
            "outermost point is the over-travel."
        )
    return figures, captions


def turns_s(traces: Traces) -> list[float]:
    """Return the instants, s, at which each axis has its largest and its smallest position."""
    return [
        float(traces.time_s[at])
        for position in traces.actual.values()
        for at in (np.nanargmax(position), np.nanargmin(position))
    ]


def turning_figure(cases: list[Case], axis: str) -> Figure:
    """Draw the actual position of ``axis`` around its outermost point, a panel for each feed."""
    feeds = list(dict.fromkeys(proof.plan.options["feed"] for _, proof, _ in cases))
    figure, panels = new_figure((7.2, _tall_in(len(feeds), 3.0)), len(feeds))
    point_m, sign = _outermost(cases, axis)
    for panel, feed in zip(panels, feeds, strict=True):
        cases_at_feed = [case for case in cases if case[1].plan.options["feed"] == feed]
        deepest_mm = 1.0
        for number, (_, proof, traces) in enumerate(cases_at_feed):
            beyond_mm = sign * (traces.actual[axis] - point_m) * 1e3
            extreme_index = int(np.argmax(beyond_mm))
            is_near = np.abs(traces.time_s - traces.time_s[extreme_index]) <= 2.0 * _AROUND_S
            deepest_mm = max(deepest_mm, abs(float(beyond_mm[extreme_index])))
            panel.plot(
                traces.time_s[is_near] - traces.time_s[extreme_index],
                beyond_mm[is_near],
                label=proof.plan.motion.path.interpolation,
                **AXES[number % len(AXES)],
            )
        limit_m = _limit_m(cases_at_feed[0][1], axis)
        if limit_m is not None:
            panel.axhline(limit_m * 1e3, label=f"limit {limit_m * 1e3:g} mm", **LIMIT)
            panel.axhline(-limit_m * 1e3, **LIMIT)
        panel.set_ylim(-1.3 * deepest_mm - 0.5, 0.35 * deepest_mm + 0.5)
        panel.set_xlim(-_AROUND_S, _AROUND_S)
        panel.set_ylabel(f"{axis} beyond the point [mm]")
        panel.set_title(f"Feed {feed}: {axis} turning at {point_m * 1e3:g} mm")
    panels[-1].set_xlabel("time from the extreme [s]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def _tall_in(panels: int, each_in: float) -> float:
    """Return the height of a figure, inches; many panels are lower, to fit a page."""
    return 1.0 + min(each_in * panels, max(_TALL_IN, 1.5 * panels))


def _outermost(cases: list[Case], axis: str) -> tuple[float, float]:
    """Return the end of the programmed travel with the larger error, m, and its direction."""
    _, proof, traces = cases[0]
    programmed = traces.vertices[:, proof.plan.motion.programmed.axes.index(axis)]
    ends = [(float(programmed.max()), 1.0), (float(programmed.min()), -1.0)]

    def largest_error_m(end: tuple[float, float]) -> float:
        point_m, sign = end
        return max(
            abs(float((sign * (case[2].actual[axis] - point_m)).max(initial=-np.inf)))
            for case in cases
        )

    return max(ends, key=largest_error_m)


def _limit_m(proof: Proof, axis: str) -> float | None:
    for result in proof.verdict.results:
        if result.name == "turning_point_error" and result.axis == axis:
            return result.limit
    return None


def paths_figure(cases: list[Case], first: str, second: str) -> Figure:
    """Draw the path of two linear axes in every case, to scale, a panel for each feed."""
    feeds = list(dict.fromkeys(proof.plan.options["feed"] for _, proof, _ in cases))
    figure, panels = new_figure((7.2, _tall_in(len(feeds), 3.2)), len(feeds))
    for panel, feed in zip(panels, feeds, strict=True):
        cases_at_feed = [case for case in cases if case[1].plan.options["feed"] == feed]
        for number, (_, proof, traces) in enumerate(cases_at_feed):
            panel.plot(
                traces.actual[first] * 1e3,
                traces.actual[second] * 1e3,
                label=proof.plan.motion.path.interpolation,
                **AXES[number % len(AXES)],
            )
        _, proof, traces = cases_at_feed[0]
        columns = [proof.plan.motion.trajectory.axes.index(axis) for axis in (first, second)]
        points = traces.vertices[:, columns] * 1e3
        panel.plot(points[:, 0], points[:, 1], label="programmed", **PROGRAMMED)
        panel.set_aspect("equal", adjustable="datalim")
        panel.margins(0.06)
        panel.set_xlabel(f"{first} [mm]")
        panel.set_ylabel(f"{second} [mm]")
        panel.set_title(f"Feed {feed}: the eye's path {first}-{second}")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5)
    return figure


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
            if traces.stride > 1:  # turning points are drawn with every sample
                traces = collect(proof, turns_s(traces))
            label = f"{proof.plan.motion.path.interpolation}, feed {proof.plan.options['feed']}"
            stem = label.replace(", feed ", "-").replace(" ", "").replace("/", "-per-")
            for name, figure in _figures(proof, traces).items():
                # On a separate line, because the legend is beside the title.
                figure.axes[0].set_title(f"{label}:\n{figure.axes[0].get_title(loc='left')}")
                figures[f"{stem}-{name}"] = figure
                captions[f"{stem}-{name}"] = (
                    f"{label}. Programmed, planned and actual; the lines differ in dash."
                    f"{traces.run.words(proof)}"
                )
            cases.append((label, proof, traces))
        first_figures, first_captions = overlays(cases)
        figures, captions = first_figures | figures, first_captions | captions
        all_passed = all(proof.verdict.passed for proof in found.proofs)
        document = Document(
            title=f"{first.plan.job.name} on {first.plan.machine.name}: comparison",
            subtitle=first.plan.machine.title,
            verdicts=[(closing_of_all([proof.verdict for proof in found.proofs]), all_passed)],
            warnings=grouped(warnings_of_all(found.proofs)),
            tables=[Table(title=t, header=h, rows=r) for t, h, r in tables],
            figures=figures,
            captions=captions,
            facts=_facts(cases),
        )
        return write_document(document, folder, "comparison")


def _facts(cases: list[Case]) -> list[tuple[str, str]]:
    """Return the facts that all cases share, then the planner's facts case by case."""
    first = cases[0][1]
    facts = [*shared_facts(first, ("interpolation", "feed"))]
    for number, (label, proof, _) in enumerate(cases, start=1):
        fact_text = ", ".join(f"{key} {value}" for key, value in summary_facts(proof))
        facts.append((f"case {number}", f"{label}; {fact_text}" if fact_text else label))
    return facts


def _figures(proof: Proof, traces: Traces) -> dict[str, Figure]:
    machine = proof.plan.machine
    moving = [axis for axis in traces.drawn_axes if moves(traces, axis)]
    linear = [axis for axis in moving if machine.axes[axis].kind == "linear"]
    figures = {f"profile-{axis}": profile_figure(proof, traces, axis) for axis in linear}
    if len(linear) > 1:
        figures[f"path-{linear[0]}{linear[1]}"] = path_figure(proof, traces, linear[0], linear[1])
    return figures
