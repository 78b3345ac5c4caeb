"""Design time of every shaper, and robustness evaluations beside peers that do the same.

A robustness evaluation is the residual vibration of one train on one mode: 10 000 of them make a
map. Peers: the same formula as a Python loop, and python-control simulating the oscillator (a
hundred runs, scaled up). Designs have no peer that solves them exactly with damping; they are
timed alone, their proof by simulation included.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from threadline.motion.shaping import (
    FlexibleMode,
    Requirement,
    Shaper,
    ShaperKind,
    design,
    direct_shaper,
    direct_unit_magnitude,
    residual_vibration,
    specified_insensitivity,
)

MODE = FlexibleMode(3.04, 0.0089)
CASES = 10_000
SIMULATED = 100
REPEATS = 5


def best_s(call: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the shortest of some runs, s."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return min(times)


def loop(shaper: Shaper, frequency_hz: np.ndarray, damping: np.ndarray) -> list[float]:
    """Residual vibration by the textbook formula, case by case in Python."""
    amplitudes, times = shaper.amplitudes.tolist(), shaper.times_s.tolist()
    found = []
    for f, z in zip(frequency_hz.tolist(), damping.tolist(), strict=True):
        w = 2.0 * math.pi * f
        wd = w * math.sqrt(1.0 - z * z)
        c = sum(
            a * math.exp(z * w * t) * math.cos(wd * t)
            for a, t in zip(amplitudes, times, strict=True)
        )
        s = sum(
            a * math.exp(z * w * t) * math.sin(wd * t)
            for a, t in zip(amplitudes, times, strict=True)
        )
        found.append(math.exp(-z * w * times[-1]) * math.hypot(c, s))
    return found


def simulated(shaper: Shaper, frequency_hz: np.ndarray, damping: np.ndarray) -> list[float]:
    """Residual vibration by python-control: steps of each oscillator to the train's end, added."""
    import control

    found = []
    for f, z in zip(frequency_hz.tolist(), damping.tolist(), strict=True):
        w = 2.0 * math.pi * f
        system = control.ss([[0, 1], [-w * w, -2 * z * w]], [[0], [w * w]], np.eye(2), 0)
        x = np.zeros(2)
        for amplitude, t in zip(shaper.amplitudes, shaper.times_s, strict=True):
            if t < shaper.duration_s:
                grid = np.array([0.0, shaper.duration_s - t])
                # A constant input between two instants is exact.
                x += amplitude * control.forced_response(system, grid, np.ones(2)).outputs[:, -1]
        left = x[0] - 1.0
        damped = math.sqrt(1 - z * z)
        # Over the envelope that a plain step leaves, 1 / damped.
        found.append(damped * math.hypot(left, (x[1] / w + z * left) / damped))
    return found


def run() -> list[dict[str, Any]]:
    """Return the entries of this comparison."""
    results = []
    for kind in ShaperKind:
        took = best_s(partial(design, kind, MODE))
        results.append(alone(f"shaper design, {kind}", took, "proved by a simulated oscillator"))
    took = best_s(lambda: specified_insensitivity(MODE, 0.2), 1)
    results.append(alone("shaper design, si over 20 %", took, "linear programs, then exact"))
    two = [Requirement(MODE), Requirement(FlexibleMode(9.1, 0.01))]
    took = best_s(lambda: direct_shaper(two), 1)
    results.append(alone("shaper design, two modes at once", took, "linear programs, then exact"))
    took = best_s(lambda: direct_unit_magnitude(two), 1)
    name = "shaper design, two modes at once, unit magnitude"
    results.append(alone(name, took, "linear programs, then exact"))
    rng = np.random.default_rng(4)
    f, z = rng.uniform(1.0, 6.0, CASES), rng.uniform(0.0, 0.2, CASES)
    shaper = design("um-2ei", MODE)
    residual_vibration(shaper, f, z)  # compiles the kernel, or loads it
    ours = best_s(lambda: residual_vibration(shaper, f, z))
    name = f"{CASES} robustness evaluations"
    apart = float(np.abs(np.array(loop(shaper, f, z)) - residual_vibration(shaper, f, z)).max())
    results.append(
        beside(f"{name} vs Python loop", ours, best_s(lambda: loop(shaper, f, z), 2), apart)
    )
    try:
        theirs = simulated(shaper, f[:SIMULATED], z[:SIMULATED])
        peer = best_s(lambda: simulated(shaper, f[:SIMULATED], z[:SIMULATED]), 1)
        apart = float(np.abs(np.array(theirs) - residual_vibration(shaper, f, z)[:SIMULATED]).max())
        results.append(beside(f"{name} vs python-control", ours, peer * CASES / SIMULATED, apart))
    except ImportError:
        results.append(alone(f"{name} vs python-control", ours, "the peer is not installed"))
    return results


def alone(name: str, ours: float, note: str) -> dict[str, Any]:
    return {
        "name": name, "ours": ours, "peer": None, "peer_value": None, "ratio": None, "unit": "s",
        "note": f"{ours * 1e3:.3g} ms; {note}",
    }  # fmt: skip


def beside(name: str, ours: float, peer: float, apart: float) -> dict[str, Any]:
    return {
        "name": name,
        "ours": ours,
        "peer": name.rpartition(" vs ")[2],
        "peer_value": peer,
        "ratio": peer / ours,
        "unit": "s",
        "note": f"{ours * 1e3:.3g} ms against {peer * 1e3:.4g} ms; largest difference {apart:.1e}",
    }
