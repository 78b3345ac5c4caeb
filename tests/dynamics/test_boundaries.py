"""A stated margin decides eigenvalues on a boundary, not the last digit."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.dynamics.margins import (
    DOUBLE,
    SIMPLE,
    not_decaying,
    size_of,
    swinging,
    unstable_eigenvalues,
)


def oscillator(omega: float, damping_ratio: float) -> np.ndarray:
    """``x'' + 2 z w x' + w^2 x = 0``: poles ``-z w +- i w sqrt(1 - z^2)``."""
    return np.array([[0.0, 1.0], [-(omega**2), -2.0 * damping_ratio * omega]])


@pytest.mark.parametrize("omega", [1e-2, 1.0, 19.03, 1e4])
@pytest.mark.parametrize("seed", range(8))
def test_an_undamped_pair_never_decays_in_whatever_coordinates(omega: float, seed: int) -> None:
    """A similarity transform moves the last digits of the real part to either side of zero."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(2, 2)))[0] @ np.diag(rng.uniform(0.1, 10.0, 2))
    turned = turn @ oscillator(omega, 0.0) @ np.linalg.inv(turn)
    assert len(not_decaying(turned)) == 2
    damped = turn @ oscillator(omega, 1e-3) @ np.linalg.inv(turn)
    assert len(not_decaying(damped)) == 0


@pytest.mark.parametrize("seed", range(8))
def test_a_critically_damped_pair_does_not_swing_in_whatever_coordinates(seed: int) -> None:
    """Its double pole splits by the square root of rounding, with or without imaginary part."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(2, 2)))[0] @ np.diag(rng.uniform(0.1, 10.0, 2))
    critical = turn @ oscillator(30.0, 1.0) @ np.linalg.inv(turn)
    assert len(swinging(critical)) == 0
    below = turn @ oscillator(30.0, 0.999) @ np.linalg.inv(turn)
    (pole,) = swinging(below)
    assert pole == pytest.approx(30.0 * (-0.999 + 1j * np.sqrt(1 - 0.999**2)), rel=1e-9)


def test_a_free_mass_beside_a_stiff_beam_does_not_swing() -> None:
    """Its double pole at 0 splits by the rounding of the beam's 1e8 1/s^2, not of its own."""
    mass = np.zeros((4, 4))
    mass[0, 2] = mass[1, 3] = 1.0
    mass[2, :2], mass[3, :2] = (-1e8, 1e8), (1e8, -1e8)
    (pole,) = swinging(mass)
    assert pole.imag == pytest.approx(np.sqrt(2e8), rel=1e-12)


def test_the_norm_does_not_depend_on_units() -> None:
    """m or um in one of the states is a similarity: balancing removes it."""
    matrix = oscillator(19.03, 0.1)
    scaled = np.diag([2.0**20, 1.0]) @ matrix @ np.diag([2.0**-20, 1.0])
    assert size_of(scaled) == pytest.approx(size_of(matrix), rel=1e-12)
    assert size_of(np.empty((0, 0))) == 0.0
    assert not len(not_decaying(np.empty((0, 0)))) and not len(swinging(np.empty((0, 0))))


def test_an_integrator_is_on_the_circle_and_a_slow_growth_is_not() -> None:
    assert not len(unstable_eigenvalues(np.array([[1.0 + 5e-10]])))
    assert len(unstable_eigenvalues(np.array([[1.0 + 1e-8]]))) == 1
    assert SIMPLE < DOUBLE
