"""The design of a winding: every layer with its pattern, on the surface of the layers before it.

For a shell model the layers are cut into rings along the meridian, each with thickness and angle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import JobError, Place, placed
from threadline.jobs.winding.circuit import Circuit
from threadline.jobs.winding.closing_patterns import Pattern, chosen, closed_circuit, patterns
from threadline.jobs.winding.layers import Closing, Layer, Winding
from threadline.jobs.winding.on_mandrel import Wrap, wrap_of
from threadline.jobs.winding.thickness import Thickness, grown, hoops, thickness
from threadline.laminate.deck import DeckPly, Rings
from threadline.laminate.theory import Ply

_HOLLOW = 1e-6  # of 1 / r, of a curvature that points outwards
_PER_RADIUS = 8  # rings in a length of the largest radius
_LEAST_RINGS, _MAX_RINGS = 16, 160  # rings
_THINNEST = 0.05  # of the band: less is no ply
_HOOP_RAD = math.radians(2.0)  # nearer to 90 deg both directions are one


@dataclass(frozen=True, slots=True, eq=False)
class Laid:
    """A layer with its pattern.

    Parameters
    ----------
    wrap
        The layer on its surface.
    table
        All patterns that close, the nearest to the geodesic first.
    pattern, by
        The pattern that is wound, and what closes it.
    circuit
        One of its circuits.
    """

    wrap: Wrap
    table: tuple[Pattern, ...]
    pattern: Pattern
    by: Closing
    circuit: Circuit

    @property
    def layer(self) -> Layer:
        """The layer of the file."""
        return self.wrap.layer

    @property
    def length_m(self) -> float:
        """Length of its fibre without dwells."""
        return self.pattern.circuits * self.circuit.length_m

    @property
    def dwells_m(self) -> float:
        """Length of its fibre on the parallels of the turns."""
        return self.pattern.circuits * self.circuit.dwells_m

    @property
    def fibre_kg(self) -> float | None:
        """Mass of its fibres with dwells; None without ``[band] tex``."""
        per_m = self.layer.band.fibre_kg_m
        return None if per_m is None else per_m * (self.length_m + self.dwells_m)

    @property
    def thickness_m(self) -> float | None:
        """Mean thickness of the layer at the largest radius; None if unknown.

        A circuit passes every place twice: a layer has two bands, times its coverage.
        """
        band_m = self.layer.band.thickness
        return None if band_m is None else 2.0 * band_m * self.pattern.coverage

    @property
    def fibre_m2(self) -> float | None:
        """Cross-section of all bands on a parallel, m^2; None without a thickness of the band."""
        band_m = self.layer.band.thickness
        return None if band_m is None else 2.0 * self.pattern.circuits * self.wrap.width_m * band_m

    def spread(self) -> Thickness | None:
        """Return the thickness along the meridian; None if it is unknown."""
        if self.fibre_m2 is None:
            return None
        if self.layer.kind == "hoop":
            left, right = self.circuit.left.rows[-1, 1], self.circuit.right.rows[-1, 1]
            volume = 0.5 * self.fibre_m2 * self.circuit.length_m
            ends = float(left), float(right)
            return hoops(self.circuit.surface, ends, self.wrap.width_m, volume)
        return thickness(self.circuit, self.wrap.sites, self.wrap.width_m, self.fibre_m2)

    def hollow_m(self) -> tuple[float, float] | None:
        """Return the ends of the hollows of the mandrel, m along it, that the fibre bridges.

        The fibre leaves the surface where its normal curvature ``k cos(a)^2 + cos(b) sin(a)^2 / r``
        points outwards. None without such a place, and above the first layer.
        """
        surface = self.circuit.surface
        if surface is not self.wrap.winding.product.surface:
            return None
        course = self.circuit.course()
        x, r = surface.at(course[:, 1])
        speed = np.hypot(x[:, 1], r[:, 1])
        along_curvature = (r[:, 1] * x[:, 2] - x[:, 1] * r[:, 2]) / speed**3
        round_curvature = x[:, 1] / (speed * r[:, 0])
        normal = (
            along_curvature * np.cos(course[:, 3]) ** 2
            + round_curvature * np.sin(course[:, 3]) ** 2
        )
        places = x[normal * r[:, 0] < -_HOLLOW, 0]
        return (float(places.min()), float(places.max())) if len(places) else None

    @property
    def most_m(self) -> float | None:
        """Largest thickness, at a turn; None if unknown."""
        spread = self.spread()
        return None if spread is None else float(spread.t.max())

    @property
    def slip(self) -> float:
        """Largest friction ratio of the path, dwells without a boss included."""
        circuit, wrap = self.circuit, self.wrap
        ratios = [abs(circuit.left.ratio), abs(circuit.right.ratio)]
        for site, turn in zip(wrap.sites, (circuit.left, circuit.right), strict=True):
            slip = wrap.slip_at(circuit, site)
            if turn.dwell and slip <= wrap.friction:
                ratios.append(slip)
        return max(ratios)


def design(winding: Winding) -> tuple[Laid, ...]:
    """Return every layer with its pattern.

    Raises
    ------
    JobError
        If a layer cannot be wound; the error names its line.
    """
    layers_laid = []
    surface = winding.product.surface
    for layer in winding.layers:
        with placed(Place(str(winding.path), layer.line)):
            wrap = wrap_of(winding, layer, surface)
            table = patterns(wrap)
            pattern, by = chosen(wrap, table)
            circuit = closed_circuit(wrap, pattern, by)
            layer_laid = Laid(wrap, tuple(table), pattern, by, circuit)
            spread = layer_laid.spread()
        layers_laid.append(layer_laid)
        if spread is not None and layer is not winding.layers[-1]:
            try:
                surface = grown(surface, spread)
            except JobError as error:
                winding.refuse(
                    layer, f"nothing can be wound on this layer: with it {error.message}",
                    "Turn the layers at different radii, or take a thinner band.",
                )  # fmt: skip
    return tuple(layers_laid)


def bridged(laid: Laid) -> str | None:
    """Return a warning about hollows of the mandrel under a layer; None without one."""
    hollow = laid.hollow_m()
    if hollow is None:
        return None
    place = Place(str(laid.wrap.winding.path), laid.layer.line)
    begin, end = (1e3 * place_m for place_m in hollow)
    return (
        f"{place}: the fibre bridges the hollow of the mandrel at {begin:.4g} to {end:.4g} mm. "
        "An angle nearer to 90 deg lies closer; threadline prove tells the height."
    )


def rings_of(laid: Sequence[Laid]) -> tuple[Rings, dict[str, Ply]]:
    """Return the rings of a winding, and the elastic constants of their materials by name.

    The two directions of a layer are interwoven through its whole thickness. Four plies, +a, -a, -a
    and +a, each a quarter thick, have the same stiffness, and do not couple tension and twist.

    Raises
    ------
    JobError
        If the material or the thickness of a layer is unknown, or the mandrel is bare in between.
    """
    constants: dict[str, Ply] = {}
    names: list[str] = []
    for number, layer_laid in enumerate(laid, start=1):
        band, layer = layer_laid.layer.band, layer_laid.layer
        if band.composite is None or band.fibre_volume is None or band.thickness is None:
            missing = "material" if band.composite is None else "thickness"
            raise JobError(
                f"a shell model needs the {missing} of layer {number}",
                place=Place(str(layer_laid.wrap.winding.path), layer.line),
                remedy='Write material = "e-glass/epoxy" and thickness = "0.3 mm" into [band].',
            )
        ply = band.composite.ply(band.fibre_volume)
        name = next((name for name, known_ply in constants.items() if known_ply == ply), None)
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
    largest_m = float(base.at(u)[1][:, 0].max())
    count = min(max(math.ceil(_PER_RADIUS * (end - begin) / largest_m), _LEAST_RINGS), _MAX_RINGS)
    places = np.linspace(begin, end, 2 * count + 1)
    x, r = base.at(places)
    speed = np.hypot(x[:, 1], r[:, 1])
    outwards = np.column_stack([-r[:, 1], x[:, 1]]) / speed[:, None]
    thickness, angle = _stack(laid, places[1::2])
    plies = []
    for ring_thickness, angles in zip(thickness.tolist(), angle.tolist(), strict=True):
        ring: list[DeckPly] = []
        for layer_laid, name, thickness_m, a in zip(
            laid, names, ring_thickness, angles, strict=True
        ):
            if thickness_m > _THINNEST * (layer_laid.layer.band.thickness or 0.0):
                ring += _plies(name, a, thickness_m)
        plies.append(ring)
    return Rings(np.column_stack([x[:, 0], r[:, 0]]), outwards, plies), constants


def _plies(name: str, angle: float, thickness: float) -> list[DeckPly]:
    if 0.5 * math.pi - angle < _HOOP_RAD:
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
    for column, layer_laid in enumerate(laid):
        circuit = layer_laid.circuit
        surface = circuit.surface
        places = u if column == 0 else surface.place_of(points[:, 0])
        spread = layer_laid.spread()
        assert spread is not None
        thickness[:, column] = spread.at(places)
        rows = np.vstack([circuit.left.rows[::-1], circuit.middle, circuit.right.rows])
        order = np.argsort(rows[:, 1], kind="stable")
        # Beyond a turn the band lies along the parallel.
        angle[:, column] = np.interp(
            places, rows[order, 1], rows[order, 3], left=0.5 * math.pi, right=0.5 * math.pi
        )
        x, r = surface.at(places)
        speed = np.hypot(x[:, 1], r[:, 1])
        normal = np.column_stack([-r[:, 1], x[:, 1]]) / speed[:, None]
        points = points + thickness[:, column, None] * normal
    return thickness, angle
