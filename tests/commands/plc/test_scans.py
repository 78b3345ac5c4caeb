"""The parsed program, run scan by scan: times of switching, and the effect of a broken beam."""

from __future__ import annotations

import itertools

import pytest

from tests.commands.plc.driving import Bench, homed
from tests.commands.plc.machine import Plc
from tests.commands.plc.pistons import Cell
from tests.commands.plc.texts import controller as plc

SCAN_OF = {"letter-placer": 10_000, "letter-placer+quick": 5_000, "letter-placer+timed": 1_000}


def run(controller: Plc, period: int, jitter: float, seed: int = 1) -> list[tuple[int, set[str]]]:
    """Return times, us, and the outputs from then on, through one cycle."""
    bench = homed(controller, period, jitter, seed)
    bench.press("start_button")
    trace: list[tuple[int, set[str]]] = []
    for _ in itertools.count():
        state = bench.scan()
        if not trace or trace[-1][1] != state:
            trace.append((bench.now, state))
        if not bench.block["busy"]:
            assert bench.block["finished"], bench.block["fault_text"]
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
    """The schedule is rounded by half a scan, the nearest scan acts, and jitter adds its own."""
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
    for found, expected in zip(times, (ZV_MS, ACROSS_MS, ACROSS_MS + ZV_MS), strict=True):
        assert abs(found - expected) <= allowed + 1e-9


def test_cycle_does_its_seven_steps_in_order() -> None:
    trace = run(plc(), 10_000, 0.0)
    seen = [key for key, _ in itertools.groupby(
        next((n for n in ("z_down", "knife", "z_up", "x_right", "press", "x_left") if n in s), "")
        for _, s in trace
    ) if key]  # fmt: skip
    assert seen == ["z_down", "knife", "z_up", "x_right", "z_down", "press", "z_up", "x_left"]
    assert trace[-1][1] == set()


@pytest.mark.long(only="um-2ei")
@pytest.mark.parametrize("shaper", ["zv", "um-2ei"])
def test_opposite_valves_are_never_open_together(shaper: str) -> None:
    for _, state in run(plc(shaper=shaper), 10_000, 0.2, seed=3):
        assert not {"x_left", "x_right"} <= state
        assert not {"z_up", "z_down"} <= state


