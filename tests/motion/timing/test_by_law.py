"""Moves by a motion law: their times in closed form, their limits, the law itself, the commands."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from threadline.cli.main import main
from threadline.errors import OptionError
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import load_machine
from threadline.motion.laws import LAWS, law, write_law
from threadline.motion.path import chord_path, plan_path, programmed_path
from threadline.motion.timing import Pace, Trajectory, check_limits, limit_peaks, plan_trajectory

from ..path.builders import job_of

WINDER = load_machine("lathe-winder")
ROOT = Path(__file__).resolve().parents[3]
FAST = Feed(FeedMode.FASTEST_AXIS, 1e4)  # so that only the limits bind


def by(name: str, points: list[tuple[float, ...]], feed: Feed = FAST) -> Trajectory:
    programmed = programmed_path(job_of(points, axes=("X", "Y"), feed=None), WINDER, feed=feed)
    path = chord_path(programmed, f"law:{name}")
    return plan_trajectory(path, WINDER, Pace.LAW, law(name))


def limits_of(axis: str) -> tuple[float, float, float]:
    a = WINDER.axes[axis]
    assert a.jerk is not None
    return a.velocity.si, a.acceleration.si, a.jerk.si


MOVES = [(0.0, 0.0), (0.3, 0.0), (0.3005, 0.0), (0.1, 0.1), (0.1, 0.1), (0.1, 0.1 + 2e-6)]


@pytest.mark.parametrize(
    "name", [*LAWS, "trapezoid:0.2", "harmonic:15", "jerk-limited:1,2,1,3,2,1,2"]
)
def test_rapid_moves_take_the_least_time_within_every_limit(name: str) -> None:
    """T = max(Cv h / V, sqrt(Ca h / A), cbrt(Cj h / J)) over the axes, move by move.

    To 1e-5: the quintic pieces of a law of sines have a little more jerk than the law.
    """
    motion = law(name)
    expected = 0.0
    for start, end in pairwise(MOVES):
        times = [0.0]
        for axis, way in zip("XY", np.subtract(end, start), strict=True):
            top, acceleration, jerk = limits_of(axis)
            h = abs(way)
            times += [motion.velocity * h / top, np.sqrt(motion.acceleration * h / acceleration)]
            if motion.jerk is not None:
                times.append(np.cbrt(motion.jerk * h / jerk))
        expected += max(times)
    moved = by(name, MOVES)
    assert moved.duration_s == pytest.approx(expected, rel=2e-5)
    assert moved.historical == (motion.jerk is None)
    peaks = check_limits(moved, WINDER)
    held = (
        ("velocity", "acceleration")
        if motion.jerk is None
        else ("velocity", "acceleration", "jerk")
    )
    used = max(p.ratio for p in peaks if p.quantity in held)
    assert 0.999 < used <= 1.0 + 1e-9
    if motion.jerk is None:
        assert max(p.ratio for p in peaks if p.quantity == "jerk") == np.inf


@pytest.mark.parametrize("name", ["modified-sine", "harmonic-5", "cubic", "5-6-7-8-9"])
def test_the_motion_is_the_law_and_its_peak_meets_the_feed(name: str) -> None:
    """36 mm/s along 3-4-5 triangles: the fastest axis at its feed, both axes by the law."""
    motion = law(name)
    feed = Feed(FeedMode.FASTEST_AXIS, 0.036)
    moved = by(name, [(0.0, 0.0), (0.2, 0.15)], feed)
    duration = motion.velocity * 0.2 / 0.036
    assert moved.duration_s == pytest.approx(duration, rel=1e-9)
    t = np.linspace(0, 1, 5001)
    way = np.array([0.2, 0.15])
    for derivative, tolerance in ((0, 2e-9), (1, 1e-6), (2, 1e-3)):
        expected = motion(t, derivative)[1:-1, None] * way / duration**derivative
        found = moved(t * moved.duration_s, derivative)[1:-1]
        assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max()
    assert np.abs(moved(t * duration, 1)).max() == pytest.approx(0.036, rel=1e-6)


def test_a_measured_law_moves_a_machine_too(tmp_path: Path) -> None:
    """A table of constant jerks that is not symmetric, through a file."""
    exact = law("jerk-limited:1,2,1,3,2,1,2")
    write_law(exact, tmp_path / "frame.csv")
    read = by(str(tmp_path / "frame.csv"), MOVES)
    assert read.duration_s == pytest.approx(
        by("jerk-limited:1,2,1,3,2,1,2", MOVES).duration_s, rel=1e-4
    )
    assert max(peak.ratio for peak in limit_peaks(read, WINDER)) <= 1.0 + 1e-9


def test_laws_follow_chords_only() -> None:
    programmed = programmed_path(job_of(MOVES, axes=("X", "Y"), feed=None), WINDER)
    with pytest.raises(OptionError, match="is followed along chords, not along auto"):
        plan_trajectory(plan_path(programmed, WINDER, "auto"), WINDER, Pace.LAW, law("cubic"))
    with pytest.raises(OptionError, match="name the law"):
        plan_trajectory(chord_path(programmed), WINDER, Pace.LAW)


def ran(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[object, str, str]:
    with pytest.raises(SystemExit) as caught:
        main(list(arguments))
    out, err = capsys.readouterr()
    return caught.value.code, out, err


X180 = (str(ROOT / "examples" / "x-180.prg"), "-m", "lathe-winder")


def test_prove_compile_and_judge_take_a_law(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    trace = tmp_path / "x.npz"
    code, out, _ = ran(
        capsys, "prove", *X180, "--law", "modified-sine", "--json", "--recording", str(trace)
    )
    proved = json.loads(out)
    assert code == 0
    assert proved["interpolation"] == "law:modified-sine"
    named = {(c["name"], c["axis"]): c for c in proved["criteria"]}
    for quantity in ("velocity", "acceleration", "jerk"):
        assert named[quantity, "X"]["status"] == "passed"
    deviation = [c["measured"] for c in proved["criteria"] if c["name"] == "path_deviation"]
    assert deviation == [pytest.approx(0.0, abs=1e-12)]
    code, out, _ = ran(capsys, "judge", str(trace), "--json")
    judged = json.loads(out)
    assert code == 0 and judged["interpolation"] == "law:modified-sine"
    assert judged["duration_s"] == proved["duration_s"]
    # The jerk of a cubic steps: its demand is reported, as for historical interpolations.
    _, out, _ = ran(capsys, "prove", *X180, "--law", "cubic", "--json")
    named = {(c["name"], c["axis"]): c for c in json.loads(out)["criteria"]}
    assert named["jerk", "X"]["status"] == "reported"
    code, out, _ = ran(
        capsys, "compile", *X180, "--law", "modified-sine", "--target", "csv", "-o",
        str(tmp_path / "x.csv"),
    )  # fmt: skip
    assert code == 0 and (tmp_path / "x.csv").stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--law", "nope"), "unknown motion law 'nope'"),
        (("--law", "cubic", "--interpolation", "linear"), "both choose the interpolation"),
        (("--interpolation", "law:trapezoid:2"), "ramp must be in"),
        (("--law", ""), "unknown motion law ''"),
    ],
)
def test_a_wrong_law_is_one_line(
    arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = ran(capsys, "prove", *X180, *arguments)
    assert (code, out) == (2, "")
    assert message in err and err.count("\n") == 1
