"""The report of an on/off machine: broken light beam, Petri net of the PLC, tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from threadline.base.arrays import FloatArray
from threadline.base.wording import grouped
from threadline.commands.intents import Scheduled
from threadline.commands.plc_net import NetPlace, petri_net
from threadline.commands.plc_watch import home_places
from threadline.errors import PlanError
from threadline.proof.options import OF_AXES
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
from threadline.report.lines import creep_rows, production, shaping_rows
from threadline.report.publish import write_document
from threadline.report.style import figure_style, new_figure
from threadline.report.switching_figures import (
    cycle_figure,
    frame_figure,
    residual_figure,
    residuals_figure,
    shaper_words,
)
from threadline.report.traces import drawn_run
from threadline.verdict import closing, closing_of_all, step_rows, verdict_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from threadline.search import Comparison
    from threadline.search.broken_beam import BreakSweep
    from threadline.search.report_data import ReportData


MICRO = 1e6


def break_figure(
    sweeps: Sequence[BreakSweep], twin: tuple[FloatArray, FloatArray] | None = None
) -> Figure:
    """Draw the vibration after a beam was broken over that instant, a panel per shaper.

    The first panel also shows the simulated points ``twin``, times in s and amplitudes in m.
    """
    columns = 3
    rows = -(-len(sweeps) // columns)
    figure, panels = new_figure((7.2, 2.0 * rows), rows, columns, sharex=True, sharey=True)
    worst = next(float(s.ringing_m.max()) for s in sweeps if s.name == "none") * MICRO
    for panel, sweep in zip(panels, sweeps, strict=False):
        panel.plot(sweep.times_s * 1e3, sweep.ringing_m * MICRO, color="#0072B2", linewidth=1.2)
        panel.axhline(worst, color="#D55E00", linestyle=(0, (1, 1.5)), linewidth=1.2)
        over = f", {sweep.over_level:.0%} over the level" if sweep.over_level > 1e-9 else ""
        panel.set_title(f"{sweep.name}{over}")
    if twin is not None:
        panels[0].plot(twin[0] * 1e3, twin[1] * MICRO, "o", color="black", mfc="none")
    for panel in panels[len(sweeps) :]:
        panel.set_visible(False)
    figure.supxlabel("beam broken, ms after the move began (dotted: worst unshaped)")
    figure.supylabel("frame rings then, um")
    return figure


_PLACES_IN_ROW = 4
_INCH = 1.3  # length of one unit of height
_PAGE = 7.0  # units: a page of paper
_TOP = 0.65  # distance of place 0 from the upper edge
_SMALL, _PLAIN = 7.0, 8.0  # points
_LINE = 1.2 * _SMALL / 72.0 / _INCH  # units
_HALF_BAR, _LABEL, _OUTPUTS, _GAP = 0.14, 0.18, 0.2, 0.06
"""Half width of a bar; offsets of its label and of a place's outputs; gap between rows."""
_BREAK = "#B00000"


@dataclass(frozen=True, slots=True)
class _Bar:
    """A place of the net and the condition of its transition.

    ``then`` names the target if the transition leads back. ``opened`` is the place that lets a
    cylinder creep to the end switch for which this place waits; None without creep.
    """

    place: NetPlace
    label: str
    then: str = ""
    opened: NetPlace | None = None

    @property
    def lines(self) -> tuple[str, ...]:
        """Texts of the outputs that are on, and of further outputs that a creep turns on."""
        if self.opened is None:
            return self.place.on
        opened_outputs = [name for name in self.opened.on if name not in self.place.on]
        return (*self.place.on, f"creeps by {self.opened.number}:", *opened_outputs)


@dataclass(frozen=True, slots=True)
class _Row:
    """Bars side by side; ``step`` is empty if the row above already shows the name of the step."""

    step: str
    bars: Sequence[_Bar]

    @property
    def above(self) -> float:
        """Height of the labels above its places."""
        return _LABEL + _LINE * max(bar.label.count("\n") + 1 for bar in self.bars) + _GAP

    @property
    def below(self) -> float:
        """Height of the outputs below its places."""
        return _OUTPUTS + _LINE * max(len(bar.lines) for bar in self.bars) + _GAP


