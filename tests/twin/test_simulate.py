"""The simulated winder, compared with an integrator with events, closed forms, and streaming."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline

from threadline.errors import OptionError
from threadline.machine.load import load_machine
from threadline.twin import simulate

TICK = 5e-3
COUNTS = 4000 / (2 * np.pi)
KT, KE, R = 0.082, 8.6 / (1000 * 2 * np.pi / 60), 0.4


def reference_winder(rows, inertia, limit, quantised, gain=0.45, kp=2.0, kd=4.0, parts=4):
    """Integrate one axis of the winder tick by tick with DOP853.

    Return (n,) angles in rad, (n,) speeds, and (n, parts - 1) angles between the ``parts`` of each
    tick.

    The clipped current is a function of the speed, continuous with a kink; the kinks are events
    at which the integration starts anew, so that its order holds.
    """
    theta = omega = 0.0
    reference, previous_error, previous_level = 0.0, 0.0, 0.0
    angles, speeds, between = [], [], []
    for row in rows:
        angles.append(theta)
        speeds.append(omega)
        read = theta * COUNTS
        if quantised:
            read = np.floor(read + 0.5)
        error = reference - read
        level = kp * error + kd * (error - previous_error)
        if quantised:
            level = np.rint(level)
        level = np.clip(level, -2048, 2047)
        if level * previous_level < 0:
            level = 0.0
        previous_error, previous_level = error, level
        volts = level * 20 / 4096 * gain

        def slope(_t, y, volts=volts):
            current = np.clip((volts - KE * y[1]) / R, -limit, limit)
            return [y[1], KT * current / inertia]

        def kinks(_t, y, volts=volts):
            return (volts - KE * y[1]) / R - limit

        def kinks_low(_t, y, volts=volts):
            return (volts - KE * y[1]) / R + limit

        kinks.terminal = kinks_low.terminal = True
        at, quarters = 0.0, []
        while at < TICK:
            events = [e for e in (kinks, kinks_low) if abs(e(0, [theta, omega])) > 1e-9]
            done = solve_ivp(
                slope, (at, TICK), [theta, omega], "DOP853", rtol=1e-12, atol=1e-13,
                events=events, dense_output=True,
            )  # fmt: skip
            while len(quarters) < parts - 1 and (len(quarters) + 1) * TICK / parts <= done.t[-1]:
                quarters.append(done.sol((len(quarters) + 1) * TICK / parts)[0])
            theta, omega = done.y[:, -1]
            at = done.t[-1]
        between.append(quarters)
        reference += row
    return np.array(angles), np.array(speeds), np.array(between)


@pytest.mark.parametrize("feed", [10, 80])
@pytest.mark.parametrize("quantised", [True, False])
def test_winder_follows_integrator(feed, quantised, table, there_and_back):
    """Within 1e-6 rad (2e-8 m) without quantisers, within one count with them; saturated at 80.

    The same holds for velocities, and the cubic through two samples is the way between them.
    """
    machine = load_machine("lathe-winder")
    rows = there_and_back(feed, 3200)
    recording = simulate(table(machine, {"X": rows}), machine, quantised=quantised, settle_s=0.2)
    _, load = recording.samples("X.load")
    _, current = recording.samples("X.current_peak")
    padded = np.concatenate((rows, np.zeros(len(load) - len(rows), dtype=int)))
    made = reference_winder(padded, 3.606e-4, 4.0, quantised)
    expected, speeds, between = (one * COUNTS / 55.358e3 for one in made)

    tolerance = 1.0 / 55.358e3 if quantised else 2e-8
    np.testing.assert_allclose(load, expected, atol=tolerance)
    _, velocity = recording.samples("X.velocity")
    np.testing.assert_allclose(velocity, speeds, atol=tolerance / TICK)
    # The cubic through two samples is the way between them: within 0.4 um, where it bows by 33 um.
    cubic = CubicHermiteSpline(TICK * np.arange(len(load)), load, velocity)
    for k in range(3):
        at = TICK * (np.arange(len(load) - 1) + 0.25 * (k + 1))
        np.testing.assert_allclose(cubic(at), between[:-1, k], atol=4e-7 + tolerance)
    straight = 0.5 * (load[:-1] + load[1:])
    assert np.abs(straight - between[:-1, 1]).max() > (3e-5 if feed == 80 else 4e-6)
    saturates = np.abs(current).max() > 4.0 - 1e-9
    assert saturates == (feed == 80)


def test_blocks_do_not_matter(table, there_and_back):
    """However the commands are cut into blocks, every sample is the same to the bit."""
    machine = load_machine("lathe-winder+stiction")
    rows = there_and_back(80)
    whole = simulate(table(machine, {"X": rows, "A": 2 * rows}), machine, record_every=7)
    cut = simulate(table(machine, {"X": rows, "A": 2 * rows}, 13), machine, record_every=7)
    for channel in whole.channels:
        times, one = whole.samples(channel.name)
        other_times, other = cut.samples(channel.name)
        np.testing.assert_array_equal(times, other_times)
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("every", [1, 20])
def test_a_long_block_is_recorded_piece_by_piece(every, table):
    """100 000 rows in one block: bounded blocks of samples, and no bit differs from small rows."""
    machine = load_machine("lathe-winder")
    x = np.resize([30] * 90 + [0] * 20 + [-30] * 90 + [0] * 20, 100_000)
    long = list(simulate(table(machine, {"X": x}), machine, record_every=every))
    samples = [len(block.samples["X.load"]) for block in long]
    assert max(samples) <= 16_384 and sum(samples) == -(-100_101 // every)
    small = simulate(table(machine, {"X": x}, 777), machine, record_every=every)
    for name in long[0].samples:
        found = np.concatenate([block.samples[name] for block in long])
        np.testing.assert_array_equal(found, small.samples(name)[1], err_msg=name)


def test_reading_twice_is_the_same(table, there_and_back):
    machine = load_machine("lathe-winder")
    recording = simulate(table(machine, {"Y": there_and_back(20)}), machine)
    first, second = recording.samples("Y.load")[1], recording.samples("Y.load")[1]
    np.testing.assert_array_equal(first, second)
    assert first.max() > 0.1


def test_recording_says_where_it_was_told_to_be(table):
    """Commanded at tick k is the sum of the rows before it, and is held through the settling."""
    machine = load_machine("lathe-winder")
    rows = np.array([3, -1, 4, 1, -5, 9])
    recording = simulate(table(machine, {"X": rows}), machine, settle_s=0.1)
    times, commanded = recording.samples("X.commanded")
    expected = np.concatenate(([0], np.cumsum(rows), np.full(20, rows.sum())))
    np.testing.assert_allclose(commanded * 55.358e3, expected, atol=1e-9)
    np.testing.assert_allclose(times, TICK * np.arange(len(expected)))


def test_switch_cuts_the_motor(table):
    """Beyond the switch the motor coasts: without friction it keeps its speed."""
    machine = load_machine("lathe-winder")
    start = 500  # mm; the switch stands at 510
    rows = np.full(2000, 20)
    commands = table(machine, {"X": rows})
    object.__setattr__(commands, "start_counts", np.array([0, round(start * 55.358), 0]))
    recording = simulate(commands, machine)
    _, load = recording.samples("X.load")
    _, pressed = recording.samples("x_high")
    _, current = recording.samples("X.current")
    assert pressed[0] == 0 and pressed[-1] == 1
    first = int(np.argmax(pressed))
    assert load[first - 1] < 0.510 <= load[first]
    after = load[first + 1 :]
    assert np.ptp(np.diff(after)) < 1e-12
    assert np.abs(current[first:]).max() == 0.0


def turning(theta, moved, volts):
    """Return the time, s, and angle, rad, at which the rigid winder turns under held volts.

    Its speed is an exponential; the motion in a tick gives the speed at its begin.
    """
    end, decay = volts * 0.45 / KE, KT * KE / (R * 3.606e-4)
    omega = end + (moved - end * TICK) * decay / (1 - np.exp(-decay * TICK))
    at = np.log((omega - end) / -end) / decay
    return at, theta + end * at + (omega - end) * (1 - np.exp(-decay * at)) / decay


def test_switch_touched_within_a_tick(table):
    """A peak between two ticks trips a switch below it, although no tick is beyond it."""
    machine = load_machine("lathe-winder")
    rows = np.zeros(60, dtype=int)
    rows[0] = 247
    recording = simulate(table(machine, {"X": rows}), machine, quantised=False)
    load, volts = recording.samples("X.load")[1], recording.samples("X.voltage")[1]
    k, per_rad = int(np.argmax(load)), COUNTS / 55.358e3
    at, peak = turning(load[k] / per_rad, (load[k + 1] - load[k]) / per_rad, volts[k])
    assert 0 < at < TICK
    above = peak * per_rad - load.max()
    assert above > 5e-7
    for share, pressed in ((0.9, 1), (1.1, 0)):
        place = load.max() + share * above
        switch = machine.inputs["x_high"]
        switch = dataclasses.replace(switch, at=dataclasses.replace(switch.at, si=place))
        inputs = {**machine.inputs, "x_high": switch}
        other = dataclasses.replace(machine, inputs=inputs)
        run = simulate(table(other, {"X": rows}), other, quantised=False)
        assert run.samples("x_high")[1].max() == pressed


def test_wrong_commands_are_refused(table):
    machine = load_machine("lathe-winder")
    commands = table(machine, {"X": np.array([1])})
    with pytest.raises(OptionError, match="record_every"):
        simulate(commands, machine, record_every=0)
    with pytest.raises(OptionError, match="encoder_phase"):
        simulate(commands, machine, encoder_phase=np.array([0.0, 1.0, 0.0]))
    with pytest.raises(OptionError, match="settle_s"):
        simulate(commands, machine, settle_s=-1.0)


@pytest.mark.parametrize("encoder", ["nearest", "floor", "truncate"])
@pytest.mark.parametrize("dac", ["nearest", "floor", "truncate"])
def test_rounding_is_the_machine_files(encoder, dac, table):
    """Readings and levels, compared with numpy's rounding of the load and the controller."""
    machine = load_machine("lathe-winder")
    sensor = dataclasses.replace(machine.sensors["x"], rounding=encoder)
    controller = machine.controllers["x"]
    output = dataclasses.replace(controller.dac, rounding=dac, zero_on_reversal=False)
    kp = dataclasses.replace(controller.kp, si=0.37130517)
    controller = dataclasses.replace(controller, dac=output, kp=kp)
    machine = dataclasses.replace(
        machine,
        sensors={**machine.sensors, "x": sensor},
        controllers={**machine.controllers, "x": controller},
    )
    rows = np.concatenate((np.full(40, 7), np.full(80, -9)))
    recording = simulate(table(machine, {"X": rows}), machine)
    scale = machine.axes["X"].counts.si
    exact = recording.samples("X.load")[1] * scale
    read = np.rint(recording.samples("X.measured")[1] * scale)
    moves = {"nearest": lambda x: np.floor(x + 0.5), "floor": np.floor, "truncate": np.trunc}
    np.testing.assert_array_equal(read, moves[encoder](exact))
    error = np.rint(recording.samples("X.commanded")[1] * scale) - read
    asked = 0.37130517 * error + 4.0 * np.diff(error, prepend=0.0)
    given = {**moves, "nearest": np.rint}[dac](asked)
    # A sample is taken before the controller acts: it shows the level of the previous tick.
    levels = recording.samples("X.voltage")[1] / output.volt_per_level
    np.testing.assert_allclose(levels[1:], given[:-1], atol=1e-9)
    assert (exact < 0).any() and np.abs(asked - given).max() > 0.3


