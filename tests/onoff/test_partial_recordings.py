"""Cycles that were recorded in part, or by hand: measured and not measured results."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.onoff.cycles import TRIMMED, altered, run
from threadline.dynamics.pneumatic import step_ringing
from threadline.errors import RecordingError
from threadline.files import Recording, RecordingBlock, Stream
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, plan_job, prove, prove_plan
from threadline.verdict import Criterion, Status, judge, load_spec
from threadline.verdict.switch_run import SwitchRun


def test_a_table_made_by_hand_is_judged_as_the_recording_is(
    cycle: Path, shaped: Proof, tmp_path: Path
) -> None:
    """Outputs, an input and frames as columns of a spreadsheet: the result equals the proof."""
    switched = shaped.plan.commands.outputs
    samples = shaped.recording.samples_of([*switched, "x_is_left", "X.frame", "Z.frame"])
    columns = {f"{name}.output": samples[name][1] for name in switched}
    columns["x_is_left.input"] = samples["x_is_left"][1]
    for axis in "XZ":
        columns[f"{axis}.frame [um]"] = 1e6 * samples[f"{axis}.frame"][1]
    times_s, _ = samples["X.frame"]
    trace = tmp_path / "trace.csv"
    table = np.column_stack([times_s, *columns.values()])
    head = ";".join(["time [s]", *columns])
    np.savetxt(trace, table, fmt="%.6g", delimiter=";", header=head, comments="")
    words = ["judge", str(trace), "--job", str(cycle), "-m", TRIMMED, "--json"]
    code, text = run(*words, "--shaper", "zv")
    assert code == 0
    found = {(c["name"], c["axis"], c.get("step")): c for c in json.loads(text)["criteria"]}
    for result in shaped.verdict.results:
        if result.name in ("residual_vibration", "cycle_time", "switching_order"):
            made = found[result.name, result.axis, result.step or None]
            assert made["measured"] == pytest.approx(result.measured, abs=1e-8), result
    code, text = run(*words)  # a plan without the shaper is not the plan of this run
    assert code == 1
    criteria = json.loads(text)["criteria"]
    assert [c["name"] for c in criteria if c["status"] == "failed"] == ["switching_order"]


def test_cycle_time_is_not_measured_without_the_last_contact(
    shaped: Proof,
) -> None:
    """The last switching begins the way back; the cycle ends when x_is_left turns on."""
    criterion = Criterion(name="cycle_time", limit=1e3, required=True)
    spec = replace(shaped.spec, criteria=(criterion,))
    assert judge([shaped.recording], shaped.plan, spec).passed

    bare = [c for c in shaped.recording.channels if c.name != "x_is_left"]
    without = judge([replace(shaped.recording, channels=tuple(bare))], shaped.plan, spec)
    assert without.result("cycle_time").status is Status.NOT_MEASURED
    assert "no input channel x_is_left" in without.result("cycle_time").note
    assert not without.passed

    def never(samples: dict[str, Any]) -> None:
        samples["x_is_left"][len(samples["x_is_left"]) // 2 :] = 0.0

    held = judge([altered(shaped.recording, never)], shaped.plan, spec).result("cycle_time")
    assert held.status is Status.NOT_MEASURED
    assert "ends while the cycle waits for x_is_left" in held.note


def test_frames_and_pistons_without_a_sample_are_not_measured(shaped: Proof) -> None:
    """A channel that is named and empty counts as missing."""

    def empty(samples: dict[str, Any]) -> None:
        samples["Z.frame"] = samples["Z.load"] = np.empty(0)

    verdict = judge([altered(shaped.recording, empty)], shaped.plan, shaped.spec)
    for name in ("residual_vibration", "end_position_error", "travel"):
        assert verdict.result(name, "Z").status is Status.NOT_MEASURED
        assert verdict.result(name, "X").status is not Status.NOT_MEASURED
    assert verdict.result("settling_time").status is Status.NOT_MEASURED


def cut(recording: Recording, name: str, begin: int, end: int) -> Recording:
    """Return a recording in three blocks; in the second one a channel has no samples."""
    (whole,) = recording

    def part(first: int, last: int | None, *, without: bool) -> RecordingBlock:
        samples = {k: v[first:last] for k, v in whole.samples.items()}
        if without:
            samples = {k: v[:0] if name in (k, "") else v for k, v in samples.items()}
        return RecordingBlock(first_tick={"twin": first}, samples=samples)

    blocks = [
        part(0, begin, without=False),
        part(begin, end, without=True),
        part(end, None, without=False),
    ]
    return replace(recording, blocks=Stream.of(blocks))


@pytest.mark.parametrize("axis", ["X", "Z"])
def test_ringing_that_was_cut_out_is_not_measured(shaped: Proof, axis: str) -> None:
    """3 mm at 3 Hz on one frame for 0.2 s, which are cut out of its channel, or of all channels."""
    run = SwitchRun(shaped.recording, shaped.plan)
    step = max(run.steps, key=lambda s: np.subtract(*run.quiet_s(s, axis)[::-1]))
    begin = round(1e3 * run.quiet_s(step, axis)[0]) + 50
    end = begin + 200

    def ring(samples: dict[str, Any]) -> None:
        time = np.arange(end - begin) * 1e-3
        samples[f"{axis}.frame"][begin:end] += 3e-3 * np.sin(2 * np.pi * 3.0 * time)

    ringing = altered(shaped.recording, ring)
    assert not judge([ringing], shaped.plan, shaped.spec).passed
    verdict = judge([cut(ringing, f"{axis}.frame", begin, end)], shaped.plan, shaped.spec)
    other = "Z" if axis == "X" else "X"
    found = [r for r in verdict.results if r.name == "residual_vibration"]
    assert {r.status for r in found if r.axis == axis} == {Status.NOT_MEASURED}
    assert all(f"{axis}.frame has no samples from" in r.note for r in found if r.axis == axis)
    assert Status.PASSED in {r.status for r in found if r.axis == other}
    assert verdict.result("settling_time").status is Status.NOT_MEASURED

    with pytest.raises(RecordingError, match=r"has no samples from .*when the valves switched"):
        judge([cut(ringing, "", begin, end)], shaped.plan, shaped.spec)


def test_blocks_of_a_cycle_that_go_back_are_refused(shaped: Proof) -> None:
    (block,) = altered(shaped.recording, lambda samples: None)
    again = RecordingBlock(first_tick={"twin": 100}, samples=block.samples)
    with pytest.raises(RecordingError, match=r"begins at 0\.1 s, and the blocks before it"):
        judge(
            [replace(shaped.recording, blocks=Stream.of([block, again]))], shaped.plan, shaped.spec
        )
    late = {k: v[4000:] for k, v in block.samples.items()}
    on = next(i for i in range(4000, 9000) if block.samples["z_down"][i])
    late = {k: v[on:] for k, v in block.samples.items()}
    begun = [RecordingBlock(first_tick={"twin": on}, samples=late)]
    with pytest.raises(RecordingError, match=r"begins at .* s, the motion before: nobody knows"):
        judge([replace(shaped.recording, blocks=Stream.of(begun))], shaped.plan, shaped.spec)


@pytest.mark.parametrize("name", ["", "X.frame", "X.load"])
def test_a_recording_that_ends_before_the_cycle_measures_what_it_came_to(
    shaped: Proof, name: str
) -> None:
    """Cut 0.1 s before its end: the last step of X is unknown, the steps before it are not."""
    run = SwitchRun(shaped.recording, shaped.plan)
    count = round(1e3 * (run.end_s - 0.1))

    def shorter(samples: dict[str, Any]) -> None:
        for key in samples:
            if name in (key, ""):
                samples[key] = samples[key][:count]

    verdict = judge([altered(shaped.recording, shorter)], shaped.plan, shaped.spec)
    whole = judge([shaped.recording], shaped.plan, shaped.spec)
    assert all(r.status is not Status.FAILED for r in verdict.results)
    gone = [
        (a.name, a.axis, a.step)
        for a, b in zip(verdict.results, whole.results, strict=True)
        if a.status is Status.NOT_MEASURED and b.status is not Status.NOT_MEASURED
    ]
    assert gone
    expected = {
        "": {"cycle_time", "valve_conflict", "over_level", "travel"},
        "X.frame": {"residual_vibration", "settling_time"},
        "X.load": {"end_position_error", "travel"},
    }[name]
    assert expected <= {measure for measure, _, _ in gone}
    if name:
        assert {measure for measure, _, _ in gone} == expected
    steps = {step for measure, _, step in gone if measure not in ("travel", "cycle_time")}
    assert len(steps - {""}) == 1 or not name  # only the last of them
    assert "the recording ends at" in next(
        r.note for r in verdict.results if (r.name, r.axis, r.step) == gone[0]
    )


def test_the_travel_of_a_cylinder_is_no_angle(shaped: Proof) -> None:
    """A frame that is said to turn by 5 mrad would pass for one that moves by 5 mm."""
    turned = replace(
        shaped.recording,
        channels=tuple(
            replace(c, unit="rad") if c.name == "Z.frame" else c for c in shaped.recording.channels
        ),
    )
    machine = shaped.plan.machine
    with pytest.raises(RecordingError, match=r"'Z.frame' is in rad.*Z of .* is linear.*mm"):
        judge([turned], shaped.plan, load_spec(None, machine))


def test_the_end_of_a_move_is_looked_at_before_its_step_moves_on(tmp_path: Path) -> None:
    """One step goes down and up again: neither end is missed by the other's 30 mm."""
    machine = load_machine("letter-placer")
    file = tmp_path / "dip.toml"
    file.write_text(
        '[[operation]]\nvalve = "main_air"\n[[operation]]\nstep = "dip"\nmove = { Z = "30 mm" }\n'
        '[[operation]]\ndwell = "200 ms"\n[[operation]]\nmove = { Z = "0 mm" }\n',
        encoding="utf-8",
    )
    proof = prove(file, machine, load_spec(None, machine), Options())
    found = [r.measured for r in proof.verdict.results if r.name == "end_position_error"]
    assert found
    assert max(value for value in found if value is not None) < 0.002


