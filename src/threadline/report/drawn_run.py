"""Choice of the run that a figure shows: the one with the worst value of a criterion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from threadline.pipeline import Proof
from threadline.signals import Recording
from threadline.verdict import Result, Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnRun:
    """The run that a figure shows.

    Parameters
    ----------
    recording
        Recording of this run alone.
    number
        Its number, as in ``Result.run``: from 1, runs of other machines last.
    worst_of
        The criterion that is worst in this run; empty where no run is worse than another, and the
        first one is drawn.
    """

    recording: Recording
    number: int
    worst_of: str

    def words(self, proof: Proof) -> str:
        """Return the sentence for a caption; empty where only one run was judged."""
        if len(proof.judged) == proof.judged[0].runs == 1:
            return ""
        why = f", in which {self.worst_of} is worst" if self.worst_of else ""
        return f" Drawn is {run_words(proof.verdict, self.number)}{why}."


def run_words(verdict: Verdict, number: int) -> str:
    """Return the name of a run in a caption: a run of the machine, or a machine in tolerance."""
    if number <= verdict.runs:
        return f"run {number} of {verdict.runs}"
    return f"machine {number - verdict.runs} of {verdict.machines} within the tolerances"


def drawn_run(proof: Proof, names: Sequence[str]) -> DrawnRun:
    """Return the run that is worst in the first of the criteria in which runs differ.

    Parameters
    ----------
    names
        Criteria that the figure marks or shows, the most important first.
    """
    for name in names:
        worst = worst_result(proof.verdict, name)
        if worst is not None and worst.run is not None:
            return DrawnRun(recording=proof.run(worst.run), number=worst.run, worst_of=name)
    return DrawnRun(recording=proof.recording, number=1, worst_of="")


def worst_result(verdict: Verdict, name: str) -> Result | None:
    """Return the result of ``name`` that is nearest to, or furthest over, its limit."""
    results = [
        r
        for r in verdict.results
        if r.name == name and r.measured is not None and r.time_s is not None
    ]
    if not results:
        return None
    return max(results, key=lambda r: abs(r.measured or 0.0) / (r.limit or 1.0))
