"""The printed overshoots of the stitcher's test path, and what play and tolerances add to them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim
from tools import stitcher_overshoots as tool

from threadline.machine.load import load_machine

FITTING = np.array([[1.25, 0.952, 0.6]])


def driven_belt(axis: str) -> float:
    """Return the overshoot in mm of a load whose motor follows exactly: scipy, by hand."""
    k, m, c = (6.24e5, 111.0, 3330.0) if axis == "X" else (1e6, 70.0, 2080.0)
    frame = 0.0 if axis == "X" else 1.0
    rows = [
        [0, 1, 0, 0],
        [-k / m, -c / m, -frame * k / m, 0],
        [0, 0, 0, 1],
        [-k / 175, 0, -(k + 5e6) / 175, -1000 / 175],
    ]
    plant = StateSpace(rows, [[0], [k / m], [0], [k / 175]], [[1, 0, 0, 0]], [[0]])
    motor = tool.side(1e-4)
    motor = np.concatenate((motor, np.full(4000, motor[-1])))
    _, head, _ = lsim(plant, motor, np.arange(len(motor)) * 1e-4)
    return float(1e3 * (head.max() - motor[-1]))


def test_one_filter_gives_the_printed_overshoots():
    """1.70 or 1.78 mm and 1.3 mm with one lead on both axes; those for a rigid drive give less."""
    machine = load_machine("stitcher")
    found = tool.overshoots(machine, FITTING).overshoot
    for axis, (low, high) in tool.PRINTED.items():
        assert low - 0.02 <= found[axis][0] <= high + 0.02
    rigid = tool.overshoots(machine, np.array([[0.89, 0.976, 0.004]])).overshoot
    assert rigid["X"][0] < 1.3 and rigid["Y"][0] < 0.9


def test_belts_alone_overshoot_less():
    """A slow filter overshoots less than belt and load alone would, one that fits runs past it."""
    slow_lead = np.array([[0.6, 0.99, 0.6], [1.25, 0.952, 0.6]])
    found = tool.overshoots(load_machine("stitcher"), slow_lead).overshoot
    for axis in "XY":
        assert found[axis][0] < driven_belt(axis) < found[axis][1]
    assert driven_belt("X") == pytest.approx(1.48, abs=0.01)
    assert driven_belt("Y") == pytest.approx(0.92, abs=0.01)


def test_play_adds_little():
    """0.1 mm of play at the head adds some hundredths; what the machine overshot takes 1.6 mm."""
    machine = load_machine("stitcher+backlash")
    lead = (1.25, 0.952, 0.6)
    found = tool.play_table(machine, {"X": lead, "Y": lead}, np.array([0.0, 0.1, 0.4, 1.6]))
    for axis in "XY":
        over = found.overshoot[axis]
        assert (np.diff(over) > 0).all()
        assert over[1] - over[0] < 0.08
    assert found.overshoot["X"][2] < 1.9 < found.overshoot["X"][3]


def test_form_of_the_current_limit_matters():
    machine = load_machine("stitcher")
    held = tool.overshoots(machine, FITTING).overshoot
    clipped = tool.overshoots(tool.clipped_output(machine), FITTING).overshoot
    assert abs(held["X"][0] - clipped["X"][0]) > 0.05


def test_side_is_a_trapezoid():
    """2.5 in; the speed rises by 281 in/s^2 to 7.5 in/s (thesis, chapter 3)."""
    position = tool.side(1e-5)
    speed = np.diff(position) / 1e-5
    assert position[-1] == pytest.approx(63.5e-3)
    assert speed.max() == pytest.approx(0.1905, rel=1e-6)
    assert np.diff(speed)[:1000].max() / 1e-5 == pytest.approx(7.1374, rel=1e-4)