@pytest.mark.parametrize("inductance_mh", [6.0, 0.5, 0.05])
def test_a_coil_far_faster_than_the_tick_follows_its_equations(inductance_mh, table, belt_axis):
    """Without a limit nothing is watched, and a tick may last 80 times as long as L / R.

    From 6 times on, this ended as a defect. The reference is DOP853 on the textbook equations: a
    current to 0.1 mA, a place to 1 nm. For the stiffest coil it leaves 1e-7 A and 1e-13 m, and
    takes a thirtieth of the time of Radau.
    """
    machine = belt_axis(
        clocks='servo = "10 ms exact, assumed"',
        drives_m=f'resistance = "0.4 ohm exact, assumed"\n'
        f'inductance = "{inductance_mh} mH exact, assumed"',
        controllers_c='kp = "0.2 dac/count exact, assumed"\nkd = "0.1 dac/count exact, assumed"',
    )
    rows = np.concatenate([np.full(15, 300), np.full(20, -300), np.zeros(5, dtype=np.int64)])
    recording = simulate(table(machine, {"X": rows}), machine, quantised=False)
    load, volts = recording.samples("X.load")[1], recording.samples("X.voltage")[1]
    current = recording.samples("X.current")[1]
    coil = inductance_mh * 1e-3

    def slope(_t, state, input_v):
        motor, head, motor_v, head_v, amps = state
        stretch, rate = 0.012 * motor - head, 0.012 * motor_v - head_v
        belt = 2e4 * stretch + 15.0 * rate
        return [
            motor_v,
            head_v,
            (0.1 * amps - 0.012 * belt - 1e-3 * motor_v) / 2e-4,
            (belt - 4.0 * head_v) / 1.5,
            (input_v - 0.1 * motor_v - 0.4 * amps) / coil,
        ]

    state = np.zeros(5)
    found = []
    for volt in volts:  # a sample has the voltage of the tick that ends with it
        done = solve_ivp(slope, (0, 0.01), state, "DOP853", args=(volt,), rtol=1e-10, atol=1e-12)
        state = done.y[:, -1]
        found.append((state[1], state[4]))
    head, amps = np.transpose(found)
    assert np.abs(volts).max() > 1.0 and np.abs(head).max() > 0.02
    np.testing.assert_allclose(load, head, atol=1e-9)
    np.testing.assert_allclose(current, amps, atol=1e-4)
