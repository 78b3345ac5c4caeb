"""The pages of a report and what stays apart on them, also when printed in grey."""

from __future__ import annotations

import io
import re
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread as read_png
from matplotlib.transforms import Bbox

from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.options import Options, parse_feed
from threadline.pipeline import plan_job, prove_plan
from threadline.plant.analysis import analyse_axis
from threadline.report.analysis import _figures
from threadline.report.document import Document, Table, _pages, _with_caption, write_document
from threadline.report.figures import error_figure
from threadline.report.mismatch import draw_mismatch
from threadline.report.proof import write_comparison
from threadline.report.style import AXES, LIMIT, figure_style
from threadline.report.traces import collect
from threadline.search import Fastest, Interval, Mismatch, compare
from threadline.verdict import Verdict, load_spec

HEADER = ("criterion", "axis", "line", "note")
ROW = ("contour_error", "X", "23 (pass 12)", "programmed point missed")


def pages_of(*lengths: int) -> list:
    tables = [Table(title=f"table {n}", header=HEADER, rows=[ROW] * n) for n in lengths]
    document = Document(
        title="a",
        subtitle="b",
        verdicts=[("IN SPEC", True)],
        tables=tables,
        figures={},
        captions={},
        facts=[("key", "value")] * 8,
    )
    with figure_style():
        return _pages(document)


def test_short_tables_share_a_page_and_long_ones_go_on() -> None:
    assert len(pages_of(3, 4)) == 1
    pages = pages_of(3, 55, 2)
    assert len(pages) == 3
    printed = [text for page in pages for text in page.texts]
    assert sum(text.get_text() == ROW[0] for text in printed) == 60
    assert all(0.04 < text.get_position()[1] <= 0.95 for text in printed)


def test_line_and_note_stand_apart() -> None:
    page = pages_of(3)[0]
    page.canvas.draw()
    boxes = {text.get_text(): text.get_window_extent() for text in page.texts}
    assert boxes[ROW[2]].x1 + 3 < boxes[ROW[3]].x0


def test_figures_on_one_page_keep_their_own_identifiers_and_text_is_text(tmp_path) -> None:
    """Two drawings with clipped lines: every identifier is there once, every reference has one."""
    figures = {}
    with figure_style():
        for name in ("one", "two"):
            figures[name] = Figure()
            figures[name].add_subplot().plot([0, 1], [0, 1])
        document = Document(
            title="a <b> & c",
            subtitle="b",
            verdicts=[("IN SPEC", True)],
            tables=[],
            figures=figures,
            captions={"one": "first", "two": "second"},
            facts=[],
            warnings=["mind the <gap>"],
        )
        page = write_document(document, tmp_path / "report", "r").read_text(encoding="utf-8")
        printed = [text.get_text() for text in _pages(document)[0].texts]
    names = re.findall(r'\bid="([^"]+)"', page)
    wanted = re.findall(r'(?:href="|url\()#([^")]+)', page)
    assert len(names) == len(set(names)) > 10
    assert len(wanted) > 4
    assert set(wanted) <= set(names)
    assert "a &lt;b&gt; &amp; c" in page
    assert "mind the &lt;gap&gt;" in page
    assert any("warning: mind the <gap>" in text for text in printed)


def test_the_speeds_over_tolerances_are_a_line_for_each_mass() -> None:
    """Nine cells in any order; no speed at all is drawn as 0."""
    nothing = Verdict(results=(), simulated=True)
    cells = []
    for mass in (1.0, -1.0, 0.0):
        for stiffness in (0.0, 1.0, -1.0):
            high = 50.0 + 10.0 * stiffness - mass
            best = (Interval(low=1.0, high=high),) if (mass, stiffness) != (1.0, -1.0) else ()
            found = Fastest(intervals=best, limited_by="range", verdict=nothing, tried=2)
            cells.append(Mismatch(mass=mass, stiffness=stiffness, found=found))
    (panel,) = draw_mismatch(cells, "a title").axes
    drawn = {line.get_label(): line.get_xydata().tolist() for line in panel.lines}
    assert drawn == {
        "loads: lower end": [[-1.0, 41.0], [0.0, 51.0], [1.0, 61.0]],
        "loads: as in the file": [[-1.0, 40.0], [0.0, 50.0], [1.0, 60.0]],
        "loads: upper end": [[-1.0, 0.0], [0.0, 49.0], [1.0, 59.0]],
    }


def test_a_picture_without_any_speed_says_so() -> None:
    nothing = Verdict(results=(), simulated=True)
    found = Fastest(intervals=(), limited_by="stitch_length_error", verdict=nothing, tried=2)
    cells = [Mismatch(mass=m, stiffness=k, found=found) for m in (-1.0, 1.0) for k in (-1.0, 1.0)]
    (panel,) = draw_mismatch(cells, "a title").axes
    (text,) = panel.texts
    assert text.get_text() == (
        "no needle speed is in spec on any of the 4 machines:\nstitch length error fails at all"
    )


