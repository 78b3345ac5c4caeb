"""Parts of the slow twin's network, written from the documents and the equations.

Nothing here uses the engine or the package's equations of the machine; the machine file gives the
numbers. Each part has one affine law at a time, and states what ends it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

SLACK = 1e-13


@dataclass
class Watch:
    """A law holds while ``row . z <= 0``; then ``leave`` replaces it by another law."""

    row: np.ndarray
    leave: Callable[[np.ndarray], None]

    def slack(self) -> float:
        return SLACK * max(1.0, abs(float(self.row[-1])))


@dataclass
class Held:
    """A state that stays at a value while the force on it is within bounds."""

    state: int
    scale: float  # from its derivative to the watched force
    low: float
    high: float
    leave_low: Callable[[np.ndarray], None]
    leave_high: Callable[[np.ndarray], None]


class Part:
    """A force or current that is ``row . z`` in each of its modes; ``mode`` is the one in force."""

    mode = "free"

    def __init__(self, direction: np.ndarray) -> None:
        self.direction = direction  # effect of a unit of it on the derivative of z

    def law(self) -> np.ndarray:
        raise AssertionError

    def watches(self) -> Iterator[Watch]:
        return iter(())

    def held(self) -> Held | None:
        return None

    def to(self, mode: str) -> Callable[[np.ndarray], None]:
        def change(_z: np.ndarray) -> None:
            self.mode = mode

        return change


class Belt(Part):
    """Two runs, each of which pulls with ``max(0, P + its share of the spring's force)``."""

    def __init__(self, direction, spring, preload, first) -> None:
        super().__init__(direction)
        self.spring, self.preload, self.first = spring, preload, first
        self.mode = "both"

    def law(self) -> np.ndarray:
        row = self.spring.copy()
        if self.mode == "first":
            row = self.first * row
            row[-1] += self.preload
        if self.mode == "second":
            row = (1.0 - self.first) * row
            row[-1] -= self.preload
        return row

    def watches(self) -> Iterator[Watch]:
        first, second = -self.first * self.spring, (1.0 - self.first) * self.spring
        first[-1] -= self.preload  # above 0: the first run is slack
        second[-1] -= self.preload  # above 0: the second
        if self.mode == "both":
            yield Watch(first, self.to("second"))
            yield Watch(second, self.to("first"))
        else:
            yield Watch(-(second if self.mode == "first" else first), self.to("both"))


class Play(Part):
    """A dead band; a contact pushes and never pulls, and with damping lets go before its edge."""

    def __init__(self, direction, stretch, spring, stiffness, width, damped) -> None:
        super().__init__(direction)
        self.stretch, self.damped = stretch, damped
        self.half, self.push = 0.5 * width, {}
        for side, sign in (("above", 1.0), ("below", -1.0)):
            self.push[side] = sign * spring
            self.push[side][-1] -= stiffness * self.half

    def edge(self, side: str) -> np.ndarray:
        """Return a row that is above 0 beyond the edge."""
        row = self.stretch * (1.0 if side == "above" else -1.0)
        row[-1] -= self.half
        return row

    def law(self) -> np.ndarray:
        if self.mode not in self.push:
            return 0.0 * self.stretch
        return self.push[self.mode] * (1.0 if self.mode == "above" else -1.0)

    def watches(self) -> Iterator[Watch]:
        if self.mode == "free":
            for side in ("above", "below"):
                yield Watch(self.edge(side), self.to(side))
        elif self.mode in self.push:
            after = f"parting {self.mode}" if self.damped else "free"
            yield Watch(-self.push[self.mode], self.to(after))
        else:
            side = self.mode.removeprefix("parting ")
            yield Watch(-self.edge(side), self.to("free"))
            yield Watch(self.push[side], self.to(side))


class Friction(Part):
    """Coulomb friction: a body sticks up to the breakaway force and slides against a lower one."""

    def __init__(self, direction, speed, inertia, sliding, breakaway) -> None:
        super().__init__(direction)
        self.speed, self.inertia = speed, inertia
        self.sliding, self.breakaway = sliding, breakaway
        self.mode = "stick"

    def law(self) -> np.ndarray:
        row = np.zeros_like(self.direction)
        row[-1] = {"stick": 0.0, "forwards": -self.sliding, "backwards": self.sliding}[self.mode]
        return row

    def stop(self, z: np.ndarray) -> None:
        self.mode = "stick"
        z[self.speed] = 0.0

    def watches(self) -> Iterator[Watch]:
        if self.mode != "stick":
            row = np.zeros_like(self.direction)
            row[self.speed] = -1.0 if self.mode == "forwards" else 1.0
            yield Watch(row, self.stop)

    def held(self) -> Held | None:
        if self.mode != "stick":
            return None
        return Held(
            self.speed, self.inertia, -self.breakaway, self.breakaway,
            self.to("backwards"), self.to("forwards"),
        )  # fmt: skip


class Motor(Part):
    """A current: free, at a limit, or switched off for good.

    ``clamped`` is the state of a coil whose current itself is held at the limit, and -1 if the
    clipped current comes from a law or from an integrator that runs on.
    """

    def __init__(self, direction, free, upper, lower, clamped, scale) -> None:
        super().__init__(direction)
        self.free, self.upper, self.lower = free, upper, lower
        self.clamped, self.scale = clamped, scale
        self.switches: list[tuple[str, np.ndarray]] = []  # rows above 0 where closed
        self.tripped: list[str] = []

    def law(self) -> np.ndarray:
        if self.mode == "cut":
            return 0.0 * self.free
        if self.clamped >= 0 or self.mode == "free":
            return self.free
        return self.upper if self.mode == "upper" else self.lower

    def limit(self, mode: str) -> Callable[[np.ndarray], None]:
        def change(z: np.ndarray) -> None:
            self.mode = mode
            if self.clamped >= 0:
                z[self.clamped] = (self.upper if mode == "upper" else self.lower)[-1]

        return change

    def trip(self, name: str) -> Callable[[np.ndarray], None]:
        def change(z: np.ndarray) -> None:
            self.mode = "cut"
            self.tripped.append(name)
            if self.clamped >= 0:
                z[self.clamped] = 0.0

        return change

    def watches(self) -> Iterator[Watch]:
        if self.mode == "cut":
            return
        if self.mode == "free" and self.upper is not None:
            yield Watch(self.free - self.upper, self.limit("upper"))
            yield Watch(self.lower - self.free, self.limit("lower"))
        elif self.mode == "upper" and self.clamped < 0:
            yield Watch(self.upper - self.free, self.to("free"))
        elif self.mode == "lower" and self.clamped < 0:
            yield Watch(self.free - self.lower, self.to("free"))
        for name, row in self.switches:
            yield Watch(row, self.trip(name))

    def held(self) -> Held | None:
        if self.clamped < 0 or self.mode == "free":
            return None
        inf, free = np.inf, self.to("free")
        if self.mode == "cut":
            return Held(self.clamped, self.scale, -inf, inf, free, free)
        low, high = (0.0, inf) if self.mode == "upper" else (-inf, 0.0)
        return Held(self.clamped, self.scale, low, high, free, free)
