"""Work by hand, scan by scan: faults latch, a jog needs a fresh press, the air needs time."""

from __future__ import annotations

import pytest

from tests.commands.plc.driving import Bench, homed
from tests.commands.plc.pistons import Cell
from tests.commands.plc.texts import controller as plc

X_OUT, X_IN, Z_OUT, Z_IN, KNIFE = 1, 2, 3, 4, 5
SLOWLY = {"main_air", "x_right", "x_right_a2"}
RAMP_SCANS = 150  # 1.5 s of the soft start of letter-placer
DWELL_SCANS = 2  # 20 ms, the shortest time of its valves


def by_hand(bench: Bench, jog: int = 0) -> set[str]:
    return bench.scan(manual=True, jog=jog)


def ready(cell: Cell | None = None) -> Bench:
    """Return a bench by hand with the air up."""
    bench = homed(plc()) if cell is None else Bench(plc(), cell=cell)
    for _ in range(RAMP_SCANS + 5):
        assert by_hand(bench) <= {"main_air"}
    return bench


@pytest.mark.parametrize(("broken", "code"), [("light_grid", 1), ("enable", 2)])
def test_a_break_while_a_jog_runs_stays_until_it_is_acknowledged(broken: str, code: int) -> None:
    bench = ready()
    assert by_hand(bench, X_OUT) == SLOWLY
    assert bench.scan(manual=True, jog=X_OUT, **{broken: False}) == set()
    assert bench.block["fault_code"] == code
    for _ in range(10):
        assert by_hand(bench, X_OUT) == set(), "the beam is back, nobody has acknowledged"
    for jog in (0, X_OUT):
        assert by_hand(bench, jog) == set(), "a fresh press is no acknowledgement"
    bench.scan(manual=True, jog=X_OUT, acknowledge=True)
    for _ in range(RAMP_SCANS + 5):
        assert by_hand(bench, X_OUT) == {"main_air"}, "what was held all the time is no press"
    by_hand(bench)
    assert by_hand(bench, X_OUT) == SLOWLY


def test_a_late_scan_by_hand_is_a_fault() -> None:
    bench = ready()
    by_hand(bench, X_OUT)
    inputs = bench.cell.advance(bench.now + 25_000) | {"manual": True, "jog": X_OUT}
    assert bench.cell.tell(bench.plc.scan(inputs, bench.now)) == set()
    assert bench.block["fault_text"] == "a scan came late"


def test_a_jog_that_is_held_at_power_up_is_no_press() -> None:
    bench = Bench(plc())
    for _ in range(RAMP_SCANS + 50):
        assert by_hand(bench, X_OUT) == {"main_air"}


def test_a_jog_that_is_held_through_a_cycle_sets_out_nothing_at_its_end() -> None:
    bench = homed(plc())
    bench.press("start_button")
    while bench.block["busy"]:
        by_hand(bench, X_OUT)
    assert bench.block["finished"]
    for _ in range(RAMP_SCANS + 50):
        assert by_hand(bench, X_OUT) == {"main_air"}


def test_cylinder_stopped_at_its_end_moves_only_after_the_next_press() -> None:
    bench = ready()
    while bench.cell.contacts()["z_is_down"] is False:
        by_hand(bench, Z_OUT)
    by_hand(bench, Z_OUT)
    bench.cell.pistons["z"].at = 80.0
    for _ in range(20):
        assert by_hand(bench, Z_OUT) == {"main_air"}, "it sank back, and nobody asked again"
    by_hand(bench)
    assert "z_down" in by_hand(bench, Z_OUT)


def test_by_hand_the_soft_start_is_waited_for() -> None:
    bench = homed(plc())
    by_hand(bench)
    for _ in range(RAMP_SCANS - 1):
        assert by_hand(bench, Z_OUT) == {"main_air"}
    for _ in range(2):
        state = by_hand(bench, Z_OUT)
    assert state == {"main_air", "z_down", "z_down_a2"}


def test_by_hand_valves_rest_between_two_things() -> None:
    """A panel asks for another way in every scan: a valve opens after the others have shut."""
    bench = ready(Cell(100.0, 0.0))
    quiet, opened = 0, 0
    for number in range(100):
        on = by_hand(bench, (X_OUT, X_IN)[number // 5 % 2]) - {"main_air"}
        opened += bool(on and quiet)
        assert not on or quiet in (0, DWELL_SCANS), number
        quiet = 0 if on else quiet + 1
    assert opened == 19, "all but the first, which has nothing before it"


def test_the_way_home_watches_what_it_has_brought_home() -> None:
    """The lift sinks while X comes back: X does not go on under it, and nothing is homed."""
    bench = Bench(plc(), cell=Cell(200.0, 100.0))
    bench.press("home_button")
    while "x_left" not in bench.scan():
        assert bench.block["busy"]
    bench.cell.pistons["z"].at = 50.0
    assert bench.scan() == set()
    assert not bench.block["homed"]
    assert bench.block["fault_text"] == "an end switch is off where its piston stands"
    assert bench.block["contact_text"] == "z_is_up"


def test_by_hand_the_lift_goes_down_at_the_two_places_of_the_list_alone() -> None:
    for x, goes in ((0.0, True), (200.0, True), (100.0, False)):
        bench = ready(Cell(x, 0.0))
        assert ("z_down" in by_hand(bench, Z_OUT)) == goes, x
        assert (bench.block["hint_text"] == "") == goes


def test_by_hand_there_is_always_a_way_to_the_start() -> None:
    """The lift first, from anywhere; then X, which the list brings back only with the lift up."""
    for x in (0.0, 100.0, 200.0):
        bench = ready(Cell(x, 70.0))
        assert by_hand(bench, X_IN) == {"main_air"}
        for jog, there in ((Z_IN, "z_is_up"), (X_IN, "x_is_left")):
            for _ in range(200):
                by_hand(bench, jog)
            assert bench.cell.contacts()[there], x


def test_a_panel_is_told_why_nothing_happens() -> None:
    bench = Bench(plc())

    def hint(**given: bool | int) -> str:
        bench.scan(**given)
        hint: str = bench.block["hint_text"]
        return hint

    assert hint(start_button=True) == "home first"
    assert hint(home_button=True, light_grid=False) == "the light grid is broken"
    assert hint(home_button=True) == "home first", "it was held"
    bench.home()
    assert hint() == "ready to start"
    assert hint(manual=True) == "the air is coming up"
    assert hint(manual=True, enable=False) == "the enable is missing"
    assert hint(acknowledge=True, enable=False) == "the enable is missing"
    assert hint(home_button=True) == "acknowledge first"
    assert bench.block["fault_step"] == "by hand"
    assert hint(acknowledge=True) == "home first"
    assert bench.block["fault_step"] == ""


def test_a_panel_is_told_the_step_and_the_address_until_it_acknowledges() -> None:
    bench = homed(plc())
    bench.press("start_button")
    while bench.block["step_text"] != "cut":
        bench.scan()
    bench.cell.stuck = {"z_is_down": False}
    bench.until_idle()
    for _ in range(3):
        assert bench.block["step_text"] == "idle"
        assert bench.block["fault_step"] == "cut"
        assert (bench.block["contact_text"], bench.block["contact_address"]) == (
            "z_is_down", "%IX0.6",
        )  # fmt: skip
        bench.scan()
    bench.press("acknowledge")
    assert bench.block["fault_step"] == bench.block["contact_address"] == ""
