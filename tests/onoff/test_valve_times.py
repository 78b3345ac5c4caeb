"""Valves that close later than they open: on the twin, in plans and in searches."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.onoff.test_twin import plain, schedule
from threadline.base.arrays import FloatArray
from threadline.cli.main import main
from threadline.commands.schedule import compile_schedule
from threadline.commands.schedule_moves import valves_of
from threadline.dynamics.pneumatic import cylinder_equations, step_ringing
from threadline.errors import PlanError
from threadline.jobs import read_job
from threadline.machine import Machine, load_machine
from threadline.machine.quantity import Quantity
from threadline.motion.shaping.onoff.flow_search import FlowMove, flow_command, least_scans
from threadline.motion.shaping.onoff.switched import Valves
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.search.cycle_robust import robust_cycle
from threadline.search.move_commands import residual_ringing
from threadline.search.move_list import move_list
from threadline.search.paced import Question
from threadline.twin.switching import SwitchOptions, ringing_m, simulate_switching
from threadline.verdict import load_spec

UNEQUAL = "letter-placer+unequal-valves"
DOWN_AND_UP = """
[[operation]]
step = "start"
valve = "main_air"

[[operation]]
step = "descend"
move = { Z = "100 mm" }

[[operation]]
wait = "z_is_down"

[[operation]]
step = "lift"
move = { Z = "0 mm" }

