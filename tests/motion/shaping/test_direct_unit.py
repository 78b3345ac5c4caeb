"""Unit-magnitude designs for several modes: known trains, simulation and a grid search."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from tests.motion.shaping.test_study import run
from threadline.errors import OptionError
from threadline.motion.shaping.designs import convolve, design, simulated_vibration
from threadline.motion.shaping.direct import Requirement, direct_shaper
from threadline.motion.shaping.direct_unit import direct_unit_magnitude, switchings_of
from threadline.motion.shaping.types import FlexibleMode


@pytest.mark.parametrize("zeta", [0.0, 0.02, 0.1])
@pytest.mark.parametrize(("derivatives", "kind"), [(0, "um-zv"), (1, "um-zvd")])
def test_one_mode_gives_the_known_trains(zeta: float, derivatives: int, kind: str) -> None:
    """They are found as a time-optimal switching, without a given number of impulses."""
    mode = FlexibleMode(3.04, zeta)
    found = direct_unit_magnitude([Requirement(mode, derivatives=derivatives)])
    expected = design(kind, mode)
    assert found.amplitudes.tolist() == expected.amplitudes.tolist()
    assert found.times_s == pytest.approx(expected.times_s, abs=1e-9)


@pytest.mark.parametrize(
    "modes",
    [
        [(3.04, 0.009), (7.0, 0.05)],
        [(3.04, 0.009), (9.1, 0.01)],
        [(3.04, 0.009), (3.05, 0.009)],
        [(1.0, 0.0), (2.7, 0.0), (4.1, 0.0)],
    ],
)
def test_several_modes_stand_still_and_no_level_but_0_and_1(
    modes: list[tuple[float, float]],
) -> None:
    expected = [FlexibleMode(*m) for m in modes]
    found = direct_unit_magnitude([Requirement(m) for m in expected])
    for m in expected:
        assert simulated_vibration(found, m.frequency_hz, m.damping_ratio) < 1e-10
    assert set(found.levels.tolist()) == {0.0, 1.0}
    apart = convolve(*[design("um-zv", m) for m in expected])
    # Pulses that do not overlap also leave a convolved train of unit magnitude: a longer one.
    assert apart.over_level > 0.5 or apart.duration_s > 1.03 * found.duration_s


def test_two_modes_cannot_be_silenced_sooner() -> None:
    """Bounded least squares over levels in [0, 1], which include every on/off pattern.

    Neither answer depends on the solver's convergence. In less time, a plane separates the possible
    levels from the wanted ones: its distance, which is computed exactly, bounds them. In more time,
    the found levels are put into the constraints.
    """
    modes = [(1.0, 0.0), (2.3, 0.0)]
    found = direct_unit_magnitude([Requirement(FlexibleMode(*m)) for m in modes])
    for share, feasible in ((0.97, False), (0.999, False), (1.001, True)):
        edges = np.linspace(0.0, share * found.duration_s, 801)
        rows, target = [], []
        for f, _ in modes:
            turned = np.exp(2j * np.pi * f * (edges - edges[-1]))
            for part in (np.real, np.imag):
                rows.append(part(turned[:-1] - turned[1:]))
                target.append(-part(turned[-1]))
        a, b = np.array(rows), np.array(target)
        left = lsq_linear(a, b, bounds=(0.0, 1.0), method="bvls", tol=1e-14)
        missed = a @ np.clip(left.x, 0.0, 1.0) - b
        if feasible:
            assert np.abs(missed).max() < 1e-12
        else:
            normal = missed / np.linalg.norm(missed)
            distance = np.minimum(normal @ a, 0.0).sum() - normal @ b
            assert distance > 1e-3  # a vibration of at least 0.001 of an impulse's


def test_modes_that_coincide_are_one_mode() -> None:
    mode = FlexibleMode(3.04, 0.01)
    twice = direct_unit_magnitude([Requirement(mode), Requirement(mode)])
    assert twice.times_s == pytest.approx(design("um-zv", mode).times_s, abs=1e-9)


def test_a_tolerance_is_refused() -> None:
    with pytest.raises(OptionError, match="only exact zeros"):
        direct_unit_magnitude([Requirement(FlexibleMode(3.0), tolerance=0.05)])
    with pytest.raises(OptionError, match="at least one"):
        direct_unit_magnitude([])


def test_positive_designs_of_neighbouring_modes_become_zvd() -> None:
    """Two zeros that approach each other are a zero and its derivative: ZVD, in the limit."""
    modes = [FlexibleMode(3.04, 0.009), FlexibleMode(3.05, 0.009)]
    found = direct_shaper([Requirement(m) for m in modes])
    zvd = design("zvd", FlexibleMode(3.045, 0.009))
    assert found.times_s == pytest.approx(zvd.times_s, rel=1e-4)
    assert found.amplitudes == pytest.approx(zvd.amplitudes, abs=1e-4)
    for m in modes:
        assert simulated_vibration(found, m.frequency_hz, m.damping_ratio) < 1e-10


def test_two_bands_that_overlap_or_repeat() -> None:
    """The same band twice is the band once; of two that overlap both are met."""
    mode, other = FlexibleMode(3.04, 0.0089), FlexibleMode(3.5, 0.0089)
    one = direct_shaper([Requirement(mode, 0.05, 0.2)])
    twice = direct_shaper([Requirement(mode, 0.05, 0.2)] * 2)
    assert twice.duration_s == pytest.approx(one.duration_s, rel=1e-9)
    both = direct_shaper([Requirement(mode, 0.05, 0.2), Requirement(other, 0.05, 0.2)])
    for m, ratio in itertools.product((mode, other), np.linspace(0.8, 1.2, 21)):
        assert simulated_vibration(both, m.frequency_hz * ratio, m.damping_ratio) <= 0.05 + 1e-9
    assert both.duration_s > one.duration_s


def test_command_line_has_it() -> None:
    code, text, _ = run("--mode", "7Hz", "--kind", "um-direct", "--json")
    content = json.loads(text)
    assert code == 0
    assert {abs(a) for a in content["amplitudes"]} == {1.0}
    assert content["vibration"] < 1e-10


def test_levels_that_are_means_of_a_wave_tell_when_it_switches() -> None:
    """On from 0.25 to 2.6, 5.8 to 8.4, and from 11 cells on: each level is the mean of its cell."""
    edges = np.array([0.25, 2.6, 5.8, 8.4, 11.0])
    cells = np.arange(12.0)
    levels = np.diff(sum(np.clip(cells - a, 0.0, b - a) for a, b in ((0.25, 2.6), (5.8, 8.4))))
    found = switchings_of(levels, 0.01)
    np.testing.assert_allclose(found, 0.01 * (edges - edges[0]), atol=1e-15)
