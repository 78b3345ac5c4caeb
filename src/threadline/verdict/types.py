"""Criteria and verdicts: what is asked of a job, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Status(StrEnum):
    """What came of a criterion."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_MEASURED = "not-measured"  # its channel is absent from the recording
    REPORTED = "reported"  # it has no limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Criterion:
    """A line of a specification.

    Parameters
    ----------
    name
        One of the measures: ``contour_error``, ``turning_point_error``, ...
    axis
        The axis that it is asked of, ``""`` for every axis or for the tool.
    limit
        Largest allowed value, SI; None where it is only reported.
    required
        The whole passes only if it was measured.
    """

    name: str
    axis: str = ""
    limit: float | None = None
    required: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """A specification: criteria with limits."""

    name: str
    criteria: tuple[Criterion, ...]
    sha256: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """A criterion and what was measured.

    Parameters
    ----------
    name, axis, limit, required
        As in the criterion; ``axis`` is filled in where one was measured.
    measured
        The worst value, SI ``unit``; None where nothing was measured.
    time_s
        When the worst value occurred, from the start of the job.
    operation, job_line
        Where in the job; None where there is no such place.
    position
        (axes,) commanded position there, m or rad, or None.
    """

    name: str
    axis: str
    measured: float | None
    limit: float | None
    unit: str
    status: Status
    required: bool = False
    time_s: float | None = None
    operation: int | None = None
    job_line: int | None = None
    position: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Every criterion's result, in the order of the specification."""

    results: tuple[Result, ...]
    simulated: bool

    @property
    def passed(self) -> bool:
        """Nothing failed, and everything required was measured."""
        return all(
            result.status is not Status.FAILED
            and not (result.required and result.status is Status.NOT_MEASURED)
            for result in self.results
        )

    def result(self, name: str, axis: str = "") -> Result:
        """Return the result of a criterion; raises KeyError if it was not judged."""
        for result in self.results:
            if result.name == name and (not axis or result.axis == axis):
                return result
        raise KeyError((name, axis))
