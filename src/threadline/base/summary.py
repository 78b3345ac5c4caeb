"""The printed form of an answer: at most ten lines, and a table in a notebook."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

from threadline.base.wording import plain

__all__ = ["MOST_ROWS", "Summarised", "Summary", "html_table"]

MOST_ROWS = 7
"""Largest number of rows that an answer prints: with title, header and closing lines ten lines."""


class Summary(NamedTuple):
    """Texts of the table of an answer: its title, header, all rows, and a closing line."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    below: str = ""


class Summarised(ABC):
    """Base of answers that print ``_summary()`` as a table instead of all their fields."""

    __slots__ = ()

    @abstractmethod
    def _summary(self) -> Summary:
        """Return the whole table; printing shortens it."""

    def __repr__(self) -> str:
        title, header, rows, below = _shortened(self._summary())
        table = [header, *rows] if rows else []
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
            for row in table
        ]
        return "\n".join(plain(line.rstrip()) for line in (title, *lines, below) if line)

    def _repr_html_(self) -> str:
        return html_table(_shortened(self._summary()))


def html_table(summary: Summary) -> str:
    """Return the table of an answer as HTML, all its text escaped."""
    lines = [f"<table><caption>{escape(plain(summary.title))}</caption>"]
    for tag, row in [("th", summary.header), *(("td", row) for row in summary.rows)]:
        cells = "".join(f"<{tag}>{escape(plain(cell))}</{tag}>" for cell in row)
        lines.append(f"<tr>{cells}</tr>")
    return "\n".join([*lines, f"</table><p>{escape(plain(summary.below))}</p>"])


def _shortened(summary: Summary) -> Summary:
    """Return a table with only the first rows; its closing line says how many are left out."""
    hidden_count = len(summary.rows) - MOST_ROWS
    if hidden_count <= 0:
        return summary
    below = "; ".join(filter(None, (summary.below, f"and {hidden_count} more rows")))
    return summary._replace(rows=summary.rows[:MOST_ROWS], below=below)
