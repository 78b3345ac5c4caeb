"""A motion law: any rise from rest to rest, symmetric or not, closed or tabulated."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import OptionError
from threadline.laws.extremes import extremes, refuse_descent, steps
from threadline.laws.forms import Form
from threadline.laws.inverse_law import invert

LEAST_STRETCH = 1e-7
"""Share of the move's time; a shorter stretch is a step, whose derivatives are rounding."""
_SAME = 1e-9  # of the time: ends this close are one end, calculated in two ways
LEAST_HEAT = 12.0  # integral of the squared acceleration of the cubic law, the least possible


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Law:
    """A normalised motion from rest to rest: rise 1 in time 1.

    Parameters
    ----------
    name
        Hyphenated, as on the command line.
    velocity, acceleration, jerk
        Peaks of the magnitudes of the derivatives (Cv, Ca, Cj); None where the jerk is infinite
        because the acceleration steps.
    form
        The rise on [0, ``meets``].
    closing
        The rest of the rise as a function of the rest of the time, on [0, 1 - ``meets``]: the
        motion seen backwards from its end. None where the second half of the motion mirrors the
        first; then ``meets`` is 1/2.
    meets
        Time at which ``form`` hands over to ``closing``.
    """

    name: str
    velocity: float
    acceleration: float
    jerk: float | None
    form: Form
    closing: Form | None = None
    meets: float = 0.5

    def __call__(self, t: FloatArray | float, derivative: int = 0) -> FloatArray:
        """Return the ``derivative``-th derivative (0 to 3) at (n,) times; at rest outside [0, 1].

        Where a derivative jumps, the value after the jump is returned for times up to ``meets`` and
        the value before it for later ones. The impulse of jerk at a jump of acceleration is left
        out. A ValueError refuses other derivatives.
        """
        if not 0 <= derivative <= 3:
            raise ValueError(f"derivative must be 0 to 3, got {derivative}")
        at = np.atleast_1d(np.asarray(t, dtype=np.float64))
        late = at > self.meets
        value = np.empty_like(at)
        value[~late] = self.form.value(np.clip(at[~late], 0.0, self.meets), derivative)
        seen = self.left(np.clip(1.0 - at[late], 0.0, 1.0 - self.meets), derivative)
        if derivative == 0:
            value[late] = 1.0 - seen
            return value
        value[late] = seen if derivative % 2 else -seen
        value[(at < 0.0) | (at > 1.0)] = 0.0
        return value

    def left(self, before_end: FloatArray, derivative: int = 0) -> FloatArray:
        """Return the rest of the rise at (n,) times ``before_end``, counted back from the end.

        ``derivative`` counts derivatives by that time. Close to the end the rest is accurate to its
        last digits, as ``1 - s`` would not be.
        """
        closing = self.form if self.closing is None else self.closing
        return closing.value(before_end, derivative)

    def inverse(self, rise: FloatArray | float) -> FloatArray:
        """Return the (n,) times at which the law has risen to ``rise``, in [0, 1]: s(t(x)) = x.

        Where the law dwells at a rise, the earliest time of the dwell is returned.

        Raises
        ------
        ValueError
            If a rise is outside [0, 1].
        OptionError
            If the law goes back somewhere, and so meets a rise more than once.
        """
        refuse_descent(self)
        x = np.atleast_1d(np.asarray(rise, dtype=np.float64))
        if not bool(np.all((x >= 0.0) & (x <= 1.0))):
            worst = x[~((x >= 0.0) & (x <= 1.0))][0]
            raise ValueError(f"law {self.name}: a rise must be in [0, 1], got {worst}")
        early = x <= float(self.form.value(np.array([self.meets]), 0)[0])
        out = np.empty_like(x)
        out[early] = invert(self.form, self.meets, x[early])
        closing = self.form if self.closing is None else self.closing
        # 1 - x is exact from 1/2 on, and a rise is flat at both ends: solve for what is left.
        out[~early] = 1.0 - invert(closing, 1.0 - self.meets, 1.0 - x[~early], latest=True)
        return out

    @property
    def edges(self) -> FloatArray:
        """(n,) ends of the stretches on which the law is smooth, from 0 to 1."""
        closing = self.form if self.closing is None else self.closing
        first = [b for b in self.form.breaks if 0.0 < b < self.meets]
        last = [1.0 - b for b in closing.breaks if 0.0 < b < 1.0 - self.meets]
        ends = [0.0]
        for end in sorted((self.meets, *first, *last)):
            if min(end - ends[-1], 1.0 - end) > _SAME:
                ends.append(end)
        return np.array([*ends, 1.0])

    @property
    def efficiency(self) -> float:
        """Heat in the motor with the cubic law, the least of all, over the heat with this law.

        Heat is the integral of the squared acceleration of a move over the same distance and time.
        """
        t, weights = gauss(self.edges)
        heat = float(self(t, 2) ** 2 @ weights)
        return LEAST_HEAT / heat


def measured_law(name: str, form: Form, closing: Form | None = None, meets: float = 0.5) -> Law:
    """Return the law of the given forms, with peaks that are computed from them.

    The arguments are those of ``Law``. The jerk of the law is None where the acceleration jumps.
    """
    bare = Law(
        name=name, velocity=0.0, acceleration=0.0, jerk=None, form=form, closing=closing,
        meets=meets,
    )  # fmt: skip
    peaks = []
    for derivative in (1, 2, 3):
        low, _, high, _ = extremes(bare, derivative)
        peaks.append(max(-low, high))
    return Law(
        name=name, velocity=peaks[0], acceleration=peaks[1],
        jerk=None if steps(bare) else peaks[2], form=form, closing=closing, meets=meets,
    )  # fmt: skip


def gauss(edges: FloatArray, panels: int = 1, points: int = 16) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights of Gauss-Legendre quadrature between (n,) edges.

    Each stretch between two edges is divided into ``panels`` of ``points`` nodes.
    """
    nodes, weights = _of_one(points)
    parts = np.arange(panels) / panels
    begins = (edges[:-1, None] + np.diff(edges)[:, None] * parts).ravel()
    half = 0.5 * np.diff(np.append(begins, edges[-1]))
    t: FloatArray = ((begins + half)[:, None] + half[:, None] * nodes).ravel()
    return t, (half[:, None] * weights).ravel()


@cache
def _of_one(points: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights from -1 to 1, eigenvalues of a matrix: to find them takes time."""
    nodes, weights = np.polynomial.legendre.leggauss(points)
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights


def check_stretches(name: str, ends: Iterable[float]) -> None:
    """Refuse a law with a stretch shorter than ``LEAST_STRETCH``.

    Parameters
    ----------
    ends
        Where its stretches end, from the beginning of the move or before its end.

    Raises
    ------
    OptionError
        If one is shorter than ``LEAST_STRETCH``.
    """
    shortest = min((end - begin for begin, end in pairwise((0.0, *ends)) if end > begin), default=1)
    if shortest < LEAST_STRETCH:
        raise OptionError(
            f"motion law {name!r}: a stretch of it takes {shortest:.3g} of the time, the least is "
            f"{LEAST_STRETCH:g}",
            remedy="Give its stretches lengths that are closer to each other.",
        )
