"""``prove`` and ``judge`` of a move list: every step is measured, and valve limits are kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.onoff.cycles import TRIMMED, altered, run
from threadline.cli.prove import show_proof
from threadline.dynamics.pneumatic import step_ringing
from threadline.errors import OptionError, RecordingError, SpecError
from threadline.files import SwitchSchedule
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, plan_job
from threadline.report.lines import shaping_rows
from threadline.twin.switching import SwitchOptions, ringing_m, simulate_switching
from threadline.verdict import Status, judge, load_spec, verdict_json


def until(commands: SwitchSchedule, tick: int) -> SwitchSchedule:
    """Return the beginning of a schedule."""
    count = int(np.searchsorted(commands.ticks, tick))
    return replace(
        commands,
        ticks=commands.ticks[:count],
        levels=commands.levels[:count],
        operation=commands.operation[:count],
        duration_ticks=tick,
        events=tuple(e for e in commands.events if e.tick < tick),
    )


def test_shaped_cycle_is_in_spec_and_the_unshaped_and_the_misread_one_are_not(
    cycle: Path, tmp_path: Path
) -> None:
    """Exit status 0 and 1; a written recording is judged the same."""
    trace = tmp_path / "run.npz"
    words = ["prove", str(cycle), "-m", TRIMMED, "--json", "--nominal"]
    code, text = run(*words, "--shaper", "zv", "--recording", str(trace))
    proof = json.loads(text)
    assert (code, proof["passed"], proof["ticks"]) == (0, True, None)
    code, text = run("judge", str(trace), "--json")
    again = json.loads(text)
    assert code == 0
    assert again["criteria"] == proof["criteria"]
    code, text = run(*words)
    assert (code, json.loads(text)["passed"]) == (1, False)
    misread = ["prove", str(cycle), "-m", "letter-placer+whole-scans", "--json"]
    code, text = run(*misread, "--shaper", "zv:3.04Hz:0.17")
    rows = {(c["axis"], c.get("step")): c for c in json.loads(text)["criteria"]
            if c["name"] == "residual_vibration"}  # fmt: skip
    assert code == 1
    assert rows["X", "across"]["status"] == "failed"
    # By the facts, 24.7 % of the unshaped stroke's ringing; whole scans and lag change it a little.
    unshaped = json.loads(run(*misread)[1])["criteria"]
    (other,) = [c for c in unshaped if (c["axis"], c.get("step")) == ("X", "across")
                and c["name"] == "residual_vibration"]  # fmt: skip
    assert rows["X", "across"]["measured"] / other["measured"] == pytest.approx(0.247, abs=0.02)


def test_residual_of_a_step_is_the_ringing_that_a_fit_finds(shaped: Proof) -> None:
    """The frame's amplitude after "across" by a fitted sine, without the later steps.

    Half the peak-to-peak of a window contains the rest of the motion, too: 15 % and 2 um.
    """
    machine, commands = shaped.plan.machine, shaped.plan.commands
    (end,) = [e.tick for e in commands.events if e.name == "leave"]
    single = simulate_switching(until(commands, end), machine, SwitchOptions(after_s=1.2))
    pole = step_ringing(machine, "X").pole
    expected = ringing_m(single, "X", end * 0.01, pole)
    result = next(
        r
        for r in shaped.verdict.results
        if (r.name, r.axis, r.step) == ("residual_vibration", "X", "across")
    )
    assert result.measured is not None
    assert expected > 5e-6
    assert result.measured == pytest.approx(expected, rel=0.15, abs=2e-6)


def test_a_bare_shaper_says_for_which_mode_it_was_made(
    shaped: Proof, capsys: pytest.CaptureFixture[str]
) -> None:
    """The machine's own pole under each cylinder; JSON has it in full."""
    content = verdict_json(shaped.verdict, shaped.plan)["shaping"]
    assert list(content) == ["X", "Z"]
    show_proof(shaped)
    printed = capsys.readouterr().out
    for axis, message in content.items():
        pole = step_ringing(shaped.plan.machine, axis).pole
        ratio = -pole.real / abs(pole)
        (mode,) = message["modes"]
        assert message["shaper"] == "zv"
        assert mode["frequency_hz"] == pytest.approx(abs(pole) / (2 * np.pi), rel=1e-12)
        assert mode["damping_ratio"] == pytest.approx(ratio, rel=1e-12)
        words = f"zv for {abs(pole) / (2 * np.pi):.4g} Hz, damping ratio {ratio:.4g}"
        assert f"Cylinder {axis}:           shaped by {words}" in printed
    machine = shaped.plan.machine
    plan = plan_job(shaped.plan.job, machine, Options(shaper="X=um-zv:3Hz:0.1, Z=none"))
    assert shaping_rows(plan) == [
        ["X", "shaped by um-zv for 3 Hz, damping ratio 0.1"], ["Z", "unshaped"]
    ]  # fmt: skip
    plain = plan_job(shaped.plan.job, machine, Options())
    assert shaping_rows(plain) == []
    assert "shaping" not in verdict_json(shaped.verdict, plain)


