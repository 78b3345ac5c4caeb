"""Sensitivities of a yield, and the cheapest tolerances, as tables and as JSON content."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.progress import Progress
from threadline.base.workers import Done
from threadline.cli.output import print_table, say
from threadline.machine.numbers import number_at
from threadline.proof.worst_machine import shares_of
from threadline.search.influence import MACHINES, CheapestSet, Influence, influence, judgements
from threadline.search.machine_yield import MachineYield, yield_words

SAMPLES = 256
_SAMPLES_SERIAL = 16  # number of samples if machines are simulated one by one


def counted(progress: Progress, what: str, total: int | None = None) -> Done:
    """Return a callback that reports progress from the number of machines judged.

    A search has no known total: it reports how many machines it has tried.
    """
    judged_count = 0.0

    def done(count: float) -> None:
        nonlocal judged_count
        judged_count += count
        if total is None:
            progress(f"{what}, {judged_count:.0f} tried", 0.0)
        else:
            progress(what, min(judged_count / total, 1.0))

    return done


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivities:
    """Sensitivity of the yield to each tolerance.

    Parameters
    ----------
    indices
        Sobol indices of the largest share of a limit.
    halved
        (n,) yield of ``machines`` machines, with one of the n tolerances halved.
    own
        Yield of the same machines with every tolerance as in the file.
    machines
        Number of machines from which each yield is counted.
    """

    indices: Influence
    halved: FloatArray
    own: float
    machines: int


def sensitivities_of(
    judged: MachineYield, variants: int, seed: int, progress: Progress
) -> Sensitivities:
    """Return the sensitivities; use at most ``variants`` machines if simulated one by one."""
    normal = [number.normal for number in judged.numbers]
    machines = MACHINES if judged.together else min(MACHINES, variants)
    samples = SAMPLES if judged.together else _SAMPLES_SERIAL
    total = (len(normal) + 1) * machines + judgements(len(normal), samples)
    done = counted(progress, "what the yield depends on", total)

    def result(parts: np.ndarray) -> np.ndarray:
        shares, _ = shares_of(judged.judged(parts, done))
        return np.minimum(shares, 10.0)

    indices = influence(result, normal, samples, seed)
    own_share = judged.drawn(machines, seed, done).share
    halved = judged.halved(machines, seed, done)
    return Sensitivities(indices=indices, halved=halved, own=own_share, machines=machines)


def show_sensitivities(sensitivities: Sensitivities, judged: MachineYield) -> None:
    """Print the sensitivities, the number with the largest total index first."""
    indices = sensitivities.indices
    rows = [
        [
            number.name,
            _within(indices.first[k], indices.first_interval[:, k]),
            _within(indices.total[k], indices.total_interval[:, k]),
            f"{100.0 * sensitivities.halved[k]:.2f} %",
        ]
        for k, number in enumerate(judged.numbers)
    ]
    rows = [rows[k] for k in np.argsort(-indices.total, kind="stable")]
    head = ["number", "alone", "with others", "yield if halved"]
    share_text = f"of {sensitivities.machines} machines {sensitivities.own:.2%} in spec"
    print_table(f"what the yield depends on; {share_text}", head, rows)


def _within(share: float, ends: FloatArray) -> str:
    """Return an index with the ends of its 95 % interval."""
    # Adding zero makes a zero of minus zero.
    low, high = (f"{round(float(end), 2) + 0.0:.2f}" for end in ends)
    return f"{round(float(share), 2) + 0.0:.2f} ({low} to {high})"


def sensitivity_content(sensitivities: Sensitivities, judged: MachineYield) -> dict[str, Any]:
    """Return the sensitivities as JSON content."""
    indices = sensitivities.indices
    return {
        "machines": sensitivities.machines,
        "yield": sensitivities.own,
        "numbers": [
            {
                "name": number.name,
                "first": float(indices.first[k]),
                "first_interval": indices.first_interval[:, k].tolist(),
                "total": float(indices.total[k]),
                "total_interval": indices.total_interval[:, k].tolist(),
                "yield_if_halved": float(sensitivities.halved[k]),
            }
            for k, number in enumerate(judged.numbers)
        ],
    }


def show_set(found: CheapestSet, judged: MachineYield, yield_goal: str) -> None:
    """Print which tolerances to halve, and the yield of machines with these tolerances."""
    words = (
        f"{found.passed} of {found.tried} machines in spec, {yield_words(found.interval)} of all"
    )
    if not found.reached:
        say(f"no set of tolerances was found that reaches {yield_goal}; the best of them: {words}")
        return
    rows = []
    for number, factor in zip(judged.numbers, found.factors.tolist(), strict=True):
        if factor < 1.0:
            quantity = number_at(judged.plan.machine, number.numbers[0])
            relative = quantity.tolerance_si / abs(quantity.si) if quantity.si else 0.0
            present_text, new_text = (
                f"+-{100.0 * relative * f:.3g} %" if relative else "" for f in (1.0, factor)
            )
            rows.append([number.name, present_text, new_text, f"1/{1.0 / factor:.0f}"])
    head = ["number", "tolerance", "instead", "of it"]
    print_table(f"cheapest set that reaches {yield_goal}: {found.halvings} halvings", head, rows)
    say(f"with it: {words}")


def set_content(found: CheapestSet, judged: MachineYield) -> dict[str, Any]:
    """Return the tolerances to halve and the resulting yield as JSON content."""
    return {
        "reached": found.reached,
        "halvings": found.halvings,
        "passed": found.passed,
        "machines": found.tried,
        "interval": list(found.interval),
        "factors": {
            number.name: factor
            for number, factor in zip(judged.numbers, found.factors.tolist(), strict=True)
            if factor < 1.0
        },
    }