[[operation]]
wait = "z_is_up"
"""


def with_times(machine: Machine, opens: str, closes: str) -> Machine:
    """Return a machine whose X has valves of these times forward."""

    def time(text: str) -> Quantity:
        return replace(machine.cylinders["X"].delay, si=float(text), exact_s=Fraction(text))

    cylinder = machine.cylinders["X"]
    way = replace(cylinder.forward, opens=time(opens), closes=time(closes))
    return replace(machine, cylinders={**machine.cylinders, "X": replace(cylinder, forward=way)})


@pytest.mark.parametrize(("opens", "closes"), [("0.0137", "0.0311"), ("0.03", "0.004")])
def test_each_flow_comes_and_goes_in_its_own_time(opens: str, closes: str) -> None:
    """Compared with DOP853 on the plant's matrices, restarted where a flow opens or closes.

    At scan 11 one flow control gives way to the other: as long as one closes later than the other
    opens, both are open, or neither.
    """
    machine = with_times(plain(load_machine("letter-placer"), "0.1"), opens, closes)
    first, then = ("x_right", "x_right_a1"), ("x_right", "x_right_a2")
    commands = schedule(machine, Fraction(1, 100), [(0, first), (11, then), (23, ())], 30)
    recording = simulate_switching(commands, machine, SwitchOptions(after_s=0.3))
    times, found = recording.samples("X.load")
    plant = cylinder_equations(machine, "X")
    matrix, push = plant.sliding()[0], plant.level[0]
    o, c = 0.1 + float(opens), 0.1 + float(closes)
    changes = [(o, 0.63), (0.11 + o, 0.37), (0.11 + c, -0.63), (0.23 + c, -0.37)]
    level, state, expected = 0.0, np.zeros(len(push)), []
    bounds = [(0.0, 0.0), *sorted(changes), (float(times[-1]), 0.0)]
    for (begin, change), (end, _) in pairwise(bounds):
        level += change
        inside = times[(times >= begin) & ((times < end) | (end == times[-1]))]
        done = solve_ivp(
            lambda t, x, pushed=level * push: matrix @ x + pushed,
            (begin, end), state, method="DOP853", t_eval=np.union1d(inside, [end]),
            rtol=1e-9, atol=1e-13,
        )  # fmt: skip
        expected += list(plant.stroke @ done.y[:, : len(inside)])
        state = done.y[:, -1]
    assert max(expected) > 0.03
    # As in the test of the dead time: two runs of DOP853 at other tolerances differ by 2e-10 m.
    assert np.abs(found - np.array(expected)).max() < 2e-8


def test_a_broken_beam_lets_through_what_has_not_closed_yet() -> None:
    """The piston goes on at its speed for as long as its valves take to close."""
    base = load_machine("letter-placer")
    row = ("x_right", "x_right_a1", "x_right_a2")
    went = []
    for closes in ("0.001", "0.041"):
        machine = with_times(base, "0.001", closes)
        commands = schedule(machine, Fraction(1, 100), [(0, row), (30, ())], 31)
        options = SwitchOptions(break_s=0.2, after_s=2.0)
        went.append(simulate_switching(commands, machine, options).samples("X.load")[1][-1])
    assert went[0] == pytest.approx(0.43 * 0.20, rel=0.01)
    assert went[1] - went[0] == pytest.approx(0.43 * 0.04, rel=0.01)


@pytest.mark.parametrize("shaper", ["none", "um-zv", "um-zvd"])
def test_commands_are_shorter_by_what_the_flow_lasts_longer(shaper: str, examples: Path) -> None:
    """Each stroke ends within half a scan of its place; unplanned it would be 6 to 26 mm beyond."""
    machine = load_machine(UNEQUAL)
    job = read_job(examples / "letter-cycle.toml", machine)
    made = plan_job(job, machine, Options(shaper=shaper))
    blind = plan_job(job, load_machine("letter-placer"), Options(shaper=shaper))
    for move, other in zip(made.scheduled.moves, blind.scheduled.moves, strict=True):
        scan_m = 0.01 * move.levels.speed_m_s
        assert abs(move.levels.commanded_m - move.levels.wanted_m) <= 0.5 * scan_m + 1e-9
        valves = valves_of(machine.cylinders[move.axis].way(move.forward), 0.01)
        unaware = valves.covered(other.levels.ticks, other.levels.levels) * scan_m
        assert unaware - move.levels.wanted_m > 2.0 * abs(
            move.levels.commanded_m - move.levels.wanted_m
        )
    recording = simulate_switching(made.scheduled.commands, machine)
    _, stroke = recording.samples("X.load")
    down = next(m for m in made.scheduled.moves if m.axis == "X")
    # Told past its end a piston runs into its stop; a fiftieth of speed times lag is left of it.
    assert stroke.max() == pytest.approx(min(down.levels.commanded_m, 0.2), abs=1.1e-3)


def test_ringing_after_a_command_agrees_with_the_closed_form(tmp_path: Path) -> None:
    """Levels with a gap: the twin's ringing to 3 %; without the valve times it is half."""
    machine = load_machine(UNEQUAL)
    file = tmp_path / "gap.toml"
    file.write_text(
        '[[operation]]\nvalve = "main_air"\n[[operation]]\nmove = { X = "161 mm" }\n'
        'levels = "1 for 40 ms, 0 for 40 ms, 1 for 260 ms, 0 for 40 ms, 1 for 30 ms"\n'
    )
    (move,) = (made := compile_schedule(read_job(file, machine), machine)).moves
    valves = valves_of(machine.cylinders["X"].forward, 0.01)
    ringing = step_ringing(machine, "X")
    turn = complex(np.exp(ringing.pole * 0.01))
    left = residual_ringing(move.levels.ticks, move.levels.levels, turn, valves)
    instant = residual_ringing(
        move.levels.ticks, move.levels.levels, turn, Valves(flows=(0.63, 0.37))
    )
    recording = simulate_switching(made.commands, machine, SwitchOptions(after_s=2.0))
    from_s = 0.01 * move.last_tick + machine.cylinders["X"].rest_s(forward=True) + 0.3
    found = ringing_m(recording, "X", from_s, ringing.pole)
    aged = np.exp(ringing.pole.real * (from_s - 0.01 * move.last_tick - 0.2))
    assert found == pytest.approx(abs(left * ringing.amplitude_m) * aged, rel=0.03)
    assert abs(instant) < 0.5 * abs(left)


def test_a_valve_is_not_switched_again_before_it_has_closed(tmp_path: Path) -> None:
    file = tmp_path / "short.toml"
    file.write_text(
        '[[operation]]\nvalve = "main_air"\n[[operation]]\nmove = { X = "200 mm" }\n'
        'levels = "1 for 200 ms, 0 for 20 ms, 1 for 240 ms"\n'
    )
    machine = load_machine(UNEQUAL)
    with pytest.raises(PlanError, match="would switch again after 20 ms; it needs 25 ms"):
        compile_schedule(read_job(file, machine), machine)


