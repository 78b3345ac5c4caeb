"""Pistons for the tests: outputs in, end switches out, in microseconds; independent of our code.

Speed follows the open flows after a dead time; no lag, no springs. Places in mm.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field

FLOW = {"a1": 0.63, "a2": 0.37}
RELEASED = dict.fromkeys(("start_button", "acknowledge", "home_button"), False)


@dataclass
class Piston:
    out: str
    back: str
    stroke: float
    speed: float  # mm per us at level 1
    dead_us: int
    at: float = 0.0
    level: float = 0.0
    orders: list[tuple[int, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.ways = [
            (valve, sign, [(f"{valve}_{k}", flow) for k, flow in FLOW.items()])
            for valve, sign in ((self.out, 1.0), (self.back, -1.0))
        ]

    def tell(self, on: set[str], now: int) -> None:
        level = 0.0
        for valve, sign, flows in self.ways:
            if valve in on:
                level += sign * sum([flow for name, flow in flows if name in on])
        if not self.orders or self.orders[-1][1] != level:
            self.orders.append((now + self.dead_us, level))

    def advance(self, then: int, now: int) -> None:
        while now < then:
            until = then
            if self.orders and self.orders[0][0] <= now:
                self.level = self.orders.pop(0)[1]
                continue
            if self.orders:
                until = min(then, self.orders[0][0])
            self.at = min(max(self.at + self.level * self.speed * (until - now), 0.0), self.stroke)
            now = until

    def fork(self) -> Piston:
        twin = copy.copy(self)
        twin.orders = self.orders.copy()
        return twin


class Cell:
    """The machine around the controller: pistons, and a letter that the venturi holds."""

    def __init__(self, x: float = 0.0, z: float = 0.0) -> None:
        self.pistons = {
            "x": Piston("x_right", "x_left", 200.0, 0.43e-3, 200_000, x),
            "z": Piston("z_down", "z_up", 100.0, 0.2e-3, 100_000, z),
        }
        self.now = 0
        self.on: set[str] = set()
        self.stuck: dict[str, bool] = {}
        self.inputs = {"light_grid": True, "enable": True}

    def contacts(self) -> dict[str, bool]:
        x, z = self.pistons["x"].at, self.pistons["z"].at
        true = {
            "x_is_left": x <= 6, "x_is_right": x >= 194, "z_is_up": z <= 6, "z_is_down": z >= 94,
            "letter_held": "venturi" in self.on,
        }  # fmt: skip
        true.update(self.stuck)
        return true

    def advance(self, then: int) -> dict[str, bool]:
        """Advance to ``then``, and return every input."""
        for piston in self.pistons.values():
            piston.advance(then, self.now)
        self.now = then
        return {**RELEASED, **self.inputs, **self.contacts()}

    def tell(self, outputs: dict[str, bool]) -> set[str]:
        self.on = {name for name, value in outputs.items() if value}
        for piston in self.pistons.values():
            piston.tell(self.on if "main_air" in self.on else set(), self.now)
        return self.on

    def fork(self) -> Cell:
        twin = copy.copy(self)
        twin.pistons = {name: piston.fork() for name, piston in self.pistons.items()}
        twin.on, twin.stuck, twin.inputs = self.on.copy(), self.stuck.copy(), self.inputs.copy()
        return twin
