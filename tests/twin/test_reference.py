"""The engine, compared with the slow twin: library machines, and random networks of all parts.

Both must agree to 1e-6 counts at loads, encoders and frames and to 1e-6 V, A and m/s, with and
without quantisers: a million ticks of rounding at 1e-12, the slack of the modes. Rounded readings
and levels must be the same. The actual difference is 1e-11 in the library and 1e-7 in the worst
random network, in which hundreds of changes of modes follow each other.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.made import read_once
from threadline.machine import Machine
from threadline.machine.load import load_machine
from threadline.twin import simulate

from .random_machines import FEATURES, Maker
from .reference_twin import reference_run

TOLERANCE = 1e-6
SETTLE = 10
OUT_AND_BACK = np.concatenate((np.ones(12), -np.ones(16), np.zeros(8))).astype(np.int64)
SEEDS = tuple(range(14))


def assert_twin_is_the_reference(
    machine: Machine, rows, table, quantised: bool, phases=None
) -> None:
    """Assert that every channel equals the reference at every tick."""
    phases = phases or {}
    expected, _ = reference_run(machine, rows, quantised=quantised, phases=phases, settle=SETTLE)
    given = np.array([phases.get(axis, 0.5) for axis in machine.axes])
    settle_s = (SETTLE - 0.5) * float(machine.tick_clock.period_s)
    recording = read_once(
        simulate(
            table(machine, rows), machine, quantised=quantised, encoder_phase=given,
            settle_s=settle_s,
        )
    )  # fmt: skip
    for channel in recording.channels:
        if channel.name not in expected:
            assert channel.name.endswith(("commanded", "current_peak", "operation"))
            continue
        found = recording.samples(channel.name)[1]
        scale = machine.axes[channel.axis].counts.si if channel.unit in {"m", "rad"} else 1.0
        if quantised and channel.name.endswith("measured"):
            same = np.rint(found * scale), np.rint(expected[channel.name] * scale)
            np.testing.assert_array_equal(*same, err_msg=channel.name)
        np.testing.assert_allclose(
            found * scale, expected[channel.name] * scale, rtol=0, atol=TOLERANCE,
            err_msg=channel.name,
        )  # fmt: skip
    moved = {a: np.ptp(expected[f"{a}.load"]) * machine.axes[a].counts.si for a in rows}
    assert max(moved.values()) > 1.0


WINDERS = ("", "+physical", "+current", "+8A", "+stiction", "+springy", "+stiction+springy+8A")
STITCHERS = ("", "+unloaded", "+head-feedback", "+moving-fabric", "+rigid-frame")
LIBRARY = (
    *((f"lathe-winder{overlay}", 80) for overlay in WINDERS),
    *((f"stitcher{overlay}", 60) for overlay in STITCHERS),
    ("stitcher-rigid", 60),
    ("stitcher-rigid-half-mass", 60),
)


@pytest.mark.parametrize(
    ("name", "feed", "quantised"),
    [(*case, True) for case in LIBRARY] + [("lathe-winder", 80, False), ("stitcher", 60, False)],
)
def test_library_machines(name, feed, quantised, table):
    """Every machine of the library that has axes, with each of its overlays, all axes at once."""
    machine = load_machine(name)
    rows = {axis: feed * OUT_AND_BACK // (k + 1) for k, axis in enumerate(machine.axes)}
    assert_twin_is_the_reference(machine, rows, table, quantised)


def made(seed: int, tmp_path: Path) -> tuple[Machine, set[str]]:
    maker = Maker(seed)
    file = tmp_path / f"random-{seed}.toml"
    file.write_text(maker.text())
    return load_machine(str(file)), maker.used


@pytest.mark.long(but=("0", "4", "7", "13"))
@pytest.mark.parametrize("seed", SEEDS)
def test_random_networks(seed, table, tmp_path):
    """With quantisers where the seed is odd."""
    machine, _ = made(seed, tmp_path)
    random = np.random.default_rng(seed)
    rows = {axis: int(random.integers(8, 40)) * OUT_AND_BACK for axis in machine.axes}
    phases = {axis: float(random.uniform(0.0, 1.0)) for axis in machine.axes}
    assert_twin_is_the_reference(machine, rows, table, bool(seed % 2), phases)


def test_random_networks_have_every_part_and_change_modes(tmp_path):
    """Otherwise the test above would prove less than it says."""
    used, changes = set(), 0
    for seed in SEEDS:
        machine, features = made(seed, tmp_path)
        used |= features
        rows = {axis: 30 * OUT_AND_BACK[:20] for axis in machine.axes}
        changes += reference_run(machine, rows, quantised=False, settle=0)[1]
    assert used == set(FEATURES)
    assert changes > 60


def test_the_reference_is_a_closed_form(belt_axis, tmp_path):
    """One body on held volts is an exponential: a formula checks the reference itself."""
    machine = belt_axis(
        links_belt='stiffness = "0 N/m exact, assumed"\ndamping = "0 N s/m exact, assumed"',
        controllers_c='kp = "1000 dac/count exact, assumed"\nkd = "0 dac/count exact, assumed"',
        sensors_e='reads = { head = "500 count/m exact, assumed" }',
    )
    rows = {"X": np.array([1] + [0] * 19)}
    found, _ = reference_run(machine, rows, quantised=False, settle=0)
    # 1000 levels of 20 V / 4096 from the first tick on, against 0.1 V s/rad and 1e-3 N m s/rad.
    volts, damping, inertia = 1000 * 20 / 4096, 1e-3 + 0.1 * 0.1 / 0.5, 2e-4
    end = 0.1 * volts / 0.5 / damping
    time = np.maximum(0.002 * (np.arange(20) - 1), 0.0)
    speed = end * (1.0 - np.exp(-damping / inertia * time))
    driven = np.where(np.arange(20) > 0, volts, 0.0)
    expected = (np.where(np.arange(20) > 1, driven, 0.0) - 0.1 * speed) / 0.5
    np.testing.assert_allclose(found["X.current"][:20], expected, atol=1e-9)
