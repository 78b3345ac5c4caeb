"""Lead filters: the printed ones follow from their crossovers and margins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from threadline.dynamics.lead import design_lead, lead_deg, lead_from_response
from threadline.dynamics.loop import axis_loop
from threadline.dynamics.margins import loop_margins
from threadline.dynamics.values import Values
from threadline.errors import OptionError
from threadline.machine import load_machine
from threadline.machine.numbers import with_numbers

PRINTED = {
    ("stitcher-rigid", "X"): (0.89, 0.976, 0.004, 178, 175),
    ("stitcher-rigid", "Y"): (0.85, 0.973, 0.004, 170, 200),
    ("stitcher-rigid-half-mass", "X"): (0.72, 0.966, 0.047, None, None),
    ("stitcher-rigid-half-mass", "Y"): (0.77, 0.961, 0.188, None, None),
}


@pytest.mark.parametrize(("where", "printed"), PRINTED.items())
def test_printed_filters_come_back(where, printed):
    """From the printed filter's own crossover and margin, started from another filter.

    B is given unless it is at the chip's limit: two wishes leave one of three numbers open.
    """
    machine = load_machine(where[0])
    controller = where[1].lower()
    gain, zero, pole, *_ = printed
    worst = loop_margins(axis_loop(machine, where[1])).worst_phase
    other = Values.of(
        machine,
        {f"controllers.{controller}.{k}": np.array([v]) for k, v in (("gain", 0.3), ("zero", 0.9))},
    )
    loop = axis_loop(machine, where[1], other)
    found = design_lead(
        loop,
        worst.omega_rad_s / (2 * np.pi),
        worst.phase_margin_deg,
        *(() if pole == 0.004 else (pole,)),
    )
    assert found.gain == pytest.approx(gain, rel=0.1)
    assert 1 - found.zero == pytest.approx(1 - zero, rel=0.1)
    assert found.pole == pytest.approx(pole, rel=0.1)
    # With any B the filter does the same: 5 % in gain at ten times the crossover.
    default = design_lead(loop, worst.omega_rad_s / (2 * np.pi), worst.phase_margin_deg)
    omega = worst.omega_rad_s * np.geomspace(0.1, 10, 50)
    z = np.exp(1j * omega * default.period_s)
    theirs = gain * (z - zero) / (z + pole)
    ours = default.gain * (z - default.zero) / (z + default.pole)
    np.testing.assert_allclose(np.abs(ours), np.abs(theirs), rtol=0.05)


@pytest.mark.parametrize(("axis", "crossover", "margin"), [("X", 13.5, 65.8), ("Y", 15.0, 64.7)])
def test_printed_crossovers_give_the_printed_continuous_filters(axis, crossover, margin):
    """178 (s + 175), 170 (s + 200) V/rad from the two printed figures: within 10 %."""
    found = design_lead(axis_loop(load_machine("stitcher-rigid"), axis), crossover, margin)
    k, a, b = found.continuous
    printed = PRINTED["stitcher-rigid", axis]
    assert k * 8000 / (2 * np.pi) == pytest.approx(printed[3], rel=0.1)
    assert a == pytest.approx(printed[4], rel=0.1)
    assert b == pytest.approx(14821, rel=0.01)


@pytest.mark.parametrize(("axis", "printed", "ours"), [("X", 70, 70.5), ("Y", 61, 61.3)])
def test_lead_needed_at_25_hz(axis, printed, ours):
    """For 65 deg at 25 Hz the thesis says 70 and 61."""
    loop = axis_loop(load_machine("stitcher-rigid"), axis)
    (found,) = lead_deg(loop.plant_response(np.array([2 * np.pi * 25.0])), 65.0)
    assert found == pytest.approx(ours, abs=0.05)
    assert found == pytest.approx(printed, abs=0.6)


@settings(max_examples=20)
@given(
    crossover=st.floats(4, 18), margin=st.floats(45, 70), axis=st.sampled_from("XY"),
    name=st.sampled_from(["stitcher-rigid", "stitcher-rigid-half-mass"]),
)  # fmt: skip
def test_designs_have_what_was_asked(crossover, margin, axis, name):
    """The loop is closed with the design, on its own frequency response: gain 1, the margin."""
    machine = load_machine(name)
    try:
        found = design_lead(axis_loop(machine, axis), crossover, margin)
    except OptionError as error:
        assert "deg of lead" in str(error)
        return
    loop = axis_loop(with_numbers(machine, found.replaced(axis.lower())), axis)
    L = loop.response(np.array([2 * np.pi * crossover]))[0]
    assert abs(L) == pytest.approx(1.0, rel=1e-9)
    assert np.degrees(np.angle(-L)) == pytest.approx(margin, abs=1e-8)
    assert loop.closed().spectral_radius < 1


def test_many_plants_at_once_are_the_single_ones():
    machine = load_machine("stitcher-rigid")
    loops = [axis_loop(machine, axis) for axis in "XY"]
    omega = 2 * np.pi * np.array([12.0, 14.0])
    response = np.array(
        [loop.plant_response(np.array([w]))[0] for loop, w in zip(loops, omega, strict=True)]
    )
    gains, zeros = lead_from_response(response, omega, 60.0, loops[0].period_s)
    for loop, w, gain, zero in zip(loops, omega, gains, zeros, strict=True):
        single = design_lead(loop, w / (2 * np.pi), 60.0)
        assert gain == pytest.approx(single.gain * single.volt_per_level, rel=1e-12)
        assert zero == pytest.approx(single.zero, rel=1e-12)


@pytest.mark.parametrize(
    ("crossover", "margin", "pole", "message"),
    [
        (60, 80, 1 / 256, "needs 180.0 deg of lead; this filter gives 0.0 ... 84.2 deg"),
        (2, 20, 1 / 256, "of lead; this filter gives"),
        (0, 60, 1 / 256, "outside 0 ... "),
        (4000, 60, 1 / 256, "half the controller's rate"),
        (13, 200, 1 / 256, "phase margin 200 deg"),
        (13, 60, 0.999, "outside 1/256 ... 255/256"),
    ],
)
def test_lead_filter_beyond_the_chip_is_refused(crossover, margin, pole, message):
    with pytest.raises(OptionError) as caught:
        design_lead(axis_loop(load_machine("stitcher-rigid"), "Y"), crossover, margin, pole)
    assert message in str(caught.value)
