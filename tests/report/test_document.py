"""The pages of a report: parts that must stay apart, even when printed in grey."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import pairwise

import pytest
from matplotlib import image as plt_image
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from threadline.cli.search_text import show_mismatch
from threadline.dynamics.analysis import analyse_axis
from threadline.files import Recording
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, prove_plan
from threadline.report.analysis import axis_figures
from threadline.report.document import Document, Table, changes, run_facts
from threadline.report.figures import criteria_figure, error_figure
from threadline.report.proof import write_comparison
from threadline.report.publish import write_document
from threadline.report.searches import draw_mismatch
from threadline.report.style import AXES, LIMIT, figure_style, headed
from threadline.report.traces import collect
from threadline.search import Mismatch, compare
from threadline.search.feed_ranges import Interval
from threadline.search.mismatch import CYCLE, NEEDLE
from threadline.verdict import Status, Verdict, load_spec
from threadline.verdict.rendering import closing_of_all
from threadline.verdict.types import Change, Disturbance


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
    names = re.findall(r'\bid="([^"]+)"', page)
    expected = re.findall(r'(?:href="|url\()#([^")]+)', page)
    assert len(names) == len(set(names)) > 10
    assert len(expected) > 4
    assert set(expected) <= set(names)
    assert "a &lt;b&gt; &amp; c" in page
    assert "mind the &lt;gap&gt;" in page


def test_a_picture_that_leaves_its_page_says_what_it_is_of(tmp_path) -> None:
    """Job, machine and verdict stand above the picture in its file; the page has them once."""
    with figure_style():
        figure = Figure(figsize=(4.0, 2.0))
        figure.add_subplot().plot([0, 1], [0, 1], label="x on a winder")
        figure.legend()
        width, height = figure.get_size_inches()
        document = Document(
            title="x.prg on winder",
            subtitle="a winder",
            verdicts=[("IN SPEC (nominal: 1 run)", True)],
            tables=[],
            figures={"one": figure},
            captions={},
            facts=[],
        )
        with headed(figure, ["x.prg on winder: $a$", "long " * 30]) as area:
            texts = [text.get_text() for text in figure.texts]
        page = write_document(document, tmp_path, "r").read_text(encoding="utf-8")
    assert texts[0].startswith("x.prg on winder: $a$\nlong long") and texts[0].count("\n") == 3
    assert area.width == width and area.height > height and not figure.texts
    pixels = plt_image.imread(tmp_path / "r-one.png").shape
    drawn = re.search(r'viewBox="0 0 (\S+) (\S+)"', (tmp_path / "r-one.svg").read_text())
    assert drawn is not None
    for across, up in ((pixels[1], pixels[0]), map(float, drawn.groups())):
        assert up / across == pytest.approx((height + 0.4) / width, rel=0.01)
    inner = re.search(r'height="(\S+)pt" viewBox="0 (\S+) (\S+) (\S+)"', page)
    assert inner is not None
    assert float(inner[4]) / float(inner[3]) == pytest.approx(height / width, rel=1e-6)
    assert inner[1] == inner[4] and float(inner[2]) == pytest.approx(72 * 0.4)
    single = (tmp_path / "r-one.svg").read_text()
    assert 'id="head"' in single and "IN SPEC" in single
    in_page = page[page.index("<svg") : page.index("</svg>")]
    assert "head" not in in_page and "IN SPEC" not in in_page
    # No letter of the figure was defined in the lines above it, which the page does not have.
    assert set(re.findall(r'(?:href="|url\()#([^")]+)', in_page)) <= set(
        re.findall(r'id="([^"]+)"', in_page)
    )


def test_the_parts_of_a_figure_are_placed_once_for_all_its_files(
    tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its files show the same, with room for the space between its parts."""
    placed: list[Figure] = []
    execute = ConstrainedLayoutEngine.execute
    monkeypatch.setattr(
        ConstrainedLayoutEngine, "execute", lambda s, fig: (placed.append(fig), execute(s, fig))
    )
    with figure_style():
        figure = Figure(figsize=(7.2, 3.0))
        above, below = figure.subplots(2, 1)
        above.set_xlabel("between")
        document = Document(
            title="job", subtitle="", verdicts=[("IN SPEC", True)], tables=[], captions={},
            figures={"a": figure}, facts=[],
        )  # fmt: skip
        write_document(document, tmp_path, "r")
    assert placed == [figure]
    gap_in = 3.0 * (above.get_position().y0 - below.get_position().y1)
    assert gap_in > 0.3  # 0.21 without placement: too little for numbers and their label


