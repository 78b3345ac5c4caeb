"""The design of a winding: every layer with its pattern, on the surface of the layers before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.errors import JobError, Place, placed
from threadline.jobs.winding.circuit import Circuit
from threadline.jobs.winding.closing_patterns import Pattern, chosen, closed_circuit, patterns
from threadline.jobs.winding.layers import Closing, Layer, Winding
from threadline.jobs.winding.on_mandrel import Wrap, wrap_of
from threadline.jobs.winding.thickness import Thickness, grown, hoops, thickness

_HOLLOW = 1e-6  # of 1 / r, of a curvature that points outwards


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
        thick = self.layer.band.thickness
        return None if thick is None else 2.0 * thick * self.pattern.coverage

    @property
    def fibre_m2(self) -> float | None:
        """Cross-section of all bands on a parallel, m^2; None without a thickness of the band."""
        thick = self.layer.band.thickness
        return None if thick is None else 2.0 * self.pattern.circuits * self.wrap.width_m * thick

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
        bend = (r[:, 1] * x[:, 2] - x[:, 1] * r[:, 2]) / speed**3
        round_ = x[:, 1] / (speed * r[:, 0])
        normal = bend * np.cos(course[:, 3]) ** 2 + round_ * np.sin(course[:, 3]) ** 2
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
        found = [abs(circuit.left.ratio), abs(circuit.right.ratio)]
        for site, turn in zip(wrap.sites, (circuit.left, circuit.right), strict=True):
            slip = wrap.slip_at(circuit, site)
            if turn.dwell and slip <= wrap.friction:
                found.append(slip)
        return max(found)


def design(winding: Winding) -> tuple[Laid, ...]:
    """Return every layer with its pattern.

    Raises
    ------
    JobError
        If a layer cannot be wound; names its line.
    """
    found = []
    surface = winding.product.surface
    for layer in winding.layers:
        with placed(Place(str(winding.path), layer.line)):
            wrap = wrap_of(winding, layer, surface)
            table = patterns(wrap)
            pattern, by = chosen(wrap, table)
            circuit = closed_circuit(wrap, pattern, by)
            one = Laid(wrap, tuple(table), pattern, by, circuit)
            spread = one.spread()
        found.append(one)
        if spread is not None and layer is not winding.layers[-1]:
            try:
                surface = grown(surface, spread)
            except JobError as error:
                winding.refuse(
                    layer, f"nothing can be wound on this layer: with it {error.message}",
                    "Turn the layers at different radii, or take a thinner band.",
                )  # fmt: skip
    return tuple(found)


def bridged(laid: Laid) -> str | None:
    """Return a warning about hollows of the mandrel under a layer; None without one."""
    hollow = laid.hollow_m()
    if hollow is None:
        return None
    place = Place(str(laid.wrap.winding.path), laid.layer.line)
    begin, end = (1e3 * one for one in hollow)
    return (
        f"{place}: the fibre bridges the hollow of the mandrel at {begin:.4g} to {end:.4g} mm. "
        "An angle nearer to 90 deg lies closer; threadline prove tells the height."
    )
