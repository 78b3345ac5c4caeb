"""``prove`` and ``judge`` of a move list: every step measured, the valves' limits kept."""

from __future__ import annotations

import json
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.made import Made
from threadline.cli.main import main
from threadline.cli.prove import show_proof
from threadline.errors import OptionError, RecordingError, SpecError
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.options import Options
from threadline.pipeline import Proof, plan_job, prove, prove_plan
from threadline.plant.pneumatic import step_ringing
from threadline.report.switching import shaping_rows
from threadline.signals import Recording, RecordingBlock, Stream, SwitchSchedule
from threadline.twin.switching import SwitchOptions, ringing_m, simulate_switching
from threadline.verdict import Criterion, Status, judge, load_spec, verdict_json
from threadline.verdict.switch_run import SwitchRun

TRIMMED = "letter-placer+whole-scans+own-damping"


@pytest.fixture(scope="module")
def cycle() -> Path:
    return Path(__file__).resolve().parents[2] / "examples" / "letter-cycle.toml"


@pytest.fixture(scope="module")
def shaped(cycle: Path) -> Proof:
    machine = load_machine(TRIMMED)
    return prove(cycle, machine, load_spec(None, machine), Options(shaper="zv"))


def altered(recording: Recording, change: Any) -> Recording:
    def blocks() -> Any:
        whole = list(recording)
        samples = {k: np.concatenate([b.samples[k] for b in whole]) for k in whole[0].samples}
        change(samples)
        events = tuple(event for block in whole for event in block.events)
        yield RecordingBlock(first_tick=whole[0].first_tick, samples=samples, events=events)

    return replace(recording, blocks=Made(blocks))


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


def run(*words: str) -> tuple[int, str]:
    output = StringIO()
    with pytest.raises(SystemExit) as stopped, redirect_stdout(output):
        main(list(words))
    return int(stopped.value.code or 0), output.getvalue()


def test_shaped_cycle_is_in_spec_and_the_unshaped_and_the_misread_one_are_not(
    cycle: Path, tmp_path: Path
) -> None:
    """Exit codes 0 and 1; a recording that was written is judged the same."""
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
    # 24.7 % of what the unshaped stroke leaves, by the facts; whole scans and lag move it a little.
    unshaped = json.loads(run(*misread)[1])["criteria"]
    (other,) = [c for c in unshaped if (c["axis"], c.get("step")) == ("X", "across")
                and c["name"] == "residual_vibration"]  # fmt: skip
    assert rows["X", "across"]["measured"] / other["measured"] == pytest.approx(0.247, abs=0.02)


def test_residual_of_a_step_is_the_ringing_that_a_fit_finds(shaped: Proof) -> None:
    """The frame's amplitude after "across" by a fitted sine, the later steps cut off.

    Half the peak-to-peak of a window counts the rest of the motion too: 15 % and 2 um.
    """
    machine, commands = shaped.plan.machine, shaped.plan.commands
    (end,) = [e.tick for e in commands.events if e.name == "leave"]
    alone = simulate_switching(until(commands, end), machine, SwitchOptions(after_s=1.2))
    pole = step_ringing(machine, "X").pole
    wanted = ringing_m(alone, "X", end * 0.01, pole)
    result = next(
        r
        for r in shaped.verdict.results
        if (r.name, r.axis, r.step) == ("residual_vibration", "X", "across")
    )
    assert result.measured is not None
    assert wanted > 5e-6
    assert result.measured == pytest.approx(wanted, rel=0.15, abs=2e-6)


def test_a_bare_shaper_says_for_which_mode_it_was_made(
    shaped: Proof, capsys: pytest.CaptureFixture[str]
) -> None:
    """The machine's own pole under each cylinder; JSON has it in full."""
    content = verdict_json(shaped.verdict, shaped.plan)["shaping"]
    assert list(content) == ["X", "Z"]
    show_proof(shaped)
    printed = capsys.readouterr().out
    for axis, told in content.items():
        pole = step_ringing(shaped.plan.machine, axis).pole
        ratio = -pole.real / abs(pole)
        (mode,) = told["modes"]
        assert told["shaper"] == "zv"
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
    """The last target of X is where it began: forward and back again, each within a millimetre."""
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
    """None comes late: 903 scans of 10 ms. Half a second without air in a wait adds as much."""
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
    """A valve that opens for 10 ms, opposite valves together, both levels with a third one."""
    assert shaped.verdict.result(name).status is Status.PASSED

    def change(samples: dict[str, Any]) -> None:
        if name == "switching_dwell":
            samples["x_left"][1000:1010] = 1.0
        elif name == "valve_conflict":
            moving = np.flatnonzero(samples["x_right"])
            samples["x_left"][moving[100:300]] = 1.0
        else:
            samples["z_down_a2"][samples["z_down"] > 0] = 1.0

    machine = shaped.plan.machine
    if name == "over_level":  # flows that sum to more than 1
        way = machine.cylinders["Z"].forward
        flow = replace(way.flows["z_down_a2"], si=0.6)
        more = replace(way, flows={**way.flows, "z_down_a2": flow})
        cylinders = {**machine.cylinders, "Z": replace(machine.cylinders["Z"], forward=more)}
        machine = replace(machine, cylinders=cylinders)
    scheduled = replace(shaped.plan.scheduled, machine=machine)
    plan = replace(shaped.plan, machine=scheduled.machine, intent=scheduled)
    verdict = judge([altered(shaped.recording, change)], plan, shaped.spec)
    result = verdict.result(name)
    assert result.status is Status.FAILED
    wanted = {"switching_dwell": 0.010, "valve_conflict": 0.2, "over_level": 0.107}[name]
    assert result.measured == pytest.approx(wanted, abs=1e-9)


