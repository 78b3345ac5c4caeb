"""The judge of many runs beside the judge of one, on the processor's time of one core.

Every criterion of the machine's own specification, simulation included on both sides: 256 variants
in one part against one after the other. The figures themselves are the same to 1e-12.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.options import options_of
from threadline.pipeline import plan_job
from threadline.search.judge_runs import AT_ONCE, RunsJudge
from threadline.signals import tick_table
from threadline.twin import simulate, simulate_batch
from threadline.verdict import judge, load_spec

EXAMPLES = Path(__file__).parents[1] / "examples"
CASES = (("x-180", "linear"), ("cone-dome-cylinder", "auto"))
ROUNDS = 5


def _cpu_s(work: Callable[[], object]) -> float:
    work()
    found = []
    for _ in range(ROUNDS):
        begun = time.process_time()
        work()
        found.append(time.process_time() - begun)
    return min(found)


def _entry(name: str, interpolation: str) -> dict[str, Any]:
    machine = load_machine("lathe-winder")
    spec = load_spec(None, machine)
    options = options_of(interpolation, None, "0.1 mm")
    plan = plan_job(read_job(EXAMPLES / f"{name}.prg", machine), machine, options)
    table, random = tick_table(plan.commands), np.random.default_rng(1994)
    phases = random.random((AT_ONCE, len(machine.axes)))
    body = machine.bodies["x"].inertia.si
    numbers = {"bodies.x.inertia": body * random.uniform(0.95, 1.05, AT_ONCE)}
    runs = RunsJudge(plan, spec, threads=1)
    many_s = _cpu_s(lambda: runs.judged(numbers, phases)) / AT_ONCE
    one_s = _cpu_s(lambda: judge([simulate(table, machine)], plan, spec))
    twin_s = _cpu_s(
        lambda: simulate_batch(table, machine, numbers, encoder_phase=phases, threads=1)
    )
    return {
        "name": f"batch judge vs single judge, {name}",
        "ours": many_s,
        "peer": "single judge",
        "peer_value": one_s,
        "ratio": one_s / many_s,
        "unit": "s",
        "note": f"a variant, simulated and judged by every criterion; simulated alone, no sample "
        f"kept, {1e3 * twin_s / AT_ONCE:.2g} ms",
    }


def run() -> list[dict[str, Any]]:
    """Return an entry for each program."""
    return [_entry(*case) for case in CASES]
