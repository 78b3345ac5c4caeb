"""A thousand holds at random instants of runs: no row skipped or repeated, none off the path.

And at each tick the axes are told where the table is at the plan's time that the machine tells.
Then runs in which the loads follow, held at random instants: each has to be judged as one that
nobody held.

``python -m tools.random_holds [COUNT]``; a minute of processor for 1000, with 60 runs judged.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from tests.live.bench import Bench, table_of_counts, winder
from tests.live.test_held_runs import SPEC, alike, plan_of
from tests.live.test_pace import plan_ticks
from tests.live.test_tail import PLACES, ROWS, off_path

from threadline.files import RunEnd
from threadline.live.states import Cause, State
from threadline.proof.pipeline import simulate
from threadline.verdict import judge

_HALF_COUNT = 0.5 + 1e-6
_JUDGED = 60


def run_with_holds(random: np.random.Generator) -> tuple[int, bool]:
    """Hold and go on at random instants, some while it still brakes; return holds and if sound."""
    bench, holds = Bench().ready(), 0
    bench.executor.start(table_of_counts(ROWS))
    while True:
        bench.go_on(bench.executor.tick + int(random.integers(0, 110)))
        if bench.executor.over or bench.executor.state is not State.RUNNING:
            break
        bench.desk.ask(Cause.HOLD)
        bench.executor.obey()
        holds += 1
        bench.go_on(bench.executor.tick + int(random.choice([0, 5, 15, 60])))
        bench.desk.ask(Cause.RESUME)
        bench.executor.obey()
        if holds == 8:
            break
    bench.go_on()
    counts = bench.commanded()
    steps = np.diff(counts[:, 0])
    sound = (
        bench.executor.ended == (RunEnd.COMPLETED, "")
        and counts[-1].tolist() == ROWS.sum(axis=0).tolist()
        and 0 <= steps.min() <= steps.max() <= 11
        and off_path(counts) <= 1.0
        and off_plan(counts, plan_ticks(bench.sink.blocks, len(counts))) <= _HALF_COUNT
    )
    return holds, bool(sound)


def judged_with_holds(random: np.random.Generator, runs: int) -> tuple[int, int]:
    """Hold runs of loads that follow; return holds, and how many runs are not judged as unheld."""
    with TemporaryDirectory() as folder:
        plan = plan_of(Path(folder))
        unheld, holds, wrong = judge([simulate(plan.commands, winder())], plan, SPEC), 0, 0
        for _ in range(runs):
            bench = Bench().ready()
            bench.executor.start(plan.commands, pass_stops=True, loads_follow=True)
            for wait in random.integers(1, 250, size=int(random.integers(1, 5))).tolist():
                bench.go_on(bench.executor.tick + wait)
                if bench.executor.over or bench.executor.state is not State.RUNNING:
                    break
                bench.desk.ask(Cause.HOLD)
                bench.executor.obey()
                holds += 1
                bench.go_on(bench.executor.tick + int(random.choice([0, 5, 15, 60, 200])))
                bench.desk.ask(Cause.RESUME)
                bench.executor.obey()
            bench.go_on()
            wrong += not alike(judge([bench.sink.recording(plan)], plan, SPEC), unheld)
    return holds, wrong


def off_plan(counts: np.ndarray, ticks: np.ndarray) -> float:
    """Return how far (n, 3) counts are from the table at (n,) ticks of it, in counts."""
    at = np.minimum(ticks, len(ROWS))
    meant = [np.interp(at, np.arange(len(PLACES)), column) for column in PLACES.T]
    return float(np.abs(counts - np.stack(meant, axis=1)).max())


def main() -> None:
    """Print how many holds there were, and in how many runs something was wrong."""
    wanted = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    random, holds, wrong = np.random.default_rng(15), 0, 0
    while holds < wanted:
        more, sound = run_with_holds(random)
        holds, wrong = holds + more, wrong + (not sound)
    print(f"{holds} holds, wrong runs: {wrong}")
    holds, wrong = judged_with_holds(random, _JUDGED)
    print(f"{holds} holds in {_JUDGED} runs that were judged, otherwise than unheld: {wrong}")


if __name__ == "__main__":
    main()
