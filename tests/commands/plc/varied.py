"""Faultless cycles on varied machines: speeds, switches, and scans that jitter.

``python -m tests.commands.plc.varied [CYCLES]`` prints how many of them end in a fault. Speeds
differ by up to 3 % and switches by up to 2 mm, as in the machine file; scans come up to 20 % late
or early.
"""

from __future__ import annotations

import random
import sys

from tests.commands.plc.driving import Bench
from tests.commands.plc.pistons import Cell
from tests.commands.plc.texts import controller

MACHINE = "letter-placer+whole-scans"
SPEEDS = {"x": 0.4255319e-3, "z": 0.2e-3}  # mm per us
SWITCHES = ("x_is_left", "x_is_right", "z_is_up", "z_is_down")


class Varied(Cell):
    """A cell with its own speeds, as factors, and switches, moved by mm; counts openings."""

    def __init__(self, speeds: dict[str, float], moved: dict[str, float]) -> None:
        super().__init__()
        for name, piston in self.pistons.items():
            piston.speed = SPEEDS[name] * speeds.get(name, 1.0)
        self.moved = moved

    def contacts(self) -> dict[str, bool]:
        x, z = self.pistons["x"].at, self.pistons["z"].at
        at = {name: self.moved.get(name, 0.0) for name in SWITCHES}
        return super().contacts() | {
            "x_is_left": x <= 6.0 + at["x_is_left"],
            "x_is_right": x >= 194.0 + at["x_is_right"],
            "z_is_up": z <= 6.0 + at["z_is_up"],
            "z_is_down": z >= 94.0 + at["z_is_down"],
            **self.stuck,
        }


def bench(cell: Cell, seed: int) -> Bench:
    """Return a homed bench around ``cell`` in the first scan of its cycle."""
    made = Bench(controller(MACHINE, "none"), 10_000, 0.2, seed, cell=cell)
    made.home()
    made.press("start_button")
    return made


def drawn(seed: int) -> Bench:
    """Return a bench around a drawn machine."""
    draw = random.Random(seed)
    speeds = {name: 1.0 + draw.uniform(-0.03, 0.03) for name in SPEEDS}
    return bench(Varied(speeds, {name: draw.uniform(-2.0, 2.0) for name in SWITCHES}), seed)


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 631
    faults: dict[str, int] = {}
    for seed in range(count):
        made = drawn(seed)
        made.until_idle()
        if not made.block["finished"]:
            fault = f"{made.block['fault_text']} ({made.block['contact_text']})"
            faults[fault] = faults.get(fault, 0) + 1
    print(f"{sum(faults.values())} of {count} cycles end in a fault")
    for fault, number in faults.items():
        print(f"{number}: {fault}")


if __name__ == "__main__":
    main()
