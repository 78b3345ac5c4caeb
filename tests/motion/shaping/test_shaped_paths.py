"""The distance of shaped motion from its path, and refused shapers."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion.shaping.pieces import MACHINE, MODE, made, rest_to_rest
from threadline.errors import OptionError, PlanError
from threadline.motion.shaping import (
    UNSHAPED,
    FlexibleMode,
    Shaper,
    convolve,
    design,
    longest_delay_s,
    parse_shaper,
    shape_trajectory,
    shaping_deviation,
)
from threadline.motion.timing import Trajectory


def brute_deviation(planned: np.ndarray, shaped: np.ndarray) -> float:
    """Both ways, all places against all: right if a path does not cross itself."""

    def far(points: np.ndarray, chain: np.ndarray) -> float:
        a, way = chain[:-1], np.diff(chain, axis=0)
        square = (way**2).sum(axis=1)
        u = np.einsum("nja,ja->nj", points[:, None] - a[None], way)
        u = np.clip(u / np.where(square > 0, square, 1.0), 0.0, 1.0)
        off = points[:, None] - a[None] - u[:, :, None] * way[None]
        return float(np.sqrt((off**2).sum(axis=2).min(axis=1)).max())

    return max(far(shaped, planned), far(planned, shaped))


def corner() -> Trajectory:
    """Return X, then Y, each from rest to rest and no operation between."""
    c = np.zeros((2, 6, 2))
    c[0, 3:, 0] = c[1, 3:, 1] = np.array([10.0, -15.0, 6.0]) * 0.1
    c[1, 0, 0] = 0.1
    return made([0.5, 0.5], c, [0, 1])


@pytest.mark.parametrize("blend", [0.5, 1.0])
def test_deviation_of_a_corner_is_that_of_a_dense_search(blend: float) -> None:
    shaper = design("zvd", FlexibleMode(6.0 / blend))
    planned = corner()
    shaped = shape_trajectory(planned, shaper, MACHINE)
    found = shaping_deviation(planned, shaped, MACHINE, shaper.duration_s)
    t = np.linspace(0.0, shaped.duration_s, 1500)
    expected = brute_deviation(planned(t), shaped(t))
    assert expected > 1e-4
    # Samples a hundredth of the train apart: chords of 0.1 m in 0.5 s at the corner.
    assert found.at_tool_m == pytest.approx(expected, rel=0.02, abs=2e-6)
    assert found.within(expected * 1.05)
    assert not found.within(expected * 0.9)


def test_one_shaper_leaves_a_straight_line_and_two_do_not() -> None:
    line = rest_to_rest(duration=0.6)
    shared = design("zvd", MODE)
    shaped = shape_trajectory(line, shared, MACHINE)
    assert shaping_deviation(line, shaped, MACHINE, shared.duration_s).at_tool_m < 1e-12
    own = {"X": shared, "Y": design("zv", FlexibleMode(25.0))}
    shaped = shape_trajectory(line, own, MACHINE)
    longest = longest_delay_s(line.axes, own)
    apart = shaping_deviation(line, shaped, MACHINE, longest)
    assert apart.at_tool_m > 1e-3
    aligned = shape_trajectory(line, own, MACHINE, centroid_shift=True)
    longest = longest_delay_s(line.axes, own, centroid_shift=True)
    assert shaping_deviation(line, aligned, MACHINE, longest).at_tool_m < 0.5 * apart.at_tool_m


def test_a_turning_point_that_is_cut_is_a_planned_place_missed() -> None:
    """There and back without a rest: the shaped motion turns early."""
    c = np.zeros((2, 3, 2))
    c[0, 1, 0], c[0, 2, 0] = 0.2, -0.1  # reaches 0.1 m at rest and goes back
    c[1, 0, 0], c[1, 2, 0] = 0.1, -0.1
    planned = made([0.2, 0.2], c, [0, 1])
    shaper = design("zv", FlexibleMode(10.0))
    shaped = shape_trajectory(planned, shaper, None)
    found = shaping_deviation(planned, shaped, MACHINE, shaper.duration_s)
    top = float(shaped(np.linspace(0.0, shaped.duration_s, 20001))[:, 0].max())
    assert found.missed
    assert found.at_tool_m == pytest.approx(0.1 - top, abs=2e-6)
    assert found.at_tool_m > 1e-4


def test_wrong_shapers_are_refused() -> None:
    line = rest_to_rest()
    with pytest.raises(OptionError, match="axis 'A'"):
        shape_trajectory(line, {"A": UNSHAPED}, None)
    half = Shaper(amplitudes=np.array([0.5, 0.4]), times_s=np.array([0.0, 0.1]))
    with pytest.raises(OptionError, match=r"sum to 0\.9"):
        shape_trajectory(line, half, None)
    other = made([0.1], np.zeros((1, 2, 1)), axes=("X",))
    with pytest.raises(PlanError, match="axes"):
        shaping_deviation(line, other, MACHINE, 0.1)


def test_text_of_shapers() -> None:
    one = parse_shaper("ei:12Hz:0.02:0.1")
    assert isinstance(one, Shaper)
    assert one.amplitudes.tolist() == design("ei", MODE, tolerance=0.1).amplitudes.tolist()
    two = parse_shaper("zv : 12 Hz * zvd:3Hz")
    assert isinstance(two, Shaper)
    expected = convolve(design("zv", FlexibleMode(12.0)), design("zvd", FlexibleMode(3.0)))
    assert two.times_s.tolist() == expected.times_s.tolist()
    axes = parse_shaper("X=zv:12Hz:0.02, Y=um-zv:9Hz")
    assert isinstance(axes, dict)
    assert {k: v.name for k, v in axes.items()} == {"X": "zv", "Y": "um-zv"}
    wrong: list[tuple[str, str]] = [
        ("zv", "kind:frequency"),
        ("zv:12", "mode '12'"),
        ("zv:12Hz:x", "damping ratio 'x'"),
        ("zx:12Hz", "unknown"),
        ("X=zv:12Hz,zv:9Hz", "no axis before"),
        ("X=zv:12Hz,X=zv:9Hz", "has two"),
        ("ei:12Hz:0.5", "the damping ratio must be in"),
        ("zv:12mm", "mode '12mm'"),
        ("", "kind:frequency"),
    ]
    for text, words in wrong:
        with pytest.raises(OptionError, match=words):
            parse_shaper(text)
