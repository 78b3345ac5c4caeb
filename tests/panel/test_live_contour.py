"""The contour error of a run while it goes on: the judge's measure on the same samples."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.live.memory_sink import MemorySink
from tests.panel.bench import PROGRAM, operator, proven, served
from tests.panel.test_operator import started
from threadline.files import ChannelKind
from threadline.machine import load_machine
from threadline.panel.live_contour import Also, LiveContour
from threadline.proof.options import options_of
from threadline.proof.pipeline import Proof, open_job, plan_job, prove_plan
from threadline.report.traces import contour_along
from threadline.verdict import load_spec

LIMIT_M = 0.5e-3
SMALL = 7  # samples of a report; they need not fill whole pieces


@pytest.fixture(scope="module")
def proof(tmp_path_factory: pytest.TempPathFactory) -> Proof:
    file = tmp_path_factory.mktemp("live-contour") / "there.prg"
    file.write_text(PROGRAM, "utf-8")
    machine, options = load_machine("lathe-winder"), options_of(interpolation="linear")
    plan = plan_job(open_job(file, machine, options), machine, options)
    return prove_plan(plan, load_spec(None, machine))


def fed(proof: Proof, live: LiveContour, until: Callable[[], bool] = lambda: False) -> None:
    """Give a measurement the samples of a proof, a few at a time, as a machine reports them."""
    for block in proof.recording:
        count = max(map(len, block.samples.values()))
        (clock,) = block.first_tick
        for first in range(0, count, SMALL):
            part = {name: values[first : first + SMALL] for name, values in block.samples.items()}
            stride = proof.recording.channels[0].stride
            tick = block.first_tick[clock] + first * stride
            events = block.events if first == 0 else ()
            live.block(replace(block, first_tick={clock: tick}, samples=part, events=events))
            if until():
                return


def test_live_contour_equals_the_judged_error_at_samples(proof: Proof) -> None:
    live = LiveContour.of(proof.plan, proof.spec, proof.recording.channels)
    assert live is not None
    assert live.report() is None
    fed(proof, live)
    live.close()
    report = live.report()
    assert live.failed == ""
    assert report is not None
    along = contour_along(proof.recording, proof.plan, proof.spec.lag_s)
    assert along is not None
    times_s, away_m = along
    assert report["worst_m"] == pytest.approx(float(away_m.max()), rel=1e-9)
    assert report["worst_s"] == pytest.approx(float(times_s[away_m.argmax()]), abs=1e-9)
    judged = next(r for r in proof.verdict.results if r.name == "contour_error")
    assert 0.0 < report["worst_m"] <= judged.measured * (1.0 + 1e-9)
    assert report["limit_m"] == judged.limit and report["at"] == "load"


def test_live_contour_is_reported_during_the_run(proof: Proof) -> None:
    """Samples are measured during the run: a report is at most the lag and a piece old."""
    live = LiveContour.of(proof.plan, proof.spec, proof.recording.channels)
    assert live is not None
    count = [0]

    def most_of_it() -> bool:
        count[0] += SMALL
        return count[0] >= 700

    fed(proof, live, most_of_it)
    end = time.monotonic() + 100.0
    while live.report() is None:
        assert time.monotonic() < end
        time.sleep(0.02)
    report = live.report()
    assert report is not None
    assert 0.0 <= report["now_m"] <= report["worst_m"]
    given_s = count[0] * float(proof.recording.channels[0].clock.period_s)
    assert 0.0 <= report["worst_s"] <= given_s < proof.plan.duration_s
    live.close()


def test_live_contour_needs_a_measured_position(proof: Proof) -> None:
    """Without the load's position the encoder is read; without an encoder there is no error."""
    kinds = (ChannelKind.LOAD, ChannelKind.TOOL)
    encoders = tuple(c for c in proof.recording.channels if c.kind not in kinds)
    live = LiveContour.of(proof.plan, proof.spec, encoders)
    assert live is not None
    fed(proof, live)
    live.close()
    report = live.report()
    assert report is not None and report["at"] == "encoder" and report["worst_m"] > 0.0
    blind = tuple(c for c in encoders if c.kind is not ChannelKind.MEASURED)
    assert LiveContour.of(proof.plan, proof.spec, blind) is None
    assert LiveContour.of(proof.plan, replace(proof.spec, criteria=()), encoders) is None


def test_a_sink_beside_another_gets_all(proof: Proof) -> None:
    first, second = MemorySink(), MemorySink()
    both = Also(first, second)
    both.begin(proof.recording.channels, True)
    for block in proof.recording:
        both.block(block)
    assert len(first.blocks) == len(second.blocks) > 0


@pytest.fixture
def project(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.getbasetemp() / "proven-project"
    folder.mkdir(exist_ok=True)
    proven(folder)
    yield folder


@pytest.mark.long(shown_by="test_live_contour_is_reported_during_the_run")
def test_a_run_tells_its_error_ten_times_a_second_and_keeps_the_worst(project: Path) -> None:
    with served(project, 0.9) as client, operator(client) as anna:
        started(anna.ready())
        anna.heard.clear()
        anna.see("idle")
        seen = [
            (one["progress"]["time_s"], one["progress"]["contour"])
            for one in anna.heard
            if one["type"] == "state" and one["state"] == "running"
        ]
        contours = [contour for _, contour in seen if contour is not None]
        first, last = (next(t for t, c in way if c is not None) for way in (seen, seen[::-1]))
        assert first < 0.5 * last
        moved = [one for one in seen if one[0] >= first]
        assert len(contours) == len(moved)
        fresh = np.count_nonzero(np.diff([one["now_m"] for one in contours]))
        assert fresh >= 10.0 * (last - first) * 0.5  # half of them: a busy computer
        assert contours[-1]["limit_m"] == pytest.approx(LIMIT_M)
        while not (anna.hear()["type"] == "state" and anna.state["progress"]["verdict"]):
            pass
        kept = anna.state["progress"]["contour"]
        assert kept["worst_m"] >= max(one["worst_m"] for one in contours) > 0.0
        assert 0.0 < kept["worst_s"] < anna.state["progress"]["duration_s"] + 1.0
