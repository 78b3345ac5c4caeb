"""The judge of many runs beside the judge of one and beside the twin, on one core's processor time.

Every criterion of the machine's own specification. Beside the judge of one, simulation is included
on both sides: 256 variants in one part against one after the other; the figures themselves are the
same to 1e-12. Beside the twin, what it takes to write the samples that are judged is its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.dynamics.values import Values
from threadline.files import ChannelKind, tick_table
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.judge_runs import AT_ONCE, RunsJudge, cached_in_memory
from threadline.proof.options import options_of
from threadline.proof.pipeline import plan_job
from threadline.twin import BatchOptions, simulate, simulate_batch, simulate_runs
from threadline.verdict import Spec, judge, load_spec, needed_channels

EXAMPLES = Path(__file__).parents[1] / "examples"
CASES = (("x-180", "linear"), ("cone-dome-cylinder", "auto"))
ROUNDS = 5


def _cpu_s(*works: Callable[[], object]) -> list[float]:
    """Return the least processor time of each of several works, done in turns."""
    found: list[list[float]] = [[] for _ in works]
    for _ in range(ROUNDS + 1):
        for work, times in zip(works, found, strict=True):
            begun = time.process_time()
            work()
            times.append(time.process_time() - begun)
    return [min(times[1:]) for times in found]


class _Case(NamedTuple):
    """A program as planned, the specification, and 256 machines with their encoder phases."""

    plan: Plan
    spec: Spec
    numbers: dict[str, FloatArray]
    phases: FloatArray


def _case(name: str, interpolation: str) -> _Case:
    machine = load_machine("lathe-winder")
    options = options_of(interpolation, None, "0.1 mm")
    plan = plan_job(read_job(EXAMPLES / f"{name}.prg", machine), machine, options)
    random = np.random.default_rng(1994)
    phases = random.random((AT_ONCE, len(machine.axes)))
    body = machine.bodies["x"].inertia.si
    numbers = {"bodies.x.inertia": body * random.uniform(0.95, 1.05, AT_ONCE)}
    return _Case(cached_in_memory(plan), load_spec(None, machine), numbers, phases)


def _beside_single(name: str, case: _Case) -> dict[str, Any]:
    plan, spec, numbers, phases = case
    machine, table = plan.machine, tick_table(plan.commands)
    runs = RunsJudge(plan, spec, threads=1)
    (many_s,) = _cpu_s(lambda: runs.judged(numbers, phases))
    many_s /= AT_ONCE
    (one_s,) = _cpu_s(lambda: judge([simulate(table, machine)], plan, spec))
    (twin_s,) = _cpu_s(
        lambda: simulate_batch(
            table, machine, numbers, encoder_phase=phases, options=BatchOptions(threads=1)
        )
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


def _beside_twin(name: str, case: _Case) -> dict[str, Any]:
    plan, spec, numbers, phases = case
    table, kinds = tick_table(plan.commands), needed_channels(spec)
    kinds = (ChannelKind.COMMANDED, ChannelKind.OPERATION, *kinds)
    values = Values.of(plan.machine, numbers)
    runs = RunsJudge(plan, spec, threads=1)

    def simulated() -> None:
        for _ in simulate_runs(table, values, encoder_phase=phases, kinds=kinds):
            pass

    both = _cpu_s(lambda: runs.judged(numbers, phases), simulated)
    ours, twin = (found / AT_ONCE for found in (both[0] - both[1], both[1]))
    return {
        "name": f"judging vs simulating, {name}",
        "ours": ours,
        "peer": "simulating",
        "peer_value": twin,
        "ratio": twin / ours,
        "unit": "s",
        "note": "a variant judged by every criterion, against simulated with every sample that is "
        "judged; the two were timed in turns",
    }


def run() -> list[dict[str, Any]]:
    """Return two entries for each program."""
    cases = [(name, _case(name, interpolation)) for name, interpolation in CASES]
    return [entry(*case) for entry in (_beside_single, _beside_twin) for case in cases]
