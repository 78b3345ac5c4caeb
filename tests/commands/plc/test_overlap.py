"""A cycle whose cylinders overlap: its awaited switches still hold every interlock.

The cell of ``pistons.py`` is the judge, as for the list that waits for rest.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from tests.commands.plc.driving import Bench, homed
from tests.commands.plc.machine import Plc
from tests.commands.plc.parts import read_in_parts
from tests.commands.plc.stuck import CONTACTS, watched
from tests.commands.plc.texts import controller
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, write
from threadline.search.move_list import overlapped, with_choices

CYCLE = Path(__file__).resolve().parents[3] / "examples" / "letter-cycle.toml"


@cache
def written(folder: Path) -> Plc:
    machine = load_machine("letter-placer")
    job = overlapped(with_choices(read_job(CYCLE, machine), {}, {}), machine)
    out = folder / "cycle.st"
    write(plan_job(job, machine, Options()), "st", out)
    return Plc(read_in_parts(out.read_text(encoding="ascii")))


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return homed(written(tmp_path).fork(), 10_000, 0.2, 3)


def scans_of_a_cycle(bench: Bench) -> tuple[int, list[float]]:
    """Return the scans of a cycle, and the place of the lift when X starts."""
    lift: list[float] = []
    bench.press("start_button")
    scans, was = 0, False
    while bench.block["busy"]:
        moving = bool(bench.scan() & {"x_left", "x_right"})
        if moving and not was:
            lift.append(bench.cell.pistons["z"].at)
        scans, was = scans + 1, moving
    assert bench.block["finished"]
    return scans, lift


def test_a_cycle_is_shorter_and_x_sets_out_with_the_lift_up(bench: Bench) -> None:
    listed, _ = scans_of_a_cycle(homed(controller("letter-placer", "none"), 10_000, 0.2, 3))
    scans, lift = scans_of_a_cycle(bench)
    assert scans < listed - 40
    assert len(lift) == 2
    assert max(lift) <= 6.0


def test_a_stuck_contact_lets_nothing_go_where_it_must_not(bench: Bench) -> None:
    """Each contact stuck on and off from each place on: tools and X as the pistons allow."""
    bench.press("start_button")
    place, checked = 0, 0
    while bench.block["busy"]:
        if bench.block["place"] != place:
            place = bench.block["place"]
            for contact in CONTACTS:
                for value in (False, True):
                    trial = bench.fork()
                    trial.cell.stuck = {contact: value}
                    watched(trial)
                    named = trial.block["contact_text"]
                    assert trial.block["finished"] or named == contact, (place, contact, value)
                    checked += 1
        bench.scan()
    assert checked > 250


def test_by_hand_x_still_needs_the_lift_up(bench: Bench) -> None:
    out = bench.plc.instance.v["sequence"].v
    assert out is bench.block
    bench.cell.pistons["z"].at = 50.0
    for _ in range(160):
        bench.scan(manual=True)
    jogs = [bench.scan(manual=True, jog=number) for number in range(1, 8) for _ in range(5)]
    assert not any({"x_left", "x_right"} & on for on in jogs)
    assert any({"z_up"} & on for on in jogs)
