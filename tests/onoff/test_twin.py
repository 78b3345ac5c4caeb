"""The twin of an on/off machine: exact instants, streams, and variants beside their machines."""

from __future__ import annotations

import pickle
import tracemalloc
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from threadline.dynamics.pneumatic import cylinder_equations
from threadline.errors import MachineError
from threadline.files import Clock, Event, SwitchSchedule
from threadline.machine import Machine, load_machine
from threadline.machine.numbers import number_at
from threadline.machine.variants import drawn, numbers_at, variant
from threadline.proof.options import Options
from threadline.proof.pipeline import prove
from threadline.twin.switching import SwitchOptions, simulate_switching, simulate_switchings
from threadline.verdict import load_spec

OUTPUTS = ("x_right", "x_right_a1", "x_right_a2", "x_left", "x_left_a1", "x_left_a2",
           "z_down", "z_down_a1", "z_down_a2", "z_up", "z_up_a1", "z_up_a2")  # fmt: skip


def schedule(machine: Machine, scan_s: Fraction, rows: list[tuple[int, tuple[str, ...]]],
             duration: int, events: tuple[Event, ...] = ()) -> SwitchSchedule:  # fmt: skip
    """Return a schedule of outputs that are on from scans on."""
    return SwitchSchedule(
        clock=Clock("scan", scan_s),
        outputs=OUTPUTS,
        ticks=np.array([tick for tick, _ in rows]),
        levels=np.array([[int(name in on) for name in OUTPUTS] for _, on in rows]),
        operation=np.zeros(len(rows), dtype=np.int64),
        duration_ticks=duration,
        job_sha256="",
        machine_sha256=machine.sha256,
        events=events,
    )


def plain(machine: Machine, delay_s: str) -> Machine:
    """Return a machine whose X has no ramp, so that its equations are linear, and a dead time."""
    cylinder = machine.cylinders["X"]
    exact = Fraction(delay_s)
    delay = replace(cylinder.delay, si=float(exact), exact_s=exact)
    cylinder = replace(cylinder, air_ramp=None, delay=delay)
    return replace(machine, cylinders={**machine.cylinders, "X": cylinder})


@pytest.mark.parametrize("delay_s", ["0.1234567", "1e-7", "0.02", "0.20050000001"])
@pytest.mark.parametrize("scan_s", [Fraction(1, 100), Fraction(73, 10_000)])
def test_any_dead_time_arrives_where_it_should(delay_s: str, scan_s: Fraction) -> None:
    """Compared with DOP853 on the plant's own matrices, restarted where each level arrives."""
    machine = plain(load_machine("letter-placer"), delay_s)
    half, full = ("x_right", "x_right_a1"), ("x_right", "x_right_a1", "x_right_a2")
    commands = schedule(machine, scan_s, [(0, half), (11, full), (23, ())], 30)
    recording = simulate_switching(commands, machine, SwitchOptions(after_s=0.3))
    times, found = recording.samples("X.load")
    plant = cylinder_equations(machine, "X")
    matrix, push = plant.sliding()[0], plant.level[0]
    arrivals = [float(scan_s * k) + float(Fraction(delay_s)) for k in (0, 11, 23)]
    bounds, state, expected = [0.0, *arrivals, float(times[-1])], np.zeros(len(push)), []
    for level, begin, end in zip((0.0, 0.63, 1.0, 0.0), bounds[:-1], bounds[1:], strict=True):
        inside = times[(times >= begin) & ((times < end) | (end == bounds[-1]))]
        done = solve_ivp(
            lambda t, x, pushed=level * push: matrix @ x + pushed,
            (begin, end), state, method="DOP853", t_eval=np.union1d(inside, [end]),
            rtol=1e-9, atol=1e-13,
        )  # fmt: skip
        expected += list(plant.stroke @ done.y[:, : len(inside)])
        state = done.y[:, -1]
    assert max(expected) > 0.04
    # DOP853 at 1e-9 with a beam of 1.6 kHz: two runs at other tolerances differ by 2e-10 m.
    assert np.abs(found - np.array(expected)).max() < 2e-8


