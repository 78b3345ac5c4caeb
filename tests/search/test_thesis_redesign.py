"""The thesis's redesign on the simulated machine: speed, corners, bandwidth, current.

Its reference is built here from its own equations (3.11 ... 3.13, and the next segment begins
where the one before decelerates): 7.8 in/s, 1092 in/s^2, 2.5 in per segment, every 1 ms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from threadline.base.arrays import FloatArray
from threadline.dynamics.analysis import loop_figures
from threadline.dynamics.loop import axis_loop
from threadline.files import Stream, TickBlock, TickTable
from threadline.machine import Machine, load_machine
from threadline.machine.numbers import with_numbers
from threadline.twin import simulate

INCH = 0.0254
SEGMENT = 2.5 * INCH
STITCH_S = 1 / 75
LIMIT_A = 27.0


@dataclass(frozen=True)
class Run:
    """What became of the two-corner path; X first."""

    until_95_ms: tuple[float, float]  # of the commanded speed
    until_75_ms: tuple[float, float]  # 95 % of 7.5 in/s
    corner_mm: tuple[float, float]
    peak_a: tuple[float, float]
    clamped: tuple[float, float]  # share of the time of the command


def trapezoid(time_s: FloatArray, speed: float, acceleration: float) -> FloatArray:
    ramp = speed / acceleration
    slew = SEGMENT / speed - ramp
    end = 2 * ramp + slew
    t = np.clip(time_s, 0.0, end)
    down = SEGMENT - acceleration * (end - t) ** 2 / 2
    steady = speed * (t - ramp / 2)
    return np.where(t < ramp, acceleration * t**2 / 2, np.where(t < ramp + slew, steady, down))


@cache
def two_corners(name: str, speed: float = 7.8, acceleration: float = 1092.0) -> Run:
    machine = load_machine(name)
    return sewn(machine, speed * INCH, acceleration * INCH)


def sewn(machine: Machine, speed: float, acceleration: float) -> Run:
    begins = np.arange(3) * SEGMENT / speed  # where the segment before decelerates
    time_s = np.arange(int(1e3 * (begins[2] + 0.4 + speed / acceleration))) * 1e-3
    x = trapezoid(time_s, speed, acceleration) + trapezoid(time_s - begins[2], speed, acceleration)
    y = trapezoid(time_s - begins[1], speed, acceleration)
    counts = np.rint(np.stack([x, y], axis=1) * machine.counts_per_unit).astype(np.int64)
    rows = np.diff(counts, axis=0)
    block = TickBlock(
        first_tick=0, counts=rows, operation=np.zeros(len(rows), dtype=np.int64), events=()
    )
    commands = TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(2, dtype=np.int64),
        blocks=Stream.of([block]),
        job_sha256="",
        machine_sha256=machine.sha256,
    )
    blocks = list(simulate(commands, machine))
    found = {k: np.concatenate([b.samples[k] for b in blocks]) for k in blocks[0].samples}
    tick_s = np.arange(len(found["X.load"])) * 1e-3
    at_95, at_75 = [], []
    for axis, begin in (("X", begins[0]), ("Y", begins[1])):
        velocity = np.abs(np.gradient(found[f"{axis}.load"], 1e-3))
        for level, into in ((0.95 * speed, at_95), (0.95 * 7.5 * INCH, at_75)):
            at = int(np.flatnonzero((velocity >= level) & (tick_s > begin))[0])
            share = (level - velocity[at - 1]) / (velocity[at] - velocity[at - 1])
            into.append(1e3 * (float(tick_s[at - 1]) + 1e-3 * share - begin))
    load = np.stack([found["X.load"], found["Y.load"]], axis=1)
    corners = [
        1e3 * float(np.linalg.norm(load - corner, axis=1).min())
        for corner in ([SEGMENT, 0.0], [SEGMENT, SEGMENT])
    ]
    current = [np.abs(found[f"{axis}.current_peak"]) for axis in "XY"]
    return Run(
        until_95_ms=(at_95[0], at_95[1]),
        until_75_ms=(at_75[0], at_75[1]),
        corner_mm=(corners[0], corners[1]),
        peak_a=(float(current[0].max()), float(current[1].max())),
        clamped=(
            float((current[0] > LIMIT_A - 1e-9).sum() / len(rows)),
            float((current[1] > LIMIT_A - 1e-9).sum() / len(rows)),
        ),
    )


def test_without_the_load_damping_it_is_as_printed() -> None:
    """21 and 23 ms to 95 % of speed, 0.40 and 0.31 mm at the corners.

    0.5 ms for the times, which are read from a 1 ms grid; the corners come out at 0.42 and
    0.37 mm, so 0.07 mm for them.
    """
    run = two_corners("stitcher-rigid-half-mass+no-load-damping")
    assert run.until_95_ms == pytest.approx((21, 23), abs=0.5)
    assert run.corner_mm == pytest.approx((0.40, 0.31), abs=0.07)
    assert max(run.corner_mm) < 0.5
    assert max(run.until_75_ms) < 2e3 * STITCH_S


def test_with_it_the_printed_redesign_misses_its_own_specification() -> None:
    """Corners beyond 0.5 mm, and Y not at 95 % of 7.5 in/s within two stitches (26.7 ms)."""
    run = two_corners("stitcher-rigid-half-mass")
    assert run.corner_mm == pytest.approx((0.74, 1.54), abs=0.02)
    assert min(run.corner_mm) > 0.5
    assert run.until_75_ms == pytest.approx((25.5, 29.7), abs=0.3)
    assert run.until_75_ms[1] > 2e3 * STITCH_S


@pytest.mark.parametrize(
    ("name", "printed", "within"),
    [
        ("stitcher-rigid-half-mass", (39, 38), 0.08),
        ("stitcher-rigid-half-mass+no-load-damping", (39, 38), 0.105),
        ("stitcher-rigid", (33, 36), 0.08),
        ("stitcher-rigid+no-load-damping", (33, 36), 0.08),
    ],
)
def test_bandwidths(name: str, printed: tuple[float, float], within: float) -> None:
    machine = load_machine(name)
    for axis, wanted in zip("XY", printed, strict=True):
        found = loop_figures(axis_loop(machine, axis), "sampled").bandwidth_hz
        assert found == pytest.approx(wanted, rel=within)


def test_the_full_mass_saturates_at_1092_in_s2_and_half_of_it_hardly() -> None:
    """Share of the time at 27 A; without the load damping, as the print must have had it."""
    full = two_corners("stitcher-rigid+no-load-damping")
    half = two_corners("stitcher-rigid-half-mass+no-load-damping")
    assert full.peak_a == half.peak_a == pytest.approx((LIMIT_A, LIMIT_A))
    assert full.clamped[0] > 3 * half.clamped[0]
    assert full.clamped[1] > 1.3 * half.clamped[1]
    # What they would draw from an amplifier that gives it: even half the mass needs more than 27.
    wanted = {}
    for name in ("stitcher-rigid", "stitcher-rigid-half-mass"):
        machine = load_machine(f"{name}+no-load-damping")
        free = {f"drives.{d}.amplifier.current_limit": 500.0 for d in "xy"}
        run = sewn(with_numbers(machine, free), 7.8 * INCH, 1092 * INCH)
        wanted[name] = run.peak_a
    assert wanted["stitcher-rigid"] == pytest.approx((35.4, 35.6), abs=0.3)
    assert wanted["stitcher-rigid-half-mass"] == pytest.approx((29.4, 32.4), abs=0.3)
    # With the damping kept, holding the speed alone takes nearly all there is.
    kept = two_corners("stitcher-rigid-half-mass")
    assert min(kept.clamped) > 0.25
