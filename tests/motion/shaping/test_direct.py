"""Direct designs against closed forms, bounds and the simulated oscillator; Klipper's types."""

from __future__ import annotations

import math

import numpy as np
import pytest

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError
from threadline.motion.shaping.designs import convolve, design, parse_shaper, simulated_vibration
from threadline.motion.shaping.direct import Requirement, direct_shaper, specified_insensitivity
from threadline.motion.shaping.firmwares import (
    klipper_export,
    klipper_impulses,
    marlin_export,
    reprap_export,
)
from threadline.motion.shaping.onoff.body_and_modes import RestToRest, worst_ringing
from threadline.motion.shaping.onoff.switched import residual_front, switched_command
from threadline.motion.shaping.response import pole, response, responses
from threadline.motion.shaping.robustness import insensitivity
from threadline.motion.shaping.types import FlexibleMode, ShaperError


@pytest.mark.parametrize("derivatives", [0, 1])
def test_one_mode_gives_zv_and_zvd(derivatives: int) -> None:
    """Positive and shortest: Singer and Seering's trains, without being told their form."""
    mode = FlexibleMode(3.04, 0.1)
    found = direct_shaper([Requirement(mode, derivatives=derivatives)])
    expected = design(["zv", "zvd"][derivatives], mode)
    assert found.times_s == pytest.approx(expected.times_s, abs=1e-9)
    assert found.amplitudes == pytest.approx(expected.amplitudes, abs=1e-9)


def test_two_modes_are_shorter_together_than_convolved() -> None:
    modes = [FlexibleMode(3.04, 0.01), FlexibleMode(7.0, 0.05)]
    found = direct_shaper([Requirement(m) for m in modes])
    for m in modes:
        assert simulated_vibration(found, m.frequency_hz, m.damping_ratio) < 1e-10
    assert found.amplitudes.min() > 0.0
    apart = convolve(*[design("zv", m) for m in modes])
    assert found.duration_s < 0.95 * apart.duration_s


@pytest.mark.parametrize("ratio", [12.5, 40.0, 250.0, 990.0])
def test_modes_far_apart_cost_little_more_than_the_slower_alone(ratio: float) -> None:
    """No train for both is shorter than one for the slower mode; the faster adds at most its own.

    Every vibration in both bands comes from a simulated oscillator, without a formula of shaping.
    """
    slow, fast = FlexibleMode(0.4, 0.01), FlexibleMode(0.4 * ratio, 0.02)
    found = direct_shaper([Requirement(fast, 0.05, 0.2), Requirement(slow, 0.05, 0.2)])
    one_by_one = [specified_insensitivity(mode, 0.2).duration_s for mode in (slow, fast)]
    assert one_by_one[0] <= found.duration_s <= sum(one_by_one) * (1.0 + 1e-12)
    for mode in (slow, fast):
        for f in mode.frequency_hz * np.linspace(0.8, 1.2, 9):
            assert simulated_vibration(found, float(f), mode.damping_ratio) < 0.05 + 1e-9


def test_modes_that_no_single_train_can_serve_are_refused() -> None:
    far = [Requirement(FlexibleMode(0.043)), Requirement(FlexibleMode(645.0))]
    with pytest.raises(
        OptionError, match=r"0.043 Hz and 645 Hz: the ratio 1.5e\+04 is beyond 1000"
    ):
        direct_shaper(far)
    near = [Requirement(FlexibleMode(1.0 + 0.3 * k), 0.05, 0.1) for k in range(7)]
    with pytest.raises(ShaperError, match=r"7 modes near each other.*convolve"):
        direct_shaper(near)


def test_gradients_at_many_frequencies_are_differences() -> None:
    """Central differences of the plain sum: their error is of the order of 1e-9."""
    a, t, s = np.array([0.3, 0.5, 0.2]), np.array([0.0, 0.4, 1.1]), pole(0.05)
    f = np.array([0.7, 1.0, 3.3])
    values, gradients = responses(a, t, f, s)
    assert values == pytest.approx([response(a, t, float(g), s, 0) for g in f], abs=1e-15)
    for k in range(5):
        step = np.zeros(5)
        step[k] = 1e-6
        ends = [
            responses(a + sign * step[2:], t + sign * np.append(0.0, step[:2]), f, s)[0]
            for sign in (1.0, -1.0)
        ]
        assert gradients[:, k] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-7)


def test_undamped_two_modes_closed_form() -> None:
    """Three equally spaced impulses null f1 and f2 if 2 pi f h lie symmetrically about pi."""
    found = direct_shaper([Requirement(FlexibleMode(1.0)), Requirement(FlexibleMode(2.7))])
    h = 1.0 / 3.7
    assert found.times_s == pytest.approx([0.0, h, 2.0 * h], abs=1e-9)
    side = 1.0 / (2.0 - 2.0 * math.cos(2.0 * math.pi * h))
    assert found.amplitudes[0] == pytest.approx(side, abs=1e-9)


