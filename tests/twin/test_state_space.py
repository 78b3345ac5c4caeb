"""State-space controllers and observing sensors in the twin, by other controllers, and scipy."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scipy.signal import cont2discrete

from threadline.dynamics.values import Values
from threadline.files import ChannelKind, TickBlock, TickTable
from threadline.files.formats import read_recording, write_recording
from threadline.machine import Machine, load_machine
from threadline.machine.controllers import LeadController, PdController, PidController
from threadline.twin.session import Session
from threadline.twin.simulate import simulate, simulate_runs

EQUAL = 1e-9  # relative to the largest value of a channel: sums in another order
WINDER_PID = """base = "lathe-winder"
[controllers.x]
kind = "pid"
ki = "0.05 dac/count exact, assumed"
[controllers.y]
kind = "pid"
ki = "0.02 dac/count exact, assumed"
[controllers.a]
kind = "pid"
ki = "0.02 dac/count exact, assumed"
"""


def of_one_error(controller) -> tuple[list[list[float]], list[float], list[float], float]:
    """A, b, c, d of a controller by its equation in docs/machine-file.md; states e', e'', u'."""
    if isinstance(controller, PdController):
        kp, kd = controller.kp.si, controller.kd.si
        c, d = [-kd, 0.0, 0.0], kp + kd
    elif isinstance(controller, PidController):
        kp, ki, kd = controller.kp.si, controller.ki.si, controller.kd.si
        c, d = [-kp - 2.0 * kd, kd, 1.0], kp + ki + kd
    else:
        assert isinstance(controller, LeadController)
        gain = controller.gain.si
        c, d = [-gain * controller.zero.si, 0.0, -controller.pole.si], gain
    return [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], c], [1.0, 0.0, d], c, d


def rows_of(matrix: np.ndarray) -> str:
    return "[" + ", ".join(str([float(x) for x in row]) for row in matrix) + "]"


def same_as_one(machine: Machine) -> str:
    """Return the overlay that makes one state-space controller of all controllers of a machine."""
    names = list(machine.axes)
    m = len(names)
    A, B = np.zeros((3 * m, 3 * m)), np.zeros((3 * m, 2 * m))
    C, D, L = np.zeros((m, 3 * m)), np.zeros((m, 2 * m)), np.zeros((3 * m, m))
    parts = [machine.controllers[machine.axes[name].controller] for name in names]
    for k, part in enumerate(parts):
        a, b, c, d = of_one_error(part)
        own = slice(3 * k, 3 * k + 3)
        A[own, own], C[k, own] = a, c
        B[own, k], B[own, m + k] = b, -np.array(b)
        D[k, k], D[k, m + k] = d, -d
        L[3 * k + 2, k] = 1.0
    first = parts[0]
    zero = str(first.dac.zero_on_reversal).lower()
    reference = f'reference_clock = "{first.reference_clock}"' if first.reference_clock else ""
    gone = "\n".join(f'{machine.axes[name].controller} = "none"' for name in names)
    quoted = ", ".join(f'"{name}"' for name in names)
    sensors = ", ".join(f'"{part.sensor}"' for part in parts)
    drives = ", ".join(f'"{part.drive}"' for part in parts)
    moved = "\n".join(f'[axes.{name}]\ncontroller = "all"' for name in names)
    return f"""
