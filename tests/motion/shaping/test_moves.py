"""Shaped moves on simulated machines whose loads swing: the remaining swing in mm, by the twin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from threadline.dynamics.analysis import analyse_axis
from threadline.machine import load_machine
from threadline.motion.shaping import parse_shaper, shape_trajectory
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, prove
from threadline.verdict import Criterion, Spec

SPEC = Spec(
    name="residual",
    criteria=(
        Criterion(name="residual_vibration", options={"after": 0.15, "window": 0.35}),
        Criterion(name="shaping_deviation"),
    ),
)


def proved(folder: Path, reference: str, words: str, feed: str, shaper: str | None) -> Proof:
    job = folder / "move.prg"
    job.write_text(f"%\nO 1;\nN 10 G01 G91 F600;\nN 20 {words};\nN 30 M30;\n%\n")
    options = Options(feed=parse_feed(feed), shaper=shaper)
    return prove(job, load_machine(reference), SPEC, options)


def residual_m(proof: Proof, axis: str) -> float:
    found = proof.verdict.result("residual_vibration", axis).measured
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("reference", "words", "feed", "modes", "times"),
    [
        ("lathe-winder+springy", "X 150", "400 mm/s", ["12.463Hz:0.0574"], 20.0),
        ("stitcher", "X 100", "190 mm/s", ["10.952Hz:0.2707"], 20.0),
        # The frame of Y rings between quantised DAC levels: less can be gained.
        ("stitcher", "Y 100", "190 mm/s", ["15.302Hz:0.2009", "29.828Hz:0.0434"], 4.0),
    ],
)
def test_shaping_leaves_a_fraction_of_the_vibration(
    reference: str, words: str, feed: str, modes: list[str], times: float, tmp_path: Path
) -> None:
    axis = words[0]
    # The shapers' modes are poles of the closed loop, found by other code.
    poles = analyse_axis(load_machine(reference), axis).sampled.poles
    for mode in modes:
        f, zeta = (float(word.removesuffix("Hz")) for word in mode.split(":"))
        near = min(poles, key=lambda s: abs(abs(s) / 6.283185307 - f))
        assert abs(near) / 6.283185307 == pytest.approx(f, rel=1e-3)
        assert -near.real / abs(near) == pytest.approx(zeta, abs=1e-3)
    shaper = "*".join(f"zv:{mode}" for mode in modes)
    plain = proved(tmp_path, reference, words, feed, None)
    shaped = proved(tmp_path, reference, words, feed, shaper)

    assert residual_m(plain, axis) > 0.04e-3
    assert residual_m(shaped, axis) * times < residual_m(plain, axis)
    # One straight move stays on its line.
    away = shaped.verdict.result("shaping_deviation").measured
    assert away is not None
    assert away < 1e-9
    assert shaped.plan.options["shaper"] == shaper
    assert shaped.plan.motion.timed is not None


def test_the_plan_is_that_of_the_shaped_trajectory(tmp_path: Path) -> None:
    text = "zvd:12.463Hz:0.0574"
    proof = proved(tmp_path, "lathe-winder+springy", "X 150", "400 mm/s", text)
    assert proof.plan.motion.timed is not None
    expected = shape_trajectory(proof.plan.motion.timed, parse_shaper(text), None)
    assert proof.plan.motion.trajectory.duration_s == expected.duration_s


def test_a_reversal_that_is_cut_is_the_deviation(tmp_path: Path) -> None:
    """Forth and back on one line: the distance of the shaped motion from the farthest point.

    With 5000 samples each; the acceleration of 10 m/s^2 leaves 1e-6 m between two of them.
    """
    words = "X 50;\nN 25 X -50"
    proof = proved(tmp_path, "lathe-winder", words, "36 mm/s", "zv:12Hz:0.02")
    column = proof.plan.motion.trajectory.axes.index("X")
    time_s = np.linspace(0.0, proof.plan.motion.trajectory.duration_s, 5000)
    assert proof.plan.motion.timed is not None
    farthest = [
        float(motion(time_s)[:, column].max())
        for motion in (proof.plan.motion.timed, proof.plan.motion.trajectory)
    ]
    lacking = farthest[0] - farthest[1]
    assert lacking > 1e-4
    found = proof.verdict.result("shaping_deviation")
    assert found.measured == pytest.approx(lacking, abs=2e-6)
    assert "missed" in found.note
