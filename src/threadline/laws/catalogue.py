"""The motion laws by name."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import OptionError
from threadline.laws.forms import Phase, Phases, Power, chained
from threadline.wording import nearest

LEAST_HEAT = 12.0  # integral of the squared acceleration of the cubic law, the least possible


@dataclass(frozen=True, slots=True, kw_only=True)
class Law:
    """A normalised motion from rest to rest: rise 1 in time 1, the second half mirroring the first.

    Parameters
    ----------
    name
        Hyphenated, as on the command line.
    velocity, acceleration, jerk
        Peaks of the derivatives (Cv, Ca, Cj), exact; None where the jerk is infinite because the
        acceleration steps.
    form
        The rise on [0, 1/2].
    """

    name: str
    velocity: float
    acceleration: float
    jerk: float | None
    form: Phases | Power

    def __call__(self, t: FloatArray | float, derivative: int = 0) -> FloatArray:
        """Return the ``derivative``-th derivative (0 to 3) at ``t``; at rest outside [0, 1].

        At a step the value is that after it in the first half and before it in the second;
        impulses are left out.
        """
        if not 0 <= derivative <= 3:
            raise ValueError(f"derivative must be 0 to 3, got {derivative}")
        at = np.atleast_1d(np.asarray(t, dtype=np.float64))
        mirrored = at > 0.5
        half = np.clip(np.where(mirrored, 1.0 - at, at), 0.0, 0.5)
        value = self.form.value(half, derivative)
        if derivative == 0:
            return np.where(mirrored, 1.0 - value, value)
        outside = (at < 0.0) | (at > 1.0)
        sign = 1.0 if derivative % 2 else -1.0
        return np.where(outside, 0.0, np.where(mirrored, sign * value, value))

    @property
    def efficiency(self) -> float:
        """Heat of the cubic law, the least there is, over that of this law, for equal moves."""
        # Gauss-Legendre on 64 panels: every law is smooth between multiples of 1/24.
        nodes, weights = np.polynomial.legendre.leggauss(12)
        edges = np.linspace(0.0, 0.5, 25)
        middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
        t = (middle[:, None] + half[:, None] * nodes).ravel()
        heat = 2.0 * float((self(t, 2) ** 2 * (half[:, None] * weights).ravel()).sum())
        return LEAST_HEAT / heat


def law(name: str) -> Law:
    """Return the law called ``name``.

    Raises
    ------
    OptionError
        If there is none.
    """
    if name not in LAWS:
        raise OptionError(f"unknown motion law {name!r}", remedy=nearest(name, LAWS, "There are"))
    return LAWS[name]


def trapezoid(ramp: float = 1.0 / 3.0) -> Law:
    """Return the law of trapezoidal velocity whose ramps take ``ramp`` of the time each.

    Raises
    ------
    ValueError
        If ``ramp`` is not in (0, 1/2].
    """
    if not 0.0 < ramp <= 0.5:
        raise ValueError(f"ramp must be in (0, 1/2], got {ramp!r}")
    top = 1.0 / (1.0 - ramp)
    phases = [Phase(begin=0.0, end=ramp, c0=top / ramp), Phase(begin=ramp, end=0.5)]
    return Law(
        name="trapezoid", velocity=top, acceleration=top / ramp, jerk=None,
        form=Phases(chained(phases)),
    )  # fmt: skip


def trapezoidal_acceleration(ramp: float = 1.0 / 8.0) -> Law:
    """Return the law whose acceleration rises and falls over ``ramp`` of the time each.

    Raises
    ------
    ValueError
        If ``ramp`` is not in (0, 1/4].
    """
    if not 0.0 < ramp <= 0.25:
        raise ValueError(f"ramp must be in (0, 1/4], got {ramp!r}")
    top = 4.0 / (1.0 - 2.0 * ramp)
    phases = [
        Phase(begin=0.0, end=ramp, c1=top / ramp),
        Phase(begin=ramp, end=0.5 - ramp, c0=top),
        Phase(begin=0.5 - ramp, end=0.5, c0=top, c1=-top / ramp),
    ]
    return Law(
        name="trapezoidal-acceleration", velocity=2.0, acceleration=top, jerk=top / ramp,
        form=Phases(chained(phases)),
    )  # fmt: skip


def _single(
    c0: float = 0.0, c1: float = 0.0, b: float = 0.0, w: float = 1.0, p: float = 0.0
) -> Phases:
    return Phases(chained([Phase(begin=0.0, end=0.5, c0=c0, c1=c1, b=b, w=w, p=p)]))


def _modified_trapezoid() -> Law:
    top = 8.0 * pi / (pi + 2.0)
    phases = [
        Phase(begin=0.0, end=1 / 8, b=top, w=4.0 * pi),
        Phase(begin=1 / 8, end=3 / 8, c0=top),
        Phase(begin=3 / 8, end=1 / 2, b=top, w=4.0 * pi, p=pi / 2.0),
    ]
    return Law(
        name="modified-trapezoid", velocity=2.0, acceleration=top, jerk=4.0 * pi * top,
        form=Phases(chained(phases)),
    )  # fmt: skip


def _modified_sine() -> Law:
    top = 4.0 * pi**2 / (4.0 + pi)
    phases = [
        Phase(begin=0.0, end=1 / 8, b=top, w=4.0 * pi),
        Phase(begin=1 / 8, end=1 / 2, b=top, w=4.0 * pi / 3.0, p=pi / 2.0),
    ]
    return Law(
        name="modified-sine", velocity=4.0 * pi / (4.0 + pi), acceleration=top,
        jerk=4.0 * pi * top, form=Phases(chained(phases)),
    )  # fmt: skip


_ALL = (
    Law(
        name="double-parabola", velocity=2.0, acceleration=4.0, jerk=None, form=_single(c0=4.0)
    ),
    trapezoid(),
    Law(
        name="cubic", velocity=1.5, acceleration=6.0, jerk=None, form=_single(c0=6.0, c1=-12.0)
    ),
    Law(
        name="simple-harmonic", velocity=pi / 2.0, acceleration=pi**2 / 2.0, jerk=None,
        form=_single(b=pi**2 / 2.0, w=pi, p=pi / 2.0),
    ),
    Law(
        name="cycloidal", velocity=2.0, acceleration=2.0 * pi, jerk=4.0 * pi**2,
        form=_single(b=2.0 * pi, w=2.0 * pi),
    ),
    _modified_trapezoid(),
    _modified_sine(),
    Law(
        name="3-4-5", velocity=15.0 / 8.0, acceleration=10.0 / sqrt(3.0), jerk=60.0,
        form=Power((0.0, 0.0, 0.0, 10.0, -15.0, 6.0)),
    ),
    Law(
        name="4-5-6-7", velocity=35.0 / 16.0, acceleration=84.0 * sqrt(5.0) / 25.0, jerk=52.5,
        form=Power((0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0)),
    ),
    trapezoidal_acceleration(),
)  # fmt: skip
LAWS: dict[str, Law] = {each.name: each for each in _ALL}