@pytest.mark.parametrize("broken", ["light_grid", "enable"])
@pytest.mark.parametrize(("machine", "period"), SCAN_OF.items())
def test_a_break_at_every_scan_switches_all_off_and_start_alone_begins_nothing(
    machine: str, period: int, broken: str
) -> None:
    """All breaks at any ms since the last scan are seen by the next one: one test for each scan."""
    bench = homed(plc(machine), period)
    bench.press("start_button")
    checked = 0
    while bench.block["busy"]:
        if checked % max(1, 10_000 // period) == 0:
            trial = bench.fork()
            assert trial.scan(**{broken: False}) == set()
            assert trial.block["fault_code"] == (1 if broken == "light_grid" else 2)
            assert trial.scan(start_button=True) == set()
            assert trial.press("start_button") == set()
            assert trial.press("home_button") == set(), "home before it was acknowledged"
            trial.press("acknowledge")
            assert not trial.block["fault"]
            assert trial.press("start_button") == set(), "a start from anywhere"
        bench.scan()
        checked += 1
    assert checked * period > 7_000_000


@pytest.mark.long(but="zv-65")
@pytest.mark.parametrize(("shaper", "apart"), [("zv", 65), ("zv", 13), ("um-2ei", 13)])
def test_after_every_break_acknowledge_home_and_start_bring_a_whole_cycle(
    shaper: str, apart: int
) -> None:
    """At every 65th or 13th scan of the cycle, with jitter: pistons stand anywhere then."""
    bench = homed(plc(shaper=shaper), 10_000, 0.2, seed=5)
    bench.press("start_button")
    checked = 0
    while bench.block["busy"]:
        if checked % apart == 0:
            trial = bench.fork()
            trial.scan(light_grid=False)
            for _ in range(60):
                trial.scan()
            trial.press("acknowledge")
            trial.home()
            assert (trial.cell.pistons["x"].at, trial.cell.pistons["z"].at) == (0.0, 0.0)
            trial.press("start_button")
            trial.until_idle()
            assert trial.block["finished"], trial.block["fault_text"]
        bench.scan()
        checked += 1


def test_a_press_while_the_beam_is_broken_is_no_start() -> None:
    bench = homed(plc())
    for _ in range(5):
        assert bench.scan(start_button=True, light_grid=False) == set()
    assert bench.scan(start_button=True) == set()


@pytest.mark.parametrize("button", ["start_button", "home_button"])
def test_a_button_that_is_held_at_power_up_is_no_press(button: str) -> None:
    bench = Bench(plc())
    for _ in range(5):
        assert bench.scan(**{button: True}) == set()


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
        bench = homed(plc(machine), period)
        bench.press("start_button")
        for _ in range(10):
            assert bench.scan() == {"main_air"}
        inputs = bench.cell.advance(bench.now + late)
        state = bench.cell.tell(bench.plc.scan(inputs, bench.now))
        assert (state == set()) == (late >= limit)
        assert bench.block["fault"] == (late >= limit)
        assert bench.block["fault_code"] == (3 if late >= limit else 0)


def test_an_input_that_never_comes_is_a_fault() -> None:
    bench = homed(plc())
    bench.cell.stuck = {"letter_held": False}
    bench.press("start_button")
    bench.until_idle()
    block = bench.block
    assert block["fault"]
    assert block["stopped"]
    assert not block["finished"]
    assert block["fault_text"] == "an input did not come in time"
    assert block["contact_text"] == "letter_held"


def test_home_from_wherever_the_pistons_stand() -> None:
    for x in range(0, 201, 25):
        for z in (0.0, 37.0, 100.0):
            bench = Bench(plc(), cell=Cell(float(x), z))
            seen: list[set[str]] = []
            bench.press("home_button")
            while bench.block["busy"]:
                seen.append(bench.scan())
            assert bench.block["homed"]
            assert (bench.cell.pistons["x"].at, bench.cell.pistons["z"].at) == (0.0, 0.0)
            # The lift first, and slowly: only the smaller flow.
            assert all(s <= {"main_air", "z_up", "z_up_a2", "x_left", "x_left_a2"} for s in seen)
            first_x = next(i for i, s in enumerate(seen) if "x_left" in s)
            assert not any("z_up" in s for s in seen[first_x:])


def test_single_and_continuous_cycles_and_their_count() -> None:
    bench = homed(plc())
    bench.press("start_button")
    bench.until_idle()
    assert bench.block["count"] == 1
    bench.scan()
    bench.scan(start_button=True, continuous=True)
    places = []
    while bench.block["count"] < 3:
        bench.scan(continuous=True)
        places.append(bench.block["place"])
    assert bench.block["busy"], "two more cycles, and on"
    bench.scan(continuous=True, stop_at_end=True)
    for _ in range(2000):
        bench.scan(continuous=True)
    assert not bench.block["busy"]
    assert bench.block["count"] == 4
    assert bench.block["finished"]
    assert bench.block["homed"]


def test_by_hand_one_thing_at_a_time_with_the_interlocks_of_the_cycle() -> None:
    jogs = {"x_out": 1, "x_in": 2, "z_out": 3, "z_in": 4, "knife": 5, "venturi": 6, "press": 7}
    bench = homed(plc())
    for _ in range(160):
        assert bench.scan(manual=True) == {"main_air"}
    assert bench.scan(manual=True, jog=jogs["x_out"]) == {"main_air", "x_right", "x_right_a2"}
    assert bench.scan(manual=True, jog=jogs["knife"]) == {"main_air"}, "the lift is up"
    assert not bench.block["homed"]
    for _ in range(200):
        bench.scan(manual=True, jog=jogs["z_out"])
    assert bench.cell.pistons["z"].at > 90
    assert bench.scan(manual=True, jog=jogs["x_out"]) == {"main_air"}, "the lift is down"
    assert bench.scan(manual=True, jog=jogs["z_out"]) == {"main_air"}, "it is at its end"
    assert bench.scan(manual=True, jog=jogs["x_out"], light_grid=False) == set()
    bench.press("acknowledge")
    assert bench.scan(start_button=True) == set(), "a start that is not home"
    for _ in range(3):
        assert bench.scan(manual=True, start_button=True, home_button=True) <= {"main_air"}
