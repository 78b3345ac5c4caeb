"""The criteria that a winder's product, and the spool of its fibre, add to a specification."""

from __future__ import annotations

from collections.abc import Sequence

from threadline.machine.spool import Spool
from threadline.verdict.replayed import least_friction
from threadline.verdict.types import Criterion
from threadline.winding.product import Product

_LEAST_M = 5e-5  # lifted or bridged: a tow is thicker
MOST_VARIATION = 0.05
"""Largest allowed variation of the tension, as the winder thesis has it (section 2.4)."""


def criteria_of(
    product: Product, spool: Spool | None = None, tensions_n: Sequence[float] = ()
) -> tuple[Criterion, ...]:
    """Return the criteria that a product asks for, beside the criteria of the specification.

    With a spool its arm limits the slack, unless the product says what is taken up, and the
    tension may vary by ``MOST_VARIATION``. A brake that can be set follows the tensions of the
    layers; the least that the arm takes up at one of them counts.
    """
    slip = least_friction(product)
    take_up = product.take_up
    if take_up is None and spool is not None:
        follows = tensions_n if spool.most_torque is not None else ()
        take_up = min((spool.take_up_at(one) for one in follows), default=spool.take_up_m)
    wanted: dict[str, float | None] = {
        "planned_slip_tendency": slip,
        "planned_bridging": _LEAST_M,
        "planned_lifting": _LEAST_M,
        "slip_tendency": slip,
        "bridging": _LEAST_M,
        "lifting": _LEAST_M,
        "clearance": 0.0,
        "slack": take_up,
        "laid_error": None,
        "free_length": None,
        "fibre_speed": None,
        "fibre_speed_variation": None,
        "planned_pattern_closure": None,
        "pattern_closure": None,
    }
    if product.covered is not None:
        wanted |= {"planned_coverage_gap": product.gap, "coverage_gap": product.gap}
    found = [
        Criterion(name=name, limit=limit, required=limit is not None)
        for name, limit in wanted.items()
    ]
    if spool is not None:
        # Not required: a real machine may have no sensor of the tension.
        found.append(Criterion(name="tension_variation", limit=MOST_VARIATION))
    return tuple(found)
