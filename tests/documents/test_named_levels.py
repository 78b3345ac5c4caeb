"""Every figure of a verdict in a document stands with the level of the verdict."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from threadline.verdict.registry import MEASURES
from threadline.verdict.types import Level

ROOT = Path(__file__).resolve().parents[2]
LEVEL = re.compile(
    r"\b(nominal(ly)?|repeated|over (the )?tolerances|20 runs|(one|1) run|as drawn|yield"
    r"|limits and time alone)\b",
    re.I,
)
"""Words for how far a figure reaches; a yield is of machines within the tolerances."""
JUDGED = re.compile(
    r"\b(in spec|out of spec|verdict|contour|turning point|stitch length|of its limit|fastest"
    r"|residual vibration|stitches? to speed)\b",
    re.I,
)
"""Words for what a specification sets limits to."""
FIGURE = re.compile(r"\d+(\.\d+)? (mm(/s)?|stitch(es)?/s|stitches a second|%|s|ms|um)\b")
DOCUMENTS = [ROOT / "docs" / "yield.md"]  # the validation pages have a column for it


def tables(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield the line, the table, and the text between it and the heading or table before it."""
    lines = text.splitlines()
    at, begin = 0, 0
    while at < len(lines):
        if lines[at].startswith("#"):
            begin = at
        if not lines[at].startswith("|"):
            at += 1
            continue
        end = at
        while end < len(lines) and lines[end].startswith("|"):
            end += 1
        yield at + 1, "\n".join(lines[at:end]), "\n".join(lines[begin:at])
        at = begin = end


def test_the_glossary_has_every_level_and_only_measures_that_exist() -> None:
    words = re.findall(
        r"^\| (.+?) \|", (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert {level.value for level in Level} <= set(words)
    assert {word.strip("`") for word in words if word.startswith("`")} <= MEASURES.keys()


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda file: file.name)
def test_every_table_of_what_is_judged_says_its_level(document: Path) -> None:
    """In its columns, or in the words between it and the heading or the table before it."""
    silent = [
        f"{document.name}:{line}: {table.splitlines()[0]}"
        for line, table, before in tables(document.read_text(encoding="utf-8"))
        if JUDGED.search(table) and not LEVEL.search(table) and not LEVEL.search(before)
    ]
    assert not silent, "\n".join(silent)


def test_a_reader_of_the_readme_cannot_take_a_nominal_figure_for_a_proven_one() -> None:
    """A paragraph, or a remark on a command, with a figure of a machine names its level."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    readme += "\n\n" + (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    remarks = re.findall(r"^threadline .*?  (#.*)", readme, re.MULTILINE)
    # A picture and its caption count as one.
    paragraphs = re.split(r"\n\s*\n(?!\*)", re.sub(r"```.*?```", "", readme, flags=re.DOTALL))
    of_machines = [p for p in (*paragraphs, *remarks) if FIGURE.search(p)]
    assert of_machines
    for paragraph in of_machines:
        assert LEVEL.search(paragraph), paragraph
