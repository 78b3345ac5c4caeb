"""What was parsed, run scan by scan: times of switching, and what a broken beam does."""

from __future__ import annotations

import itertools
import random

import pytest

from tests.plc.machine import Plc
from tests.plc.texts import controller as plc

READY = {
    "light_grid": True, "enable": True, "x_is_left": True, "x_is_right": True, "z_is_up": True,
    "z_is_down": True, "letter_held": True,
}  # fmt: skip
SCAN_OF = {"letter-placer": 10_000, "letter-placer+quick": 5_000, "letter-placer+timed": 1_000}


def on(outputs: dict[str, bool]) -> set[str]:
    return {name for name, value in outputs.items() if value}


def pressed(controller: Plc, period: int, now: int = 0) -> int:
    """Let go of the button for a scan, press it, and return the time of that scan."""
    controller.scan(READY | {"start_button": False}, now)
    controller.scan(READY | {"start_button": True}, now + period)
    return now + period


def run(controller: Plc, period: int, jitter: float, seed: int = 1) -> list[tuple[int, set[str]]]:
    """Return times, us, and what is on from then on, through one cycle."""
    generator = random.Random(seed)
    start = pressed(controller, period)
    trace: list[tuple[int, set[str]]] = []
    for k in itertools.count(1):
        late = generator.uniform(-jitter, jitter) * period
        now = start + k * period + round(late)
        state = on(controller.scan(READY | {"start_button": False}, now))
        if not trace or trace[-1][1] != state:
            trace.append((now, state))
        if not controller.instance.v["sequence"].v["busy"]:
            return trace
    raise AssertionError


# Levels of the published shaper (3.04 Hz, 0.17) and times of X's 200 mm at 0.43 m/s, ms.
ZV_MS = 166.9
ACROSS_MS = 200.0 / 0.43


@pytest.mark.parametrize("jitter", [0.0, 0.2])
@pytest.mark.parametrize(("machine", "period"), SCAN_OF.items())
def test_switchings_are_within_half_a_scan_of_the_shaper(
    machine: str, period: int, jitter: float
) -> None:
    """The schedule is rounded by half a scan, the scan nearest to it acts, jitter adds its own."""
    trace = run(plc(machine), period, jitter)
    stroke = [(t, s) for t, s in trace if "x_right" in s]
    assert [s - {"main_air", "venturi", "x_right"} for _, s in stroke] == [
        {"x_right_a1"},
        {"x_right_a1", "x_right_a2"},
        {"x_right_a2"},
    ]
    begin = stroke[0][0]
    end = next(t for t, s in trace if t > begin and "x_right" not in s)
    times = [(t - begin) / 1000 for t in (stroke[1][0], stroke[2][0], end)]
    allowed = (1.0 + 2 * jitter) * period / 1000
    for found, wanted in zip(times, (ZV_MS, ACROSS_MS, ACROSS_MS + ZV_MS), strict=True):
        assert abs(found - wanted) <= allowed + 1e-9


def test_cycle_does_its_seven_steps_in_order() -> None:
    trace = run(plc(), 10_000, 0.0)
    seen = [key for key, _ in itertools.groupby(
        next((n for n in ("z_down", "knife", "z_up", "x_right", "press", "x_left") if n in s), "")
        for _, s in trace
    ) if key]  # fmt: skip
    assert seen == ["z_down", "knife", "z_up", "x_right", "z_down", "press", "z_up", "x_left"]
    assert trace[-1][1] == set()


@pytest.mark.parametrize("shaper", ["zv", "um-2ei"])
def test_opposite_valves_are_never_open_together(shaper: str) -> None:
    for _, state in run(plc(shaper=shaper), 10_000, 0.2, seed=3):
        assert not {"x_left", "x_right"} <= state
        assert not {"z_up", "z_down"} <= state


@pytest.mark.parametrize("broken", ["light_grid", "enable"])
@pytest.mark.parametrize(("machine", "period"), SCAN_OF.items())
def test_a_break_at_every_millisecond_switches_all_off_within_one_scan(
    machine: str, period: int, broken: str
) -> None:
    """Off in the first scan after the break; off while start is held; on only by a new press."""
    controller = plc(machine)
    now = pressed(controller, period)
    ready = READY | {"start_button": True}
    checked, busy = 0, 0
    while controller.instance.v["sequence"].v["busy"]:
        # Breaks at any ms since the last scan are all seen by this one: once is every ms of it.
        trial = controller.fork()
        after = now + period
        assert on(trial.scan(ready | {broken: False}, after)) == set()
        assert on(trial.scan(ready, after + period)) == set(), "held start began again"
        assert on(trial.scan(READY | {"start_button": False}, after + 2 * period)) == set()
        assert "main_air" in on(trial.scan(ready, after + 3 * period)), "a fresh press is ignored"
        busy += bool(on(controller.scan(ready, after)))
        now, checked = after, checked + 1
    assert checked * period > 7_000_000
    assert busy > 0.9 * checked


def test_a_press_while_the_beam_is_broken_is_no_start() -> None:
    controller = plc()
    controller.scan(READY | {"start_button": False}, 0)
    for k in range(1, 5):
        pushed = READY | {"start_button": True, "light_grid": False}
        assert on(controller.scan(pushed, k * 10_000)) == set()
    assert on(controller.scan(READY | {"start_button": True}, 50_000)) == set()


def test_a_button_that_is_held_at_power_up_is_no_start() -> None:
    controller = plc()
    for k in range(5):
        assert on(controller.scan(READY | {"start_button": True}, k * 10_000)) == set()


@pytest.mark.parametrize(
    ("machine", "limit"),
    [
        ("letter-placer", 25_000),
        ("letter-placer+quick", 13_000),
        ("letter-placer+timed", 3_000),
    ],
)
def test_watchdog_stops_a_late_scan_and_no_other(machine: str, limit: int) -> None:
    period = SCAN_OF[machine]
    for late in (limit - 1, limit):
        controller = plc(machine)
        now = pressed(controller, period)
        for _ in range(10):
            now += period
            state = on(controller.scan(READY | {"start_button": False}, now))
            assert state == {"main_air"}
        state = on(controller.scan(READY | {"start_button": False}, now + late))
        block = controller.instance.v["sequence"].v
        assert (state == set()) == (late >= limit)
        assert block["fault"] == (late >= limit)


def test_an_input_that_never_comes_is_a_fault() -> None:
    controller = plc()
    now = pressed(controller, 10_000)
    inputs = READY | {"start_button": False, "letter_held": False}
    for _ in range(2000):
        now += 10_000
        controller.scan(inputs, now)
    block = controller.instance.v["sequence"].v
    assert block["fault"] and block["stopped"] and not block["busy"] and not block["finished"]
