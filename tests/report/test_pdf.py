"""The PDF of a report, read back by an independent library (pypdf)."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from pypdf import PageObject, PdfReader

from threadline.report.document import Document, Table
from threadline.report.figures import PROFILE_IN
from threadline.report.pdf import figure_page, write_pdf
from threadline.report.pdf_tables import columns_of
from threadline.report.style import figure_style

A4_PT = (210.0 / 25.4 * 72.0, 297.0 / 25.4 * 72.0)
VERDICT = "OUT OF SPEC (nominal: 1 run)"


def document(
    tables: Sequence[Table] = (), heights_in: Sequence[float] = (), title: str = "a.prg on winder"
) -> Document:
    figures = {}
    with figure_style():
        for number, height in enumerate(heights_in):
            figures[f"f{number}"] = Figure(figsize=(7.2, height))
            figures[f"f{number}"].add_subplot().set_title(f"Picture {number}")
    return Document(
        title=title,
        subtitle="what was asked",
        verdicts=[(VERDICT, False)],
        tables=tables,
        figures=figures,
        captions={name: f"Caption of {name}" for name in figures},
        facts=[("threadline", "0.1.0"), ("job sha256", "0123456789abcdef" * 4)],
        warnings=[f"warning number {n}" for n in range(9)],
    )


def written(what: Document, file: Path) -> list[PageObject]:
    with figure_style():
        write_pdf(what, file)
    return list(PdfReader(file).pages)


def words_at(page: PageObject) -> list[tuple[str, float, float]]:
    """Return each piece of text with its starting point, points from the lower left corner."""
    found: list[tuple[str, float, float]] = []

    def take(text: str, matrix: list[float], place: list[float], *_: object) -> None:
        if text.strip():
            x = place[4] * matrix[0] + place[5] * matrix[2] + matrix[4]
            y = place[4] * matrix[1] + place[5] * matrix[3] + matrix[5]
            found.append((text.strip(), x, y))

    page.extract_text(visitor_text=take)
    return found


def titles_at(page: PageObject) -> dict[str, float]:
    """Return the height of the title of each figure on a page, points from its lower edge."""
    found: dict[str, float] = {}
    drawn = re.findall(rb"q ([\d.]+) 0 0 [\d.]+ [\d.]+ ([\d.]+) cm (/\w+) Do Q", contents_of(page))
    for scale, foot_pt, name in drawn:
        form = page["/Resources"]["/XObject"][name.decode()]
        inside: list[tuple[str, float]] = []
        take = partial(_height, inside)
        page.extract_xform_text(form, visitor_text=take)
        for text, y_pt in inside:
            if text.startswith("Picture"):
                found[text] = float(foot_pt) + float(scale) * y_pt
    return found


def _height(into: list[tuple[str, float]], text: str, matrix: list[float], *_: object) -> None:
    into.append((text.strip(), matrix[5]))


def contents_of(page: PageObject) -> bytes:
    contents = page.get_contents()
    assert contents is not None
    return contents.get_data()


def rows_table(count: int, title: str = "Criteria") -> Table:
    header = ("criterion", "axis", "measured", "note")
    rows = [(f"measure_{n}", "X", f"{n} mm", "programmed point missed") for n in range(count)]
    return Table(title=title, header=header, rows=rows)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> list[PageObject]:
    tables = [rows_table(6), rows_table(140, "Step by step")]
    file = tmp_path_factory.mktemp("pdf") / "report.pdf"
    return written(document(tables, [3.0, 6.8, 15.0, 3.0]), file)


def test_every_page_is_upright_a4_with_its_verdict_and_number(pages: list[PageObject]) -> None:
    """A figure of 15 inches is higher than a page, and 140 rows are several."""
    assert len(pages) >= 6
    for number, page in enumerate(pages, start=1):
        box = [float(edge) for edge in page.mediabox]
        assert box == pytest.approx([0.0, 0.0, *A4_PT], abs=0.01)
        text = page.extract_text()
        assert VERDICT in text
        assert f"page {number} of {len(pages)}" in text
        assert "a.prg on winder" in text


def test_long_tables_go_on_under_their_header(pages: list[PageObject]) -> None:
    texts = [page.extract_text() for page in pages]
    everything = "\n".join(texts)
    for n in range(140):
        assert re.search(rf"\bmeasure_{n}\b", everything)
    holding = [text for text in texts if "measure_" in text]
    assert len(holding) >= 3
    assert all("criterion" in text for text in holding)


def test_headings_stand_with_what_they_head(pages: list[PageObject]) -> None:
    """The first figure and a row of the table are on the page of their heading."""
    texts = [page.extract_text() for page in pages]
    for heading, first in (
        ("Warnings", "warning number 0"),
        ("Criteria", "measure_0"),
        ("Step by step", "measure_4"),
        ("Figures", "Caption of f0"),
        ("What this was made from", "threadline"),
    ):
        (page,) = [text for text in texts if re.search(rf"^{heading}$", text, re.M)]
        assert first in page


@pytest.mark.parametrize("rows", range(20, 44))
def test_no_heading_is_left_at_the_foot_of_a_page(rows: int, tmp_path: Path) -> None:
    """Wherever the first table ends: the page of a heading has rows of its table below it."""
    tables = [
        rows_table(rows, "First"),
        Table(title="Second", header=("s", "t"), rows=[("u", "v")]),
    ]
    for page in written(document(tables), tmp_path / "r.pdf"):
        lines = page.extract_text().split("\n")
        for heading, below in (
            ("First", "criterion"),
            ("Second", "s"),
            ("What this", "threadline"),
        ):
            at = [n for n, line in enumerate(lines) if line.startswith(heading)]
            assert all(lines[n + 1].split()[0] == below for n in at)


def test_figures_stand_whole_on_their_page_above_their_caption(pages: list[PageObject]) -> None:
    """The figure of 15 inches is reduced, the others are as large as they were drawn."""
    for number in range(4):
        (page,) = [p for p in pages if f"Caption of f{number}" in p.extract_text()]
        assert f"Picture {number}" in page.extract_text()
        words = words_at(page)
        (caption_y,) = [y for text, _, y in words if text == f"Caption of f{number}"]
        title_y = titles_at(page)[f"Picture {number}"]
        assert caption_y < title_y < A4_PT[1] - 40.0
        if number in (0, 1):  # as far apart as the figure is high, except for a line or two
            assert title_y - caption_y == pytest.approx(72.0 * (3.0, 6.8)[number], abs=15.0)


def test_contents_of_a_figure_are_copied_without_parsing(tmp_path: Path) -> None:
    """Only the place of the drawing is added to its page, however many points it has."""
    with figure_style():
        made = document()
        figure = Figure(figsize=(7.2, 3.0))
        y = np.random.default_rng(3).uniform(size=100_000)
        figure.add_subplot().plot(np.cumsum(0.5 + y), y, color=(0.2, 0.4, 0.6))
        file = tmp_path / "many.pdf"
        write_pdf(replace(made, figures={"f": figure}, captions={"f": "Caption"}), file)
    pages = PdfReader(file).pages
    assert sum(len(contents_of(page)) for page in pages) < 20_000
    drawn = [form.get_data() for page in pages
             for form in page["/Resources"].get("/XObject", {}).values()]  # fmt: skip
    (single,) = drawn
    contents = PdfReader(io.BytesIO(figure_page(figure))).pages[0].get_contents()
    assert contents is not None
    assert len(single) > 200_000 and single == contents.get_data()
    # The page's own words end with their last colour and place, not with the figure's.
    (page,) = [page for page in pages if b"/Figure0 Do" in contents_of(page)]
    assert re.search(rb"^q\s.*\sQ q [\d. ]+ cm /Figure0 Do Q\s*$", contents_of(page), re.DOTALL)


def test_two_profiles_stand_on_a_page(tmp_path: Path) -> None:
    """The first stands below the title, the others on the page after it."""
    texts = [
        page.extract_text()
        for page in written(document((), [PROFILE_IN[1]] * 3), tmp_path / "r.pdf")
    ]
    assert "Caption of f0" in texts[0]
    assert "Caption of f1" in texts[1] and "Caption of f2" in texts[1]


def test_a_wide_table_is_cut_into_tables_that_begin_with_its_first_column(tmp_path: Path) -> None:
    """30 columns of words that cannot be broken: every cell is on paper, inside the margins."""
    header = ["step", *(f"residual_vibration_{n}" for n in range(30))]
    rows = [[f"step{r}", *(f"{r}.{n:03d} mm" for n in range(30))] for r in range(3)]
    pages = written(document([Table(title="Steps", header=header, rows=rows)]), tmp_path / "r.pdf")
    words = [word for page in pages for word in words_at(page)]
    messages = [text for text, _, _ in words]
    for r in range(3):
        for n in range(30):
            assert sum(text == f"{r}.{n:03d} mm" for text in messages) == 1
    for n in range(30):
        assert f"residual_vibration_{n}" in messages
    assert messages.count("step1") == messages.count("step2") >= 5
    assert all(30.0 < x < A4_PT[0] - 30.0 for _, x, _ in words)


def test_a_long_note_is_wrapped_and_not_cut(tmp_path: Path) -> None:
    note = " ".join(f"word{n}" for n in range(300))
    row = ("contour_error", "X", "0.4818 mm", "0.5 mm", "failed", "51.895 s", "23 (pass 2)", note)
    header = ("criterion", "axis", "measured", "limit", "status", "at", "line", "note")
    table = Table(title="Criteria", header=header, rows=[row])
    pages = written(document([table]), tmp_path / "r.pdf")
    message = " ".join(page.extract_text() for page in pages).split()
    assert {f"word{n}" for n in range(300)} <= set(message)
    assert {"contour_error", "51.895"} <= set(message)


def test_columns_are_as_wide_as_their_words() -> None:
    """Together they fill the room; a single column wider than a page is broken inside a word."""
    (columns, size_pt, widths_pt), *others = columns_of(rows_table(3), 500.0)
    assert (columns, size_pt, others) == ((0, 1, 2, 3), 8.0, [])
    assert sum(widths_pt) == pytest.approx(500.0)
    endless = Table(title="t", header=("a", "b"), rows=[("x", "y" * 500)])
    assert sum(columns_of(endless, 500.0)[0][2]) == pytest.approx(500.0)


def test_long_names_keep_their_page_number_apart(tmp_path: Path) -> None:
    """A name of 300 letters is whole on the first page, and shortened at the foot of each."""
    title = "cone-" * 60 + "end.prg on winder"
    pages = written(document([rows_table(80)], title=title), tmp_path / "r.pdf")
    assert title in pages[0].extract_text().replace("\n", "")
    for number, page in enumerate(pages, start=1):
        (at,) = [x for text, x, _ in words_at(page) if text == f"page {number} of {len(pages)}"]
        ((foot, y),) = [(text, y) for text, _, y in words_at(page) if "…" in text]
        assert foot.endswith("winder")
        assert y < 40.0 and at > 500.0


def test_the_same_report_has_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.pdf", "b.pdf"):
        written(document([rows_table(3)], [3.0]), tmp_path / name)
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()


def test_words_of_the_user_are_no_markup(tmp_path: Path) -> None:
    """The library that sets the text has a markup of its own."""
    hostile = "<b>a</b> & <font size=90>&lt; <img src='/etc/passwd'/> </para>"
    table = Table(title=hostile, header=(hostile, "b"), rows=[(hostile, "1")], note=hostile)
    pages = written(document([table], title=hostile), tmp_path / "r.pdf")
    text = " ".join(" ".join(page.extract_text() for page in pages).split())
    assert text.count(hostile) >= 4