def petri_figures(scheduled: Scheduled) -> list[Figure]:
    """Draw the net: place 0, then rows of places for each step, with bars for transitions.

    The places of homing, if the machine has it, follow the cycle. The label of a bar is the time of
    the place before it, or the awaited input and its timeout. The dashed line beside the rows is
    the transition from every place back to place 0. A figure has the height of a page; a long
    schedule has several.
    """
    net = petri_net(scheduled)
    home = _home(scheduled, len(net.places), net.scan_ms)
    bars = _bars(net.places, "back to 0, or to 1\nif continuous") + _bars(home, "back to 0")
    begins = f"home leads to {home[0].number}, and then start to 1" if home else "start leads to 1"
    pages: list[list[_Row]] = []
    height_used = _PAGE
    for step in dict.fromkeys(bar.place.step for bar in bars):
        step_bars = [bar for bar in bars if bar.place.step == step]
        for first in range(0, len(step_bars), _PLACES_IN_ROW):
            row = _Row("" if first else step, step_bars[first : first + _PLACES_IN_ROW])
            if height_used + row.above + row.below > _PAGE:
                pages.append([])
                height_used, row = _TOP, replace(row, step=step)
            pages[-1].append(row)
            height_used += row.above + row.below
    return [_page(rows, begins) for rows in pages]


def _home(scheduled: Scheduled, after: int, scan_ms: int) -> tuple[NetPlace, ...]:
    """Return the places of homing; none if a cylinder has no switch at its start."""
    try:
        return home_places(scheduled, after, scan_ms)
    except PlanError:
        return ()  # ``compile`` refuses such a machine with a reason


def _bars(places: Sequence[NetPlace], then: str) -> list[_Bar]:
    bars, passed_ms = list[_Bar](), 0
    for place in places:
        if place.opens:
            bars[-1] = replace(bars[-1], opened=place)
        elif place.wait is None:
            bars.append(_Bar(place, f"{place.due_ms - passed_ms} ms"))
            passed_ms = place.due_ms
        else:
            name, value = place.wait
            late_s = (place.due_ms - passed_ms) / 1000.0
            bars.append(
                _Bar(place, f"{name if value else f'not {name}'}\n(at most {late_s:.3g} s)")
            )
            passed_ms = 0
    return [*bars[:-1], *(replace(last, then=then) for last in bars[-1:])]


def _page(rows: Sequence[_Row], begins: str) -> Figure:
    height = _TOP + sum(row.above + row.below for row in rows)
    figure, panel = new_figure((7.2, _INCH * height))
    _place(panel, 0, 0, "0", "white")
    panel.text(0.25, 0.0, f"every output off; {begins}", va="center", fontsize=_PLAIN)
    row_height = 0.4 - _TOP
    for row in rows:
        row_height -= row.above
        panel.text(
            -0.75, row_height, row.step, ha="right", va="center", weight="bold", fontsize=_PLAIN
        )
        for column, bar in enumerate(row.bars):
            place = bar.place
            face = "white" if place.wait is None else "#E8E8E8"
            _place(panel, column, row_height, str(place.number), face)
            panel.plot(
                [column + 0.5] * 2,
                [row_height - _HALF_BAR, row_height + _HALF_BAR],
                "k-",
                linewidth=2.4,
            )
            panel.annotate("", (column + 0.8, row_height), (column + 0.16, row_height), zorder=1,
                           arrowprops={"arrowstyle": "->", "linewidth": 0.9})  # fmt: skip
            panel.text(column + 0.5, row_height + _LABEL, bar.label, ha="center", va="bottom",
                       fontsize=_SMALL)  # fmt: skip
            if bar.then:
                panel.text(column + 0.85, row_height, bar.then, va="center", fontsize=_SMALL)
            panel.text(column, row_height - _OUTPUTS, "\n".join(bar.lines), ha="center", va="top",
                       fontsize=_SMALL)  # fmt: skip
        _arc(panel, [(-0.16, row_height), (-0.55, row_height)])
        last_row_height, row_height = row_height, row_height - row.below
    # One line for all rows: dashed lines drawn over each other would look solid.
    _arc(panel, [(-0.55, last_row_height), (-0.55, 0.0)])
    _arc(panel, [(-0.55, 0.0), (-0.17, 0.0)], arrow=True)
    panel.text(-0.62, 0.0, "any fault\nat any place", ha="right", va="center", fontsize=_SMALL,
               color=_BREAK)  # fmt: skip
    panel.set_xlim(-1.75, _PLACES_IN_ROW + 0.55)
    panel.set_ylim(0.4 - height, 0.4)
    panel.set_axis_off()
    return figure


