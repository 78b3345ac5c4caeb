"""A laminated body of revolution as a deck of shells, for CalculiX and Abaqus.

The deck models a quarter with eight-node shells on the middle of the thickness; every ring along
the meridian has its own plies. The planes of the cuts are planes of symmetry: the plies of a ring
must not couple tension and twist. The left rim is held along the axis. The right rim carries the
force of the pressure on its opening, so that the body is in equilibrium as a closed vessel.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.laminate.theory import Ply

_AROUND = 18  # elements round the quarter
_POISSON_ACROSS = 0.4  # between both directions across the fibres; plane stress does not see it
_MM, _MPA = 1e3, 1e-6


@dataclass(frozen=True, slots=True)
class DeckPly:
    """A ply of a ring: name of its material, angle of its fibres, rad, and thickness, m."""

    material: str
    angle: float
    thickness: float


@dataclass(frozen=True, slots=True, eq=False)
class Rings:
    """A laminated body of revolution as rings.

    Parameters
    ----------
    inside
        (2 n + 1, 2) places along the axis and radii of the inner surface, m: the edges of n rings
        and their middles, from left to right.
    outwards
        (2 n + 1, 2) unit normals there, away from the axis.
    plies
        Plies of each ring, the innermost first.
    """

    inside: FloatArray
    outwards: FloatArray
    plies: Sequence[Sequence[DeckPly]]

    @property
    def thickness_m(self) -> FloatArray:
        """(n,) thickness of the rings, m."""
        return np.array([sum(ply.thickness for ply in ring) for ring in self.plies])

    @property
    def middle(self) -> FloatArray:
        """(2 n + 1, 2) places and radii of the middle of the thickness, m."""
        own = self.thickness_m
        at = np.empty(len(self.inside))
        at[1::2] = own
        at[0], at[-1] = own[0], own[-1]
        at[2:-1:2] = 0.5 * (own[1:] + own[:-1])
        return np.asarray(self.inside + 0.5 * at[:, None] * self.outwards)


def shell_deck(title: str, rings: Rings, materials: Mapping[str, Ply], pressure: float) -> str:
    """Return the text of the deck in mm, N and MPa.

    Parameters
    ----------
    title
        Title of the deck, on one line.
    materials
        Elastic constants by the names that the plies use.
    pressure
        Internal pressure, Pa.
    """
    return "\n".join(_lines(title, rings, materials, pressure)) + "\n"


def _lines(
    title: str, rings: Rings, materials: Mapping[str, Ply], pressure: float
) -> Iterator[str]:
    yield "*HEADING"
    yield title
    yield "** mm, N, MPa. X is the axis of the mandrel. A quarter: PLANE_Y and PLANE_Z are planes"
    yield "** of symmetry. RING_1, RING_2, ... from left to right have their own plies."
    yield from _mesh(rings)
    for name, ply in materials.items():
        yield from _material(name, ply)
    for number, ring in enumerate(rings.plies, start=1):
        chord = rings.middle[2 * number] - rings.middle[2 * number - 2]
        for place in range(_AROUND):
            yield from _section(number, place, ring, chord)
    yield "*STEP"
    yield "*STATIC"
    yield "*BOUNDARY"
    yield "** The cut at z = 0, the cut at y = 0, and the left rim along the axis:"
    for name, dofs in (("PLANE_Z", (3, 4, 5)), ("PLANE_Y", (2, 4, 6)), ("LEFT_RIM", (1,))):
        for dof in dofs:
            yield f"{name}, {dof}, {dof}"
    yield "*DLOAD"
    yield "** On the inner surface in CalculiX; Abaqus has the area of the middle of the thickness."
    yield f"ALL_RINGS, P, {_MPA * pressure:.9g}"
    force = _MPA * pressure * 0.25 * math.pi * (_MM * rings.inside[-1, 1]) ** 2
    yield "*CLOAD"
    yield f"** The pressure on the opening of the right rim: {force:.9g} N of this quarter."
    for place in range(2 * _AROUND + 1):
        share = 4.0 if place % 2 else 1.0 if place in (0, 2 * _AROUND) else 2.0
        node = _number(2 * len(rings.plies), place)
        yield f"{node}, 1, {force * share / (6.0 * _AROUND):.9g}"
    yield from ("*NODE FILE", "U", "*EL FILE", "S, E", "*NODE PRINT, NSET=ALL_NODES", "U")
    yield from ("*EL PRINT, ELSET=ALL_RINGS", "S", "*END STEP")


def _number(edge: int, place: int) -> int:
    """Return the number of a node: by half rings from the left, and half elements round."""
    return edge * (2 * _AROUND + 1) + place + 1


def _mesh(rings: Rings) -> Iterator[str]:
    middle, count, last = _MM * rings.middle, len(rings.plies), 2 * _AROUND
    yield "*NODE, NSET=ALL_NODES"
    for edge, (along, radius) in enumerate(middle.tolist()):
        for place in range(0, last + 1, 1 + edge % 2):
            turn = 0.5 * math.pi * place / last
            y = 0.0 if place == last else radius * math.cos(turn)
            places = (along, y, radius * math.sin(turn))
            yield f"{_number(edge, place)}, " + ", ".join(f"{one:.9g}" for one in places)
    for number in range(1, count + 1):
        low, high = 2 * number - 2, 2 * number
        for place in range(_AROUND):
            # Round the axis first, then along the meridian: the normal points outwards.
            yield f"*ELEMENT, TYPE=S8R, ELSET={_part(number, place)}"
            a, b = 2 * place, 2 * place + 2
            corners = ((low, a), (low, b), (high, b), (high, a))
            sides = ((low, a + 1), (low + 1, b), (high, a + 1), (low + 1, a))
            nodes = [_number(*node) for node in (*corners, *sides)]
            yield ", ".join(map(str, ((number - 1) * _AROUND + place + 1, *nodes)))
        first = (number - 1) * _AROUND + 1
        yield from _set("ELSET", f"RING_{number}", range(first, first + _AROUND))
    yield from _set("ELSET", "ALL_RINGS", range(1, count * _AROUND + 1))
    yield from _set("NSET", "PLANE_Z", [_number(edge, 0) for edge in range(2 * count + 1)])
    yield from _set("NSET", "PLANE_Y", [_number(edge, last) for edge in range(2 * count + 1)])
    yield from _set("NSET", "LEFT_RIM", [_number(0, place) for place in range(last + 1)])


def _part(number: int, place: int) -> str:
    return f"RING_{number}_{place + 1}"


def _set(kind: str, name: str, members: Sequence[int]) -> Iterator[str]:
    yield f"*{kind}, {kind}={name}"
    for begin in range(0, len(members), 12):
        yield ", ".join(map(str, members[begin : begin + 12]))


def _material(name: str, ply: Ply) -> Iterator[str]:
    """Yield a material with the constants of a ply, alike in both directions across the fibres."""
    across = ply.across * _MPA
    shear_across = across / (2.0 * (1.0 + _POISSON_ACROSS))
    numbers = (
        ply.along * _MPA, across, across, ply.poisson, ply.poisson, _POISSON_ACROSS,
        ply.shear * _MPA, ply.shear * _MPA,
    )  # fmt: skip
    yield f"*MATERIAL, NAME={name}"
    yield "*ELASTIC, TYPE=ENGINEERING CONSTANTS"
    yield ", ".join(f"{number:.9g}" for number in numbers)
    yield f"{shear_across:.9g}"


def _section(number: int, place: int, ring: Sequence[DeckPly], chord: FloatArray) -> Iterator[str]:
    """Yield orientations and section of an element; ``chord`` goes along the ring's meridian."""
    cos, sin = (chord / math.hypot(*chord)).tolist()
    turn = 0.5 * math.pi * (place + 0.5) / _AROUND
    along = (cos, sin * math.cos(turn), sin * math.sin(turn))
    round_ = (0.0, -math.sin(turn), math.cos(turn))
    for layer, ply in enumerate(ring, start=1):
        c, s = math.cos(ply.angle), math.sin(ply.angle)
        yield f"*ORIENTATION, NAME=O_{number}_{place + 1}_{layer}, SYSTEM=RECTANGULAR"
        # Along the fibres, and across them in the surface.
        fibre = [c * a + s * b for a, b in zip(along, round_, strict=True)]
        across = [s * a - c * b for a, b in zip(along, round_, strict=True)]
        yield ", ".join(f"{v:.9g}" for v in (*fibre, *across))
    yield f"*SHELL SECTION, COMPOSITE, ELSET={_part(number, place)}"
    for layer, ply in enumerate(ring, start=1):
        yield f"{_MM * ply.thickness:.9g}, , {ply.material}, O_{number}_{place + 1}_{layer}"
