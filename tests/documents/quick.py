"""The quick commands of docs/results*.md and docs/yield.md, and the figures that they stand for.

A command is *quick* when it ends within eight seconds of processor time; all of them together take
about a minute. The figures of a command are places in the text of its document, written as there
with ``{}`` for each number, and what the command answers for each, in the unit of the text.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from threadline.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
NUMBER = r"([+-]?\d+(?: \d{3})*(?:\.\d+)?)"
LAST_DIGIT = 0.51  # of a unit of the last digit that is printed: rounding, and its own rounding

Answer = Callable[[Any], float]


@dataclass(frozen=True, slots=True)
class Figures:
    """A place of a document, ``{}`` for each of its numbers, and what answers each of them."""

    said: str
    measured: Sequence[Answer]


@dataclass(frozen=True, slots=True)
class Quick:
    """A command as its document says it, and its figures.

    ``more`` is added to it, such as ``--nominal`` where the document says so beside the command;
    where the command has SEAM, JOB or NAME in it, ``instead`` has all its words. ``tool`` is what
    the command calls, if it is one of ``tools/``.
    """

    document: str
    said: str
    figures: Sequence[Figures]
    more: Sequence[str] = ()
    instead: Sequence[str] = ()
    status: int = 0
    tool: Callable[[], Any] | None = None

    def answers(self) -> Any:
        """Return what the command answers: its JSON, or the rows of a tool."""
        return answer(self.words, self.status) if self.tool is None else self.tool()

    @property
    def words(self) -> list[str]:
        """The words that are run; reports are not drawn."""
        words = [*self.instead] or shlex.split(self.said)[1:]
        if "--report" in words:
            at_report = words.index("--report")
            del words[at_report : at_report + 2]
        return [word for word in words if word != "--json"] + [*self.more]


@cache
def text_of(document: str) -> str:
    """Return a document with every run of white space as one space."""
    return " ".join((ROOT / "docs" / document).read_text(encoding="utf-8").split())


def printed(document: str, said: str) -> list[str]:
    """Return the numbers of the one place of a document that reads ``said``."""
    pattern = re.escape(" ".join(said.split())).replace(r"\{\}", NUMBER)
    ends = r"(?![.]?\d)" if said.endswith("{}") else ""  # with the whole number
    places = re.findall(pattern + ends, text_of(document))
    assert len(places) == 1, f"{document} has {len(places)} places that read {said!r}"
    return [places[0]] if isinstance(places[0], str) else list(places[0])


def agrees(text: str, measured: float) -> bool:
    """Whether a printed number is the measured one, rounded to its digits."""
    digits = text.replace(" ", "")
    decimals = len(digits.partition(".")[2])
    return abs(float(digits) - measured) <= LAST_DIGIT * 10.0**-decimals


def answer(words: Sequence[str], status: int = 0) -> Any:
    """Return what a command says with ``--json``, run in this process."""
    told = io.StringIO()
    with contextlib.redirect_stdout(told), pytest.raises(SystemExit) as stopped:
        main([*words, "--json"])
    assert (stopped.value.code or 0) == status, words
    return json.loads(told.getvalue())


def of(name: str, axis: str | None = None, times: float = 1e3) -> Answer:
    """Return what finds a criterion of a verdict, in thousandths of its SI unit."""

    def found(said: Any) -> float:
        return times * max(
            c["measured"]
            for c in said["criteria"]
            if c["name"] == name and (axis is None or c["axis"] == axis)
        )

    return found


def at(*path: str | int, times: float = 1.0) -> Answer:
    """Return what finds a number by its keys."""

    def found(said: Any) -> float:
        for key in path:
            said = said[key]
        return times * float(said)

    return found


seconds = at("duration_s")
contour = of("contour_error")
turning = of("turning_point_error")
