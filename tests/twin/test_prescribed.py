"""Drives that take positions: the loads behind them, needed torque, and available torque."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from threadline.cli.main import main
from threadline.dynamics.analysis import unstable_loops
from threadline.dynamics.loop import axis_loop
from threadline.dynamics.plausibility import plausibility_warnings
from threadline.dynamics.prescribed import Prescribed, prescribed, resonance_hz
from threadline.dynamics.without_loop import analyse_moving
from threadline.errors import MachineError, OptionError
from threadline.files import RunEnd, Stream, TickBlock, TickTable
from threadline.machine import Machine, load_machine
from threadline.machine.sources import PulseServo, Stepper, Winding, pull_out_torque
from threadline.machine.variants import drawn, variant
from threadline.machine.vary import vary
from threadline.proof.options import Options
from threadline.proof.pipeline import check_loops, prove
from threadline.twin.prescribed import advances_of
from threadline.twin.simulate import simulate
from threadline.verdict import Status, load_spec

RADIUS, MASS, K, C, DAMPING = 6.366198e-3, 1.2, 60e3, 25.0, 8.0
ROTOR, MOTOR_DAMPING, FRICTION = 3.2e-5, 1e-4, 0.02
PER_RAD = 200 * 16 / (2 * np.pi)
TICK = 1e-3


def table(machine: Machine, counts: np.ndarray) -> TickTable:
    """Return a table that moves X alone."""
    both = np.zeros((len(counts), 2), dtype=np.int64)
    both[:, machine.axis_names.index("X")] = counts
    block = TickBlock(first_tick=0, counts=both, operation=np.zeros(len(counts), dtype=np.int64))
    return TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(2, dtype=np.int64),
        blocks=Stream.of([block]),
        job_sha256="",
        machine_sha256=machine.sha256,
    )


def stroke(ticks: int = 240) -> np.ndarray:
    """Return counts of 30 mm forth in a fast S: up to 0.25 m/s."""
    s = np.linspace(0.0, 1.0, ticks + 1)
    return np.diff(np.rint(2400 * (s - np.sin(2 * np.pi * s) / (2 * np.pi)))).astype(np.int64)


def other(machine: Machine, **changes: object) -> Machine:
    """Return a machine whose drive of X has other fields."""
    return replace(machine, drives={**machine.drives, "x": replace(machine.drives["x"], **changes)})


@pytest.fixture(scope="module")
def machine() -> Machine:
    """Return the library's machine with a perfect stepper."""
    return other(load_machine("stepper-winder"), microstep_error=None)


def by_dop853(at: np.ndarray, speed: np.ndarray, ticks: int) -> np.ndarray:
    """Return position and speed of the eye at the ticks, restarted where the speed jumps."""
    state, found = np.zeros(2), [np.zeros(2)]
    for k in range(ticks):

        def slope(t: float, x: np.ndarray, k: int = k) -> list[float]:
            motor = RADIUS * (at[k] + speed[k] * t)
            pull = K * (motor - x[0]) + C * (RADIUS * speed[k] - x[1])
            return [x[1], (pull - DAMPING * x[1]) / MASS]

        done = solve_ivp(slope, (0.0, TICK), state, method="DOP853", rtol=1e-12, atol=1e-15)
        state = done.y[:, -1]
        found.append(state)
    return np.array(found)


@pytest.mark.parametrize("error_rad", [0.0, np.radians(0.09)])
def test_the_load_follows_its_belt_as_an_independent_integration_has_it(
    machine: Machine, error_rad: float
) -> None:
    """DOP853 at 1e-12 on Newton's law by hand; both are exact between ticks."""
    if error_rad:
        machine = load_machine("stepper-winder")
    counts = stroke()
    recording = simulate(table(machine, counts), machine, settle_s=0.2)
    load = recording.samples("X.load")[1]
    ticks = len(load)
    travelled = np.concatenate(([0], np.cumsum(counts), np.full(ticks, counts.sum())))[: ticks + 1]
    at = travelled / PER_RAD
    # The error of a microstep repeats with every full step; the motor starts in the middle of one.
    at = at + error_rad * np.sin(2 * np.pi * (travelled / 16 + 0.5))
    at -= at[0]
    expected = by_dop853(at, np.diff(at) / TICK, ticks - 1)
    assert np.abs(load - expected[:, 0]).max() < 1e-11
    # It swings behind the motor at sqrt(k/m) = 35.6 Hz, by much more than that.
    assert np.abs(expected[:, 0] - RADIUS * at[:-1]).max() > 5e-5


