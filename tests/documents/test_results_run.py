"""The results documents say what their quick commands come to.

What is quick is said in ``docs/results.md``; this folder is its list. A figure of a document that
differs from what its command answers, by more than the rounding of its last digit, fails here.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import re

import pytest

from tests.documents import of_the_rest, of_the_stitcher, of_the_winder
from tests.documents.of_tools import TABLES, ToolTable
from tests.documents.quick import ROOT, Quick, agrees, printed, text_of
from tests.documents.slow import SLOW

QUICK = [*of_the_winder.QUICK, *of_the_stitcher.QUICK, *of_the_rest.QUICK]
DOCUMENTS = [*sorted(path.name for path in (ROOT / "docs").glob("results*.md")), "yield.md"]
NOISE = 1e-9  # a smaller figure is what rounding leaves of nothing
COMMAND = re.compile(
    r"`((?:threadline|python|pytest|make|OPENBLAS_NUM_THREADS=1|/usr/bin/time)\s[^`]*)`"
)


def name_of(quick: Quick) -> str:
    return " ".join(quick.words)


@pytest.mark.parametrize(
    "quick", [quick for quick in QUICK if quick is not of_the_winder.WHOLE], ids=name_of
)
def test_a_document_has_the_figures_that_its_command_answers(quick: Quick) -> None:
    has_its_figures(quick)


def has_its_figures(quick: Quick) -> None:
    """Run a command, and compare its answer with the figures of its document."""
    assert quick.said in text_of(quick.document)
    said = quick.answers()

    differ = []
    for figures in quick.figures:
        texts = printed(quick.document, figures.said)
        for text, found in zip(texts, figures.measured, strict=True):
            if not agrees(text, found(said)):
                differ.append(f"{figures.said}: printed {text}, answered {found(said):.6g}")
    assert not differ, "\n".join(differ)


@pytest.mark.parametrize("tool", TABLES, ids=lambda tool: tool.said)
def test_a_document_has_the_rows_that_its_tool_prints(tool: ToolTable) -> None:
    """Word by word, but for figures that are the rounding of nothing."""
    assert tool.said in text_of(tool.document)
    written = (ROOT / "docs" / tool.document).read_text(encoding="utf-8").splitlines()
    rows = {without_noise(line) for line in written if line.startswith("|")}
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        getattr(importlib.import_module(tool.module), tool.function)()
    made = [
        line for line in told.getvalue().splitlines() if line.startswith("| ") and "---" not in line
    ]

    assert len(made) > tool.headers
    missing = [line for line in made if without_noise(line) not in rows]
    # The headers of the tool are not always those of the document.
    assert len(missing) <= tool.headers, "\n".join(missing)


def without_noise(row: str) -> str:
    """Return a row with every number below ``NOISE`` as 0."""
    return re.sub(
        r"\b\d\.\d+e-\d+\b", lambda found: "0" if float(found[0]) < NOISE else found[0], row
    )


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_command_of_a_document_is_run_here_or_says_why_not(document: str) -> None:
    known = {quick.said for quick in QUICK if quick.document == document}
    known |= {tool.said for tool in TABLES if tool.document == document}
    known |= SLOW[document].keys()
    found = {" ".join(said.split()) for said in COMMAND.findall(
        (ROOT / "docs" / document).read_text(encoding="utf-8")
    )}  # fmt: skip

    assert sorted(found - known) == []
    assert sorted(SLOW[document].keys() - found) == []


def test_a_stale_figure_is_noticed() -> None:
    assert agrees("1.43", 1.4349)
    assert not agrees("1.40", 1.4349)
    assert not agrees("16 542", 16541.0)