MEASURED = "residual_vibration"
PICK = """
[[operation]]
step = "start"
valve = "main_air"

[[operation]]
step = "out"
move = { X = "200 mm" }

[[operation]]
wait = "x_is_right"

[[operation]]
step = "there"
dwell = "LASTS ms"

[[operation]]
step = "back"
move = { X = "0 mm" }
"""


def of_pick(folder: Path, lasts_ms: int, rest: str = "", shaper: str = "none") -> Proof:
    machine = load_machine("letter-placer+whole-scans+own-damping")
    text = PICK.replace("LASTS", str(lasts_ms))
    file = folder / "pick.toml"
    file.write_text(text.replace('"200 mm" }\n', f'"200 mm" }}\n{rest}'), encoding="utf-8")
    plan = plan_job(read_job(file, machine), machine, Options(shaper=shaper))
    return prove_plan(plan, load_spec(None, machine))


@pytest.mark.parametrize("shaper", ["none", "um-zv"])
def test_ringing_is_measured_even_if_the_cylinder_moves_again_soon(
    shaper: str, tmp_path: Path
) -> None:
    """By place and speed in 20 ms, against half the peak-to-peak of a second: 3 % and 8 um.

    A piston at rest still has 2 % of its speed, and its braking pushes the frame by 17 um at most.
    A live machine may wait there for an input that comes at once on the simulated one.
    """

    def out_of(proof: Proof) -> float:
        (found,) = [
            r for r in proof.verdict.results if (r.name, r.axis, r.step) == (MEASURED, "X", "out")
        ]
        assert found.measured is not None
        return found.measured

    soon, later = of_pick(tmp_path, 10, "", shaper), of_pick(tmp_path, 1000, "", shaper)
    assert out_of(later) > 3e-5
    assert out_of(soon) == pytest.approx(out_of(later), rel=0.03, abs=8e-6)
    notes = [r.note for r in soon.verdict.results if (r.name, r.step) == (MEASURED, "out")]
    assert any("by its place and speed" in note for note in notes)


