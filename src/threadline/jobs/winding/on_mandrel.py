"""A layer on its mandrel: at which angle it is wound, and where it turns back at both ends."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from threadline.errors import JobError
from threadline.jobs.winding.circuit import (
    LEVEL,
    ROUGH_LEVEL,
    Circuit,
    Site,
    circuit_of,
    turns,
    widest,
)
from threadline.jobs.winding.layers import MARGIN, OPEN_END_SHARE, Layer, Winding
from threadline.winding.surface import Surface

_TURN = 2.0 * math.pi
_PLACES_BETWEEN = 1025  # places between begin and end
_HOOP_ROWS = 100
_HALVINGS = 12  # of the range of friction ratios of a turn
_NEAR_BANDS = 3.0  # band widths from a turn within which a boss or pins hold a dwell


@dataclass(frozen=True, slots=True, eq=False)
class Wrap:
    """A layer on its surface, before its pattern is chosen.

    Parameters
    ----------
    base
        The circuit before friction, a dwell or another angle closes a pattern.
    sites
        Sites of the left and the right turn.
    least_m
        Radius below which the band's centre must not turn on a dome: opening and half a band.
    width_m
        Width of the band.
    friction
        Largest friction ratio.
    turning
        Friction ratios with which ``base`` turns, left and right; 0 on a dome.
    """

    winding: Winding
    layer: Layer
    surface: Surface
    sites: tuple[Site, Site]
    base: Circuit
    least_m: float
    width_m: float
    friction: float
    turning: tuple[float, float]

    @property
    def name(self) -> str:
        """Name of the layer, with which a message begins."""
        return f"layer {self.layer.number}: "

    @property
    def domes(self) -> bool:
        """Whether the fibre turns by Clairaut's law at one end at least."""
        return any(site.dome for site in self.sites)

    def circuit(
        self, ratio: float = 0.0, constant_m: float | None = None, dwell: float = 0.0
    ) -> Circuit:
        """Return a circuit with a friction ratio on its domes, a Clairaut radius and dwells.

        A positive ``ratio`` steers towards the pole: the fibre turns later and further round.
        """
        constant = self.base.constant_m if constant_m is None else constant_m
        left, right = (
            -ratio if site.dome else self._open_ratio(site, turning_ratio, constant)
            for site, turning_ratio in zip(self.sites, self.turning, strict=True)
        )
        circuit = circuit_of(self.surface, self.sites, constant, (left, right), self.name)
        if dwell == 0.0:
            return circuit
        can_dwell = [self.can_dwell(circuit, site) for site in self.sites]
        share = dwell / sum(can_dwell)
        return replace(
            circuit,
            left=replace(circuit.left, dwell=share if can_dwell[0] else 0.0),
            right=replace(circuit.right, dwell=share if can_dwell[1] else 0.0),
        )

    def _open_ratio(self, site: Site, turning_ratio: float, constant_m: float) -> float:
        """Return the ratio that turns a fibre of another angle as far beyond the joint as ``base``.

        On a cylinder of radius R the turn takes ``(R / sin(a) - R) / ratio``.
        """
        if constant_m == self.base.constant_m:
            return turning_ratio
        radius = float(self.surface.at(np.array([site.joint]))[1][0, 0])
        excesses = [radius / constant - 1.0 for constant in (constant_m, self.base.constant_m)]
        return (
            min(turning_ratio * excesses[0] / excesses[1], self.friction)
            if excesses[1] > 0.0
            else turning_ratio
        )

    def slip_at(self, circuit: Circuit, site: Site) -> float:
        """Return the slip tendency of a dwell on the parallel where a circuit turns."""
        turn = circuit.right if site.side > 0 else circuit.left
        x, r = self.surface.at(turn.rows[-1:, 1])
        return abs(float(r[0, 1] / x[0, 1]))

    def can_dwell(self, circuit: Circuit, site: Site) -> bool:
        """Return whether a dwell holds: by friction, or by a boss or pins beside the turn."""
        if self.slip_at(circuit, site) <= self.friction:
            return True
        turn = circuit.right if site.side > 0 else circuit.left
        turn_m = float(self.surface.at(turn.rows[-1:, 1])[0][0, 0])
        near_m = _NEAR_BANDS * self.width_m
        return any(
            ring.name.startswith("the boss") or ring.name.startswith("the pins")
            for ring in self.winding.product.rings
            if min(abs(ring.begin_m - turn_m), abs(ring.end_m - turn_m)) <= near_m
            or ring.begin_m <= turn_m <= ring.end_m
        )


