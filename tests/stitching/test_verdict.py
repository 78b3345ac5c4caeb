"""The verdict on a recording of a frame names the stitch at fault and passes no missing sample."""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.made import Made
from threadline.errors import RecordingError
from threadline.files import Recording, RecordingBlock, Stream
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, plan_job, prove
from threadline.report.proof import write_report
from threadline.report.stitched import design_figure
from threadline.search.report_data import report_data
from threadline.verdict import Status, judge, load_spec

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
MACHINE = load_machine("schiffli-frame")
SPEC = load_spec(None, MACHINE)


@cache
def proof() -> Proof:
    return prove(EXAMPLES / "rosette.dst", MACHINE, SPEC, Options())


def changed(change) -> Recording:
    """Return the recording with the samples of each block changed."""
    recording = proof().recording

    def blocks():
        for block in recording:
            yield RecordingBlock(
                first_tick=block.first_tick,
                samples=change({k: v.copy() for k, v in block.samples.items()}, block),
                events=block.events,
            )

    return replace(recording, blocks=Made(blocks))


def test_the_stitch_that_is_off_is_named() -> None:
    """The test pushes the frame by 0.3 mm only while the needle is in for the 100th time."""
    plan = proof().plan
    turn = int(np.flatnonzero(plan.stitched.turns.moves.needle)[99])
    when = plan.stitched.turns.begin[turn] / 16e6

    def push(samples, block):
        first = block.first_tick["servo"]
        times = (first + np.arange(len(samples["needle"]))) * 1e-3
        samples["Y.load"][(times > when + 0.3) & (times < when + 0.31)] += 3e-4
        return samples

    verdict = judge([changed(push)], plan, SPEC)
    found = verdict.result("stitch_residual", "Y")
    assert found.status is Status.FAILED
    assert found.note.startswith(
        "block 1, stitch 100; 1 of 185 stitches beyond 0.1 mm on an axis; alone it"
    )
    assert found.job_line == plan.stitched.turns.line[turn]
    assert 3e-4 - 1e-4 < found.measured < 3e-4 + 1e-4
    assert verdict.result("stitch_residual", "X").status is Status.PASSED


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("far_s", [0.0, 0.3])
def test_a_sample_that_cannot_be_is_refused_wherever_it_lies(value: float, far_s: float) -> None:
    """A bad sample that judges no stitch was once passed over, on frames and on placers."""
    plan = proof().plan
    turn = int(np.flatnonzero(plan.stitched.turns.moves.needle)[99])
    when = plan.stitched.turns.begin[turn] / 16e6

    def spoil(samples, block):
        times = (block.first_tick["servo"] + np.arange(len(samples["needle"]))) * 1e-3
        samples["Y.load"][(times > when + far_s) & (times < when + far_s + 0.0015)] = value
        return samples

    with pytest.raises(RecordingError, match=r"channel 'Y\.load' ha|channel 'Y\.load' holds"):
        judge([changed(spoil)], plan, SPEC)


def test_a_stitch_is_out_where_either_axis_is() -> None:
    """Two stitches are off in X and two in Y, one of them in both, so three are out."""
    plan = proof().plan
    turns = np.flatnonzero(plan.stitched.turns.moves.needle)
    off = {"X.load": (20, 40), "Y.load": (40, 60)}

    def push(samples, block):
        times = (block.first_tick["servo"] + np.arange(len(samples["needle"]))) * 1e-3
        for name, stitches in off.items():
            for stitch in stitches:
                when = plan.stitched.turns.begin[turns[stitch]] / 16e6
                samples[name][(times > when + 0.3) & (times < when + 0.31)] += 4e-4
        return samples

    verdict = judge([changed(push)], plan, SPEC)
    for axis in "XY":
        assert "3 of 185 stitches" in verdict.result("stitch_residual", axis).note


def test_the_picture_draws_the_way_of_every_stitch() -> None:
    """It draws stitches out of spec too, each with a cross, and it draws travel."""
    fast = prove(
        EXAMPLES / "rosette.dst", MACHINE, SPEC, Options(feed=parse_feed("120 stitch/min"))
    )
    turns = fast.plan.stitched.turns
    panel = design_figure(fast, fast.recording).axes[0]
    assert sum(len(drawn.get_segments()) for drawn in panel.collections) == len(turns)
    crosses = max(len(line.get_xdata()) for line in panel.lines)
    count = int(fast.verdict.result("stitch_residual", "X").note.split("; ")[1].split()[0])
    assert crosses == count > 100


