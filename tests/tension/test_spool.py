"""The tension between spool and mandrel, compared with closed forms and an integrator."""

from __future__ import annotations

from dataclasses import astuple, replace
from itertools import pairwise

import numpy as np
import pytest

from tests.tension.spool_reference import Numbers, Reference
from threadline.dynamics.spool import (
    DRAGS,
    STUCK,
    TENSION,
    TORQUE,
    TRAVEL,
    W,
    Y,
    drawn,
    slack,
    spool_numbers,
    steps_in,
    unwind,
)
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine.load import load_machine

MACHINE = load_machine("lathe-winder+spool")
TICK_S = 5e-3
SPOOL = Numbers(
    radius=0.06, inertia=3.6e-3, torque=0.43, stiction=0.43, stiffness=6e3, damping=3.0, mass=0.15,
    spring=120.0, damper=25.0, preload=8.4, travel=0.1, release=4.0,
)  # fmt: skip


def numbers_of(spool: Numbers, friction: float = 0.0) -> np.ndarray:
    """Return the row of numbers for the compiled spool."""
    r, j, torque, stiction, k, c, *arm = astuple(spool)
    return np.array([r, j, torque, stiction / torque, friction, k, c, *arm])


def ran(
    spool: Numbers, speeds: np.ndarray, *, friction: float = 0.0, begun: bool = False
) -> np.ndarray:
    """Return the states after every tick; the speed of the fibre is straight between the ticks."""
    row = numbers_of(spool, friction)
    steps = int(steps_in(MACHINE, row[None], TICK_S)[0])
    state = (drawn(row[None]) if begun else slack(1))[0]
    found = []
    for before, after in pairwise(speeds):
        unwind(state, row, 0.5 * (before + after) * TICK_S, after, TICK_S, steps)
        found.append(state.copy())
    return np.array(found)


@pytest.mark.parametrize("release", [0.0, 4.0])
@pytest.mark.parametrize("friction", [0.0, 0.1])
def test_at_a_constant_speed_the_tension_is_the_torque_over_the_radius(
    release: float, friction: float
) -> None:
    """T r = torque(y) and 2 T = preload + k y; the guides add their share."""
    spool = replace(SPOOL, release=release, spring=90.0)
    states = ran(spool, np.full(4001, 0.1), friction=friction)
    y = states[-1][Y]
    torque = spool.torque - release * (y - spool.travel / 2)
    assert 0.0 < y < spool.travel
    assert states[-1][TENSION] == pytest.approx((1.0 + friction) * torque / spool.radius, rel=1e-9)
    assert 2.0 * torque / spool.radius == pytest.approx(spool.preload + spool.spring * y, rel=1e-6)
    assert states[-1][W] == pytest.approx(0.1 / spool.radius, rel=1e-6)


def test_a_brake_set_anew_between_two_layers_is_that_of_dop853() -> None:
    """The torque changes at a tick while the fibre runs: within 2 mN before, at and after it."""
    torques, change = (0.43, 0.36), 400
    speeds = 0.06 + 0.03 * np.sin(np.linspace(0.0, 12.0, 1001))
    speeds *= np.minimum(np.arange(1001) / 40.0, 1.0)  # from rest
    at = TICK_S * np.arange(len(speeds))
    reference = Reference(SPOOL, lambda t: float(np.interp(t, at, speeds)))
    row = numbers_of(SPOOL)
    steps = int(steps_in(MACHINE, row[None], TICK_S)[0])
    state, found, expected = drawn(row[None])[0], [], []
    for k, (before, after) in enumerate(pairwise(speeds)):
        if k == change:
            row[TORQUE] = torques[1]
            reference.n = replace(SPOOL, torque=torques[1], stiction=torques[1])
        unwind(state, row, 0.5 * (before + after) * TICK_S, after, TICK_S, steps)
        found.append(state[TENSION])
        expected += reference.advance(at[k + 1 : k + 2]).tolist()
    error = np.abs(np.array(found) - np.array(expected))
    assert np.mean(found[:change]) - np.mean(found[-300:]) > 0.5
    assert error.max() < 2e-3


