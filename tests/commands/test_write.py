"""The targets by name, their files and refusals, and the part program of a plan."""

from __future__ import annotations

import hashlib
import re
from types import SimpleNamespace

import numpy as np
import pytest

from threadline.commands.planned_job import planned_job
from threadline.commands.ticks import compile_ticks
from threadline.commands.write import table_writer
from threadline.errors import LimitError, OptionError
from threadline.files import Clock, SwitchSchedule
from threadline.files.formats import read_table
from threadline.jobs import read_job
from threadline.jobs.operations import Dwell, Feed, FeedMode, Move, SetOutput, Stop
from threadline.machine import load_machine
from threadline.motion.path import programmed_path
from threadline.proof.pipeline import target_names, target_of, write

from .makers import HERE, job_of, lines, polynomials, winder

FEED = Feed(FeedMode.RAPID, 0.0)
OPERATIONS = [
    Dwell(0.5, HERE),
    Move((0.1,), FEED, HERE),
    Stop(False, HERE),
    Dwell(1.0, HERE),
    Move((0.0,), FEED, HERE),
    Stop(True, HERE),
]
# s(u) = 10 u^3 - 15 u^4 + 6 u^5 over 0.1 m and back
RISE = [[0.0], [0.0], [0.0], [1.0], [-1.5], [0.6]]
FALL = [[0.1], [0.0], [0.0], [-1.0], [1.5], [-0.6]]
PIECES = [(0.5, [[0.0]], 0), (1.25, RISE, 1), (1.0, [[0.1]], 1), (2.0, FALL, 4)]


def plan_of(trajectory, operations=OPERATIONS):
    machine, job = winder(), job_of(operations)
    return SimpleNamespace(
        job=job,
        machine=machine,
        motion=SimpleNamespace(trajectory=trajectory, programmed=programmed_path(job, machine)),
        commands=compile_ticks(trajectory, machine, job),
    )


@pytest.mark.parametrize("target", ["csv", "npz", "ticks"])
def test_tables_hold_the_commands(tmp_path, target) -> None:
    plan = plan_of(polynomials(PIECES))
    path = tmp_path / f"out.{target}"
    (done,) = write(plan, target, path)
    assert done.path == path
    assert done.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    read, expected = list(read_table(path)), list(plan.commands)
    assert np.array_equal(
        np.concatenate([b.counts for b in read]), np.concatenate([b.counts for b in expected])
    )
    assert [e for b in read for e in b.events] == [e for b in expected for e in b.events]
    assert read_table(path).job_sha256 == plan.job.sha256
    assert write(plan, target, str(path))[0].sha256 == done.sha256
    assert table_writer(target)(plan.commands, path).sha256 == done.sha256


def test_unknown_targets_name_the_nearest(tmp_path) -> None:
    plan = plan_of(polynomials(PIECES))
    with pytest.raises(OptionError, match=r"unknown target 'tick'. Did you mean 'ticks'\?"):
        write(plan, "tick", tmp_path / "x")
    with pytest.raises(OptionError, match=r"unknown target 'dxf'. Known: csv, fanuc, fluidnc"):
        write(plan, "dxf", tmp_path / "x")
    with pytest.raises(
        OptionError, match=r"unknown target 'nosuch'. Known: openplc, plcopen, scl, st"
    ):
        target_of("nosuch", load_machine("letter-placer"))
    assert {"csv", "nc", "npz", "ticks"} <= set(target_names())
    assert list(tmp_path.iterdir()) == []


def test_commands_of_another_kind_are_refused(tmp_path) -> None:
    schedule = SwitchSchedule(
        clock=Clock("scan", winder().tick_clock.period_s),
        outputs=("valve",),
        ticks=np.array([0]),
        levels=np.array([[1]]),
        operation=np.array([0]),
        duration_ticks=1,
        job_sha256="",
        machine_sha256="",
    )
    plan = plan_of(polynomials(PIECES))
    plan.commands = schedule
    with pytest.raises(OptionError, match=r"this needs a table of counts, which an on/off machine"):
        write(plan, "csv", tmp_path / "x")
    plan.machine = load_machine("letter-placer")
    with pytest.raises(
        OptionError, match=r"commanded by switches. Use openplc or plcopen or scl or st"
    ):
        write(plan, "csv", tmp_path / "x")


def test_a_plan_over_the_limits_leaves_no_file(tmp_path) -> None:
    plan = plan_of(lines([[0.0], [0.1], [0.3]], [1.0, 0.1]))
    for target in ("csv", "npz", "ticks"):
        (tmp_path / "old").write_text("old")
        with pytest.raises(LimitError):
            write(plan, target, tmp_path / "old")
        assert (tmp_path / "old").read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["old"]


