"""Random breaks of the beam and random presses of buttons: no output stays on."""

from __future__ import annotations

import random
from collections import Counter

import pytest

from tests.commands.plc.breaks import KINDS, breaks, broken
from tests.commands.plc.driving import Bench, homed
from tests.commands.plc.texts import controller


@pytest.mark.long(but="200")
@pytest.mark.parametrize("number", [200, 1200])
def test_no_random_break_leaves_an_output_on(number: int) -> None:
    """There is a break in each scan of homing and of the begin of a cycle."""
    counts = Counter(breaks(controller, number))
    assert sum(counts.values()) == number
    assert min(counts[kind] for kind in KINDS) > number // 4


def test_an_output_that_stays_on_would_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = homed(controller())
    bench.press("start_button")
    whole = Bench.scan

    def leaking(self: Bench, **given: bool | int) -> set[str]:
        return whole(self, **given) | {"main_air"}

    monkeypatch.setattr(Bench, "scan", leaking)
    with pytest.raises(AssertionError, match="in its first scan"):
        broken(bench.fork(), random.Random(1))
