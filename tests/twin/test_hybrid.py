"""Belts, play, friction, coils, dead times: each against DOP853, written again from physics.

The reference integrates between the exact instants at which anything of the controller changes. Its
right-hand sides are written out below, not assembled from the machine file. Laws with jumps
(friction, a clamped current, a damped contact) are integrated mode by mode with events. The
tolerance is 1e-9 m: scipy's own is 1e-12 relative, and a run has some hundred events. It also holds
with quantisers, where one count of 24 um is allowed: with gains that are whole numbers no rounding
is a tie, so both read and send the same.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from threadline.errors import MachineError
from threadline.twin import simulate

from .belt_reference import (
    BH,
    BM,
    COUNT_M,
    KE,
    KT,
    ROWS,
    RP,
    TICK,
    UNLIMITED,
    C,
    J,
    K,
    M,
    R,
    amperes,
    amplifier,
    closed_loop,
    integrate,
    linear,
    smooth,
)


def every_way(test):
    """Run a test without and with quantisers, with and without a current limit that binds."""
    for name, values in (("limit", [None, 1.5]), ("quantised", [False, True])):
        test = pytest.mark.parametrize(name, values)(test)
    return test


def check_against(machine, states, table, atol=1e-9, rows=ROWS, quantised=False, limit=None):
    """Assert that the load follows the reference at every tick, and that a limit binds."""
    recording = simulate(table(machine, {"X": rows}), machine, quantised=quantised, settle_s=0.02)
    _, load = recording.samples("X.load")
    assert np.ptp(load) > 1e-3
    np.testing.assert_allclose(load[: len(states)], states[:, 1], rtol=0, atol=atol)
    if limit is not None:
        assert (np.abs(recording.samples("X.current")[1]) > limit - 1e-4).sum() > 10
    return recording


@every_way
def test_linear_belt(quantised, limit, belt_axis, table):
    """The clipped current has a kink and no jump; here it binds most of the way."""
    states = closed_loop(smooth(linear, amperes(limit)), quantised=quantised)
    machine = belt_axis(drives_m=amplifier(limit))
    check_against(machine, states, table, quantised=quantised, limit=limit)


@every_way
def test_preloaded_belt(quantised, limit, belt_axis, table):
    """Each run pulls with max(0, preload +- half the spring's force)."""
    machine = belt_axis(links_belt='preload = "3 N exact, assumed"', drives_m=amplifier(limit))

    def force(s, r):
        half = 0.5 * linear(s, r)
        return max(0.0, 3 + half) - max(0.0, 3 - half)

    current = amperes(limit)
    bilinear = closed_loop(smooth(force, current), quantised=quantised)
    check_against(machine, bilinear, table, quantised=quantised, limit=limit)
    plain = closed_loop(smooth(linear, current), quantised=quantised)
    assert np.abs(bilinear - plain)[:, 1].max() > 2 * COUNT_M


@pytest.mark.parametrize("stiffness", [2e6, 8e6])
def test_belt_that_swings_within_a_tick(stiffness, belt_axis, table):
    """Half a turn of its mode in a tick and more: runs go slack and tight again between ticks."""
    machine = belt_axis(
        links_belt=f'stiffness = "{stiffness} N/m exact, assumed"\npreload = "3 N exact, assumed"'
    )

    def force(s, r):
        half = 0.5 * (stiffness * s + C * r)
        return max(0.0, 3 + half) - max(0.0, 3 - half)

    states = closed_loop(smooth(force))
    check_against(machine, states, table)
    stretch = stiffness * (RP * states[:, 0] - states[:, 1])
    assert stretch.max() > 6 and stretch.min() < -6


def assert_crossed(states, gap, recording, limit):
    """Assert that the gap is left on both sides, and occupied while the limit binds."""
    stretch = RP * states[:, 0] - states[:, 1]
    assert stretch.max() > gap and stretch.min() < -gap
    if limit is not None:
        current = np.abs(recording.samples("X.current")[1][: len(states)])
        assert ((np.abs(stretch) < gap) & (current > limit - 1e-4)).any()


@every_way
def test_undamped_play(quantised, limit, belt_axis, table):
    """A gap of 0.4 mm is crossed at each reversal, with bounces."""
    machine = belt_axis(
        links_belt='damping = "0 N s/m exact, assumed"\nplay = "0.4 mm exact, assumed"',
        drives_m=amplifier(limit),
    )
    gap = 2e-4

    def force(s, _r):
        return K * (max(0.0, s - gap) + min(0.0, s + gap))

    states = closed_loop(smooth(force, amperes(limit)), quantised=quantised)
    recording = check_against(machine, states, table, atol=1e-8, quantised=quantised, limit=limit)
    assert_crossed(states, gap, recording, limit)


@every_way
def test_damped_play(quantised, limit, belt_axis, table):
    """A damped contact pushes, never pulls: it begins at the gap's edge, and ends without force."""
    machine = belt_axis(links_belt='play = "0.4 mm exact, assumed"', drives_m=amplifier(limit))
    current = amperes(limit)
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
                turn = (KT * current(volts, y[2]) - BM * y[2] - RP * f) / J
                return [y[2], y[3], turn, (f - BH * y[3]) / M]

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

    states = closed_loop(advance, quantised=quantised)
    recording = check_against(machine, states, table, atol=1e-7, quantised=quantised, limit=limit)
    assert_crossed(states, gap, recording, limit)


def stick_slip(fc, fs, current=UNLIMITED):
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
                turn = (KT * current(volts, w) - BM * w - RP * f) / J
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


@pytest.mark.parametrize("quantised", [False, True])
@pytest.mark.parametrize("limit", [None, 2.5])
@pytest.mark.parametrize("stiction", [11.0, None])
def test_stick_slip(stiction, limit, quantised, belt_axis, table):
    """Coulomb friction, with and without a higher one at rest; the limit is worth 20.8 N."""
    more = "" if stiction is None else f'\nstiction = "{stiction} N exact, assumed"'
    machine = belt_axis(
        bodies_head=f'friction = "8 N exact, assumed"{more}', drives_m=amplifier(limit)
    )
    advance = stick_slip(8.0, stiction or 8.0, amperes(limit))
    states = closed_loop(advance, quantised=quantised)
    recording = check_against(machine, states, table, atol=1e-8, quantised=quantised, limit=limit)
    stuck = np.diff(recording.samples("X.load")[1]) == 0
    assert stuck[10:].sum() > 4  # it does stick, and not only before it first breaks away
    if limit is not None:
        current = np.abs(recording.samples("X.current")[1][1:])
        assert (stuck & (current > limit - 1e-4)).any()


@pytest.mark.parametrize("quantised", [False, True])
def test_clamped_coil(quantised, belt_axis, table):
    """The current is a state; at its limit it stays until its own volts drive it back."""
    machine = belt_axis(drives_m=f'{amplifier(1.2)}\ninductance = "2 mH exact, assumed"')
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

    states = closed_loop(advance, state=5, quantised=quantised)
    recording = check_against(machine, states, table, quantised=quantised)
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
    check_against(machine, np.array(states), table)


def test_two_clocks(belt_axis, table):
    """A second axis has a controller at 136 us under references every 2 ms."""
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


def test_clocks_and_parts_that_cannot_be_simulated_are_refused(belt_axis, table):
    """Clocks that hardly ever meet, and a part too fast for the ticks."""
    odd = 'clock = "odd"\nreference_clock = "servo"'
    awkward = belt_axis(clocks='odd = "1.0000001 ms exact, assumed"', controllers_c=odd)
    with pytest.raises(MachineError, match="common multiple"):
        simulate(table(awkward, {"X": ROWS}), awkward)
    stiff = belt_axis(
        links_belt='stiffness = "1e15 N/m exact, assumed"\npreload = "1 N exact, assumed"'
    )
    with pytest.raises(MachineError, match="too fast"):
        simulate(table(stiff, {"X": ROWS}), stiff)