def test_steps_are_told_with_their_lines(shaped: Proof, cycle: Path) -> None:
    lines = cycle.read_text().splitlines()
    rows = [r for r in shaped.verdict.results if r.name == "residual_vibration" and r.axis == "Z"]
    assert [r.step for r in rows] == [
        "start", "descend", "cut", "lift", "across", "leave", "mount", "return",
    ]  # fmt: skip
    for row in rows:
        assert row.job_line is not None
        assert lines[row.job_line - 1] == "[[operation]]"
        assert lines[row.job_line] == f'step = "{row.step}"'


def test_every_stroke_ends_where_the_job_says(shaped: Proof) -> None:
    """The last target of X is its start: forward and back again, each within a millimetre."""
    ends = [r for r in shaped.verdict.results if r.name == "end_position_error"]
    assert {r.axis for r in ends} == {"X", "Z"}
    assert len([r for r in ends if r.axis == "X"]) >= 2
    assert all(r.measured is not None and 0.0 <= r.measured < 1e-3 for r in ends)

    def change(samples: dict[str, Any]) -> None:
        samples["X.load"] -= 3e-3

    off = judge([altered(shaped.recording, change)], shaped.plan, shaped.spec)
    found = [r.measured for r in off.results if (r.name, r.axis) == ("end_position_error", "X")]
    assert all(m is not None and abs(m - 3e-3) < 1e-3 for m in found)


def test_cycle_time_is_the_schedule_and_its_waits(shaped: Proof) -> None:
    """No wait is late: 903 scans of 10 ms. Half a second without air in a wait adds as much."""
    measured = shaped.verdict.result("cycle_time").measured
    assert measured == pytest.approx(9.03, abs=1e-9)

    def change(samples: dict[str, Any]) -> None:
        # The scan of the wait for letter_held, at 2.87 s, lasts 500 ms more.
        for name, values in samples.items():
            samples[name] = np.insert(values, np.repeat(2875, 500), values[2875])

    late = judge([altered(shaped.recording, change)], shaped.plan, shaped.spec)
    assert late.result("cycle_time").measured == pytest.approx(9.53, abs=1e-9)
    assert late.result("switching_order").status is Status.PASSED
    found = [r.time_s for r in late.results if (r.name, r.step) == ("residual_vibration", "leave")]
    assert min(t for t in found if t is not None) > 5.23 + 0.5


def test_a_broken_beam_is_no_cycle(shaped: Proof) -> None:
    plan = shaped.plan
    recording = simulate_switching(plan.commands, plan.machine, SwitchOptions(break_s=4.3))
    verdict = judge([recording], plan, shaped.spec)
    order = verdict.result("switching_order")
    assert order.status is Status.FAILED
    assert order.time_s == pytest.approx(4.3, abs=0.0101)
    assert verdict.result("residual_vibration").status is Status.NOT_MEASURED
    assert not verdict.passed


@pytest.mark.parametrize("name", ["switching_dwell", "valve_conflict", "over_level"])
def test_limits_of_the_valves_are_judged(shaped: Proof, name: str) -> None:
    """A valve that opens for 10 ms, opposite valves together, both levels with a third one.

    X is too far open as well, by a smaller share of its tolerance than Z.
    """
    assert shaped.verdict.result(name).status is Status.PASSED

    def change(samples: dict[str, Any]) -> None:
        if name == "switching_dwell":
            samples["x_left"][1000:1010] = 1.0
        elif name == "valve_conflict":
            moving = np.flatnonzero(samples["x_right"])
            samples["x_left"][moving[100:300]] = 1.0
        else:
            samples["z_down_a2"][samples["z_down"] > 0] = 1.0
            samples["x_right_a2"][samples["x_right"] > 0] = 1.0

    machine = shaped.plan.machine
    if name == "over_level":  # flows that sum to more than 1
        cylinders = {**machine.cylinders}
        for axis, second, level in (("X", "x_right_a2", 0.597), ("Z", "z_down_a2", 0.6)):
            way = cylinders[axis].forward
            flow = replace(way.flows[second], si=level)
            more = replace(way, flows={**way.flows, second: flow})
            cylinders[axis] = replace(cylinders[axis], forward=more)
        machine = replace(machine, cylinders=cylinders)
    scheduled = replace(shaped.plan.scheduled, machine=machine)
    plan = replace(shaped.plan, machine=scheduled.machine, intent=scheduled)
    verdict = judge([altered(shaped.recording, change)], plan, shaped.spec)
    result = verdict.result(name)
    assert result.status is Status.FAILED
    expected = {"switching_dwell": 0.010, "valve_conflict": 0.2, "over_level": 0.107}[name]
    assert result.measured == pytest.approx(expected, abs=1e-9)


def test_a_dwell_that_is_kept_is_told_in_words(shaped: Proof) -> None:
    """No negative time: 0 too short, and the shortest rest of a valve beside the needed one."""
    result = shaped.verdict.result("switching_dwell")
    assert result.measured == 0.0
    assert " ms; it needs 20 ms" in result.note
    assert float(result.note.split(" again after ")[1].split(" ms")[0]) >= 20.0


