"""Results of measures: a finding for one run; for many runs arrays, with a finding for each."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.verdict.samples import lanes
from threadline.verdict.types import Status, is_measured

Statuses = Callable[[float | None, float | None], Status]
"""Returns the status of a measured value under a limit; each may be None."""


@dataclass(frozen=True, slots=True)
class Hidden:
    """The possible error that a recording does not show between two of its samples.

    Parameters
    ----------
    channel, interval_s
        Name of a channel, and the time between two of its samples.
    most
        By how much the finding may be larger between samples, in its unit; it grows with the square
        of the interval. Infinite if samples so far apart do not show the finding at all.
    why
        The bound in words.
    enough_s
        Longest interval at which the samples show the finding; for an infinite ``most``.
    instead
        Another remedy than finer samples, in words.
    """

    channel: str
    interval_s: float
    most: float
    why: str
    enough_s: float = 0.0
    instead: str = ""

    def note(self, room: float) -> str:
        """Return the note of a criterion whose value at the samples is ``room`` below its limit."""
        allowed_s = self.enough_s
        if math.isfinite(self.most):
            allowed_s = self.interval_s * math.sqrt(max(room, 0.0) / self.most)
        return (
            f"{self.every}{self.why}; record every {1e3 * allowed_s:.3g} ms at least{self.instead}"
        )

    @property
    def every(self) -> str:
        """The channel and the time between its samples, in words."""
        return f"{self.channel} has a sample every {1e3 * self.interval_s:.4g} ms: "


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """The worst value of one measure in one run, for one axis or (``""``) the tool.

    ``value`` is None if nothing could be measured; ``note`` then gives the reason. ``step`` is the
    step of a move list. ``seen`` is the worst value of places that the recording reached, if
    ``value`` also counts places that it did not reach. ``unseen`` names the part that was not seen,
    if ``value`` is only the worst of the rest: then it can fail a limit, but not pass one.
    ``hidden`` states how much larger the value may be between two samples of a recording; ``over``
    how much too large it may be, because tool or command did not move straight between samples.
    ``typical`` is the median of all runs, for a measure of many runs together.
    """

    value: float | None
    axis: str = ""
    time_s: float | None = None
    operation: int | None = None
    job_line: int | None = None
    position: tuple[float, ...] | None = None
    note: str = ""
    step: str = ""
    seen: Finding | None = None
    unseen: str = ""
    hidden: Hidden | None = None
    over: float = 0.0
    typical: float | None = None

    def worse(self, other: Finding) -> Finding:
        """Return the worse of the same finding in two recordings.

        If only one of them was measured, its value can fail a limit but not pass it: the other's
        note goes into ``unseen``.
        """
        if self.value is None or other.value is None:
            if self.value is None and other.value is None:
                return self
            blank, known = (self, other) if self.value is None else (other, self)
            return replace(known, unseen=known.unseen or blank.note)
        larger = other if other.value > self.value else self
        hidden = [one for one in (self.hidden, other.hidden) if one is not None]
        coarsest = max(hidden, key=lambda one: one.most, default=None)
        over = max(self.over, other.over)
        return replace(larger, unseen=self.unseen or other.unseen, hidden=coarsest, over=over)

    def under(self, limit: float | None, status: Statuses) -> Finding:
        """Return the finding as it counts under a limit: if partly unseen, it can only fail.

        The same holds if the error that may be hidden between samples would take it beyond the
        limit. If it fails only by the part that may be too large, it is not measured.
        """
        if self._may_be_too_large(limit, status):
            every = "" if self.hidden is None else self.hidden.every
            note = f"{every}the excess over the limit may come from straight lines between them"
            note += "; record at each tick"
            return Finding(value=None, axis=self.axis, step=self.step, note=note)
        if not self.unseen:
            return self._between(limit, status)
        if status(self.value, limit) is Status.FAILED:
            note = "; ".join(filter(None, (self.note, self.unseen)))
            return replace(self, note=note, unseen="")
        return Finding(value=None, axis=self.axis, step=self.step, note=self.unseen)

    def _may_be_too_large(self, limit: float | None, status: Statuses) -> bool:
        """Return whether the value fails its limit only by the part that may be too large."""
        if not self.over or self.value is None or status(self.value, limit) is not Status.FAILED:
            return False
        return status(self.value - self.over, limit) is not Status.FAILED

    def _between(self, limit: float | None, status: Statuses) -> Finding:
        hidden, value = self.hidden, self.value
        if hidden is None or value is None or limit is None:
            return self
        if status(value, limit) is Status.FAILED:
            return self
        if status(value + hidden.most, limit) is not Status.FAILED:
            return self
        note = hidden.note(limit - value)
        return Finding(value=None, axis=self.axis, step=self.step, note=note)

    def in_unit(self, unit: str) -> Finding:
        """Return the finding for a verdict: NaN counts as not measured."""
        if self.value is None or is_measured(self.value, unit):
            return self
        note = "; ".join(filter(None, (self.note, "no number came of these samples")))
        return replace(self, value=None, note=note)

    def somewhere(self) -> Finding:
        """Return the finding without its place if its value is zero: no place is worst then.

        A finding of one step keeps its place, which identifies the step.
        """
        if self.value != 0.0 or self.step:
            return self
        if (self.time_s, self.operation, self.job_line, self.position) == (None,) * 4:
            return self
        return replace(self, time_s=None, operation=None, job_line=None, position=None)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunFindings:
    """Results of a measure in each of several runs, for one axis or (``""``) the tool.

    Parameters
    ----------
    value
        (runs,) NaN if nothing could be measured.
    of
        Returns the finding of a run, by its number.
    parts
        The findings that were joined, each with its unseen part; empty if none were.
    """

    axis: str = ""
    step: str = ""
    value: FloatArray
    of: Callable[[int], Finding]
    parts: tuple[RunFindings, ...] = ()

    @classmethod
    def made(cls, findings: Sequence[Finding]) -> RunFindings:
        """Return the findings of consecutive runs, all of the same axis and step, joined."""
        return _in_a_row([RunFindings.alike(finding, 1) for finding in findings])

    @classmethod
    def alike(cls, finding: Finding, runs: int) -> RunFindings:
        """Return one finding that all runs share."""
        value = np.nan if finding.value is None else finding.value
        return cls(
            axis=finding.axis,
            step=finding.step,
            value=np.full(runs, value),
            of=partial(_same, finding),
        )

    def __len__(self) -> int:
        return len(self.value)

    def each(self, function: Callable[[Finding], Finding]) -> RunFindings:
        """Return the result of applying a function to the finding of every run."""
        return RunFindings.made([function(self.of(run)) for run in range(len(self))])

    def worst(self) -> Finding:
        """Return the worst finding of all runs; of equal findings the first."""
        if len(self.value) == 1:
            return self.of(0)
        if self.parts:
            return reduce(Finding.worse, (part.worst() for part in self.parts))
        blank = np.isnan(self.value)
        if blank.all():
            return self.of(0)
        worst = self.of(int(np.nanargmax(self.value)))
        return worst.worse(self.of(int(np.argmax(blank)))) if blank.any() else worst


def sure_of(found: RunFindings, sure: FloatArray, *, unless: str) -> RunFindings:
    """Return findings that assume straight segments between samples, with their possible excess.

    Parameters
    ----------
    sure
        (runs,) values that the samples prove, whatever happens between them.
    unless
        Note of findings that do not depend on the segments.
    """
    rows = []
    for run, least in enumerate(sure.tolist()):
        one = found.of(run)
        if one.value is not None and one.note != unless:
            one = replace(one, over=max(one.value - least, 0.0))
        rows.append(one)
    return RunFindings.made(rows)


def joined(known: Sequence[RunFindings], fresh: Sequence[RunFindings]) -> list[RunFindings]:
    """Return, per axis and step, the findings of both sets of runs, joined."""
    rows: dict[tuple[str, str], list[RunFindings]] = {}
    for found in (*known, *fresh):
        rows.setdefault((found.axis, found.step), []).append(found)
    return [_in_a_row(row) for row in rows.values()]


def _in_a_row(parts: Sequence[RunFindings]) -> RunFindings:
    if len(parts) == 1:
        return parts[0]
    return RunFindings(
        axis=parts[0].axis,
        step=parts[0].step,
        value=np.concatenate([part.value for part in parts]),
        of=partial(_of_parts, tuple(parts)),
        parts=tuple(parts),
    )


def _of_parts(parts: tuple[RunFindings, ...], run: int) -> Finding:
    for part in parts:
        if run < len(part):
            return part.of(run)
        run -= len(part)
    raise IndexError(run)


def _same(finding: Finding, run: int) -> Finding:  # noqa: ARG001
    return finding


class Worst:
    """The worst value of every run so far, and its place.

    Parameters
    ----------
    runs
        Number of runs.
    axes
        Number of columns of a position.
    axis
        Axis of the values, ``""`` for the tool.
    note
        Why nothing was measured; replaced by the first value.

    Attributes
    ----------
    value
        (runs,) minus infinity before the first value.
    """

    def __init__(self, runs: int, axes: int, axis: str = "", note: str = "") -> None:
        self.axis = axis
        self.value: FloatArray = np.full(runs, -np.inf)
        self._time_s: FloatArray = np.full(runs, np.nan)
        self._operation: IntArray = np.full(runs, -1, dtype=np.int64)
        self._line: IntArray = np.full(runs, -1, dtype=np.int64)
        self._position: FloatArray = np.full((runs, axes), np.nan)
        self._note: NDArray[Any] = np.full(runs, note, dtype=object)

    def offer(
        self,
        value: FloatArray,
        *,
        time_s: FloatArray | float | None = None,
        operation: IntArray | int | None = None,
        line: IntArray | int | None = None,
        position: FloatArray | None = None,
        note: NDArray[Any] | str = "",
    ) -> None:
        """Keep each run's value if it is worse than the value so far; of equals the first stays.

        Parameters
        ----------
        value
            (runs,) values; NaN is skipped.
        time_s, operation, line, position, note
            Place of the value, the same for all runs or (runs,); the position is (axes,) or
            (runs, axes). None is an unknown place.
        """
        at = np.flatnonzero(value > self.value)
        if not len(at):
            return
        self.value[at] = value[at]
        self._time_s[at] = np.nan if time_s is None else _of(time_s, at)
        self._operation[at] = -1 if operation is None else _of(operation, at)
        self._line[at] = -1 if line is None else _of(line, at)
        if position is None:
            self._position[at] = np.nan
        else:
            self._position[at] = position if position.ndim == 1 else position[at]
        self._note[at] = _of(note, at)

    def is_beaten(self, value: FloatArray) -> bool:
        """Return whether any of (runs,) values is worse than the value so far."""
        return bool((value > self.value).any())

    def say(self, note: str) -> None:
        """Give every run without a value the reason ``note``."""
        self._note[np.isneginf(self.value)] = note

    def copy(self) -> Worst:
        """Return a copy of the present state."""
        made = object.__new__(Worst)
        made.axis = self.axis
        made.value, made._time_s = self.value.copy(), self._time_s.copy()
        made._operation, made._line = self._operation.copy(), self._line.copy()
        made._position, made._note = self._position.copy(), self._note.copy()
        return made

    def found(self, seen: Worst | None = None) -> RunFindings:
        """Return the findings; ``seen`` is the state before unreached places were counted."""
        return RunFindings(
            axis=self.axis,
            value=np.where(np.isneginf(self.value), np.nan, self.value),
            of=partial(_finding_of, self, seen),
        )

    def of(self, run: int) -> Finding:
        """Return the worst finding of one run."""
        note, value = str(self._note[run]), float(self.value[run])
        if value == -math.inf:
            return Finding(value=None, axis=self.axis, note=note)
        time_s, position = float(self._time_s[run]), self._position[run].tolist()
        operation, line = int(self._operation[run]), int(self._line[run])
        return Finding(
            value=value,
            axis=self.axis,
            time_s=None if math.isnan(time_s) else time_s,
            operation=None if operation < 0 else operation,
            job_line=None if line < 0 else line,
            position=(tuple(position) if position and all(map(math.isfinite, position)) else None),
            note=note,
        )


def _of(what: Any, at: IntArray) -> Any:
    return what[at] if isinstance(what, np.ndarray) else what


def _finding_of(worst: Worst, seen: Worst | None, run: int) -> Finding:
    finding = worst.of(run)
    return finding if seen is None else replace(finding, seen=seen.of(run))


def _largest(
    values: FloatArray, reference: FloatArray, best: FloatArray, at: IntArray, begin: int
) -> None:
    """Raise ``best`` to the largest |values - reference|, ``at`` to its first sample.

    The first of the samples has the number ``begin``; NaN is skipped.
    """
    samples, axes, runs = values.shape
    for i in range(samples):
        for a in range(axes):
            larger = 0
            for r in range(runs):
                larger += abs(values[i, a, r] - reference[i, a]) > best[a, r]
            if larger:  # seldom, after the first few samples
                for r in range(runs):
                    size = abs(values[i, a, r] - reference[i, a])
                    larger = size > best[a, r]
                    best[a, r] = size if larger else best[a, r]
                    at[a, r] = begin + i if larger else at[a, r]


def _add_squares(values: FloatArray, before: FloatArray, fresh: bool, total: FloatArray) -> None:
    """Add the mean squares of all sample intervals to ``total``, in their order.

    Between two samples a and b the value is interpolated linearly: its mean square is a third of
    a^2 + a b + b^2. ``before``, (axes, runs), is the sample before, and becomes the last sample;
    with ``fresh`` there is no sample before.
    """
    samples, axes, runs = values.shape
    for i in range(samples):
        for a in range(axes):
            for r in range(runs):
                one, two = before[a, r], values[i, a, r]
                total[a, r] += 0.0 if fresh and i == 0 else (one * one + one * two + two * two) / 3
                before[a, r] = two


def _count_beyond(
    values: FloatArray, limit: FloatArray, count: IntArray, first: IntArray, begin: int
) -> None:
    """Count samples of at least ``limit``; ``first`` becomes the number of the first of them."""
    samples, axes, runs = values.shape
    for i in range(samples):
        for a in range(axes):
            some = 0
            for r in range(runs):
                some += abs(values[i, a, r]) >= limit[a]
            if some:
                for r in range(runs):
                    beyond = abs(values[i, a, r]) >= limit[a]
                    fresh = beyond and count[a, r] == 0
                    first[a, r] = begin + i if fresh else first[a, r]
                    count[a, r] += 1 if beyond else 0


raise_to_farthest = njit(nogil=True)(_largest)
add_squares = njit(nogil=True)(_add_squares)
count_beyond = njit(nogil=True)(_count_beyond)


def largest(values: FloatArray, reference: FloatArray | None = None) -> tuple[FloatArray, IntArray]:
    """Return (axes, runs) largest sizes of (n, runs, axes) values, and the first sample of each.

    Parameters
    ----------
    reference
        (n, axes) that is subtracted from the values; None is 0. A sample that is NaN on either side
        is skipped; if none is left the size is minus infinity and the sample -1.
    """
    rows = lanes(values)
    samples, axes, runs = rows.shape
    best, at = np.full((axes, runs), -np.inf), np.full((axes, runs), -1, dtype=np.int64)
    against = np.zeros((samples, axes)) if reference is None else np.ascontiguousarray(reference)
    raise_to_farthest(rows, against, best, at, 0)
    return best, at
