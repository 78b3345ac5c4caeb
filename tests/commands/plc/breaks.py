"""Random breaks of homing and of the cycle: no output is ever left on.

``python -m tests.commands.plc.breaks`` counts them on blark's reading of the text;
``--compiled FOLDER`` on the C that matiec made of it (see ``compiled``). Each case goes on from a
scan of a run whose scans jitter: a broken beam, a missing enable or a late scan, of random length,
with buttons pressed and work by hand requested meanwhile and after it.
"""

from __future__ import annotations

import argparse
import random
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.commands.plc.compiled import Compiled
from tests.commands.plc.driving import Bench
from tests.commands.plc.machine import Plc
from tests.commands.plc.texts import controller

KINDS = ("light_grid", "enable", "late scan")
LONGEST = 12  # scans of a break
BEHIND = 3


def broken(trial: Bench, choose: random.Random) -> str:
    """Break a run off and press buttons; return the kind of break. Raises if an output stays on."""
    kind = choose.choice(KINDS)
    given = {} if kind == "late scan" else {kind: False}
    if kind == "late scan":
        trial.count += choose.randint(2, 20)  # at least 30 ms, less the jitter, of 25 ms
    assert trial.scan(**given) == set(), (kind, "in its first scan")
    assert trial.block["fault"], kind
    length = choose.randint(0, LONGEST)
    for scan in range(length + BEHIND):
        meddling: dict[str, bool | int] = {
            "start_button": choose.random() < 0.5,
            "home_button": choose.random() < 0.5,
            "manual": choose.random() < 0.5,
            "continuous": choose.random() < 0.5,
            "jog": choose.randint(0, 8),
        }
        assert trial.scan(**meddling, **(given if scan < length else {})) == set(), (kind, scan)
    assert trial.block["fault"], (kind, "until it is acknowledged")
    return kind


def breaks(begin: Callable[[], Plc], count: int, seed: int = 1) -> Iterator[str]:
    """Yield ``count`` breaks, one from each scan of ways home and cycles, one after the other."""
    choose = random.Random(seed)
    done = 0
    while True:
        seed += 1
        bench = Bench(begin(), jitter=0.2, seed=seed)
        for button in ("home_button", "start_button"):
            bench.press(button)
            while bench.block["busy"]:
                if done == count:
                    return
                yield broken(bench.fork(), choose)
                done += 1
                bench.scan()
            assert not bench.block["fault"], bench.block["fault_code"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=18_118)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--compiled", type=Path, default=None)
    asked = parser.parse_args()
    begin = (lambda: Compiled(asked.compiled)) if asked.compiled else controller
    counts = Counter(breaks(begin, asked.cases, asked.seed))
    summary = ", ".join(f"{counts[kind]} by {kind}" for kind in KINDS)
    print(f"{sum(counts.values())} breaks ({summary}): no output left on")


if __name__ == "__main__":
    main()