def test_torque_is_inertia_belt_and_friction(machine: Machine) -> None:
    """By hand from the integration above, over the curve's torque at that speed."""
    counts = stroke()
    recording = simulate(table(machine, counts), machine, settle_s=0.05)
    share = recording.samples("X.torque_share")[1]
    ticks = len(share)
    travelled = np.concatenate(([0], np.cumsum(counts), np.full(ticks, counts.sum())))[: ticks + 1]
    at = travelled / PER_RAD
    speed = np.diff(at) / TICK
    load = by_dop853(at, speed, ticks - 1)
    drive = machine.drives["x"]
    assert isinstance(drive, Stepper)
    # A microstep more or less is taken up in half a period of the motor's own swing: 223 Hz, of
    # 1.26 N m times a sine that goes round 50 times a turn.
    swing = np.sqrt(50 * 1.26 / ROTOR) / (2 * np.pi)
    assert resonance_hz(drive, ROTOR) == pytest.approx(swing, rel=1e-9)
    n = round(0.5 / (swing * TICK))
    before = np.concatenate((np.zeros(n), speed))[:ticks]
    mean = 0.5 * (np.concatenate(([0.0], speed))[:ticks] + speed)
    belt = K * (RADIUS * at[:ticks] - load[:, 0]) + C * (RADIUS * mean - load[:, 1])
    torque = ROTOR * (speed - before) / (n * TICK) + RADIUS * belt + MOTOR_DAMPING * mean
    torque += FRICTION * np.sign(mean)
    np.testing.assert_allclose(share, np.abs(torque) / drive.most_torque(mean), atol=1e-9)
    assert share.max() > 0.08


def test_the_largest_share_between_samples_is_kept(machine: Machine) -> None:
    commands = table(machine, stroke())
    fine = simulate(commands, machine).samples("X.torque_share")[1]
    coarse = simulate(commands, machine, record_every=7).samples("X.torque_share")[1]
    assert coarse.max() == fine[: 7 * (len(coarse) - 1) + 1].max()
    assert coarse[3] == fine[15:22].max()
    copied = pickle.loads(pickle.dumps(simulate(commands, machine).blocks))
    np.testing.assert_array_equal(
        np.concatenate([block.samples["X.torque_share"] for block in copied]), fine
    )


@pytest.mark.parametrize("per_ms", [10, 1000])
def test_a_rotor_takes_its_time_for_a_step_that_comes_within_a_microsecond(
    tmp_path: Path, per_ms: int
) -> None:
    """A count in a tick of 1 us is 12.5 m/s of the belt: taken for a speed, its run fell slack.

    The load equals one with pulses spread evenly over 1 ms, except for a delay of less than that;
    so does the torque.
    """
    file = tmp_path / "mine.toml"
    file.write_text(
        'base = "stepper-winder"\nname = "mine"\n'
        f'[clocks]\npulse = "{1 / per_ms} ms exact, assumed"\n'
    )
    usual, fine = load_machine("stepper-winder"), load_machine(str(file))
    counts = stroke()
    moves = np.interp(
        np.arange(240 * per_ms + 1) / per_ms,
        np.arange(241),
        np.concatenate([[0], np.cumsum(counts)]),
    )
    rows = np.diff(np.floor(moves + 0.5)).astype(np.int64)
    coarse = simulate(table(usual, counts), usual, settle_s=0.05)
    found = simulate(table(fine, rows), fine, settle_s=0.05)
    there, here = coarse.samples("X.load")[1], found.samples("X.load")[1][::per_ms]
    size = min(len(there), len(here))
    assert size > 280
    assert np.abs(here[:size] - there[:size]).max() < 0.25 * 1e-3
    asked = [one.samples("X.torque_share")[1].max() for one in (coarse, found)]
    assert asked[1] == pytest.approx(asked[0], rel=0.3)


