"""Shaped trajectories, compared with dense superposition and scipy's oscillator."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tests.made import Made
from tests.motion.shaping.pieces import MACHINE, MODE, made, random_pieces, rest_to_rest
from threadline.commands.ticks import compile_ticks
from threadline.errors import LimitError
from threadline.jobs import read_job
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.shaping import FlexibleMode, Shaper, design, parse_shaper, shape_trajectory
from threadline.motion.timing import Trajectory, TrajectoryBlock, limit_peaks, plan_trajectory


def test_ramp_through_two_impulses_has_a_closed_form() -> None:
    """A ramp v t held at its ends: y = v sum A clip(t - t_k, 0, T)."""
    c = np.zeros((1, 2, 1))
    c[0, 1] = 0.2
    shaper = Shaper(amplitudes=np.array([0.6, 0.4]), times_s=np.array([0.0, 0.05]))
    shaped = shape_trajectory(made([0.2], c, axes=("X",)), shaper, None)
    assert shaped.duration_s == pytest.approx(0.25, abs=1e-15)
    pieces = [tuple(b.start_s) for b in shaped]
    assert np.concatenate(pieces) == pytest.approx([0.0, 0.05, 0.2], abs=1e-15)
    t = np.linspace(0.0, 0.3, 61)
    expected = 0.6 * np.clip(t, 0, 0.2) + 0.4 * np.clip(t - 0.05, 0, 0.2)
    assert shaped(t)[:, 0] == pytest.approx(expected, abs=1e-15)


@settings(max_examples=15)
@given(st.integers(0, 10_000))
def test_superposition_and_any_cut_into_blocks(seed: int) -> None:
    """Position to 1e-12 of a dense sum; velocity likewise; the same pieces however it is cut."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 40))
    durations, c = random_pieces(rng, n)
    k = int(rng.integers(1, 6))
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.2, k))])
    amplitudes = rng.normal(size=k + 1)
    amplitudes[-1] += 1.0 - amplitudes.sum()
    shaper = Shaper(amplitudes=amplitudes, times_s=times)
    plain = made(durations, c)
    shaped = shape_trajectory(plain, shaper, None)

    assert shaped.duration_s == pytest.approx(plain.duration_s + times[-1], abs=1e-12)
    t = rng.uniform(0.0, shaped.duration_s + 0.1, 300)
    for order in (0, 1):
        expected = np.zeros((len(t), 2))
        for a, d in zip(amplitudes, times, strict=True):
            # Before its start the trajectory stands.
            expected += a * plain(t - d, order) * ((t >= d) | (order == 0))[:, None]
        scale = np.abs(expected).max() + 1.0
        assert np.abs(shaped(t, order) - expected).max() <= 1e-12 * scale * 10.0**order
    cuts = sorted(rng.integers(0, n + 1, int(rng.integers(0, 6))).tolist())
    again = shape_trajectory(made(durations, c, cuts=cuts), shaper, None)
    for name in ("start_s", "duration_s", "coefficients", "operation"):
        one, other = (
            np.concatenate([getattr(b, name) for b in trajectory]) for trajectory in (shaped, again)
        )
        assert np.array_equal(one, other), name


@pytest.mark.parametrize("amplitudes", [(-0.5, 1.5), (1.5, -0.5), (4.0, -3.0)])
def test_a_centroid_outside_its_train_leaves_the_operations_in_place(
    amplitudes: tuple[float, float],
) -> None:
    """Centroids at 0.15, -0.05 and -0.3 s of a train of 0.1 s: its end, or its begin, counts.

    The operation is the one under way so long before, by hand, in any division into blocks.
    """
    durations, c = random_pieces(np.random.default_rng(5), 30)
    shaper = Shaper(amplitudes=np.array(amplitudes), times_s=np.array([0.0, 0.1]))
    late_s = 0.1 if amplitudes[0] < 0.0 else 0.0
    ends = np.cumsum(durations)
    for cuts in ([], [7], [3, 4, 5, 20], list(range(1, 30))):
        for block in shape_trajectory(made(durations, c, cuts=cuts), shaper, None):
            middle = block.start_s + 0.5 * block.duration_s
            expected = np.searchsorted(ends, np.maximum(middle - late_s, 1e-12), side="right")
            np.testing.assert_array_equal(block.operation, np.minimum(expected, 29))


def test_memory_holds_only_what_the_train_reaches() -> None:
    """A long trajectory, block by block: the shaped blocks stay small and come as it is read."""
    rng = np.random.default_rng(3)
    read = []

    def blocks() -> Iterator[TrajectoryBlock]:
        position = np.zeros(2)
        for i in range(50):
            c = rng.normal(size=(100, 4, 2))
            for row in c:
                row[0] = position
                position = row.sum(axis=0)
            read.append(i)
            yield TrajectoryBlock(
                start_s=(np.arange(100) + 100 * i) * 0.01,
                duration_s=np.full(100, 0.01),
                coefficients=c,
                operation=np.full(100, i),
            )

    shaped = shape_trajectory(
        Trajectory(axes=("X", "Y"), blocks=Made(blocks)), design("zvd", MODE), None
    )
    longest = 0
    for count, block in enumerate(shaped, start=1):
        longest = max(longest, len(block))
        assert len(read) <= count + 2
    assert longest <= 3 * 110


