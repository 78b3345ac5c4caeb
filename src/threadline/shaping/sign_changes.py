"""Where a function changes sign between two points at which a row of values says that it does."""

from __future__ import annotations

from collections.abc import Callable


def crossing(function: Callable[[float], float], start: float, end: float, *, xtol: float) -> float:
    """A root between ``start`` and ``end``, of which one has a positive value and one has not.

    Many points at once are rounded in another order than one by one. A root that lies on one of
    the two may show a change of sign to the row that found it and none to ``function``: then the
    end with the smaller value is the root, to rounding.

    >>> round(crossing(lambda x: x * x - 2.0, 1.0, 2.0, xtol=1e-12), 9)
    1.414213562
    >>> crossing(lambda x: x + 1e-17, 0.0, 1.0, xtol=1e-12)
    0.0
    """
    from scipy.optimize import brentq

    first, last = function(start), function(end)
    if (first > 0.0) == (last > 0.0):
        return start if abs(first) <= abs(last) else end
    return float(brentq(function, start, end, xtol=xtol, rtol=1e-15))