@pytest.mark.parametrize("volts", [12.0, 36.0, 80.0])
def test_pull_out_torque_is_the_most_that_voltage_and_current_allow(volts: float) -> None:
    """Every current on a grid of 2e5, without those that need more voltage than there is."""
    drive = load_machine("stepper-winder").drives["x"]
    assert isinstance(drive, Stepper) and drive.winding is not None
    winding = replace(drive.winding, supply=replace(drive.winding.supply, si=volts))
    most, k, ohm, henry = 2.8, 1.26 / 2.8, 0.9, 2.5e-3
    angle, size = np.meshgrid(np.linspace(0, 2 * np.pi, 2001), np.linspace(0, most, 101))
    current = size * np.exp(1j * angle)
    for speed in (0.0, 3.0, 20.0, 60.0, 150.0, 400.0):
        # 1.8 degrees a step: 50 electrical turns in one turn of the shaft.
        needed = (ohm + 1j * 50 * speed * henry) * current + 1j * k * speed
        best = k * current.imag[np.abs(needed) <= volts].max(initial=0.0)
        (found,) = pull_out_torque(winding, 200 / (2 * np.pi), np.array([speed]))
        assert found >= best - 1e-9
        assert found == pytest.approx(best, abs=0.02)


def test_curve_points_are_joined_and_end() -> None:
    drive = load_machine("stepper-winder").drives["x"]
    assert isinstance(drive, Stepper) and drive.winding is not None
    torque = drive.winding.holding_torque

    def point(speed: float, value: float) -> object:
        from threadline.machine.sources import CurvePoint

        of = replace(torque, si=speed, unit="rad/s", tolerance_si=0.0)
        return CurvePoint(speed=of, torque=replace(torque, si=value))

    curve = (point(0.0, 1.2), point(50.0, 1.0), point(150.0, 0.4))
    drive = replace(drive, winding=None, curve=curve)
    found = drive.most_torque(np.array([0.0, -25.0, 100.0, 150.0, 151.0]))
    np.testing.assert_allclose(found, [1.2, 1.1, 0.7, 0.4, 0.0])