def _place(panel: Axes, column: float, height: float, text: str, face: str) -> None:
    panel.plot(column, height, "o", markersize=18, mfc=face, mec="black", zorder=3)
    panel.text(column, height, text, ha="center", va="center", zorder=4, fontsize=_PLAIN)


def _arc(panel: Axes, points: Sequence[tuple[float, float]], arrow: bool = False) -> None:
    if arrow:
        panel.annotate("", points[-1], points[0], zorder=1, arrowprops={
            "arrowstyle": "->", "linewidth": 1.0, "linestyle": "--", "color": _BREAK,
        })  # fmt: skip
        return
    columns, heights = zip(*points, strict=True)
    panel.plot(columns, heights, linestyle="--", linewidth=0.8, color=_BREAK, zorder=1)


_DRAWN = ("residual_vibration",)
_CAPTIONS = {
    "residual": "Ringing of the frame once each step has brought its cylinder to rest"
    "{beside}; dotted: the limit.",
    "cycle": "Pistons, and outputs that are on, over the cycle; dotted lines part the steps.",
    "frame": "The frame over the cycle{beside}.",
    "broken-beam": "A beam of the light grid is broken at each instant of the longest move and all "
    "valves shut: the ringing after that. First the move as scheduled, with simulated runs as "
    "circles at the scans that shut the valves; then every kind of shaper, made for "
    "the machine's own mode.",
    "petri-net": "The sequence that the PLC program runs, a Petri net with one token: places "
    "numbered as in its text, below them the outputs that are on. A bar lets the token pass after "
    "the time of its own place, or when its input comes; grey places wait for an input, and one "
    "that does not come in time is a fault. The places of homing bring every cylinder back from "
    "wherever it stands. Below a place that waits for an end switch stands the place to which the "
    "token goes and from which it returns while a cylinder creeps, with the outputs that it opens. "
    "The program's own times are sums of these, from the last input "
    "that was waited for. The dashed line holds for every place: a broken "
    "beam, a missing enable, a late scan or an implausible contact return the token to "
    "place 0, everything off.",
}


