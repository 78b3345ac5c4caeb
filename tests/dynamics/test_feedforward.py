"""Feed-forward through the exact inverse: the load follows, to the micrometre."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from tests.dynamics.in_one_piece import feed_forward, follow, smooth_motion
from threadline.dynamics.inverse import inverse_of
from threadline.dynamics.loop import axis_loop
from threadline.dynamics.values import Values
from threadline.errors import MachineError, OptionError
from threadline.files import Stream, TickBlock, TickTable
from threadline.machine import load_machine
from threadline.twin import simulate

INCH = 25.4e-3
WIDTHS = np.array([10e-3, 8e-3, 6e-3, 4e-3])


def trapezoid(distance=2.5 * INCH, v=5 * INCH, a=150 * INCH):
    ramp = v / a
    cruise = (distance - v * ramp) / v
    breaks = np.array([0, ramp, ramp + cruise, 2 * ramp + cruise])
    return breaks, np.array(
        [
            [0.5 * a, 0, -0.5 * a],
            [0, v, v],
            [0, 0.5 * a * ramp**2, distance - 0.5 * a * ramp**2],
        ]
    )


def position(t):
    breaks, c = trapezoid()
    k = np.clip(np.searchsorted(breaks, t) - 1, 0, 2)
    s = np.clip(t, breaks[0], breaks[-1]) - breaks[k]
    return c[0, k] * s**2 + c[1, k] * s + c[2, k]


def test_smooth_motion_is_the_moving_average():
    """One and two averages against quadrature; derivatives against differences; ends at rest."""
    one = smooth_motion(*trapezoid(), np.array([0.02]))
    for t in (-0.005, 0.004, 0.033, 0.2, 0.5, 0.53):
        # The corners of the trapezoid are given to the quadrature.
        average = quad(position, t - 0.01, t + 0.01, points=trapezoid()[0], limit=200)[0] / 0.02
        assert one(np.array([t]))[0] == pytest.approx(average, abs=1e-12)
    two = smooth_motion(*trapezoid(), np.array([0.02, 0.012]))
    for t in (0.004, 0.033, 0.5):
        average = quad(lambda u: one(np.array([u]))[0], t - 0.006, t + 0.006)[0] / 0.012
        assert two(np.array([t]))[0] == pytest.approx(average, abs=1e-10)
    four = smooth_motion(*trapezoid(), WIDTHS)
    t = np.linspace(-0.02, 0.6, 4001)
    step = t[1] - t[0]
    for order in range(1, 5):
        before = four(t, order - 1)
        slope = (before[2:] - before[:-2]) / (2 * step)
        got = four(t, order)[1:-1]
        # Differences across a corner of the derivative are off by half its jump in slope.
        assert np.median(np.abs(slope - got)) < 1e-3 * np.abs(got).max()
        assert np.abs(slope - got).max() < 0.15 * np.abs(got).max()
    assert four(np.array([-1.0, four.start_s, four.end_s, 2.0])) == pytest.approx(
        [0, 0, 2.5 * INCH, 2.5 * INCH], abs=1e-9
    )
    assert np.abs(four(np.array([-1.0, 2.0]), 5)).max() == 0.0
    with pytest.raises(OptionError, match="above 0 s"):
        smooth_motion(*trapezoid(), np.array([0.01, 0.0]))


@pytest.mark.long(but="X")
@pytest.mark.parametrize("axis", ["X", "Y"])
def test_volts_of_the_inverse_drive_the_plant_along_the_motion(axis):
    """The plant's equations integrated by DOP853 under the inverse's volts, dead time apart."""
    motion = smooth_motion(*trapezoid(), np.append(WIDTHS, 5e-3))
    inverse = inverse_of(load_machine("stitcher"), axis)
    assert inverse.degree == 5 and len(inverse.Q) == (0 if axis == "X" else 2)
    t = np.arange(motion.start_s, motion.end_s + 0.05, 50e-6)
    followed = follow(inverse, motion, t)
    plant = inverse.plant

    def slope(now, x):
        return plant.A @ x + plant.B[:, 0] * np.interp(now, t, followed.volts)

    done = solve_ivp(
        slope, (t[0], t[-1]), np.zeros(len(plant.A)), "DOP853", rtol=1e-8, atol=1e-11, max_step=1e-3
    )
    load = done.y.T @ plant.C[0]
    # 0.2 um: the volts are interpolated between samples 50 us apart.
    np.testing.assert_allclose(load, motion(done.t), atol=2e-7)
    counts = done.y.T @ inverse.loop.axis_plant().C[0]
    np.testing.assert_allclose(np.interp(done.t, t, followed.measured_counts), counts, atol=0.1)
    coil = plant.states.index(f"{axis.lower()}.i")
    assert np.abs(followed.current_a).max() == pytest.approx(np.abs(done.y[coil]).max(), rel=1e-2)


def load_error(machine, axis, reference_si, start_s, motion):
    """Return the largest distance of the load from the motion, with references held for 1 ms."""
    loop = axis_loop(machine, axis)
    closed = loop.closed()
    ticks = int((len(reference_si) - 1) * 1e-3 / loop.period_s)
    t = np.arange(ticks) * loop.period_s
    held = reference_si[np.floor(t / 1e-3 + 1e-9).astype(int)] * loop.counts_per_unit
    load = closed.respond(held[:, None])[:, closed.outputs.index(f"{axis}.load")]
    return float(np.abs(load - motion(t + start_s)).max())


@pytest.mark.parametrize("axis", ["X", "Y"])
def test_the_loop_follows_to_the_micrometre(axis):
    """Belt, frame, dead time, filter and two clocks; 2 to 3 mm without it."""
    machine = load_machine("stitcher")
    motion = smooth_motion(*trapezoid(), WIDTHS)
    made = feed_forward(machine, axis, motion, motion.start_s, motion.end_s)
    error = load_error(machine, axis, made.reference_si, made.start_s, motion)
    assert error < 1.5e-6
    instants = made.start_s + 1e-3 * np.arange(len(made.reference_si))
    plain = load_error(machine, axis, motion(instants), made.start_s, motion)
    assert plain > 2e-3
    assert made.bound_by == "current" and made.within_limits
    assert 0.5 * made.current_limit_a < made.peak_current_a < made.current_limit_a
    # Each millisecond of preview counts: a reference one tick late is far off.
    late = np.concatenate([made.reference_si[:1], made.reference_si[:-1]])
    assert load_error(machine, axis, late, made.start_s, motion) > 50e-6


def test_the_quantised_machine_follows_too():
    """Both axes on the simulated machine, 8-bit words and whole counts: 50 um against 2 mm."""
    machine = load_machine("stitcher")
    motion = smooth_motion(*trapezoid(), WIDTHS)
    errors = {}
    for kind in ("inverse", "plain"):
        columns, start = [], 0.0
        for axis in "XY":
            made = feed_forward(machine, axis, motion, motion.start_s, motion.end_s, settle_s=0.8)
            start = made.start_s
            instants = start + 1e-3 * np.arange(len(made.reference_si))
            reference = made.reference_si if kind == "inverse" else motion(instants)
            columns.append(np.rint(reference * machine.axes[axis].counts.si).astype(np.int64))
        rows = np.diff(np.stack(columns, axis=1), axis=0, prepend=0)
        table = TickTable(
            clock=machine.tick_clock,
            axes=machine.axis_names,
            counts_per_unit=machine.counts_per_unit,
            start_counts=np.zeros(2, dtype=np.int64),
            blocks=Stream.of(
                [TickBlock(first_tick=0, counts=rows, operation=np.zeros(len(rows), dtype=int))]
            ),
            job_sha256="job",
            machine_sha256=machine.sha256,
        )
        recording = simulate(table, machine, settle_s=0.01)
        for axis in "XY":
            times, load = recording.samples(f"{axis}.load")
            # A row moves during its tick: its end is due one tick later.
            errors[kind, axis] = np.abs(load - motion(times + start - 1e-3)).max()
            assert np.abs(recording.samples(f"{axis}.current_peak")[1]).max() < 27
    for axis in "XY":
        assert errors["inverse", axis] < 50e-6
        assert errors["plain", axis] > 2e-3


def test_errors_of_the_model_show():
    """A mass 10 % off has an effect, at most in proportion: still better than without."""
    machine = load_machine("stitcher")
    motion = smooth_motion(*trapezoid(), WIDTHS)
    wrong = Values.of(machine, {"bodies.x_head.inertia": np.array([1.1 * 111])})
    made = feed_forward(machine, "X", motion, motion.start_s, motion.end_s, model=wrong)
    error = load_error(machine, "X", made.reference_si, made.start_s, motion)
    assert 5e-6 < error < 1e-3


def test_more_current_than_there_is_is_said():
    motion = smooth_motion(*trapezoid(v=7.5 * INCH, a=546 * INCH), 0.2 * WIDTHS)
    made = feed_forward(load_machine("stitcher"), "Y", motion, motion.start_s, motion.end_s)
    assert not made.within_limits and made.bound_by == "current"


def test_shared_bodies_and_undamped_frames_are_refused(tmp_path):
    file = tmp_path / "m.toml"
    file.write_text('base = "stitcher"\n[bodies.frame]\ndamping = "none"\n')
    with pytest.raises(MachineError, match="its inverse is unstable, the plant has a zero at"):
        inverse_of(load_machine(str(file)), "Y")
    file.write_text(
        'base = "stitcher"\n[links.bridge]\nstiffness = "1e5 N/m exact, assumed"\n'
        'stretch = { x_head = "1 exact, assumed", y_head = "-1 exact, assumed" }\n'
    )
    with pytest.raises(MachineError, match="shares bodies with the drives of other axes"):
        inverse_of(load_machine(str(file)), "X")


def test_references_and_their_derivatives_rise_with_the_motion():
    """A rigid winder axis: the inverse is J y'' + B y' by hand, in volts."""
    machine = load_machine("lathe-winder")
    motion = smooth_motion(*trapezoid(0.05, 0.1, 1.0), np.array([0.05, 0.05]))
    inverse = inverse_of(machine, "X")
    t = np.arange(motion.start_s, motion.end_s, 1e-3)
    followed = follow(inverse, motion, t)
    radius = 4000 / (2 * np.pi) / 55.358e3
    KT, KE, R, J = 0.082, 8.6 / (1000 * 2 * np.pi / 60), 0.4, 3.606e-4
    by_hand = (R * J / KT * motion(t, 2) + KE * motion(t, 1)) / radius / 0.45
    np.testing.assert_allclose(followed.volts, by_hand, atol=1e-9)
    made = feed_forward(machine, "X", motion, motion.start_s, motion.end_s)
    assert made.peak_current_a is None and made.period_s == 5e-3
    assert all(b > a - 1e-4 for a, b in pairwise(made.reference_si))
