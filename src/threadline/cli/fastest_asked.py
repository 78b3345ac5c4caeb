"""What ``threadline fastest`` was asked: the question, and how its answer is told."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from threadline.cli.found import limit_words, typed
from threadline.cli.output import check_outputs, print_table
from threadline.commands.plan import Plan
from threadline.errors import OptionError
from threadline.jobs import Job
from threadline.machine import Machine
from threadline.machine.vary import ends_of
from threadline.proof.options import Options
from threadline.proof.pipeline import Trials, prove_plan
from threadline.report import write_report
from threadline.search.by_pace import Question
from threadline.search.mismatch import Mismatch, Searched
from threadline.search.studied import studied
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


Search = Callable[[Options, Trials], tuple[float | None, float | None]]
"""Searches with options and trials; returns the best speed and how long the job takes at it, s,
each None where there is none or it is not known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Certainty:
    """The fastest on all machines at the ends of the tolerances, and that of the file's alone.

    Parameters
    ----------
    machines
        How many the plan is for, that of the file among them.
    sure, alone
        Best speeds, or durations in s, of both searches; None where none is in specification.
    unit
        Of both.
    share
        By how much the speed falls, or the duration grows; None where one of them has no best.
    """

    machines: int
    sure: float | None
    alone: float | None
    unit: str
    share: float | None

    def line(self) -> str:
        """Say it for people."""
        both = [
            "none" if best is None else f"{typed(best)} {self.unit}"
            for best in (self.sure, self.alone)
        ]
        change = "" if self.share is None else f": {abs(self.share):.1%} slower"
        return (
            f"what certainty costs: {both[0]} on all {self.machines} machines, {both[1]} planned "
            f"and judged for the machine as its file says{change}"
        )

    def json(self) -> dict[str, Any]:
        """Return it as JSON content."""
        return {
            "certainty": {
                "machines": self.machines,
                "best": self.sure,
                "alone": self.alone,
                "unit": self.unit,
                "slower": self.share,
            }
        }


def certainty_of(
    asked: Asked, found: tuple[float | None, float | None], unit: str, search: Search
) -> Certainty | None:
    """Search once more for the machine of the file alone; None where no ends were asked for.

    Parameters
    ----------
    found
        Best speed and duration of the search over the ends.
    unit
        Of the speed; where durations are known they are compared, in s.
    """
    if asked.trials.ends is None:
        return None
    options = asked.options
    if options.robust_share is not None:
        options = replace(options, robust_share=0.0)
    alone = search(options, replace(asked.trials, ends=None))
    timed = found[1] is not None or alone[1] is not None
    sure, best = (found[1], alone[1]) if timed else (found[0], alone[0])
    share = None
    if sure is not None and best is not None:
        share = sure / best - 1.0 if timed else 1.0 - sure / best
    machine = asked.machine if asked.actual is None else asked.actual
    return Certainty(
        machines=1 + len(ends_of(machine, asked.trials.ends)),
        sure=sure,
        alone=best,
        unit="s" if timed else unit,
        share=share,
    )


ABOVE = 1.1
"""Highest feed that is tried, over the nominal best: other machines are rarely faster."""


def check_mismatch(mismatch: bool, actual: bool, report: Path | None) -> None:
    """Refuse --mismatch beside --actual, and a folder that no report can be written into.

    Raises
    ------
    OptionError
        If the options do not go together, or the report cannot be written.
    """
    if mismatch and actual:
        raise OptionError("--mismatch and --actual exclude each other", remedy="Give one of them.")
    check_outputs(folder=report)


def drawn_of(
    cells: Sequence[Mismatch], title: str, searched: Searched, asked: Asked
) -> Path | None:
    """Return the picture of a search over tolerances; None where nothing is drawn."""
    if asked.report is None or not asked.mismatch:
        return None
    from threadline.report.searches import write_mismatch  # slow to import: it draws

    return write_mismatch(cells, f"{title}\n(nominal: one run each)", searched, asked.report)


def report_of(plan: Plan, asked: Asked, spec: Spec | None = None) -> Path | None:
    """Prove the fastest again, and return the page of its report; None where none is asked for."""
    if asked.report is None:
        return None
    proof = prove_plan(plan, spec or asked.spec, trials=asked.trials, actual=asked.actual)
    return write_report(studied(proof), asked.report)


def mismatch_json(cells: list[Mismatch], drawn: Path | None) -> dict[str, Any]:
    """Return a search over tolerances as JSON content; nothing where there was none."""
    found = [
        {
            "mass": cell.mass,
            "stiffness": cell.stiffness,
            "best": cell.best,
            "intervals": [[i.low, i.high] for i in cell.intervals],
            "limited_by": cell.limited_by,
        }
        for cell in cells
    ]
    told: dict[str, Any] = {"mismatch": found} if found else {}
    return told | ({} if drawn is None else {"report": str(drawn)})


def show_mismatch(cells: list[Mismatch], title: str, searched: Searched) -> None:
    """Print the fastest for masses and stiffnesses at the ends of their tolerances."""
    names = {-1.0: "lower end", 0.0: "as in the file", 1.0: "upper end"}
    ranges = any(cell.intervals for cell in cells)
    rows = [
        [
            names[cell.mass],
            names[cell.stiffness],
            "none" if cell.best is None else f"{searched.per_unit * cell.best:.2f}",
            *([_in_spec(cell, searched)] if ranges else []),
            limit_words(cell.limited_by),
        ]
        for cell in cells
    ]
    best = f"{searched.best} {searched.unit}"
    all_of = [f"in spec {searched.unit}"] if ranges else []
    header = ["mass of loads", "stiffness of springs", best, *all_of, "limited by"]
    print_table(
        f"{title}: planned for the file, {searched.done} off its tolerances, one run each",
        header,
        rows,
    )


def _in_spec(cell: Mismatch, searched: Searched) -> str:
    """Return all that is in spec of what was tried: beneath the fastest there may be a gap."""
    scale = searched.per_unit
    return ", ".join(
        f"{scale * one.low:.2f}"
        if one.low == one.high
        else f"{scale * one.low:.2f} to {scale * one.high:.2f}"
        for one in sorted(cell.intervals, key=lambda one: one.low)
    )
