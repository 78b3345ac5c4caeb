"""A controller and the machine around it, scan by scan, driven like an operator at the panel."""

from __future__ import annotations

import random
from typing import Any

from tests.commands.plc.machine import Plc
from tests.commands.plc.pistons import Cell

PANEL = {"continuous": False, "stop_at_end": False, "manual": False, "jog": 0}


class Bench:
    """A controller with its cell; ``period`` in us, each scan off by a share ``jitter`` of it."""

    def __init__(
        self,
        plc: Plc,
        period: int = 10_000,
        jitter: float = 0.0,
        seed: int = 1,
        cell: Cell | None = None,
    ) -> None:
        self.plc, self.cell = plc, cell or Cell()
        self.period, self.jitter = period, jitter
        self.random = random.Random(seed)
        self.count = 0
        self.on: set[str] = set()

    @property
    def block(self) -> dict[str, Any]:
        state: dict[str, Any] = self.plc.instance.v["sequence"].v
        return state

    @property
    def now(self) -> int:
        return self.cell.now

    def scan(self, **given: bool | int) -> set[str]:
        """Run one scan with these inputs and those of the cell; return the outputs that are on."""
        self.count += 1
        late = round(self.random.uniform(-self.jitter, self.jitter) * self.period)
        cell = self.cell.advance(self.count * self.period + late)
        self.on = self.cell.tell(self.plc.scan({**cell, **PANEL, **given}, self.now))
        return self.on

    def press(self, button: str) -> set[str]:
        self.scan()
        return self.scan(**{button: True})

    def until_idle(self, most: int = 20_000) -> None:
        for _ in range(most):
            if not self.block["busy"]:
                return
            self.scan()
        raise AssertionError("it never ends")

    def home(self) -> None:
        self.press("home_button")
        self.until_idle()
        assert self.block["homed"], self.block["fault_text"]

    def fork(self) -> Bench:
        twin = Bench(self.plc.fork(), self.period, self.jitter, cell=self.cell.fork())
        twin.count, twin.on = self.count, self.on
        twin.random.setstate(self.random.getstate())
        return twin


def homed(plc: Plc, period: int = 10_000, jitter: float = 0.0, seed: int = 1) -> Bench:
    """Return a bench whose pistons were brought home."""
    bench = Bench(plc, period, jitter, seed)
    bench.home()
    return bench
