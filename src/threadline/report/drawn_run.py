"""Which of the runs that were judged is drawn: that in which the marked worst was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from threadline.pipeline import Proof
from threadline.signals import Recording
from threadline.verdict import Result, Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnRun:
    """The run that a picture is of.

    Parameters
    ----------
    recording
        The run alone.
    number
        As ``Result.run`` has it: from 1, those of other machines last.
    worst_of
        The criterion of which it has the worst; empty where the first run is drawn because no run
        is worse than another.
    """

    recording: Recording
    number: int
    worst_of: str

    def words(self, proof: Proof) -> str:
        """Return the sentence that a caption says of it; empty where one run alone was judged."""
        if len(proof.judged) == proof.judged[0].runs == 1:
            return ""
        why = f", in which {self.worst_of} is worst" if self.worst_of else ""
        return f" Drawn is {run_words(proof.verdict, self.number)}{why}."


def run_words(verdict: Verdict, number: int) -> str:
    """Return the name of a run in a caption: of the machine itself, or of one off its file."""
    if number <= verdict.runs:
        return f"run {number} of {verdict.runs}"
    return f"machine {number - verdict.runs} of {verdict.machines} within the tolerances"


def drawn_run(proof: Proof, names: Sequence[str]) -> DrawnRun:
    """Return the run with the worst of the first criterion of which one run is worse than others.

    Parameters
    ----------
    names
        Criteria that the picture marks or shows, the most important first.
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
