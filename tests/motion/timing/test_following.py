"""Timing that loops and drives can follow, compared with closed forms and with the twin."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.motion.path.builders import job_of
from tests.motion.timing.builders import without_drives
from threadline.dynamics.responses import answers_of
from threadline.errors import PlanError
from threadline.files import tick_table
from threadline.jobs.operations import Dwell, Feed, FeedMode, Source
from threadline.machine import load_machine
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.timing import limit_peaks, plan_trajectory
from threadline.motion.timing.optimal import following_error
from threadline.motion.timing.optimal.followers import Follower, Past
from threadline.motion.timing.optimal.motion_limits import limits_of
from threadline.motion.timing.types import TrajectoryBlock
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, prove_plan
from threadline.twin import simulate
from threadline.verdict import load_spec

WINDER = load_machine("lathe-winder")
SPEC = load_spec(None, WINDER)
FAST = Feed(FeedMode.FASTEST_AXIS, 10.0)
CORNERS = [[0.0, 0.0], [0.1, 0.03], [0.06, 0.1], [0.13, 0.12], [0.15, 0.02]]
CORNER = [[0.0, 0.0], [0.02, 0.006], [0.012, 0.02]]
# For X: the demand of its motor at 4 A and 10 V, by hand from the printed numbers.
RAD_PER_M = 55358.0 * 2.0 * np.pi / 4000.0
VOLTS_PER_M_S = 8.6 / (1000.0 * 2.0 * np.pi / 60.0) * RAD_PER_M / 0.45
AMPERES_PER_M_S2 = 3.606e-4 * RAD_PER_M / 0.082
VOLTS_PER_M_S2 = 0.4 * AMPERES_PER_M_S2 / 0.45


def proved(points, **words):
    job = job_of(points, ("X", "Y"), None, extra=words.pop("extra", {}))
    plan = plan_job(job, WINDER, Options(interpolation="optimal", feed=FAST, **words))
    verdict = prove_plan(plan, SPEC).verdict
    return plan, {(r.name, r.axis): r.measured for r in verdict.results}


@cache
def proved_corner(**words):
    """Several tests use the same plans; each takes seconds, because the way is short."""
    return proved(CORNER, **words)


def values(recording, name):
    """Return all samples of a channel."""
    return np.concatenate([block.samples[name] for block in recording])


def worst(found, name):
    return max(value for (what, _), value in found.items() if what == name)


def test_a_steady_motion_lags_by_the_voltage_that_it_needs():
    """At constant speed the difference per tick is nothing: 2 levels a count make the volts."""
    lag_s = VOLTS_PER_M_S / (2.0 * 20.0 / 4096.0 * 55358.0)
    answer = answers_of(WINDER)["X"]
    assert answer.taps.sum() == pytest.approx(1.0, abs=1e-12)
    assert answer.moments[0] == pytest.approx(lag_s, rel=1e-5)
    ramp = 0.1 * np.arange(400) * answer.period_s
    assert ramp[-1] - answer.load(ramp)[-1] == pytest.approx(0.1 * lag_s, rel=1e-5)


def test_the_answer_is_what_the_twin_does():
    """Within two counts of X, 36 um: the twin rounds its commands and its readings."""
    plan, _ = proved_corner(contour_m=6e-4)
    recording = simulate(tick_table(plan.commands), WINDER)
    commanded = values(recording, "X.commanded")
    load = values(recording, "X.load")
    answer = answers_of(WINDER)["X"]
    assert np.abs(commanded - load).max() > 1e-3
    assert np.abs(answer.load(commanded) - load).max() < 4e-5


def test_the_loads_keep_the_contour_that_was_asked_for():
    """0.1 mm for the path and 0.3 mm for the loops, plus the twin's counts and levels.

    With the limits of axes and drives alone the same path is out of specification.
    """
    plan, found = proved_corner()
    assert 0.25e-3 < worst(found, "contour_error") <= 0.43e-3
    assert worst(found, "dac_saturation") == 0.0
    hasty, lost = proved_corner(contour_m=np.inf)
    assert worst(lost, "contour_error") > 1e-3
    coarser, _ = proved_corner(contour_m=6e-4)
    assert hasty.duration_s < coarser.duration_s < 0.9 * plan.duration_s


@pytest.mark.long(shown_by="test_a_place_that_strays_by_nothing_is_not_slowed")
def test_motions_that_stray_a_hundredth_too_far_are_slowed_and_not_lost():
    """With four short moves every round ends so; the guards alone would leave 0.864 s."""
    plan, found = proved((0.2 * np.array(CORNERS)).tolist())
    assert plan.duration_s < 0.83
    assert worst(found, "contour_error") <= 0.43e-3


@pytest.mark.long(shown_by="test_the_loads_keep_the_contour_that_was_asked_for")
def test_the_contour_is_kept_where_the_program_rests():
    """The loops' response to the move before a rest counts against the move after it."""
    extra = {k: Dwell(0.001, Source("job.prg", k)) for k in (1, 2)}
    plan, found = proved(CORNERS[:4], extra=extra)
    assert worst(found, "contour_error") <= 0.43e-3
    _, lost = proved(CORNERS[:4], extra=extra, contour_m=np.inf)
    assert worst(lost, "contour_error") > 1e-3
    assert max(peak.ratio for peak in limit_peaks(plan.motion.trajectory, WINDER)) <= 1.001


