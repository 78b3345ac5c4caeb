"""What ``threadline fastest`` was asked: the question, and how its answer is told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from threadline.jobs import Job
from threadline.machine import Machine
from threadline.options import Options
from threadline.pipeline import Trials
from threadline.search.by_pace import Question
from threadline.search.until import Until
from threadline.verdict import Spec


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """The options of ``threadline fastest``, read as far as every job understands them.

    Parameters
    ----------
    question
        The job, the machine, what is asked of them, and how to plan.
    words
        The options that a command of the shell needs to ask for the same plan, as typed.
    low, high, band
        Texts of the options; None where they were not given.
    until
        When the search has to come to an answer.
    out
        Where the move list of the fastest is written; None to write none.
    mismatch, report
        Whether to search at the ends of the tolerances as well; the folder of pictures.
    json
        Whether a machine reads the answer.
    """

    question: Question
    words: Mapping[str, str | Path | None]
    low: str | None
    high: str | None
    until: Until
    band: str | None
    out: Path | None
    mismatch: bool
    report: Path | None
    json: bool

    @property
    def file(self) -> Path:
        """The file of the job."""
        return self.question.file

    @property
    def job(self) -> Job:
        """The job in it."""
        return self.question.job

    @property
    def machine(self) -> Machine:
        """The machine that plans are made for."""
        return self.question.machine

    @property
    def actual(self) -> Machine | None:
        """The machine that runs them; None where it is the same."""
        return self.question.actual

    @property
    def spec(self) -> Spec:
        """What is asked, with ``margin`` kept free."""
        return self.question.spec

    @property
    def margin(self) -> float:
        """Share of every limit to keep free."""
        return self.question.margin

    @property
    def options(self) -> Options:
        """How to plan."""
        return self.question.options

    @property
    def trials(self) -> Trials:
        """Which runs every verdict is made of."""
        return self.question.trials

    @property
    def title(self) -> str:
        """Job and machine."""
        return f"{self.job.name} on {self.machine.name}"