@pytest.mark.parametrize(("zeta", "relative"), [(0.0, 0.1), (0.0, 0.3), (0.05, 0.2), (0.2, 0.1)])
def test_specified_insensitivity_is_met_and_not_exceeded(zeta: float, relative: float) -> None:
    mode = FlexibleMode(3.04, zeta)
    found = specified_insensitivity(mode, relative, 0.05)
    assert found.amplitudes.min() >= 0.0
    worst = max(
        simulated_vibration(found, 3.04 * (1 + r), zeta)
        for r in np.linspace(-relative, relative, 41)
    )
    assert 0.0499 < worst <= 0.05 + 1e-9
    if zeta:
        # The band of EI cannot take longer than EI.
        ei = design("ei", mode)
        width = insensitivity(ei, mode)
        if 2 * relative <= width.value:
            assert found.duration_s <= ei.duration_s


def test_specified_insensitivity_of_the_band_of_ei_is_ei() -> None:
    mode = FlexibleMode(1.0)
    ei = design("ei", mode)
    width = insensitivity(ei, mode)
    found = specified_insensitivity(mode, 0.4999999 * width.value, 0.05)
    assert found.duration_s == pytest.approx(ei.duration_s, rel=1e-6)


def test_contradictory_requirements_are_refused() -> None:
    with pytest.raises(OptionError, match="no train is silent over a band"):
        Requirement(FlexibleMode(1.0), relative=0.1)
    with pytest.raises(OptionError, match="derivatives"):
        Requirement(FlexibleMode(1.0), tolerance=0.1, derivatives=1)
    with pytest.raises(OptionError, match="at least one"):
        direct_shaper([])


@pytest.mark.parametrize("zeta", [0.0, 0.1])
def test_klipper_plays_the_common_kinds(zeta: float) -> None:
    mode = FlexibleMode(40.0, zeta)
    expected = {"zv": "zv", "mzv": "mzv", "zvd": "zvd", "ei": "ei", "2hump-ei": "2hump_ei"}
    for kind, word in expected.items():
        export = klipper_export(design(kind, mode), mode)
        assert export.shaper_type == word
        assert f"shaper_type_x: {word}\nshaper_freq_x: 40\n" in export.section
        # Closed forms agree to rounding, published curve fits to half a percent of V.
        assert export.difference < (1e-12 if word in ("zv", "mzv", "zvd") else 0.005)
        theirs = klipper_impulses(word, mode)
        limit = 0.055 if "ei" in word else 1e-10
        assert simulated_vibration(theirs, 40.0, zeta) < limit


def klipper_mzv(n: int, t: float, zeta: float) -> tuple[FloatArray, FloatArray]:
    """Return amplitudes, and times in damped periods, by the equations of Klipper's sources.

    Sum 1, and cosine and sine sums 0 at the frequencies 1 + i / tau; then the decay.
    """
    tau = t * (n - 2) / (n - 2 * t - 1)
    at = np.linspace(0.0, t, n)
    phase = 2 * np.pi * (1 + np.arange(n - 1) / tau)[:, None] * at
    rows = np.vstack((np.ones(n), np.cos(phase), np.sin(phase)))
    expected = np.append(1.0, np.zeros(2 * n - 2))
    weights = np.linalg.lstsq(rows, expected, rcond=None)[0]
    weights *= np.exp(-2 * np.pi * zeta / np.sqrt(1 - zeta**2) * at)
    return weights / weights.sum(), at


@pytest.mark.parametrize(
    ("word", "n", "t"),
    [
        ("mzv", 3, 0.75),
        ("mzv(n=4,t=0.9)", 4, 0.9),
        ("mzv(5, 1.1)", 5, 1.1),
        # t = tau (n - 1) / (n + 2 tau - 2)
        ("mzv(n=5,tau=1)", 5, 0.8),
        ("mzv(n=6, t=1.0)", 6, 1.0),
    ],
)
@pytest.mark.parametrize("zeta", [0.0, 0.1])
def test_mzv_takes_klippers_parameters(word: str, n: int, t: float, zeta: float) -> None:
    mode = FlexibleMode(40.0, zeta)
    amplitudes, at = klipper_mzv(n, t, zeta)
    for train in (design(word, mode), klipper_impulses(word, mode)):
        assert train.amplitudes == pytest.approx(amplitudes, abs=1e-9)
        assert train.times_s == pytest.approx(at * mode.damped_period_s, abs=1e-12)
        assert simulated_vibration(train, 40.0, zeta) < 1e-10
    export = klipper_export(design(word, mode), mode)
    message = "mzv" if word == "mzv" else f"mzv(n={n},t={t:g})"
    assert f"shaper_type_x: {message}\n" in export.section
    per_axis = parse_shaper(f"X={word}:40Hz:{zeta}, Y=zv:20Hz")
    assert isinstance(per_axis, dict) and set(per_axis) == {"X", "Y"}
    assert per_axis["X"].times_s == pytest.approx(at * mode.damped_period_s)


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("mzv(n=2)", "whole number from 3"),
        ("mzv(n=nan)", "whole number from 3"),
        ("mzv(n=3,t=1)", "below"),
        ("mzv(n=8,t=0.4)", "at least 0.5"),
        ("mzv(t=0.9,tau=1)", "leave one out"),
        ("mzv(m=3)", "unknown"),
        ("mzv(t=inf)", "positive numbers"),
        ("mzv(t=x)", "not a number"),
    ],
)
def test_mzv_refuses_what_klipper_cannot_play(word: str, message: str) -> None:
    with pytest.raises(OptionError) as raised:
        design(word, FlexibleMode(40.0))
    assert message in str(raised.value)


