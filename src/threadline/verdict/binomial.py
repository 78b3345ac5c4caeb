"""The exact confidence interval of a proportion."""

from __future__ import annotations

CONFIDENCE = 0.95


def clopper_pearson(passed: int, tried: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the exact two-sided interval of a proportion: ``passed`` of ``tried`` were counted.

    Clopper and Pearson (1934), "The use of confidence or fiducial limits illustrated in the case
    of the binomial".

    >>> low, high = clopper_pearson(10_000, 10_000)
    >>> f"{low:.5f} {high}"
    '0.99963 1.0'
    """
    from scipy.special import betaincinv  # slow to import, and asked for by few commands

    tail = 0.5 * (1.0 - confidence)
    low = 0.0 if not passed else float(betaincinv(passed, tried - passed + 1, tail))
    high = 1.0 if passed == tried else float(betaincinv(passed + 1, tried - passed, 1.0 - tail))
    return low, high
