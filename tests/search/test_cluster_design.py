"""Candidates of a redesign on the workers of a cluster: the same bits as on one computer."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import threadline as tl
from tests.search.fleet import ROOT, Fleet
from threadline.base.cluster import Cluster, on_cluster
from threadline.errors import JobError, OptionError
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, Trials
from threadline.search import design
from threadline.search.design_evaluate import Effort, Evaluator, Tried
from threadline.search.design_judge import OtherRuns
from threadline.search.design_single_proofs import JobReader
from threadline.search.design_space import design_space
from threadline.verdict import load_spec

QUICK = Effort(sample_log2=4, settings_log2=3, proposals=12, rounds=3, trade_rounds=0, side=0)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    found = Fleet(tmp_path_factory.mktemp("fleet"), 2)
    yield found
    found.end()


def bits(found: Tried) -> list[bytes]:
    return [found.ratio.tobytes(), found.nominal.tobytes(), *(b.encode() for b in found.binding)]


@pytest.mark.long(
    shown_by="tests/search/test_cluster.py::test_an_answer_is_that_of_one_computer_to_the_bit"
)
@pytest.mark.parametrize(
    ("job", "machine", "widths_s", "count"),
    [
        ("letter-cycle.toml", "letter-placer", (), 3),  # proved one by one
        ("x-180.prg", "lathe-winder", (), 6),  # side by side
        ("x-180.prg", "lathe-winder", (0.02, 0.05), 2),  # each through its own inverse
    ],
)
def test_candidates_are_those_of_one_computer(
    job: str, machine: str, widths_s: tuple[float, ...], count: int, fleet: Fleet
) -> None:
    named = load_machine(machine)
    space = design_space(named, widths_s)
    options = Options(interpolation="linear") if machine == "lathe-winder" else Options()
    evaluator = Evaluator(
        space,
        JobReader.of(ROOT / "examples" / job, options),
        load_spec(None, named),
        options,
        OtherRuns.of(space, Trials(repeats=2) if not widths_s else NOMINAL),
        Effort(sample_log2=2),
    )
    random = np.random.default_rng(1)
    points = space.low + (space.high - space.low) * random.random((count, len(space.low)))
    points[0] = np.clip(np.zeros(len(space.low)), space.low, space.high)
    levels = np.zeros(count, dtype=np.int64)
    here = evaluator.tried(points, levels, beyond=np.inf)
    simulated = evaluator.simulated
    with on_cluster(fleet.address, print):
        there = evaluator.tried(points, levels, beyond=np.inf)
    assert bits(there) == bits(here)
    assert simulated > 0 and evaluator.simulated == 2 * simulated
    assert len(set(here.ratio.tolist())) > 1


@pytest.mark.long(
    shown_by="tests/search/test_cluster.py::test_an_answer_is_that_of_one_computer_to_the_bit"
)
def test_python_has_the_cluster_too(
    coarse_search: None, fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A yield, and a search for the fastest over tolerances: the same bits as on one computer."""
    job = tmp_path / "turn.prg"
    job.write_text("G91\nG1 X5 F1000\nG1 X-5\nM30\n")
    words = {"interpolation": "linear"}
    here = tl.yields(job, "lathe-winder", variants=12, **words)
    there = tl.yields(job, "lathe-winder", variants=12, cluster=fleet.address, **words)
    assert [row.values.tobytes() for row in there.found.rows] == [
        row.values.tobytes() for row in here.found.rows
    ]
    words |= {"level": "over tolerances", "low": "0.01 m/s", "high": "0.012 m/s"}
    sent: list[object] = []
    real = Cluster.answers

    def counted(self: Cluster, work: object, items: object, done: object) -> object:
        sent.append(work)
        return real(self, work, items, done)  # type: ignore[arg-type]

    monkeypatch.setattr(Cluster, "answers", counted)
    single = tl.fastest(job, "lathe-winder", **words)
    assert not sent
    shared = tl.fastest(job, "lathe-winder", cluster=fleet.address, **words)
    assert single.best is not None and sent
    assert (shared.best, shared.limited_by) == (single.best, single.limited_by)
    assert [r.measured for r in shared.of.best.found.verdict.results] == [
        r.measured for r in single.of.best.found.verdict.results
    ]