def test_a_dwell_that_is_kept_is_told_in_words(shaped: Proof) -> None:
    """No negative time: 0 too short, and how long the quickest valve rested of what it needs."""
    result = shaped.verdict.result("switching_dwell")
    assert result.measured == 0.0
    assert " ms; it needs 20 ms" in result.note
    assert float(result.note.split(" again after ")[1].split(" ms")[0]) >= 20.0


def test_flow_controls_of_a_closed_valve_are_no_level(shaped: Proof) -> None:
    """All that lets Z down opens while no air goes that way: too much of nothing is not over.

    The two flow controls sum to 1; the judge is given 0.6 for one of them, as above.
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
    with pytest.raises(OptionError, match=r"--interpolation: .* switches cylinders on and off"):
        plan_job(read_job(cycle, machine), machine, Options(interpolation="cubic"))
    code, _ = run("prove", str(cycle), "-m", TRIMMED, "--shaper", "zw")
    assert code == 2
    code, _ = run("compare", str(cycle), "-m", TRIMMED, "--feed", "36 mm/s")
    assert code == 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("zv:3Hz:x", "'x' is no number"),
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


def test_a_table_made_by_hand_is_judged_as_the_recording_is(
    cycle: Path, shaped: Proof, tmp_path: Path
) -> None:
    """Outputs, an input and frames as columns of a spreadsheet: what was proved comes out."""
    switched = shaped.plan.commands.outputs
    columns = {f"{name}.output": shaped.recording.samples(name)[1] for name in switched}
    columns["x_is_left.input"] = shaped.recording.samples("x_is_left")[1]
    for axis in "XZ":
        columns[f"{axis}.frame [um]"] = 1e6 * shaped.recording.samples(f"{axis}.frame")[1]
    times_s, _ = shaped.recording.samples("X.frame")
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
    code, text = run(*words)  # a plan without the shaper is not what this machine was told
    assert code == 1
    criteria = json.loads(text)["criteria"]
    assert [c["name"] for c in criteria if c["status"] == "failed"] == ["switching_order"]


def test_how_long_the_cycle_waits_at_its_end_is_not_known_without_the_contact(
    shaped: Proof,
) -> None:
    """The last switching begins the way back; the cycle ends when x_is_left says so."""
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
    """A channel that is named and empty is as good as none."""

    def empty(samples: dict[str, Any]) -> None:
        samples["Z.frame"] = samples["Z.load"] = np.empty(0)

    verdict = judge([altered(shaped.recording, empty)], shaped.plan, shaped.spec)
    for name in ("residual_vibration", "end_position_error", "travel"):
        assert verdict.result(name, "Z").status is Status.NOT_MEASURED
        assert verdict.result(name, "X").status is not Status.NOT_MEASURED
    assert verdict.result("settling_time").status is Status.NOT_MEASURED


def cut(recording: Recording, name: str, begin: int, end: int) -> Recording:
    """Return a recording in three blocks, in the second of which a channel has no samples."""
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
    """3 mm at 3 Hz on one frame for 0.2 s; those 0.2 s are cut out of its channel, or of all."""
    run = SwitchRun(shaped.recording, shaped.plan)
    step = max(run.steps, key=lambda s: np.subtract(*run.quiet_s(s, axis)[::-1]))
    begin = round(1e3 * run.quiet_s(step, axis)[0]) + 50
    end = begin + 200

    def ring(samples: dict[str, Any]) -> None:
        time = np.arange(end - begin) * 1e-3
        samples[f"{axis}.frame"][begin:end] += 3e-3 * np.sin(2 * np.pi * 3.0 * time)

    rung = altered(shaped.recording, ring)
    assert not judge([rung], shaped.plan, shaped.spec).passed
    verdict = judge([cut(rung, f"{axis}.frame", begin, end)], shaped.plan, shaped.spec)
    other = "Z" if axis == "X" else "X"
    found = [r for r in verdict.results if r.name == "residual_vibration"]
    assert {r.status for r in found if r.axis == axis} == {Status.NOT_MEASURED}
    assert all(f"{axis}.frame has no samples from" in r.note for r in found if r.axis == axis)
    assert Status.PASSED in {r.status for r in found if r.axis == other}
    assert verdict.result("settling_time").status is Status.NOT_MEASURED

    with pytest.raises(RecordingError, match=r"has no samples from .*when the valves switched"):
        judge([cut(rung, "", begin, end)], shaped.plan, shaped.spec)


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
    """Cut off 0.1 s before its end: the last step of X is not known, those before it are."""
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
def test_what_rings_is_measured_though_the_cylinder_moves_again_at_once(
    shaper: str, tmp_path: Path
) -> None:
    """By place and speed in 20 ms, against half the peak-to-peak of a second: 3 % and 8 um.

    A piston at rest still has 2 % of its speed, and what slows it pushes the frame by 17 um at
    most. A live machine may wait there for an input that on the simulated one comes at once.
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


def test_what_is_required_and_cannot_be_measured_is_not_proven(tmp_path: Path) -> None:
    """X goes back before it has come to rest: nobody knows what would ring there."""
    proof = of_pick(tmp_path, 10, 'rest = "100 ms"\n', "zv")
    told = [r for r in proof.verdict.results if (r.name, r.axis, r.step) == (MEASURED, "X", "out")]
    assert [r.status for r in told] == [Status.NOT_MEASURED]
    assert told[0].note == "it moves again before it has come to rest"
    assert told[0].required
    assert not proof.verdict.passed
