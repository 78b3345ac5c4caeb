"""A stitcher's axis with its motion chip, integrated by scipy between exact instants.

Nothing here uses the package's equations of the machine: motor, coil, belt, head and frame are
written out, dead time is a list of arrivals in exact fractions, and a clamped current is integrated
piece by piece with events. The instants are those of any jump: every tick of the filter, every
arrival of a level, every tick of the references.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from math import isqrt

import numpy as np
from scipy.optimize import brentq

from tests.dop853 import state_after

FILTER, REFERENCE, DELAY = Fraction(136, 10**6), Fraction(1, 1000), Fraction(3, 1000)
KT, KV, R, L = 0.5, 60 * 60 / (1000 * 2 * np.pi), 0.8, 4e-3
RATIO = 29e-3 / 6
COUNTS = 8000 / (2 * np.pi)
VOLT = 20 / 256
LIMIT = 27.0


@dataclass
class Axis:
    """One axis; ``belt(stretch, rate, y)`` is its force, the frame is left out when ``mf`` is 0."""

    j: float = 4.75e-4
    b: float = 0.24
    ka: float = 40.0
    m: float = 111.0
    d: float = 3330.0
    k: float = 6.24e5
    mf: float = 0.0
    df: float = 1000.0
    kf: float = 5e6
    at_head: bool = False
    clamp: str = "state"
    belt: Callable[[float, float, np.ndarray], float] | None = None
    mode: dict[str, int] = field(default_factory=lambda: {"at": 0})

    def size(self) -> int:
        return 7 if self.mf else 5

    def read(self, y: np.ndarray) -> float:
        return COUNTS * (y[3] / RATIO if self.at_head else y[0])

    def _slope(self, y: np.ndarray, volts: float, held: bool) -> np.ndarray:
        # Plain floats: for scalars numpy takes four times as long, with the same last bit.
        theta, omega, i, x, v, *frame = y.tolist()
        place, speed = frame or (0.0, 0.0)
        stretch = RATIO * theta - x - place
        rate = RATIO * omega - v - speed
        pull = self.k * stretch if self.belt is None else self.belt(stretch, rate, y)
        current = min(max(i, -LIMIT), LIMIT)
        out = [
            omega,
            (KT * current - self.b * omega - RATIO * pull) / self.j,
            0.0 if held else (volts - KV * omega - R * i) / L,
            v,
            (pull - self.d * v) / self.m,
        ]
        if self.mf:
            out += [speed, (pull - self.df * speed - self.kf * place) / self.mf]
        return np.array(out)

    def advance(self, y: np.ndarray, volts: float, span: float) -> np.ndarray:
        """Integrate over ``span`` with held volts; ``clamp`` is the mode of the current."""

        def rate(state: np.ndarray) -> float:
            return (volts - KV * state[1] - R * state[2]) / L

        while span > 1e-15:
            at = self.mode["at"]
            if at and at * rate(y) < 0:
                at = self.mode["at"] = 0
            # Side on which the current crosses its limit next, unless it is there already.
            away = abs(y[2]) - LIMIT
            side = 1.0 if self.clamp == "state" else -np.sign(away) * (abs(away) > 1e-9)

            def over(state: np.ndarray, at: int = at, side: float = side) -> float:
                # Above zero from where the clamp begins or ends, or from a kink in the torque on:
                # begun anew there, so that the order of the method holds.
                return -at * rate(state) if at else side * (abs(state[2]) - LIMIT)

            def after(time: float, start: np.ndarray = y, at: int = at) -> np.ndarray:
                return state_after(
                    lambda _t, s: self._slope(s, volts, bool(at)), start, time,
                    rtol=1e-10, atol=1e-12,
                )  # fmt: skip

            end, time = after(span), span
            crossed = over(end) > 0 >= over(y)
            if crossed:
                time = brentq(lambda t: over(after(t)), 0.0, span, xtol=1e-18, rtol=1e-14)
                end = after(time)
            y, span = end, span - time
            if crossed and self.clamp == "state":
                self.mode["at"] = 0 if at else int(np.sign(y[2]))
                if self.mode["at"]:
                    y[2] = self.mode["at"] * LIMIT
        return y


def run(
    axis: Axis,
    rows: np.ndarray,
    law: tuple[tuple[float, ...], tuple[float, ...]],
    *,
    quantised: bool,
    delay: Fraction = DELAY,
    profile: Callable[[int, int], float] | None = None,
) -> np.ndarray:
    """Return the (ticks, states) at every reference tick.

    Parameters
    ----------
    law
        ``b0 b1 b2`` and ``a1 a2`` of ``u = b0 e + b1 e' + b2 e'' - a1 u' - a2 u''``; the word is
        clamped to 8 bits, and the output that is remembered with it.
    profile
        Positions from the last reference and the one before it, asked for at every filter tick.
    """
    (b0, b1, b2), (a1, a2) = law
    end = REFERENCE * len(rows)
    travelled = np.concatenate(([0], np.cumsum(rows)))
    ticks = [FILTER * k for k in range(int(end / FILTER) + 1)]
    instants = sorted(
        {i for i in (*ticks, *(t + delay for t in ticks)) if i < end}
        | {REFERENCE * k for k in range(len(rows))}
    )
    y = np.zeros(axis.size())
    e = [0.0, 0.0]
    u = [0.0, 0.0]
    arriving: dict[Fraction, float] = {}
    volts, states = 0.0, []
    for now, then in zip(instants, [*instants[1:], end], strict=True):
        if now % REFERENCE == 0:
            states.append(y)
        if now % FILTER == 0:
            seen = axis.read(y)
            seen = np.floor(seen + 0.5) if quantised else seen
            row = int(now // REFERENCE)
            expected = travelled[row]
            if profile is not None:
                expected = profile(int(expected), int(travelled[max(row - 1, 0)]))
                expected = np.floor(expected) if quantised else expected
            error = expected - seen
            out = b0 * error + b1 * e[0] + b2 * e[1] - a1 * u[0] - a2 * u[1]
            level = np.clip(np.rint(out) if quantised else out, -128, 127)
            e = [error, e[0]]
            u = [float(np.clip(out, -128, 127)), u[0]]
            arriving[now + delay] = level * VOLT * axis.ka
        volts = arriving.pop(now, volts)
        y = axis.advance(y, volts, float(then - now))
    return np.array(states)


@dataclass
class IntegralVelocity:
    """Speed in counts per tick, reached with ``acceleration`` 256ths, and its sum."""

    acceleration: int
    whole: bool
    speed: float = 0.0
    at: float = 0.0

    def __call__(self, reference: int, before: int) -> float:
        expected = (reference - before) * float(FILTER / REFERENCE)
        if self.whole:
            expected = min(127, max(-128, round(expected)))
        most = self.acceleration / 256
        self.speed = min(self.speed + most, max(self.speed - most, expected))
        self.at += self.speed
        return self.at


@dataclass
class Trapezoid:
    """Motion to a target, in integers: 256ths of a count and of a count per tick."""

    acceleration: int
    velocity: int
    speed: int = 0
    at: int = 0
    target: int = 0

    def __call__(self, reference: int, _before: int) -> float:
        if self.at == self.target:
            self.target, self.speed = 256 * reference, 0
        left = self.target - self.at
        a, size = self.acceleration, abs(left)
        # The most n with a + ... + n a <= left, the largest v with (n + 1)(v - n a/2) <= left.
        n = (isqrt(1 + 8 * size // a) - 1) // 2
        stoppable = (2 * size + n * (n + 1) * a) // (2 * (n + 1))
        self.speed = min(self.speed + a, 256 * self.velocity, stoppable)
        self.at += self.speed if left > 0 else -self.speed
        return self.at / 256
