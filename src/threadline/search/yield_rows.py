"""The rows of a yield that people look at, and what a share of its machines come to."""

from __future__ import annotations

import numpy as np

from threadline.search.machine_yield import Yield
from threadline.verdict import CriterionRow


def limited_rows(found: Yield) -> list[CriterionRow]:
    """Return the criteria with a limit that depend on the machine, not on the plan alone.

    One that is required and was not measured is among them.
    """
    return [
        row
        for row in found.found.rows
        if row.limit is not None and not row.of_plan
        and ((row.values > 0.0).any() or row.missed.any())
    ]  # fmt: skip


def quantile(row: CriterionRow, share: float) -> float:
    """Return what ``share`` of the machines that were measured come to at most; NaN if none was.

    A machine whose motion grows without bound comes to infinity.
    """
    known = row.values[~np.isnan(row.values)]
    if not len(known):
        return float("nan")
    if np.isfinite(known).all():
        return float(np.quantile(known, share))
    # Between a number and infinity nothing can be interpolated.
    return float(np.quantile(known, share, method="inverted_cdf"))
