"""Sensitivity, insensitivity, higher modes, batches and controllers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from threadline.errors import OptionError
from threadline.motion.shaping.controller import ControllerLimits, realise
from threadline.motion.shaping.designs import UNIT_MAGNITUDE, convolve, design, simulated_vibration
from threadline.motion.shaping.firmwares import klipper_impulses
from threadline.motion.shaping.response import residual_vibration, residual_vibration_batch
from threadline.motion.shaping.robustness import check_higher_modes, insensitivity
from threadline.motion.shaping.types import UNSHAPED, FlexibleMode, ShaperError

MODE = FlexibleMode(3.04, 0.0089)


def test_undamped_zv_insensitivity_has_a_closed_form() -> None:
    """V = |cos(pi f / 2 f0)| <= tolerance between 1 -+ 2 asin(tolerance) / pi."""
    mode = FlexibleMode(3.04)
    found = insensitivity(design("zv", mode), mode, 0.05)
    assert found.value == pytest.approx(4.0 * math.asin(0.05) / math.pi, rel=1e-7)
    assert found.low_hz + found.high_hz == pytest.approx(2 * 3.04, rel=1e-9)


def test_a_fast_mode_beside_a_slow_one_keeps_its_width() -> None:
    """Convolved with a ZV a thousand times as slow, the vibration at f is multiplied by its V.

    This V is 1 at even multiples of the slow frequency, one every 0.2 % of the fast one: the width
    lies between that of the ZV alone and one such step more, on either side. The first points of
    the grid, several stretches of it, are below the tolerance.
    """
    fast, slow = FlexibleMode(1000.0), FlexibleMode(1.0)
    both = convolve(design("zv", fast), design("zv", slow))
    single = insensitivity(design("zv", fast), fast, 0.7).value
    found = insensitivity(both, fast, 0.7).value
    assert single <= found < single + 2 * 0.002


def test_a_step_is_amplified_where_it_was_before() -> None:
    """The switched train's V is largest at three times its mode, where its impulses add up: 3."""
    mode = FlexibleMode(2.0)
    found = check_higher_modes(
        convolve(design("um-zv", mode), design("zv", FlexibleMode(0.002))), mode
    )
    assert found.peak == pytest.approx(3.0, rel=1e-3)
    assert found.peak_hz == pytest.approx(6.0, rel=1e-2)


def test_insensitivity_of_what_never_rings_little_is_zero() -> None:
    assert insensitivity(UNSHAPED, MODE).value == 0.0
    with pytest.raises(OptionError, match="tolerance"):
        insensitivity(UNSHAPED, MODE, 0.0)


@pytest.mark.parametrize("kind", ["zv", "ei", "2hump-ei", "um-2ei"])
def test_insensitivity_ends_where_the_simulation_reaches_the_tolerance(kind: str) -> None:
    shaper = design(kind, MODE)
    found = insensitivity(shaper, MODE, 0.05)
    for f in (found.low_hz, found.high_hz):
        assert simulated_vibration(shaper, f, MODE.damping_ratio) == pytest.approx(0.05, abs=1e-8)
    middle = np.linspace(found.low_hz, found.high_hz, 50)
    assert residual_vibration(shaper, middle, MODE.damping_ratio).max() <= 0.05 * (1 + 2e-8)


def test_vibration_over_frequency_and_damping_is_the_simulation() -> None:
    shaper, frequencies, ratios = design("zvd", MODE), (2.5, 3.04, 3.9), (0.0, 0.2)
    table = residual_vibration(shaper, np.array([frequencies]), np.array([ratios]).T)
    expected = [[simulated_vibration(shaper, f, z) for f in frequencies] for z in ratios]
    assert table == pytest.approx(np.array(expected), abs=1e-12)


def test_convolution_multiplies_vibrations_and_merges_coincident_impulses() -> None:
    zv = design("zv", FlexibleMode(3.04, 0.1))
    zvd = design("zvd", FlexibleMode(3.04, 0.1))
    both = convolve(zv, zv)
    assert both.times_s == pytest.approx(zvd.times_s, abs=1e-15)
    assert both.amplitudes == pytest.approx(zvd.amplitudes, abs=1e-15)
    f = np.linspace(1.0, 8.0, 30)
    product = residual_vibration(zv, f, 0.05) * residual_vibration(zvd, f, 0.05)
    assert residual_vibration(convolve(zv, zvd), f, 0.05) == pytest.approx(product, rel=1e-10)
    with pytest.raises(OptionError, match="at least one"):
        convolve()


def test_unit_magnitude_shapers_excite_higher_modes_three_to_seven_times() -> None:
    for kind in UNIT_MAGNITUDE:
        found = check_higher_modes(design(kind, FlexibleMode(3.04)), FlexibleMode(3.04))
        assert 2.9 < found.peak <= 7.0, kind
        assert "amplifies" in found.warnings[0]
        assert 1.5 * 3.04 <= found.peak_hz <= 30.5
    # Undamped, |cos| of a ZV is 1 at 2, 4, ... times its frequency: the lowest is reported.
    assert check_higher_modes(design("zv", FlexibleMode(3.04)), FlexibleMode(3.04)).peak_hz < 6.1
    positive = check_higher_modes(design("zvd", MODE), MODE, [FlexibleMode(9.0)])
    assert positive.warnings == ()
    # UM-ZV at three times its frequency: all three impulses add up.
    known = FlexibleMode(3 * 3.04)
    found = check_higher_modes(design("um-zv", FlexibleMode(3.04)), FlexibleMode(3.04), [known])
    assert found.excited[0][1] == pytest.approx(3.0)
    assert len(found.warnings) == 2