def test_the_next_step_waits_for_the_valves_of_the_way_that_was_gone(tmp_path: Path) -> None:
    """The valves of the way back close at once here: 25 ms less than those of the way forth."""
    machine = load_machine(UNEQUAL)
    cylinder = machine.cylinders["X"]
    quick = replace(cylinder, back=replace(cylinder.back, closes=None))
    machine = replace(machine, cylinders={**machine.cylinders, "X": quick})
    file = tmp_path / "there-and-back.toml"
    moves = "".join(f'[[operation]]\nmove = {{ X = "{mm} mm" }}\n' for mm in (161, 0, 161))
    file.write_text(f'[[operation]]\nvalve = "main_air"\n{moves}')
    there, back, again = compile_schedule(read_job(file, machine), machine).moves
    assert (there.forward, back.forward) == (True, False)
    rest_s = cylinder.delay.si + 4.0 * cylinder.lag.si
    assert back.first_tick - there.last_tick == np.ceil((rest_s + 0.025) / 0.01 - 1e-9)
    assert again.first_tick - back.last_tick == np.ceil(rest_s / 0.01 - 1e-9)


def integrated(
    switchings: list[tuple[float, float]], pole: complex, band: FloatArray
) -> FloatArray:
    """Return the amplitudes after changes of the level by DOP853, relative to one step.

    All of the (n,) ``band`` is integrated at once: a step takes the interpreter as long as for one.
    """
    poles = pole * band
    state, level = np.zeros(2 * len(poles)), 0.0
    square, twice = np.abs(poles) ** 2, 2.0 * poles.real

    def pushed(x: FloatArray, level: float) -> FloatArray:
        place, speed = np.split(x, 2)
        return np.concatenate([speed, square * (level - place) + twice * speed])

    for (begin, change), (end, _) in pairwise(sorted(switchings)):
        level += change
        state = solve_ivp(
            lambda _, x, level=level: pushed(x, level),
            (begin, end), state, "DOP853", rtol=1e-10, atol=1e-12,
        ).y[:, -1]  # fmt: skip
    away, speed = np.split(state, 2)
    here = np.hypot(away, (speed - poles.real * away) / poles.imag)
    return np.asarray(here / np.hypot(1.0, poles.real / poles.imag))


@pytest.mark.parametrize("scans", [61, 62])
def test_a_command_for_a_band_knows_when_its_flows_come(scans: int) -> None:
    """Each flow's own changes, by hand, through an integrator, at 21 frequencies of the band."""
    pole, band = -0.154 + 18.27j, np.linspace(0.8, 1.2, 21)
    valves = Valves(flows=(0.63, 0.37), opens=1.0, closes=2.5)
    move = FlowMove(
        on_scans=46.5,
        valves=valves,
        dwell_scans=3,
        turns=np.exp(pole * band * 0.01),
        most=np.full(21, 0.16),
    )
    least = least_scans(move, 80)
    command = flow_command(move, scans)
    assert command is not None
    assert least is not None
    assert least <= scans
    opened = {0.0: (0, 0), 0.37: (0, 1), 0.63: (1, 0), 1.0: (1, 1)}
    changes, before = [], (0, 0)
    for tick, level in zip(command.ticks, command.levels, strict=True):
        now = opened[round(level, 2)]
        for flow, was, is_ in zip((0.63, 0.37), before, now, strict=True):
            if was != is_:
                changes.append((0.01 * (tick + (1.0 if is_ else 2.5)), flow * (is_ - was)))
        before = now
    covered = -sum(at * change for at, change in changes) / 0.01
    assert 46.3 - 1e-9 <= covered <= 46.52 + 1e-9
    worst = integrated(changes, pole, band).max()
    assert worst <= 0.16 * (1.0 + 1e-6)


@pytest.mark.long(
    shown_by="tests/search/test_within.py::test_a_cycle_for_a_band_ends_with_the_one_that_is_tried"
)
def test_the_robust_cycle_of_such_a_machine_is_in_spec_all_over_the_band(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The twin lets each flow come in its own time there, too; compile accepts the found list."""
    machine = load_machine(UNEQUAL)
    spec = load_spec(None, machine)
    down = tmp_path / "down.toml"
    down.write_text(DOWN_AND_UP, encoding="utf-8")
    job = read_job(down, machine)
    found = robust_cycle(Question(job=job, machine=machine, spec=spec), 0.2)
    assert found.job is not None
    assert all(run.verdict.passed for run in found.over)
    assert max(run.worst_m for run in found.over) > 0.05e-3, "most of what may ring is used"
    written = tmp_path / "robust.toml"
    written.write_text(move_list(found.job, machine), encoding="utf-8")
    out = tmp_path / "robust.st"
    with pytest.raises(SystemExit) as ended:
        main(["compile", str(written), "-m", UNEQUAL, "--target", "st", "-o", str(out)])
    capsys.readouterr()
    assert (ended.value.code, out.exists()) == (0, True)