def test_every_stitch_is_a_row_of_a_table(tmp_path: Path) -> None:
    """The worst rows of the table are the stitches that the verdict names."""
    write_report(report_data(proof()), tmp_path)
    with (tmp_path / "report-stitches.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    verdict, turns = proof().verdict, proof().plan.stitched.turns
    assert [int(row["stitch"]) for row in rows] == list(range(1, 186))
    assert [int(row["block"]) for row in rows] == turns.block[turns.stitch > 0].tolist()
    for axis in "XY":
        for name, scale in (("stitch_residual {} [mm]", 1e-3), ("servo_force {}", 1.0)):
            worst = max(rows, key=lambda row: float(row[name.format(axis)]))
            found = verdict.result(name.split()[0], axis)
            reported = float(worst[name.format(axis)]) * scale
            assert reported == pytest.approx(found.measured, rel=1e-5)
            assert found.note.startswith(f"block {worst['block']}, stitch {worst['stitch']}")
            assert int(worst["record"]) == found.job_line
        moves = np.diff([float(row[f"{axis} [mm]"]) for row in rows])
        sewn = [float(row[f"move {axis} [mm]"]) for row in rows[1:]]
        # Between two blocks the frame travels: a turn without a stitch.
        assert np.isclose(moves, sewn, atol=1e-6).sum() >= len(sewn) - 1
    used = max(float(row["window_use"]) for row in rows)
    # The largest of all may be a travel's; the table has five digits.
    assert 0.3 < used <= verdict.result("window_use").measured * (1.0 + 1e-5)
    slow = [row for row in rows if float(row["alone it can at [stitch/min]"]) < 60.0]
    # Cancelling swings let these stitches be faster than alone, but slower than the usual one.
    speeds = [float(row["speed [stitch/min]"]) for row in rows]
    assert slow
    assert max(float(row["speed [stitch/min]"]) for row in slow) < np.median(speeds)


def test_a_frame_that_is_off_while_the_needle_is_up_sews_well() -> None:
    def wander(samples, block):
        samples["X.load"][samples["needle"] == 0] += 5e-3
        return samples

    verdict = judge([changed(wander)], proof().plan, SPEC)
    before = proof().verdict.result("stitch_residual", "X").measured
    assert verdict.result("stitch_residual", "X").measured == before


def test_a_stitch_too_few_passes_nothing_that_it_measures() -> None:
    def blunt(samples, block):
        if block.first_tick["servo"] == 0:
            samples["needle"][:5000] = 0.0
        return samples

    verdict = judge([changed(blunt)], proof().plan, SPEC)
    for axis in "XY":
        found = verdict.result("stitch_residual", axis)
        assert found.status is not Status.PASSED
        assert "needle entered" in found.note
    assert not verdict.passed


def test_without_a_needle_or_a_load_nothing_is_measured() -> None:
    recording = proof().recording
    for name in ("needle", "X.load"):
        channels = tuple(c for c in recording.channels if c.name != name)
        verdict = judge([replace(recording, channels=channels)], proof().plan, SPEC)
        found = verdict.result("stitch_residual", "X")
        assert found.status is Status.NOT_MEASURED
        assert not verdict.passed


@pytest.mark.parametrize("name", ["needle", "Y.load", "X.torque_share"])
def test_a_channel_that_is_lost_for_a_while_hides_no_stitch(name: str) -> None:
    """The load is 3 mm off during the 100th stay of the needle, while one channel is lost.

    Once, without the needle's samples, the stay went on behind the gap and all stitches passed.
    """
    recording, plan = proof().recording, proof().plan
    turn = int(np.flatnonzero(plan.stitched.turns.moves.needle)[99])
    off = round(plan.stitched.turns.begin[turn] / 16e6 / 1e-3) + 300
    blocks = list(recording)
    whole = {
        c.name: np.concatenate([b.samples[c.name] for b in blocks]) for c in recording.channels
    }
    assert (whole["needle"][off - 5 : off + 15] != 0).all()
    whole["Y.load"][off : off + 10] += 3e-3
    cut = [
        RecordingBlock(
            first_tick={"servo": begin},
            samples={
                c: v[begin:begin] if lost and c == name else v[begin:end] for c, v in whole.items()
            },
        )
        for begin, end, lost in (
            (0, off - 5, False),
            (off - 5, off + 15, True),
            (off + 15, len(whole["needle"]), False),
        )
    ]
    verdict = judge([replace(recording, blocks=Made(lambda: iter(cut)))], plan, SPEC)
    found = verdict.result("stitch_residual", "Y")
    assert found.status is not Status.PASSED
    assert not verdict.passed
    if name != "X.torque_share":
        assert f"{name} has no samples from" in found.note


def test_channels_of_other_instants_than_the_needle_are_not_measured() -> None:
    recording = proof().recording
    channels = tuple(replace(c, stride=2) if c.name == "X.load" else c for c in recording.channels)
    verdict = judge([replace(recording, channels=channels)], proof().plan, SPEC)
    found = verdict.result("stitch_residual", "X")
    assert found.status is Status.NOT_MEASURED
    assert found.note.startswith("X.load and needle are not of the same instants")


def every(count: int, bump_m: float) -> Recording:
    """Return each ``count``-th sample; a motion of Y that is 0 at each 40th sample is added."""
    recording = proof().recording
    blocks = list(recording)
    samples = {
        c.name: np.concatenate([block.samples[c.name] for block in blocks])
        for c in recording.channels
    }
    length = len(samples["Y.load"])
    samples["Y.load"] = samples["Y.load"] + bump_m * np.sin(np.pi * np.arange(length) / 40) ** 2
    block = RecordingBlock(
        first_tick={name: 0 for name in blocks[0].first_tick},
        samples={name: values[::count] for name, values in samples.items()},
    )
    channels = tuple(replace(c, stride=count) for c in recording.channels)
    return replace(recording, channels=channels, blocks=Stream.of([block]))


@pytest.mark.parametrize("bump_m", [0.0, 5e-3])
def test_samples_far_apart_do_not_show_where_the_frame_stood(bump_m: float) -> None:
    """A frame that brakes at a = 6.33 m/s^2 is a T^2 / 2 from its place at a time T before."""
    verdict = judge([every(40, bump_m)], proof().plan, SPEC)
    found = verdict.result("stitch_residual", "Y")
    assert found.status is Status.NOT_MEASURED
    assert "Y.load has a sample every 40 ms: " in found.note
    assert "5.064 mm farther away, at the 6.33 m/s^2 of the machine file" in found.note
    assert judge([every(1, bump_m)], proof().plan, SPEC).passed is (bump_m == 0.0)


def test_a_measured_run_with_a_sample_each_millisecond_proves_the_stitches() -> None:
    measured = replace(every(1, 0.0), simulated=False)
    found = judge([measured], proof().plan, SPEC).result("stitch_residual", "Y")
    assert found.status is Status.PASSED
    tight = replace(
        SPEC,
        criteria=tuple(
            replace(c, limit=found.measured + 3e-6) if c.name == "stitch_residual" else c
            for c in SPEC.criteria
        ),
    )
    found = judge([measured], proof().plan, tight).result("stitch_residual", "Y")
    assert found.status is Status.NOT_MEASURED


def test_move_too_long_for_its_window_fails_with_a_speed_that_suffices() -> None:
    """At full speed with half of the acceleration, 16.5 mm need 1.414 times the window."""
    soft = load_machine("schiffli-frame")
    axes = {
        name: replace(axis, acceleration=replace(axis.acceleration, si=3.165))
        for name, axis in soft.axes.items()
    }
    soft = replace(soft, axes=axes, sha256="soft")
    options = Options(feed=parse_feed("166.66666 stitch/min"))
    plan = plan_job(read_job(EXAMPLES / "rosette.dst", soft), soft, options)
    from threadline.verdict.stitch_run import measure_tables

    (found,) = measure_tables(plan)["window_use"]
    assert found.value == pytest.approx(np.sqrt(2.0), rel=1e-3)
    # Half of the acceleration is enough for half of the length: 8.25 mm.
    long = int((np.abs(plan.stitched.turns.moves.units).max(axis=1) > 82).sum())
    assert found.note == (
        f"block 2, stitch 172; {long} of 186 turns; it can at 117.8 stitches a minute"
    )


@pytest.mark.parametrize(
    "reference",
    ["table-embroiderer", "schiffli-frame+fifteen-yards", "schiffli-frame+ten-yards"],
)
def test_every_machine_sews_the_example(reference: str) -> None:
    machine = load_machine(reference)
    found = prove(EXAMPLES / "rosette.dst", machine, load_spec(None, machine), Options())
    assert found.verdict.passed
    fastest = 60.0 / found.plan.stitched.turns.turn_s.min()
    assert fastest <= (1000.0 if reference == "table-embroiderer" else 166.67) * (1 + 1e-4)
