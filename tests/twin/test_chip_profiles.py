"""Positions that the motion chip makes before its filter: scipy, integers, closed forms.

The filter, the plant and the tolerances are the same as in ``test_stitcher``: 0.1 um at the head
without quantisers, one encoder count (3.8 um) with them, while the current is limited.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.dynamics.in_one_piece import feed_forward, smooth_motion
from threadline.dynamics.preview import AxisPreview
from threadline.errors import MachineError
from threadline.machine.load import load_machine
from threadline.twin import simulate

from .chip_reference import (
    COUNTS,
    FILTER,
    LIMIT,
    RATIO,
    Axis,
    IntegralVelocity,
    Trapezoid,
    run,
)

COUNT_M = RATIO / COUNTS
LEAD = ((0.89, -0.89 * 0.976, 0.0), (0.004, 0.0))
TICK = float(FILTER)


def machine_of(tmp_path, kind: str, acceleration: int, velocity: int | None = None):
    """Return the stitcher with its chip in another mode; acceleration in 256ths."""
    text = f'base = "stitcher"\nname = "mine"\n[controllers.x]\nkind = "{kind}"\n'
    text += f'acceleration = "{acceleration / 256!r} count/tick**2 exact, assumed"\n'
    if velocity is not None:
        text += f'velocity = "{velocity} count/tick exact, assumed"\n'
    file = tmp_path / "mine.toml"
    file.write_text(text)
    return load_machine(str(file))


def check_against(machine, given, profile, table, *, quantised: bool) -> np.ndarray:
    """Assert that the head follows the reference; return the positions of the head."""
    head = run(Axis(), given, LEAD, quantised=quantised, profile=profile)[:, 3]
    recording = simulate(table(machine, {"X": given}), machine, quantised=quantised)
    _, load = recording.samples("X.load")
    np.testing.assert_allclose(load[: len(head)], head, atol=COUNT_M if quantised else 1e-7)
    _, current = recording.samples("X.current_peak")
    assert np.abs(current).max() == pytest.approx(LIMIT, abs=1e-9)
    return head


@pytest.mark.parametrize("quantised", [False, True])
@pytest.mark.parametrize("acceleration", [150, 900])
def test_integral_velocity(acceleration, quantised, table, tmp_path):
    """50 counts per ms, back at 30, on at 50: ramps at the filter's clock, whole counts per tick.

    At 900/256 the ramps take longer than a reference and need more than 27 A.
    """
    given = np.repeat([0, 90, -30, 50], [2, 18, 14, 6]) * (1 if acceleration < 500 else 2)
    machine = machine_of(tmp_path, "integral-velocity", acceleration)
    profile = IntegralVelocity(acceleration, whole=quantised)
    head = check_against(machine, given, profile, table, quantised=quantised)
    assert np.ptp(head) > 1e-3


def test_integral_velocity_is_constant(table, tmp_path):
    """At the end 7 counts in every tick; within 10 counts of 5147, as the load still rings.

    The references alone give 6.94 counts, 47 less in the same time.
    """
    machine = machine_of(tmp_path, "integral-velocity", 17)
    given = np.full(400, 51)  # 6.94 counts per tick
    recording = simulate(table(machine, {"X": given}), machine)
    _, measured = recording.samples("X.measured")
    expected = 7 / TICK * 0.1 * COUNT_M
    assert measured[399] - measured[299] == pytest.approx(expected, abs=10 * COUNT_M)


@pytest.mark.parametrize("quantised", [False, True])
@pytest.mark.parametrize(("acceleration", "velocity"), [(37, 11), (600, 20)])
def test_trapezoid(acceleration, velocity, quantised, table, tmp_path):
    """Forth, and back with a target that comes while the first profile is still under way."""
    given = np.zeros(40, dtype=np.int64)
    given[[1, 6, 30]] = 1001, -1600, 3
    machine = machine_of(tmp_path, "trapezoid", acceleration, velocity)
    profile = Trapezoid(acceleration, velocity)
    head = check_against(machine, given, profile, table, quantised=quantised)
    assert np.ptp(head) > 5e-4
    assert profile.target != 256 * 1001  # the next profile was begun
    assert profile.target != 256 * (1001 - 1600) or acceleration == 37


@pytest.mark.parametrize(("distance", "top"), [(900, 20), (90, 20), (7, 20), (1, 1)])
def test_trapezoid_is_one(distance, top):
    """The profile itself against the closed form: never faster, within a tick of its time."""
    chip, a = Trapezoid(64, top), 0.25
    at = [0.0]
    while at[-1] != distance:
        at.append(chip(distance, 0))
    speeds = np.diff([0.0, *at, at[-1]])
    peak = min(top, np.sqrt(a * distance))
    time = distance / peak + peak / a
    assert speeds.max() <= top
    assert np.abs(np.diff(speeds)).max() <= a
    assert time - 1 <= len(at) - 1 <= time + 2


@pytest.mark.parametrize(
    ("kind", "acceleration", "velocity", "named"),
    [
        ("integral-velocity", 0.4, None, "fifteen bits"),
        ("integral-velocity", 256 * 128, None, "fifteen bits"),
        ("trapezoid", 17, 128, "at most 127"),
        ("trapezoid", 17, None, "velocity"),
    ],
)
def test_registers(kind, acceleration, velocity, named, tmp_path):
    with pytest.raises(MachineError, match=named):
        machine_of(tmp_path, kind, acceleration, velocity)


def test_feed_forward_is_refused(tmp_path):
    """The inverse needs to set every reference; a chip that makes its own does not allow that."""
    machine = machine_of(tmp_path, "integral-velocity", 17)
    motion = smooth_motion(np.array([0.0, 0.1]), np.array([[0.0], [0.0]]), np.full(5, 0.01))
    with pytest.raises(MachineError, match="generates positions itself"):
        feed_forward(machine, "X", motion, 0.0, 0.1)
    # The way of the commands, run by run.
    with pytest.raises(MachineError, match="generates positions itself"):
        AxisPreview(machine, "X")
