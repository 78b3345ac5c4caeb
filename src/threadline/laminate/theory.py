"""Classical lamination theory and netting analysis.

Axes: 1 along the meridian, 2 round the mandrel. A layer's angle is the angle between its fibres
and axis 1. Sources: S. W. Tsai and H. T. Hahn, Introduction to Composite Materials (1980), chapters
3 to 6; J. C. Halpin and J. L. Kardos, The Halpin-Tsai equations: a review, Polymer Engineering and
Science 16 (1976) 344-352.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Ply:
    """Elastic constants of a layer of parallel fibres in plane stress, Pa.

    Parameters
    ----------
    along, across
        Young's moduli along and across the fibres.
    poisson
        Poisson's ratio: contraction across the fibres over strain along them.
    shear
        Shear modulus in the plane.
    """

    along: float
    across: float
    poisson: float
    shear: float

    def stiffness(self, angle: float) -> FloatArray:
        """Return the (3, 3) plane-stress stiffness, Pa, for 1, 2 and 12 at an angle in rad.

        The shear strain is the engineering shear strain.
        """
        whole = 1.0 - self.poisson**2 * self.across / self.along
        own = np.array([
            [self.along, self.poisson * self.across, 0.0],
            [self.poisson * self.across, self.across, 0.0],
            [0.0, 0.0, self.shear * whole],
        ]) / whole  # fmt: skip
        c, s = math.cos(angle), math.sin(angle)
        strain = np.array([
            [c * c, s * s, c * s],
            [s * s, c * c, -c * s],
            [-2.0 * c * s, 2.0 * c * s, c * c - s * s],
        ])  # fmt: skip
        return np.asarray(strain.T @ own @ strain)


@dataclass(frozen=True, slots=True)
class Layered:
    """One layer of a laminate: its ply, the angle of its fibres, rad, and its thickness, m."""

    ply: Ply
    angle: float
    thickness: float


@dataclass(frozen=True, slots=True, eq=False)
class Laminate:
    """Stiffness of a laminate about the middle of its thickness.

    Parameters
    ----------
    a, b, d
        (3, 3) membrane, coupling and bending stiffness: N/m, N and N m.
    thickness
        Thickness, m.
    """

    a: FloatArray
    b: FloatArray
    d: FloatArray
    thickness: float

    @property
    def moduli(self) -> tuple[float, float, float, float]:
        """Moduli along and round and shear modulus, Pa; Poisson's ratio for a strain along.

        Bending is left out: the laminate of a closed shell cannot curl.
        """
        soft = np.linalg.inv(self.a) * self.thickness
        return (
            1.0 / float(soft[0, 0]), 1.0 / float(soft[1, 1]), 1.0 / float(soft[2, 2]),
            -float(soft[0, 1] / soft[0, 0]),
        )  # fmt: skip


def laminate_of(layers: Sequence[Layered]) -> Laminate:
    """Return the stiffness of layers, the innermost first.

    Raises
    ------
    ValueError
        If no layer has a thickness above 0.
    """
    whole = sum(layer.thickness for layer in layers)
    if not whole > 0.0:
        raise ValueError("a laminate needs a layer with a thickness above 0")
    a, b, d = (np.zeros((3, 3)) for _ in range(3))
    low = -0.5 * whole
    for layer in layers:
        high = low + layer.thickness
        stiff = layer.ply.stiffness(layer.angle)
        a += stiff * (high - low)
        b += stiff * (high**2 - low**2) / 2.0
        d += stiff * (high**3 - low**3) / 3.0
        low = high
    return Laminate(a, b, d, whole)


def ply_of(
    fibre: tuple[float, float, float, float], resin: tuple[float, float], fibre_volume: float
) -> Ply:
    """Return the ply of fibres in a resin.

    The modulus along the fibres and Poisson's ratio follow the rule of mixtures. The modulus across
    and the shear modulus follow the equations of Halpin and Tsai, with the factors 2 and 1. For
    E-glass with 60 % fibre volume these two are 11 % and 26 % below the measured values (Soden,
    Hinton and Kaddour 1998, table 3). Where the resin carries load, prefer the data of a measured
    prepreg.

    Parameters
    ----------
    fibre
        Moduli along and across, shear modulus, Pa, and Poisson's ratio.
    resin
        Young's modulus, Pa, and Poisson's ratio.
    fibre_volume
        Share of the fibres in the volume.
    """
    along, across, shear, poisson = fibre
    soft, soft_poisson = resin
    rest = 1.0 - fibre_volume

    def mixed(stiff: float, matrix: float, shape: float) -> float:
        ratio = (stiff / matrix - 1.0) / (stiff / matrix + shape)
        return matrix * (1.0 + shape * ratio * fibre_volume) / (1.0 - ratio * fibre_volume)

    return Ply(
        along=fibre_volume * along + rest * soft,
        across=mixed(across, soft, 2.0),
        poisson=fibre_volume * poisson + rest * soft_poisson,
        shear=mixed(shear, soft / (2.0 * (1.0 + soft_poisson)), 1.0),
    )


@dataclass(frozen=True, slots=True)
class Netting:
    """Load that fibres alone carry on a cylinder: N/m per Pa of fibre stress, which is m.

    Parameters
    ----------
    along, round
        Sum of fibre thickness times the squared cosine or sine of the angle.
    """

    along: float
    round: float

    @property
    def ratio(self) -> float:
        """Load carried round over load carried along; a closed cylinder needs 2."""
        return self.round / self.along if self.along > 0.0 else math.inf

    def stress(self, pressure: float, radius: float) -> float:
        """Return the fibre stress, Pa, of a closed cylinder under internal pressure, Pa.

        It is the larger of the stresses from both directions; they are equal at a ratio of 2. It is
        infinite if no fibre carries along or none round. ``radius`` is in m.
        """
        if self.along <= 0.0 or self.round <= 0.0:
            return math.inf
        return pressure * radius * max(1.0 / self.round, 0.5 / self.along)


def netting(layers: Sequence[tuple[float, float]]) -> Netting:
    """Return the load that the fibres of layers carry, from their angle, rad, and thickness, m."""
    return Netting(
        along=sum(t * math.cos(angle) ** 2 for angle, t in layers),
        round=sum(t * math.sin(angle) ** 2 for angle, t in layers),
    )
