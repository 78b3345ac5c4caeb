"""Long turns are set as Linux reads them, and started processes do not inherit them."""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path

import pytest

from tests.long_turns import LONG_S, ask_for_turns


def slice_ms(process: int | str) -> float:
    """Return the turn of a process by Linux's own report, ms."""
    lines = Path(f"/proc/{process}/sched").read_text(encoding="ascii").splitlines()
    return float(next(line for line in lines if line.startswith("se.slice")).split(":")[1]) * 1e-6


def test_a_turn_is_asked_for_and_given_back() -> None:
    sched = Path("/proc/self/sched")
    if not sched.exists() or "se.slice" not in sched.read_text(encoding="ascii"):
        return  # another system
    if tuple(int(part) for part in platform.release().split(".")[:2]) < (6, 12):
        return  # a Linux with the same turns for all
    try:
        assert ask_for_turns(LONG_S)
        assert slice_ms("self") == pytest.approx(1e3 * LONG_S)
        child = os.fork()
        if child == 0:
            os._exit(int(slice_ms("self") < 1e3 * LONG_S))
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1
    finally:
        assert ask_for_turns(0.0)
    assert slice_ms("self") < 1e3 * LONG_S


def test_other_systems_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(platform, "machine", lambda: "riscv64")
        assert not ask_for_turns(LONG_S)
    monkeypatch.setattr(sys, "platform", "darwin")
    assert not ask_for_turns(LONG_S)
