"""Runs that continue each other are judged as one, each up to the begin of the next."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.live.test_continued import JOBS, broken_off, planned, rest_of, run
from threadline.files import Recording, RunEnd
from threadline.files.formats import write_recording
from threadline.live.continuing import continued
from threadline.live.store.whole_trace import joined_with, whole_recording
from threadline.verdict import judge, load_spec


def in_folder(folder: Path, recording: Recording, continues: str = "") -> Path:
    """Write a trace like that of a run with this name."""
    folder.mkdir(parents=True)
    origin = {**recording.origin, **({"continues": continues} if continues else {})}
    write_recording(replace(recording, origin=origin), folder / "trace.mcap")
    return folder / "trace.mcap"


@pytest.mark.long(but="letter-placer")
@pytest.mark.parametrize("name", [name for name in JOBS if name != "schiffli-frame"])
def test_all_runs_of_a_job_are_judged_as_one(name: str, tmp_path: Path) -> None:
    """Compared with an uninterrupted run: the same verdict, line by line, and nearly its figures.

    A frame moves to its place by the program itself, as cylinders do, and takes 20 s more. Axes
    start from rest at the joint, so that they follow differently there: 20 % of a limit.
    """
    plan = planned(name)
    first, rest = broken_off(name)[0], rest_of(name)[1]
    in_folder(tmp_path / "first", first)
    trace = in_folder(tmp_path / "second", rest, "first")
    assert joined_with(trace) == ("first",)
    whole = whole_recording(trace)
    clock, block = whole.channels[0].clock.name, next(iter(first))
    tick = block.first_tick[clock]
    for block in whole:  # without a gap
        assert block.first_tick[clock] == tick
        tick += len(block.samples["operation"]) * whole.channels[0].stride
    operations = whole.samples("operation")[1]
    assert (np.diff(operations) >= 0.0).all()
    assert not whole.outcome().incomplete
    spec = load_spec(None, plan.machine)
    found = judge([whole], plan, spec)
    assert found.passed
    assert not found.incomplete
    undisturbed = judge([run(plan)[1]], plan, spec)
    for ours, other in zip(found.results, undisturbed.results, strict=True):
        assert (ours.name, ours.axis, ours.status) == (other.name, other.axis, other.status)
        if ours.limit and ours.measured is not None and other.measured is not None:
            assert ours.measured == pytest.approx(other.measured, abs=0.2 * abs(ours.limit))


@pytest.mark.long(shown_by="test_all_runs_of_a_job_are_judged_as_one")
def test_whole_trace_takes_later_rows_from_the_earlier_run(tmp_path: Path) -> None:
    """Broken off twice, and continued from a place before the begin of the second run."""
    plan = planned("lathe-winder")
    first, executed = broken_off("lathe-winder")
    (ended, _), second, _ = run(plan, continued(plan, executed, at_rest=False), "power-loss@2 s")
    assert ended is RunEnd.FAULT
    _, third, _ = run(plan, continued(plan, executed - 1, at_rest=False))
    _, fourth, _ = run(plan, continued(plan, executed, at_rest=False))
    in_folder(tmp_path / "a", first)
    in_folder(tmp_path / "b", second, "a")
    assert joined_with(in_folder(tmp_path / "c", third, "b")) == ("a",)
    assert joined_with(in_folder(tmp_path / "d", fourth, "b")) == ("b", "a")
    for name in ("c", "d"):
        whole = whole_recording(tmp_path / name / "trace.mcap")
        assert judge([whole], plan, load_spec(None, plan.machine)).passed
    elsewhere = in_folder(tmp_path / "e", fourth, "../a")
    assert joined_with(elsewhere) == ()
    assert not judge([whole_recording(elsewhere)], plan, load_spec(None, plan.machine)).passed
