"""Limits of velocity and acceleration that a part program sets for the moves after a line."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from threadline.base.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitChange:
    """Limits that a line sets anew; None leaves a limit as it is.

    Parameters
    ----------
    velocity_m_s, acceleration_m_s2
        Largest velocity and acceleration along X, Y and Z.
    corner_m_s
        Speed through a corner of 90 degrees.
    cruise_ratio
        Least share of a move at constant speed, in [0, 1).
    """

    velocity_m_s: float | None = None
    acceleration_m_s2: float | None = None
    corner_m_s: float | None = None
    cruise_ratio: float | None = None


LIMITS = tuple(field.name for field in fields(LimitChange))


@dataclass(frozen=True, slots=True, eq=False)
class ProgramLimits:
    """The limits that a program has set, by the operation from which they hold.

    Parameters
    ----------
    since
        (k,) first operation for which each row holds, not decreasing.
    values
        (k, 4) values of ``LIMITS`` in SI; NaN where the program has not set the limit.
    """

    since: IntArray
    values: FloatArray

    def at(self, operation: IntArray) -> FloatArray:
        """Return the (n, 4) limits in force in (n,) operations, NaN for the machine's own."""
        row = np.searchsorted(self.since, operation, side="right")
        return np.vstack((np.full((1, len(LIMITS)), np.nan), self.values))[row]


class GrowingLimits:
    """Collects the changes of limits of a job in the order of its operations."""

    def __init__(self) -> None:
        self._now = np.full(len(LIMITS), np.nan)
        self._since: list[int] = []
        self._values: list[FloatArray] = []

    def take(self, change: LimitChange, operation: int) -> None:
        """Add a change that holds from an operation on."""
        changed = np.array([getattr(change, name) for name in LIMITS], dtype=np.float64)
        self._now = np.where(np.isnan(changed), self._now, changed)
        self._since.append(operation)
        self._values.append(self._now)

    def table(self) -> ProgramLimits:
        """Return the table of the changes so far."""
        values = np.array(self._values, dtype=np.float64).reshape(-1, len(LIMITS))
        return ProgramLimits(np.array(self._since, dtype=np.int64), values)