[controllers]
{gone}
[controllers.all]
kind = "state-space"
clock = "{first.clock}"
{reference}
references = [{quoted}]
sensors = [{sensors}]
drives = [{drives}]
A = {rows_of(A)}
B = {rows_of(B)}
C = {rows_of(C)}
D = {rows_of(D)}
L = {rows_of(L)}
[controllers.all.dac]
bits = "{first.dac.bits.si:g} bit exact, assumed"
range = "{first.dac.range.si:g} V exact, assumed"
zero_on_reversal = {zero}
{moved}
"""


def run(machine: Machine, counts: np.ndarray, **options) -> dict[str, np.ndarray]:
    session = Session(machine, **options)
    rows = TickBlock(
        first_tick=0, counts=counts, operation=np.zeros(len(counts), dtype=np.int64), events=()
    )
    return dict(session.advance(rows).samples)


def jolts(axes: int, ticks: int, size: int) -> np.ndarray:
    """Return rows with jumps that drive the DAC to its ends, slow motion, and reversals."""
    random = np.random.default_rng(43)
    counts = np.zeros((ticks, axes), dtype=np.int64)
    for axis in range(axes):
        for at in range(20, ticks, ticks // 9):
            counts[at, axis] = random.integers(-size, size)
            counts[at + 5 : at + 40, axis] += random.integers(-size // 100, size // 100)
    return counts


def compare(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    assert one.keys() == other.keys()
    for name, samples in one.items():
        size = max(1.0, float(np.abs(samples).max()))
        assert np.abs(samples - other[name]).max() <= EQUAL * size, name


@pytest.mark.parametrize(
    ("base", "quantised"),
    [("lathe-winder", True), ("lathe-winder", False), ("winder-pid", False)],
)
def test_one_controller_for_three_axes_runs_like_their_own(tmp_path, base, quantised):
    """Quantisers only with the PD: its gains are whole, so that sums in any order are exact.

    Elsewhere a sum in another order may change a level of the DAC.
    """
    text = 'base = "lathe-winder"\n' if base == "lathe-winder" else WINDER_PID
    (tmp_path / "own.toml").write_text(text)
    own = load_machine(tmp_path / "own.toml")
    (tmp_path / "all.toml").write_text('base = "own.toml"\n' + same_as_one(own))
    counts = jolts(3, 900, 2000)
    first = run(own, counts, quantised=quantised)
    second = run(load_machine(tmp_path / "all.toml"), counts, quantised=quantised)
    assert np.abs(first["X.voltage"]).max() >= 9.99  # the DAC was at its end, and the clamp counts
    compare(first, second)


def test_lead_filters_with_dead_time_and_another_clock_run_alike(tmp_path):
    own = load_machine("stitcher")
    (tmp_path / "all.toml").write_text('base = "stitcher"\n' + same_as_one(own))
    counts = jolts(2, 1200, 30_000)
    one = run(own, counts, quantised=False)
    assert np.abs(one["X.voltage"]).max() >= 9.9
    compare(one, run(load_machine(tmp_path / "all.toml"), counts, quantised=False))


ONE_AXIS = """
name = "swinger"
title = "a motor that pulls a head by a belt"
sources = ["made for a test"]
tick_budget = "1e8 tick exact, assumed"
[clocks]
tick = "1 ms exact, assumed"
[bodies.motor]
kind = "rotary"
inertia = "4e-4 kg m^2 exact, assumed"
damping = "0.02 N m s/rad exact, assumed"
[bodies.head]
kind = "linear"
inertia = "20 kg exact, assumed"
damping = "150 N s/m exact, assumed"
[links.belt]
stretch = { motor = "5 mm/rad exact, assumed", head = "-1 exact, assumed" }
stiffness = "2e5 N/m exact, assumed"
[drives.motor]
kind = "dc-motor"
acts_on = { motor = "1 exact, assumed" }
torque_constant = "0.5 N m/A exact, assumed"
back_emf = "0.5 V s/rad exact, assumed"
resistance = "0.8 ohm exact, assumed"
amplifier = { mode = "current", gain = "2 A/V exact, assumed" }
delay = "2 ms exact, assumed"
[sensors.motor]
kind = "encoder"
reads = { motor = "8000 count/rev exact, assumed" }
[sensors.scale]
kind = "encoder"
reads = { head = "200 count/mm exact, assumed" }
[sensors.pot]
kind = "potentiometer"
reads = { head = "250 V/m exact, assumed" }
POT
[sensors.felt]
kind = "accelerometer"
reads = { head = "1 exact, assumed" }
FELT
[controllers.all]
kind = "state-space"
clock = "tick"
references = ["X"]
sensors = ["motor", "felt", "pot"]
drives = ["motor"]
A = [[0.9, 0.05], [-0.02, 0.7]]
B = [[0.001, -0.001, 0.02, -0.1], [0.002, -0.003, 0.0, 0.05]]
C = [[0.4, 0.7]]
D = [[1.1, -1.1, 0.8, -0.9]]
dac = { bits = "16 bit exact, assumed", range = "10 V exact, assumed" }
[axes.X]
kind = "linear"
controller = "all"
counts = "254.6479 count/mm exact, assumed"
velocity = "1 m/s exact, assumed"
acceleration = "20 m/s^2 exact, assumed"
travel = ["-1 m exact, assumed", "1 m exact, assumed"]
load = { head = "1 exact, assumed" }
"""
POT = 'noise = "20 mV exact, assumed"'


def swinger(folder, pot: str = "", felt: str = "", **changes: str) -> Machine:
    text = ONE_AXIS.replace("POT", pot).replace("FELT", felt)
    for old, new in changes.items():
        key = f"\n{old} = "
        start = text.index(key)
        text = text[:start] + key + new + text[text.index("\n", start + 1) :]
    (folder / "swinger.toml").write_text(text)
    return load_machine(folder / "swinger.toml")


def test_a_loop_over_three_sensors_is_that_of_scipy(tmp_path):
    """The plant as two bodies, held inputs by scipy's ``cont2discrete``, the controller by hand."""
    J, b, M, B, k, r = 4e-4, 0.02, 20.0, 150.0, 2e5, 0.005
    plant = np.array(
        [
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [-k * r * r / J, k * r / J, -b / J, 0.0],
            [k * r / M, -k / M, 0.0, -B / M],
        ]
    )
    force = np.array([[0.0], [0.0], [0.5 * 2.0 / J], [0.0]])  # V to N m: 2 A/V, 0.5 N m/A
    F, G, *_ = cont2discrete((plant, force, np.eye(4), np.zeros((4, 1))), 1e-3)
    A = np.array([[0.9, 0.05], [-0.02, 0.7]])
    Bc = np.array([[0.001, -0.001, 0.02, -0.1], [0.002, -0.003, 0.0, 0.05]])
    C, D = np.array([0.4, 0.7]), np.array([1.1, -1.1, 0.8, -0.9])
    counts = np.zeros((400, 1), dtype=np.int64)
    counts[20:120] = 6
    counts[200:260] = -4
    x, held, late = np.zeros(4), np.zeros(2), [0.0, 0.0]
    load, felt = [], []
    travelled = np.concatenate(([0], np.cumsum(counts[:, 0])))
    for n in range(400):
        sensed = np.array([x[0] * 8000 / (2 * np.pi), plant[3] @ x, 250.0 * x[1]])
        load.append(x[1])
        felt.append(sensed[1])
        seen = np.array([travelled[n], *sensed])
        level = C @ held + D @ seen
        held = A @ held + Bc @ seen
        late.append(np.clip(level, -32768, 32767) * 20.0 / 2**16)
        x = F @ x + G[:, 0] * late.pop(0)
    found = run(swinger(tmp_path), counts, quantised=False)
    assert np.abs(load).max() > 1e-3
    np.testing.assert_allclose(found["X.load"], load, atol=1e-12)
    np.testing.assert_allclose(found["felt.sensor"], felt, atol=1e-9)
    np.testing.assert_allclose(found["pot.sensor"], 250.0 * np.array(load), atol=1e-9)
    np.testing.assert_allclose(found["scale.sensor"], 2e5 * np.array(load), atol=1e-7)