def test_the_part_program_follows_the_plan_in_place_and_time(tmp_path) -> None:
    """A small reader of its words: times add up, chords stay within 10 um, dwells stay."""
    trajectory = polynomials(PIECES)
    write(plan_of(trajectory), "nc", tmp_path / "out.ngc")
    text = (tmp_path / "out.ngc").read_text()

    places = [len(decimals) for decimals in re.findall(r"X-?\d+\.(\d+)", text)]
    digits = [len(word.replace(".", "").lstrip("0")) for word in re.findall(r"F([\d.]+)", text)]
    assert 3 < max(places) <= 6
    assert max(digits) <= 9
    assert re.search(r"^N\d+ G64 P0\.01$", text, re.M)
    time_s, x_m = 0.0, 0.0
    worst, stops = 0.0, []
    for line in text.splitlines():
        words = dict(re.findall(r"([A-Z]) ?(-?[\d.]+)", line.replace("G93 ", "").replace("G1", "")))
        if "X" in words:
            duration = 60.0 / float(words["F"])
            times = time_s + duration * np.linspace(0.0, 1.0, 11)
            x = float(words["X"]) / 1000.0
            chord = x_m + (x - x_m) * np.linspace(0.0, 1.0, 11)
            worst = max(worst, np.abs(trajectory(times)[:, 0] - chord).max())
            time_s, x_m = time_s + duration, x
        elif "P" in words and "G64" not in line:
            time_s += float(words["P"])
            stops.append(("dwell", round(time_s, 9)))
        elif words.get("M") in {"0", "30"}:
            stops.append((words["M"], round(time_s, 9)))
    assert stops == [("dwell", 0.5), ("0", 1.75), ("dwell", 2.75), ("30", 4.75)]
    assert x_m == 0.0
    assert 2e-6 < worst <= 1.01e-5  # the bound is kept, and not by many tiny chords


def test_our_own_reader_takes_the_part_program(tmp_path) -> None:
    """Without the G64 that only LinuxCNC knows."""
    plan = plan_of(polynomials(PIECES))
    write(plan, "nc", tmp_path / "out.prg")
    text = re.sub(r"N\d+ G64 P0\.01\n", "", (tmp_path / "out.prg").read_text())
    (tmp_path / "out.prg").write_text(text)
    read = list(read_job(tmp_path / "out.prg", plan.machine))
    expected = list(planned_job(plan.job, plan.motion.trajectory, plan.machine))
    assert [type(o) for o in read] == [type(o) for o in expected]
    for ours, theirs in zip(read, expected, strict=True):
        if isinstance(ours, Move):
            assert ours.target[1] == pytest.approx(theirs.target[0], abs=1e-12)
            assert ours.feed.value == pytest.approx(theirs.feed.value, rel=1e-9)


def test_a_rest_that_no_dwell_asks_for_keeps_its_time() -> None:
    """A move to the present place takes its time; outputs stay between the moves around them."""
    pieces = [(1.0, [[0.0], [0.1]], 0), (0.75, [[0.1]], 1), (1.0, [[0.1], [-0.1]], 3)]
    operations = [
        Move((0.1,), FEED, HERE),
        Move((0.1,), FEED, HERE),
        SetOutput("valve", 1, HERE),
        Move((0.0,), FEED, HERE),
        Stop(True, HERE),
    ]
    made = list(planned_job(job_of(operations), polynomials(pieces), winder()))
    assert [type(o).__name__ for o in made] == ["Move", "Dwell", "SetOutput", "Move", "Stop"]
    assert made[1].duration_s == 0.75
    assert made[3].feed == Feed(FeedMode.INVERSE_TIME, 1.0)


def test_a_target_is_refused_before_anything_is_planned() -> None:
    """By its name and the kind of machine alone, with the targets that would do."""
    assert not target_of("nc", winder()).takes_shaped
    with pytest.raises(OptionError, match=r"unknown target 'okuma'. Known: csv, fanuc, fluidnc"):
        target_of("okuma", winder())
    with pytest.raises(OptionError, match=r"than lathe-winder, .* Use csv or npz or ticks or nc"):
        target_of("st", winder())
    placer = load_machine("letter-placer")
    assert target_of("plcopen", placer).takes_shaped
    with pytest.raises(
        OptionError, match=r"than letter-placer, .* Use openplc or plcopen or scl or st"
    ):
        target_of("csv", placer)
