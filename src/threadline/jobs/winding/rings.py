"""A winding as rings along the meridian: thickness and angle of every layer, for a shell model."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import JobError, Place
from threadline.jobs.winding.build_up import Laid
from threadline.laminate.deck import DeckPly, Rings
from threadline.laminate.theory import Ply

_PER_RADIUS = 8  # rings in a length of the largest radius
_LEAST, _MOST = 16, 160  # rings
_THINNEST = 0.05  # of the band: less is no ply
_ROUND = math.radians(2.0)  # nearer to 90 deg both directions are one


def rings_of(laid: Sequence[Laid]) -> tuple[Rings, dict[str, Ply]]:
    """Return the rings of a winding, and the elastic constants of their materials by name.

    A layer is interwoven, both of its directions lie in the whole of its thickness: four plies, +a,
    -a, -a and +a, each a quarter thick, have the same stiffness, and do not couple tension and
    twist.

    Raises
    ------
    JobError
        If the material or the thickness of a layer is unknown, or the mandrel is bare in between.
    """
    constants: dict[str, Ply] = {}
    names: list[str] = []
    for number, one in enumerate(laid, start=1):
        band, layer = one.layer.band, one.layer
        if band.composite is None or band.fibre_volume is None or band.thickness is None:
            lacks = "material" if band.composite is None else "thickness"
            raise JobError(
                f"a shell model needs the {lacks} of layer {number}",
                place=Place(str(one.wrap.winding.path), layer.line),
                remedy='Write material = "e-glass/epoxy" and thickness = "0.3 mm" into [band].',
            )
        ply = band.composite.ply(band.fibre_volume)
        name = next((name for name, known in constants.items() if known == ply), None)
        if name is None:
            name = f"MATERIAL_{len(constants) + 1}"
            constants[name] = ply
        names.append(name)
    base = laid[0].circuit.surface
    u = np.linspace(0.0, base.length_m, 4097)
    wound = np.flatnonzero(_stack(laid, u)[0].sum(axis=1) > 0.0)
    begin, end = float(u[wound[0]]), float(u[wound[-1]])
    if len(wound) != wound[-1] - wound[0] + 1:
        raise JobError(
            "the mandrel is bare between its layers: no single shell",
            place=Place(str(laid[0].wrap.winding.path)),
            remedy="Let the layers meet.",
        )
    most = float(base.at(u)[1][:, 0].max())
    count = min(max(math.ceil(_PER_RADIUS * (end - begin) / most), _LEAST), _MOST)
    places = np.linspace(begin, end, 2 * count + 1)
    x, r = base.at(places)
    speed = np.hypot(x[:, 1], r[:, 1])
    outwards = np.column_stack([-r[:, 1], x[:, 1]]) / speed[:, None]
    thickness, angle = _stack(laid, places[1::2])
    plies = []
    for of_ring, angles in zip(thickness.tolist(), angle.tolist(), strict=True):
        ring: list[DeckPly] = []
        for one, name, thick, a in zip(laid, names, of_ring, angles, strict=True):
            if thick > _THINNEST * (one.layer.band.thickness or 0.0):
                ring += _plies(name, a, thick)
        plies.append(ring)
    return Rings(np.column_stack([x[:, 0], r[:, 0]]), outwards, plies), constants


def _plies(name: str, angle: float, thickness: float) -> list[DeckPly]:
    if 0.5 * math.pi - angle < _ROUND:
        return [DeckPly(name, 0.5 * math.pi, thickness)]
    quarter = 0.25 * thickness
    return [DeckPly(name, sign * angle, quarter) for sign in (1.0, -1.0, -1.0, 1.0)]


def _stack(laid: Sequence[Laid], u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (n, layers) thickness, m, and angle, rad, over places on the bare mandrel.

    Every layer lies on the one below: a place moves out along the normal by the thickness.
    """
    surface = laid[0].circuit.surface
    x, r = surface.at(u)
    points = np.column_stack([x[:, 0], r[:, 0]])
    thickness, angle = np.zeros((len(u), len(laid))), np.zeros((len(u), len(laid)))
    for column, one in enumerate(laid):
        circuit = one.circuit
        surface = circuit.surface
        at = u if column == 0 else surface.place_of(points[:, 0])
        spread = one.spread()
        assert spread is not None
        thickness[:, column] = spread.at(at)
        rows = np.vstack([circuit.left.rows[::-1], circuit.middle, circuit.right.rows])
        order = np.argsort(rows[:, 1], kind="stable")
        # Beyond a turn the band lies along the parallel.
        angle[:, column] = np.interp(
            at, rows[order, 1], rows[order, 3], left=0.5 * math.pi, right=0.5 * math.pi
        )
        x, r = surface.at(at)
        speed = np.hypot(x[:, 1], r[:, 1])
        normal = np.column_stack([-r[:, 1], x[:, 1]]) / speed[:, None]
        points = points + thickness[:, column, None] * normal
    return thickness, angle