def test_the_printer_gets_every_column_and_no_scroll_bar(tmp_path) -> None:
    """The rules by which a wide table scrolls on a screen are undone for printers."""
    document = Document(
        title='say "a"</style>',
        subtitle="b",
        verdicts=[("OUT OF SPEC (nominal: 1 run)", False)],
        tables=[
            Table(
                title="t",
                header=("a", "note"),
                rows=[("x", "a note that may be broken into lines")],
            )
        ],
        figures={},
        captions={},
        facts=[],
    )
    page = write_document(document, tmp_path, "r").read_text(encoding="utf-8")
    sheet = page.partition("<style>")[2].partition("</style>")[0]
    screen, _, rest = sheet.partition("@media print {")
    printer, _, paper = rest.partition("@page {")
    assert "overflow-x: auto" in screen and "white-space: nowrap" in screen
    assert ".scroll { overflow: visible; }" in printer
    assert "th, td { white-space: normal;" in printer
    assert "h1, h2 { break-after: avoid; }" in printer
    assert "thead { display: table-header-group; }" in printer
    assert "auto" not in printer
    assert "td.short { white-space: nowrap; }" in printer
    assert re.findall(r'class="([^"]*)">([^<]*)</td>', page)[:2] == [
        ("left short", "x"),
        ("left note", "a note that may be broken into lines"),
    ]
    assert "A4 portrait" in paper
    assert '"OUT OF SPEC (nominal: 1 run)"' in paper
    assert 'counter(page) " of " counter(pages)' in paper
    assert "say \\22 a\\22 \\3c /style\\3e " in paper


def cell(mass: float, stiffness: float, best: float | None, limited_by: str) -> Mismatch:
    return Mismatch(mass=mass, stiffness=stiffness, best=best, intervals=(), limited_by=limited_by)


def test_the_speeds_over_tolerances_are_a_line_for_each_mass() -> None:
    """Nine cells in any order; no speed at all is drawn as 0."""
    cells = []
    for mass in (1.0, -1.0, 0.0):
        for stiffness in (0.0, 1.0, -1.0):
            high = 50.0 + 10.0 * stiffness - mass
            best = high if (mass, stiffness) != (1.0, -1.0) else None
            cells.append(cell(mass, stiffness, best, "range"))
    (panel,) = draw_mismatch(cells, "a title", NEEDLE).axes
    drawn = {line.get_label(): line.get_xydata().tolist() for line in panel.lines}
    assert drawn == {
        "loads: lower end": [[-1.0, 41.0], [0.0, 51.0], [1.0, 61.0]],
        "loads: as in the file": [[-1.0, 40.0], [0.0, 50.0], [1.0, 60.0]],
        "loads: upper end": [[-1.0, 0.0], [0.0, 49.0], [1.0, 59.0]],
    }
    # If no cycle is in spec, its line has a gap, because the shortest is not 0 s.
    (panel,) = draw_mismatch(cells, "a title", CYCLE).axes
    heights = {line.get_label(): line.get_ydata()[0] for line in panel.lines}
    assert heights["loads: lower end"] == 41.0
    assert math.isnan(heights["loads: upper end"])
    assert panel.get_ylabel() == "shortest in spec, s"


def test_a_gap_beneath_the_fastest_is_drawn_and_told(capsys: pytest.CaptureFixture[str]) -> None:
    """The end of each slower range is hollow; all ranges in spec stand beside the fastest."""
    ends = ((67.93, 70.58), (20.0, 57.63), (12.0, 12.0))
    ranges = tuple(Interval(low=low, high=high, isolated=low == high) for low, high in ends)
    cells = [replace(cell(0.0, 1.0, 70.58, "x"), intervals=ranges), cell(0.0, 0.0, 73.0, "x")]
    (panel,) = draw_mismatch(cells, "a title", NEEDLE).axes
    (hollow,) = (
        line for line in panel.lines if line.get_mfc() == "white" and len(line.get_xdata())
    )
    assert hollow.get_xydata().tolist() == [[1.0, 57.63], [1.0, 12.0]]
    show_mismatch(cells, "a title", NEEDLE)
    assert "12.00, 20.00 to 57.63, 67.93 to 70.58" in capsys.readouterr().out


def test_a_picture_without_any_speed_says_so() -> None:
    ends = [(m, k) for m in (-1.0, 1.0) for k in (-1.0, 1.0)]
    cells = [cell(m, k, None, "stitch_length_error") for m, k in ends]
    (panel,) = draw_mismatch(cells, "a title", NEEDLE).axes
    (text,) = panel.texts
    assert text.get_text() == (
        "no needle speed is in spec on any of the 4 machines:\nstitch length error fails"
    )
    cells[0] = cell(-1.0, -1.0, None, "seam_error")
    (panel,) = draw_mismatch(cells, "a title", NEEDLE).axes
    assert panel.texts[0].get_text().endswith("\nseam error and stitch length error fail")


