"""One axis of the winder in three cases, and its controller as a peer's user writes it."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from threadline.files import Stream, TickBlock, TickTable
from threadline.machine import Machine
from threadline.machine.load import load_machine
from threadline.machine.parts import DcMotor

H, COUNTS, R, KT = 5e-3, 4000 / (2 * np.pi), 0.4, 0.082
KE = 8.6 / (1000 * 2 * np.pi / 60)
J, GAIN, VOLT = 3.606e-4, 0.45, 20 / 4096
LIMIT, SLIDE, BREAK = 4.0, 0.05, 0.06
VARIANTS = 1000
CASES = ("linear-quantised", "saturated", "contact")
# Ours prepares its tables within the time measured, JAX before it: a long run is a fair one.
BATCH_TICKS = 240_000


def machine_of(case: str, *, reversal: bool = True) -> Machine:
    """Return the X axis of the winder, alone and without travel switches.

    Comparisons without quantisers leave out the zero tick on reversal too: at rest the sign of a
    level of 1e-13 would decide on it.
    """
    whole = load_machine("lathe-winder" + ("+stiction" if case == "contact" else ""))
    drive = whole.drives["x"]
    assert isinstance(drive, DcMotor)
    if case != "saturated":
        amplifier = dataclasses.replace(drive.amplifier, current_limit=None)
        drive = dataclasses.replace(drive, amplifier=amplifier)
    controller = whole.controllers["x"]
    dac = dataclasses.replace(controller.dac, zero_on_reversal=reversal)
    return dataclasses.replace(
        whole,
        bodies={"x": whole.bodies["x"]},
        drives={"x": drive},
        sensors={"x": whole.sensors["x"]},
        controllers={"x": dataclasses.replace(controller, dac=dac)},
        axes={"X": whole.axes["X"]},
        inputs={},
        tool=None,
    )


def rows_of(case: str, ticks: int) -> np.ndarray:
    """Return counts per tick: to and fro at 30 counts per tick, or in jumps that saturate."""
    if case == "saturated":
        once = np.zeros(400, dtype=np.int64)
        once[[0, 200]] = 2000, -2000
    else:
        once = np.concatenate((np.full(330, 30), np.zeros(40), np.full(330, -30), np.zeros(40)))
    return np.resize(once.astype(np.int64), ticks)


def table_of(machine: Machine, rows: np.ndarray) -> TickTable:
    counts = rows.reshape(len(rows), -1)
    block = TickBlock(first_tick=0, counts=counts, operation=np.zeros(len(rows), np.int64))
    return TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(len(machine.axes), dtype=np.int64),
        blocks=Stream.of([block]),
        job_sha256="",
        machine_sha256=machine.sha256,
    )


class Loop:
    """The controller as a peer's user writes it: PD on counts, 12-bit DAC, zero on reversal."""

    def __init__(self, quantised: bool = True) -> None:
        self.error = self.level = 0.0
        self.quantised = quantised

    def volts(self, reference: float, theta: float) -> float:
        read = theta * COUNTS
        if self.quantised:
            read = np.floor(read + 0.5)
        error = reference - read
        level = 2 * error + 4 * (error - self.error)
        if self.quantised:
            level = np.rint(level)
        level = min(max(level, -2048.0), 2047.0)
        if self.quantised and level * self.level < 0:
            level = 0.0
        self.error, self.level = error, level
        return level * VOLT * GAIN


def inertias() -> np.ndarray:
    return J * (1 + 0.1 * np.linspace(-1.0, 1.0, VARIANTS))


def seconds(call: Callable[[], Any], repeats: int = 9) -> float:
    """Return the shortest of some runs: the one that was disturbed least."""
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - start)
    return best