def write_switching(studied: ReportData, folder: Path, tables: Sequence[Printed] = ()) -> Path:
    """Write the report of a proof into ``folder``; return the path of the HTML page.

    ``tables`` are from the search that found the job; they follow the tables of the proof.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    proof, unshaped = studied.proof, studied.unshaped
    plan = proof.plan
    shaper = plan.options.get("shaper")
    header, rows = verdict_rows(proof.verdict, every_axis=False)
    shaper_text = shaper_words(plan) if shaper is None else f"shaper {shaper}"
    steps = [_step_table(proof, shaper_text)]
    if unshaped is not None:
        steps.append(_step_table(unshaped, "without a shaper"))
    run = drawn_run(proof, _DRAWN)
    with figure_style():
        figures = {
            "residual": residual_figure(proof, unshaped),
            "frame": frame_figure(proof, run.recording, unshaped),
            "cycle": cycle_figure(proof, run.recording),
        }
        if studied.beam is not None:
            beam = studied.beam
            twin = beam.instants_s, beam.simulated_m
            figures["broken-beam"] = break_figure(beam.sweeps, twin)
        captions = dict(_CAPTIONS)
        comparison_text = "" if unshaped is None else ", as planned and without a shaper"
        for name in ("residual", "frame"):
            captions[name] = captions[name].format(beside=comparison_text)
        for name in ("frame", "cycle"):
            captions[name] += run.words(proof)
        net = plan.scheduled.one_cycle
        for number, figure in enumerate(petri_figures(net), start=1):
            name = "petri-net" if number == 1 else f"petri-net-{number}"
            figures[name] = figure
            captions[name] = _CAPTIONS["petri-net"] if number == 1 else "The sequence, continued."
        document = Document(
            title=f"{plan.job.name} on {plan.machine.name}",
            subtitle="; ".join(
                [
                    plan.machine.title,
                    shaper_text,
                    *filter(None, [production(proof)]),
                    *(f"{axis} {words}" for axis, words in shaping_rows(plan)),
                ]
            ),
            verdicts=[(closing(proof.verdict), proof.verdict.passed)],
            warnings=grouped(warnings_of(proof)),
            tables=[
                Table(title="Criteria", header=header, rows=rows),
                *changes(proof.verdict),
                *steps,
                *(Table(title=t, header=h, rows=r) for t, h, r in tables),
            ],
            figures=figures,
            captions=captions,
            facts=_facts(proof),
        )
        return write_document(document, folder, "report")


def write_switching_comparison(found: Comparison, folder: Path, tables: Sequence[Printed]) -> Path:
    """Write the report of a comparison of shapers; return the path of the HTML page."""
    first = found.proofs[0].plan
    all_passed = all(proof.verdict.passed for proof in found.proofs)
    names = [proof.plan.options.get("shaper", "none") for proof in found.proofs]
    with figure_style():
        figures = {"residual": residuals_figure(found.proofs)}
        captions = {
            "residual": "What each step leaves ringing, shaper by shaper; dotted: the limit."
        }
        for name, proof in zip(names, found.proofs, strict=True):
            stem = "cycle-" + name.replace(":", "-").replace("*", "-by-").replace(" ", "")
            run = drawn_run(proof, _DRAWN)
            figures[stem] = cycle_figure(proof, run.recording)
            captions[stem] = f"Shaper {name}: pistons and outputs over the cycle.{run.words(proof)}"
        document = Document(
            title=f"{first.job.name} on {first.machine.name}: comparison",
            subtitle=first.machine.title,
            verdicts=[(closing_of_all([proof.verdict for proof in found.proofs]), all_passed)],
            warnings=[
                *(f"{name} is refused: {why}" for name, why in found.refused),
                *grouped(warnings_of_all(found.proofs)),
            ],
            tables=[Table(title=t, header=h, rows=r) for t, h, r in tables],
            figures=figures,
            captions=captions,
            facts=[
                *_facts(found.proofs[0]),
                *((f"case {n}", f"shaper {name}") for n, name in enumerate(names, start=1)),
            ],
        )
        return write_document(document, folder, "comparison")


def _step_table(proof: Proof, how: str) -> Table:
    header, rows = step_rows(proof.verdict)
    return Table(title=f"Step by step, {how}", header=header, rows=rows)


def _facts(proof: Proof) -> list[tuple[str, str]]:
    plan = proof.plan
    return [
        *origin_facts(plan.machine, plan.job),
        ("simulated", "yes" if proof.verdict.simulated else "no, recorded live"),
        *run_facts(proof.recording),
        ("scan", f"{float(plan.commands.clock.period_s) * 1e3:g} ms"),
        ("schedule", f"{plan.duration_s:g} s, {len(plan.scheduled.commands.ticks)} switchings"),
        *((name.lower(), words) for name, words in creep_rows(plan)),
        *((f"cylinder {axis}", words) for axis, words in shaping_rows(plan)),
        *options_facts(plan.options, plan.machine, OF_AXES),
    ]
