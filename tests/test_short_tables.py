"""Tables of feed-forward that begin and end with the motion of their loads."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.commands.plan import Plan
from threadline.files import tick_table
from threadline.jobs.reading import read_job
from threadline.machine import load_machine
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options, describe, options_from
from threadline.proof.pipeline import plan_job

FAST = parse_feed("1000 count/tick")
AFTER_TICKS = 100  # the loops have settled by then
STANDS_M = 2e-5  # a count is 18 um


def planned(job: Path, contour_m: float | None, machine: str = "lathe-winder") -> Plan:
    """Return the plan of ``optimal`` with feed-forward, at the limits."""
    found = load_machine(machine)
    options = Options(interpolation="optimal", feed=FAST, feed_forward_s=0.01, contour_m=contour_m)
    return plan_job(read_job(job, found), found, options)


def driven(plan: Plan) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, places of X in m, and levels in V, of a loop that is written out here.

    One inertia behind a winding without inductance: the speed approaches the voltage's by
    exp(-t / tau), and the way is the exact integral. PD with whole counts, levels of the DAC, and 0
    V at the first tick after a reversal, as the thesis describes its card.
    """
    table = tick_table(plan.commands)
    x = table.axes.index("X")
    counts = np.concatenate([np.asarray(block.counts)[:, x] for block in table])
    commanded = table.start_counts[x] + np.concatenate([[0], np.cumsum(counts)])
    commanded = np.concatenate([commanded, np.full(AFTER_TICKS, commanded[-1])])
    tick_s, per_m = 0.005, 55358.0
    torque, emf, ohms, inertia, gain, amperes = (
        0.082,
        8.6 * 60 / (2e3 * np.pi),
        0.4,
        3.606e-4,
        0.45,
        4.0,
    )
    level_v = 20.0 / 4096
    per_rad = 4000 / (2 * np.pi)
    angle, speed, before, error_before = commanded[0] / per_rad, 0.0, 0.0, 0.0
    places, levels = [], []
    for expected in commanded:
        error = expected - np.floor(angle * per_rad + 0.5)
        level = float(np.rint(2 * error + 4 * (error - error_before))) * level_v
        error_before = error
        level = 0.0 if level * before < 0.0 else level
        before = level
        places.append(angle * per_rad / per_m)
        levels.append(level)
        # Fine steps of the exact answer, so that the limit of the current can cut in.
        for _ in range(50):
            fine_s = tick_s / 50
            wound = np.clip((gain * level - emf * speed) / ohms, -amperes, amperes)
            mean = speed + 0.5 * fine_s * torque * wound / inertia
            wound = np.clip((gain * level - emf * mean) / ohms, -amperes, amperes)
            gained = fine_s * torque * wound / inertia
            angle += fine_s * (speed + 0.5 * gained)
            speed += gained
    return np.arange(len(commanded)) * tick_s, np.array(places), np.array(levels)


def off_m(plan: Plan) -> float:
    """Return the largest distance of X from its motion, in the loop written out here."""
    time_s, places, _ = driven(plan)
    intended = plan.motion.trajectory(time_s)[:, plan.motion.axes.index("X")]
    return float(np.abs(places - intended).max())


def test_a_table_ends_before_its_load_stands_and_the_load_keeps_its_motion(
    examples: Path,
) -> None:
    """From the first row until the loop has settled, X keeps the allowed distance."""
    whole, short = planned(examples / "x-180.prg", np.inf), planned(examples / "x-180.prg", None)
    moves_s = short.motion.moving_s[1] - short.motion.moving_s[0]
    assert whole.duration_s > moves_s + 0.1
    assert short.duration_s < moves_s
    table = tick_table(short.commands)
    assert sum(len(block) for block in table) * 0.005 == pytest.approx(short.duration_s)
    time_s, places, levels = driven(short)
    assert off_m(whole) < 5e-5
    assert off_m(short) < 3e-4
    late = time_s > short.duration_s + 0.2
    assert np.abs(places[late]).max() < STANDS_M
    # A tenth of the volts is kept, except for counts and levels; the plan's demand shows it.
    assert np.abs(levels).max() < 9.3
    assert short.motion.demands[short.motion.axes.index("X")].volts <= 9.0 * 1.001


def test_less_leeway_makes_a_longer_table_that_the_load_follows_more_closely(
    examples: Path,
) -> None:
    plans = [planned(examples / "x-180.prg", within) for within in (1e-5, 1e-4, 4e-4)]
    durations = [plan.duration_s for plan in plans]
    assert durations[0] >= durations[1] > durations[2]
    assert off_m(plans[0]) < 6e-5
    assert off_m(plans[2]) < 4.5e-4


@pytest.mark.parametrize(
    ("body", "ends_late"),
    [
        ("G01 X 20 F 60000", False),
        ("G01 X 0.05 F 60000", False),
        ("G01 X 20 F 60000\nG04 P 0.3", True),
    ],
)
def test_short_moves_and_rests_at_the_end(tmp_path: Path, body: str, ends_late: bool) -> None:
    """A programmed dwell is not cut off, and a move of a few ticks arrives."""
    lines = "".join(f"N {10 * k} {line};\n" for k, line in enumerate(body.split("\n"), 1))
    job = tmp_path / "short.prg"
    job.write_text(f"%\nO 1;\n{lines}N 90 M30;\n%\n")
    plan = planned(job, None)
    end_s = plan.motion.trajectory.moves_s[1]
    assert (plan.duration_s >= end_s + 0.3 - 1e-9) == ends_late
    assert off_m(plan) < 3.3e-4
    _, places, _ = driven(plan)
    expected = plan.motion.trajectory(plan.motion.trajectory.duration_s)[0]
    assert abs(places[-1] - expected[plan.motion.axes.index("X")]) < STANDS_M


def test_contour_option_is_recorded_and_read_back(examples: Path) -> None:
    """Recordings without this option have tables with the rests of their inverses."""
    machine = load_machine("lathe-winder")
    job = read_job(examples / "x-180.prg", machine)
    options = Options(interpolation="optimal", feed=FAST, feed_forward_s=0.01, contour_m=2e-4)
    described = describe(job, machine, options)
    assert options_from(described) == options
    del described["contour"]
    assert options_from(described).timing.ends_m is None
    assert replace(options, contour_m=None).timing.ends_m == 3e-4
    assert replace(options, interpolation="auto", contour_m=None).timing.ends_m is None
