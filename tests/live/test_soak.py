"""A short run of the long soak test, so that it stays runnable: one minute, and eight kills."""

from __future__ import annotations

from pathlib import Path

import pytest
from tools import soak


@pytest.mark.long(shown_by="tests/live/test_killed.py::test_kill_the_executor")
def test_a_minute_and_eight_kills_leave_nothing_wrong(tmp_path: Path) -> None:
    """Both ends of four kinds of work are killed, and every run is in the index."""
    assert list(soak.kill(8, tmp_path)) == []
    assert list(soak.run_a_day(1.0 / 60.0, 100.0, tmp_path, inside=True)) == []


def test_a_trace_that_ends_too_early_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a negative allowance for lost time, every trace ends too early."""
    monkeypatch.setattr(soak, "LOST_S", -1e9)
    (message,) = soak.kill(1, tmp_path)
    assert "kill 0 of the executor of lathe-winder: the trace ends at" in message
