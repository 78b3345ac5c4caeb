"""Long moves without their middles: the verdict is the same as on the whole moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.errors import LimitError
from threadline.jobs import Job, read_job
from threadline.jobs.operations import Feed, FeedMode, Move
from threadline.machine import Machine, load_machine
from threadline.machine.quantity import parse_machine_quantity
from threadline.machine.radii import with_radii
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, try_plan
from threadline.search import fastest_job
from threadline.search.paced import Question
from threadline.search.shortened_jobs import LongMoves
from threadline.verdict import load_spec

FEED = Feed(FeedMode.FASTEST_AXIS, 0.15)
HOOPS = "G21 G90 G94 F9000\nG1 X100\nG1 X300 A9000\nG4 P0.2\nG1 X100 A18000\nG1 X0\nM30\n"
"""Two hoop layers of 9000 degrees at a radius of 50 mm: 52 s each at 0.15 m/s."""


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("stepper-winder")


def job_of(folder: Path, machine: Machine, text: str = HOOPS) -> Job:
    path = folder / "hoops.nc"
    path.write_text(text)
    return read_job(path, machine)


def targets_of(job: Job) -> np.ndarray:
    return np.array([job.start, *(one.target for one in job if isinstance(one, Move))])


def test_both_ends_of_a_long_move_stay(tmp_path: Path, machine: Machine) -> None:
    """All moves are kept with their directions; two of them last 6 s and four ramps."""
    job = job_of(tmp_path, machine)
    watched, on = LongMoves.of(job, machine).without_middles(FEED, 1.0)
    assert on is machine
    assert [type(one) for one in watched] == [type(one) for one in job]
    assert [one.source for one in watched] == [one.source for one in job]
    before, after = (np.diff(targets_of(one), axis=0) for one in (job, watched))
    short = [0, 3]
    np.testing.assert_allclose(after[short], before[short], atol=1e-12)
    for at in (1, 2):
        share = after[at] / before[at]
        assert share[0] == pytest.approx(share[1], rel=1e-12)
        lasts_s = np.abs(before[at]).max() * 0.05 / 0.15
        assert 6.0 < share[0] * lasts_s < 8.0
    # With a tenth of the acceleration the machine takes longer to reach the speed.
    gentle = np.diff(targets_of(LongMoves.of(job, machine).without_middles(FEED, 0.1)[0]), axis=0)
    assert (np.abs(gentle[1]) > 1.1 * np.abs(after[1])).all()


def test_cut_job_has_the_results_of_the_whole_job(tmp_path: Path, machine: Machine) -> None:
    """Compared with every tick of the job, in each criterion.

    The motors have even microsteps: at a turning point the place within a step matters, and it is
    another place after a cut. Runs with other phases cover that.
    """
    drives = {name: replace(drive, microstep_error=None) for name, drive in machine.drives.items()}
    machine = replace(machine, drives=drives)
    job, spec = job_of(tmp_path, machine), load_spec(None, machine)
    options = Options(feed=FEED)
    whole, less = (
        try_plan(plan, spec).verdict
        for plan in (
            plan_job(job, machine, options),
            plan_job(LongMoves.of(job, machine).without_middles(FEED, 1.0)[0], machine, options),
        )
    )
    assert whole.passed and less.passed
    measured = {(r.name, r.axis): r.measured for r in whole.results if r.measured is not None}
    found = {(r.name, r.axis): r.measured for r in less.results if r.measured is not None}
    measured.pop(("travel", "X"))
    found.pop(("travel", "X"))
    assert found.keys() == measured.keys() and len(found) > 8
    for key, value in measured.items():
        # Ticks of 1 ms and counts fall elsewhere: one is 0.0125 mm of X, and 0.65 mrad or 0.033
        # mm of A.
        allowed = 5e-3 if key[0] == "settling_time" else 6.6e-4 if key[1] == "A" else 3e-5
        assert found[key] == pytest.approx(value, rel=0.03, abs=allowed), key


def test_cut_job_that_leaves_the_travel_is_judged_without_ends_of_travel(
    tmp_path: Path, machine: Machine
) -> None:
    """A hoop layer goes forth, quick steps go back: after a cut they would end beyond X's end."""
    back = "".join(f"G1 X{x} A{9000 + 40 * k}\n" for k, x in enumerate(range(380, -500, -20)))
    text = f"G21 G90 G94 F9000\nG1 X-400\nG1 X400 A9000\n{back}M30\n"
    job = job_of(tmp_path, machine, text)
    watched, on = LongMoves.of(job, machine).without_middles(FEED, 1.0)
    assert targets_of(watched)[:, job.axes.index("X")].min() < -0.5
    assert on.axes["X"].travel is None and machine.axes["X"].travel is not None
    assert plan_job(watched, on, Options(feed=FEED)).duration_s < 40.0
    # If the machine has a switch at some place, the job stays whole.
    winder = load_machine("lathe-winder")
    assert winder.inputs
    job = job_of(tmp_path, winder, text)
    assert LongMoves.of(job, winder).without_middles(FEED, 1.0) == (job, winder)


