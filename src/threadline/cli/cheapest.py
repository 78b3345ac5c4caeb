"""The cheapest set of tolerances that reaches a yield, as a table and as JSON content."""

from __future__ import annotations

from math import ceil, floor
from typing import Any

from threadline.cli.output import print_table, say
from threadline.machine.numbers import number_at
from threadline.search.cheapest_set import CheapestSet
from threadline.search.machine_yield import MachineYield


def yield_words(interval: tuple[float, float]) -> str:
    """Return between which shares a yield lies, rounded outwards: it never reads better than it is.

    >>> yield_words((0.989979, 0.99742)), yield_words((0.025 ** (1 / 10_000), 1.0))
    ('98.99 to 99.75 %', 'at least 99.963 %')
    """
    low, high = interval
    if high == 1.0:
        return f"at least {floor(1e5 * low) / 1e3:.5g} %"
    return f"{floor(1e4 * low) / 1e2:.4g} to {ceil(1e4 * high) / 1e2:.4g} %"


def show_set(found: CheapestSet, judged: MachineYield, wished: str) -> None:
    """Print which tolerances to halve, and the yield of machines with these tolerances."""
    words = (
        f"{found.passed} of {found.tried} machines in spec, {yield_words(found.interval)} of all"
    )
    if not found.reached:
        say(f"no set of tolerances was found that reaches {wished}; the best of them: {words}")
        return
    rows = []
    for number, factor in zip(judged.numbers, found.factors.tolist(), strict=True):
        if factor < 1.0:
            quantity = number_at(judged.plan.machine, number.numbers[0])
            own = quantity.tolerance_si / abs(quantity.si) if quantity.si else 0.0
            now, then = (f"+-{100.0 * own * f:.3g} %" if own else "" for f in (1.0, factor))
            rows.append([number.name, now, then, f"1/{1.0 / factor:.0f}"])
    head = ["number", "tolerance", "instead", "of it"]
    print_table(f"cheapest set that reaches {wished}: {found.halvings} halvings", head, rows)
    say(f"with it: {words}")


def set_content(found: CheapestSet, judged: MachineYield) -> dict[str, Any]:
    """Return the tolerances to halve and the yield they give as JSON content."""
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