@pytest.mark.long(
    shown_by="tests/search/test_cluster.py::test_an_answer_is_that_of_one_computer_to_the_bit"
)
def test_a_proof_over_the_tolerances_is_the_same_on_the_cluster(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = tmp_path / "turn.prg"
    job.write_text("G91\nG1 X5 F1000\nG1 X-5\nM30\n")
    sent: list[object] = []
    real = Cluster.answers

    def counted(self: Cluster, work: object, items: object, done: object) -> object:
        sent.append(work)
        return real(self, work, items, done)  # type: ignore[arg-type]

    monkeypatch.setattr(Cluster, "answers", counted)
    words = {"level": "over tolerances", "interpolation": "linear"}
    alone = tl.prove(job, "lathe-winder", **words)  # type: ignore[arg-type]
    assert not sent
    shared = tl.prove(job, "lathe-winder", cluster=fleet.address, **words)  # type: ignore[arg-type]
    assert sent
    assert shared.verdict.results == alone.verdict.results
    assert shared.verdict.tolerances == alone.verdict.tolerances


@pytest.mark.long(
    shown_by="tests/search/test_cluster.py::test_an_answer_is_that_of_one_computer_to_the_bit"
)
def test_python_redesigns_on_the_cluster(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Workers judge the candidates and the drawn machines of ``tl.design``; the design is the same.

    A batch of candidates that is too small to be worth sending is judged on this computer.
    """
    monkeypatch.setattr(design, "THOROUGH", QUICK)
    job, spec = tmp_path / "turn.prg", tmp_path / "close.toml"
    job.write_text("G91\nG1 X5 F2000\nG1 X-5\nM30\n")
    spec.write_text(
        'name = "close"\n[[criteria]]\nname = "tracking_error"\naxis = "X"\nlimit = "1.06 mm"\n'
    )
    words = {"spec": spec, "interpolation": "linear", "front": 12}
    sent: list[object] = []
    real = Cluster.answers

    def counted(self: Cluster, work: object, items: object, done: object) -> object:
        sent.append(work)
        return real(self, work, items, done)  # type: ignore[arg-type]

    monkeypatch.setattr(Cluster, "answers", counted)
    here = tl.design(job, "lathe-winder", **words)
    assert not sent
    there = tl.design(job, "lathe-winder", cluster=fleet.address, **words)
    assert sent and here.found is not None and there.found is not None
    assert here.front and there.simulated == here.simulated
    for one, other in [
        (there.found.candidate, here.found.candidate),
        (there.pareto, here.pareto),
        (there.front, here.front),
    ]:
        assert repr(one) == repr(other)  # every digit of every number


def test_a_cluster_that_would_judge_nothing_is_refused_before_it_is_asked(tmp_path: Path) -> None:
    """No scheduler is at port 9: connecting to it would take ten seconds, with another error."""
    job = tmp_path / "turn.prg"
    job.write_text("G91\nG1 X5 F1000\nM30\n")
    for ask in (tl.prove, tl.compare, tl.fastest, tl.learn):
        for words, message in (
            ({}, "this level has none"),
            ({"yield_": "90 %"}, "machines of yield_="),
        ):
            with pytest.raises(OptionError, match=rf"{message}.*leave cluster= out"):
                ask(job, "lathe-winder", cluster="localhost:9", **words)  # type: ignore[operator]


def test_a_job_that_changed_since_is_refused(tmp_path: Path) -> None:
    """A worker reads the file at the same path."""
    file = tmp_path / "turn.prg"
    file.write_text("G91\nG1 X5 F1000\nM30\n")
    read, machine = JobReader.of(file, Options()), load_machine("lathe-winder")
    assert read(machine).name
    file.write_text("G91\nG1 X6 F1000\nM30\n")
    with pytest.raises(JobError, match="is not the job that the search began with"):
        read(machine)
