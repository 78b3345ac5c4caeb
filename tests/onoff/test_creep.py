"""A cylinder that stops short of its end switch creeps to it, in plan, twin and judge."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete

from tests.onoff.cycles import TRIMMED
from threadline.commands.plan import Plan
from threadline.dynamics.pneumatic import cylinder_equations, opening_ringing_m, step_ringing
from threadline.errors import LinkFaultError, RecordingError
from threadline.files import Creep, Recording, SwitchSchedule, switch_schedule
from threadline.jobs import read_job
from threadline.live.wire import creep_of
from threadline.machine import load_machine
from threadline.machine.numbers import number_at
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.twin.switching import simulate_switching, simulate_switchings
from threadline.twin.switching_session import SwitchingSession
from threadline.verdict.switch_measures import residual_vibration, switching_order
from threadline.verdict.switch_run import SwitchRun

CYCLE = Path(__file__).resolve().parents[2] / "examples" / "letter-cycle.toml"
SLOW = {"cylinders.X.speed": 0.97, "contacts.x_is_right.at": 196 / 194}
"""What the machine file allows: 194 mm of 200 are covered, and the switch is at 196."""


@cache
def planned() -> Plan:
    machine = load_machine(TRIMMED)
    return plan_job(read_job(CYCLE, machine), machine, Options(shaper="zv"))


def slow(factors: dict[str, float], commands: SwitchSchedule) -> Recording:
    machine = planned().machine
    own = {p: np.array([f * number_at(machine, p).si]) for p, f in factors.items()}
    (recording,) = simulate_switchings(commands, machine, own)
    return recording


def commands() -> SwitchSchedule:
    return switch_schedule(planned().commands)


@cache
def crept() -> SwitchRun:
    return SwitchRun(slow(SLOW, commands()), planned())


def test_a_slow_machine_ends_its_cycle() -> None:
    """Without its creeps the schedule waits for a switch that never comes."""
    run = crept()
    assert run.followed
    assert [f.value for f in switching_order(run, {})] == [0.0]
    across = next(move for move in run.moves if move.planned.step == "across")
    period_s = float(commands().clock.period_s)
    later_s = across.end_s - run.instant_s(across.planned.last_tick)
    # It rests for 0.82 s first: 0.24 s and four lags of 0.144 s; an opening lasts two scans.
    assert later_s == pytest.approx(0.82 + 2 * period_s, abs=1e-6)
    with pytest.raises(RecordingError, match="'x_is_right' did not become on"):
        list(slow(SLOW, replace(commands(), creeps=())))


def test_a_switch_that_is_out_of_reach_ends_it_in_the_time_of_the_list() -> None:
    with pytest.raises(RecordingError, match="'x_is_right' did not become on within 2 s"):
        list(slow(SLOW | {"cylinders.X.speed": 0.85}, commands()))


def test_simulated_ringing_of_a_creep_agrees_with_the_plan() -> None:
    """An opening rings as planned, beside the slower stroke's ringing: a tenth of the limit."""
    (across,) = [
        f.value
        for f in residual_vibration(crept(), {"after": 0.0, "window": 1.0})
        if (f.step, f.axis) == ("across", "X")
    ]
    rings_m = planned().scheduled.creeping["X"]["rings_m"]
    assert across == pytest.approx(rings_m, abs=30e-6)
    assert rings_m == pytest.approx(0.136e-3, abs=1e-6)


def test_the_ringing_of_an_opening_is_that_of_its_equations() -> None:
    """Compared with scipy's exact discretisation of the sliding cylinder, step by step."""
    machine, level, open_s = planned().machine, 0.493, 0.02
    plant, pole = cylinder_equations(machine, "X"), step_ringing(machine, "X").pole
    rates, size = plant.sliding()[0], len(plant.states)
    step_s = 1e-3
    once, push, *_ = cont2discrete(
        (rates, plant.level[0][:, None], np.eye(size), np.zeros((size, 1))), step_s
    )
    x, frame = np.zeros(size), []
    for k in range(3000):
        x = once @ x + push[:, 0] * (level if k < round(open_s / step_s) else 0.0)
        frame.append(plant.frame[0] @ x)
    wave = np.exp(pole * (np.arange(1, 3001) * step_s - open_s))[-700:]
    columns = np.column_stack((wave.real, -wave.imag, np.ones(700)))
    swing = np.hypot(*np.linalg.lstsq(columns, np.array(frame[-700:]))[0][:2])
    assert opening_ringing_m(machine, "X", level, open_s) == pytest.approx(swing, rel=1e-4)


