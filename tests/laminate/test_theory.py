"""Lamination theory and netting, compared with printed figures, closed forms and energy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from threadline.errors import JobError
from threadline.laminate.materials import composite_of, library
from threadline.laminate.theory import (
    Layered,
    Ply,
    laminate_of,
    netting,
    ply_of,
)

T300 = Ply(along=181e9, across=10.3e9, poisson=0.28, shear=7.17e9)


def test_the_laminate_of_the_textbook() -> None:
    """[0/30/-45] of T300/5208, plies of 5 mm: printed in textbooks of composite mechanics."""
    found = laminate_of([Layered(T300, math.radians(a), 5e-3) for a in (0.0, 30.0, -45.0)])
    assert found.a[0, 0] == pytest.approx(1.7392e9, rel=5e-5)
    assert found.a[0, 2] == pytest.approx(5.663e7, rel=1e-4)
    assert found.b[0, 0] == pytest.approx(-3.129e6, rel=2e-4)
    assert found.d[0, 0] == pytest.approx(3.3432e4, rel=5e-5)
    assert found.thickness == pytest.approx(15e-3, rel=1e-12)


def test_the_stiffness_is_the_energy_of_a_turned_strain() -> None:
    """The strain tensor is turned as a matrix, and numpy inverts the ply's own compliance."""
    compliance = np.array([
        [1.0 / T300.along, -T300.poisson / T300.along, 0.0],
        [-T300.poisson / T300.along, 1.0 / T300.across, 0.0],
        [0.0, 0.0, 1.0 / T300.shear],
    ])  # fmt: skip
    own = np.linalg.inv(compliance)
    for angle in np.linspace(-1.5, 1.5, 13):
        c, s = math.cos(angle), math.sin(angle)
        turn = np.array([[c, s], [-s, c]])
        for strain in np.eye(3):
            tensor = np.array([[strain[0], strain[2] / 2], [strain[2] / 2, strain[1]]])
            turned = turn @ tensor @ turn.T
            inner = np.array([turned[0, 0], turned[1, 1], 2.0 * turned[0, 1]])
            energy = strain @ T300.stiffness(float(angle)) @ strain
            assert energy == pytest.approx(inner @ own @ inner, rel=1e-12)


def test_a_symmetric_laminate_does_not_couple_and_an_isotropic_one_is_a_plate() -> None:
    angles = [0.3, -0.3, 1.2, 1.2, -0.3, 0.3]
    assert np.abs(laminate_of([Layered(T300, a, 1e-3) for a in angles]).b).max() < 1e-3
    steel = Ply(210e9, 210e9, 0.3, 210e9 / 2.6)
    plate = laminate_of([Layered(steel, a, 2e-3) for a in (0.0, 0.7)])
    assert plate.d[0, 0] == pytest.approx(210e9 * 4e-3**3 / 12.0 / 0.91, rel=1e-12)
    assert plate.moduli == pytest.approx((210e9, 210e9, 210e9 / 2.6, 0.3), rel=1e-12)


def test_netting_balances_where_it_is_printed() -> None:
    def unbalanced(angle: float) -> float:
        return netting([(angle, 1e-3)]).ratio - 2.0

    assert brentq(unbalanced, 0.1, 1.5) == pytest.approx(math.radians(54.7356), abs=1e-6)
    for degrees in (10.0, 30.0, 50.0):
        angle = math.radians(degrees)
        hoops = 3.0 * math.cos(angle) ** 2 - 1.0
        both = netting([(angle, 1e-3), (0.5 * math.pi, hoops * 1e-3)])
        assert both.ratio == pytest.approx(2.0, rel=1e-9)
        # Statics of a closed cylinder: p r / 2 along, p r round, and one stress in all fibres.
        stress = both.stress(1e6, 0.1)
        assert stress * 1e-3 * math.cos(angle) ** 2 == pytest.approx(1e6 * 0.1 / 2.0, rel=1e-9)
    assert netting([(0.5 * math.pi, 1e-3)]).stress(1e6, 0.1) > 1e20


def test_fibres_in_a_resin_agree_with_measured_plies() -> None:
    """E-glass in MY750 with 60 %: 45.6 GPa along, 16.2 across, 5.83 in shear, 0.278 (table 3)."""
    glass, epoxy = library()["e-glass"], library()["epoxy"]
    fibre = glass["modulus"], glass["across"], glass["shear"], glass["poisson"]
    ply = ply_of(fibre, (epoxy["modulus"], epoxy["poisson"]), 0.6)
    assert ply.along == pytest.approx(45.6e9, rel=0.01)
    assert ply.poisson == pytest.approx(0.278, rel=0.07)
    assert ply.across == pytest.approx(16.2e9, rel=0.12)
    assert ply.shear == pytest.approx(5.83e9, rel=0.27)
    # In shear the Halpin-Tsai form with 1 is the lower bound of Hashin for round fibres.
    stiff, soft = glass["shear"], epoxy["modulus"] / 2.7
    hashin = soft * (stiff * 1.6 + soft * 0.4) / (stiff * 0.4 + soft * 1.6)
    assert ply.shear == pytest.approx(hashin, rel=1e-12)


def test_every_material_of_the_library_makes_a_ply() -> None:
    def fail(key: str, message: str, remedy: str) -> None:
        raise JobError(f"{key}: {message}", remedy=remedy)

    found = library()
    resins = [name for name, one in found.items() if one.kind == "resin"]
    names = [name for name, one in found.items() if one.kind == "prepreg"]
    names += [f"{f}/{r}" for f in found if found[f].kind == "fibre" for r in resins]
    assert len(names) >= 10
    for name in names:
        composite = composite_of(name, found, fail, "material")  # type: ignore[arg-type]
        ply = composite.ply(composite.fibre_volume or 0.6)
        assert ply.along > ply.across > ply.shear / 3.0 > 0.0
        assert ply.poisson**2 * ply.across < ply.along  # otherwise it would give back energy
        assert 1000.0 < composite.resin_density < 1500.0
    for one in found.values():
        assert one.price is not None
        for number in one.numbers.values():
            assert number.note or number.provenance == "assumed"