def test_flow_controls_of_a_closed_valve_are_no_level(shaped: Proof) -> None:
    """Every flow control for Z down opens while no air flows: this exceeds no level.

    The two flow controls sum to 1; the judge gets 0.6 for one of them, as above.
    """
    machine = shaped.plan.machine
    way = machine.cylinders["Z"].forward
    more = replace(way, flows={n: replace(flow, si=0.6) for n, flow in way.flows.items()})
    cylinders = {**machine.cylinders, "Z": replace(machine.cylinders["Z"], forward=more)}
    scheduled = replace(shaped.plan.scheduled, machine=replace(machine, cylinders=cylinders))
    plan = replace(shaped.plan, machine=scheduled.machine, intent=scheduled)

    def change(samples: dict[str, Any]) -> None:
        for flow in way.flows:
            samples[flow][:] = samples[way.valve] == 0

    verdict = judge([altered(shaped.recording, change)], plan, shaped.spec)
    assert verdict.result("over_level").measured == 0.0
    assert verdict.result("switching_order").status is Status.FAILED


def test_ringing_between_the_moves_is_seen(shaped: Proof) -> None:
    """0.2 mm at 3 Hz added to the frame: half its peak-to-peak is 0.2 mm, and fails 0.1 mm."""

    def change(samples: dict[str, Any]) -> None:
        time = np.arange(len(samples["X.frame"])) * 1e-3
        samples["X.frame"] = 2e-4 * np.sin(2 * np.pi * 3.0 * time)

    verdict = judge([altered(shaped.recording, change)], shaped.plan, shaped.spec)
    for result in verdict.results:
        if result.name == "residual_vibration" and result.axis == "X":
            assert result.status is Status.FAILED
            assert result.measured == pytest.approx(2e-4, rel=1e-3)


def test_recording_without_a_frame_or_outputs(shaped: Proof) -> None:
    frames = [c for c in shaped.recording.channels if c.name != "Z.frame"]
    recording = replace(shaped.recording, channels=tuple(frames))
    verdict = judge([recording], shaped.plan, shaped.spec)
    assert "no frame channel of Z" in verdict.result("residual_vibration", "Z").note
    assert verdict.result("residual_vibration", "X").status is Status.PASSED
    outputs = [c for c in shaped.recording.channels if c.name != "z_up"]
    with pytest.raises(RecordingError, match="no output channel 'z_up'"):
        judge([replace(shaped.recording, channels=tuple(outputs))], shaped.plan, shaped.spec)


def test_a_criterion_of_one_step_replaces_that_of_all(shaped: Proof, tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text(
        'name = "s"\n[[criteria]]\nname = "residual_vibration"\nlimit = "1 mm"\n'
        '[[criteria]]\nname = "residual_vibration"\naxis = "X"\nstep = "leave"\nlimit = "1 um"\n'
    )
    spec = load_spec(file, shaped.plan.machine)
    verdict = judge([shaped.recording], shaped.plan, spec)
    failed = [r for r in verdict.results if r.status is Status.FAILED]
    assert [(r.axis, r.step) for r in failed] == [("X", "leave")]
    rows = [(r.axis, r.step) for r in verdict.results if r.name == "residual_vibration"]
    assert len(rows) == len(set(rows)) == 16
    file.write_text('name = "s"\n[[criteria]]\nname = "residual_vibration"\nstep = "leave"\n')
    with pytest.raises(SpecError, match="unknown key 'step'"):
        load_spec(file, load_machine("lathe-winder"))


def test_options_that_a_schedule_does_not_have_are_refused(cycle: Path) -> None:
    machine = load_machine(TRIMMED)
    with pytest.raises(OptionError, match="takes no --interpolation, because it switches"):
        plan_job(read_job(cycle, machine), machine, Options(interpolation="cubic"))
    code, _ = run("prove", str(cycle), "-m", TRIMMED, "--shaper", "zw")
    assert code == 2
    code, _ = run("compare", str(cycle), "-m", TRIMMED, "--feed", "36 mm/s")
    assert code == 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("zv:3Hz:x", "'x' is not a number"),
        ("X=zv, zv", "has no axis before it"),
        ("Q=zv", "no cylinder 'Q'"),
        ("X=zv,X=none", "has two"),
        ("zv:3 mm", "3 mm"),
    ],
)
def test_wrong_shapers_are_refused(cycle: Path, text: str, words: str) -> None:
    machine = load_machine(TRIMMED)
    with pytest.raises(OptionError) as caught:
        plan_job(read_job(cycle, machine), machine, Options(shaper=text))
    assert words in str(caught.value)


def test_a_cylinder_can_have_its_own_shaper(cycle: Path) -> None:
    machine = load_machine(TRIMMED)
    job = read_job(cycle, machine)
    moves = plan_job(job, machine, Options(shaper="X=zv, Z=none")).scheduled.moves
    assert {(m.axis, len(m.levels.ticks)) for m in moves} == {("X", 4), ("Z", 2)}
