"""The streaming inverse, compared with the inverse in one piece, which DOP853 tests."""

from __future__ import annotations

import numpy as np
import pytest

from tests.dynamics.in_one_piece import feed_forward, smooth_motion
from tests.dynamics.test_feedforward import WIDTHS, load_error, trapezoid
from threadline.dynamics.preview import AxisPreview
from threadline.errors import MachineError
from threadline.machine import load_machine


@pytest.mark.long(only=("37-Y",))
@pytest.mark.parametrize("axis", ["X", "Y"])
@pytest.mark.parametrize("run", [37, 4096])
def test_runs_give_what_the_whole_gives(axis, run):
    machine = load_machine("stitcher")
    motion = smooth_motion(*trapezoid(), WIDTHS)
    whole = feed_forward(machine, axis, motion, motion.start_s, motion.end_s, settle_s=0.1)
    preview = AxisPreview(machine, axis)
    timing = preview.timing
    assert timing.tick_s == pytest.approx(136e-6)
    # Dead time of 3 ms and half a hold ahead; a reference is held for a millisecond.
    assert timing.early_s == pytest.approx(3.068e-3) and timing.held_s == pytest.approx(0.5e-3)
    assert timing.lead_s == pytest.approx(4e-3)
    # X: the zero of the filter, 0.976; Y: the frame's damping of 1000 N s/m on 175 kg.
    expected_s = {"X": 136e-6 * np.log(1e3) / -np.log(0.976), "Y": np.log(1e3) * 2 * 175 / 1000}[
        axis
    ]
    assert timing.settle_s == pytest.approx(expected_s, rel=1e-6)
    count = int((motion.end_s + 0.1 - whole.start_s) / timing.tick_s)
    ticks = whole.start_s + timing.tick_s * np.arange(count)
    reports = []
    for begin in range(0, count, run):
        t = ticks[begin : begin + run]
        ahead_s = preview.ahead * timing.tick_s
        acts = whole.start_s + timing.tick_s * np.arange(
            begin + preview.ahead if begin else 0, begin + len(t) + preview.ahead
        )
        assert acts[-1] == pytest.approx(t[-1] + ahead_s)
        derivatives = [
            np.stack([motion(at, order) for order in range(preview.orders)], axis=1)
            for at in (t, acts + timing.early_s)
        ]
        reports.append(preview.feed(t, *derivatives))
    due = whole.start_s + 1e-3 * np.arange(int(count * timing.tick_s / 1e-3) - 1)
    reference = np.interp(due + timing.held_s, ticks, np.concatenate(reports))
    # 1 nm: two ways to integrate the frame, of fourth and of sixth order.
    np.testing.assert_allclose(reference, whole.reference_si[: len(due)], atol=1e-9)
    demand = preview.demand
    assert demand.current_a == pytest.approx(whole.peak_current_a, rel=1e-6)
    assert demand.volts == pytest.approx(whole.peak_volts, rel=1e-6)
    assert demand.bound_by == "current"
    assert demand.share == pytest.approx(whole.peak_current_a / 27)


def test_filters_without_a_stable_inverse_are_refused(tmp_path):
    file = tmp_path / "m.toml"
    file.write_text(
        'base = "stitcher"\n[controllers.x]\nkind = "pd"\nkp = "0 dac/count exact, assumed"\n'
        'kd = "1 dac/count exact, assumed"\ngain = "none"\nzero = "none"\npole = "none"\n'
    )
    # kp e + kd (e - e before): the zero lies at kd / (kp + kd), here 1.
    with pytest.raises(MachineError, match=r"no stable inverse, because of a zero at \|z\| = 1\. "):
        AxisPreview(load_machine(str(file)), "X")


@pytest.mark.parametrize("damping", [5.0, 20.0, 200.0])
def test_damped_belts_are_followed_however_fast_their_zero_decays(tmp_path, damping):
    """The zero k/c of the belt times the controller's tick: 17, 4.2 and 0.42.

    With these references the sampled loop stays within 2.5 um (1.5 um without damping; 2 to 3 mm
    without feed-forward): the volts are the difference of two large terms, so a small relative
    error of the inverse means metres.
    """
    file = tmp_path / "damped.toml"
    file.write_text(
        f'base = "stitcher"\n[links.x_belt]\ndamping = "{damping} N s/m +- 50 %, assumed"\n'
    )
    machine = load_machine(str(file))
    motion = smooth_motion(*trapezoid(), WIDTHS)
    whole = feed_forward(machine, "X", motion, motion.start_s, motion.end_s, settle_s=0.1)
    assert load_error(machine, "X", whole.reference_si, whole.start_s, motion) < 2.5e-6
    preview = AxisPreview(machine, "X")
    assert preview.inverse.Q[0, 0] == pytest.approx(-6.24e5 / damping)
    timing = preview.timing
    count = int((motion.end_s + 0.1 - whole.start_s) / timing.tick_s)
    t = whole.start_s + timing.tick_s * np.arange(count)
    now, early = (
        np.stack([motion(at, order) for order in range(preview.orders)], axis=1)
        for at in (
            t,
            whole.start_s + timing.tick_s * np.arange(count + preview.ahead) + timing.early_s,
        )
    )
    references = preview.feed(t, now, early)
    due = whole.start_s + 1e-3 * np.arange(int(count * timing.tick_s / 1e-3) - 1)
    reference = np.interp(due + timing.held_s, t, references)
    assert load_error(machine, "X", reference, whole.start_s, motion) < 2.5e-6
    assert preview.demand.volts == pytest.approx(whole.peak_volts, rel=1e-3)