def test_cut_job_longer_than_the_stroke_is_judged_without_a_stroke(
    tmp_path: Path, machine: Machine
) -> None:
    """The job goes from -100 to 300 mm; without the layer's middle it begins at -350 mm."""
    stroke = parse_machine_quantity("500 mm exact, assumed", ("m",))
    axis = replace(machine.axes["X"], stroke=stroke)
    short = replace(machine, axes={**machine.axes, "X": axis})
    back = "".join(f"G1 X{x} A{9000 + 40 * k}\n" for k, x in enumerate(range(260, -101, -20)))
    text = f"G21 G90 G94 F9000\nG1 X300\nG1 X0\nG1 X280 A9000\n{back}M30\n"
    job = job_of(tmp_path, short, text)
    watched, on = LongMoves.of(job, short).without_middles(FEED, 1.0)
    places = targets_of(watched)[:, job.axes.index("X")]
    assert np.abs(places).max() < 0.5 < np.ptp(places)
    assert on.axes["X"].stroke is None


def test_a_mandrel_of_many_radii_stays_whole(tmp_path: Path, machine: Machine) -> None:
    conical = with_radii(machine, "A=20 mm at X 0 mm; 50 mm at X 300 mm")
    job = job_of(tmp_path, conical)
    assert LongMoves.of(job, conical).without_middles(FEED, 1.0) == (job, conical)
    assert LongMoves.of(job, machine).without_middles(FEED, 1.0)[0] is not job


def test_a_limit_that_is_broken_late_in_a_long_move_is_told(
    tmp_path: Path, machine: Machine
) -> None:
    """X reaches its end after 42 of the 52 s of a hoop layer, in the part that trials leave out."""
    job = job_of(tmp_path, machine, "G21 G90 G94 F9000\nG1 X100\nG1 X600 A9000\nG1 X0\nM30\n")
    with pytest.raises(LimitError, match="its travel ends at 500 mm"):
        fastest_job(
            Question(
                job=job,
                machine=machine,
                spec=load_spec(None, machine),
                options=Options(),
                low=0.14,
                high=0.15,
            )
        )
    inside = job_of(tmp_path, machine, "G21 G90 G94 F9000\nG1 X100\nG1 X500 A9000\nG1 X0\nM30\n")
    watched, _ = LongMoves.of(inside, machine).without_middles(FEED, 1.0)
    assert np.abs(targets_of(watched)[:, job.axes.index("X")]).max() < 0.4


def test_the_answer_is_of_the_whole_job(tmp_path: Path, machine: Machine) -> None:
    """This also holds for a job of long moves alone without any repetition."""
    job = job_of(tmp_path, machine)
    file = tmp_path / "spec.toml"
    file.write_text('name = "any"\n[[criteria]]\nname = "velocity"\nlimit = "machine"\n')
    spec = load_spec(file, machine)
    found = fastest_job(
        Question(
            job=job,
            machine=machine,
            spec=spec,
            options=Options(interpolation="linear"),
            low=0.14,
            high=0.15,
        )
    )
    assert found.cut and found.whole and found.parts == 0
    assert found.best.duration_s is not None and found.best.duration_s > 100.0
