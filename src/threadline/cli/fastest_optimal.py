"""Output of ``threadline fastest`` for ``optimal``: the plans proved, their choices and limits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from threadline.base.option_defaults import NO_CONTOUR
from threadline.cli.fastest_output import SearchOutput
from threadline.cli.search_text import limit_words, margin_words, typed
from threadline.proof.option_words import reserve_words, share_words
from threadline.proof.options import Options
from threadline.report.document import Printed
from threadline.report.figures import binding_lines, binding_of
from threadline.search import Candidate, FastestJob
from threadline.search.by_pace import Answer


class OptimalOutput(SearchOutput):
    """Output of a search over allowances: the fastest plan in spec, and its limits."""

    of: FastestJob

    def __init__(self, found: Answer, title: str) -> None:
        super().__init__(found, title)
        self._bound = binding_of(found.plan())

    def _table(self) -> Printed:
        if self.of.best.options is not None:
            return self._chosen()
        rows = [
            [
                _allowance(candidate),
                "" if candidate.duration_s is None else f"{candidate.duration_s:.3f}",
                _outcome(candidate),
            ]
            for candidate in self.of.candidates
        ]
        by_share = self.of.best.contour_m is None
        header = ["acceleration limits used" if by_share else "contour mm", "job s", "verdict"]
        how = f"{self.how}, optimal{margin_words(self.question.margin)}"
        return f"{how}: plans proved", header, rows

    def _chosen(self) -> Printed:
        """Return a table of the plans that were the best so far."""
        rows, best_s = [], math.inf
        shares_differ = any(candidate.share != 1.0 for candidate in self.of.candidates)
        for candidate in self.of.candidates:
            if (
                candidate.duration_s is None
                or candidate.duration_s >= best_s
                or candidate.options is None
            ):
                continue
            best_s = candidate.duration_s
            options = candidate.options
            shares = [share_words(candidate.share)] if shares_differ else []
            rows.append(
                [
                    f"{best_s:.3f}",
                    *shares,
                    typed(round(options.tolerance_m * 1e3, 6)),
                    typed(round(options.outside_m * 1e3, 6)),
                    str(len(options.narrow)),
                    "" if options.reserve is None else reserve_words(options.reserve),
                    "" if options.feed_forward_s is None else typed(options.feed_forward_s * 1e3),
                    typed(round(options.allowance_m * 1e3, 6)),
                ]
            )
        header = [
            "job s",
            *(["limits used"] if shares_differ else []),
            "tolerance mm",
            "outside mm",
            "narrow",
            "reserve",
            "smoothing ms",
            "contour mm",
        ]
        how = f"{self.how}, optimal{margin_words(self.question.margin)}"
        return f"{how}: the best plans so far", header, rows

    def _lines(self) -> Iterator[str]:
        best, proved = self.of.best, len(self.of.candidates)
        if best.duration_s is None:
            yield f"no plan is in spec ({proved} proved): the nearest fails {best.found.limited_by}"
            return
        yield (
            f"fastest: {best.duration_s:.3f} s, limited by {limit_words(best.found.limited_by)}; "
            f"{proved} plans proved"
        )
        if self.of.left:
            yield (
                f"unsearched: up to {self.of.left} further choices of a plan, some plans for "
                'each; --within "2 h" continues the search'
            )
        if any(candidate.isolated for candidate in self.of.candidates):
            yield "alone: the plan for an allowance smaller by half a percent is out of spec"
        for bound in self.of.bounds:
            excess = best.duration_s / bound.duration_s - 1.0
            bound_text = f"{bound.duration_s:.3f} s ({excess:+.0%})"
            yield f"within the limits of {bound.within} alone: {bound_text}"

    def _after(self) -> Iterator[str]:
        yield from () if self._bound is None else binding_lines(self._bound)

    def _page(self, folder: Path) -> Path | None:
        return self._proved(folder)  # without a passed plan, the closest one shows the failures

    def _details(self) -> dict[str, Any]:
        best = self.of.best
        return {
            "duration_s": best.duration_s,
            "bounds": [{"within": b.within, "duration_s": b.duration_s} for b in self.of.bounds],
            "binds": {} if self._bound is None else self._bound.binds,
            "unsearched": self.of.left,
            "rungs": [
                {
                    "duration_s": candidate.duration_s,
                    "limited_by": None
                    if candidate.duration_s is not None
                    else candidate.found.limited_by,
                    "alone": candidate.isolated,
                    **_allowed(candidate),
                }
                for candidate in self.of.candidates
            ],
            **_allowed(best),
        }


def _allowed(candidate: Candidate) -> dict[str, Any]:
    contour_m = candidate.contour_m
    return {
        "limits": candidate.share,
        "contour_m": None if contour_m is None or math.isinf(contour_m) else contour_m,
        **_choices(candidate.options),
    }


def _choices(options: Options | None) -> dict[str, Any]:
    """Return the choices of a plan, where all of them were searched."""
    if options is None:
        return {}
    reserve = options.reserve
    return {
        "tolerance_m": options.tolerance_m,
        "outside_m": options.outside_m,
        "narrow_m": {str(line): width for line, width in options.narrow},
        "reserve": None
        if reserve is None
        else {"volts": reserve.volts, "current": reserve.current},
        "feed_forward_s": options.feed_forward_s,
    }


def _outcome(candidate: Candidate) -> str:
    if candidate.duration_s is None:
        return f"OUT: {candidate.found.limited_by}"
    return "in spec, alone" if candidate.isolated else "in spec"


def _allowance(candidate: Candidate) -> str:
    if candidate.contour_m is None:
        return share_words(candidate.share)
    return (
        NO_CONTOUR
        if math.isinf(candidate.contour_m)
        else typed(round(candidate.contour_m * 1e3, 6))
    )
