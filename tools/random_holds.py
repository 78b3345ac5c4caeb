"""A thousand holds at random instants of runs: no row skipped or repeated, none off the path.

And at each tick the axes are told where the table is at the plan's time that the machine tells.

``python -m tools.random_holds [COUNT]``; half a minute of processor for 1000.
"""

from __future__ import annotations

import sys

import numpy as np
from tests.live.bench import Bench, table_of_counts
from tests.live.test_pace import plan_ticks
from tests.live.test_tail import PLACES, ROWS, off_path

from threadline.live.states import Cause, State
from threadline.signals import Ended

_HALF_COUNT = 0.5 + 1e-6


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
        bench.executor.ended == (Ended.COMPLETED, "")
        and counts[-1].tolist() == ROWS.sum(axis=0).tolist()
        and 0 <= steps.min() <= steps.max() <= 11
        and off_path(counts) <= 1.0
        and off_plan(counts, plan_ticks(bench.kept.blocks, len(counts))) <= _HALF_COUNT
    )
    return holds, bool(sound)


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


if __name__ == "__main__":
    main()
