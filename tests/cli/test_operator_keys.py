"""An operator at a terminal is told the keys before the machine moves far."""

from __future__ import annotations

import os
from contextlib import closing
from types import SimpleNamespace
from typing import Any

import pytest

from threadline.cli.operator_keys import AtTheKeys
from threadline.live.states import Desk, State

KEYS = "h holds, r goes on, any other key stops"


@pytest.mark.parametrize("at_a_terminal", [True, False])
def test_keys_are_named_once_where_there_are_any(
    at_a_terminal: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    ends = os.pipe()
    running: Any = SimpleNamespace(state=State.RUNNING, time_s=0.0, percent=100)
    with closing(Desk()) as desk:
        keys = AtTheKeys(desk, 1.0, None, ends[0] if at_a_terminal else None)
        for _ in range(3):
            keys.step(running)
    assert capfd.readouterr().err.count(KEYS) == (1 if at_a_terminal else 0)
    for end in ends:
        os.close(end)


@pytest.mark.parametrize(
    ("keys", "percent", "asked", "message"),
    [
        ("-", 100, 90, ""),
        ("---", 100, 70, ""),
        ("-+", 50, 50, ""),
        ("+", 100, None, "an override of 110 % is not within the 10 to 100 %"),
        ("--", 20, 10, "an override of 0 % is not within the 10 to 100 %"),
    ],
)
def test_keys_override_the_feed_in_steps_and_never_stop(
    keys: str, percent: int, asked: int | None, message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    text = pressed(keys, percent, "", asked, capfd)
    assert message in text
    assert (f"feed {percent} %" in text) is (percent != 100)  # the override in force


def test_an_override_that_would_spoil_the_work_is_refused_at_the_key(
    capfd: pytest.CaptureFixture[str],
) -> None:
    message = pressed("-", 100, "at 50 % its loads would shake", None, capfd)
    assert "the feed of this run cannot be overridden: at 50 % its loads would shake" in message


def pressed(
    keys: str, percent: int, no_override: str, asked: int | None, capfd: pytest.CaptureFixture[str]
) -> str:
    """Press keys in a run, and check the requests; return the messages."""
    ends = os.pipe()
    os.write(ends[1], keys.encode())
    running: Any = SimpleNamespace(
        state=State.RUNNING, time_s=0.0, percent=percent, no_override=no_override
    )
    with closing(Desk()) as desk:
        AtTheKeys(desk, 1.0, None, ends[0]).step(running)
        assert desk.take_override() == asked
        assert desk.take() is None
    for end in ends:
        os.close(end)
    return capfd.readouterr().err
