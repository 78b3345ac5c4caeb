"""What feed-forward asks of the drives, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from threadline.control import Demand


def feed_forward_lines(demands: Sequence[Demand]) -> Iterator[str]:
    """Yield a line per axis: what its model needs, and which limit is nearest."""
    for demand in demands:
        current = (
            f"{demand.current_a:.1f} A of {demand.current_limit_a:g} A, "
            if demand.current_a is not None
            else ""
        )
        yield (
            f"feed-forward, {demand.axis}:".ljust(22)
            + f"{current}{demand.volts:.2f} V of {demand.volt_limit:g} V "
            f"({demand.share:.0%} of the {demand.bound_by})"
        )


def feed_forward_warnings(demands: Sequence[Demand]) -> Iterator[str]:
    """Yield a warning for every axis whose reference needs more than there is."""
    for demand in demands:
        if demand.share <= 1.0:
            continue
        if demand.bound_by == "current":
            need = (
                f"{demand.current_a:.1f} A at {demand.current_at_s:.3f} s; its amplifier gives "
                f"{demand.current_limit_a:g} A"
            )
        else:
            need = f"{demand.volts:.2f} V; its controller puts out {demand.volt_limit:g} V"
        yield (
            f"axes.{demand.axis}: the reference needs {need}. Smooth it over a longer time, "
            "or lower the speed"
        )
