"""HAL's answers are compared with the sent records, and a silent HAL is a fault.

A stand-in plays HAL, so that it can fail in ways in which HAL never should: it commands its drives
something else.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
import pytest

from tests.live.bench import table_of_counts, there_and_back, winder
from threadline.live.ahead import Ahead
from threadline.live.hal_rows import HalRows
from threadline.live.hal_session import HalSession, Samples
from threadline.live.wire import Message

TICKS = 12
ZERO = np.zeros(3, dtype=np.int64)


class Played:
    """Stand-in for a running HAL: it plays each record as sent, or as changed by ``measure``."""

    def __init__(self, measure: Callable[[np.ndarray], np.ndarray]) -> None:
        self._measure, self.end, self.lost = measure, 0, 0
        self._taken, self._places = 0, np.zeros((0, 3))
        self.alive = True

    def fill(self) -> None:
        self._reach(self._taken + 100)

    def _reach(self, end: int) -> None:
        last = self._places[-1:] if len(self._places) else np.zeros((1, 3))
        self._places = np.vstack([self._places, np.repeat(last, max(end - self.end, 0), axis=0)])
        self.end = len(self._places)

    def replace(self, first: int, positions: np.ndarray) -> bool:
        self._reach(first + len(positions))
        self._places[first:] = positions[-1]
        self._places[first : first + len(positions)] = positions
        return True

    def samples(self) -> Samples:
        until = self._taken + (TICKS if self.alive else 0)
        numbers, self._taken = np.arange(self._taken, until), until
        measured = self._measure(self._places[numbers])
        return Samples(numbers, np.full(len(numbers), 0.005), measured, measured)


def heard(hal: Played, reports: int, after: Callable[[], None] = lambda: None) -> list[Message]:
    """Begin a run, and return the commanded counts in a number of reports."""
    reported: list[Message] = []
    rows = HalRows(winder(), ZERO, reported.append, cast(HalSession, hal), plant=False)
    for kind in ("enable", "home", "begin"):
        rows.take(Message(kind))
    rows.take(Ahead(table_of_counts(there_and_back()), winder()).extend(60))
    for _ in range(20):  # the records before the run rest
        rows.go_on(0.06)
        if len([one for one in reported if one.kind == "report"]) >= reports:
            break
        if rows.tick:
            after()
    return [one for one in reported if one.kind == "report"]


def faults(reports: list[Message]) -> list[str]:
    return [event[3] for one in reports for event in one.head["events"] if event[1] == "fault"]


def test_rows_reported_by_hal_as_sent_raise_no_fault() -> None:
    reports = heard(Played(lambda places: places), 4)
    assert faults(reports) == []
    x = np.concatenate([one.arrays["X.commanded"] for one in reports])
    sent = np.cumsum(there_and_back()[:, 1])[: len(x) - 1]
    assert len(x) >= 3 * TICKS
    np.testing.assert_array_equal(np.rint(x[1:] * winder().counts_per_unit[1]), sent)


def test_a_count_that_was_not_sent_is_a_fault() -> None:
    """One count of one axis is wrong from some place on."""
    reports = heard(Played(lambda places: places + (places[:, 1:2] > 20) * [0, 0, 1]), 6)
    assert faults(reports) == ["HAL's commands to the drives differ from the sent rows by 1 counts"]


@pytest.mark.parametrize("dies", ["at once", "in motion"])
def test_a_hal_that_is_silent_is_a_fault(dies: str) -> None:
    """At the sixth look, with 60 ms between two looks, HAL was silent for 0.3 s."""
    hal = Played(lambda places: places)

    def die() -> None:
        hal.alive = False

    hal.alive = dies != "at once"
    assert faults(heard(hal, 20, die)) == ["HAL's thread has stood still for 0.4 s"]
