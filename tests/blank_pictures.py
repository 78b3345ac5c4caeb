"""Reports with empty pictures, for tests of their words: drawing takes most of the time."""

from __future__ import annotations

from dataclasses import replace

import pytest

from threadline.report.document import Document


def blank_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace every figure by an empty one of the same size, once the report has made it.

    ``tests/report`` and the tests of each command check the drawings.
    """
    shown = Document.shown

    def blank(document: Document) -> Document:
        from matplotlib.figure import Figure

        empty = {
            name: Figure(figsize=tuple(figure.get_size_inches().tolist()))
            for name, figure in document.figures.items()
        }
        return shown(replace(document, figures=empty))

    monkeypatch.setattr(Document, "shown", blank)