@pytest.mark.parametrize("tension", [4.0, 5.5, 7.9, 10.0, 14.0])
def test_the_torque_for_a_tension_gives_this_tension(tension: float) -> None:
    """On both stops of the arm and between them; at a constant speed the spool agrees."""
    spool = MACHINE.spool
    assert spool is not None
    torque = spool.torque_for(tension)
    braked = replace(spool, torque=replace(spool.torque, si=torque))
    assert braked.tension_n == pytest.approx(tension, rel=1e-12)
    assert braked.take_up_m == pytest.approx(spool.take_up_at(tension), abs=1e-12)
    low, high = spool.floats_n
    assert (0.0 < braked.take_up_m < 0.2) == (low < tension < high)
    states = ran(replace(SPOOL, torque=torque, stiction=torque), np.full(3001, 0.1), begun=True)
    assert states[-1][TENSION] * 1.1 == pytest.approx(tension, rel=1e-6)


def test_the_file_says_the_same_tension_and_take_up() -> None:
    spool = MACHINE.spool
    assert spool is not None
    state = drawn(spool_numbers(MACHINE, Values.of(MACHINE)))[0]
    assert state[TENSION] == pytest.approx(spool.tension_n, rel=1e-12)
    assert 2.0 * state[Y] == pytest.approx(spool.take_up_m, rel=1e-9)
    # 6 to 7 N per 1000 tex of glass.
    assert 1.2 * 6.0 < spool.tension_n < 1.2 * 7.0


def test_an_even_acceleration_adds_the_inertia_of_spool_over_its_radius() -> None:
    """With the arm at its upper stop, T = torque / r + J a / r^2."""
    spool = replace(SPOOL, release=0.0, spring=20.0)
    pushed = 0.5  # m/s^2
    speeds = 0.05 + pushed * TICK_S * np.arange(3001)
    states = ran(spool, speeds)
    want = spool.torque / spool.radius + spool.inertia * pushed / spool.radius**2
    assert states[-1][Y] == spool.travel
    assert states[-1][TENSION] == pytest.approx(want, rel=1e-5)


def test_the_arm_takes_up_what_the_eye_gives_back_until_its_lower_stop() -> None:
    """At a reversal the spool stands; the arm moves by half of the fibre and its spring relaxes."""
    row = numbers_of(SPOOL)
    state = drawn(row[None])[0]
    way, before = state[Y], state[TENSION]
    back = 0.02  # m
    steps = int(steps_in(MACHINE, row[None], TICK_S)[0])
    speeds = np.concatenate([-np.sin(np.linspace(0.0, np.pi, 401)), np.zeros(2000)])
    speeds *= back / (TICK_S * speeds[:401].sum()) * -1.0
    for v0, v1 in pairwise(speeds):
        unwind(state, row, 0.5 * (v0 + v1) * TICK_S, v1, TICK_S, steps)
    less = (before - state[TENSION]) / SPOOL.stiffness  # the fibre gets shorter, too
    assert state[STUCK] == 1.0
    assert way - state[Y] == pytest.approx(0.5 * (back - less), rel=1e-6)
    assert 2.0 * state[TENSION] == pytest.approx(SPOOL.preload + SPOOL.spring * state[Y], rel=1e-6)
    for _ in range(400):
        unwind(state, row, -0.1 * TICK_S, -0.1, TICK_S, steps)
    assert (state[Y], state[TENSION]) == (0.0, 0.0)


