"""A stroke ends at its switch: a short one creeps to it, and a missing switch is a fault."""

from __future__ import annotations

import pytest

from tests.commands.plc.stuck import forbidden
from tests.commands.plc.varied import Varied, bench

OPENS = {"x_right", "x_right_a2", "main_air", "venturi"}


def run(made, step: str = "across") -> tuple[list[int], list[set[str]]]:
    """Run to the end; return the scans in which X creeps in ``step``, and the outputs then."""
    scans, on = [], []
    while made.block["busy"]:
        now = made.scan()
        assert not forbidden(now, made.cell), made.block["step_text"]
        if made.block["step_text"] == step and now & {"x_right", "x_left"}:
            scans.append(made.count)
            on.append(now)
    return scans, on


@pytest.mark.parametrize(("speed", "seeds"), [(0.97, (1, 2)), (0.955, (3,))])
def test_a_slow_piston_creeps_to_its_switch(speed: float, seeds: tuple[int, ...]) -> None:
    """It covers 194 mm of 200 mm, and its switch is at 196: no cycle ended before it crept."""
    for seed in seeds:
        made = bench(Varied({"x": speed}, {"x_is_right": 2.0}), seed)
        scans, on = run(made)
        assert made.block["finished"], made.block["fault_text"]
        creeps = scans[47:]  # after the 47 scans of the stroke
        assert 2 <= len(creeps) <= 3 if speed > 0.96 else 4 <= len(creeps) <= 6
        assert all(now == OPENS for now in on[47:])


def test_a_piston_in_time_does_not_creep() -> None:
    made = bench(Varied({"x": 0.98}, {"x_is_right": 1.0}), 4)
    scans, _ = run(made)
    assert made.block["finished"]
    assert len(scans) == 47


def test_a_switch_that_never_comes_is_a_fault_in_its_time() -> None:
    """Two seconds after the stroke has come to rest, however far it has crept by then."""
    made = bench(Varied({}, {}), 5)
    made.cell.stuck = {"x_is_right": False}
    scans, _ = run(made)
    assert made.block["fault_text"] == "an input did not come in time"
    assert made.block["contact_text"] == "x_is_right"
    assert made.on == set()
    rest_scans = 68  # 0.2 s and four lags of 0.12 s
    assert made.count - (scans[46] + 1) == pytest.approx(rest_scans + 200, abs=2)
    assert 47 + 2 * 3 <= len(scans) <= 47 + 3 * 4, "three or four openings of two scans"


def test_the_cycle_goes_on_when_the_crept_piston_rests() -> None:
    """The lift goes down only after the last opening: dead time and lags at their longest."""
    made = bench(Varied({"x": 0.97}, {"x_is_right": 2.0}), 6)
    last = down = 0
    while made.block["busy"] and not down:
        on = made.scan()
        last = made.count if "x_right" in on else last
        down = made.count if last and "z_down" in on else 0
    assert down - last >= 82  # 0.24 s and four lags of 0.144 s
