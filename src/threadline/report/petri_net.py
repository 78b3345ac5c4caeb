"""The Petri net of a schedule as figures of one page each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from threadline.errors import PlanError
from threadline.targets.plc_home import home_places
from threadline.targets.plc_net import NetPlace, petri_net
from threadline.targets.schedule import Scheduled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PLACES_IN_ROW = 4
_INCH = 1.3  # of the unit of heights
_PAGE = 7.0  # units: a page of paper
_TOP = 0.65  # place 0, from the upper edge
_SMALL, _PLAIN = 7.0, 8.0  # points
_LINE = 1.2 * _SMALL / 72.0 / _INCH  # units
_HALF_BAR, _LABEL, _OUTPUTS, _GAP = 0.14, 0.18, 0.2, 0.06
"""Half of a bar; where its label and the outputs of a place begin; what is left between rows."""
_BREAK = "#B00000"


@dataclass(frozen=True, slots=True)
class _Bar:
    """A place, and the condition of the transition after it; ``then`` where that leads back."""

    place: NetPlace
    label: str
    then: str = ""


@dataclass(frozen=True, slots=True)
class _Row:
    """Bars beside each other; ``step`` is empty where the row above has its name."""

    step: str
    bars: Sequence[_Bar]

    @property
    def above(self) -> float:
        """Height over its places that its labels need."""
        return _LABEL + _LINE * max(bar.label.count("\n") + 1 for bar in self.bars) + _GAP

    @property
    def below(self) -> float:
        """Height under its places that their outputs need."""
        return _OUTPUTS + _LINE * max(len(bar.place.on) for bar in self.bars) + _GAP


def petri_figures(scheduled: Scheduled) -> list[Figure]:
    """Draw the net: place 0, then rows of places for each step, bars for transitions.

    Behind the cycle come the places of the way home, where the machine has one.
    A bar is labelled with the time of the place before it, or with the input that is waited for and
    its timeout. The dashed line beside the rows is the transition from every place back to place 0.
    A figure is as high as a page of a report; a long schedule has several.
    """
    net = petri_net(scheduled)
    home = _home(scheduled, len(net.places), net.scan_ms)
    bars = _bars(net.places, "back to 0, or to 1\nif continuous") + _bars(home, "back to 0")
    begins = f"home leads to {home[0].number}, and then start to 1" if home else "start leads to 1"
    pages: list[list[_Row]] = []
    full = _PAGE
    for step in dict.fromkeys(bar.place.step for bar in bars):
        own = [bar for bar in bars if bar.place.step == step]
        for first in range(0, len(own), _PLACES_IN_ROW):
            row = _Row("" if first else step, own[first : first + _PLACES_IN_ROW])
            if full + row.above + row.below > _PAGE:
                pages.append([])
                full, row = _TOP, replace(row, step=step)
            pages[-1].append(row)
            full += row.above + row.below
    return [_page(rows, begins) for rows in pages]


def _home(scheduled: Scheduled, after: int, scan_ms: int) -> tuple[NetPlace, ...]:
    """Return the places of the way home; none where a cylinder has no switch at its start."""
    try:
        return home_places(scheduled, after, scan_ms)
    except PlanError:
        return ()  # ``compile`` refuses such a machine, and says why


def _bars(places: Sequence[NetPlace], then: str) -> list[_Bar]:
    bars, passed_ms = list[_Bar](), 0
    for place in places:
        if place.wait is None:
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
    from matplotlib.figure import Figure

    high = _TOP + sum(row.above + row.below for row in rows)
    figure = Figure(figsize=(7.2, _INCH * high))
    panel = figure.subplots()
    _place(panel, 0, 0, "0", "white")
    panel.text(0.25, 0.0, f"every output off; {begins}", va="center", fontsize=_PLAIN)
    at = 0.4 - _TOP
    for row in rows:
        at -= row.above
        panel.text(-0.75, at, row.step, ha="right", va="center", weight="bold", fontsize=_PLAIN)
        for column, bar in enumerate(row.bars):
            place = bar.place
            face = "white" if place.wait is None else "#E8E8E8"
            _place(panel, column, at, str(place.number), face)
            panel.plot([column + 0.5] * 2, [at - _HALF_BAR, at + _HALF_BAR], "k-", linewidth=2.4)
            panel.annotate("", (column + 0.8, at), (column + 0.16, at), zorder=1,
                           arrowprops={"arrowstyle": "->", "linewidth": 0.9})  # fmt: skip
            panel.text(column + 0.5, at + _LABEL, bar.label, ha="center", va="bottom",
                       fontsize=_SMALL)  # fmt: skip
            if bar.then:
                panel.text(column + 0.85, at, bar.then, va="center", fontsize=_SMALL)
            panel.text(column, at - _OUTPUTS, "\n".join(place.on), ha="center", va="top",
                       fontsize=_SMALL)  # fmt: skip
        _arc(panel, [(-0.16, at), (-0.55, at)])
        last, at = at, at - row.below
    # One line for all rows: a dashed one drawn again for each of them would look solid.
    _arc(panel, [(-0.55, last), (-0.55, 0.0)])
    _arc(panel, [(-0.55, 0.0), (-0.17, 0.0)], arrow=True)
    panel.text(-0.62, 0.0, "any fault\nat any place", ha="right", va="center", fontsize=_SMALL,
               color=_BREAK)  # fmt: skip
    panel.set_xlim(-1.75, _PLACES_IN_ROW + 0.55)
    panel.set_ylim(0.4 - high, 0.4)
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
    across, up = zip(*points, strict=True)
    panel.plot(across, up, linestyle="--", linewidth=0.8, color=_BREAK, zorder=1)