def test_captions_stand_below_the_figures_of_the_pdf_and_leave_them_as_they_are() -> None:
    """200 letters of 8 points take more than one line of 4 inches; the page grows by them."""
    with figure_style():
        figure = Figure(figsize=(4.0, 3.0))
        figure.add_subplot().bar([0], [1])
        figure.canvas.draw()
        before = figure.axes[0].get_position().bounds
        caption = "what it shows and how to read it, " * 6
        page = _with_caption(figure, caption)
        figure.canvas.draw()
        assert figure.axes[0].get_position().bounds == before
        (text,) = figure.texts
        box = text.get_window_extent().transformed(figure.dpi_scale_trans.inverted())
        bare = _with_caption(Figure(figsize=(4.0, 3.0)), None)
    assert " ".join(text.get_text().split()) == caption.strip()
    assert text.get_text().count("\n") >= 2
    assert (page.x0, page.x1, page.y1) == (0.0, 4.0, 3.0)
    assert page.y0 < box.y0 < box.y1 <= 0.0 < box.x0 < box.x1 < 4.0
    assert bare.bounds == (0.0, 0.0, 4.0, 3.0)


def test_a_legend_outside_the_panels_stays_above_the_caption() -> None:
    """In the picture that is printed: nothing red below the figure, and as much as there was."""

    def red(figure: Figure, page: Bbox | None) -> tuple[np.ndarray, int]:
        made = io.BytesIO()
        figure.savefig(made, format="png", dpi=100, bbox_inches=page)
        pixels = read_png(io.BytesIO(made.getvalue()))
        return np.flatnonzero((pixels[..., 0] > pixels[..., 1] + 0.5).any(axis=1)), len(pixels)

    with figure_style():
        figure = Figure(figsize=(4.0, 3.0))
        figure.add_subplot().plot([0, 1], [0, 1], color="red", label="a")
        figure.legend(loc="outside lower center")
        before, _ = red(figure, None)
        page = _with_caption(figure, "what it shows")
        after, rows = red(figure, page)
    assert 300 < rows == pytest.approx(100 * page.height, abs=1)
    assert before.max() > 270  # the legend is the lowest thing
    assert abs(after.min() - before.min()) <= 1 and abs(after.max() - before.max()) <= 1


def test_grid_lines_run_behind_bars() -> None:
    with figure_style():
        assert Figure().add_subplot().get_axisbelow() is True


def test_no_axis_looks_like_a_limit_in_grey() -> None:
    """The limit is dotted; no axis is, and none has another's dashes."""
    dots = LIMIT["linestyle"][1]
    dashes = [style["linestyle"] for style in AXES]
    assert dots[0] <= 1
    assert all(dash == "-" or dash[1][0] > 2 for dash in dashes)
    assert len({str((style["linestyle"], style["linewidth"])) for style in AXES}) == len(AXES)


def test_the_labels_of_many_bars_do_not_touch(tmp_path) -> None:
    """Every criterion of three axes with a limit."""
    machine = load_machine("lathe-winder")
    job = tmp_path / "a.prg"
    job.write_text("G91 G1 X 5 Y 3 A 40 F 600\nX -5 Y -3 A -40\nM30\n")
    plan = plan_job(read_job(job, machine), machine, Options())
    proof = prove_plan(plan, load_spec(None, machine))
    with figure_style():
        figure = error_figure(proof, collect(proof))
        figure.canvas.draw()
    labels = [label.get_window_extent() for label in figure.axes[2].get_yticklabels()]
    assert len(labels) >= 12
    assert all(abs(a.y0 - b.y0) >= a.height for a, b in pairwise(labels))


def test_a_comparison_lists_every_case_it_was_made_from(tmp_path) -> None:
    machine = load_machine("lathe-winder")
    job = tmp_path / "a.prg"
    job.write_text("G91 G1 X 5 F 600\nX -5\nM30\n")
    read, spec = read_job(job, machine), load_spec(None, machine)
    feeds = [None, parse_feed("20 count/tick")]
    found = compare(read, machine, spec, ["linear", "auto"], feeds, Options(), with_fastest=False)
    page = write_comparison(found, tmp_path / "report", []).read_text(encoding="utf-8")
    facts = dict(re.findall(r"<tr><td>([^<]*)</td><td class=\"left\"><code>([^<]*)<", page))
    cases = [facts[f"case {n}"].split(";")[0] for n in (1, 2, 3, 4)]
    assert cases == [
        f"{name}, feed {feed}"
        for name in ("linear", "auto")
        for feed in ("programmed", "20.0 count/tick")
    ]
    assert not {"feed", "interpolation"} & set(facts)
    assert facts["tolerance"] == "0.0001 m"


def test_every_line_of_the_bode_plot_is_named_and_the_locus_is_free() -> None:
    analysis = analyse_axis(load_machine("stitcher"), "X")
    with figure_style():
        figures = {name: figure for name, (figure, _) in _figures(analysis, None).items()}
    size, turn = figures["bode"].axes
    named = [t.get_text() for panel in (size, turn) for t in panel.get_legend().get_texts()]
    assert "phase crossover: gain margin" in named
    assert "gain crossover: phase margin" in named
    assert figures["locus"].axes[0].get_legend() is None
    assert figures["locus"].legends
