"""Layers as a definition of FiberPath (``.wind``), as far as the format can hold them."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.writing import staged_file
from threadline.errors import JobError, Place
from threadline.jobs.winding.build_up import Laid
from threadline.jobs.winding.layers import USUAL_SPEED_M_S, Winding
from threadline.winding.fiberpath import ANGLES, FRICTION, circuits_of
from threadline.winding.surface import Surface

_LEAD_OUT = 90.0  # deg; a quarter of a turn, as in FiberPath's examples
_LEAST_LOCK = 360.0 + _LEAD_OUT  # deg: then the mandrel never goes back at a turn
_LEAD_IN_MM, _LEAD_IN = 10.0, 0.1  # and at most this share of the length
_STRAIGHT_M = 1e-6
_SAMPLES = 513


@dataclass(frozen=True, slots=True)
class _Mandrel:
    """The part of a mandrel that the format holds, m: its covered length, and the radii there."""

    begin: float
    end: float
    radius: float
    end_radius: float

    @property
    def cone(self) -> bool:
        return abs(self.end_radius - self.radius) > _STRAIGHT_M


def check_wind(winding: Winding) -> None:
    """Refuse a mandrel that the format cannot hold, before its layers are designed.

    Raises
    ------
    JobError
        If the format cannot hold the mandrel.
    """
    _mandrel(winding, winding.product.surface)


def write_wind(file: Path, laid: Sequence[Laid]) -> list[str]:
    """Write the layers of a winding as a ``.wind``; return the parts that the format cannot hold.

    Raises
    ------
    JobError
        If the format cannot hold the mandrel or a layer; the error names it.
    OptionError, OSError
        If the file cannot be written.
    """
    winding = laid[0].wrap.winding
    shape = _mandrel(winding, laid[0].wrap.surface)
    mandrel = {"diameter": 2e3 * shape.radius, "windLength": 1e3 * (shape.end - shape.begin)}
    if shape.cone:
        mandrel["endDiameter"] = 2e3 * shape.end_radius
    rows = [_layer(layer_laid, shape) for layer_laid in laid]
    angles = [row["windAngle"] for row in rows if "windAngle" in row]
    # A feed is the speed of the eye along the mandrel: no layer draws fibre faster than wanted.
    steepest = math.radians(min(angles)) if angles else laid[0].circuit.angle
    speed = winding.speed_m_s or USUAL_SPEED_M_S
    content = {
        "schemaVersion": "1.1",
        "mandrelParameters": mandrel,
        "towParameters": {"width": 1e3 * winding.product.width.si, "thickness": _thickness(laid)},
        "defaultFeedRate": 6e4 * speed * math.cos(steepest),
        "layers": rows,
    }
    with staged_file(file) as stream:
        stream.write((json.dumps(content, indent=2) + "\n").encode("ascii"))
    return _left_out(winding, laid, shape)


def _mandrel(winding: Winding, surface: Surface) -> _Mandrel:
    """Return the covered mandrel, if it is a cylinder or a cone that narrows to the right."""
    place = Place(str(winding.path))
    for number, part in enumerate(json.loads(winding.text)["part"], start=1):
        kind = part.get("kind")
        if kind in ("hemisphere", "ellipsoid", "isotensoid", "nose"):
            raise JobError(
                f"[[part]] {number} is a dome ({kind}), and a .wind has no domes",
                place=place,
                remedy="A .wind holds a cylinder or a cone: leave --wind out, compile writes "
                "programs for every mandrel.",
            )
    x, r = (values[:, 0] for values in surface.at(np.linspace(0.0, surface.length_m, _SAMPLES)))
    line = np.interp(x, x[[0, -1]], r[[0, -1]])
    worst = int(np.abs(r - line).argmax())
    if abs(r[worst] - line[worst]) > _STRAIGHT_M:
        raise JobError(
            f"the mandrel has several radii: {1e3 * r[0]:.6g} mm at its left end, "
            f"{1e3 * r[worst]:.6g} mm at {1e3 * x[worst]:.4g} mm, {1e3 * r[-1]:.6g} mm at its "
            "right end; a .wind has one cylinder or one cone",
            place=place,
            remedy="Leave --wind out: compile writes programs for every mandrel.",
        )
    covered = winding.product.covered
    if covered is None:
        raise JobError(
            "without [coverage] the windLength of a .wind is not known",
            place=place,
            remedy="Write [coverage] with begin and end.",
        )
    radii = np.interp(covered, x, r)
    if radii[1] > radii[0] + _STRAIGHT_M:
        raise JobError(
            f"the cone widens to the right, from {1e3 * radii[0]:.6g} to {1e3 * radii[1]:.6g} mm; "
            "FiberPath winds cones that narrow",
            place=place,
            remedy="Draw the mandrel the other way round.",
        )
    return _Mandrel(covered[0], covered[1], float(radii[0]), float(radii[1]))


def _thickness(laid: Sequence[Laid]) -> float:
    """Return the thickness of the only tow, mm."""
    winding, first = laid[0].wrap.winding, laid[0].layer.band.thickness
    for layer_laid in laid:
        band_m = layer_laid.layer.band.thickness
        if band_m is None:
            winding.refuse(
                layer_laid.layer,
                "the thickness of the band is not known, and a .wind has one",
                'Write [band] thickness = "0.25 mm".',
            )
        if first is not None and abs(band_m - first) > 1e-9:
            winding.refuse(
                layer_laid.layer,
                f"its band is {1e3 * band_m:.4g} mm thick, the first layer's "
                f"{1e3 * first:.4g} mm; a .wind has one tow",
                "Wind layers with another band as a second job.",
            )
    assert first is not None
    return 1e3 * first


def _layer(layer_laid: Laid, shape: _Mandrel) -> dict[str, Any]:
    """Return a layer of the format."""
    winding, layer = layer_laid.wrap.winding, layer_laid.layer
    ends = layer.begin_m, layer.end_m
    for name, end, covered in zip(("begin", "end"), ends, (shape.begin, shape.end), strict=True):
        if end is not None and abs(end - covered) > _STRAIGHT_M:
            winding.refuse(
                layer,
                f"its {name} is {1e3 * end:.6g} mm, and [coverage] has {1e3 * covered:.6g} mm; the "
                "layers of a .wind are all as long as its windLength",
                f"Leave {name} out.",
            )
    count = layer_laid.pattern.circuits
    if layer.kind == "hoop":
        if shape.cone:
            winding.refuse(layer, "FiberPath winds no hoops on a cone", "Leave the layer out.")
        if count != 1:
            winding.refuse(
                layer,
                f"a hoop layer with {count} circuits; in a .wind it goes there and back once",
                f"Write {count} hoop layers.",
            )
        return {"windType": "hoop", "terminal": False}
    angle = math.degrees(_angle(layer_laid, shape))
    low, high = ANGLES
    if not low <= angle <= high:
        winding.refuse(
            layer,
            f"it begins at {angle:.4g} deg; FiberPath winds {low:g} to {high:g} deg",
            "Give another angle, or a hoop layer.",
        )
    planned_count = circuits_of(1e3 * shape.radius, 1e3 * winding.product.width.si, angle)
    if planned_count == 1 or count != planned_count:
        winding.refuse(
            layer,
            f"{count} circuits; FiberPath winds {planned_count} at {angle:.4g} deg, as many as "
            "cover" + (" and at least 2" if planned_count == 1 else ""),
            f"Write circuits = {planned_count}." if planned_count > 1 else "Take a narrower band.",
        )
    slots, skip = _turn(count, layer_laid.pattern.shift)
    return {
        "windType": "helical",
        "windAngle": angle,
        "patternNumber": count,
        "skipIndex": skip,
        "lockDegrees": 180.0 * slots / count,
        "leadInMM": min(_LEAD_IN_MM, 1e3 * _LEAD_IN * (shape.end - shape.begin)),
        "leadOutDegrees": _LEAD_OUT,
        "skipInitialNearLock": False,
    }


def _angle(layer_laid: Laid, shape: _Mandrel) -> float:
    """Return the winding angle where the covered length begins, rad."""
    circuit = layer_laid.circuit
    if not shape.cone:
        return circuit.angle
    place = circuit.surface.place_of(np.array([shape.begin]))
    radius = float(circuit.surface.at(place)[1][0, 0])
    return math.asin(min(circuit.constant_m / radius, 1.0))


def _turn(count: int, shift: int) -> tuple[int, int]:
    """Return the lock, in 180 deg / count, and the ``skipIndex`` that shift every circuit."""
    slots = math.ceil(_LEAST_LOCK * count / 180.0)
    while math.gcd(skip := (shift - slots) % count, count) != 1 or skip == 0:
        slots += 1
    return slots, skip


def _left_out(winding: Winding, laid: Sequence[Laid], shape: _Mandrel) -> list[str]:
    """Return in words the parts of the product that the format cannot hold."""
    product, texts = winding.product, []
    zero_m = product.at.si + shape.begin
    if abs(zero_m) > _STRAIGHT_M:
        texts.append(f"the machine place of its 0, {1e3 * zero_m:.6g} mm")
    if product.friction.si != FRICTION:
        texts.append(f"the friction of {product.friction.si:g}")
    dwells = [
        math.degrees(t.dwell)
        for layer_laid in laid
        for t in (layer_laid.circuit.left, layer_laid.circuit.right)
    ]
    if any(dwells):
        texts.append("dwells (FiberPath turns by lockDegrees)")
    if product.rings:
        texts.append(", ".join(sorted({ring.name for ring in product.rings})))
    if not texts:
        return []
    return [f"{Place(str(winding.path))}: a .wind has no place for: {'; '.join(texts)}."]
