"""The place where the next hold of a run takes effect."""

from __future__ import annotations

from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.live.path_window import REST_S


def next_hold(rests_s: FloatArray | None, time_s: float) -> dict[str, Any]:
    """Return where a hold that is asked for now takes effect, as fields of ``Progress``.

    Parameters
    ----------
    rests_s
        (n, 2) begin and end of the rests for which a hold waits, s; None: it takes effect at once.
    time_s
        Instant of the plan, s.

    Examples
    --------
    >>> next_hold(np.array([[1.0, 2.0], [5.0, 6.0]]), 1.97)
    {'hold': 'at a rest', 'hold_at_s': 5.0}
    >>> next_hold(np.zeros((0, 2)), 1.0)
    {'hold': 'at the end', 'hold_at_s': None}
    """
    if rests_s is None:
        return {"hold": "at once", "hold_at_s": None}
    ahead = rests_s[rests_s[:, 1] - np.maximum(rests_s[:, 0], time_s) >= REST_S - 1e-9]
    if not len(ahead):
        return {"hold": "at the end", "hold_at_s": None}
    return {"hold": "at a rest", "hold_at_s": round(float(max(ahead[0, 0], time_s)), 3)}