def oscillator_ring(trajectory: Trajectory, mode: FlexibleMode) -> float:
    """Return the envelope of x'' + 2 z w (x' - y') + w^2 (x - y) = 0 after the end, by DOP853."""
    w, z = 2 * math.pi * mode.frequency_hz, mode.damping_ratio
    state = np.zeros(2)  # deviation from the command and its rate: e'' + 2zw e' + w^2 e = -y''
    for block in trajectory:
        for start, duration in zip(block.start_s, block.duration_s, strict=True):

            def rate(t: float, e: np.ndarray, block: TrajectoryBlock = block) -> list[float]:
                return [
                    e[1],
                    -2 * z * w * e[1]
                    - w * w * e[0]
                    - float(block.evaluate(np.array([t]), 2)[0, 0]),
                ]

            # Within its piece, so that the integrator never steps over a jump.
            state = solve_ivp(
                rate,
                (start + 1e-12 * duration, start + duration * (1 - 1e-12)),
                state,
                method="DOP853",
                rtol=1e-12,
                atol=1e-15,
            ).y[:, -1]
    return math.hypot(state[0], (state[1] / w + z * state[0]) / math.sqrt(1 - z * z))


@pytest.mark.parametrize("kind", ["zv", "zvd", "um-zv"])
def test_a_shaped_move_leaves_an_oscillator_at_rest(kind: str) -> None:
    move = rest_to_rest(duration=0.12, axes=1)
    plain = oscillator_ring(move, MODE)
    assert plain > 0.01  # of 0.1 m: otherwise the shaper would have no effect
    shaped = shape_trajectory(move, design(kind, MODE), None)
    assert oscillator_ring(shaped, MODE) < 1e-9


def test_two_modes_are_silenced_by_a_convolution() -> None:
    other = FlexibleMode(31.0, 0.01)
    move = rest_to_rest(duration=0.06, axes=1)
    shaper = parse_shaper("zv:12Hz:0.02*zv:31Hz:0.01")
    assert isinstance(shaper, Shaper)
    shaped = shape_trajectory(move, shaper, None)
    for mode in (MODE, other):
        assert oscillator_ring(move, mode) > 1e-4
        assert oscillator_ring(shaped, mode) < 1e-9


def winder_trajectory(examples: Path, name: str = "x-180.prg") -> Trajectory:
    job = read_job(examples / name, MACHINE)
    programmed = programmed_path(job, MACHINE, feed=None)
    path = plan_path(programmed, MACHINE, interpolation="auto", tolerance_m=1e-4)
    return plan_trajectory(path, MACHINE)


def test_positive_shapers_keep_every_limit_and_switched_ones_are_refused(examples: Path) -> None:
    plain = winder_trajectory(examples)
    before = {(p.axis, p.quantity): p for p in limit_peaks(plain, MACHINE)}
    shaped = shape_trajectory(plain, design("ei", MODE), MACHINE)
    for peak in limit_peaks(shaped, MACHINE):
        was = before[peak.axis, peak.quantity]
        assert peak.ratio <= was.ratio * (1 + 1e-9) + 1e-12, (peak, was)
    assert shaped.duration_s > plain.duration_s
    over = Shaper(amplitudes=np.array([3.0, -5.0, 3.0]), times_s=np.array([0.0, 0.02, 0.04]))
    with pytest.raises(LimitError, match="limit is"):
        shape_trajectory(plain, over, MACHINE)


def test_centroid_shift_keeps_a_straight_line_at_constant_speed() -> None:
    c = np.zeros((1, 2, 2))
    c[0, 1] = 0.3, -0.2
    line = made([1.0], c)
    shapers = {"X": design("zv", MODE), "Y": design("zvd", FlexibleMode(20.0))}
    t = np.linspace(0.2, 0.9, 30)

    def off_line(trajectory: Trajectory) -> float:
        y = trajectory(t)
        return float(np.abs(y[:, 0] / 0.3 + y[:, 1] / 0.2).max())

    assert off_line(shape_trajectory(line, shapers, None)) > 1e-3
    aligned = shape_trajectory(line, shapers, None, centroid_shift=True)
    assert off_line(aligned) < 1e-14
    # Both axes are late by the later centroid, exactly.
    late = max(one.centroid_s for one in shapers.values())
    assert aligned(t)[:, 0] == pytest.approx(0.3 * (t - late), abs=1e-14)
    # An axis that is not named is delayed, not shaped.
    one_by_one = shape_trajectory(line, {"X": shapers["X"]}, None, centroid_shift=True)
    assert one_by_one(t)[:, 1] == pytest.approx(-0.2 * (t - shapers["X"].centroid_s), abs=1e-14)