def test_two_openings_cancel() -> None:
    """They are an odd number of half periods apart: a machine that needs two hardly rings."""
    run = SwitchRun(slow(SLOW | {"cylinders.X.speed": 0.96}, commands()), planned())
    (across,) = [
        f.value
        for f in residual_vibration(run, {"after": 0.0, "window": 1.0})
        if (f.step, f.axis) == ("across", "X")
    ]
    assert across < 0.2 * planned().scheduled.creeping["X"]["rings_m"]


@pytest.mark.parametrize("piece", [7, 100])
def test_a_schedule_in_pieces_creeps_to_the_bit_alike(piece: int) -> None:
    machine = planned().machine
    parts = {
        "cylinders": machine.cylinders
        | {"X": replace(machine.cylinders["X"], speed=_times(machine, "cylinders.X.speed"))},
        "contacts": machine.contacts
        | {
            "x_is_right": replace(
                machine.contacts["x_is_right"], at=_times(machine, "contacts.x_is_right.at")
            )
        },
    }
    other, whole = replace(machine, **parts), commands()
    waits = [event for event in whole.events if event.kind == "wait"]
    session, reach, samples = SwitchingSession(other), -1, list[np.ndarray]()
    while session.switched_off_at is None or session.tick < session.switched_off_at:
        if reach < whole.duration_ticks and session.place >= reach - piece:
            before, reach = reach, min(reach + 2 * piece, whole.duration_ticks)
            rows = (whole.ticks > before) & (whole.ticks <= reach)
            session.take(
                whole.ticks[rows],
                whole.levels[rows],
                whole.operation[rows],
                [wait for wait in waits if before < wait.tick <= reach],
                reach=reach,
                duration=whole.duration_ticks if reach == whole.duration_ticks else None,
                creeps=[creep for creep in whole.creeps if before < creep.tick <= reach],
            )
        samples.append(session.advance(5).samples["X.load"])
    assert not session.failure
    found = np.concatenate(samples)
    expected = simulate_switching(whole, other).samples("X.load")[1]
    assert np.array_equal(found, expected[: len(found)])


def _times(machine, path: str):
    quantity = number_at(machine, path)
    return replace(quantity, si=quantity.si * SLOW[path], exact_s=None)


def test_a_wait_without_creep_only_waits(tmp_path: Path) -> None:
    file = tmp_path / "list.toml"
    file.write_text(CYCLE.read_text().replace('wait = "x_is', 'creep = false\nwait = "x_is'))
    machine = load_machine(TRIMMED)
    plan = plan_job(read_job(file, machine), machine, Options())
    waits = {e.tick: e.name for e in plan.commands.events if e.kind == "wait"}
    creeping = [waits[creep.tick] for creep in switch_schedule(plan.commands).creeps]
    assert creeping == ["z_is_down", "z_is_up", "z_is_down", "z_is_up"]
    assert plan.scheduled.creeping.keys() == {"Z"}


def test_creep_is_part_of_the_hash_and_of_the_message() -> None:
    whole = commands()
    assert all(creep_of(list(creep.row)) == creep for creep in whole.creeps)
    later = replace(whole.creeps[0], every=whole.creeps[0].every + 1)
    hashes = {one.rows_sha256() for one in (whole, replace(whole, creeps=(later,)))}
    assert len(hashes | {replace(whole, creeps=()).rows_sha256()}) == 3
    for wrong in ([1, 2], [*whole.creeps[0].row[:-1], 7], [0, 0, 2, 2, 0, 9, 1], "word"):
        with pytest.raises(LinkFaultError):
            creep_of(wrong)
    with pytest.raises(ValueError, match="does not have 16 levels"):
        replace(whole, creeps=(replace(later, levels=(1,)),))
    assert Creep.of_row(later.row) == later


def test_every_further_cycle_creeps_as_the_program_does(tmp_path: Path) -> None:
    """The list ends with a move whose switch is awaited at the begin of the next cycle."""
    text = CYCLE.read_text().replace(
        'valve = "main_air"', 'valve = "main_air"\nfirst_cycle_only = true'
    )
    file = tmp_path / "list.toml"
    file.write_text(text[: text.rindex("[[operation]]")])
    machine = load_machine(TRIMMED)
    both = plan_job(read_job(file, machine), machine, Options()).scheduled
    assert both.single is not None
    one, two = both.single.commands.creeps, both.commands.creeps
    later = both.steady_tick - both.again_tick
    assert len(one) == 5
    assert [creep.tick for creep in two] == [
        *(creep.tick for creep in one), *(creep.tick + later for creep in one),
    ]  # fmt: skip
