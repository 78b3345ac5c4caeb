"""Print the tables of docs/results-onoff.md: a broken beam, the cycle step by step, and its levels.

Run as ``python -m tools.onoff_results [break | cycle | levels ...]``; without a name all of them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from threadline.commands.schedule import compile_schedule
from threadline.commands.schedule_options import shaping_of
from threadline.errors import PlanError
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, REPEATED, Proof, plan_job, prove, try_plan
from threadline.search.broken_beam import break_sweeps, move_sweep
from threadline.search.machine_yield import MachineYield
from threadline.verdict import Verdict, load_spec

JOB = Path("examples/letter-cycle.toml")
MICRO = 1e6
MACHINES = 10  # drawn within the tolerances; one that is out is enough
OWN = "letter-placer+whole-scans+own-damping"
PAPER = "letter-placer+whole-scans"
UM = ("um-zv", "um-zvd", "um-ei", "um-2ei")
CASES = (
    ("own damping", OWN, (None, "zv", *UM, "zv*um-2ei")),
    ("own, 50 % hysteresis", f"{OWN}+hysteresis", (None, "zv", *UM)),
    (
        "own damping, for the paper's mode",
        PAPER,
        ("zv:3.04Hz:0.17", "um-2ei:3.04Hz:0.17", "zv:3.04Hz:0.17*um-2ei:3.04Hz:0.17"),
    ),
    (
        "feet that give 0.17",
        f"{PAPER}+paper-damping",
        (None, "zv:3.04Hz:0.17", "um-2ei:3.04Hz:0.17", "zv:3.04Hz:0.17*um-2ei:3.04Hz:0.17"),
    ),
)


def row(cells: Sequence[str]) -> None:
    print("| " + " | ".join(cells) + " |", flush=True)


def broken() -> None:
    """Worst and mean over the instants of a break, and how far the twin is from them."""
    row(("shaper", "worst", "mean", "unbroken", "over the level"))
    row(["---"] * 5)
    for sweep in break_sweeps(load_machine("letter-placer")):
        sizes = sweep.ringing_m * MICRO
        numbers = [f"{v:.0f}" for v in (sizes.max(), sizes.mean(), sizes[-1])]
        row((sweep.name, *numbers, f"{sweep.over_level:.2f}"))
    print()
    row(("scheduled move", "worst", "twin's worst", "largest difference"))
    row(["---"] * 4)
    machine = load_machine(OWN)
    job = read_job(JOB, machine)
    for shaper in ("none", "zv", *UM):
        scheduled = compile_schedule(job, machine, shaping_of(machine, shaper))
        move = next(m for m in scheduled.moves if m.axis == "X")
        sweep, (instants, found) = move_sweep(scheduled, move, breaks=16)
        apart = found - np.interp(instants, sweep.times_s, sweep.ringing_m)
        numbers = [f"{v * MICRO:.0f}" for v in (sweep.ringing_m.max(), found.max())]
        row((shaper, *numbers, f"{np.abs(apart).max() * MICRO:.0f}"))


def cycle() -> None:
    """Half the peak-to-peak of the frame that each step leaves, and how long the cycle takes."""
    steps = ("descend", "cut", "lift", "across", "leave", "mount", "return")
    row(("case", "shaper", *steps, "cycle s", "verdict"))
    row(["---"] * (len(steps) + 4))
    for title, reference, shapers in CASES:
        machine = load_machine(reference)
        for shaper in shapers:
            try:
                proof = prove(JOB, machine, load_spec(None, machine), Options(shaper=shaper))
            except PlanError as error:
                row((title, shaper or "none", f"refused: {error.message}"))
                continue
            cells = [f"{_left(proof, 'X', s):.0f}/{_left(proof, 'Z', s):.0f}" for s in steps]
            took = proof.verdict.result("cycle_time").measured
            verdict = "in spec" if proof.verdict.passed else "out"
            row((title, shaper or "none", *cells, f"{took:.2f}", verdict))


def levels() -> None:
    """The most that a step leaves of each case in spec in one run: of 20 runs, of ten machines."""
    row(("case", "shaper", "nominal", "repeated", "over tolerances"))
    row(["---"] * 5)
    for title, reference, shapers in CASES:
        machine = load_machine(reference)
        spec = load_spec(None, machine)
        job = read_job(JOB, machine)
        for shaper in shapers:
            plan = plan_job(job, machine, Options(shaper=shaper))
            cells = []
            for trials in (NOMINAL, REPEATED):
                verdict = try_plan(plan, spec, trials).verdict
                cells.append(f"{_most(verdict)} um {'in spec' if verdict.passed else 'out'}")
                if not verdict.passed:
                    break
            else:
                held = MachineYield(plan, spec).drawn(MACHINES, 1)
                cells.append(f"{held.passed} of {MACHINES}")
            row((title, shaper or "none", *cells, *["out"] * (3 - len(cells))))


def _most(verdict: Verdict) -> str:
    measured = verdict.result("residual_vibration").measured
    return "-" if measured is None else f"{measured * MICRO:.0f}"


def _left(proof: Proof, axis: str, step: str) -> float:
    (found,) = [
        r.measured
        for r in proof.verdict.results
        if (r.name, r.axis, r.step) == ("residual_vibration", axis, step)
    ]
    return float("nan") if found is None else found * MICRO


SECTIONS: dict[str, Callable[[], None]] = {"break": broken, "cycle": cycle, "levels": levels}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("section", nargs="*", choices=[*SECTIONS, []])
    for name in parser.parse_args().section or SECTIONS:
        print(f"\n### {name}\n")
        SECTIONS[name]()


if __name__ == "__main__":
    main()
