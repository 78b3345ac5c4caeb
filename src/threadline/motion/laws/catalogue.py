"""The motion laws by name."""

from __future__ import annotations

from collections.abc import Callable
from math import comb, pi, sqrt
from pathlib import Path

import numpy as np

from threadline.base.wording import nearest
from threadline.errors import OptionError
from threadline.motion.laws.law import Harmonics, Law, Phase, Phases, Rest, chained, check_stretches
from threadline.motion.laws.law_table import read_law

MOST_HARMONICS = 63


def law(name: str) -> Law:
    """Return the motion law with a name.

    A name has one of three forms: one of ``LAWS`` (``"modified-sine"``), one of ``FAMILIES`` with
    its numbers (``"trapezoid:0.2"``, ``"harmonic:7"``), or the CSV file of a table
    (``"frame.csv"``, :mod:`threadline.motion.laws.law_table`).

    Raises
    ------
    OptionError
        If there is no law with that name, its numbers are out of range, or its table is unreadable.
    """
    if name in LAWS:
        return LAWS[name]
    if name.lower().endswith(".csv"):
        return read_law(Path(name))
    kind, colon, text = name.partition(":")
    if not colon or kind not in FAMILIES:
        raise OptionError(
            f"unknown motion law {name!r}",
            remedy=nearest(name, [*LAWS, *(f"{family}:..." for family in FAMILIES)], "There are"),
        )
    try:
        numbers = [float(word) for word in text.split(",")]
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            family_law = FAMILIES[kind](*numbers)
    except (TypeError, ValueError, ArithmeticError) as error:
        # A wrong count of numbers raises a TypeError, whose text is about Python and not shown.
        reason = str(error) if isinstance(error, ValueError) else f"it takes {TAKES[kind]}"
        if isinstance(error, ArithmeticError):
            reason = "its numbers are too small or too far apart"
        raise OptionError(
            f"motion law {name!r}: {reason}", remedy=f"Write it like {EXAMPLES[kind]!r}."
        ) from None
    for form in (family_law.form, family_law.closing):
        check_stretches(name, () if form is None else form.breaks)
    return family_law


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


def modified_constant_velocity(share: float = 0.5) -> Law:
    """Return the law with constant velocity over the middle ``share`` of the time and sine ramps.

    In the first quarter of a ramp the acceleration rises as a quarter of a sine; over the rest of
    the ramp it falls as another quarter.

    Raises
    ------
    ValueError
        If ``share`` is not in [0, 1).
    """
    if not 0.0 <= share < 1.0:
        raise ValueError(f"the share of constant velocity must be in [0, 1), got {share!r}")
    ramp = (1.0 - share) / 2.0
    # Both quarters of a sine: pi / 2 over ramp / 4 and over 3 ramp / 4. For 1/2 the peak is
    # 16 pi**2 / (5 pi + 4).
    fast, slow = 2.0 * pi / ramp, 2.0 * pi / (3.0 * ramp)
    velocity_gain = 1.0 / fast + 1.0 / slow
    ramp_rise = (ramp / 4.0 - 1.0 / fast) / fast + 0.75 * ramp / fast + 1.0 / slow**2
    top = 1.0 / (2.0 * ramp_rise + velocity_gain * share)
    phases = [
        Phase(begin=0.0, end=ramp / 4.0, b=top, w=fast),
        Phase(begin=ramp / 4.0, end=ramp, b=top, w=slow, p=pi / 2.0),
    ]
    if share > 0.0:
        phases.append(Phase(begin=ramp, end=0.5))
    return Law(
        name="modified-constant-velocity", velocity=top * velocity_gain, acceleration=top,
        jerk=top * fast, form=Phases(chained(phases)),
    )  # fmt: skip


