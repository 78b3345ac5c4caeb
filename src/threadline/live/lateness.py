"""Time that passes unseen: the guard of late ticks, and a clock that counts sleep."""

from __future__ import annotations

import sys
import time

LATE_IN_A_ROW = 3
LATE_PERIODS = 5.0
"""A fault is this number of consecutive late reports, and a report late by this number of periods.
"""
# Python's monotonic clock stands while Linux or macOS sleep. What macOS calls monotonic does not.
_COUNTS_SLEEP: int | None = getattr(time, "CLOCK_BOOTTIME", None)
if _COUNTS_SLEEP is None and sys.platform == "darwin":
    _COUNTS_SLEEP = time.CLOCK_MONOTONIC


def clock_s() -> float:
    """Return seconds of a clock that never goes back, the same in all processes.

    It goes on while the computer sleeps, on Linux and macOS. On other systems it may stand then: a
    silence is told by the time for which the computer was awake.
    """
    return time.monotonic() if _COUNTS_SLEEP is None else time.clock_gettime(_COUNTS_SLEEP)


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
