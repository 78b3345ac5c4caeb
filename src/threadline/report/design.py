"""The report of a redesign: its changes, their cost and gain, the region in spec, and the front."""

from __future__ import annotations

import math
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.machine.numbers import number_at
from threadline.report.document import Document, Table, origin_facts
from threadline.report.publish import write_document
from threadline.report.style import figure_style, new_figure
from threadline.search.design import DesignResult, candidate_cells
from threadline.search.design_proof import Candidate, ProvedDesign
from threadline.verdict import Verdict, closing, percent_used, verdict_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Table = tuple[list[str], list[list[str]]]
_AROUND = 0.06  # margin around the points, as a share of their range on a logarithmic axis
_FEWEST_TICKS = 4
_MARKS = ("s", "D", "^", "P", "X")


def change_rows(result: DesignResult) -> _Table:
    """Return the numbers that the design changes: from, to, factor and cost."""
    found, space = result.found, result.space
    assert found is not None
    rows = []
    for name, weight, paths in zip(space.names, space.weights, space.paths, strict=True):
        factor = found.candidate.factors[name]
        if factor == 1.0:
            continue
        cost = f"{weight * abs(np.log(factor)):.3f}"
        for path in paths:
            old = number_at(result.machine, path)
            rows.append(
                [
                    name,
                    path,
                    f"{old.si:.4g} {old.unit}",
                    f"{old.si * factor:.4g} {old.unit}",
                    f"{factor:.3g}",
                    cost,
                ]
            )
            cost = ""
    rows.append(["total", "", "", "", "", f"{found.candidate.cost:.3f}"])
    return ["parameter", "number", "from", "to", "factor", "cost"], rows


def gain_rows(found: ProvedDesign) -> _Table:
    """Return the settings for the changed machine: filters, acceleration, needle."""
    rows = []
    candidate = found.candidate
    if candidate.crossover_hz is not None:
        rows.append(["crossover of all axes", f"{candidate.crossover_hz:.4g} Hz"])
        rows.append(["phase margin", f"{candidate.phase_margin_deg:.4g} deg"])
    for path, value in found.numbers.items():
        if path.startswith("controllers."):
            rows.append([path, f"{value:.5g}"])
    if candidate.smoothing_s is None and found.machine.axes:
        rows.append(["acceleration and jerk, of the machine's", f"{candidate.acceleration:.1%}"])
    elif candidate.smoothing_s is not None:
        rows.append(["feed-forward, smoothed over", f"{candidate.smoothing_s * 1e3:.3g} ms"])
        share = f"{candidate.acceleration:.1%}"
        rows.append(["acceleration and jerk of the ramps, of the machine's", share])
    if candidate.delay_s is not None:
        rows.append(["needle down after the command", f"{candidate.delay_s * 1e3:.3g} ms"])
    return ["setting", "value"], rows


def candidate_rows(result: DesignResult) -> _Table:
    """Return the Pareto set and the machines that it is compared with."""
    names = list(result.space.names)
    header = ["machine", *names, "cost", f"of the limit, {result.screened}", "limited by"]
    rows = [candidate_cells("as it is", names, result.as_built)]
    rows += [candidate_cells(name, names, candidate) for name, candidate in result.known.items()]
    if result.found is not None:
        rows.append(candidate_cells("smallest change", names, result.found.candidate))
    rows += [
        candidate_cells("cost against margin", names, candidate) for candidate in result.pareto
    ]
    return header, rows


def corners_title(corners: Verdict) -> str:
    """Return the title of the verdict over the corners of the redesign's tolerances."""
    count = corners.runs + corners.machines
    return f"Verdict of one run at each of {count} corners of the tolerances of [design]"


