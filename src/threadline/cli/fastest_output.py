"""Output of ``threadline fastest``: as text, as JSON content, and as a report.

``SearchOutput`` is the part common to all searches; each kind of search adds its table and lines.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from threadline.cli.output import print_table, say
from threadline.cli.search_text import (
    END,
    VELOCITY_LIMITS,
    certainty_words,
    forbidden_words,
    isolated_words,
    limit_words,
    margin_words,
    merged,
    resolution_words,
    settings_words,
    show_mismatch,
    typed,
    until_words,
)
from threadline.commands.plan import Following
from threadline.jobs.feed_times import dwells_s
from threadline.jobs.operations import FeedMode
from threadline.proof.option_words import share_words
from threadline.proof.pipeline import prove_plan
from threadline.proof.recorded import tolerance_warnings
from threadline.report.document import Printed
from threadline.report.proof import write_report
from threadline.search import Fastest, FastestJob
from threadline.search.by_pace import Answer
from threadline.search.fastest import RANGE
from threadline.search.feed_ranges import joined
from threadline.search.report_data import report_data
from threadline.search.shaft import FastestShaft
from threadline.verdict import Verdict, closing, criteria_json, verdict_rows
from threadline.verdict.rendering import tolerances_json


class SearchOutput(ABC):
    """Output of a search: the common part.

    Parameters
    ----------
    found
        The answer.
    title
        Name of job and machine.
    """

    on_ticks = True
    """Whether the printed ``prove`` command names an interpolation."""

    def __init__(self, found: Answer, title: str) -> None:
        self.found, self.question, self.of = found, found.question, found.of
        self.title = f"{title}{margin_words(found.question.margin)}"
        self.how = title
        self.as_found: str | None = None
        """The command that writes a file for the firmware with the answer."""
        self.faster: str | None = None
        """The same command with corners rounded."""

    def warnings(self) -> list[str]:
        """Return warnings about the best plan."""
        return tolerance_warnings(self.found.plan()) if self._warns() else []

    def _warns(self) -> bool:
        """Whether the best plan may deviate from the programmed path by more than the tolerance."""
        return False

    @abstractmethod
    def _table(self) -> Printed | None:
        """Return a table of all intervals in spec; None if it would be empty."""

    @abstractmethod
    def _lines(self) -> Iterator[str]:
        """Yield the lines before the verdict."""

    def _more(self) -> Iterator[Printed | str]:
        """Yield tables and lines after the verdict."""
        yield from ()

    def _after(self) -> Iterator[str]:
        """Yield lines on the settings of the machine, or on the binding limits."""
        yield from ()

    def _details(self) -> dict[str, Any]:
        """Return the JSON entries of this kind of search."""
        return {}

    def _page(self, folder: Path) -> Path | None:
        """Write the report on the best plan; return its page, None if no plan passed."""
        return self._proved(folder) if self.found.passed else None

    def _proved(self, folder: Path) -> Path:
        question = self.question
        plan = self.found.plan()
        proof = prove_plan(plan, question.spec, trials=question.trials, actual=question.actual)
        return write_report(report_data(proof), folder)

    def report(self, folder: Path) -> Path | None:
        """Write the picture of a mismatch search, if there was one; else the report."""
        found = self.found
        if not found.mismatch:
            return self._page(folder)
        from threadline.report.searches import write_mismatch  # slow to import: it draws

        title = f"{self.title}\n(nominal: one run each)"
        return write_mismatch(found.mismatch, title, found.searched, folder)

    def content(self) -> dict[str, Any]:
        """Return the answer as JSON content."""
        found = self.found
        content: dict[str, Any] = {
            "best": found.best,
            "unit": found.unit,
            "intervals": [[i.low, i.high] for i in found.intervals],
            "limited_by": found.limited_by,
            "tried": found.tried,
            "margin": self.question.margin,
            "ended": found.ended,
            "verdict": verdict_content(found.verdict),
            **self._details(),
        }
        certainty = found.certainty
        if certainty is not None:
            content["certainty"] = {
                "machines": certainty.machines,
                "best": certainty.sure,
                "alone": certainty.alone,
                "unit": certainty.unit,
                "slower": certainty.share,
            }
        if found.mismatch:
            content["mismatch"] = [
                {
                    "mass": cell.mass,
                    "stiffness": cell.stiffness,
                    "best": cell.best,
                    "intervals": [[i.low, i.high] for i in cell.intervals],
                    "limited_by": cell.limited_by,
                }
                for cell in found.mismatch
            ]
        return content

    def show(self, again: str | None, page: Path | None) -> None:
        """Print the answer, the command ``again`` that proves it, and the path of the report."""
        found = self.found
        for line in until_words(found.ended):
            say(line)
        show([self._table(), *self._lines()])
        place_text = "at the fastest" if found.best is not None else "where the search came closest"
        print_table(f"verdict {place_text}", *verdict_rows(found.verdict))
        say(closing(found.verdict))
        show(self._more())
        if found.certainty is not None:
            say(certainty_words(found.certainty))
        show(self._after())
        if found.passed:
            say(f"To prove it: {again or 'write its move list with -o FILE.toml, and prove that'}")
        if found.passed and self.faster is not None:
            say(f"For a file as fast: {self.as_found}")
            say(
                "For a faster file, its corners rounded within the tolerance (compile refuses if "
                f"that is slower): {self.faster}"
            )
        if found.mismatch:
            show_mismatch(found.mismatch, self.title, found.searched)
        if page is not None:
            say(f"Report: {page}")


def show(parts: Iterable[Printed | str | None]) -> None:
    """Print tables and lines."""
    for part in parts:
        if isinstance(part, str):
            say(part)
        elif part is not None:
            print_table(*part)


def verdict_content(verdict: Verdict) -> dict[str, Any]:
    """Return the verdict of a search as JSON content."""
    return {
        "passed": verdict.passed,
        "level": verdict.level.value,
        **tolerances_json(verdict),
        "criteria": criteria_json(verdict),
    }


def _steps(found: Fastest) -> dict[str, Any]:
    return {"alone": list(found.isolated), "step": found.step, "step_at_edges": found.near_step}


_UNITS = {
    FeedMode.FASTEST_AXIS: ("mm/s", 1e3),
    FeedMode.F_WORD: ("F", 60_000.0),
    FeedMode.OVERRIDE: ("%", 100.0),
}
"""By feed mode: unit of printed feeds, and factor from m/s."""


_MANY_DWELLS, _MOSTLY_DWELLS = 0.02, 0.5
"""Shares of the time from which the output names dwells, and from which it names them alone."""
_MUCH_LESS = 1.1  # ratio of the highest feed to ``enough`` from which the output names it


class FeedOutput(SearchOutput):
    """Output of a search over feeds and shares of the limits."""

    of: FastestJob

    def _warns(self) -> bool:
        return self.found.passed or self.question.options.following is Following.MOTOR

    def _table(self) -> Printed:
        best, (unit, per_m_s) = self.of.best, _UNITS[self.of.by]
        rows = []
        for candidate in self.of.candidates:
            for interval in candidate.found.intervals:
                first = interval is candidate.found.fastest
                rows.append(
                    [
                        share_words(candidate.share),
                        typed(interval.low * per_m_s),
                        "alone" if interval.isolated else typed(interval.high * per_m_s),
                        f"{candidate.duration_s:.3f}" if first and candidate.duration_s else "",
                        self._limit(candidate.found.limited_by, best=candidate is best)
                        if first
                        else "",
                    ]
                )
        header = ["acceleration limits used", f"from {unit}", f"to {unit}", "job s", "limited by"]
        options = self.question.options
        following = ", feed-forward" if options.following is Following.LOAD else ""
        how = f"{self.how}, {options.interpolation}{following}{margin_words(self.question.margin)}"
        return f"{how}: feeds in spec", header, merged(rows)

    @property
    def _end(self) -> str:
        return VELOCITY_LIMITS if self.question.high is None else END

    def _lines(self) -> Iterator[str]:
        best, tried, (unit, per_m_s) = self.of.best, self.found.tried, _UNITS[self.of.by]
        yield from self._judged()
        if best.found.best is None:
            forbidding = joined(
                one for candidate in self.of.candidates for one in candidate.found.forbidden
            )
            why, *more = forbidden_words(forbidding, best.found.limited_by, self._feed_text)
            yield from (f"no feed is in spec ({tried} tried): {why}", *more)
            if best.found.fixed:
                yield (
                    f"no feed below {self._feed_text(best.found.low)} was tried: "
                    f"{best.found.fixed} is above its limit by the same value at every speed"
                )
            return
        yield (
            f"fastest: {best.duration_s:.3f} s at {self._feed_text(best.found.best)} with "
            f"{share_words(best.share)} of the acceleration and jerk limits, limited by "
            f"{self._limit(best.found.limited_by)}; {tried} plans tried"
        )
        enough = self.of.enough
        if enough is not None and self._far_above_enough:
            least = self._feed_text(float(f"{1.0005 * enough:.4g}"))
            yield (
                f"{least} takes the same time within 0.1 %: above it {self._beside_feed} set the "
                "time, not the feed"
            )
        yield f"feeds {resolution_words(best.found)}"
        if best.found.isolated:
            yield isolated_words(best.found, unit, per_m_s)

    @property
    def _far_above_enough(self) -> bool:
        """Whether a much lower feed takes the same time as the highest one."""
        best, enough = self.of.best.found.best, self.of.enough
        return None not in (best, enough) and enough < best / _MUCH_LESS  # type: ignore[operator]

    def _limit(self, limited_by: str, *, best: bool = True) -> str:
        """Return the limit of the time in words; the end of the search limits only the feed."""
        if best and limited_by == RANGE and self._far_above_enough:
            return self._beside_feed
        return limit_words(limited_by, self._end)

    @property
    def _beside_feed(self) -> str:
        """The reason in words why a higher feed does not shorten the best plan."""
        share = dwells_s(self.question.job) / (self.of.best.duration_s or math.inf)
        dwells = f"dwells ({100.0 * share:.0f} % of the time)"
        if share >= _MOSTLY_DWELLS:
            return dwells
        rest = "acceleration, corners and rapid moves"
        return rest if share < _MANY_DWELLS else f"{dwells}, {rest}"

    def _feed_text(self, value: float) -> str:
        unit, per_m_s = _UNITS[self.of.by]
        number = typed(value * per_m_s)
        return f"F {number}" if self.of.by is FeedMode.F_WORD else f"{number} {unit}"

    def _judged(self) -> Iterator[str]:
        """Yield lines on the moves judged in place of the whole job, and the skipped shares."""
        result = self.of
        if result.parts:
            parts = "one stretch" if result.parts == 1 else f"{result.parts} stretches"
            yield (
                f"judged by {result.judged_moves} of {result.moves} moves, {parts}: the others "
                "repeat them"
            )
        if result.cut:
            yield "long moves were judged by their beginnings and ends"
        if result.in_one_run:
            yield (
                "the feeds of the table pass in one run of each plan"
                + (
                    "; the answer is judged at the level asked for"
                    if result.whole
                    else ", and so does the answer: prove it by the command below"
                )
            )
        if result.left_out:
            left_out = ", ".join(share_words(share) for share in result.left_out)
            yield (
                f"left out: {left_out} of the limits: even at the highest feed the job takes no "
                "less time with them"
            )
        if (result.parts or result.cut) and not result.whole:
            yield (
                "the whole job was not judged: the verdict is the worst of the judged stretches, "
                "with times from the beginning of a stretch; prove the job by the command below"
            )

    def _after(self) -> Iterator[str]:
        yield from settings_words(self.question.job, self.question.machine, self.of)

    def _details(self) -> dict[str, Any]:
        result = self.of
        by_word = result.by is FeedMode.F_WORD
        return {
            **_steps(result.best.found),
            "feed": self.question.job.feed_rule if by_word else result.by.value,
            "limits": result.best.share,
            "duration_s": result.best.duration_s,
            "dwells_s": dwells_s(self.question.job),
            "enough": result.enough,
            "moves": result.moves,
            "judged_moves": result.judged_moves,
            "parts": result.parts,
            "long_moves_cut": result.cut,
            "limits_left_out": list(result.left_out),
            "whole_job_judged": result.whole,
            "searched_in_one_run": result.in_one_run,
            "rungs": [
                {
                    "limits": candidate.share,
                    "duration_s": candidate.duration_s,
                    "intervals": [[i.low, i.high] for i in candidate.found.intervals],
                    "limited_by": candidate.found.limited_by,
                }
                for candidate in result.candidates
            ],
        }


class NeedleOutput(SearchOutput):
    """Output of a search over needle speeds."""

    of: Fastest

    def _warns(self) -> bool:
        return self.found.passed

    def _table(self) -> Printed | None:
        rows = [[typed(i.low), "alone" if i.isolated else typed(i.high)] for i in self.of.intervals]
        if not rows:
            return None
        return f"{self.title}: needle speeds in spec", ["from stitch/s", "to stitch/s"], rows

    def _lines(self) -> Iterator[str]:
        found = self.of
        if found.best is None:
            why, *more = forbidden_words(
                found.forbidden, found.limited_by, lambda speed: f"{typed(speed)} stitch/s"
            )
            yield from (f"no needle speed is in spec ({found.tried} tried): {why}", *more)
            return
        yield (
            f"fastest: {typed(found.best)} stitch/s, limited by {limit_words(found.limited_by)}; "
            f"{found.tried} plans tried"
        )
        yield f"needle speeds {resolution_words(found)}"
        if found.isolated:
            yield isolated_words(found, "stitch/s")

    def _details(self) -> dict[str, Any]:
        return _steps(self.of)


_MINUTE = 60.0


class ShaftOutput(SearchOutput):
    """Output of a search over shaft speeds: a constant speed, and a speed for each stitch."""

    of: FastestShaft
    on_ticks = False

    def _table(self) -> Printed:
        constant = self.of.constant
        rows = [
            [
                f"{i.low * _MINUTE:.2f}",
                "alone" if i.isolated else f"{i.high * _MINUTE:.2f}",
                "begins where the search did: --low for slower ones"
                if i.low == constant.low
                else "",
            ]
            for i in constant.intervals
        ]
        header = ["from stitch/min", "to stitch/min", "note"]
        return f"{self.title}: constant speeds in spec", header, rows

    def _lines(self) -> Iterator[str]:
        found, constant = self.of, self.of.constant
        if constant.best is None:
            yield f"no constant speed is in spec: {limit_words(found.limited_by)}"
        else:
            yield (
                f"fastest constant speed: {constant.best * _MINUTE:.2f} stitch/min, "
                f"{found.constant_s:.4g} s, limited by {limit_words(found.limited_by)}; "
                f"{resolution_words(constant)}"
            )
        if constant.isolated:
            yield isolated_words(constant, "stitch/min", _MINUTE)
        if found.schedule is not None:
            yield (
                f"fastest with a speed for each stitch: {found.schedule.plan.duration_s:.4g} s, "
                f"planned for a swing of {found.tolerance_m * 1e3:.4g} mm"
            )

    def _details(self) -> dict[str, Any]:
        found = self.of
        schedule = None
        if found.schedule is not None:
            schedule = {
                "duration_s": found.schedule.plan.duration_s,
                "tolerance_m": found.tolerance_m,
                "criteria": criteria_json(found.schedule.verdict),
            }
        return {
            **_steps(found.constant),
            "intervals_unit": "stitch/s",
            "constant_s": found.constant_s,
            "schedule": schedule,
        }
