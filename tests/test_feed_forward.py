"""Jobs planned through the inverses of the axes, simulated with their quantisers and judged."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.blank_pictures import blank_pictures
from threadline.cli.main import main
from threadline.cli.prove import show_proof
from threadline.commands import feedforward as targets
from threadline.dynamics.eccentric import current_needed
from threadline.errors import LimitError, OptionError
from threadline.files.formats import read_recording
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.machine.vary import off_tolerance
from threadline.motion.timing import averaged
from threadline.motion.timing.by_law import rapid_time_s
from threadline.proof.options import Options, options_from
from threadline.proof.pipeline import open_job, plan_job, prove_plan
from threadline.report.lines import feed_forward_lines, motion_lines
from threadline.report.proof import write_report
from threadline.report.traces import collect
from threadline.search import mismatch
from threadline.search.by_pace import speeds
from threadline.search.fastest import COARSE, Fastest
from threadline.search.paced import Question
from threadline.search.report_data import report_data
from threadline.verdict import load_spec, verdict_json
from threadline.verdict.needle import has_stitches, planned_stitches

pytestmark = pytest.mark.usefixtures("coarse_search")

PLACE = Path(__file__).parents[1] / "examples" / "stitcher-place.spec.toml"
SEAM = """
[stitching]
stitch_length = "0.1 in"
needle_speed = "65 stitch/s"
motion = "discrete"
travel_speed = "fastest"
settle = "0 s"

[[contour]]
unit = "mm"
points = [[10, 5], [50.64, 5], [50.64, 45.64]]
"""
WIDTH_S = 0.04
AHEAD = Options(feed_forward_s=WIDTH_S)


@pytest.fixture(scope="module")
def machine():
    return load_machine("stitcher")


@pytest.fixture(scope="module")
def seam(tmp_path_factory):
    file = tmp_path_factory.mktemp("seam") / "corner.seam.toml"
    file.write_text(SEAM)
    return file


@pytest.fixture(scope="module")
def plan(seam, machine):
    return plan_job(read_job(seam, machine), machine, AHEAD)


@pytest.fixture(scope="module")
def proof(plan, machine):
    return prove_plan(plan, load_spec(PLACE, machine))


def measured(proof, name, axis=""):
    return next(r.measured for r in proof.verdict.results if (r.name, r.axis) == (name, axis))


def test_seam_at_65_stitches_a_second_needs_feed_forward(proof, seam, machine):
    assert proof.verdict.passed
    # Cornering at rest takes v E|t| / (4 sqrt 2), a quarter of a full corner, and a little more.
    speed = 65 * 2.54e-3
    rounding = 0.25 * speed * 0.1109 * WIDTH_S / np.sqrt(2)
    assert measured(proof, "contour_error") == pytest.approx(rounding, abs=30e-6)
    plain = prove_plan(
        plan_job(read_job(seam, machine), machine, Options()), load_spec(PLACE, machine)
    )
    assert not plain.verdict.passed
    assert measured(plain, "tracking_error", "X") > 3e-3
    for axis in "XY":
        assert measured(proof, "tracking_error", axis) < 60e-6


def test_loads_are_where_the_trajectory_says(proof, plan):
    """This holds on the clock of the recording, dead time and previews included."""
    for axis, column in (("X", 0), ("Y", 1)):
        times, load = proof.recording.samples(f"{axis}.load")
        expected = plan.motion.trajectory(times)[:, column]
        # 60 um: whole counts are 3.8 um, a DAC level at rest 22 to 24 counts.
        assert np.abs(load - expected).max() < 60e-6
        commanded = proof.recording.samples(f"{axis}.commanded")[1]
        assert np.abs(commanded - expected).max() > 1e-3  # it leads by the filter's time


def test_the_needle_keeps_its_time(plan):
    """With a constant needle all instants are 1/65 s apart up to rounding, corners included."""
    down = np.concatenate([run.down_s for run in planned_stitches(plan)])
    np.testing.assert_allclose(np.diff(down), 1 / 65, atol=1e-12)
    assert has_stitches(plan.job)
    assert len(down) == sum("stitch" in getattr(o, "tags", {}) for o in plan.job)


def test_demand_is_that_of_the_run(proof, plan):
    """The model's demand against the current of the simulated motor and against rigid friction."""
    for demand in plan.motion.demands:
        _, current = proof.recording.samples(f"{demand.axis}.current_peak")
        # A DAC level is 3 V at the motor and 1 kHz of references shake it: 3 A.
        assert np.abs(current).max() == pytest.approx(demand.current_a, abs=3.0)
        friction = current_needed(plan.machine, demand.axis, 65 * 2.54e-3, 0.0)
        assert friction < demand.current_a < 1.2 * friction
        assert demand.bound_by == "current" and demand.current_limit_a == 27.0
    lines = list(feed_forward_lines(plan.motion.demands))
    assert len(lines) == 2 and "A of 27 A" in lines[0]
    assert not plan.motion.warnings


