"""Margins of loops with several crossovers, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.dynamics.margins import GainCrossover, Margins, PhaseCrossover


def margins(phases, omegas=None, factors=()) -> Margins:
    omegas = np.arange(1.0, 1.0 + len(phases)) if omegas is None else omegas
    return Margins(
        gain_crossovers=tuple(
            GainCrossover(omega_rad_s=w, phase_margin_deg=p)
            for w, p in zip(omegas, phases, strict=True)
        ),
        phase_crossovers=tuple(
            PhaseCrossover(omega_rad_s=1.0, gain_factor=factor) for factor in factors
        ),
        modulus_margin=0.5,
    )


@pytest.mark.parametrize(
    ("phases", "worst"), [((-60.0, 20.0), 20.0), ((-10.0, 50.0), -10.0), ((70.0, 30.0, 40.0), 30.0)]
)
def test_the_worst_phase_is_the_nearest_to_the_limit_from_either_side(phases, worst) -> None:
    found = margins(phases).worst_phase
    assert found is not None and found.phase_margin_deg == worst
    assert margins(()).worst_phase is None


@pytest.mark.parametrize(
    ("phases", "omegas", "delay_s"),
    [
        ((60.0,), (2.0,), np.pi / 3 / 2.0),
        # A lead of 60 degrees too much takes 300 degrees of lag.
        ((-60.0,), (2.0,), 5 * np.pi / 3 / 2.0),
        # 90 degrees at 1 rad/s are 1.571 s, 30 at 10 rad/s 0.052 s, -10 at 100 rad/s 0.061 s.
        ((90.0, 30.0, -10.0), (1.0, 10.0, 100.0), np.pi / 6 / 10.0),
        ((90.0, 80.0, -10.0), (1.0, 10.0, 100.0), np.radians(350.0) / 100.0),
    ],
)
def test_the_delay_margin_is_the_least_dead_time_to_any_crossover(phases, omegas, delay_s) -> None:
    assert margins(phases, omegas).delay_margin_s == pytest.approx(delay_s, rel=1e-12)
    assert margins(()).delay_margin_s is None


def test_gain_margins_on_either_side_of_one() -> None:
    found = margins((), factors=(0.2, 0.5, 3.0, 8.0))
    assert (found.raise_to, found.lower_to) == (3.0, 0.5)
    assert (found.gain_margin(stable=True), found.gain_margin(stable=False)) == (3.0, 0.5)
    # At the limit already, and hardly below and above it.
    close = margins((), factors=(0.99, 1.01))
    assert (close.raise_to, close.lower_to) == (1.01, 0.99)
    at_it = margins((), factors=(1.0, 1.5))
    assert (at_it.raise_to, at_it.lower_to) == (1.5, 1.0)