def test_grid_lines_run_behind_bars() -> None:
    with figure_style():
        assert Figure().add_subplot().get_axisbelow() is True


def test_no_axis_looks_like_a_limit_in_grey() -> None:
    """The limit is dotted; no axis is, and no two axes have the same dashes."""
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


def test_a_bar_that_passed_is_within_its_limit(tmp_path) -> None:
    """A plan may exceed a limit by 0.1 % between samples; otherwise it would show 101 %."""
    machine = load_machine("lathe-winder")
    job = tmp_path / "a.prg"
    job.write_text("G91 G1 X 5 F 600\nX -5\nM30\n")
    proof = prove_plan(
        plan_job(read_job(job, machine), machine, Options()), load_spec(None, machine)
    )
    row = next(r for r in proof.verdict.results if r.name == "velocity" and r.axis == "X")
    over = [
        replace(row, measured=1.0004 * row.limit, status=status)
        for status in (Status.PASSED, Status.FAILED)
    ]
    verdict = replace(proof.verdict, results=tuple(over))
    (panel,) = criteria_figure(replace(proof, verdict=verdict)).axes
    assert [text.get_text() for text in panel.texts] == ["100 %", "101 %"]


def test_a_comparison_lists_every_case_it_was_made_from(tmp_path) -> None:
    machine = load_machine("lathe-winder")
    job = tmp_path / "a.prg"
    job.write_text("G91 G1 X 5 F 600\nX -5\nM30\n")
    read, spec = read_job(job, machine), load_spec(None, machine)
    planned = [
        Options(interpolation=name, feed=feed)
        for name in ("linear", "auto")
        for feed in (None, parse_feed("20 count/tick"))
    ]
    found = compare(read, machine, spec, planned, with_fastest=False)
    page = write_comparison(found, tmp_path / "report", []).read_text(encoding="utf-8")
    facts = dict(
        re.findall(
            r"<tr><td class=\"left\">([^<]*)</td><td class=\"left fact\"><code>([^<]*)<", page
        )
    )
    cases = [facts[f"case {n}"].split(";")[0] for n in (1, 2, 3, 4)]
    assert cases == [
        f"{name}, feed {feed}"
        for name in ("linear", "auto")
        for feed in ("programmed", "20.0 count/tick")
    ]
    assert not {"feed", "interpolation"} & set(facts)
    assert facts["tolerance"] == "0.1 mm"
    # Each drawing has a picture of its own, even if the feed in its name has a point.
    pictures = {file.stem for file in (tmp_path / "report").glob("*.png")}
    assert len(pictures) == page.count("<figure") >= 4
    assert any(name.startswith("comparison-auto-20.0count-per-tick-") for name in pictures)


def test_a_case_of_limits_alone_is_told_without_runs() -> None:
    kept = Verdict(results=(), simulated=True, limits_alone=True)
    message = closing_of_all([kept, kept])
    assert message.endswith("placement is not proven, the machine file has no dynamics)")


def test_every_line_of_the_bode_plot_is_named_and_the_locus_is_free() -> None:
    analysis = analyse_axis(load_machine("stitcher"), "X")
    with figure_style():
        figures = {name: figure for name, (figure, _) in axis_figures(analysis, None).items()}
    size, turn = figures["bode"].axes
    named = [t.get_text() for panel in (size, turn) for t in panel.get_legend().get_texts()]
    assert "phase crossover: gain margin" in named
    assert "gain crossover: phase margin" in named
    assert figures["locus"].axes[0].get_legend() is None
    assert figures["locus"].legends


def test_a_run_with_an_override_tells_its_reason() -> None:
    """The recording's own remarks on a run stand among the facts of its report."""
    run = Recording(
        channels=(), blocks=(), job_sha256="", machine_sha256="", simulated=False,
        origin={"link": "sim", "override": "trial of the eye", "feed": "programmed"},
    )  # fmt: skip
    assert run_facts(run) == [("link", "sim"), ("override", "trial of the eye")]
    assert run_facts(replace(run, origin={})) == []


def test_a_report_names_what_changed_the_motion() -> None:
    """With time and line; without any such event there is no table."""
    cut = Disturbance(
        change=Change.LIMIT_SWITCH, text="the limit switch x_high of X cut the supply of drives.x",
        time_s=15.34, job_line=2, axis="X",
    )  # fmt: skip
    (table,) = changes(Verdict(results=(), simulated=True, disturbances=(cut,)))
    assert table.title == "What changed the motion"
    assert [list(row) for row in table.rows] == [[cut.text, "15.340 s", "2", "-"]]
    assert changes(Verdict(results=(), simulated=True)) == []
