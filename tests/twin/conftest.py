"""Shared helpers: tables of commands, and an independent integrator."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from threadline.files import Stream, TickBlock, TickTable
from threadline.machine import Machine
from threadline.machine.load import load_machine


def make_table(machine: Machine, moves: dict[str, np.ndarray], block: int = 10**9) -> TickTable:
    """Return a table with the given counts per tick per axis."""
    rows = len(next(iter(moves.values())))
    counts = np.zeros((rows, len(machine.axes)), dtype=np.int64)
    for axis, column in moves.items():
        counts[:, machine.axis_names.index(axis)] = column
    blocks = [
        TickBlock(
            first_tick=at,
            counts=counts[at : at + block],
            operation=np.arange(rows)[at : at + block] // 50,
        )
        for at in range(0, rows, block)
    ]
    return TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(len(machine.axes), dtype=np.int64),
        blocks=Stream.of(blocks),
        job_sha256="job",
        machine_sha256=machine.sha256,
    )


@pytest.fixture
def table() -> Callable[..., TickTable]:
    return make_table


@pytest.fixture
def there_and_back() -> Callable[[int, int], np.ndarray]:
    """Return counts per tick of a linear move of ``distance`` counts forth and back."""

    def move(feed: int, distance: int = 10_000) -> np.ndarray:
        out = np.full(distance // feed, feed)
        return np.concatenate((out, -out))

    return move


BELT_AXIS = """
name = "belt-axis"
title = "a motor that drives a head through a belt"
sources = ["made for a test"]
tick_budget = "1e9 tick exact, assumed"
[clocks]
servo = "2 ms exact, assumed"
[bodies.motor]
kind = "rotary"
inertia = "2e-4 kg m^2 exact, assumed"
damping = "1e-3 N m s/rad exact, assumed"
[bodies.head]
kind = "linear"
inertia = "1.5 kg exact, assumed"
damping = "4 N s/m exact, assumed"
[links.belt]
stretch = { motor = "0.012 m/rad exact, assumed", head = "-1 exact, assumed" }
stiffness = "2e4 N/m exact, assumed"
damping = "15 N s/m exact, assumed"
[drives.m]
kind = "dc-motor"
acts_on = { motor = "1 exact, assumed" }
torque_constant = "0.1 N m/A exact, assumed"
back_emf = "0.1 V s/rad exact, assumed"
resistance = "0.5 ohm exact, assumed"
amplifier = { mode = "voltage", gain = "1 exact, assumed" }
[sensors.e]
kind = "encoder"
reads = { motor = "500 count/rad exact, assumed" }
[controllers.c]
kind = "pd"
clock = "servo"
sensor = "e"
drive = "m"
kp = "3 dac/count exact, assumed"
kd = "6 dac/count exact, assumed"
dac = { bits = "12 bit exact, assumed", range = "10 V exact, assumed" }
[axes.X]
kind = "linear"
controller = "c"
counts = "41666.6666666666666 count/m exact, assumed"
velocity = "1 m/s exact, assumed"
acceleration = "10 m/s^2 exact, assumed"
endless = true
load = { head = "1 exact, assumed" }
[tool]
radius = "100 mm exact, assumed"
"""


@pytest.fixture
def belt_axis(tmp_path: Path) -> Callable[..., Machine]:
    """A machine of a motor and a head; each keyword sets lines of the table that it names.

    ``belt_axis(links_belt='preload = "5 N exact, assumed"')``
    """

    def build(extra: str = "", **lines: str) -> Machine:
        text = BELT_AXIS
        for table, line in lines.items():
            header = f"[{table.replace('_', '.')}]\n"
            head, tail = text.split(header)
            keys = {x.split("=")[0].strip() for x in line.split("\n")}
            part, *rest = tail.split("\n[", 1)
            kept = [x for x in part.split("\n") if x.split("=")[0].strip() not in keys]
            text = head + header + line + "\n" + "\n".join(kept) + "".join("\n[" + r for r in rest)
        file = tmp_path / "belt-axis.toml"
        file.write_text(text + extra)
        return load_machine(str(file))

    return build