def wrap_of(winding: Winding, layer: Layer, surface: Surface) -> Wrap:
    """Return a layer on the surface on which it is wound.

    Raises
    ------
    JobError
        If the layer cannot be wound there.
    """
    product, width = winding.product, winding.product.width.si
    level = LEVEL if surface is product.surface else ROUGH_LEVEL
    largest_m, first, last = widest(surface, level)
    if layer.kind == "hoop":
        return _hoops(winding, layer, surface)
    begin, end = _full_angle_ends(winding, layer)
    if surface is not product.surface and begin is not None and end is not None:
        largest_m, first, last = _widest_between(surface, (begin, end), (largest_m, first, last))
    least_radii_m = [_least_radius(surface, first, -1), _least_radius(surface, last, 1)]
    rims = [_rim(surface, side, width, winding.friction) for side in (-1, 1)]
    is_narrow = [least_radius_m < 0.95 * largest_m for least_radius_m in least_radii_m]
    domes_m = [
        rim.band_m for rim, narrows in zip(rims, is_narrow, strict=True) if narrows and rim.steep
    ]
    if layer.turn_m is not None:
        constant = layer.turn_m
    elif layer.angle is not None:
        constant = largest_m * math.sin(layer.angle)
    elif domes_m and len(domes_m) == sum(is_narrow):
        constant = max(domes_m)
    else:
        winding.refuse(layer, "the mandrel has no dome that gives an angle", 'angle = "55 deg"')
    turned_rims = [
        rim
        for rim, narrows in zip(rims, is_narrow, strict=True)
        if narrows and rim.end_m < constant
    ]
    least = max((rim.band_m for rim in turned_rims), default=0.0)
    if constant >= largest_m * math.cos(math.radians(0.5)):
        winding.refuse(
            layer, f"a turn at {1e3 * constant:.4g} mm leaves no angle on a mandrel of "
            f"{1e3 * largest_m:.4g} mm", "Give a smaller turn, or a hoop layer.",
        )  # fmt: skip
    wanted_m = max([min(domes_m, default=0.0), *(rim.band_m for rim in turned_rims)])
    if constant < wanted_m - 1e-9:
        winding.refuse(
            layer,
            f"a turn at {1e3 * constant:.4g} mm: the opening and half a band are "
            f"{1e3 * wanted_m:.4g} mm",
            "Give a larger turn or angle, or a narrower band.",
        )
    sites = []
    for side, least_radius_m, joint, place_m in (
        (-1, least_radii_m[0], first, begin),
        (1, least_radii_m[1], last, end),
    ):
        dome = least_radius_m < constant
        if not dome and place_m is None:
            winding.refuse(
                layer,
                f"the fibre turns by friction at the {'left' if side < 0 else 'right'} end, and "
                "nothing says from where on",
                "Give [coverage] begin and end, or begin and end of the layer.",
            )
        place = joint if dome else float(surface.place_of(np.array([place_m]))[0])
        sites.append(Site(side, place, dome))
    # On a cone the widest place lies beyond the covered length.
    if sites[0].dome and not sites[1].dome:
        sites[0] = replace(sites[0], joint=min(sites[0].joint, sites[1].joint))
    if sites[1].dome and not sites[0].dome:
        sites[1] = replace(sites[1], joint=max(sites[1].joint, sites[0].joint))
    if not sites[0].joint <= sites[1].joint:
        winding.refuse(
            layer,
            "begin is not left of end",
            "Give begin a smaller place along the mandrel than end.",
        )
    both = (sites[0], sites[1])
    left, right = (
        turn_friction_ratio(surface, site, constant, winding.friction, width) for site in both
    )
    name = f"layer {layer.number}: "
    try:
        base = circuit_of(surface, both, constant, (left, right), name)
    except JobError as error:
        winding.refuse(layer, error.message, error.remedy)
    return Wrap(winding, layer, surface, both, base, least, width, winding.friction, (left, right))


def turn_friction_ratio(
    surface: Surface, site: Site, constant_m: float, friction: float, width_m: float
) -> float:
    """Return the friction ratio with which a fibre turns: 0 on a dome.

    At an open end it is less than the friction allows, if the whole band then stays on the mandrel:
    the rest is a reserve for the steering that the machine adds.
    """
    if site.dome:
        return 0.0
    end, half_band_m = (surface.length_m if site.side > 0 else 0.0), 0.5 * width_m

    def fits(ratio: float) -> bool:
        return turns(surface, site, constant_m, ratio, end - site.side * half_band_m)

    low, high = OPEN_END_SHARE / MARGIN * friction, friction
    if fits(low):
        return low
    if not fits(high):
        return high
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if fits(middle) else (middle, high)
    return high


