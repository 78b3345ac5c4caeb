"""Content of a report: verdicts, tables, figures with captions, and the facts to repeat it."""

from __future__ import annotations

import io
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeAlias

from threadline import __version__
from threadline.base.wording import plain
from threadline.commands.learned import table_words
from threadline.files import Recording
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.proof.option_words import parse_tolerance_m, tolerance_words
from threadline.report.style import HEAD
from threadline.verdict import Verdict, happened_rows
from threadline.winding.product import digest, product_of_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox


Printed: TypeAlias = tuple[str, list[str], list[list[str]]]
"""A table as printed by a command: title, header, rows."""

_FAILED = ("failed", "OUT")


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table of a document, with a ``note`` below it; ``words`` are the columns with text."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    words: Sequence[str] = ()

    @property
    def headed(self) -> bool:
        """Whether the columns have names."""
        return any(self.header)

    @property
    def left_aligned(self) -> tuple[bool, ...]:
        """Whether each column has text: the first, notes, and both of two columns without names."""
        return tuple(
            column == 0
            or name in ("note", *self.words)
            or (len(self.header) == 2 and not self.headed)
            for column, name in enumerate(self.header)
        )


def changes(verdict: Verdict) -> list[Table]:
    """Return a table of the events that changed the motion of the runs; none without events."""
    header, rows = happened_rows(verdict)
    return [Table(title="What changed the motion", header=header, rows=rows)] if rows else []


def failing(row: Sequence[str]) -> tuple[bool, ...]:
    """Return, for each cell of a row, whether it is marked as out of specification.

    All cells are marked if the status of the row is ``failed`` or ``OUT``.

    >>> failing(["jerk", "2 m/s^3", "failed"]), failing(["return", "2 mm (failed)", "0 mm"])
    ((True, True, True), (False, True, False))
    >>> failing(["failed", "passed"])
    (False, False)
    """
    row_fails = any(cell in _FAILED for cell in row[1:])
    return tuple(row_fails or (n > 0 and cell.endswith("(failed)")) for n, cell in enumerate(row))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Document:
    """Content of a report.

    Parameters
    ----------
    title, subtitle
        Job and machine, or another subject of the report.
    verdicts
        Text of each verdict, and whether it is passed; printed at the top of every page of the PDF.
    tables, figures, captions
        In the order of the page; figures and captions by the name of the figure.
    facts
        Versions, hashes and options, with which the report can be made again.
    warnings
        Warnings about the inputs and the results.
    beside
        Files beside the figures, by the name of a figure with an ending.
    """

    title: str
    subtitle: str
    verdicts: Sequence[tuple[str, bool]]
    tables: Sequence[Table]
    figures: Mapping[str, Figure]
    captions: Mapping[str, str]
    facts: Sequence[tuple[str, str]]
    warnings: Sequence[str] = field(default_factory=tuple)
    beside: Mapping[str, bytes] = field(default_factory=dict)

    def shown(self) -> Document:
        """Return the document with control characters escaped; its figures are changed in place.

        Text of a user must not act as control characters, nor as a formula for matplotlib, which
        refuses "$x^$". The numbers of logarithmic axes remain formulas.
        """
        for figure in self.figures.values():
            without_formulas(figure)
        return replace(
            self,
            title=plain(self.title),
            subtitle=plain(self.subtitle),
            verdicts=[(plain(text), good) for text, good in self.verdicts],
            tables=[_shown_table(table) for table in self.tables],
            captions={name: plain(text) for name, text in self.captions.items()},
            facts=[(plain(name), plain(value)) for name, value in self.facts],
            warnings=[plain(text) for text in self.warnings],
        )


def _shown_table(table: Table) -> Table:
    return replace(
        table,
        title=plain(table.title),
        header=[plain(cell) for cell in table.header],
        rows=[[plain(cell) for cell in row] for row in table.rows],
        note=plain(table.note),
    )


def without_formulas(figure: Figure) -> None:
    """Turn off matplotlib's formulas in every text of ``figure`` except the numbers of its axes."""
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


def origin_facts(machine: Machine | None = None, job: Job | None = None) -> list[tuple[str, str]]:
    """Return the facts at the beginning of every report: versions and input files."""
    facts = [("threadline", __version__), ("Python", platform.python_version())]
    if job is not None:
        facts.append(("job", job.name))
        if job.sha256:  # a job made by a search has no file
            facts.append(("job sha256", job.sha256))
    if machine is not None:
        facts += [
            ("machine", f"{machine.name} ({machine.title})"),
            ("machine sha256", machine.sha256),
        ]
    return facts


def run_facts(recording: Recording) -> list[tuple[str, str]]:
    """Return the facts of a run of the real machine; none for a simulated recording.

    ``override`` is the reason why the job was run although its proof did not pass.
    """
    origin = recording.origin
    return [(name, origin[name]) for name in ("link", "label", "override") if name in origin]


def options_facts(
    options: Mapping[str, str], machine: Machine, leave_out: Sequence[str] = ()
) -> list[tuple[str, str]]:
    """Return the options of a plan as facts.

    Parameters
    ----------
    options
        Options of the plan. A machine that was given by its name is left out, because it is in
        ``origin_facts``.
    machine
        The machine of the plan.
    leave_out
        More options to leave out.
    """
    renamed = {"job": "job file", "machine": "machine file"}
    shown = {key: value for key, value in options.items() if key not in leave_out}
    if shown.get("machine") == machine.name:
        del shown["machine"]
    if "tolerance" in shown:
        shown["tolerance"] = tolerance_words(parse_tolerance_m(shown["tolerance"]))
    if "table" in shown:
        shown["table"] = table_words(shown["table"])
    if "product" in shown:
        product = product_of_text(shown["product"])
        shown["product"] = f"{product.name} ({product.file}, sha256 {digest(product)[:12]})"
    return sorted((renamed.get(key, key), value) for key, value in shown.items())


_HEAD_GROUP = re.compile(rf'^( *)<g id="{HEAD}">\n.*?^\1</g>\n', re.DOTALL | re.MULTILINE)
_SIZE = re.compile(r'height="([0-9.]+)pt" viewBox="0 0 ([0-9.]+) \1"')


def svg_text(figure: Figure, area: Bbox | None = None) -> str:
    """Return a figure as SVG; the same figure gives the same text each time.

    Parameters
    ----------
    area
        Rectangle to draw, inches; None for the figure itself.
    """
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None}, bbox_inches=area)
    return buffer.getvalue()


def without_head(svg: str, strip_in: float) -> str:
    """Return the SVG of a ``headed`` figure without the lines above it.

    This takes a few milliseconds; drawing the figure once more takes 0.2 s.

    Parameters
    ----------
    svg
        Result of ``svg_text`` for a ``headed`` figure.
    strip_in
        Height of the lines, inches.
    """
    strip_pt = 72.0 * strip_in  # points
    headless, groups = _HEAD_GROUP.subn("", svg, count=1)
    cropped, sizes = _SIZE.subn(
        lambda match: (
            f'height="{float(match[1]) - strip_pt:.6g}pt" '
            f'viewBox="0 {strip_pt:.6g} {match[2]} {float(match[1]) - strip_pt:.6g}"'
        ),
        headless,
        count=1,
    )
    assert groups == sizes == 1
    return cropped