def test_more_current_than_there_is_is_said(seam, machine):
    job = read_job(seam, machine, needle_speed="76 stitch/s")
    plan = plan_job(job, machine, AHEAD)
    assert plan.motion.demands[1].share > 1.0
    messages = plan.motion.warnings
    assert any("axes.Y: the reference needs" in text and "27 A" in text for text in messages)


def test_limits_are_checked_before_anything_is_put_out(seam, machine):
    """79 stitches of 0.1 in are 7.9 in/s; the limit of the axes is 7.8 in/s."""
    job = read_job(seam, machine, needle_speed="79 stitch/s")
    with pytest.raises(LimitError, match=r"velocity reaches 0\.2"):
        plan_job(job, machine, AHEAD)


def test_machine_with_other_numbers_leaves_the_path(plan, machine):
    spec = load_spec(PLACE, machine)
    soft = off_tolerance(machine, stiffness=-1.0)
    assert soft.links["x_belt"].stiffness.si == pytest.approx(0.8 * 6.24e5)
    heavy = off_tolerance(machine, mass=1.0)
    assert heavy.bodies["x_head"].inertia.si == pytest.approx(1.1 * 111)
    assert heavy.bodies["x_motor"].inertia.si == machine.bodies["x_motor"].inertia.si
    worse = prove_plan(plan, spec, actual=soft)
    assert not worse.verdict.passed
    assert 0.2e-3 < measured(worse, "tracking_error", "X") < 2e-3


def test_a_recording_says_how_to_plan_it_again(plan, machine):
    again = plan_job(plan.job, machine, options_from(dict(plan.options)))
    assert again.options == plan.options and again.options["feed-forward"] == "0.04 s"
    for ours, theirs in zip(plan.commands, again.commands, strict=True):
        np.testing.assert_array_equal(ours.counts, theirs.counts)
    with pytest.raises(OptionError, match="exclude each other"):
        plan_job(plan.job, machine, replace(AHEAD, shaper="zv:12Hz:0.02"))


def test_pictures_are_drawn_against_the_intended(proof, plan):
    """The report's commanded trace is the plan's trajectory, not the commands of the chip."""
    traces = collect(proof)
    for column, axis in enumerate("XY"):
        expected = plan.motion.trajectory(traces.time_s)[:, column]
        np.testing.assert_allclose(traces.commanded[axis], expected, atol=1e-12)


def test_long_jobs_stream(plan, machine, seam, monkeypatch):
    """Nothing is kept, few rows and samples exist at once, and the commands are the same."""
    monkeypatch.setattr(averaged, "MOST_CACHED", 0)
    monkeypatch.setattr(averaged, "CHUNK", 100)
    monkeypatch.setattr(targets, "MOST_CACHED", 0)
    monkeypatch.setattr(targets, "ROWS", 64)
    streamed = plan_job(read_job(seam, machine), machine, AHEAD)
    assert len(list(streamed.motion.trajectory)) > 10 > len(list(plan.motion.trajectory))
    ours, theirs = (np.concatenate([b.counts for b in made.commands]) for made in (plan, streamed))
    np.testing.assert_array_equal(ours, theirs)
    labels = [np.concatenate([b.operation for b in made.commands]) for made in (plan, streamed)]
    np.testing.assert_array_equal(*labels)
    for one, other in zip(plan.motion.demands, streamed.motion.demands, strict=True):
        assert one.current_a == pytest.approx(other.current_a, rel=1e-9)


