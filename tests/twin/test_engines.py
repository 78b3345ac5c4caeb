"""Engines are shared for the same machine, numbers and start, and for nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.motion.path.builders import job_of
from threadline.dynamics.values import Values
from threadline.files import tick_table
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.twin.simulate import engine_of, simulate

WINDER = load_machine("lathe-winder")
INERTIA = "bodies.x.inertia"


def of(inertia: list[float]) -> Values:
    return Values.of(WINDER, {INERTIA: np.array(inertia)})


def test_machines_with_different_numbers_get_separate_engines() -> None:
    start = np.zeros(len(WINDER.axes))
    first = engine_of(of([3.6e-4, 3.7e-4]), start)
    assert engine_of(of([3.6e-4, 3.7e-4]), start.copy()) is first
    others = (
        engine_of(of([3.6e-4, 3.7e-4 * (1.0 + 1e-15)]), start),
        engine_of(of([3.6e-4]), start),
        engine_of(Values.of(WINDER), start),
        engine_of(Values.of(WINDER, {"bodies.y.inertia": np.array([3.6e-4, 3.7e-4])}), start),
        engine_of(of([3.6e-4, 3.7e-4]), start + 1e-15),
        engine_of(of([3.6e-4, 3.7e-4]), start, tuple(1e4 for _ in first.rates)),
        engine_of(Values.of(replace(WINDER), dict(of([3.6e-4, 3.7e-4]).replaced)), start),
    )
    assert len({id(engine) for engine in (first, *others)}) == 8
    assert engine_of(of([3.6e-4, 3.7e-4]), start) is first
    for k in range(8):  # the last eight are kept
        engine_of(of([4e-4 + 1e-6 * k]), start)
    assert engine_of(of([3.6e-4, 3.7e-4]), start) is not first


def test_many_variants_are_not_kept() -> None:
    start = np.zeros(len(WINDER.axes))
    many = of(np.linspace(3e-4, 4e-4, 65).tolist())
    assert engine_of(many, start) is not engine_of(many, start)


def test_runs_that_share_an_engine_do_not_touch_each_other() -> None:
    """Two recordings of different commands, read in turns, equal those that are read alone."""
    tables = []
    for way in (0.01, -0.02):
        job = job_of([[0.0], [way], [0.0]], ("X",), None)
        tables.append(tick_table(plan_job(job, WINDER, Options()).commands))

    def loads(recording) -> np.ndarray:
        return np.concatenate([block.samples["X.load"] for block in recording])

    one_by_one = [loads(simulate(table, WINDER)) for table in tables]
    both = [iter(simulate(table, WINDER)) for table in tables]
    turns: list[list[np.ndarray]] = [[], []]
    for blocks in zip(*both, strict=False):
        for k, block in enumerate(blocks):
            turns[k].append(block.samples["X.load"])
    for k, rest in enumerate(both):
        turns[k] += [block.samples["X.load"] for block in rest]
        assert np.concatenate(turns[k]).tolist() == one_by_one[k].tolist()