def test_a_dead_time_of_many_digits_costs_nothing_more() -> None:
    """It has as many samples as a round one; a time with too many is refused, with both numbers."""
    base = load_machine("letter-placer")
    commands = schedule(base, Fraction(1, 100), [(0, ("x_right", "x_right_a1"))], 20)
    for delay_s in ("0.2", "0.1234567"):
        machine = plain(base, delay_s)
        assert len(simulate_switching(commands, machine).samples("X.load")[0]) == 1200
    beyond = plain(base, "0.12345678901234567890")
    with pytest.raises(MachineError, match=r"cylinders\.X: a dead time of 0\.123457 s and a scan"):
        simulate_switching(commands, beyond)


def test_a_long_recording_streams() -> None:
    """Five minutes are 0.3 million samples of 36 channels: 87 MB if they were kept."""
    machine = load_machine("letter-placer")
    commands = schedule(machine, Fraction(1, 100), [(0, ("x_right", "x_right_a1"))], 30_000)
    recording = simulate_switching(commands, machine)
    next(iter(recording))  # compiled
    tracemalloc.start()
    samples = sum(len(block.samples["X.load"]) for block in recording)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert samples == 301_000
    assert peak < 30e6


def test_the_recording_is_the_same_when_it_is_read_again_and_elsewhere() -> None:
    machine = load_machine("letter-placer")
    wait = Event(tick=15, kind="wait", operation=0, name="x_is_left", value=0)
    rows = [(0, ("x_right", "x_right_a1")), (40, ())]
    commands = schedule(machine, Fraction(1, 100), rows, 50, (wait,))
    recording = simulate_switching(commands, machine)
    first, again = recording.samples("X.frame")[1], recording.samples("X.frame")[1]
    np.testing.assert_array_equal(first, again)
    copied = pickle.loads(pickle.dumps(recording.blocks))
    whole = np.concatenate([block.samples["X.frame"] for block in copied])
    np.testing.assert_array_equal(first, whole)
    (event,) = [event for block in recording for event in block.events]
    # The wait ends with the first scan at which the piston has left its switch at 6 mm.
    load = recording.samples("X.load")[1]
    assert load[event.tick] > 6e-3 >= load[event.tick - 10]


def test_variants_do_what_machines_with_their_numbers_do() -> None:
    """Masses, springs, dead times, speeds, flows, air and switches are all drawn at once."""
    machine = load_machine("letter-placer+hysteresis")
    wait = Event(tick=60, kind="wait", operation=0, name="x_is_right", value=1)
    rows = [(0, ("x_right", "x_right_a1", "x_right_a2")), (110, ("x_left", "x_left_a2"))]
    commands = schedule(machine, Fraction(1, 100), rows, 150, (wait,))
    parts = drawn(machine, 11, np.arange(5))
    numbers = numbers_at(machine, parts)
    many = list(simulate_switchings(commands, machine, numbers))
    ends = set()
    for k, recording in enumerate(many):
        own = variant(machine, parts[k])
        single = simulate_switching(replace(commands, machine_sha256=own.sha256), own)
        channels = ("X.load", "X.frame", "Z.frame", "x_is_right")
        ours, theirs = recording.samples_of(channels), single.samples_of(channels)
        for channel in channels:
            np.testing.assert_array_equal(ours[channel][1], theirs[channel][1])
        ends.add(len(ours["X.load"][1]))
    assert len(ends) > 1  # each waits for its own switch


@pytest.mark.parametrize(
    "path",
    ["cylinders.X.delay", "cylinders.X.lag", "cylinders.X.speed", "cylinders.X.air_stiffness",
     "cylinders.X.air_damping", "cylinders.X.air_ramp", "cylinders.X.friction",
     "cylinders.X.stiction", "cylinders.X.stroke", "cylinders.X.forward.flows.x_right_a1",
     "cylinders.X.cushion.length", "cylinders.X.cushion.flow", "cylinders.X.frame.table",
     "bodies.head.inertia", "bodies.table.damping", "links.feet.stiffness",
     "links.air.damping", "contacts.x_is_right.at"],
)  # fmt: skip
def test_every_number_of_a_cylinder_can_vary(path: str) -> None:
    """Another value of each moves something: none is accepted and ignored."""
    machine = load_machine("letter-placer+hysteresis+data-sheet")
    wait = Event(tick=15, kind="wait", operation=0, name="x_is_left", value=0)
    rows = [(0, ("x_right", "x_right_a1", "x_right_a2")), (110, ())]
    commands = schedule(machine, Fraction(1, 100), rows, 130, (wait,))
    own = number_at(machine, path).si
    channels = ("X.load", "X.frame", "x_is_right")
    same, other = (
        one.samples_of(channels)
        for one in simulate_switchings(commands, machine, {path: np.array([own, 0.9 * own])})
    )
    ends = [len(one["X.load"][1]) for one in (same, other)]
    moved = any(
        not np.array_equal(same[c][1][: min(ends)], other[c][1][: min(ends)]) for c in channels
    )
    assert moved or ends[0] != ends[1]