def test_sensors_without_a_loop_are_recorded_in_steps_and_between_their_ends(tmp_path):
    machine = swinger(
        tmp_path,
        pot='range = "1 V exact, assumed"\nresolution = "40 mV exact, assumed"',
        felt='range = "1 m/s^2 exact, assumed"\nresolution = "0.25 m/s^2 exact, assumed"',
        sensors='["motor"]', A="[]", B="[]", C="[]", D="[[8.0, -8.0]]",
    )  # fmt: skip
    counts = np.full((300, 1), 5, dtype=np.int64)
    found = run(machine, counts)
    exact = run(machine, counts, quantised=False)
    true = 250.0 * exact["X.load"]
    assert true.max() > 1.2
    assert found["pot.sensor"].max() == exact["pot.sensor"].max() == 1.0
    np.testing.assert_allclose(found["pot.sensor"] / 0.04, np.rint(found["pot.sensor"] / 0.04))
    assert np.abs(found["pot.sensor"] - np.clip(250.0 * found["X.load"], -1, 1)).max() <= 0.0201
    assert np.abs(found["felt.sensor"]).max() == 1.0
    np.testing.assert_array_equal(found["felt.sensor"] * 4.0, np.rint(found["felt.sensor"] * 4.0))
    np.testing.assert_array_equal(found["scale.sensor"], np.floor(2e5 * found["X.load"] + 0.5))