def test_loads_that_follow_are_not_slowed_for_their_loops():
    """The inverse of the loops, within the drives: no sample at the clamp, and half the time."""
    motors, _ = proved_corner()
    loads, found = proved_corner(feed_forward_s=0.01)
    assert worst(found, "contour_error") <= 0.45e-3
    assert worst(found, "dac_saturation") == 0.0
    assert loads.duration_s < 0.75 * motors.duration_s


def test_no_slowness_helps_where_the_loads_never_come_near():
    """A sudden stop from 1 m/s: the load is on its way past it, whatever comes next."""
    follower = Follower(answers=(answers_of(WINDER)["X"],), radius_m=np.ones(1), tolerance_m=1e-4)
    past = Past(follower.memory_s)
    past.add(straight(0.0, 0.0, 1.0))
    assert (
        following_error.slowed_until_followed(straight(1.0, 1.0, 1.1), follower, past).end_s
        > 1.1 + 1.0
    )
    with pytest.raises(PlanError, match=r"stray .* mm from the path however slowly"):
        following_error.slowed_until_followed(straight(1.0, 1.0, 1.001, back=True), follower, past)


def test_a_place_that_strays_by_nothing_is_not_slowed():
    """A share of 0 has no negative power; 1.69 times too much is slowed by its power 1.3."""
    shares, known = np.array([0.0, 0.5, 1.0, 1.69]), np.array([np.inf, 3.0, np.inf, np.inf])
    with np.errstate(all="raise"):
        most = following_error.caps_where_loads_stray(known, np.full(4, 2.0), shares)
    assert most[:3].tolist() == [np.inf, 3.0, np.inf]
    assert most[3] == pytest.approx(2.0 / 1.3**2.6, rel=1e-12)


def straight(begin_s, start, end, back=False):
    """Return an even motion of X over a second, or a tenth of a millimetre back."""
    way = -1e-4 if back else end - start
    return TrajectoryBlock(
        start_s=np.array([begin_s]),
        duration_s=np.array([1e-3 if back else 1.0]),
        coefficients=np.array([[[start], [way]]]),
        operation=np.array([0]),
    )


def timed(machine, contour_m=np.inf, axes=("X", "Y"), points=CORNERS):
    programmed = programmed_path(job_of(points, axes, Feed(FeedMode.RAPID, 0.0)), machine)
    path = plan_path(programmed, machine, "optimal", 1e-4)
    return plan_trajectory(path, machine, contour_m=contour_m)


def test_no_drive_is_asked_for_more_than_it_can_give():
    """Volts and amperes of the printed motor, at 20 000 instants, against 90 % of 10 V and 4 A."""
    free = timed(without_drives(WINDER))
    bound = timed(WINDER)
    assert bound.duration_s > 1.05 * free.duration_s
    for trajectory, reached in ((bound, False), (free, True)):
        times = np.linspace(0.0, trajectory.duration_s, 20_001)
        v, a = (trajectory(times, order)[:, 0] for order in (1, 2))
        volts = np.abs(VOLTS_PER_M_S * v + VOLTS_PER_M_S2 * a).max()
        amperes = np.abs(AMPERES_PER_M_S2 * a).max()
        assert (volts > 9.0 * 1.0001) == reached
        assert (amperes > 3.6 * 1.0001) == reached
    assert volts > 10.0  # without the limit the DAC would have been at its clamp


def test_a_long_move_uses_all_the_volts_that_are_left_to_it():
    """By the closed form: at the top speed the velocity alone takes all these volts."""
    trajectory = timed(WINDER, axes=("X",), points=[[0.0], [0.4]])
    times = np.linspace(0.0, trajectory.duration_s, 20_001)
    speed = np.abs(trajectory(times, 1)).max()
    assert speed == pytest.approx(9.0 / VOLTS_PER_M_S, rel=2e-3)
    assert speed <= 9.0 / VOLTS_PER_M_S * (1.0 + 1e-9)
    limits = limits_of(WINDER, ("X",))
    assert limits.acceleration[0] == pytest.approx(3.6 / AMPERES_PER_M_S2, rel=1e-6)


def test_the_machine_file_says_what_is_kept_for_the_loop(tmp_path):
    """With 0.75 of 4 A left instead of 0.9; if the loads follow, 1.1215 times as much is counted.

    The volts of a tick are held for 5 ms; motor and load follow them with a pole at 46.7 1/s, so
    that the current begins at pT / (1 - exp(-pT)) times its mean.
    """
    file = tmp_path / "kept.toml"
    file.write_text(
        'base = "lathe-winder"\n[drives.x.amplifier]\nreserve = "25 % exact, assumed"\n'
    )
    kept = load_machine(str(file))
    assert limits_of(kept, ("X",)).acceleration[0] == pytest.approx(
        3.0 / AMPERES_PER_M_S2, rel=1e-6
    )
    held = 46.7 * 5e-3 / (1.0 - np.exp(-46.7 * 5e-3))
    assert limits_of(kept, ("X",), of_loads=True).acceleration[0] == pytest.approx(
        3.0 / AMPERES_PER_M_S2 / held, rel=1e-3
    )
    assert limits_of(kept, ("Y",)).acceleration[0] == limits_of(WINDER, ("Y",)).acceleration[0]


def test_friction_that_takes_all_that_a_drive_has_is_refused():
    body = WINDER.bodies["x"]
    friction = replace(body.inertia, si=0.4, unit="N*m")
    stuck = replace(WINDER, bodies={**WINDER.bodies, "x": replace(body, friction=friction)})
    with pytest.raises(PlanError, match=r"axis X: friction takes .* drives\.x"):
        limits_of(stuck, ("X",))