def test_travel_starts_and_ends_at_rest(plan):
    """The head rests at the first point of the seam, and at the end of the plan."""
    sew = next(e for b in plan.commands for e in b.events if e.name == "sew")
    at = np.array([sew.tick * 1e-3])
    np.testing.assert_allclose(plan.motion.trajectory(at)[0], [0.01, 0.005], atol=1e-9)
    np.testing.assert_allclose(plan.motion.trajectory(at, 1), 0.0, atol=1e-9)
    end = plan.motion.trajectory.duration_s
    np.testing.assert_allclose(
        plan.motion.trajectory(np.array([end]))[0], [0.05064, 0.04564], atol=1e-12
    )


def test_rapid_moves_stay_within_the_current(machine):
    """The quintic's current by the rigid model at 1000 instants, and its closed-form speed."""
    way = np.array([[0.1, 0.0], [0.0, 0.05], [1e-4, 0.0]])
    time = rapid_time_s(way, ("X", "Y"), machine)
    u = np.linspace(0, 1, 1001)
    for (x, y), t in zip(way, time, strict=True):
        axis, d = ("X", x) if x else ("Y", y)
        speed = d * 30 * u**2 * (1 - u) ** 2 / t
        slope = d * 60 * u * (1 - u) * (1 - 2 * u) / t**2
        current = [current_needed(machine, axis, v, a) for v, a in zip(speed, slope, strict=True)]
        share = np.abs(current).max() / 27
        assert share < 0.801
        full = speed.max() > 0.999 * machine.axes[axis].velocity.si
        jerk = 60 * d / t**3 > 0.999 * 27736.8
        assert share > 0.79 or full or jerk or np.abs(slope).max() > 27.7
    free = replace(
        machine,
        drives={
            n: replace(d, amplifier=replace(d.amplifier, current_limit=None))
            for n, d in machine.drives.items()
        },
    )
    assert rapid_time_s(np.array([[0.5, 0.0]]), ("X", "Y"), free)[0] == pytest.approx(
        1.875 * 0.5 / 0.19812
    )


def test_every_end_of_the_tolerances_is_tried(machine, seam, monkeypatch):
    """Plans are made for the file; the sewing machines' masses and stiffnesses are at the ends."""
    seen = []

    def search(asked, grid):
        assert asked.machine is machine and asked.options is AHEAD
        actual = asked.actual
        seen.append(
            (actual.bodies["y_head"].inertia.si / 70, actual.links["y_belt"].stiffness.si / 1e6)
        )
        return Fastest(intervals=(), limited_by="x", verdict=None, tried=1)

    spec, job = load_spec(PLACE, machine), open_job(seam, machine, AHEAD)
    asked = Question(job=job, machine=machine, spec=spec, options=AHEAD, high=78.0)
    cells = mismatch.at_tolerance_ends(asked, lambda one: speeds(search(one, COARSE)))
    expected = [(m, k) for m in (0.9, 1.0, 1.1) for k in (0.8, 1.0, 1.2)]
    np.testing.assert_allclose(seen, expected)
    np.testing.assert_allclose([(c.mass, c.stiffness) for c in cells],
                               [(m, k) for m in (-1, 0, 1) for k in (-1, 0, 1)])  # fmt: skip


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(list(arguments))
    out = capsys.readouterr()
    return stopped.value.code or 0, out.out, out.err


def test_prove_says_what_the_drives_must_give(capsys, seam):
    code, out, _ = run(
        capsys, "prove", str(seam), "-m", "stitcher", "-s", str(PLACE), "--feed-forward", "--json"
    )
    content = json.loads(out)
    assert code == 0 and content["interpolation"] == "auto"
    assert [d["axis"] for d in content["feed_forward"]] == ["X", "Y"]
    assert content["options"]["feed-forward"] == "0.04 s"
    names = [c["name"] for c in content["criteria"]]
    assert "shaping_deviation" in names
    smoothing = next(c for c in content["criteria"] if c["name"] == "shaping_deviation")
    # At a cut corner a quarter of the speed is left, as in the test of the verdict.
    assert smoothing["measured"] == pytest.approx(0.13e-3, abs=30e-6)


