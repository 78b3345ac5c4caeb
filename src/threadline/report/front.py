"""The front of cost against yield of a redesign: its table and its picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from threadline.search.design import DesignResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def front_title(result: DesignResult) -> str:
    """Return the title of the table, with the number of machines."""
    return f"Cost against yield: {result.front[0].machines} machines of each"


def front_rows(result: DesignResult) -> tuple[list[str], list[list[str]]]:
    """Return the candidates by their cost, each with its yield and its interval at 95 %."""
    names = list(result.space.names)
    rows = [
        [
            *(f"{one.factors[name]:.3g}" for name in names),
            f"{one.cost:.3f}",
            f"{one.passed}",
            f"{100.0 * one.interval[0]:.1f} to {100.0 * one.interval[1]:.1f} %",
            "yes" if one.on_front else "no",
        ]
        for one in result.front
    ]
    return [*names, "cost", "in spec", "yield", "on the front"], rows


def front_figure(result: DesignResult) -> Figure:
    """Draw the yield over the cost, with its interval; the front is a line."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 4.2))
    panel: Axes = figure.subplots()
    for mark, on_front in (("o", True), ("x", False)):
        some = [one for one in result.front if one.on_front is on_front]
        shares = np.array([one.share for one in some])
        low, high = np.array([one.interval for one in some]).reshape(-1, 2).T
        panel.errorbar(
            [one.cost for one in some],
            100.0 * shares,
            100.0 * np.array([shares - low, high - shares]),
            fmt=mark, color="black", capsize=2,
            label="on the front" if on_front else "no more yield than a cheaper one",
        )  # fmt: skip
    front = [one for one in result.front if one.on_front]
    panel.step(
        [one.cost for one in front], [100.0 * one.share for one in front], where="post",
        color="#0072B2", label="most yield for the cost",
    )  # fmt: skip
    panel.set_ylim(-3.0, 103.0)
    panel.set_xlabel("cost: sum of weight x |ln factor|")
    panel.set_ylabel("yield, 95 % interval [%]")
    panel.set_title(front_title(result))
    panel.legend()
    return figure