def test_a_pulse_servo_follows_with_its_bandwidth(machine: Machine) -> None:
    """A critically damped second-order lag and its load, by DOP853."""
    drive = machine.drives["x"]
    assert isinstance(drive, Stepper)
    torque = drive.winding.holding_torque  # type: ignore[union-attr]
    resolution = replace(drive.full_steps, si=PER_RAD)
    servo = PulseServo(
        kind="pulse-servo", body="x_motor", clock="pulse", resolution=resolution,
        bandwidth=replace(torque, si=30.0, unit="Hz", tolerance_si=0.0), torque_limit=torque,
    )  # fmt: skip
    machine = replace(machine, drives={**machine.drives, "x": servo})
    counts = stroke()
    recording = simulate(table(machine, counts), machine, settle_s=0.1)
    load, share = recording.samples("X.load")[1], recording.samples("X.torque_share")[1]
    commanded = np.concatenate(([0], np.cumsum(counts), np.full(len(load), counts.sum()))) / PER_RAD
    w, state, found, asked = 2 * np.pi * 30.0, np.zeros(4), [], []
    for k in range(len(load)):
        found.append(state[0])
        belt = K * (RADIUS * state[2] - state[0]) + C * (RADIUS * state[3] - state[1])
        turning = w * w * (commanded[k] - state[2]) - 2 * w * state[3]
        torque_now = ROTOR * turning + RADIUS * belt + MOTOR_DAMPING * state[3]
        asked.append(abs(torque_now + FRICTION * np.sign(state[3])) / 1.26)

        def slope(t: float, x: np.ndarray, k: int = k) -> list[float]:
            command = commanded[k] + (commanded[k + 1] - commanded[k]) * t / TICK
            pull = K * (RADIUS * x[2] - x[0]) + C * (RADIUS * x[3] - x[1])
            return [
                x[1],
                (pull - DAMPING * x[1]) / MASS,
                x[3],
                w * w * (command - x[2]) - 2 * w * x[3],
            ]

        state = solve_ivp(slope, (0, TICK), state, method="DOP853", rtol=1e-11, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(load, found, atol=1e-10)
    np.testing.assert_allclose(share, asked, atol=1e-6)


def test_a_motion_that_loses_steps_is_out_of_spec(tmp_path: Path) -> None:
    """Weak motors on a fast job: the verdict names axis, time and line; strong ones pass."""
    job = tmp_path / "fast.prg"
    job.write_text("N10 G01 F18000;\nN20 G91;\nN30 X 200;\nN40 X -200;\nN50 M30;\n")
    strong = load_machine("stepper-winder")
    drive = strong.drives["x"]
    assert isinstance(drive, Stepper) and isinstance(drive.winding, Winding)
    held = drive.winding.holding_torque
    weak = other(strong, winding=replace(drive.winding, holding_torque=replace(held, si=0.08)))
    for one, status in ((strong, Status.PASSED), (weak, Status.FAILED)):
        proof = prove(job, one, load_spec(None, one), Options())
        result = proof.verdict.result("step_loss", "X")
        assert result.status is status
        assert proof.verdict.passed == (status is Status.PASSED)
    assert result.measured is not None and result.measured > 1.0
    assert result.job_line in {3, 4} and result.time_s is not None
    assert any("drives.x needs" in s and "has 0.08" in s for s in plausibility_warnings(weak))


def test_machine_without_loops_passes_the_stability_check(machine: Machine) -> None:
    check_loops(machine)
    assert unstable_loops(machine) == []
    with pytest.raises(OptionError, match=r"axis X of 'stepper-winder' has no loop: drives\.x"):
        axis_loop(machine, "X")
    output = analyse_moving(machine, "X")
    assert output.as_json()["modes_hz"] == [
        pytest.approx(np.sqrt(K / MASS) / (2 * np.pi), rel=1e-3)
    ]
    assert "has no loop" in output.verdict()


def test_parts_that_are_not_linear_are_refused_by_name(machine: Machine) -> None:
    friction = machine.bodies["x_motor"].friction
    assert friction is not None
    rubbing = replace(machine.bodies["x_eye"], friction=replace(friction, si=2.0, unit="N"))
    bad = replace(machine, bodies={**machine.bodies, "x_eye": rubbing})
    with pytest.raises(MachineError, match=r"bodies\.x_eye\.friction is not linear, and"):
        simulate(table(machine, stroke()), bad)
    loose = replace(machine.links["x_belt"], preload=replace(friction, si=1.0, unit="N"))
    bad = replace(machine, links={**machine.links, "x_belt": loose})
    recording = simulate(table(machine, stroke()), bad)
    outcome = recording.outcome()
    assert outcome.ended is RunEnd.FAULT and "links.x_belt: a run falls slack" in outcome.text
    known = recording.samples("X.load")[1]
    whole = simulate(table(machine, stroke()), machine).samples("X.load")[1]
    assert 1 < len(known) < 100 and outcome.tick == len(known)
    np.testing.assert_array_equal(known, whole[: len(known)])


def test_numbers_of_a_stepper_drive_vary() -> None:
    machine = load_machine("stepper-winder")
    one = variant(machine, drawn(machine, 1, np.array([4]))[0])
    first, second = (simulate(table(m, stroke()), m).samples("X.torque_share")[1].max()
                     for m in (machine, replace(one, axes=machine.axes)))  # fmt: skip
    assert abs(second / first - 1.0) > 0.01
    drive, own = one.drives["x"], machine.drives["x"]
    assert isinstance(drive, Stepper) and isinstance(own, Stepper)
    assert drive.winding is not None and own.winding is not None
    assert drive.winding.inductance.si != own.winding.inductance.si


def test_equations_are_made_once_for_the_same_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Days are drawn anew for every plan of a search; a machine with another number is not kept."""
    made: list[Machine] = []

    def counted(machine: Machine) -> tuple[Prescribed, ...]:
        made.append(machine)
        return prescribed(machine)

    monkeypatch.setattr("threadline.twin.prescribed.prescribed", counted)
    load = load_machine("stepper-winder")
    machines = [vary(load, friction=1.0 + 1e-9 * k, supply=1.1, damping=0.9) for k in range(20)]
    first = [advances_of(machine) for machine in machines]
    assert made == machines
    again = [vary(load, friction=1.0 + 1e-9 * k, supply=1.1, damping=0.9) for k in range(20)]
    for one, machine in zip(first, again, strict=True):
        assert advances_of(machine) is one
    assert len(made) == 20
    for change in ({"friction": 1.0 + 1e-15}, {"supply": 1.1001}, {"damping": 0.9001}):
        numbers = {"friction": 1.0, "supply": 1.1, "damping": 0.9} | change
        assert advances_of(vary(load, **numbers)) not in first
    # At most 64 are kept: the first ones are made again after as many others.
    for k in range(64):
        advances_of(vary(load, friction=2.0 + k))
    before = len(made)
    advances_of(machines[0])
    assert len(made) == before + 1


@pytest.mark.parametrize("option", [["--lead", "13.5Hz,60deg"], ["--experiments"]])
def test_options_on_loops_are_refused_for_a_machine_without_loops(
    option: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["analyse", "stepper-winder", *option])
    assert stopped.value.code == 2
    assert "axis A of 'stepper-winder' has none" in " ".join(capsys.readouterr().err.split())