def test_klippers_ei_takes_the_tolerance() -> None:
    mode = FlexibleMode(40.0, 0.05)
    export = klipper_export(design("ei", mode, tolerance=0.1), mode)
    assert "shaper_type_x: ei(v_tol=0.1000)\n" in export.section
    theirs = klipper_impulses("ei(v_tol=0.1000)", mode)
    assert simulated_vibration(theirs, 40.0, 0.05) == pytest.approx(0.1, abs=0.005)


def test_m593_of_marlin_and_reprapfirmware() -> None:
    mode = FlexibleMode(40.0, 0.1)
    damped_hz = 40.0 * np.sqrt(1 - 0.1**2)
    assert marlin_export(design("zv", mode), mode).section == f"M593 F{damped_hz:.6g} D0.1\n"
    for kind, word in (("mzv", "mzv"), ("zvd", "zvd"), ("zvdd", "zvdd"), ("2hump-ei", "ei2")):
        made = design(kind, mode)
        assert reprap_export(made, mode).section == f'M593 P"{word}" F40 S0.1\n'
        other = marlin_export(made, mode)
        assert other.section == "" and "the nearest, M593 F39.7995 D0.1, is" in other.explanation


@pytest.mark.parametrize("kind", ["zvdd", "um-zv", "negative-zv"])
def test_the_nearest_substitute_is_named_where_a_kind_has_no_counterpart(kind: str) -> None:
    """By the simulated vibration, no type of Klipper's comes nearer."""
    mode = FlexibleMode(40.0, 0.05)
    made = design(kind, mode)

    def off(word: str) -> float:
        theirs = klipper_impulses(word, mode)
        return max(
            abs(simulated_vibration(theirs, f, 0.05) - simulated_vibration(made, f, 0.05))
            for f in np.linspace(30.0, 50.0, 41)
        )

    words = ("zv", "mzv", "zvd", "ei", "2hump_ei", "3hump_ei")
    nearest = min(words, key=off)
    explanation = klipper_export(made, mode).explanation
    assert f"the nearest, {nearest}, is {off(nearest):.3f} of V off" in explanation


def test_klipper_has_no_type_for_others() -> None:
    mode = FlexibleMode(40.0, 0.05)
    for kind in ("zvdd", "um-zv", "um-2ei", "negative-zv"):
        export = klipper_export(design(kind, mode), mode)
        assert export.section == ""
        assert "no type of Klipper's" in export.explanation
    at_ten_percent = klipper_export(design("2hump-ei", mode, tolerance=0.1), mode)
    assert at_ten_percent.section == ""
    with pytest.raises(OptionError, match="axes x and y"):
        klipper_export(design("zv", mode), mode, axes="z")
    with pytest.raises(OptionError, match="damping ratios up to"):
        klipper_impulses("3hump_ei", FlexibleMode(40.0, 0.25))


def test_on_off_command_on_a_ten_ms_scan() -> None:
    """At most 1 % over +-20 % within 10 % of the robust optimum, 1.0848 s."""
    move = RestToRest(0.2, 1.0, (FlexibleMode(3.04),))
    command = switched_command(move, relative=0.2, tolerance=0.01, tick_s=0.01, ticks=117)
    assert command is not None
    assert command.duration_s <= 1.1 * 1.0848
    assert set(command.levels.tolist()) <= {-1.0, 0.0, 1.0}
    assert worst_ringing(command, move.modes, 0.2) <= 0.01
    front = residual_front(move, relative=0.2, tolerance=0.01, tick_s=0.01, ticks=[89, 100])
    assert front[0].free is None
    assert front[1].free is not None
    assert front[1].free > 0.2
    assert front[1].switched is None