def harmonic(highest: float) -> Law:
    """Return the law whose acceleration has no harmonic of the move above ``highest``.

    The jerk is ``J cos(2 pi t)**highest``, so that the acceleration is flat about its peak:
    ``highest`` 1 is the cycloidal law, 3 and 5 are the laws 1-3 and 1-3-5 of Freudenstein, "On the
    dynamics of high-speed cam profiles", Int. J. Mech. Sci. 1 (1960). A move of T seconds excites
    the machine above ``highest`` / T Hz only by its beginning and its end.

    Raises
    ------
    ValueError
        If ``highest`` is not an odd whole number from 1 to 63.
    """
    n = int(highest) if 1.0 <= highest <= MOST_HARMONICS else 0
    if n != highest or n % 2 == 0:
        raise ValueError(
            f"the highest harmonic must be odd, from 1 to {MOST_HARMONICS}, got {highest!r}"
        )
    orders = tuple(range(1, n + 1, 2))
    # cos(x)**n = 2**(1-n) sum(comb(n, (n-k)/2) cos(k x)); integrated twice it is the velocity.
    weights = [comb(n, (n - k) // 2) / k**2 for k in orders]
    shares = tuple(weight / sum(weights) for weight in weights)
    # The acceleration peaks at a quarter of the time, where the sines alternate between +1 and -1.
    peak = sum(b * k * (-1.0) ** ((k - 1) // 2) for k, b in zip(orders, shares, strict=True))
    start = sum(b * k * k for k, b in zip(orders, shares, strict=True))
    return Law(
        name="cycloidal" if n == 1 else f"harmonic-{n}", velocity=2.0,
        acceleration=2.0 * pi * peak, jerk=4.0 * pi**2 * start, form=Harmonics(orders, shares),
    )  # fmt: skip


def jerk_limited(*shares: float) -> Law:
    """Return the law of seven phases of constant jerk, with ``shares`` of the time for each.

    The jerk is positive, zero, negative (the velocity rises), zero (it is constant), negative, zero
    and positive (it falls). The fall need not mirror the rise, as all shares may differ; without
    shares all seven are equal.

    Raises
    ------
    ValueError
        If there are not seven shares, or the first, third, fifth or seventh is not positive.
    """
    given_shares = shares or (1.0,) * 7
    if len(given_shares) != 7 or not all(0.0 <= share < 1e9 for share in given_shares):
        raise ValueError(f"seven shares of the time from 0 on are wanted, got {list(given_shares)}")
    if min(given_shares[::2][:2]) <= 0.0 or min(given_shares[4], given_shares[6]) <= 0.0:
        raise ValueError(
            f"the four ramps of the acceleration need some time, got {list(given_shares)}"
        )
    total = sum(given_shares)
    up, level, down, cruise, last_down, last_level, last_up = (s / total for s in given_shares)
    # Phases and rises for a cruise at unit velocity; the phases of the fall run backwards.
    first, first_rise = _ramp(up, level, down)
    last, last_rise = _ramp(last_up, last_level, last_down)
    top = 1.0 / (first_rise + cruise + last_rise)
    forms = []
    for phases, length in ((first, up + level + down), (last, last_up + last_level + last_down)):
        scaled = [Phase(begin=q.begin, end=q.end, c0=top * q.c0, c1=top * q.c1) for q in phases]
        forms.append(Phases(chained([*scaled, Phase(begin=length, end=1.0)])))
    accelerations = [
        top / (level + 0.5 * (up + down)),
        top / (last_level + 0.5 * (last_up + last_down)),
    ]
    return Law(
        name="jerk-limited", velocity=top, acceleration=max(accelerations),
        jerk=max(
            accelerations[0] / min(up, down), accelerations[1] / min(last_up, last_down)
        ),
        form=forms[0], closing=forms[1], meets=up + level + down + 0.5 * cruise,
    )  # fmt: skip


def _ramp(up: float, level: float, down: float) -> tuple[list[Phase], float]:
    """Return the phases from rest to unit velocity, and the rise over them."""
    top = 1.0 / (level + 0.5 * (up + down))
    phases = [Phase(begin=0.0, end=up, c1=top / up)]
    if level > 0.0:
        phases.append(Phase(begin=up, end=up + level, c0=top))
    phases.append(Phase(begin=up + level, end=up + level + down, c0=top, c1=-top / down))
    end = chained([*phases, Phase(begin=up + level + down, end=1.0)])[-1]
    return phases, end.s0


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
    harmonic(1),
    _modified_trapezoid(),
    _modified_sine(),
    Law(
        name="3-4-5", velocity=15.0 / 8.0, acceleration=10.0 / sqrt(3.0), jerk=60.0,
        form=Rest(2),
    ),
    Law(
        name="4-5-6-7", velocity=35.0 / 16.0, acceleration=84.0 * sqrt(5.0) / 25.0, jerk=52.5,
        form=Rest(3),
    ),
    Law(
        # (t u)**2 sqrt(1 - 4 t u) is largest at t u = 3/14; t u = 1/4 bends most.
        name="5-6-7-8-9", velocity=315.0 / 128.0, acceleration=1215.0 * sqrt(7.0) / 343.0,
        jerk=78.75, form=Rest(4),
    ),
    trapezoidal_acceleration(),
    modified_constant_velocity(),
    harmonic(3),
    harmonic(5),
    jerk_limited(),
)  # fmt: skip
LAWS: dict[str, Law] = {each.name: each for each in _ALL}
FAMILIES: dict[str, Callable[..., Law]] = {
    "trapezoid": trapezoid,
    "trapezoidal-acceleration": trapezoidal_acceleration,
    "modified-constant-velocity": modified_constant_velocity,
    "harmonic": harmonic,
    "jerk-limited": jerk_limited,
}
TAKES = {
    "trapezoid": "one number, the share of a ramp",
    "trapezoidal-acceleration": "one number, the share of a ramp",
    "modified-constant-velocity": "one number, the share of constant velocity",
    "harmonic": "one number, the highest harmonic",
    "jerk-limited": "seven numbers, the shares of its phases",
}
EXAMPLES = {
    "trapezoid": "trapezoid:0.2",
    "trapezoidal-acceleration": "trapezoidal-acceleration:0.1",
    "modified-constant-velocity": "modified-constant-velocity:0.3",
    "harmonic": "harmonic:7",
    "jerk-limited": "jerk-limited:1,2,1,3,1,2,1",
}
