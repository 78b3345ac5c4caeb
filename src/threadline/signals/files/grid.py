"""The even grid on which the instants of a trace lie."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from math import floor

from threadline.errors import Place, RecordingError

JITTER = 0.05
"""Largest distance of an instant from the grid, as a share of the period; a trace with a larger one
is refused and not resampled."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Instants ``(first + k) * period_s`` for the rows k = 0 ... rows - 1."""

    period_s: Fraction
    first: int
    rows: int


def find_grid(times_s: Iterable[tuple[int, float]], path: str) -> Grid:
    """Return the grid of a trace from its line numbers and instants.

    The period is the fraction with the least denominator that is the mean step within a tolerance.

    Raises
    ------
    RecordingError
        If there are fewer than two rows, the time does not increase, or the first instant is
        negative or between two periods.
    """
    rows, start, last = 0, 0.0, 0.0
    for number, time_s in times_s:
        if rows and time_s <= last:
            raise RecordingError(
                f"time goes from {last:.9g} s to {time_s:.9g} s, it must increase",
                place=Place(path, number),
                remedy="Sort the rows, and take out doubled ones.",
            )
        if not rows:
            start = time_s
        rows, last = rows + 1, time_s
    if rows < 2:
        raise RecordingError(
            f"the trace has {rows} row(s), at least 2 are needed", place=Place(path)
        )
    mean_s = (last - start) / (rows - 1)
    # The grid may miss the last instant by a thousandth of what is allowed, no more.
    slack = Fraction(JITTER * mean_s / 1000.0) / (rows - 1)
    period_s = simplest_between(Fraction(mean_s) - slack, Fraction(mean_s) + slack)
    first = round(Fraction(start) / period_s)
    if first < 0 or abs(Fraction(start) / period_s - first) > JITTER:
        raise RecordingError(
            f"the trace begins at {start:.9g} s, which is not a whole number of its periods "
            f"of {float(period_s):.9g} s after 0",
            place=Place(path),
            remedy="Let time begin at 0, where the job begins.",
        )
    return Grid(period_s, first, rows)


def check_on_grid(time_s: float, tick: int, period_s: Fraction, stride: int, place: Place) -> None:
    """Refuse an instant that is more than ``JITTER`` of a step away from that of ``tick``."""
    step_s = float(period_s) * stride
    expected_s = tick * float(period_s.numerator) / float(period_s.denominator)
    if not abs(time_s - expected_s) <= JITTER * step_s:
        raise RecordingError(
            f"the row is at {time_s:.9g} s, expected {expected_s:.9g} s with an even period of "
            f"{step_s:.9g} s; at most {JITTER:.0%} of a period may be between them",
            place=place,
            remedy="Record at a fixed rate, or resample the trace; a row may be missing.",
        )


def simplest_between(low: Fraction, high: Fraction) -> Fraction:
    """Return the fraction with the smallest denominator in ``low ... high``, both above 0.

    >>> simplest_between(Fraction(49999, 10**7), Fraction(50001, 10**7))
    Fraction(1, 200)

    Notes
    -----
    Continued fractions of both ends agree up to the term where the simplest one ends
    (Stern-Brocot tree).
    """
    terms = []
    while True:
        whole = floor(low)
        if whole == low or whole + 1 <= high:
            terms.append(whole if whole == low else whole + 1)
            break
        terms.append(whole)
        low, high = 1 / (high - whole), 1 / (low - whole)
    result = Fraction(terms.pop())
    while terms:
        result = terms.pop() + 1 / result
    return result