def test_rests_that_something_needs_are_rests_still() -> None:
    """Move, output, move: the train ends before the second begins; move, move: it does not."""
    one = rest_to_rest(0.1, 0.2)
    (block,) = list(one)
    back = -block.coefficients[0].copy()
    back[0] = block.coefficients[0].sum(axis=0)
    c = np.stack([block.coefficients[0], back])
    shaper = design("zvd", MODE)
    for operations, extra in (([0, 2], 1), ([0, 1], 0)):
        shaped = shape_trajectory(made([0.2, 0.2], c, operations), shaper, None)
        assert shaped.duration_s == pytest.approx(0.4 + (1 + extra) * shaper.duration_s)
        end_of_first = 0.2 + shaper.duration_s
        speed = np.abs(shaped(end_of_first, 1)).max()
        assert speed < 1e-12 if extra else speed > 0.01
        if extra:
            start = np.concatenate([b.start_s for b in shaped])
            operation = np.concatenate([b.operation for b in shaped])
            first = int(np.searchsorted(operation, 2))
            assert start[first] == pytest.approx(end_of_first, abs=1e-12)


def test_a_dwell_is_one_standing_piece_of_its_own_length() -> None:
    one = rest_to_rest(0.1, 0.2)
    (block,) = list(one)
    held = np.zeros((6, 2))
    held[0] = block.coefficients[0].sum(axis=0)
    back = -block.coefficients[0].copy()
    back[0] = held[0]
    c = np.stack([block.coefficients[0], held, back])
    for cuts in ([], [1], [1, 2], [2]):
        plain = made([0.2, 0.07, 0.2], c, [0, 0, 2], cuts)
        shaped = list(shape_trajectory(plain, design("zvd", MODE), None))
        start, length, still = (
            np.concatenate(part)
            for part in zip(
                *(
                    (b.start_s, b.duration_s, (b.coefficients[:, 1:] == 0).all(axis=(1, 2)))
                    for b in shaped
                ),
                strict=True,
            )
        )
        assert length[still] == pytest.approx([0.07], rel=1e-9)
        assert start[still] == pytest.approx([0.2 + design("zvd", MODE).duration_s])


@pytest.mark.parametrize("cuts", [[], [1, 2, 3], [2]])
def test_every_rest_makes_all_that_follows_later(cuts: list[int]) -> None:
    """Four moves of 0.2 s with an output between each two: the train is played four times."""
    (block,) = list(rest_to_rest(0.1, 0.2))
    out = block.coefficients[0]
    back = -out.copy()
    back[0] = out.sum(axis=0)
    shaper = design("zvd", MODE)
    plain = made([0.2] * 4, np.stack([out, back, out, back]), [0, 2, 4, 6], cuts)
    shaped = shape_trajectory(plain, shaper, None)
    every = 0.2 + shaper.duration_s
    assert shaped.duration_s == pytest.approx(4 * every, rel=1e-12)
    for k in range(4):
        middle = shaped(k * every + 0.1)
        assert np.abs(shaped(k * every, 1)).max() < 1e-12
        first = middle - shaped(k * every)
        assert np.abs(first).max() > 1e-3  # under way
    assert shaped(np.array([every, 3 * every]))[:, 0] == pytest.approx([0.1, 0.1], abs=1e-12)


def test_a_dwell_between_steps_of_speed_is_a_rest() -> None:
    """Historical motion: constant speeds with a dwell between them."""
    c = np.zeros((3, 2, 2))
    c[0, 1, 0], c[1, 0, 0], c[2, 0, 0], c[2, 1, 0] = 0.1, 0.1, 0.1, -0.1
    shaper = design("zvd", MODE)
    shaped = shape_trajectory(made([0.2, 0.07, 0.2], c, [0, 0, 2]), shaper, None)
    assert shaped.duration_s == pytest.approx(0.47 + 2 * shaper.duration_s)
    assert shaped(0.2 + shaper.duration_s + 0.01)[0] == pytest.approx([0.1, 0.0], abs=1e-15)


def test_outputs_of_a_job_wait_for_the_shaped_motion(tmp_path: Path) -> None:
    """A dwell and an end take effect where the shaped command stands, not in its middle."""
    job_file = tmp_path / "job.prg"
    job_file.write_text("%\nO 1;\nN 10 G01 F 2160;\nN 15 G91;\nN 20 X 40;\nN 30 G04 P 0.3;\n"
                        "N 40 X -40;\nN 50 M30;\n%\n")  # fmt: skip
    job = read_job(job_file, MACHINE)
    programmed = programmed_path(job, MACHINE, feed=None)
    path = plan_path(programmed, MACHINE, interpolation="auto", tolerance_m=1e-4)
    plain = plan_trajectory(path, MACHINE)
    shaper = design("zvd", FlexibleMode(3.0))
    shaped = shape_trajectory(plain, shaper, MACHINE)
    table = compile_ticks(shaped, MACHINE, job)
    blocks = list(table)
    counts = np.concatenate([b.counts for b in blocks])
    (dwell,) = [e for b in blocks for e in b.events if e.kind == "dwell"]
    ticks = round(dwell.value / float(table.clock.period_s))
    assert ticks > 10
    assert (counts[dwell.tick : dwell.tick + ticks] == 0).all()
    assert counts[dwell.tick - 2].any()
    assert counts[: dwell.tick].sum(axis=0).tolist() == (-counts[dwell.tick :].sum(axis=0)).tolist()