def write_design_report(result: DesignResult, folder: Path) -> Path:
    """Write the report into ``folder``; return the path of the HTML page.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    tables, figures, captions = [], {}, {}
    if result.found is not None:
        changed, settings = change_rows(result), gain_rows(result.found)
        verdict = verdict_rows(result.found.verdict)
        tables.append(Table(title="The smallest change", header=changed[0], rows=changed[1]))
        tables.append(Table(title="Settings", header=settings[0], rows=settings[1]))
        tables.append(
            Table(
                title="Criteria",
                header=verdict[0],
                rows=verdict[1],
                note=closing(result.found.verdict),
            )
        )
        if result.found.corners is not None:
            header, rows = verdict_rows(result.found.corners)
            title = corners_title(result.found.corners)
            tables.append(Table(title=title, header=header, rows=rows))
    header, rows = candidate_rows(result)
    tables.append(
        Table(
            title="Cost against margin, and other machines",
            header=header,
            rows=rows,
            note="Factors on the machine's numbers. Cost is the sum of weight x |ln factor|; of "
            "the limit: the worst measured over its limit, 100 % or less is in spec; a design out "
            "of spec in its first run was not tried in others.",
        )
    )
    if result.front:
        header, rows = front_rows(result)
        tables.append(Table(title=front_title(result), header=header, rows=rows))
    with figure_style():
        if result.region is not None:
            figures["region"] = region_figure(result)
            captions["region"] = _region_caption(result)
        figures["pareto"] = pareto_figure(result)
        captions["pareto"] = (
            "No machine that was tried has both less cost and less use of the limit than one here."
        )
        if result.front:
            figures["front"] = front_figure(result)
            captions["front"] = (
                "Machines drawn within the tolerances of each candidate, all with the same "
                "deviations. Crosses: another candidate has as many in spec and costs no more."
            )
        return write_document(
            Document(
                title=f"{result.job.name} on {result.machine.name}: redesign",
                subtitle=result.machine.title,
                verdicts=[(result.sentence(), result.found is not None)],
                tables=tables,
                figures=figures,
                captions=captions,
                facts=[
                    *origin_facts(result.machine, result.job),
                    ("machines simulated", str(result.simulated)),
                ],
            ),
            folder,
            "design",
        )


def _region_caption(result: DesignResult) -> str:
    assert result.region is not None
    others = ", ".join(f"{n} x {f:.3g}" for n, f in result.region.others.items())
    held_text = (
        f"with {others}, as in the design" if others else "everything else as the machine is"
    )
    dashed_text = (
        " Dashed: the same boundary with everything else as the machine is." if others else ""
    )
    return (
        f"Hatched: in spec, {held_text}; the best of ten designs of the filters and of "
        f"all needle delays at each point, in one run. Numbers on the lines: the worst measured "
        f"over its limit.{dashed_text}"
    )


def region_figure(result: DesignResult) -> Figure:
    """Draw the region in spec over two parameters, with the design and other machines."""
    from matplotlib.ticker import FixedLocator, NullLocator

    region = result.region
    assert region is not None
    figure, panel = new_figure((7.2, 5.6))
    first_grid, second_grid = np.meshgrid(*region.factors)
    log_ratio = np.log(np.clip(region.found, 1e-2, 1e2))
    filled = panel.contourf(
        first_grid,
        second_grid,
        log_ratio,
        levels=[-10.0, 0.0],
        colors=["#d9e8f2"],
        hatches=["///"],
        alpha=1.0,
    )
    filled.set_edgecolor("0.6")
    lines = panel.contour(
        first_grid, second_grid, log_ratio, levels=np.log([0.25, 0.5, 1.0, 2.0, 4.0]).tolist(),
        colors="black", linewidths=[0.6, 0.6, 1.8, 0.6, 0.6], linestyles="solid",
    )  # fmt: skip
    panel.clabel(lines, fmt=lambda v: f"{np.exp(v):.0%}", fontsize=7, inline_spacing=1)
    panel.fill(
        [], [], facecolor="#d9e8f2", edgecolor="0.6", hatch="///",
        label="in spec; lines: worst of its limit",
    )  # fmt: skip
    if region.others:
        panel.contour(
            first_grid, second_grid, np.log(np.clip(region.unchanged, 1e-2, 1e2)), levels=[0.0],
            colors="0.35", linewidths=1.4, linestyles=[(0, (5, 2))],
        )  # fmt: skip
    if result.found is not None:
        _mark(panel, result, "smallest change", result.found.candidate, "*", True)
    for k, (name, candidate) in enumerate(result.known.items()):
        assert result.machine.design is not None
        title = result.machine.design.known[name].title
        _mark(panel, result, title, candidate, _MARKS[k % len(_MARKS)], True)
    # The machine as built is drawn as a ring, so that a marker at the same place stays visible.
    _mark(panel, result, "as it is", result.as_built, "o", False)
    panel.set_xscale("log")
    panel.set_yscale("log")
    # Room for markers on the edge of the region.
    panel.set_xlim(*_around(region.factors[0]))
    panel.set_ylim(*_around(region.factors[1]))
    panel.set_xlabel(f"{region.names[0]}, factor")
    panel.set_ylabel(f"{region.names[1]}, factor")
    panel.grid(visible=False)
    for axis, factors in zip((panel.xaxis, panel.yaxis), region.factors, strict=True):
        axis.set_major_locator(FixedLocator(_ticks(float(factors[0]), float(factors[-1]))))
        axis.set_major_formatter(lambda v, _: f"{v:g}")
        axis.set_minor_locator(NullLocator())
    figure.legend(loc="outside lower center", ncols=1, markerscale=0.7)
    # The points are judged in the requested number of runs, the region in one run.
    panel.set_title(f"{result.job.name} on {result.machine.name}: what is in spec in one run")
    return figure


def _around(factors: FloatArray) -> tuple[float, float]:
    """Return the ends of a figure's axis, with a margin on both sides of the factors."""
    low, high = float(factors[0]), float(factors[-1])
    margin = (high / low) ** _AROUND
    return low / margin, high * margin