def test_guides_raise_the_tension_while_the_fibre_runs_out_and_lower_it_while_it_runs_back() -> (
    None
):
    states = ran(SPOOL, np.full(2001, 0.1), friction=0.25)
    out = states[-1]
    assert out[DRAGS] == 1.0
    row = numbers_of(SPOOL, 0.25)
    state = drawn(row[None])[0]
    pull = state[TENSION] / 1.25
    for _ in range(10):
        unwind(state, row, -2e-4, -0.04, TICK_S, 20)
    assert state[DRAGS] == -1.0
    one_by_one = drawn(numbers_of(SPOOL)[None])[0]
    for _ in range(10):
        unwind(one_by_one, numbers_of(SPOOL), -2e-4, -0.04, TICK_S, 20)
    assert state[TENSION] == pytest.approx(one_by_one[TENSION] / 1.25, rel=1e-9)
    assert one_by_one[TENSION] < pull


_KNOT = 40  # ticks


def _way(seed: int, knots: int) -> np.ndarray:
    """Return speeds of a fibre with reversals and rests, m/s, straight between the knots."""
    random = np.random.default_rng(seed)
    found = random.uniform(-0.06, 0.3, knots + 1)
    found[[0, knots // 2, knots // 2 + 1, -1]] = 0.0
    return np.interp(np.arange(knots * _KNOT + 1), np.arange(0, knots * _KNOT + 1, _KNOT), found)


@pytest.mark.long(but=("1-library", "2-stiction", "1-soft fibre"))
@pytest.mark.parametrize(
    "spool",
    [
        SPOOL,
        replace(SPOOL, stiction=0.52, damper=5.0, release=0.0),
        replace(SPOOL, travel=0.03, inertia=8e-3, mass=0.4),
        replace(SPOOL, stiffness=2e3, damping=0.0, spring=300.0, preload=2.0),
    ],
    ids=["library", "stiction", "short arm", "soft fibre"],
)
@pytest.mark.parametrize("seed", [1, 2])
def test_against_dop853_with_events(spool: Numbers, seed: int) -> None:
    """Random ways with reversals: within 2 mN, a part in 4000 of the tension.

    The compiled spool is of fourth order in its steps; impacts on the stops carry an error on.
    """
    speeds = _way(seed, 30)
    at = TICK_S * np.arange(len(speeds))
    reference = Reference(spool, lambda t: float(np.interp(t, at, speeds)))
    expected = np.concatenate(
        [reference.advance(at[k + 1 : k + 1 + _KNOT]) for k in range(0, len(at) - 1, _KNOT)]
    )
    states = ran(spool, speeds, begun=True)
    assert reference.changes > 5
    assert expected.max() > 5.0
    assert np.abs(states[:, TENSION] - expected).max() < 2e-3


def test_the_error_is_of_fourth_order_in_the_step() -> None:
    row = numbers_of(replace(SPOOL, damping=0.0, damper=0.0))
    speeds = 0.05 * (1.0 - np.cos(np.linspace(0.0, 6.0, 41)))

    def end(steps: int) -> np.ndarray:
        state = drawn(row[None])[0]
        for v0, v1 in pairwise(speeds):
            unwind(state, row, 0.5 * (v0 + v1) * TICK_S, v1, TICK_S, steps)
        return state

    fine = end(640)
    errors = [abs(end(steps)[TENSION] - fine[TENSION]) for steps in (10, 20, 40)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 3.5).all(), (errors, orders)


def test_a_spool_too_fast_for_the_ticks_is_refused() -> None:
    row = numbers_of(replace(SPOOL, mass=1e-9))
    with pytest.raises(MachineError, match=r"respond at .* 1/s, too fast for ticks of 0\.005 s"):
        steps_in(MACHINE, row[None], TICK_S)


def test_numbers_follow_the_file_and_its_variants() -> None:
    values = Values.of(MACHINE, {"spool.torque": np.array([0.4, 0.5])})
    found = spool_numbers(MACHINE, values)
    assert found.shape == (2, 13)
    assert found[:, 2].tolist() == [0.4, 0.5]
    assert found[0, TRAVEL] == 0.1