def test_a_cushion_throttles_the_way_in_and_not_the_way_out() -> None:
    """Back from its end a piston passes 150 mm at nearly the same instant, with or without one.

    At 0.27 m/s the 22 mm of the cushion take 80 ms; a flow throttled to 42 % would take 190 ms, 110
    more. The remaining difference is a bounce of the piston as it comes off, which the cushion
    absorbs.
    """
    rows = [(0, ("x_right", "x_right_a1", "x_right_a2")), (180, ("x_left", "x_left_a1"))]
    strokes = []
    for overlay in ("", "+data-sheet"):
        machine = load_machine(f"letter-placer{overlay}")
        recording = simulate_switching(schedule(machine, Fraction(1, 100), rows, 270), machine)
        strokes.append(recording.samples("X.load")[1])
    assert strokes[0][1790] == pytest.approx(0.2, abs=1e-6)
    passed = [int(np.argmax(stroke[1800:] < 0.15)) for stroke in strokes]  # ms
    assert 300 < passed[0] < 700
    assert abs(passed[1] - passed[0]) < 30
    assert np.abs(strokes[0][:900] - strokes[1][:900]).max() > 1e-3


class Frame(NamedTuple):
    """A head on a sprung table, with the air between them, in SI units."""

    head: float
    table: float
    spring: float
    dashpot: float
    air: float
    air_damping: float
    lag: float


PLACER = Frame(6.0, 73.54 + 1.0, 2.7e4, 24.0, 35.7e3, 300.0, 0.12)
GANTRY = Frame(4.0, 12.0, 56.3e3, 20.0, 12e3, 90.0, 0.04)
"""A light one, 10.9 Hz: what springs off its stop moves it by a fifth of what it swings."""


def stopped_frame(of: Frame, speed: float, restitution: float) -> tuple[list[float], float]:
    """Return the table at every ms, m, and how far the piston comes off its stop, m, by hand.

    Two masses with the cylinder fixed to the table; the stop only pushes, and its force is the
    force of the whole balance, the table's acceleration included.
    """
    head, table = of.head, of.table
    step = 1e-5
    z = vz = w = vw = flow = air = 0.0
    holds, hit, least = False, False, 0.2
    places = []
    for i in range(190_000):
        if i % 100 == 0:
            places.append(z)
        level = 1.0 if 0.2 <= i * step < 0.67 else 0.0
        push = of.air * air + of.air_damping * (flow - (vw - vz)) - 1.5 * (vw - vz)
        feet = -of.spring * z - of.dashpot * vz
        both = feet / (head + table)
        holds = holds and push >= head * both
        at_w, at_z = (both, both) if holds else (push / head, (feet - push) / table)
        slip = vw - vz
        vw, vz = vw + at_w * step, vz + at_z * step
        w, z = w + vw * step, z + vz * step
        flow += step * (speed * level - flow) / of.lag
        air += step * (flow - slip)
        if w - z >= 0.2 and vw > vz and not holds:
            hit = True
            mean, gap = (head * vw + table * vz) / (head + table), restitution * (vw - vz)
            holds = gap < 3e-3
            gap = 0.0 if holds else gap
            vw, vz = mean - table * gap / (head + table), mean + head * gap / (head + table)
            w = z + 0.2
        least = min(least, w - z) if hit else least
    assert hit
    return places, 0.2 - least


def as_machine(of: Frame, speed: float) -> Machine:
    """Return letter-placer with the numbers of a frame, its cylinder fixed to its table."""
    machine = plain(load_machine("letter-placer"), "0.2")
    x, table, head = machine.cylinders["X"], machine.bodies["table"], machine.bodies["head"]
    feet = machine.links["feet"]
    x = replace(
        x,
        reacts_on="table",
        speed=replace(x.speed, si=speed),
        lag=replace(x.lag, si=of.lag, exact_s=None),
        air_stiffness=replace(x.air_stiffness, si=of.air),
        air_damping=replace(x.air_damping, si=of.air_damping),
    )
    table = replace(
        table,
        # The cylinder's body of 1 kg sits on the table.
        inertia=replace(table.inertia, si=of.table - 1.0),
        damping=replace(table.damping, si=of.dashpot),
    )
    head = replace(head, inertia=replace(head.inertia, si=of.head))
    feet = replace(feet, stiffness=replace(feet.stiffness, si=of.spring))
    return replace(
        machine,
        cylinders=machine.cylinders | {"X": x},
        bodies=machine.bodies | {"table": table, "head": head},
        links=machine.links | {"feet": feet},
    )


