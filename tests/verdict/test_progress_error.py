"""The progress error, compared with closed forms, and with a search over all matchings.

A square root is taken of the difference of two squares of up to 1 m^2: a true 0 is computed as less
than 1e-7 m if the path is slanted, and as less than 1e-9 m if it lies along an axis.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.files import ChannelKind
from threadline.machine import load_machine
from threadline.machine.load import library_names
from threadline.verdict import Criterion, Status, judge, load_spec

from .builders import TICK_S, follow, plan_through, record, spec_of

XY = ("X", "Y")
LINE = [[0.0, 0.0], [0.2, 0.0]]
PER_MOVE = 100  # 2 mm in a sample
STEP_M = 0.2 / PER_MOVE
LAG = 20
CRITERIA = (Criterion(name="progress_error", limit=5e-4), Criterion(name="contour_error"))


def judged(
    points, actual, operation, *, lag=LAG, command=None, axes=XY, per_block=64, per_move=PER_MOVE
):
    plan = plan_through(points, axes, move_s=per_move * TICK_S)
    channels = {ChannelKind.LOAD: actual}
    if command is not None:
        channels[ChannelKind.COMMANDED] = command
    recording = record(axes, channels, operation, per_block=per_block)
    return judge([recording], plan, spec_of(*CRITERIA, lag_s=lag * TICK_S))


def progress(points, actual, operation, **more):
    return judged(points, actual, operation, **more).result("progress_error")


def late(positions, samples):
    return np.vstack([np.repeat(positions[:1], samples, axis=0), positions[:-samples]])


@pytest.mark.parametrize(("by", "expected"), [(1, 0.0), (20, 0.0), (21, STEP_M), (30, 10 * STEP_M)])
def test_trailing_within_the_lag_is_free_and_what_is_beyond_it_is_not(by, expected) -> None:
    command, operation = follow(LINE, PER_MOVE, standstill=60)
    result = progress(LINE, late(command, by), operation, command=command)
    assert result.measured == pytest.approx(expected, abs=1e-9)
    assert result.note == ("behind" if expected else "")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size_m", [1e-300, 1e-162, 1e-155, 1e-154, 1e-100])
def test_a_command_that_moves_by_next_to_nothing_stands(size_m) -> None:
    """The square of its way is 0, a number without digits, or one whose inverse is infinite."""
    command, operation = follow(LINE, PER_MOVE, standstill=60)
    off = command.copy()
    off[-30, 1] = size_m
    plain = progress(LINE, late(command, 30), operation, command=command)
    assert progress(LINE, late(command, 30), operation, command=off) == plain


def test_running_ahead_is_not_free() -> None:
    """3 mm too far in the middle of the stroke: on the path, and 3 mm ahead of the command."""
    command, operation = follow(LINE, PER_MOVE)
    actual = command.copy()
    actual[40:60, 0] += 3e-3
    verdict = judged(LINE, actual, operation, command=command)
    result = verdict.result("progress_error")
    assert result.measured == pytest.approx(3e-3, abs=1e-9)
    assert (result.note, result.status) == ("ahead", Status.FAILED)
    assert result.time_s == pytest.approx(40 * TICK_S)
    assert result.position == pytest.approx((0.08, 0.0))
    assert verdict.result("contour_error").measured < 1e-12


@pytest.mark.parametrize(("back_m", "expected"), [(1e-3, 5e-4), (4e-3, 2e-3), (12e-3, 6e-3)])
def test_a_step_back_within_the_lag_costs_half_of_itself(back_m: float, expected: float) -> None:
    """The load trails by 10 samples, and steps back once: half-way between two places.

    A step that is shorter than the way of a sample, 2 mm, also costs half of itself.
    """
    command, operation = follow(LINE, PER_MOVE, standstill=40)
    actual = late(command, 10)
    actual[60, 0] = actual[59, 0] - back_m
    result = progress(LINE, actual, operation, command=command)
    assert result.measured == pytest.approx(expected, abs=1e-9)


def test_a_run_that_rings_along_its_stroke_is_out_of_spec() -> None:
    """20 mm along the stroke: on the path to a micrometre, but 20 mm off its place."""
    command, operation = follow(LINE, PER_MOVE, standstill=60)
    time_s = TICK_S * np.arange(len(command))
    ring = 0.02 * np.sin(2 * np.pi * time_s / 0.1)
    actual = command.copy()
    actual[:, 0] = np.clip(command[:, 0] + np.where(time_s < 0.5, ring, 0.0), 0.0, 0.2)
    verdict = judged(LINE, actual, operation, command=command)
    assert verdict.result("contour_error").measured < 1e-12
    result = verdict.result("progress_error")
    assert result.status is Status.FAILED
    assert result.measured == pytest.approx(0.02, abs=1e-3)


def test_ringing_along_the_path_at_its_end_counts() -> None:
    """The command stands; within the lag it was farther back, and afterwards nowhere else."""
    command, operation = follow(LINE, PER_MOVE, standstill=60)
    actual = command.copy()
    actual[110, 0] -= 2e-3  # 10 samples after the end: the command was there a sample before it
    actual[140, 0] -= 1.5e-3
    result = progress(LINE, actual, operation, command=command)
    # The tool had arrived before: each swing is a step back. Half of the first counts, and the
    # whole second one.
    assert result.measured == pytest.approx(1.5e-3, abs=1e-9)
    assert result.note == "behind"


@pytest.mark.parametrize("per_block", [1, 64])
def test_a_command_that_stands_heads_where_it_went_last(per_block) -> None:
    """The last sample before the standstill turns from X into Y: the tool is behind along Y."""
    points = [[0.0, 0.0], [0.2, 0.0], [0.2, 4e-3], [0.2, 8e-3]]
    straight, operation = follow(LINE, PER_MOVE, standstill=0)
    turned = np.repeat([[0.2, 4e-3]], 220, axis=0)
    command = np.vstack([straight, turned])
    operation = np.concatenate([operation, np.ones(220)])
    actual = command.copy()
    actual[130:, 1] -= 1e-3
    result = progress(points, actual, operation, command=command, per_block=per_block)
    assert result.measured == pytest.approx(1e-3, abs=1e-9)
    assert result.note == "behind"


def test_deviation_across_the_path_is_no_progress_error() -> None:
    command, operation = follow(LINE, PER_MOVE)
    result = progress(LINE, command + np.array([0.0, 4e-4]), operation, command=command)
    assert result.measured == pytest.approx(0.0, abs=1e-9)


def test_a_stroke_there_and_back_is_followed_on_the_right_way() -> None:
    """Forth and back on one line, 6 samples late: the way back is not taken for the way forth."""
    points = [[0.0, 0.0], [0.2, 0.0], [0.0, 0.0]]
    command, operation = follow(points, PER_MOVE)
    actual = late(command, 6)
    assert progress(points, actual, operation, command=command).measured < 1e-9
    actual[150, 0] -= 7e-3
    # 6 samples late are 12 mm: 7 mm ahead are within them, and then it steps back by 5 mm.
    result = progress(points, actual, operation, command=command)
    assert result.measured == pytest.approx(2.5e-3, abs=1e-9)


def test_rotary_axes_act_at_the_tool_radius() -> None:
    points = [[0.0, 0.0], [2.0, 0.0]]
    command, operation = follow(points, PER_MOVE)
    actual = command.copy()
    actual[50, 0] += 0.03
    found = progress(points, actual, operation, command=command, axes=("A", "X"))
    assert found.measured == pytest.approx(0.1 * 0.03, abs=1e-9)  # 100 mm tool radius


@pytest.mark.parametrize("lacking", [None, 0, 1])
def test_without_a_command_the_plan_at_the_same_instant_counts(lacking: int | None) -> None:
    command, operation = follow(LINE, PER_MOVE)
    actual = command.copy()
    actual[40:60, 0] += 3e-3
    result = progress(LINE, actual, operation, command=command)
    half = None
    if lacking is not None:
        half = command.copy()
        half[:, lacking] = np.nan
    untold = progress(LINE, actual, operation, command=half)
    assert untold.measured == pytest.approx(result.measured, abs=1e-9)
    assert untold.note == "ahead; command from the plan by time"


PARTS = 32  # share of a sample's way: the reference may go back within a sample


def reference(points, actual, command, operation, lag):
    """Return the least bottleneck of all monotone matchings, from the full matrix."""
    vertices, command = np.asarray(points, dtype=float), np.asarray(command)
    count = len(actual)
    instants = np.arange(PARTS * (count - 1) + 1) / PARTS
    fine = np.column_stack([np.interp(instants, np.arange(count), axis) for axis in command.T])

    def to(p, a, b):
        way = b - a
        square = (way**2).sum(axis=1)
        u = np.clip(((p - a) * way).sum(axis=1) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
        return ((p - a - u[:, None] * way) ** 2).sum(axis=1)

    best = np.zeros(len(fine))
    for i in range(count):
        early, late = int(operation[max(i - lag, 0)]), int(operation[min(i + lag, count - 1)])
        off = to(actual[i], vertices[early : late + 1], vertices[early + 1 : late + 2]).min()
        first, last = max(i - lag, 0) * PARTS, i * PARTS
        start = np.maximum(np.arange(first, last + 1) - 1, first)
        cost = np.full(len(fine), np.inf)
        away = to(actual[i], fine[start], fine[first : last + 1])
        cost[first : last + 1] = np.sqrt(np.maximum(away - off, 0.0))
        best = np.maximum(cost, np.minimum.accumulate(best))
    return best.min()


@given(
    seed=st.integers(0, 2**32 - 1),
    moves=st.integers(1, 5),
    per_move=st.integers(1, 8),
    lag=st.integers(1, 9),
    per_block=st.integers(1, 40),
)
def test_random_ways_against_every_matching(seed, moves, per_move, lag, per_block) -> None:
    """Samples of a random way about a random path, in blocks of any size.

    Where the command turns within a sample, the error may be off by a part of a sample's way.
    """
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.01, 0.01, size=(moves + 1, 2))
    command, operation = follow(points, per_move, standstill=int(rng.integers(0, 9)))
    # Without a command the chords of the operations alone are the path, as in the reference.
    actual = command + rng.normal(scale=1e-3, size=command.shape)
    found = progress(points, actual, operation, lag=lag, per_block=per_block, per_move=per_move)
    expected = reference(points, actual, command, operation, lag)
    longest = np.linalg.norm(np.diff(command, axis=0), axis=1).max()
    assert found.measured == pytest.approx(expected, abs=0.3 * longest), (points, actual)


def test_most_random_ways_are_met_exactly() -> None:
    """Nine in ten of 1000 such ways agree up to rounding: only turns within a sample differ."""
    met = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        points = rng.uniform(-0.01, 0.01, size=(int(rng.integers(2, 7)), 2))
        per_move, lag = int(rng.integers(1, 9)), int(rng.integers(1, 10))
        command, operation = follow(points, per_move, standstill=int(rng.integers(0, 9)))
        actual = command + rng.normal(scale=1e-3, size=command.shape)
        found = progress(points, actual, operation, lag=lag, per_move=per_move)
        expected = reference(points, actual, command, operation, lag)
        met.append(abs(found.measured - expected) < 1e-8)
    assert np.mean(met) > 0.75


def along_a_line(actual, command, lag):
    """Return the progress error of (n,) ways along one line: forward motion alone, in order.

    With an error of ``e`` the place is the farthest of all ``x - e`` so far, and of the end of the
    lag: it may be neither past ``x + e`` nor past the command.
    """
    farthest = np.maximum.accumulate(actual)
    end = command[np.maximum(np.arange(len(command)) - lag, 0)]
    return max((farthest - actual).max() / 2.0, (farthest - command).max(), (end - actual).max())


@given(
    seed=st.integers(0, 2**32 - 1),
    per_move=st.integers(4, 40),
    lag=st.integers(1, 9),
    size_m=st.floats(1e-5, 2e-2),
)
def test_along_a_line_the_rate_of_samples_does_not_matter(seed, per_move, lag, size_m) -> None:
    """A random way along the path, by its closed form, and with a sample between every two."""
    rng = np.random.default_rng(seed)
    command, operation = follow(LINE, per_move, standstill=lag + 2)
    actual = command.copy()
    actual[:, 0] = np.clip(command[:, 0] + rng.uniform(-size_m, size_m, len(command)), 0.0, 0.2)
    expected = along_a_line(actual[:, 0], command[:, 0], lag)
    found = progress(LINE, actual, operation, command=command, lag=lag, per_move=per_move)
    assert found.measured == pytest.approx(expected, abs=1e-9), (command, actual)

    def twice(values):
        count = np.arange(2 * len(values) - 1) / 2.0
        return np.column_stack([np.interp(count, np.arange(len(values)), v) for v in values.T])

    finer = progress(
        LINE, twice(actual), np.repeat(operation, 2)[:-1], command=twice(command), lag=2 * lag,
        per_move=2 * per_move,
    )  # fmt: skip
    assert finer.measured == pytest.approx(expected, abs=1e-9), (command, actual)


@pytest.mark.parametrize("name", library_names())
def test_no_default_specification_asks_for_place_across_the_path_alone(name: str) -> None:
    """A limit on the contour comes with a limit along the path: equally long, and required."""
    spec = load_spec(None, load_machine(name))
    found = {c.name: (c.limit, c.required) for c in spec.criteria}
    assert found.get("progress_error") == found.get("contour_error")


def test_a_winder_with_steppers_that_rings_along_its_stroke_is_out_of_spec() -> None:
    """By the library's specification: 5 mm along the stroke, and nothing beside the path."""
    command, operation = follow(LINE, PER_MOVE, standstill=60)
    time_s = TICK_S * np.arange(len(command))
    ring = 5e-3 * np.sin(2 * np.pi * time_s / 0.05 + 0.1) * (time_s < 0.5)
    actual = command.copy()
    actual[:, 0] = np.clip(command[:, 0] + ring, 0.0, 0.2)
    plan = plan_through(LINE, XY, move_s=PER_MOVE * TICK_S)
    channels = {ChannelKind.LOAD: actual, ChannelKind.COMMANDED: command}
    asked = load_spec(None, load_machine("stepper-winder"))
    verdict = judge([record(XY, channels, operation)], plan, asked)
    failed = {r.name for r in verdict.results if r.status is Status.FAILED}
    assert verdict.result("contour_error").status is Status.PASSED
    assert "progress_error" in failed