def test_required_criterion_that_cannot_be_measured_is_not_proven(tmp_path: Path) -> None:
    """X goes back before it has come to rest, so its ringing is unknown."""
    proof = of_pick(tmp_path, 10, 'rest = "100 ms"\n', "zv")
    results = [
        r for r in proof.verdict.results if (r.name, r.axis, r.step) == (MEASURED, "X", "out")
    ]
    assert [r.status for r in results] == [Status.NOT_MEASURED]
    assert results[0].note == "it moves again before it has come to rest"
    assert results[0].required
    assert not proof.verdict.passed


def seldom(recording: Recording, name: str, count: int) -> Recording:
    """Return a recording with each ``count``-th sample of a channel."""
    blocks = list(recording)
    samples = {
        c.name: np.concatenate([block.samples[c.name] for block in blocks])
        for c in recording.channels
    }
    channels = tuple(replace(c, stride=count) if c.name == name else c for c in recording.channels)
    samples[name] = samples[name][::count]
    events = tuple(event for block in blocks for event in block.events)
    block = RecordingBlock(first_tick=blocks[0].first_tick, samples=samples, events=events)
    return replace(recording, channels=channels, blocks=Stream.of([block]))


def test_ringing_counts_by_what_samples_can_miss_of_it(shaped: Proof) -> None:
    """Samples T apart show at least cos(pi T / P) of an amplitude that rings with period P."""
    period_s = 2.0 * np.pi / abs(step_ringing(shaped.plan.machine, "X").pole)
    for count, share in ((60, np.cos(np.pi * 0.06 / period_s)), (200, 0.0)):
        recording = seldom(shaped.recording, "X.frame", count)
        found = [r for r in judge([recording], shaped.plan, shaped.spec).results if r.axis == "X"]
        ringing = [r for r in found if r.name == "residual_vibration" and r.measured is not None]
        if not share:
            assert not ringing
            continue
        worst = max(ringing, key=lambda r: r.measured)
        for room, status in ((1.001, Status.PASSED), (0.999, Status.NOT_MEASURED)):
            limit = room * worst.measured / share
            asked = replace(
                shaped.spec,
                criteria=(
                    Criterion(name="residual_vibration", axis="X", step=worst.step, limit=limit),
                ),
            )
            (again,) = judge([recording], shaped.plan, asked).results
            assert again.status is status
            if status is Status.NOT_MEASURED:
                assert f"with a period of {1e3 * period_s:.4g} ms" in again.note


def test_samples_seldom_settle_later(shaped: Proof) -> None:
    """A frame whose samples are in the band may leave it between them."""
    often = judge([shaped.recording], shaped.plan, shaped.spec).result("settling_time")
    recording = seldom(shaped.recording, "X.frame", 120)
    rare = judge([recording], shaped.plan, shaped.spec).result("settling_time")
    assert rare.measured > often.measured
    recording = seldom(shaped.recording, "X.frame", 200)
    limited = replace(shaped.spec, criteria=(Criterion(name="settling_time", limit=10.0),))
    assert judge([shaped.recording], shaped.plan, limited).passed
    assert judge([recording], shaped.plan, limited).result("settling_time").status is (
        Status.NOT_MEASURED
    )
