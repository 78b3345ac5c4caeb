"""Who runs a job at a terminal is told what the keys do before the machine moves far."""

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
def test_keys_are_told_once_where_there_are_any(
    at_a_terminal: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    ends = os.pipe()
    running: Any = SimpleNamespace(state=State.RUNNING, time_s=0.0)
    with closing(Desk()) as desk:
        keys = AtTheKeys(desk, 1.0, None, ends[0] if at_a_terminal else None)
        for _ in range(3):
            keys.step(running)
    assert capfd.readouterr().err.count(KEYS) == (1 if at_a_terminal else 0)
    for end in ends:
        os.close(end)
