"""Data for the views of a run: turn-rounds, the place of the next hold, and stitches to go back."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.live.bench import table_of_counts, winder
from tests.panel.bench import EXAMPLES, PROGRAM
from threadline.commands.plan import Plan
from threadline.errors import OptionError
from threadline.files import Channel, ChannelKind
from threadline.jobs.needle_holes import hole_operations
from threadline.live.continuing import operation_at
from threadline.live.kinds_run import run_kind_of
from threadline.live.path_window import rests_of
from threadline.machine import load_machine
from threadline.panel.job_views import plan_views
from threadline.panel.stored_runs import next_hold
from threadline.panel.welcoming import readings
from threadline.proof.options import options_of
from threadline.proof.pipeline import open_job, plan_job, prove_plan
from threadline.verdict import load_spec


def test_turn_rounds_are_where_the_carriage_turns(tmp_path: Path) -> None:
    """To 60 mm and back, twice: three turn-rounds, the middle one at zero."""
    twice = PROGRAM.replace("M30;", "N 30 A 20 X 60;\nN 40 A 20 X -60;\nM30;")
    (tmp_path / "there.prg").write_text(twice, "utf-8")
    machine, options = load_machine("lathe-winder"), options_of(interpolation="linear")
    plan = plan_job(open_job(tmp_path / "there.prg", machine, options), machine, options)
    proof = prove_plan(plan, load_spec(None, machine))
    found: dict[str, Any] = plan_views(proof)["turn_rounds"]
    assert found["axis"] == "X"
    assert found["at"] == pytest.approx([0.06, 0.0, 0.06], abs=2e-4)
    quarter = plan.duration_s / 4
    assert found["times_s"] == pytest.approx([quarter, 2 * quarter, 3 * quarter], abs=0.1)


def test_rests_are_found_and_the_next_hold_is_at_one_of_them() -> None:
    """A pause of less than 50 ms between two counts is no rest."""
    counts = np.ones((200, 3), np.int64)
    counts[20:100] = 0
    counts[110:113] = 0
    table = table_of_counts(counts)
    period_s = float(table.clock.period_s)
    (rest,) = rests_of(table).tolist()
    assert rest == [20, 100]
    found = run_kind_of(winder()).rests_s(table)
    assert found is not None
    for now, at in ((0.0, 20.0), (25.0, 25.0), (99.0, None)):
        hold = next_hold(found, now * period_s)
        assert hold["hold_at_s"] == (None if at is None else pytest.approx(at * period_s, abs=1e-3))
        assert hold["hold"] == ("at the end" if at is None else "at a rest")
    assert next_hold(None, 1.0) == {"hold": "at once", "hold_at_s": None}


def test_a_run_goes_on_some_stitches_back() -> None:
    """Stitches are counted as on the page: holes, not moves of the file."""
    machine = load_machine("schiffli-frame")
    job = open_job(EXAMPLES / "rosette.dst", machine, options_of())
    holes = hole_operations(job)
    assert len(holes) > 100
    plan = cast("Plan", SimpleNamespace(job=job))
    executed = int(holes[99])  # the hundredth stitch is under way
    assert operation_at(plan, executed, "back 10") == holes[89]
    assert operation_at(plan, executed, "back 1000") == holes[0]
    assert operation_at(plan, executed, "stitch 7") == holes[6]
    for at, why in (
        ("stitch 101", "has reached stitch 100"),
        ("stitch 0", "100"),
        ("back", "no place"),
    ):
        with pytest.raises(OptionError, match=why):
            operation_at(plan, executed, at)


def test_other_work_has_no_stitches_to_go_back(tmp_path: Path) -> None:
    (tmp_path / "there.prg").write_text(PROGRAM, "utf-8")
    job = open_job(tmp_path / "there.prg", load_machine("lathe-winder"), options_of())
    with pytest.raises(OptionError, match="has no stitches"):
        operation_at(cast("Plan", SimpleNamespace(job=job)), 2, "back 1")


def test_readings_without_an_axis_have_their_unit() -> None:
    """An example is the tension of a fibre; inputs, positions and sensor volts are not included."""
    clock = load_machine("lathe-winder").tick_clock
    channels = [
        Channel(name="tension", kind=ChannelKind.SENSOR, unit="N", clock=clock),
        Channel(name="door.input", kind=ChannelKind.INPUT, unit="", clock=clock),
        Channel(name="X.load", kind=ChannelKind.LOAD, unit="m", clock=clock, axis="X"),
        Channel(name="brake.sensor", kind=ChannelKind.SENSOR, unit="V", clock=clock),
    ]
    latest = {"tension": 12.5, "door.input": 1.0, "X.load": 0.1, "brake.sensor": 1.0}
    assert readings(channels, latest) == {"tension": (12.5, "N")}
