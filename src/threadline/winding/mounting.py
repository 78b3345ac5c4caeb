"""A product on its machine: the mandrel that the twin of a winder with a spool turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from threadline.machine import Machine
from threadline.machine.spool import Mounted
from threadline.winding.product import product_of_text


def with_mandrel(machine: Machine, product: str | None) -> Machine:
    """Return ``machine`` with the mandrel of a product mounted, if it has a spool to unwind.

    Radius, place and slip come from the file, without their tolerances; the layers that grow on
    the mandrel are left out, as in the replay.

    Parameters
    ----------
    product
        Text of the product, as ``product_text``; None for no product.

    Raises
    ------
    JobError
        If the text is no product.
    """
    if machine.spool is None or product is None:
        return machine
    wound = product_of_text(product)
    surface = wound.surface
    if wound.radius_error.si:
        surface = surface.grown(wound.radius_error.si)
    tied = wound.tied
    mandrel = Mounted(
        nodes=surface.nodes,
        x=surface.x,
        r=surface.r,
        convex=surface.convex,
        at_m=wound.at.si,
        slip=wound.slip.si,
        friction=wound.friction.si - wound.friction.tolerance,
        tied_m=None if tied is None else float(surface.place_of(np.array([tied]))[0]),
    )
    return replace(machine, mounted=mandrel)
