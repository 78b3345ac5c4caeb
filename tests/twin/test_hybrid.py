"""Belts, play, friction, coils, dead times: each against DOP853, written from the physics anew.

The reference integrates between the exact instants at which anything of the controller changes.
Its right-hand sides are written out below, not assembled from the machine file. Laws with jumps
(friction, a clamped current, a damped contact) are integrated mode by mode with events.
Tolerances: 1e-9 m where scipy's own is 1e-12 relative and a run has some hundred events.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from threadline.errors import MachineError
from threadline.machine.load import load_machine
from threadline.twin import simulate, simulate_batch

J, M, BM, BH, RP, K, C = 2e-4, 1.5, 1e-3, 4.0, 0.012, 2e4, 15.0
KT = KE = 0.1
R = 0.5
TICK = Fraction(2, 1000)
ROWS = np.concatenate((np.full(40, 25), np.full(40, -35), np.zeros(60, dtype=int)))


def closed_loop(advance, *, tick=TICK, delay=Fraction(0), rows=ROWS, state=4, settle=10):
    """Return the (n, state) states at the ticks: PD in floats, DAC clamped, inputs delayed."""
    x = np.zeros(state)
    error_before, reference, now = 0.0, 0.0, Fraction(0)
    arrivals: list[tuple[Fraction, float]] = []
    volts, states = 0.0, []
    for row in np.concatenate((rows, np.zeros(settle, dtype=int))):
        states.append(x)
        error = reference - 500 * x[0]
        level = np.clip(3 * error + 6 * (error - error_before), -2048, 2047)
        error_before = error
        arrivals.append((now + delay, level * 20 / 4096))
        end = now + tick
        while now < end:
            while arrivals and arrivals[0][0] <= now:
                volts = arrivals.pop(0)[1]
            until = min([end, *(at for at, _ in arrivals[:1])])
            x = advance(x, volts, float(until - now))
            now = until
        reference += row
    return np.array(states)


def integrate(slope, x, span, events=()):
    return solve_ivp(slope, (0, span), x, "DOP853", rtol=1e-12, atol=1e-14, events=events)


def smooth(force, current=lambda volts, w: (volts - KE * w) / R):
    """Return an advance for a belt whose force is continuous in stretch and rate."""

    def advance(x, volts, span):
        def slope(_t, y):
            th, pos, w, v = y
            pull = force(RP * th - pos, RP * w - v)
            return [w, v, (KT * current(volts, w) - BM * w - RP * pull) / J, (pull - BH * v) / M]

        return integrate(slope, x, span).y[:, -1]

    return advance


def linear(s, r):
    return K * s + C * r


def compare(machine, states, table, atol=1e-9, rows=ROWS):
    recording = simulate(table(machine, {"X": rows}), machine, quantised=False, settle_s=0.02)
    _, load = recording.samples("X.load")
    assert np.ptp(load) > 1e-3
    np.testing.assert_allclose(load[: len(states)], states[:, 1], atol=atol)
    return recording


def test_linear_belt(belt_axis, table):
    compare(belt_axis(), closed_loop(smooth(linear)), table)


def test_current_limit(belt_axis, table):
    """The clipped current has a kink, no jump; it binds most of the way here."""
    machine = belt_axis(
        drives_m='amplifier = { mode = "voltage", gain = "1 exact, assumed", '
        'current_limit = "1.5 A exact, assumed" }'
    )
    clipped = smooth(linear, lambda volts, w: np.clip((volts - KE * w) / R, -1.5, 1.5))
    recording = compare(machine, closed_loop(clipped), table)
    assert (np.abs(recording.samples("X.current")[1]) > 1.4999).sum() > 10


def test_preloaded_belt(belt_axis, table):
    """Each run pulls with max(0, preload +- half the spring's force)."""
    machine = belt_axis(links_belt='preload = "3 N exact, assumed"')

    def force(s, r):
        half = 0.5 * linear(s, r)
        return max(0.0, 3 + half) - max(0.0, 3 - half)

    bilinear = closed_loop(smooth(force))
    compare(machine, bilinear, table)
    assert np.abs(bilinear - closed_loop(smooth(linear))).max() > 1e-4


def test_undamped_play(belt_axis, table):
    """A gap of 0.4 mm, crossed at each reversal and bounced in."""
    machine = belt_axis(
        links_belt='damping = "0 N s/m exact, assumed"\nplay = "0.4 mm exact, assumed"'
    )
    gap = 2e-4

    def force(s, _r):
        return K * (max(0.0, s - gap) + min(0.0, s + gap))

    compare(machine, closed_loop(smooth(force)), table, atol=1e-8)


def test_damped_play(belt_axis, table):
    """A damped contact pushes, never pulls: it begins at the gap's edge and ends with its force."""
    machine = belt_axis(links_belt='play = "0.4 mm exact, assumed"')
    gap = 2e-4
    mode = {"side": 0, "separating": False}

    def advance(x, volts, span):
        while span > 0:
            side, separating = mode["side"], mode["separating"]
            touching = side != 0 and not separating

            def pull(y, side=side):
                return K * (RP * y[0] - y[1] - side * gap) + C * (RP * y[2] - y[3])

            def slope(_t, y, touching=touching, pull=pull):
                f = pull(y) if touching else 0.0
                current = (volts - KE * y[2]) / R
                return [y[2], y[3], (KT * current - BM * y[2] - RP * f) / J, (f - BH * y[3]) / M]

            def upper(_t, y):
                return RP * y[0] - y[1] - gap

            def lower(_t, y):
                return RP * y[0] - y[1] + gap

            def force(_t, y, pull=pull, side=side):
                return side * pull(y)

            upper.terminal = lower.terminal = force.terminal = True
            if touching:
                events = [force]
                force.direction = -1
            elif separating:
                force.direction = 1
                upper.direction, lower.direction = -1, 1
                events = [upper if side > 0 else lower, force]
            else:
                upper.direction, lower.direction = 1, -1
                events = [upper, lower]
            done = integrate(slope, x, span, events)
            x, span = done.y[:, -1], span - done.t[-1]
            if done.status != 1:
                break
            which = int(np.argmax([len(t) for t in done.t_events]))
            if touching:
                mode["separating"] = True
            elif separating:
                mode["separating"] = False
                mode["side"] = side if which == 1 else 0
            else:
                mode["side"] = 1 if which == 0 else -1
        return x

    states = closed_loop(advance)
    compare(machine, states, table, atol=1e-7)


def stick_slip(fc, fs):
    """Return an advance with Coulomb friction on the head, mode by mode."""
    mode = {"sign": 0}

    def advance(x, volts, span):
        while span > 1e-15:
            sign = mode["sign"]

            def pull(y):
                return linear(RP * y[0] - y[1], RP * y[2] - y[3]) - BH * y[3]

            if sign == 0 and abs(pull(x)) > fs:
                sign = mode["sign"] = int(np.sign(pull(x)))

            def slope(_t, y, sign=sign):
                th, pos, w, v = y
                f = linear(RP * th - pos, RP * w - v)
                turn = (KT * (volts - KE * w) / R - BM * w - RP * f) / J
                return [w, v, turn, 0.0 if sign == 0 else (f - BH * v - sign * fc) / M]

            def stops(_t, y, sign=sign):
                return sign * y[3] if sign else 1.0

            def breaks(_t, y, sign=sign):
                return abs(pull(y)) - fs if sign == 0 else -1.0

            stops.terminal, stops.direction = True, -1
            breaks.terminal, breaks.direction = True, 1
            done = integrate(slope, x, span, [stops, breaks])
            x, span = done.y[:, -1].copy(), span - done.t[-1]
            if done.status == 1:
                if sign:
                    x[3] = 0.0
                    mode["sign"] = 0
                else:
                    mode["sign"] = int(np.sign(pull(x)))
        return x

    return advance


def test_stick_slip(belt_axis, table):
    machine = belt_axis(
        bodies_head='friction = "4 N exact, assumed"\nstiction = "6 N exact, assumed"'
    )
    states = closed_loop(stick_slip(4.0, 6.0))
    recording = compare(machine, states, table, atol=1e-8)
    load = recording.samples("X.load")[1]
    assert (np.diff(load) == 0).sum() > 10  # it does stick


def test_clamped_coil(belt_axis, table):
    """The current is a state; at its limit it stays until its own volts drive it back."""
    machine = belt_axis(
        drives_m='amplifier = { mode = "voltage", gain = "1 exact, assumed", '
        'current_limit = "1.2 A exact, assumed" }\ninductance = "2 mH exact, assumed"'
    )
    limit, L = 1.2, 2e-3
    mode = {"at": 0}

    def advance(x, volts, span):
        while span > 1e-15:
            at = mode["at"]

            def rate(y):
                return (volts - R * y[4] - KE * y[2]) / L

            if at and at * rate(x) < 0:
                at = mode["at"] = 0

            def slope(_t, y, at=at):
                th, pos, w, v, i = y
                f = linear(RP * th - pos, RP * w - v)
                turn = (KT * i - BM * w - RP * f) / J
                return [w, v, turn, (f - BH * v) / M, 0.0 if at else rate(y)]

            def reaches(_t, y, at=at):
                return abs(y[4]) - limit if not at else -1.0

            def leaves(_t, y, at=at):
                return at * rate(y) if at else 1.0

            reaches.terminal, reaches.direction = True, 1
            leaves.terminal, leaves.direction = True, -1
            done = integrate(slope, x, span, [reaches, leaves])
            x, span = done.y[:, -1].copy(), span - done.t[-1]
            if done.status == 1:
                mode["at"] = 0 if at else int(np.sign(x[4]))
                if mode["at"]:
                    x[4] = mode["at"] * limit
        return x

    states = closed_loop(advance, state=5)
    recording = compare(machine, states, table)
    assert np.abs(recording.samples("X.current_peak")[1]).max() == pytest.approx(1.2, abs=1e-12)


@pytest.mark.parametrize("delay_us", ["700", "4000", "5300", "1000.0001"])
def test_fractional_dead_time(delay_us, belt_axis, table):
    """0.35, 2, 2.65, 0.50000005 ticks: the command arrives inside a tick, exactly on time."""
    machine = belt_axis(
        drives_m=f'delay = "{delay_us} us exact, assumed"',
        controllers_c='kp = "0.5 dac/count exact, assumed"\nkd = "0 dac/count exact, assumed"',
    )
    x, reference, states = np.zeros(4), 0.0, []
    advance = smooth(linear)
    delay, now = Fraction(delay_us) / 10**6, Fraction(0)
    under_way: list[tuple[Fraction, float]] = []
    volts = 0.0
    for row in np.concatenate((ROWS, np.zeros(10, dtype=int))):
        states.append(x)
        under_way.append((now + delay, 0.5 * (reference - 500 * x[0]) * 20 / 4096))
        end = now + TICK
        while now < end:
            while under_way and under_way[0][0] <= now:
                volts = under_way.pop(0)[1]
            until = min([end, *(at for at, _ in under_way[:1])])
            x = advance(x, volts, float(until - now))
            now = until
        reference += row
    compare(machine, np.array(states), table)


def test_two_clocks(belt_axis, table):
    """A second axis whose controller runs at 136 us under references every 2 ms."""
    machine = belt_axis(
        clocks='fast = "136 us exact, assumed"',
        extra="""
[bodies.y]
kind = "rotary"
inertia = "2e-4 kg m^2 exact, assumed"
[drives.y]
kind = "dc-motor"
acts_on = { y = "1 exact, assumed" }
torque_constant = "0.1 N m/A exact, assumed"
back_emf = "0.1 V s/rad exact, assumed"
resistance = "0.5 ohm exact, assumed"
amplifier = { mode = "voltage", gain = "1 exact, assumed" }
delay = "3 ms exact, assumed"
[sensors.y]
kind = "encoder"
reads = { y = "500 count/rad exact, assumed" }
[controllers.y]
kind = "pd"
clock = "fast"
sensor = "y"
drive = "y"
kp = "0.4 dac/count exact, assumed"
kd = "2 dac/count exact, assumed"
dac = { bits = "12 bit exact, assumed", range = "10 V exact, assumed" }
[axes.Y]
kind = "rotary"
controller = "y"
counts = "500 count/rad exact, assumed"
velocity = "100 rad/s exact, assumed"
acceleration = "1000 rad/s^2 exact, assumed"
endless = true
""",
    )
    rows = ROWS[:100]
    recording = simulate(table(machine, {"Y": rows}), machine, quantised=False, settle_s=0.02)
    _, load = recording.samples("Y.load")

    # One body by hand: between instants the speed relaxes to volts / KE with the motor's time.
    tau = R * 2e-4 / (KT * KE)
    fast, delay, tick = Fraction(136, 10**6), Fraction(3, 1000), Fraction(2, 1000)
    end = tick * len(load)
    instants = {tick * k for k in range(len(load) + 1)}
    controls = [fast * k for k in range(int(end / fast) + 1)]
    instants |= set(controls) | {c + delay for c in controls}
    theta = omega = volts = before = 0.0
    arriving: dict[Fraction, float] = {}
    expected = []
    ordered = sorted(i for i in instants if i <= end)
    travelled = np.concatenate(([0], np.cumsum(rows), np.full(60, rows.sum())))
    for now, then in zip(ordered, [*ordered[1:], end], strict=True):
        if now % tick == 0:
            expected.append(theta)
        if now % fast == 0:
            error = travelled[int(now // tick)] - 500 * theta
            level = np.clip(0.4 * error + 2 * (error - before), -2048, 2047)
            before = error
            arriving[now + delay] = level * 20 / 4096
        volts = arriving.pop(now, volts)
        span = float(then - now)
        decay = np.exp(-span / tau)
        theta += volts / KE * span + (omega - volts / KE) * tau * (1 - decay)
        omega = volts / KE + (omega - volts / KE) * decay
    assert np.ptp(load) > 0.5
    np.testing.assert_allclose(load, expected[: len(load)], atol=1e-9)


def test_batch_is_the_scalar_twin(belt_axis, table):
    """Every variant of a batch is what ``simulate`` does with that machine, to 1e-9 counts."""
    friction = np.array([1.0, 2.0, 4.0])
    line = 'friction = "{} N exact, assumed"\nstiction = "6 N exact, assumed"'
    machine = belt_axis(bodies_head=line.format(1))
    commands = table(machine, {"X": ROWS}, 37)
    batch = simulate_batch(
        commands,
        machine,
        {"bodies.head.friction": friction},
        channels=("X.load", "X.current"),
        quantised=False,
    )
    for index, value in enumerate(friction):
        alone = belt_axis(bodies_head=line.format(value))
        recording = simulate(table(alone, {"X": ROWS}), alone, quantised=False)
        for channel in ("X.load", "X.current"):
            np.testing.assert_allclose(
                batch.samples[channel][:, index], recording.samples(channel)[1], atol=1e-9 / 5e2
            )
    assert np.ptp(batch.end) > 1e-5


@pytest.mark.parametrize("quantised", [False, True])
def test_wide_batch_is_the_scalar_twin(belt_axis, table, quantised):
    """Variants side by side give what each gives alone, to the bit: with a limit and friction."""
    limit = (
        'amplifier = { mode = "voltage", gain = "1 exact, assumed", '
        'current_limit = "1.5 A exact, assumed" }'
    )
    inertia = np.linspace(1.0, 2.0, 70)
    machine = belt_axis(drives_m=limit, bodies_head='friction = "3 N exact, assumed"')
    commands = table(machine, {"X": ROWS})
    batch = simulate_batch(
        commands,
        machine,
        {"bodies.head.inertia": inertia},
        channels=("X.load", "X.voltage", "X.current_peak"),
        quantised=quantised,
    )
    assert batch.events > 500
    for index in (0, 7, 33, 69):
        alone = belt_axis(
            drives_m=limit,
            bodies_head=f'inertia = "{float(inertia[index])!r} kg exact, assumed"\n'
            'friction = "3 N exact, assumed"',
        )
        recording = simulate(commands, alone, quantised=quantised)
        for channel, values in batch.samples.items():
            np.testing.assert_array_equal(values[:, index], recording.samples(channel)[1])


def test_lanes_in_several_modes(table):
    """Sixteen advances of different length, lanes side by side in and out of their limit.

    The stitcher's dead time cuts its ticks unevenly. Each variant alone gives the same to 1e-9
    counts, without quantisers.
    """
    machine = load_machine("stitcher")
    commands = table(machine, {"X": np.full(40, 50), "Y": np.full(40, 45)})
    inertia = np.random.default_rng(3).uniform(60.0, 180.0, 16)
    channels = ("X.load", "Y.load", "X.current_peak")

    def run(values):
        return simulate_batch(
            commands, machine, {"bodies.x_head.inertia": values}, channels=channels,
            settle_s=0.02, quantised=False,
        )  # fmt: skip

    together = run(inertia)
    assert together.events > 16
    for index in (0, 6, 15):
        alone = run(inertia[index : index + 1])
        for channel in channels:
            one, other = together.samples[channel][:, index], alone.samples[channel][:, 0]
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 / 2.6e5)
    assert np.ptp(together.samples["X.load"][-1]) > 1e-6


def test_batch_measures(belt_axis, table):
    """Worst error, end, window and current peak are those of the recording."""
    machine = belt_axis()
    commands = table(machine, {"X": ROWS})
    phases = np.array([[0.1], [0.5], [0.9]])
    batch = simulate_batch(commands, machine, encoder_phase=phases, window_s=0.28)
    for index, phase in enumerate(phases):
        recording = simulate(commands, machine, encoder_phase=phase)
        times, load = recording.samples("X.load")
        _, commanded = recording.samples("X.commanded")
        _, peak = recording.samples("X.current_peak")
        assert batch.worst_error[index, 0] == pytest.approx(np.abs(commanded - load).max())
        assert batch.end[index, 0] == pytest.approx(load[-1])
        assert batch.highest[index, 0] == pytest.approx(load[times >= 0.28].max())
        assert batch.lowest[index, 0] == pytest.approx(load[times >= 0.28].min())
        assert abs(batch.current_peak[index, 0]) == pytest.approx(np.abs(peak).max())


def test_what_cannot_be_honoured_is_refused(belt_axis, table):
    """Clocks that hardly ever meet; a part too fast for the ticks."""
    odd = 'clock = "odd"\nreference_clock = "servo"'
    awkward = belt_axis(clocks='odd = "1.0000001 ms exact, assumed"', controllers_c=odd)
    with pytest.raises(MachineError, match="common multiple"):
        simulate(table(awkward, {"X": ROWS}), awkward)
    stiff = belt_axis(
        links_belt='stiffness = "1e22 N/m exact, assumed"\npreload = "1 N exact, assumed"'
    )
    with pytest.raises(MachineError, match="too fast"):
        simulate(table(stiff, {"X": ROWS}), stiff)
