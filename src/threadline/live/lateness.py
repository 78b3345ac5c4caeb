"""The guard of late ticks, the same for every kind of work."""

from __future__ import annotations

LATE_IN_A_ROW = 3
LATE_PERIODS = 5.0
"""A fault is this number of consecutive late reports, and a report late by this number of periods.
"""


class Lateness:
    """Counts reports that came late one after the other."""

    def __init__(self) -> None:
        self._late = 0

    def trip(self, late: bool, late_periods: float) -> str:
        """Return the text of the fault, or nothing.

        Parameters
        ----------
        late, late_periods
            Whether a report came late, and by how many of its periods.
        """
        self._late = self._late + 1 if late else 0
        if late_periods >= LATE_PERIODS:
            return f"a tick came {late_periods:.0f} periods late"
        if self._late >= LATE_IN_A_ROW:
            return f"{self._late} ticks in a row came late"
        return ""