def _hoops(winding: Winding, layer: Layer, surface: Surface) -> Wrap:
    """Return a hoop layer: one band further on in every turn, where the mandrel is widest."""
    largest_m, first, last = widest(surface, ROUGH_LEVEL)
    width, friction = winding.product.width.si, winding.friction
    covered = winding.product.covered or (-math.inf, math.inf)
    ends = surface.at(np.array([first, last]))[0][:, 0]
    begin = max(layer.begin_m if layer.begin_m is not None else covered[0], float(ends[0]))
    end = min(layer.end_m if layer.end_m is not None else covered[1], float(ends[1]))
    angle = math.atan(_TURN * largest_m / width)
    # The turn needs a little room, on the cylinder as well.
    room_m = 1.5 * largest_m / friction * (1.0 / math.sin(angle) - 1.0)
    begin, end = begin + room_m, end - room_m
    if not end - begin > width:
        winding.refuse(
            layer, "no cylinder is left for a hoop layer",
            "Hoops lie where the mandrel is widest: give a cylinder, or begin and end on it.",
        )  # fmt: skip
    places = surface.place_of(np.array([begin, end]))
    sites = Site(-1, float(places[0]), False), Site(1, float(places[1]), False)
    constant = largest_m * math.sin(angle)
    radii = surface.at(np.linspace(float(places[0]), float(places[1]), _PLACES_BETWEEN))[1][:, 0]
    if float(radii.min()) <= constant:
        winding.refuse(
            layer,
            f"hoops do not lie on the layers below: between {1e3 * begin:.4g} and "
            f"{1e3 * end:.4g} mm these narrow from a radius of {1e3 * float(radii.max()):.4g} to "
            f"{1e3 * float(radii.min()):.4g} mm, and hoops turn back at {1e3 * constant:.4g} mm",
            "Give the hoops begin and end where the layers below have their full thickness.",
        )
    base = circuit_of(surface, sites, constant, (friction, friction), f"layer {layer.number}: ")
    # Straight in u and angle round: a row in every radian or so is enough.
    rows = base.middle
    base = replace(base, middle=np.vstack([rows[:-1:_HOOP_ROWS], rows[-1:]]))
    both = friction, friction
    return Wrap(winding, layer, surface, sites, base, 0.0, width, friction, both)


def _full_angle_ends(winding: Winding, layer: Layer) -> tuple[float | None, float | None]:
    """Return the places between which a layer has its full angle, m; None where none is given."""
    covered = winding.product.covered or (None, None)
    return (
        covered[0] if layer.begin_m is None else layer.begin_m,
        covered[1] if layer.end_m is None else layer.end_m,
    )


def _widest_between(
    surface: Surface, ends_m: tuple[float, float], whole_mandrel: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return ``widest`` between two places, if the rest of the mandrel is wider.

    Where the layers below turned on an open end, they stand higher than the product.
    """
    places = surface.place_of(np.array(ends_m))
    between = np.linspace(float(places[0]), float(places[1]), _PLACES_BETWEEN)
    radii = surface.at(between)[1][:, 0]
    largest_m = float(radii.max())
    if largest_m >= whole_mandrel[0] * (1.0 - ROUGH_LEVEL):
        return whole_mandrel
    widest_u = between[radii >= largest_m * (1.0 - ROUGH_LEVEL)]
    return largest_m, float(widest_u[0]), float(widest_u[-1])


@dataclass(frozen=True, slots=True)
class _Rim:
    """An end of the mandrel.

    Parameters
    ----------
    end_m
        Radius at the end.
    band_m
        Smallest radius at which a band has room: its centre is half a band from the end.
    steep
        Whether the end is a dome: no friction holds a parallel there.
    """

    end_m: float
    band_m: float
    steep: bool


def _rim(surface: Surface, side: int, width_m: float, friction: float) -> _Rim:
    """Return the right (``side`` 1) or the left end of a mandrel.

    On a dome half a band counts in radius, as where the meridian is square to the axis; on a cone
    it counts along the meridian.
    """
    end = surface.length_m if side > 0 else 0.0
    inside_u = min(max(end - side * 0.5 * width_m, 0.0), surface.length_m)
    x, r = surface.at(np.array([end, inside_u]))
    steep = bool(abs(r[0, 1]) > friction * abs(x[0, 1]))
    radius = float(r[0, 0])
    return _Rim(radius, radius + 0.5 * width_m if steep else float(r[1, 0]), steep)


def _least_radius(surface: Surface, begin: float, side: int) -> float:
    """Return the smallest radius from a place to an end."""
    end = surface.length_m if side > 0 else 0.0
    return float(surface.at(np.linspace(begin, end, 513))[1][:, 0].min())
