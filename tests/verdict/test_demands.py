"""The extremes of trajectories, compared with closed forms and dense sampling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.files import ChannelKind, Stream
from threadline.machine.quantity import parse_machine_quantity
from threadline.motion.timing.types import Trajectory, TrajectoryBlock
from threadline.verdict import Criterion, Status, judge, load_spec

from .builders import TICK_S, follow, plan_through, record, spec_of

NAMES = ("travel", "velocity", "acceleration", "jerk")
ALL = spec_of(*(Criterion(name=name) for name in NAMES))


def judged(plan, spec=ALL):
    axes = plan.motion.programmed.axes
    nothing = np.zeros((4, len(axes)))
    return judge([record(axes, {ChannelKind.COMMANDED: nothing}, None)], plan, spec)


def with_pieces(coefficients, duration_s, *, per_block=1000, historical=False, axes=("X",)):
    coefficients = np.asarray(coefficients, dtype=float)
    duration_s = np.asarray(duration_s, dtype=float)
    start_s = np.concatenate([[0.0], np.cumsum(duration_s)[:-1]])
    plan = plan_through([[0.0] * len(axes), [0.1] * len(axes)], axes, historical=historical)
    parts = [slice(b, b + per_block) for b in range(0, len(duration_s), per_block)]
    blocks = [
        TrajectoryBlock(
            start_s=start_s[p],
            duration_s=duration_s[p],
            coefficients=coefficients[p],
            operation=np.zeros(len(duration_s[p]), dtype=np.int64),
        )
        for p in parts
    ]
    trajectory = Trajectory(axes=axes, blocks=Stream.of(blocks))
    return replace(plan, intent=replace(plan.motion, trajectory=trajectory))


QUINTIC = np.array([0, 0, 0, 10, -15, 6.0])


def test_quintic_rest_to_rest() -> None:
    """Rise h in T: peaks 15/8 h/T, 10/sqrt(3) h/T^2 and 60 h/T^3 (at the ends)."""
    h, T = 0.2, 0.5
    verdict = judged(with_pieces((h * QUINTIC)[None, :, None], [T]))

    velocity = verdict.result("velocity")
    assert velocity.measured == pytest.approx(15 / 8 * h / T, rel=1e-12)
    assert velocity.time_s == pytest.approx(T / 2, rel=1e-6)
    assert velocity.position == pytest.approx((h / 2,), rel=1e-6)
    acceleration = verdict.result("acceleration")
    assert acceleration.measured == pytest.approx(10 / np.sqrt(3) * h / T**2, rel=1e-9)
    assert verdict.result("jerk").measured == pytest.approx(60 * h / T**3, rel=1e-12)
    assert verdict.result("travel").measured == pytest.approx(h - 0.5, rel=1e-12)
    assert velocity.unit == "m/s"
    assert verdict.result("jerk").unit == "m/s^3"


def with_brakes(plan, braking: str):
    """Return the plan on its machine with a limit on the braking of axis X."""
    limit = parse_machine_quantity(f"{braking} exact, assumed", ("m/s^2",))
    braked = replace(plan.machine.axes["X"], deceleration=limit)
    axes = {**plan.machine.axes, "X": braked}
    return replace(plan, machine=replace(plan.machine, axes=axes))


def test_braking_is_measured_where_the_axis_slows_down() -> None:
    """Forth and back, 16 h u^2 (1 - u)^2 in T: a = 16 h (2 - 12 u + 12 u^2) / T^2.

    It brakes most at the end of the way back, by 32 h / T^2, and accelerates equally at the start:
    the sign of the velocity decides.
    """
    h, T = 0.1, 0.5
    there_and_back = h * np.array([0, 0, 16, -32, 16.0])
    plan = with_brakes(with_pieces(there_and_back[None, :, None], [T]), "100 m/s^2")
    verdict = judged(plan, spec_of(Criterion(name="deceleration"), Criterion(name="acceleration")))

    braking = verdict.result("deceleration")
    assert braking.measured == pytest.approx(32 * h / T**2, rel=1e-9)
    assert braking.time_s == pytest.approx(T, rel=1e-6)
    assert verdict.result("acceleration").time_s == pytest.approx(0.0, abs=1e-9)
    # It accelerates by 4 h / T^2, and brakes by twice that: a = h (4 - 12 u^2) / T^2.
    out = h * np.array([0, 0, 2, 0, -1.0])
    two = with_pieces(np.stack([out, [h, 0, 0, 0, 0]])[:, :, None], [T, T])
    verdict = judged(
        with_brakes(two, "100 m/s^2"),
        spec_of(Criterion(name="deceleration"), Criterion(name="acceleration")),
    )
    assert verdict.result("deceleration").measured == pytest.approx(8 * h / T**2, rel=1e-9)
    assert verdict.result("deceleration").time_s == pytest.approx(T, rel=1e-6)
    assert verdict.result("acceleration").measured == pytest.approx(4 * h / T**2, rel=1e-9)


def test_steps_are_taken_over_one_tick() -> None:
    """X at 0.1 m/s, then -0.05 m/s: the step 0.15 m/s in 5 ms is 30 m/s^2 and 6000 m/s^3."""
    plan = with_pieces([[[0.0], [0.01]], [[0.01], [-0.01]]], [0.1, 0.2])
    verdict = judged(plan)
    acceleration = verdict.result("acceleration")
    assert acceleration.measured == pytest.approx(0.15 / TICK_S, rel=1e-12)
    assert acceleration.time_s == pytest.approx(0.1)
    assert "velocity steps" in acceleration.note
    assert verdict.result("jerk").measured == pytest.approx(0.15 / TICK_S**2, rel=1e-12)


def test_the_step_into_standstill_at_the_end_counts() -> None:
    verdict = judged(with_pieces([[[0.0], [0.0], [0.02]]], [0.1]))
    assert verdict.result("acceleration").measured == pytest.approx(0.4 / TICK_S, rel=1e-12)


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12), per_block=st.integers(1, 5))
def test_random_pieces_against_dense_sampling(seed, count, per_block) -> None:
    """4000 points a piece miss an extreme by at most p'' / 8 / 4000^2: 1e-6 of the scale here."""
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(size=(count, 6, 1))
    duration = rng.uniform(0.5, 2.0, count)
    verdict = judged(with_pieces(coefficients, duration, per_block=per_block))
    u = np.linspace(0, 1, 4001)
    position = [np.polynomial.polynomial.polyval(u, c[:, 0]) for c in coefficients]
    reach = max(max(p.max() - 0.5, -0.5 - p.min()) for p in position)
    assert verdict.result("travel").measured == pytest.approx(reach, rel=1e-5, abs=1e-5)
    steps = 0.0
    for order, name in ((1, "velocity"), (2, "acceleration"), (3, "jerk")):
        rates = [
            np.polynomial.polynomial.polyder(c[:, 0], order) / t**order
            for c, t in zip(coefficients, duration, strict=True)
        ]
        below = [
            np.polynomial.polynomial.polyder(c[:, 0], order - 1) / t ** (order - 1)
            for c, t in zip(coefficients, duration, strict=True)
        ]
        ends = [b.sum() for b in below]
        gaps = [abs(b[0] - e) for b, e in zip(below[1:], ends[:-1], strict=True)]
        if order > 1:
            gaps += [abs(below[0][0]), abs(ends[-1])]
        steps = max([*gaps, steps / TICK_S]) if order > 1 else 0.0
        position_steps = max(gaps, default=0.0) if order == 1 else 0.0
        dense = max(np.abs(np.polynomial.polynomial.polyval(u, r)).max() for r in rates)
        expected = max(dense, max(steps, position_steps) / TICK_S)
        assert verdict.result(name).measured == pytest.approx(expected, rel=1e-5), name


def test_limits_hold_to_a_thousandth_and_historical_ones_are_excused() -> None:
    h = 0.2
    plan = plan_through([[0.0], [h]], ("X",))
    default = load_spec(None, plan.machine)
    limit = plan.machine.acceleration_limit[1]
    for factor, status in ((1.0009, Status.PASSED), (1.0011, Status.FAILED)):
        T = np.sqrt(10 / np.sqrt(3) * h / (limit * factor))
        verdict = judged(with_pieces((h * QUINTIC)[None, :, None], [T]), default)
        assert verdict.result("acceleration", "X").status is status
    historical = plan_through([[0.0], [h]], ("X",), historical=True, move_s=0.1)
    verdict = judged(historical, default)
    assert verdict.result("acceleration", "X").status is Status.REPORTED
    assert verdict.result("acceleration", "X").measured > limit
    assert verdict.result("jerk", "X").status is Status.REPORTED
    assert verdict.result("velocity", "X").status is Status.FAILED  # 2 m/s, limit 1 m/s


def test_beyond_the_travel_fails_and_an_endless_axis_has_none() -> None:
    plan = with_pieces([[[0.0, 0.0], [0.6, 100.0]]], [2.0], axes=("X", "A"))
    verdict = judged(plan, load_spec(None, plan.machine))
    travel = verdict.result("travel", "X")
    assert travel.measured == pytest.approx(0.1)
    assert travel.status is Status.FAILED
    with pytest.raises(KeyError):
        verdict.result("travel", "A")
    with pytest.raises(KeyError):
        verdict.result("travel", "Y")  # not an axis of the job
    every = judged(plan)  # for every axis, although no file would say it
    assert every.result("travel", "X").measured == pytest.approx(0.1)
    with pytest.raises(KeyError):
        every.result("travel", "A")


@pytest.mark.parametrize(
    ("far_m", "room", "note"),
    [(0.4, -0.1, "room left"), (0.5, 0.0, "room left"), (0.6, 0.1, "beyond")],
)
def test_travel_result_states_the_room_left_down_to_zero(far_m, room, note) -> None:
    """A motion that ends at the limit itself is within it."""
    plan = with_pieces([[[0.0], [far_m]]], [2.0])
    travel = judged(plan, load_spec(None, plan.machine)).result("travel", "X")
    assert travel.measured == pytest.approx(room)
    assert travel.note == note


@pytest.mark.parametrize(("stroke", "beyond"), [("0.38 m", 0.01), ("0.4 m", -0.01)])
@pytest.mark.parametrize("per_block", [1, 2])
def test_all_of_the_way_is_held_against_the_stroke(
    stroke: str, beyond: float, per_block: int
) -> None:
    """To 0.2 m and back to -0.19 m: each end lies well within the travel of +-0.5 m."""
    pieces = [[0.2 * c for c in QUINTIC], [(-0.39) * c for c in QUINTIC]]
    pieces[1][0] = 0.2
    plan = with_pieces(np.array(pieces)[:, :, None], [0.5, 0.5], per_block=per_block)
    x = plan.machine.axes["X"]
    of_use = replace(x, stroke=parse_machine_quantity(f"{stroke} exact, assumed", ("m",)))
    plan = replace(plan, machine=replace(plan.machine, axes={**plan.machine.axes, "X": of_use}))
    travel = judged(plan, load_spec(None, plan.machine)).result("travel", "X")
    assert travel.measured == pytest.approx(beyond, abs=1e-12)
    assert (travel.status is Status.FAILED) == (beyond > 0)
    assert travel.time_s == pytest.approx(1.0)
    assert travel.note.endswith("from end to end")


def test_an_axis_that_is_asked_for_by_name_is_not_measured_where_the_job_lacks_it() -> None:
    """For every axis it is left out; by name it is listed, and fails if it is required."""
    plan = with_pieces((0.2 * QUINTIC)[None, :, None], [0.5])
    by_name = Criterion(name="velocity", axis="Y", limit=1.0, required=True)
    found = judged(plan, spec_of(by_name))
    assert found.result("velocity", "Y").status is Status.NOT_MEASURED
    assert "no axis Y" in found.result("velocity", "Y").note
    assert not found.passed
    assert not judged(plan, spec_of(replace(by_name, every_axis=True))).results


def test_path_deviation_of_a_cut_corner() -> None:
    """A quadratic blend through P0, P1, P2 passes the corner at |P0 - 2 P1 + P2| / 4."""
    points = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1]]
    leg = 0.01

    def blend(chords):
        # first move to 10 mm before the corner and the blend's first half, in one polynomial each
        corner, a, b = np.array([0.1, 0.0]), np.array([0.1 - leg, 0.0]), np.array([0.1, leg])
        c = np.stack([a, 2 * (corner - a), a - 2 * corner + b])
        half = np.stack([c[0], c[1] / 2, c[2] / 4])
        middle = half.sum(axis=0)
        second = np.stack([middle, c[1] / 2 + c[2] / 2, c[2] / 4])
        return np.stack([half, second])

    plan = plan_through(points, pieces=blend)
    found = judged(plan, spec_of(Criterion(name="path_deviation"))).result("path_deviation")
    # The pieces leave out the legs: the farthest programmed point is the start, 90 mm away.
    assert found.measured == pytest.approx(0.1 - leg, abs=1e-12)

    straight = plan_through(points)
    found = judged(straight, spec_of(Criterion(name="path_deviation"))).result("path_deviation")
    assert found.measured == pytest.approx(0.0, abs=1e-12)

    def bowed(chords):
        # x = 0.1 u, y = 4 b u (1 - u): the bow b in the middle of the first move
        c = np.zeros((2, 3, 2))
        c[:, :2] = chords
        c[0, 1, 1], c[0, 2, 1] = 4 * 2e-3, -4 * 2e-3
        return c

    found = judged(plan_through(points, pieces=bowed), spec_of(Criterion(name="path_deviation")))
    assert found.result("path_deviation").measured == pytest.approx(2e-3, abs=1e-12)
    assert found.result("path_deviation").job_line == 10


def test_follow_builder_reaches_every_vertex() -> None:
    commanded, operation = follow([[0.0], [1.0], [0.0]], 4, standstill=1)
    assert commanded[:, 0].tolist() == [0, 0.25, 0.5, 0.75, 1, 0.75, 0.5, 0.25, 0, 0]
    assert operation.tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 1, 1]
