"""One self-contained HTML page, the same as PDF, and every figure as SVG and PNG."""

from __future__ import annotations

import io
import platform
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from threadline import __version__
from threadline.escaping import plain
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.writing import remove_with, staging_folder, together

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

_PNG_DPI = 160
_TOP, _BOTTOM = 0.95, 0.05  # of a page; so are the following
_TITLE, _ROW, _BETWEEN = 0.045, 0.027, 0.03
_FEWEST = 5  # rows of a table that are worth beginning it on a page
_CHARACTERS_PER_LINE = 150
_CAPTION_SIZE = (
    8.0  # points; so wide is a letter of it, and so much stays free around it, in inches
)
_LETTER_IN, _MARGIN_IN = 0.068, 0.15
_GAP = 0.012  # between a column on the right and one on the left beside it


Printed: TypeAlias = tuple[str, list[str], list[list[str]]]
"""A table as it is printed: title, header, rows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table of a document; ``note`` stands below it."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Document:
    """What a report says.

    Parameters
    ----------
    title, subtitle
        What was asked.
    verdicts
        Text and whether it is good news.
    tables, figures, captions
        In the order in which they are read; captions by figure name.
    facts
        Versions, hashes, options: what is needed to make the report again.
    """

    title: str
    subtitle: str
    verdicts: Sequence[tuple[str, bool]]
    tables: Sequence[Table]
    figures: Mapping[str, Figure]
    captions: Mapping[str, str]
    facts: Sequence[tuple[str, str]]
    warnings: Sequence[str] = field(default_factory=tuple)


def origin_facts(machine: Machine | None = None, job: Job | None = None) -> list[tuple[str, str]]:
    """Return the facts that every report begins with: versions, and what was read."""
    facts = [("threadline", __version__), ("Python", platform.python_version())]
    if job is not None:
        facts += [("job", job.name), ("job sha256", job.sha256)]
    if machine is not None:
        facts += [
            ("machine", f"{machine.name} ({machine.title})"),
            ("machine sha256", machine.sha256),
        ]
    return facts


def options_facts(
    options: Mapping[str, str], machine: Machine, leave_out: Sequence[str] = ()
) -> list[tuple[str, str]]:
    """Return the options of a plan as facts, beside those of ``origin_facts``.

    Parameters
    ----------
    options
        As the plan has them: they name the job's file and the machine as it was given, which is
        left out where it is the machine's name.
    machine
        What was given.
    leave_out
        Options that are not told.
    """
    named = {"job": "job file", "machine": "machine file"}
    told = {key: value for key, value in options.items() if key not in leave_out}
    if told.get("machine") == machine.name:
        del told["machine"]
    return sorted((named.get(key, key), value) for key, value in told.items())


def write_document(document: Document, folder: Path, stem: str) -> Path:
    """Write the document into ``folder`` and return the path of its HTML page.

    All files appear together once they are complete, so that a failure leaves nothing half-written,
    and no new folder either. Figures of the page that was there go with it.

    Raises
    ------
    OptionError, OSError
        If the folder cannot be written.
    """
    document = _shown(document)
    with together():
        old = _figure_files(folder, stem)
        with staging_folder(folder) as temporary:
            svgs = {}
            for name, figure in document.figures.items():
                svg = _svg(figure)
                (temporary / f"{stem}-{name}.svg").write_text(svg, encoding="utf-8")
                figure.savefig(
                    temporary / f"{stem}-{name}.png", dpi=_PNG_DPI, metadata={"Software": None}
                )
                svgs[name] = svg
            page = temporary / f"{stem}.html"
            page.write_text(_html(document, svgs), encoding="utf-8")
            _pdf(document, temporary / f"{stem}.pdf")
            made = {file.name for file in temporary.iterdir()}
        for name in old - made:
            remove_with(folder / name)
    return folder / f"{stem}.html"


def _figure_files(folder: Path, stem: str) -> set[str]:
    """Return the figures that the page in ``folder`` names as its own and that are files there."""
    try:
        page = (folder / f"{stem}.html").read_text(encoding="utf-8")
    except (OSError, ValueError):
        return set()
    names = re.findall(r'<figure id="([A-Za-z0-9_-]+)">', page)
    files = {f"{stem}-{name}.{ending}" for name in names for ending in ("svg", "png")}
    return {name for name in files if (folder / name).is_file()}


def _shown(document: Document) -> Document:
    """Return the document with every text as it is shown; its figures are changed in place.

    Nothing of a user's text may drive what reads a page, nor be taken by matplotlib for a formula:
    it would refuse "$x^$". The numbers of logarithmic axes are formulas, and stay.
    """
    for figure in document.figures.values():
        _without_formulas(figure)
    return replace(
        document,
        title=plain(document.title),
        subtitle=plain(document.subtitle),
        verdicts=[(plain(text), good) for text, good in document.verdicts],
        tables=[_shown_table(table) for table in document.tables],
        captions={name: plain(text) for name, text in document.captions.items()},
        facts=[(plain(name), plain(value)) for name, value in document.facts],
        warnings=[plain(text) for text in document.warnings],
    )


def _shown_table(table: Table) -> Table:
    return replace(
        table,
        title=plain(table.title),
        header=[plain(cell) for cell in table.header],
        rows=[[plain(cell) for cell in row] for row in table.rows],
        note=plain(table.note),
    )


def _without_formulas(figure: Figure) -> None:
    from matplotlib.text import Text
    from matplotlib.ticker import LogFormatter, ScalarFormatter

    numbers = {
        text
        for panel in figure.axes
        for axis in (panel.xaxis, panel.yaxis)
        if isinstance(axis.get_major_formatter(), LogFormatter | ScalarFormatter)
        for text in axis.get_ticklabels(which="both")
    }
    for text in figure.findobj(Text):
        if isinstance(text, Text) and text not in numbers:
            text.set_parse_math(False)
            text.set_text("\n".join(map(plain, text.get_text().split("\n"))))


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def _html(document: Document, svgs: Mapping[str, str]) -> str:
    environment = Environment(
        loader=PackageLoader("threadline.report"), autoescape=True, undefined=StrictUndefined
    )
    inline = []
    for index, (name, svg) in enumerate(svgs.items()):
        body = svg[svg.index("<svg") :]
        # Identifiers must be unique once several figures share one page.
        body = re.sub(r'\bid="', f'id="f{index}-', body)
        body = re.sub(r'(xlink:href="|href="|url\()#', rf"\1#f{index}-", body)
        inline.append(
            {"name": name, "svg": Markup(body), "caption": document.captions.get(name, "")}  # noqa: S704 - our own figure
        )
    return environment.get_template("proof.html").render(
        title=document.title,
        subtitle=document.subtitle,
        verdicts=document.verdicts,
        warnings=document.warnings,
        tables=document.tables,
        figures=inline,
        facts=document.facts,
    )


def _pdf(document: Document, file: Path) -> None:
    from matplotlib.backends.backend_pdf import PdfPages

    with PdfPages(file, metadata={"Title": document.title, "CreationDate": None}) as pages:
        for page in _pages(document):
            _without_formulas(page)
            pages.savefig(page)
        for name, figure in document.figures.items():
            pages.savefig(figure, bbox_inches=_with_caption(figure, document.captions.get(name)))


def _with_caption(figure: Figure, caption: str | None) -> Bbox:
    """Write the caption below the figure; return the page that holds both, in inches."""
    from matplotlib.transforms import Bbox

    width, height = figure.get_size_inches()
    if not caption:
        return Bbox.from_extents(0.0, 0.0, width, height)
    _hold_legends(figure)
    lines = textwrap.wrap(caption, max(int((width - 2 * _MARGIN_IN) / _LETTER_IN), 20))
    text = figure.text(
        _MARGIN_IN / width,
        0.0,
        "\n".join(lines),
        fontsize=_CAPTION_SIZE,
        va="top",
        color="0.2",
        parse_math=False,
    )
    text.set_in_layout(False)  # the figure itself stays as it is on the page of the browser
    room = len(lines) * _CAPTION_SIZE * 1.25 / 72.0 + _MARGIN_IN
    return Bbox.from_extents(0.0, -room, width, height)


def _hold_legends(figure: Figure) -> None:
    """Fix legends outside the panels where they are: they would move to the edge of the page."""
    figure.canvas.draw()
    figure.set_layout_engine("none")
    for legend in figure.legends:
        box = legend.get_window_extent().transformed(figure.transFigure.inverted())
        legend.set_loc("lower left")
        legend.borderaxespad = 0.0
        legend.set_bbox_to_anchor((box.x0, box.y0), transform=figure.transFigure)


def _pages(document: Document) -> list[Figure]:
    """Return the title page and the tables as figures of A4 size, as few as hold them."""
    from matplotlib.figure import Figure

    head = [document.subtitle, *(text for text, _ in document.verdicts)]
    head += [f"warning: {w}" for w in document.warnings]
    head = [line for text in head for line in textwrap.wrap(text, _CHARACTERS_PER_LINE) or [""]]
    facts = Table(title="What this was made from", header=("", ""), rows=document.facts)
    pages: list[Figure] = []

    def new_page() -> float:
        figure = Figure(figsize=(11.69, 8.27))
        figure.set_layout_engine("none")
        pages.append(figure)
        return _TOP

    top = new_page()
    pages[0].text(0.05, top, document.title, fontsize=15, weight="bold", va="top")
    pages[0].text(0.05, top - 0.05, "\n".join(head), fontsize=9, va="top")
    top -= 0.08 + 0.022 * len(head)
    for table in [*document.tables, facts]:
        start = 0
        while start == 0 or start < len(table.rows):
            room = int((top - _TITLE - _BOTTOM) / _ROW) - 1  # below the header
            if room < min(len(table.rows) - start, _FEWEST):
                top = new_page()
                continue
            rows = table.rows[start : start + max(room, 1)]
            pages[-1].text(0.05, top, table.title, fontsize=11, weight="bold", va="top")
            if rows:
                _draw_table(pages[-1], table.header, rows, top - _TITLE)
            top -= _TITLE + _ROW * (len(rows) + 1) + _BETWEEN
            start += max(len(rows), 1)
    return pages


def _draw_table(
    figure: Figure, header: Sequence[str], rows: Sequence[Sequence[str]], top: float
) -> None:
    widths = [max(len(str(row[c])) for row in [header, *rows]) + 3 for c in range(len(header))]
    total = max(sum(widths), 110)
    size = 8.0 if sum(widths) <= 130 else 8.0 * 130 / sum(widths)
    for number, row in enumerate([header, *rows]):
        at = 0.05
        y = top - _ROW * number
        for column, cell in enumerate(row):
            width = 0.9 * widths[column] / total
            left = column == 0 or len(header) == 2 or header[column] == "note"
            figure.text(
                at + (_GAP if left and column else 0.0) if left else at + width,
                y,
                str(cell),
                fontsize=size,
                ha="left" if left else "right",
                va="top",
                weight="bold" if number == 0 or "failed" in row else "normal",
            )
            at += width
