"""An interlock of the machine file is a fault of the program wherever it applies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tests.commands.plc.driving import Bench, homed
from tests.commands.plc.machine import Plc
from tests.commands.plc.parts import read_in_parts
from tests.commands.plc.pistons import Cell
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, write
from threadline.search.move_list import overlapped, with_choices

CYCLE = Path(__file__).resolve().parents[3] / "examples" / "letter-cycle.toml"


def test_the_lift_that_sinks_while_x_moves_stops_x_at_once(tmp_path: Path) -> None:
    """X needs z_is_up, and the list lets X start while the lift still moves its last bit.

    Without the interlock a sinking lift is no fault then, as it may be anywhere: X went 98 mm.
    """
    machine = load_machine("letter-placer")
    job = overlapped(with_choices(read_job(CYCLE, machine), {}, {}), machine)
    out = tmp_path / "cycle.st"
    write(plan_job(job, machine, Options()), "st", out)
    bench = homed(Plc(read_in_parts(out.read_text(encoding="ascii"))))
    bench.press("start_button")
    checked, was = 0, False
    while bench.block["busy"]:
        moves = bool(bench.on & {"x_left", "x_right"})
        if moves or was:
            trial = bench.fork()
            trial.cell.pistons["z"].at = 50.0
            on = trial.scan()
            if moves and bench.cell.on & {"x_left", "x_right"}:
                assert on == set(), bench.block["place"]
                assert trial.block["contact_text"] == "z_is_up"
                checked += 1
        was = moves
        bench.scan()
    assert bench.block["finished"], bench.block["fault_text"]
    assert checked > 80


def test_by_hand_the_lift_comes_up_where_the_list_never_raises_it(tmp_path: Path) -> None:
    """A list lowers the lift at the left, raises it only at the right, and is stopped between."""
    listed = tmp_path / "down.toml"
    moves = ('Z = "100 mm"', 'X = "200 mm"', 'Z = "0 mm"', 'X = "0 mm"')
    listed.write_text(
        '[[operation]]\nvalve = "main_air"\n'
        + "".join(f"[[operation]]\nmove = {{ {move} }}\n" for move in moves),
        encoding="utf-8",
    )
    machine = load_machine("letter-placer")
    slide = replace(machine.cylinders["X"], needs=())
    machine = replace(machine, cylinders={**machine.cylinders, "X": slide})
    out = tmp_path / "down.st"
    write(plan_job(read_job(listed, machine), machine, Options()), "st", out)
    units = read_in_parts(out.read_text(encoding="ascii"))
    for x in (0.0, 100.0, 200.0):
        bench = Bench(Plc(units), cell=Cell(x, 100.0))
        for _ in range(160):
            bench.scan(manual=True)
        for jog, contact in ((4, "z_is_up"), (2, "x_is_left")):
            for _ in range(200):
                bench.scan(manual=True, jog=jog)
            assert bench.cell.contacts()[contact], (x, contact)


def test_a_letter_that_is_lost_on_the_way_is_found_where_the_list_asks_again(
    tmp_path: Path,
) -> None:
    """A second wait while the same venturi is on passes with the letter, and fails without it."""
    again = '[[operation]]\nwait = "letter_held"\ntimeout = "100 ms"\n\n'
    let_go = '[[operation]]\nvacuum = "venturi"\non = false'
    text = CYCLE.read_text(encoding="utf-8")
    assert text.count(let_go) == 1
    listed, out = tmp_path / "again.toml", tmp_path / "again.st"
    listed.write_text(text.replace(let_go, again + let_go), encoding="utf-8")
    machine = load_machine("letter-placer")
    write(plan_job(read_job(listed, machine), machine, Options()), "st", out)
    units = read_in_parts(out.read_text(encoding="ascii"))
    for lost in (False, True):
        bench = homed(Plc(units))
        bench.press("start_button")
        while bench.block["busy"]:
            if lost and bench.block["step_text"] == "across":
                bench.cell.stuck["letter_held"] = False
            bench.scan()
        assert bench.block["finished"] is not lost
        outputs = [bench.block[name] for name in ("fault_text", "fault_step", "contact_text")]
        missing = ["an input did not come in time", "leave", "letter_held"]
        assert outputs == (missing if lost else ["none", "", ""]), outputs
