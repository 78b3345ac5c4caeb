"""Cylinders that start together, or go back at once: each has its own command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.search.test_cycle import run
from threadline.jobs import Job, read_job
from threadline.machine import Machine, load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, write
from threadline.search.cycle import FastestCycle, fastest_cycle
from threadline.search.move_list import move_list
from threadline.search.paced import Question
from threadline.verdict import Status, load_spec

TOGETHER = """
[[operation]]
step = "start"
valve = "main_air"

[[operation]]
step = "out"
move = { X = "200 mm", Z = "100 mm" }

[[operation]]
step = "back"
move = { Z = "0 mm" }

[[operation]]
move = { X = "0 mm" }
"""


def unlocked() -> Machine:
    """Return the letter placer as one whose slide may move with the lift anywhere."""
    machine = load_machine("letter-placer")
    slide = replace(machine.cylinders["X"], needs=())
    return replace(machine, cylinders={**machine.cylinders, "X": slide})


@pytest.fixture(scope="module")
def together(tmp_path_factory: pytest.TempPathFactory) -> tuple[Job, FastestCycle]:
    machine = unlocked()
    file = tmp_path_factory.mktemp("together") / "both.toml"
    file.write_text(TOGETHER, encoding="utf-8")
    job = read_job(file, machine)
    return job, fastest_cycle(Question(job=job, machine=machine, spec=load_spec(None, machine)))


def test_cylinders_that_set_out_together_have_a_command_each(
    together: tuple[Job, FastestCycle], tmp_path: Path
) -> None:
    """In spec on the twin, both start in the same scan, and the written list says so."""
    machine = unlocked()
    _, found = together
    assert found.job is not None
    assert found.proof.verdict.passed
    x, z, *_ = found.proof.plan.scheduled.moves
    assert (x.axis, z.axis) == ("X", "Z")
    assert x.operation == z.operation
    assert x.first_tick == z.first_tick
    assert x.levels.levels != (1.0, 0.0) or z.levels.levels != (1.0, 0.0), "unshaped it rings"
    file = tmp_path / "written.toml"
    file.write_text(move_list(found.job, machine), encoding="utf-8")
    assert "levels = { X = " in file.read_text(encoding="utf-8")
    again = plan_job(read_job(file, machine), machine, Options())
    assert again.scheduled.commands.ticks.tolist() == (
        found.proof.plan.scheduled.commands.ticks.tolist()
    )
    out = tmp_path / "written.st"
    write(again, "st", out)
    assert out.exists()


def test_simultaneous_strokes_take_the_time_of_the_longer_one(
    together: tuple[Job, FastestCycle],
) -> None:
    """The move is shorter than one after the other by the whole shorter stroke with its rest."""
    machine = unlocked()
    job, found = together
    apart = read_job_text(TOGETHER.replace('X = "200 mm", Z', "Z"), machine, job)
    single = fastest_cycle(Question(job=apart, machine=machine, spec=load_spec(None, machine)))
    assert single.job is not None
    saved = 0.5 + machine.cylinders["Z"].rest_s(forward=True)
    assert found.cycle_s is not None
    assert single.cycle_s is not None
    assert single.cycle_s - found.cycle_s > 0.9 * saved


def read_job_text(text: str, machine: Machine, beside: Job) -> Job:
    """Return a job as text in which the slide moves out after the lift."""
    file = Path(beside.file).with_name("apart.toml")
    after = text.replace(
        'move = { Z = "100 mm" }',
        'move = { Z = "100 mm" }\n\n[[operation]]\nmove = { X = "200 mm" }',
    )
    file.write_text(after, encoding="utf-8")
    return read_job(file, machine)


@pytest.mark.parametrize(
    ("levels", "words"),
    [
        ('{ X = "1 for 470 ms", Y = "1 for 500 ms" }', "levels are given for 'Y', which this"),
        ('{ X = "1 for 470 ms", Z = 7 }', "levels of Z: 7 is no text of levels"),
        ('{ X = "1 for 470 ms", Z = "1 for 100 ms" }', "by 20.00 mm, and its move is 100.00 mm"),
        ("[1, 2]", "levels = [1, 2] is no text"),
    ],
)
def test_levels_of_each_that_are_wrong_are_refused(
    levels: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "both.toml"
    both = 'move = { X = "200 mm", Z = "100 mm" }'
    file.write_text(TOGETHER.replace(both, f"{both}\nlevels = {levels}"), encoding="utf-8")
    code, out, err = run(capsys, "prove", file, "-m", "letter-placer")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err
    assert "both.toml:" in err


AT_ONCE_BACK = """
[[operation]]
step = "start"
valve = "main_air"

[[operation]]
step = "out"
move = { X = "200 mm" }

[[operation]]
wait = "x_is_right"

[[operation]]
step = "back"
move = { X = "0 mm" }
"""


def test_a_cycle_is_found_where_a_cylinder_goes_back_at_once(tmp_path: Path) -> None:
    """The ringing after the first stroke is measured and learned from: every step is in spec."""
    machine = load_machine("letter-placer")
    file = tmp_path / "back.toml"
    file.write_text(AT_ONCE_BACK, encoding="utf-8")
    found = fastest_cycle(
        Question(job=read_job(file, machine), machine=machine, spec=load_spec(None, machine))
    )
    assert found.job is not None
    residuals = [r for r in found.proof.verdict.results if r.name == "residual_vibration"]
    assert {r.step for r in residuals} == {"start", "out", "back"}
    assert all(r.status is Status.PASSED for r in residuals)
