"""A run that ended before its last row proves nothing beyond it; late rows are reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from threadline.files import ChannelKind, Event
from threadline.verdict import Criterion, Status, closing, judge, verdict_json
from threadline.verdict.coverage import not_beyond
from threadline.verdict.types import Result

from .builders import follow, plan_through, record, spec_of

XY = ("X", "Y")
POINTS = [[0.0, 0.0], [0.1, 0.05], [0.0, 0.0]]
SPEC = spec_of(
    Criterion(name="tracking_error", limit=1e-3),
    Criterion(name="current_peak", limit=1.0),
    Criterion(name="path_deviation", limit=1.0),
)


class Once:
    """Blocks of a live machine, which can be read only once."""

    def __init__(self, blocks) -> None:
        self._left = [*blocks]

    def __iter__(self):
        assert self._left is not None, "read twice"
        left, self._left = self._left, None
        return iter(left)


def run(*events: Event, amperes: float = 0.5, once: bool = False):
    """Judge a run with these events in its last block."""
    commanded, operation = follow(POINTS, 20)
    columns = {
        ChannelKind.COMMANDED: commanded,
        ChannelKind.LOAD: commanded.copy(),
        ChannelKind.CURRENT: np.full_like(commanded, amperes),
    }
    recording = record(XY, columns, operation)
    *before, last = recording
    blocks = [*before, replace(last, events=(*last.events, *events))]
    recording = replace(recording, blocks=Once(blocks) if once else blocks)
    plan = plan_through(POINTS, XY)
    return judge([recording], plan, SPEC), plan


@pytest.mark.parametrize("once", [False, True])
def test_a_run_that_came_to_its_end_passes_and_so_does_one_that_does_not_say(once) -> None:
    for events in ((), (Event(tick=9, kind="completed", operation=1),)):
        verdict, _ = run(*events, once=once)
        assert verdict.passed and not verdict.incomplete
        assert closing(verdict).startswith("IN SPEC") and "late" not in closing(verdict)


@pytest.mark.parametrize("once", [False, True])
@pytest.mark.parametrize("kind", ["stopped", "fault"])
def test_criteria_of_an_incomplete_run_are_not_measured(kind, once) -> None:
    """Criteria of the plan keep their results; no other criterion passes, required or not."""
    verdict, plan = run(Event(tick=9, kind=kind, operation=1, name="the link is gone"), once=once)
    assert not verdict.passed
    for axis in XY:
        lost = verdict.result("tracking_error", axis)
        assert lost.status is Status.NOT_MEASURED and lost.measured is None
        assert f"ended in operation 1, {kind}: the link is gone (0 m until then)" in lost.note
    assert verdict.result("path_deviation").status is Status.PASSED
    assert closing(verdict).startswith("NOT PROVEN (nominal: 1 run): the run ended in operation 1")
    assert verdict_json(verdict, plan)["incomplete"] == verdict.incomplete


def test_a_share_is_told_in_per_cent() -> None:
    """A share has no unit in SI, and a bare number would be unclear."""
    entry = {"name": "over_level", "axis": "", "measured": 0.05, "limit": 0.1, "unit": ""}
    used = Result(**entry, status=Status.PASSED)
    assert not_beyond(used, "it ended").note == "it ended (5 % until then)"


def test_a_run_that_ended_in_no_operation_names_none() -> None:
    """A controller that stopped without saying where leaves operation -1."""
    verdict, _ = run(Event(tick=9, kind="stopped", operation=-1, name="asked"))
    assert "the run ended, stopped: asked" in closing(verdict)
    verdict, _ = run(Event(tick=9, kind="stopped", operation=-1, name="stopped by the operator"))
    assert closing(verdict).endswith("the run ended, stopped by the operator")  # named once


def test_failure_before_a_fault_stays_failed() -> None:
    verdict, _ = run(Event(tick=9, kind="fault", operation=1), amperes=2.0)
    assert verdict.result("current_peak").status is Status.FAILED
    assert closing(verdict).startswith("OUT OF SPEC")


def test_late_rows_are_told() -> None:
    late = Event(tick=3, kind="late", operation=0, value=4.0)
    verdict, plan = run(late, late, Event(tick=9, kind="completed", operation=1))
    assert verdict.passed and verdict.late_ticks == 8
    assert closing(verdict).startswith("IN SPEC") and "8 ticks late" in closing(verdict)
    assert verdict_json(verdict, plan)["late_ticks"] == 8