@pytest.mark.parametrize(("of", "speed"), [(PLACER, 0.46), (PLACER, 0.55), (GANTRY, 0.46)])
def test_a_piston_stays_at_its_stop_as_at_one_that_does_not_spring_back(
    of: Frame, speed: float
) -> None:
    """Compared with two masses by hand whose stop only pushes, over 1.2 s after the impact."""
    machine = as_machine(of, speed)
    rows = [(0, ("x_right", "x_right_a1", "x_right_a2")), (47, ())]
    frame = simulate_switching(schedule(machine, Fraction(1, 100), rows, 190), machine)
    ours = frame.samples("X.frame")[1][:1900]
    swing = float(np.ptp(ours[1000:])) / 2.0
    inelastic, away = stopped_frame(of, speed, 0.0)
    assert away < 1e-6
    assert np.abs(ours - inelastic).max() < 0.01 * swing
    # A stop that gives half of the speed back throws it off, by tenths of a millimetre; a light
    # frame is then elsewhere by a sixth of its swing.
    bounced, away = stopped_frame(of, speed, 0.5)
    assert away > 1e-4
    least, most = (0.005, 0.05) if of is PLACER else (0.1, 0.2)
    assert least * swing < np.abs(ours - bounced).max() < most * swing


def test_a_piston_that_the_frame_pulls_off_its_stop_comes_off() -> None:
    """Pressed gently, on a light frame, it leaves the stop as the two masses do, and comes back."""
    rows = [(0, ("x_right", "x_right_a1", "x_right_a2")), (47, ())]
    machine = as_machine(GANTRY, 0.425)
    run = simulate_switching(schedule(machine, Fraction(1, 100), rows, 190), machine)
    table, away = stopped_frame(GANTRY, 0.425, 0.0)
    assert away > 1e-3
    assert np.abs(run.samples("X.frame")[1][:1900] - table).max() < 1e-5


@pytest.mark.parametrize("step", ["", 'step = "back"\n'])
def test_moves_before_a_named_step_are_judged(tmp_path: Path, step: str) -> None:
    """A list that names no step, or its first one late, has a step from its begin."""
    file = tmp_path / "list.toml"
    file.write_text(
        'name = "list"\n[[operation]]\nvalve = "main_air"\n[[operation]]\nmove = { X = "200 mm" }\n'
        f'[[operation]]\n{step}move = {{ X = "0 mm" }}\n'
    )
    machine = load_machine("letter-placer")
    verdict = prove(file, machine, load_spec(None, machine), Options()).verdict
    ends = [r for r in verdict.results if r.name == "end_position_error" and r.axis == "X"]
    assert ends and all(r.measured is not None for r in ends)


def test_a_scan_that_comes_late_switches_late() -> None:
    """The piston covers its speed times the real time between two scans; the next draw differs."""
    machine = plain(load_machine("letter-placer+jitter"), "0.2")
    rows = [(3, ("x_right", "x_right_a1", "x_right_a2")), (33, ())]
    orders = schedule(machine, Fraction(1, 100), rows, 60)
    x, covered = machine.cylinders["X"], set[float]()
    for seed in range(4):
        run = simulate_switching(orders, machine, SwitchOptions(scans=seed, after_s=2.0))
        late_s = np.random.default_rng(seed).integers(-2, 3, 4093)[[3, 33]] * 1e-3
        at = np.flatnonzero(np.diff(run.samples("x_right")[1])) + 1
        assert at * 1e-3 == pytest.approx([0.03 + late_s[0], 0.33 + late_s[1]], abs=1e-9)
        wanted_m = x.speed.si * (0.3 + late_s[1] - late_s[0])
        assert run.samples("X.load")[1][-1] == pytest.approx(wanted_m, abs=2e-5)
        covered.add(round(wanted_m, 9))
    assert len(covered) > 1
    even = simulate_switching(orders, machine, SwitchOptions(after_s=2.0))
    assert even.samples("X.load")[1][-1] == pytest.approx(0.3 * x.speed.si, abs=2e-5)
