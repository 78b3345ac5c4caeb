"""Move lists and their schedules: levels, valves, refusals, the cycle on the twin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from threadline.commands.intents import Scheduled
from threadline.commands.plc_net import petri_net
from threadline.commands.schedule import compile_schedule
from threadline.commands.schedule_options import shaping_of
from threadline.dynamics.pneumatic import step_ringing
from threadline.errors import JobError, PlanError, RecordingError
from threadline.files import SwitchSchedule
from threadline.jobs import read_job
from threadline.jobs.operations import WaitInput
from threadline.machine import load_machine
from threadline.twin.switching import SwitchOptions, ringing_m, simulate_switching

TRIMMED = "letter-placer+whole-scans+own-damping"


def cycle(examples: Path, reference: str, shaper: str, **mode: object) -> Scheduled:
    machine = load_machine(reference)
    job = read_job(examples / "letter-cycle.toml", machine)
    return compile_schedule(job, machine, shaping_of(machine, shaper, **mode))  # type: ignore[arg-type]


def x_levels(commands: SwitchSchedule) -> dict[int, float]:
    """Return the level of X to the right from each tick on, by the flows of the paper."""
    columns = [commands.outputs.index(n) for n in ("x_right", "x_right_a1", "x_right_a2")]
    found, last = {}, 0.0
    for tick, row in zip(commands.ticks, commands.levels, strict=True):
        on, a1, a2 = row[columns]
        level = on * (0.63 * a1 + 0.37 * a2)
        if level != last:
            found[int(tick)] = round(float(level), 2)
        last = level
    return found


def test_paper_shaper_becomes_its_four_levels(examples: Path) -> None:
    """0, .63, 1, .37, 0 at 0, 166.9, 465.1 and 632.0 ms: the ZV of the paper on a 1 ms clock."""
    made = cycle(examples, "letter-placer+timed", "zv", mode="3.04 Hz", damping_ratio=0.17)
    levels = x_levels(made.commands)
    first = min(levels)
    assert {t - first: v for t, v in levels.items()} == {0: 0.63, 167: 1.0, 465: 0.37, 632: 0.0}


def test_convolved_shaper_keeps_to_the_unshaped_level_and_the_dwell(examples: Path) -> None:
    made = cycle(examples, "letter-placer", "zv*um-2ei", mode="3.04 Hz", damping_ratio=0.17)
    assert set(x_levels(made.commands).values()) == {0.0, 0.37, 0.63, 1.0}
    for column in made.commands.levels.T:
        changes = made.commands.ticks[np.flatnonzero(np.diff(column, prepend=0))]
        assert np.diff(changes).min(initial=99) * 0.01 >= 0.02 - 1e-12


def test_a_dwell_of_0_changes_no_switching(examples: Path, tmp_path: Path) -> None:
    """A dwell of 0 was refused, and would have taken a scan."""
    machine = load_machine(TRIMMED)
    text = (examples / "letter-cycle.toml").read_text()
    still = tmp_path / "still.toml"
    still.write_text(
        text.replace("[[operation]]\nwait", '[[operation]]\ndwell = "0 ms"\n\n[[operation]]\nwait')
    )
    made = [
        compile_schedule(read_job(file, machine), machine, shaping_of(machine, "zv"))
        for file in (examples / "letter-cycle.toml", still)
    ]
    before, after = (one.commands for one in made)
    assert still.read_text() != text
    assert after.ticks.tolist() == before.ticks.tolist()
    assert after.levels.tolist() == before.levels.tolist()
    assert after.duration_ticks == before.duration_ticks
    assert [e.tick for e in after.events] == [e.tick for e in before.events]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('dwell = "-1 ms"', "is not within 0 ... 24 h"),
        ('wait = "z_is_up"\ntimeout = "0 s"', "is not more than 0 and at most 24 h"),
    ],
)
def test_times_that_cannot_be_are_refused_with_their_room(
    line: str, message: str, tmp_path: Path
) -> None:
    file = tmp_path / "a.toml"
    file.write_text(f"[[operation]]\n{line}\n")
    with pytest.raises(JobError, match=message):
        read_job(file, load_machine(TRIMMED))


def test_levels_without_valves_are_refused(examples: Path) -> None:
    """The machine's own ZV needs .507 and .493, which flow controls at .63 and .37 can't make."""
    with pytest.raises(PlanError, match=r"no valves of 'z_down' make the level 0\.50"):
        cycle(examples, "letter-placer", "zv")
    assert cycle(examples, TRIMMED, "zv").moves
    with pytest.raises(PlanError, match="or take a um- shaper, which needs none but 0 and 1"):
        cycle(examples, "letter-placer", "zv")
    assert cycle(examples, "letter-placer", "um-zv").moves


def test_over_pressure_is_refused(examples: Path) -> None:
    with pytest.raises(PlanError, match="outside the unshaped 0"):
        cycle(examples, "letter-placer", "negative-zv")


def test_moving_before_the_air_is_on_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "m.toml"
    file.write_text('[[operation]]\nmove = { X = "100 mm" }\n')
    machine = load_machine("letter-placer")
    with pytest.raises(PlanError, match=r"m\.toml:1: the soft-start valve 'main_air' is closed"):
        compile_schedule(read_job(file, machine), machine)


@pytest.mark.parametrize(
    ("body", "line", "words"),
    [
        ('mvoe = { X = "1 mm" }', 2, "Did you mean 'move'"),
        ('move = { X = "300 mm" }', 2, "X would move to 300 mm of 0 ... 200 mm"),
        ('move = { Q = "3 mm" }', 2, "no cylinder 'Q'"),
        ("move = { X = 3 }", 2, "has no unit"),
        ('wait = "x_is_rihgt"', 2, "Did you mean 'x_is_right'"),
        ('wait = "x_is_right"\ntimeout = "3 mm"', 3, "timeout"),
        ('dwell = "1 s"\noutput = "knife"', 3, "says dwell and output"),
        ('output = "knife"\non = 1', 3, "on must be true or false"),
        ('dwell = "-1 s"', 2, "not within"),
        ('output = "knife"\ntimeout = "1 s"', 3, "unknown key 'timeout'"),
        ("", 1, "says nothing"),
    ],
)
def test_wrong_move_lists_are_refused_with_their_line(
    tmp_path: Path, body: str, line: int, words: str
) -> None:
    file = tmp_path / "m.toml"
    file.write_text(f"[[operation]]\n{body}\n")
    with pytest.raises(JobError) as caught:
        read_job(file, load_machine("letter-placer"))
    assert words in str(caught.value)
    assert f"m.toml:{line}:" in str(caught.value)


@pytest.mark.parametrize(
    ("wait", "message"),
    [
        (
            'wait = "z_is_down"',
            "'z_is_down' would never come: Z stands at 50 mm then, and z_is_down",
        ),
        ('wait = "z_is_up"', "'z_is_up' would never come"),
        ('wait = "x_is_left"\nis = false', "'x_is_left' would never go: X stands at 0 mm"),
    ],
)
def test_waits_that_no_move_ends_are_refused(tmp_path: Path, wait: str, message: str) -> None:
    """A program for the PLC would stop there with a fault in every cycle."""
    file = tmp_path / "m.toml"
    file.write_text(
        '[[operation]]\nvalve = "main_air"\n[[operation]]\nmove = { Z = "50 mm" }\n'
        f"[[operation]]\n{wait}\n"
    )
    machine = load_machine("letter-placer")
    with pytest.raises(PlanError) as caught:
        compile_schedule(read_job(file, machine), machine)
    assert f"m.toml:5: the input {message}" in str(caught.value)


def test_an_input_that_nothing_moves_goes_when_its_end_is_waited_for(tmp_path: Path) -> None:
    """The vacuum's switch: on while the letter is held, off before the arm leaves it."""
    file = tmp_path / "m.toml"
    file.write_text(
        '[[operation]]\nwait = "letter_held"\n'
        '[[operation]]\ndwell = "50 ms"\n'
        '[[operation]]\nwait = "letter_held"\nis = false\n'
        '[[operation]]\ndwell = "50 ms"\n'
    )
    machine = load_machine("letter-placer")
    made = compile_schedule(read_job(file, machine), machine)
    recording = simulate_switching(made.commands, machine, SwitchOptions(after_s=0.1))
    times, held = recording.samples("letter_held")
    # The first wait takes its own scan, the dwell five: it goes off at 60 ms.
    assert (held[times < 0.06] == 1).all()
    assert (held[times >= 0.06] == 0).all()
    with pytest.raises(RecordingError, match="'letter_held' did not become off within 60 s"):
        stuck = SwitchOptions(inputs={"letter_held": True})
        simulate_switching(made.commands, machine, stuck).samples("letter_held")


