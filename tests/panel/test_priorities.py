"""An operator's priority as options of the plan: accuracy, optimum, speed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.live.bench import winder
from tests.panel.bench import CASES, PROGRAM
from threadline.errors import OptionError
from threadline.machine import load_machine
from threadline.panel.programs import by_priority, planned, program_path, words_of
from threadline.proof.pipeline import NOMINAL, open_job, prove_plan
from threadline.verdict import load_spec


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("project")
    (found / "there.prg").write_text(PROGRAM, "utf-8")
    return found


def request_by_priority(folder: Path, priority: str) -> dict[str, Any]:
    asked = CASES["lathe-winder"].model_dump(exclude={"what"})
    options = words_of(asked)
    job = open_job(program_path(folder, "there.prg"), winder(), options)
    spec = load_spec(None, winder())
    words = by_priority(priority, job, winder(), spec, options, NOMINAL, lambda *_: None)
    return {**asked, **words}


def test_accuracy_is_the_normal_feed(folder: Path) -> None:
    """10 counts in a tick of 5 ms are 36.13 mm/s on X, which has 55.358 counts/mm."""
    plan, _ = planned(folder, request_by_priority(folder, "accuracy"), winder())
    assert plan.duration_s == pytest.approx(2 * 60.0 / (10.0 / 55.358 / 0.005), rel=0.02)


@pytest.mark.usefixtures("coarse_search")
def test_speed_is_in_spec_and_optimum_keeps_a_fifth_of_every_limit(folder: Path) -> None:
    spec, durations_s = load_spec(None, winder()), []
    for priority, asked in (("speed", spec), ("optimum", spec.with_margin(0.2))):
        plan, _ = planned(folder, request_by_priority(folder, priority), winder())
        assert prove_plan(plan, asked, None, NOMINAL).verdict.passed
        durations_s.append(plan.duration_s)
    assert durations_s[0] < durations_s[1]


def test_priority_is_refused_for_a_job_without_a_feed() -> None:
    machine = load_machine("letter-placer")
    options = words_of(CASES["letter-placer"].model_dump(exclude={"what"}))
    job = open_job(Path(__file__).parents[2] / "examples" / "letter-cycle.toml", machine, options)
    with pytest.raises(OptionError, match="is not paced by a feed, but by: switchings"):
        by_priority(
            "speed", job, machine, load_spec(None, machine), options, NOMINAL, lambda *_: None
        )
