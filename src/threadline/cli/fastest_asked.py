"""What ``threadline fastest`` was asked: the question as typed, before a job's pace is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from threadline.jobs import Job
from threadline.machine import Machine
from threadline.options import Options
from threadline.pipeline import Trials
from threadline.search.until import Until
from threadline.verdict import Spec


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """The options of ``threadline fastest``, read as far as every job understands them.

    Parameters
    ----------
    file, job
        The file, and the job in it.
    machine, actual
        The machine that plans are made for; the one that runs them, None where it is the same.
    spec, margin
        What is asked, with ``margin``, a share of every limit, kept free.
    options
        How to plan.
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
    trials
        Which runs every verdict is made of.
    json
        Whether a machine reads the answer.
    """

    file: Path
    job: Job
    machine: Machine
    actual: Machine | None
    spec: Spec
    margin: float
    options: Options
    words: Mapping[str, str | Path | None]
    low: str | None
    high: str | None
    until: Until
    band: str | None
    out: Path | None
    mismatch: bool
    report: Path | None
    trials: Trials
    json: bool

    @property
    def title(self) -> str:
        """Job and machine."""
        return f"{self.job.name} on {self.machine.name}"