def _ticks(low: float, high: float) -> list[float]:
    """Return round factors from low to high, with equal steps if the span is short."""
    from matplotlib.ticker import MaxNLocator

    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    logarithmic = (
        [step * 10.0**decade for decade in decades for step in steps]
        for steps in ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))
    )
    even = (list(MaxNLocator(n).tick_values(low, high)) for n in range(4, 10))
    ticks: list[float] = []
    for candidates in chain(logarithmic, even):
        ticks = [v for v in candidates if low * (1 - 1e-9) <= v <= high * (1 + 1e-9)]
        if len(ticks) >= _FEWEST_TICKS:
            break
    return ticks


def _mark(
    panel: Axes, result: DesignResult, title: str, candidate: Candidate, marker: str, filled: bool
) -> None:
    assert result.region is not None
    x, y = (candidate.factors[name] for name in result.region.names)
    used_text = f"{percent_used(min(candidate.ratio, 99.0))} of the limit, {result.screened}"
    panel.plot(
        [x], [y], linestyle="none", marker=marker, markersize={"*": 13, "o": 18}.get(marker, 9),
        markerfacecolor="#E69F00" if filled else "none", markeredgecolor="black", clip_on=False,
        markeredgewidth=1.0 if filled else 1.6,
        zorder=6, label=f"{title}: {used_text}",
    )  # fmt: skip


def pareto_figure(result: DesignResult) -> Figure:
    """Draw the cost over the used share of the limit."""
    figure, panel = new_figure((7.2, 4.2))
    cost = [c.cost for c in result.pareto]
    panel.step(
        cost, [100.0 * c.ratio for c in result.pareto], where="post", color="black", lw=1.0,
        marker="o", markersize=4, markerfacecolor="white", label="least share for the cost",
    )  # fmt: skip
    panel.axhline(
        100.0, color="#D55E00", linestyle=(0, (1, 1.5)), lw=1.4, label="limit of the specification"
    )
    marked = [("as it is", result.as_built, "o"), *(
        (name, candidate, "s") for name, candidate in result.known.items()
    )]  # fmt: skip
    if result.found is not None:
        marked.append(("smallest change", result.found.candidate, "*"))
    for title, candidate, marker in marked:
        panel.plot(
            [candidate.cost], [100.0 * candidate.ratio], linestyle="none", marker=marker,
            markersize=13 if marker == "*" else 8, markerfacecolor="#E69F00",
            markeredgecolor="black", label=title,
        )  # fmt: skip
    panel.set_ylim(0.0, 100.0 * min(max(1.6, 1.1 * result.as_built.ratio), 4.0))
    panel.set_xlabel("cost: sum of weight x |ln factor|")
    panel.set_ylabel("worst measured over its limit [%]")
    panel.set_title(f"What a change buys: {result.screened}")
    panel.legend()
    return figure


def front_title(result: DesignResult) -> str:
    """Return the title of the table, with the number of machines."""
    return f"Cost against yield: {result.front[0].machines} machines of each"


def front_rows(result: DesignResult) -> tuple[list[str], list[list[str]]]:
    """Return the candidates by their cost, each with its yield and its interval at 95 %."""
    names = list(result.space.names)
    rows = [
        [
            *(f"{one.factors[name]:.3g}" for name in names),
            f"{one.cost:.3f}",
            f"{one.passed}",
            f"{100.0 * one.interval[0]:.1f} to {100.0 * one.interval[1]:.1f} %",
            "yes" if one.on_front else "no",
        ]
        for one in result.front
    ]
    return [*names, "cost", "in spec", "yield", "on the front"], rows


def front_figure(result: DesignResult) -> Figure:
    """Draw the yield over the cost, with its interval; the front is a line."""
    figure, panel = new_figure((7.2, 4.2))
    for marker, on_front in (("o", True), ("x", False)):
        candidates = [one for one in result.front if one.on_front is on_front]
        shares = np.array([one.share for one in candidates])
        low, high = np.array([one.interval for one in candidates]).reshape(-1, 2).T
        panel.errorbar(
            [one.cost for one in candidates],
            100.0 * shares,
            100.0 * np.array([shares - low, high - shares]),
            fmt=marker, color="black", capsize=2,
            label="on the front" if on_front else "no more yield than a cheaper one",
        )  # fmt: skip
    front = [one for one in result.front if one.on_front]
    panel.step(
        [one.cost for one in front], [100.0 * one.share for one in front], where="post",
        color="#0072B2", label="most yield for the cost",
    )  # fmt: skip
    panel.set_ylim(-3.0, 103.0)
    panel.set_xlabel("cost: sum of weight x |ln factor|")
    panel.set_ylabel("yield, 95 % interval [%]")
    panel.set_title(front_title(result))
    panel.legend()
    return figure