def ringing_after_cycle(made: Scheduled) -> float:
    recording = simulate_switching(made.commands, made.machine, SwitchOptions(after_s=1.2))
    times, _ = recording.samples("operation")
    pole = step_ringing(made.machine, "X").pole
    return ringing_m(recording, "X", float(times[-1]) - 0.8, pole)


def test_shaped_cycle_ends_still_and_the_unshaped_one_does_not(examples: Path) -> None:
    """A quarter of the way to 0 is far above the effect of friction, lag and 10 ms scans."""
    unshaped = ringing_after_cycle(cycle(examples, TRIMMED, "none"))
    shaped = ringing_after_cycle(cycle(examples, TRIMMED, "zv"))
    assert unshaped > 1e-3
    assert shaped < 0.05 * unshaped


def test_waits_hold_the_schedule_until_the_piston_is_there(examples: Path) -> None:
    made = cycle(examples, TRIMMED, "zv")
    recording = simulate_switching(made.commands, made.machine)
    _, stroke = recording.samples("X.load")
    waits = [e for block in recording for e in block.events]
    assert [e.name for e in waits] == [e.name for e in made.commands.events if e.kind == "wait"]
    right = next(e for e in waits if e.name == "x_is_right")
    assert stroke[right.tick] >= 0.194


def test_a_wait_may_be_for_an_input_to_go(tmp_path: Path) -> None:
    """``is`` and ``timeout`` are applied; the default waits for true, and longer."""
    file = tmp_path / "w.toml"
    file.write_text(
        '[[operation]]\nwait = "x_is_right"\nis = false\ntimeout = "250 ms"\n'
        '[[operation]]\nwait = "x_is_right"\n'
    )
    gone, there = read_job(file, load_machine("letter-placer"))
    assert isinstance(gone, WaitInput) and isinstance(there, WaitInput)
    assert (gone.name, gone.value, gone.timeout_s) == ("x_is_right", 0.0, 0.25)
    assert there.value == 1.0
    assert there.timeout_s > 1.0


