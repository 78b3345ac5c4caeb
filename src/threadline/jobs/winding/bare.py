"""The bare mandrel whose layers end at a wanted outer shape: the inverse of growing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.writing import staged_file
from threadline.errors import JobError, Place
from threadline.jobs.winding.build_up import Laid, design
from threadline.jobs.winding.layers import Winding
from threadline.jobs.winding.thickness import grown
from threadline.winding.shapes import table
from threadline.winding.surface import Surface, surface_of

TOLERANCE_M = 1e-4
"""Distance between the wound and the wanted outer shape."""
_POINTS = 201
_ROUNDS = 8
_EDGE_M = 1e-3
_HOLLOW_M = 2e-5  # a table of points waves by less


@dataclass(frozen=True, slots=True, eq=False)
class Bare:
    """A bare mandrel.

    Parameters
    ----------
    points
        (n, 2) places along the axis and radii, m, from left to right.
    laid
        The layers on it.
    off_m
        Largest distance between the wound and the wanted outer shape, m.
    """

    points: FloatArray
    laid: tuple[Laid, ...]
    off_m: float


def bare_of(winding: Winding) -> Bare:
    """Return the bare mandrel that has the drawn shape after all layers of a winding.

    The mandrel is the drawn shape less a depth along its normals. The depths are corrected by the
    distance between the wound and the drawn shape until they agree. Each layer keeps the circuits
    and the turn that it has on the drawn shape.

    Raises
    ------
    JobError
        If there is no such mandrel: it would double back, have a hollow that the fibre bridges or
        reach the axis, or the outer shape would be off by more than ``TOLERANCE_M``; the error
        names the place. Also if the thickness of the band is not known.
    """
    product_surface = winding.product.surface
    with_patterns = _with_fixed_patterns(winding)
    u = np.linspace(0.0, product_surface.length_m, _POINTS)
    x, r = product_surface.at(u)
    slope = np.hypot(x[:, 1], r[:, 1])
    outer = np.column_stack([x[:, 0], r[:, 0]])
    normal = np.column_stack([-r[:, 1], x[:, 1]]) / slope[:, None]
    depth = np.zeros(_POINTS)
    best: tuple[float, int, Bare] | None = None
    for _ in range(_ROUNDS):
        points = outer - depth[:, None] * normal
        surface = _mandrel(winding, points, outer)
        try:
            laid = design(
                replace(with_patterns, product=replace(with_patterns.product, surface=surface))
            )
        except JobError as error:
            raise JobError(
                "no bare mandrel gives this outer shape: on the nearest one, " + error.message,
                place=error.place or Place(str(winding.path)),
                remedy="Hoops and ends of layers leave steps: draw them, or wind layers that end "
                "at the openings.",
            ) from error
        off = _outside_of(_outer_surface(laid), outer, normal)
        worst = int(np.abs(off).argmax())
        if best is None or abs(off[worst]) < best[0]:
            best = float(abs(off[worst])), worst, Bare(points, laid, float(abs(off[worst])))
        if best[0] <= 0.6 * TOLERANCE_M:
            break
        depth = depth + off
    assert best is not None
    off_m, worst, bare = best
    if off_m > TOLERANCE_M:
        raise JobError(
            f"no bare mandrel gives this outer shape: at {1e3 * outer[worst, 0]:.4g} mm (radius "
            f"{1e3 * outer[worst, 1]:.4g} mm) the layers end {1e3 * off_m:.3g} mm beside it, limit "
            f"{1e3 * TOLERANCE_M:g} mm",
            place=Place(str(winding.path)),
            remedy="Layers end in steps there: draw the step, or let the layers end elsewhere.",
        )
    hollow = bare.laid[0].hollow_m()
    if hollow is not None and _deepest_m(bare.points) > _HOLLOW_M:
        begin, end = (1e3 * place_m for place_m in hollow)
        raise JobError(
            "no bare mandrel gives this outer shape: the first layer would bridge a hollow at "
            f"{begin:.4g} to {end:.4g} mm",
            place=Place(str(winding.path), bare.laid[0].layer.line),
            remedy="Turn the layers at different radii, or take a thinner band.",
        )
    return bare


def _with_fixed_patterns(winding: Winding) -> Winding:
    """Return the winding with the patterns and turns that its layers have on the drawn shape."""
    layers = []
    for layer_laid in design(winding):
        layer = layer_laid.layer
        if layer.kind == "hoop":
            layers.append(layer)
            continue
        turn = layer_laid.circuit.constant_m if layer.angle is None else None
        layers.append(
            replace(
                layer,
                turn_m=turn,
                circuits=layer_laid.pattern.circuits,
                shift=layer_laid.pattern.shift,
            )
        )
    return replace(winding, layers=tuple(layers))


def _outer_surface(laid: Sequence[Laid]) -> Surface:
    last = laid[-1]
    spread = last.spread()
    if spread is None:
        raise JobError(
            "an outer shape needs the thickness of the band",
            place=Place(str(last.wrap.winding.path), last.layer.line),
            remedy='Write thickness = "0.3 mm" into [band].',
        )
    return grown(last.circuit.surface, spread)


def _mandrel(winding: Winding, points: FloatArray, outer: FloatArray) -> Surface:
    """Return the mandrel of points; refuse one that doubles back or reaches the axis."""
    step = np.diff(points[:, 0])
    is_wrong = np.append(step <= 0.0, False) | (points[:, 1] <= 0.0)
    if is_wrong.any():
        worst = int(np.argmax(is_wrong))
        raise JobError(
            f"no bare mandrel gives this outer shape: under {1e3 * outer[worst, 0]:.4g} mm (radius "
            f"{1e3 * outer[worst, 1]:.4g} mm) it would "
            + ("reach its axis" if points[worst, 1] <= 0.0 else "double back"),
            place=Place(str(winding.path)),
            remedy="Wind fewer or thinner layers there, or turn them at different radii.",
        )
    return surface_of(table(points), _EDGE_M, str(winding.path.name))


def _outside_of(surface: Surface, outer: FloatArray, normal: FloatArray) -> FloatArray:
    """Return (n,) how far a surface lies outside of points, m, along their normals.

    Newton's method for the place where the normal meets the surface.
    """
    foot_u = surface.place_of(outer[:, 0])
    outside_m = np.zeros(len(outer))
    for _ in range(30):
        x, r = surface.at(foot_u)
        tangent = np.column_stack([x[:, 1], r[:, 1]])
        difference = np.column_stack([x[:, 0], r[:, 0]]) - outer
        # outer + outside_m n = place + step tangent
        cross = tangent[:, 0] * normal[:, 1] - tangent[:, 1] * normal[:, 0]
        step = (normal[:, 0] * difference[:, 1] - normal[:, 1] * difference[:, 0]) / cross
        foot_u = np.clip(foot_u + step, 0.0, surface.length_m)
        outside_m = (tangent[:, 0] * difference[:, 1] - tangent[:, 1] * difference[:, 0]) / cross
        if np.abs(step).max() < 1e-12:
            break
    # Beyond the ends of the surface there is nothing to compare with.
    has_foot = (foot_u > 0.0) & (foot_u < surface.length_m)
    return np.asarray(
        np.interp(np.arange(len(outside_m)), np.flatnonzero(has_foot), outside_m[has_foot])
    )


def _deepest_m(points: FloatArray) -> float:
    """Return how far a meridian lies below a string that is drawn taut over it, m."""
    string: list[tuple[float, float]] = []
    for x, r in points.tolist():
        while len(string) > 1:
            (x0, r0), (x1, r1) = string[-2:]
            if (r1 - r0) * (x - x0) > (r - r0) * (x1 - x0):
                break
            string.pop()
        string.append((x, r))
    string_r = np.interp(points[:, 0], *np.array(string).T)
    return float((string_r - points[:, 1]).max())


def write_meridian(file: Path, points: FloatArray) -> None:
    """Write points as a table that ``file`` of a ``[[part]]`` reads.

    Raises
    ------
    OptionError, OSError
        If the file cannot be written.
    """
    rows = ["x_mm,radius_mm", *(f"{1e3 * x:.6f},{1e3 * r:.6f}" for x, r in points.tolist())]
    with staged_file(file) as stream:
        stream.write(("\n".join(rows) + "\n").encode("ascii"))