def test_batch_agrees_case_by_case() -> None:
    rng = np.random.default_rng(4)
    m, n = 10_000, 7
    times = np.sort(rng.uniform(0.0, 1.0, (m, n)), axis=1)
    times -= times[:, :1]
    amplitudes = rng.normal(size=(m, n))
    f, z = rng.uniform(0.5, 20.0, m), rng.uniform(0.0, 0.3, m)
    found = residual_vibration_batch(amplitudes, times, f, z)
    s = 2 * np.pi * f * (z + 1j * np.sqrt(1 - z**2))
    expected = np.abs((amplitudes * np.exp(s[:, None] * (times - times[:, -1:]))).sum(axis=1))
    assert found == pytest.approx(expected, rel=1e-10, abs=1e-12)
    with pytest.raises(OptionError, match="shapes"):
        residual_vibration_batch(amplitudes, times[:, :3], f, z)
    with pytest.raises(OptionError, match="damping ratios"):
        residual_vibration(UNSHAPED, 1.0, 1.0)


def test_ticks_dwell_and_price() -> None:
    shaper = design("um-zvd", MODE)
    made = realise(shaper, [MODE], ControllerLimits(tick_s=0.01, dwell_s=0.05))
    assert np.diff(made.ticks).min() >= 5
    assert made.shaper.times_s == pytest.approx(np.array(made.ticks) * 0.01, abs=1e-12)
    assert made.shaper.amplitudes.tolist() == shaper.amplitudes.tolist()
    simulated = simulated_vibration(made.shaper, MODE.frequency_hz, MODE.damping_ratio)
    assert made.vibration == pytest.approx(simulated, abs=1e-10)
    assert made.vibration_price == pytest.approx(simulated, abs=1e-9)
    assert made.vibration_price > 1e-4


def test_free_amplitudes_cancel_on_the_tick() -> None:
    shaper = design("zvd", MODE)
    fixed = realise(shaper, [MODE], ControllerLimits(tick_s=0.01))
    free = realise(shaper, [MODE], ControllerLimits(tick_s=0.01, amplitudes_free=True))
    assert free.vibration < 1e-6
    assert fixed.vibration > 1e-4
    assert free.shaper.amplitudes.min() >= 0.0
    assert free.shaper.amplitudes.sum() == pytest.approx(1.0, abs=1e-12)


def test_at_most_n_impulses() -> None:
    short = realise(
        design("zvdd", MODE),
        [MODE],
        ControllerLimits(tick_s=0.001, max_impulses=3, amplitudes_free=True),
    )
    assert len(short.ticks) == 3
    assert short.vibration < 1e-6
    switched = realise(design("um-zvd", MODE), [MODE], ControllerLimits(0.001, max_impulses=3))
    assert switched.shaper.amplitudes.tolist() == [1.0, -1.0, 1.0]
    with pytest.raises(ShaperError, match="can't be cut"):
        realise(design("negative-zv", MODE), [MODE], ControllerLimits(0.001, max_impulses=2))
    with pytest.raises(OptionError, match="tick_s"):
        ControllerLimits(0.0)


def test_klipper_is_not_asked_for_more_damping_than_it_takes() -> None:
    """Its fit of three humps is valid to 0.2: beyond it Klipper would play another train."""
    assert len(klipper_impulses("3hump_ei", FlexibleMode(10.0, 0.2)).times_s) == 5
    with pytest.raises(OptionError, match=r"3hump_ei takes damping ratios up to 0\.2, got 0\.25"):
        klipper_impulses("3hump_ei", FlexibleMode(10.0, 0.25))


@pytest.mark.parametrize("below", [1e-4, 1e-5, 1e-6])
def test_a_hump_that_rises_above_the_tolerance_between_two_places_of_the_grid(below: float) -> None:
    """Two humps of 5 %, wanted slightly smaller: the interval ends at the foot of the first top.

    The reference is the vibration at a hundred times the places, each rise refined by bisection.
    """
    mode = FlexibleMode(frequency_hz=4.8, damping_ratio=0.0)
    shaper = design("2hump-ei", mode, tolerance=0.05)
    limit = 0.05 * (1.0 - below)
    found = insensitivity(shaper, mode, limit)
    f = np.linspace(mode.frequency_hz, 2.0 * mode.frequency_hz, 400_001)
    over = int(np.argmax(residual_vibration(shaper, f, 0.0) > limit))
    low, high = float(f[over - 1]), float(f[over])
    assert low - 1e-4 <= found.high_hz <= high + 1e-4
    assert found.high_hz < 1.3 * mode.frequency_hz  # and not at the end of the whole band