def test_titles_say_what_was_asked_for(capsys, proof, tmp_path, monkeypatch):
    blank_pictures(monkeypatch)
    show_proof(proof)
    out = capsys.readouterr().out
    assert "corner.seam.toml on stitcher, auto, feed-forward" in out
    page = write_report(report_data(proof), tmp_path / "report").read_text(encoding="utf-8")
    assert "interpolation auto, feed-forward, feed programmed" in page
    assert "chords" not in out
    assert "interpolation chords" not in page


def test_the_motion_is_told_apart_from_the_table(proof, plan):
    """The loads stand outside the printed span, and move half a width inside it."""
    content = verdict_json(proof.verdict, plan)
    begin, end = content["motion"]["begin_s"], content["motion"]["end_s"]
    assert content["motion"]["duration_s"] == end - begin
    speed = np.abs(plan.motion.trajectory(np.array([begin - 1e-6, end + 2e-3]), 1))
    assert speed.max() == 0.0
    speed = np.abs(
        plan.motion.trajectory(np.array([begin, end]) + WIDTH_S * np.array([0.5, -0.5]), 1)
    )
    assert speed.max(axis=1).min() > 1e-4
    # A seam of 32 stitches takes about half a second; the frame of the stitcher rings for longer.
    assert 0.4 < end - begin < 0.8 < content["duration_s"] - end
    (line,) = motion_lines(plan)
    assert f"{end - begin:.4g} s, from {begin:.3f} s to {end:.3f} s" in line
    assert f"table of {content['duration_s']:.4g} s" in line


def test_mistakes_are_said(capsys, seam, tmp_path):
    code, _, err = run(capsys, "prove", str(seam), "-m", "stitcher", "--smoothing", "40 ms")
    assert code == 2 and "Give --feed-forward too" in err
    code, _, err = run(
        capsys, "prove", str(seam), "-m", "stitcher", "--feed-forward", "--smoothing", "40 mm"
    )
    assert code == 2 and 'Write it like "36 ms"' in err
    out = tmp_path / "seam.nc"
    code, _, err = run(
        capsys, "compile", str(seam), "-m", "stitcher", "--feed-forward", "--target", "nc",
        "-o", str(out),
    )  # fmt: skip
    assert code == 2 and "a reference for every tick" in err and not out.exists()
    table = tmp_path / "seam.csv"
    code, _, _ = run(
        capsys, "compile", str(seam), "-m", "stitcher", "--feed-forward", "--target", "csv",
        "-o", str(table),
    )  # fmt: skip
    assert code == 0 and table.exists()


def test_a_trace_of_another_controller_is_judged_against_the_table_it_ran(capsys, seam, tmp_path):
    """The controller played the feed-forward table without knowing its purpose: same verdict."""
    trace, npz = tmp_path / "trace.csv", tmp_path / "run.npz"
    proving = ("prove", str(seam), "-m", "stitcher", "--feed-forward", "--nominal", "--json")
    _, out, _ = run(capsys, *proving, "--recording", str(npz))
    proved = {(c["name"], c["axis"]): c for c in json.loads(out)["criteria"]}
    recording = read_recording(npz)
    times, x = recording.samples("X.load")
    _, y = recording.samples("Y.load")
    lines = ["time [s];X.load [mm];Y.load [mm]"]
    rows = zip(times, 1e3 * x, 1e3 * y, strict=True)
    lines += [f"{t:.6f};{a:.7f};{b:.7f}" for t, a, b in rows]
    trace.write_text("\n".join(lines) + "\n")
    judging = ("judge", str(trace), "--job", str(seam), "-m", "stitcher")
    _, out, _ = run(capsys, *judging, "--feed-forward", "--json")
    found = {(c["name"], c["axis"]): c for c in json.loads(out)["criteria"]}
    for key in (("stitch_length_error", ""), ("shaping_deviation", "")):
        assert found[key]["measured"] == pytest.approx(proved[key]["measured"], rel=1e-3)
    code, _, err = run(capsys, *judging, "--smoothing", "40 ms")
    assert code == 2 and "--smoothing needs --feed-forward" in err


def test_a_machine_without_controllers_is_told_so(examples: Path) -> None:
    """Feed-forward needs the references of a controller, which a stepper does not have."""
    machine = load_machine("stepper-winder")
    job = read_job(examples / "x-180.prg", machine)
    with pytest.raises(OptionError, match=r"--feed-forward .* stepper-winder has none: drives"):
        plan_job(job, machine, Options(feed_forward_s=0.02))
