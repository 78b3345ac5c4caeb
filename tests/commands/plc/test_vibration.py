"""The parsed text, scan by scan with jitter, drives the machine's equations: the vibration left.

The equations are by hand from the paper's table 1 (rigid beam) and the fitted valve drive, each
span between two scans by scipy's matrix exponential.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from tests.commands.plc.driving import homed
from tests.commands.plc.machine import Plc
from tests.commands.plc.test_scans import SCAN_OF
from tests.commands.plc.texts import controller

TABLE, HEAD, K1, B1, B2 = 74.54, 6.0, 2.7e4, 24.0, 1.5
AIR_K, AIR_C, LAG_S, DELAY_US = 35.7e3, 300.0, 0.12, 200_000


def equations(speed: float) -> np.ndarray:
    """y, y', w, w', flow, air, level."""
    a = np.zeros((7, 7))
    force = np.array([0, AIR_C + B2, 0, -AIR_C - B2, AIR_C, AIR_K, 0.0])
    a[0, 1] = a[2, 3] = 1.0
    a[1] = -force / TABLE + np.array([-K1, -B1, 0, 0, 0, 0, 0]) / TABLE
    a[3] = force / HEAD
    a[4, 4], a[4, 6] = -1 / LAG_S, speed / LAG_S
    a[5] = [0, 1, 0, -1, 1, 0, 0]
    return a


class Propagator:
    """Advances a state by whole microseconds: matrix exponentials of 1, 2, 4 ... of them."""

    def __init__(self, matrix: np.ndarray) -> None:
        self.matrix = matrix
        self.powers = [expm(matrix * 1e-6 * 2**k) for k in range(24)]

    def __call__(self, x: np.ndarray, span_us: int) -> np.ndarray:
        for k, power in enumerate(self.powers):
            if span_us >> k & 1:
                x = power @ x
        return x


def drive(plc: Plc, period: int, jitter: float, flows: tuple[float, float], seed: int) -> float:
    """Return the amplitude, um, with which the table rings after the stroke to the right."""
    bench = homed(plc, period, jitter, seed)
    ahead, x = Propagator(equations(0.43)), np.zeros(7)
    pending: list[tuple[int, float]] = []
    bench.press("start_button")
    level, moved, now = 0.0, 0, bench.now
    for _ in range(10_000_000 // period):
        on = bench.scan()
        then = bench.now
        while pending and pending[0][0] <= then:
            at, value = pending.pop(0)
            x = ahead(x, at - now)
            now, x[6] = at, value
        x = ahead(x, then - now) if moved else x
        now = then
        expected = ("x_right" in on) * (
            flows[0] * ("x_right_a1" in on) + flows[1] * ("x_right_a2" in on)
        )
        if expected != level:
            pending.append((now + DELAY_US, expected))
            level, moved = expected, moved or now
        if moved and now > moved + 1_400_000:
            break
    assert moved
    assert x[2] - x[0] == pytest.approx(0.2, abs=0.01)
    times = np.arange(0.0, 0.7, 0.01)
    table = []
    for _ in times:
        table.append(x[0])
        x = ahead(x, 10_000)
    pole = min((p for p in np.linalg.eigvals(ahead.matrix) if p.imag > 1.0), key=abs)
    decay = np.exp(pole.real * times)
    columns = [decay * np.cos(pole.imag * times), decay * np.sin(pole.imag * times)]
    columns += [np.exp(-times / LAG_S), np.ones_like(times)]
    found = np.linalg.lstsq(np.array(columns).T, np.array(table), rcond=None)[0]
    return 1e6 * float(np.hypot(found[0], found[1]))


def test_a_scan_with_jitter_costs_little_of_what_shaping_gains() -> None:
    """The paper's ZV leaves 25 % on this machine with any scan.

    Scans of 1, 5 and 10 ms with 20 % jitter change that by at most 0.7 % of the unshaped ringing;
    the bound is twice that.
    """
    unshaped = drive(controller("letter-placer", "none"), 10_000, 0.0, (0.63, 0.37), 1)
    exact = drive(controller("letter-placer+timed", "zv"), 1_000, 0.0, (0.63, 0.37), 1)
    assert unshaped > 1000.0
    assert 0.1 * unshaped < exact < 0.35 * unshaped
    for machine, period in SCAN_OF.items():
        for seed in range(2):
            coarse = drive(controller(machine, "zv"), period, 0.2, (0.63, 0.37), seed)
            assert abs(coarse - exact) < 0.014 * unshaped