def test_the_noise_is_normal_without_memory_and_the_same_in_every_run(tmp_path):
    """The fourth moment of a sum of twelve uniform numbers is 2.9; 3 would be normal."""
    machine = swinger(tmp_path, pot=POT, sensors='["motor"]', A="[]", B="[]", C="[]", D="[[0, 0]]")
    still = np.zeros((40_000, 1), dtype=np.int64)
    noise = run(machine, still)["pot.sensor"]
    assert abs(noise.mean()) < 4 * 0.02 / 200
    assert noise.std() == pytest.approx(0.02, rel=0.02)
    assert (noise**4).mean() / noise.var() ** 2 == pytest.approx(2.9, abs=0.1)
    for lag in (1, 2, 3, 7):
        assert abs(np.corrcoef(noise[lag:], noise[:-lag])[0, 1]) < 4 / 200
    np.testing.assert_array_equal(noise, run(machine, still)["pot.sensor"])
    other = run(machine, still, encoder_phase=np.array([0.25]))["pot.sensor"]
    assert abs(np.corrcoef(noise, other)[0, 1]) < 4 / 200
    assert not run(machine, still, quantised=False)["pot.sensor"].any()


def test_runs_side_by_side_and_in_pieces_have_the_bits_of_one_run(tmp_path):
    machine = swinger(tmp_path, pot=POT, felt='noise = "0.1 m/s^2 exact, assumed"')
    counts = np.zeros((300, 1), dtype=np.int64)
    counts[20:120] = 6
    phases = np.linspace(0.0, 0.9, 20)[:, None]
    rows = TickBlock(
        first_tick=0, counts=counts, operation=np.zeros(300, dtype=np.int64), events=()
    )
    table = TickTable(
        axes=("X",), clock=machine.tick_clock, counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(1, dtype=np.int64), blocks=[rows], job_sha256="",
        machine_sha256=machine.sha256,
    )  # fmt: skip
    many = [
        b.samples
        for b in simulate_runs(table, Values(machine, {}, 20), encoder_phase=phases).blocks
    ]
    for run_ in (0, 7, 19):
        one = [b.samples for b in simulate(table, machine, encoder_phase=phases[run_]).blocks]
        for name in ("X.load", "pot.sensor", "felt.sensor", "X.voltage"):
            np.testing.assert_array_equal(
                np.concatenate([b[name][:, run_] for b in many]),
                np.concatenate([b[name] for b in one]),
            )
    session = Session(machine)
    first = session.advance(
        TickBlock(
            first_tick=0, counts=counts[:77], operation=np.zeros(77, dtype=np.int64), events=()
        )
    )
    session = pickle.loads(pickle.dumps(session))
    rest = session.advance(
        TickBlock(
            first_tick=77, counts=counts[77:], operation=np.zeros(223, dtype=np.int64), events=()
        )
    )
    whole = run(machine, counts)
    for name in whole:
        np.testing.assert_array_equal(
            np.concatenate([first.samples[name], rest.samples[name]]), whole[name]
        )


@pytest.mark.parametrize("ending", ["csv", "npz", "mcap"])
def test_readings_of_sensors_come_back_from_a_file(tmp_path, ending):
    machine = swinger(tmp_path, pot=POT)
    counts = np.full((60, 1), 3, dtype=np.int64)
    rows = TickBlock(first_tick=0, counts=counts, operation=np.zeros(60, dtype=np.int64), events=())
    table = TickTable(
        axes=("X",), clock=machine.tick_clock, counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(1, dtype=np.int64), blocks=[rows], job_sha256="0" * 64,
        machine_sha256=machine.sha256,
    )  # fmt: skip
    recording = simulate(table, machine, settle_s=0.01)
    write_recording(recording, tmp_path / f"run.{ending}")
    again = read_recording(tmp_path / f"run.{ending}")
    for name, unit in (("pot.sensor", "V"), ("felt.sensor", "m/s^2"), ("scale.sensor", "count")):
        channel = next(c for c in again.channels if c.name == name)
        samples = again.samples(name)[1]
        assert (channel.kind, channel.unit) == (ChannelKind.SENSOR, unit)
        np.testing.assert_allclose(samples, recording.samples(name)[1], rtol=1e-9, atol=1e-12)