def test_a_broken_beam_shuts_everything_in_the_next_scan(examples: Path) -> None:
    made = cycle(examples, TRIMMED, "zv")
    options = SwitchOptions(break_s=2.345, after_s=1.0)
    recording = simulate_switching(made.commands, made.machine, options)
    samples = recording.samples_of(["operation", *made.commands.outputs])
    times, _ = samples["operation"]
    total = sum(samples[name][1] for name in made.commands.outputs)
    assert total[times < 2.345].max() >= 2
    assert (total[times >= 2.355] == 0).all()


def test_a_long_move_list_is_read_in_one_pass(tmp_path: Path) -> None:
    """A search from the top for every line number would take an hour for such a list."""
    many = 50_000
    path = tmp_path / "long.toml"
    path.write_text('name = "long"\n' + '[[operation]]\ndwell = "1 ms"\n' * many)
    operations = list(read_job(path, load_machine("letter-placer")).operations)
    lines = [operation.source.line for operation in operations]
    assert lines == list(range(2, 2 * many + 2, 2))


def waiting(timeout: str, folder: Path) -> Scheduled:
    file = folder / "m.toml"
    file.write_text(
        '[[operation]]\nvalve = "main_air"\n[[operation]]\nmove = { Z = "100 mm" }\n'
        f'[[operation]]\nwait = "z_is_down"\ntimeout = "{timeout}"\n'
    )
    machine = load_machine("letter-placer")
    return compile_schedule(read_job(file, machine), machine)


def test_a_timeout_shorter_than_a_scan_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PlanError) as caught:
        waiting("1 ms", tmp_path)
    assert "m.toml:5: timeout = 1 ms is shorter than a scan, 10 ms" in str(caught.value)


@pytest.mark.parametrize(("timeout", "scans_ms"), [("10 ms", 10), ("11 ms", 20), ("2 s", 2000)])
def test_a_timeout_is_whole_scans_and_never_less(
    tmp_path: Path, timeout: str, scans_ms: int
) -> None:
    scheduled = waiting(timeout, tmp_path)
    (wait,) = [event for event in scheduled.commands.events if event.kind == "wait"]
    (place, *_) = [place for place in petri_net(scheduled).places if place.wait is not None]
    assert place.due_ms - (wait.tick - place.origin_tick) * 10 == scans_ms
