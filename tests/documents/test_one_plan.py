"""Three documents about one plan, the slowest that they show: it is made once.

The README's Python, a row of docs/validation-winder.md and one of docs/interpolations.md use
``cone-dome-cylinder.prg`` on ``lathe-winder`` by ``optimal``. Everything else is computed as usual.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from tools import validation

from tests.motion.path.test_interpolations_document import row_is_of
from threadline.commands.plan import Plan
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof import pipeline
from threadline.proof.options import Options

ROOT = validation.ROOT
MADE = pipeline.plan_job
README = (ROOT / "README.md").read_text(encoding="utf-8")


class Asked:
    """A job, a machine and options: equal if everything that affects a plan is equal."""

    def __init__(self, job: pipeline.Job, machine: pipeline.Machine, options: Options) -> None:
        self.all = (job, machine, options)
        self._said = (job.sha256, machine.sha256, options)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Asked) and self._said == other._said

    def __hash__(self) -> int:
        return hash(self._said)


@cache
def plan_of(asked: Asked) -> Plan:
    return MADE(*asked.all)


@pytest.fixture
def planned_once(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Make a plan once for all who request the same."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(pipeline, "plan_job", lambda *arguments: plan_of(Asked(*arguments)))
    yield
    assert plan_of.cache_info().currsize == 1  # they did request the same


def word_and_error_mm(message: str) -> tuple[str, float]:
    """Return the level of the answer, and the error printed below it."""
    first, second, *_ = message.splitlines()
    return first, float(second.split()[2])


def code_of_the_readme() -> str:
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert code.count("cone-dome-cylinder") == 1
    return code


def test_the_python_of_the_readme_runs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a shorter job."""
    monkeypatch.chdir(ROOT)
    code = code_of_the_readme().replace("cone-dome-cylinder", "x-180")
    exec(compile(code, "README.md", "exec"), {})
    word, error_mm = word_and_error_mm(capsys.readouterr().out)
    assert word == "in spec (repeated)"
    assert 0.0 < error_mm <= 0.5  # the limit of the winder's specification


@pytest.mark.long(shown_by="test_the_python_of_the_readme_runs")
@pytest.mark.usefixtures("planned_once")
def test_the_python_of_the_readme_runs_and_says_that_the_job_is_in_spec(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One question, one function; the answer states its level."""
    exec(compile(code_of_the_readme(), "README.md", "exec"), {})
    word, error_mm = word_and_error_mm(capsys.readouterr().out)
    assert word == "in spec (repeated)"
    assert 0.0 < error_mm <= 0.5  # the limit of the winder's specification


@pytest.mark.long(
    shown_by="tests/documents/test_validation.py::test_rows_have_the_figures_that_their_command_answers"
)
@pytest.mark.usefixtures("planned_once")
def test_the_validation_has_the_figures_that_the_command_answers() -> None:
    command = "threadline prove examples/cone-dome-cylinder.prg -m lathe-winder "
    page = ROOT / "docs" / "validation-winder.md"
    (row,) = (
        row
        for row in validation.rows_of(page)
        if row.command == f"{command}--interpolation optimal"
    )
    assert not validation.differences(row)


@pytest.mark.long(
    shown_by="tests/motion/path/test_interpolations_document.py::test_a_row_says_what_the_planner_does"
)
@pytest.mark.usefixtures("planned_once")
def test_the_row_of_optimal_says_what_the_planner_does() -> None:
    machine = load_machine("lathe-winder")
    job = read_job(Path("examples/cone-dome-cylinder.prg"), machine)
    row_is_of("optimal", pipeline.plan_job(job, machine, Options(interpolation="optimal")))
