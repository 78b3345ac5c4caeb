"""The parts of a mandrel in a product file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.wording import nearest
from threadline.errors import Place, placed
from threadline.winding.meridians import shifted, stretches_of
from threadline.winding.product_reader import KeyReader
from threadline.winding.shapes import ellipse, isotensoid, nose, table
from threadline.winding.surface import Stretch, Surface, line, surface_of

_LEAST_M = 1e-6  # of every size of a part: less is no part
_PARTS: Mapping[str, tuple[str, ...]] = {
    "cylinder": ("radius", "length"),
    "cone": ("radius", "end_radius", "length"),
    "hemisphere": ("radius", "opening", "pole"),
    "ellipsoid": ("radius", "height", "opening", "pole"),
    "isotensoid": ("radius", "opening", "pole"),
    "nose": ("radius", "height", "opening", "pole"),
    "table": ("file", "layer"),
}


class MandrelReader(KeyReader):
    """Reads the mandrel of a product file."""

    def surface(self, parts: Sequence[Mapping[str, Any]], edge: float) -> Surface:
        """Return the surface of parts that follow each other; ``edge`` rounds its corners, m."""
        chain: list[Stretch] = []
        for index, part in enumerate(parts):
            self.index = index
            held = next((key for key in ("points", "section") if key in part), None)
            kind = part.get("kind", "table" if held else None)
            if not isinstance(kind, str) or kind not in _PARTS:
                self.refuse("kind", f"a part of the kind {kind!r}"[:80], nearest(str(kind), _PARTS))
            own = (held,) if kind == "table" and held else _PARTS[kind]
            self.known(part, ("kind", *own))
            x = 0.0 if not chain else float(chain[-1].x[-1, 0])
            made = self._part(kind, part, x)
            if chain:
                before, after = float(chain[-1].r[-1, 0]), float(made[0].r[0, 0])
                if abs(before - after) > 1e-6:
                    self.refuse(
                        "radius",
                        f"the mandrel is open at x = {1e3 * x:.6g} mm: a part ends with radius "
                        f"{1e3 * before:.6g} mm, and the next begins with {1e3 * after:.6g} mm",
                        "Let each part begin with the radius at which the one before it ends.",
                    )
            chain += made
        self.index = len(parts) - 1
        with placed(Place(self.file, self.line_of(""))):
            return surface_of(chain, edge)

    def _part(self, kind: str, part: Mapping[str, Any], x: float) -> list[Stretch]:
        if kind == "table" and "section" in part:
            stretches = stretches_of(part["section"])
            if stretches is None:
                self.refuse(
                    "section",
                    "the section of this product is damaged",
                    "Give the product file again with --product.",
                )
            return shifted(stretches, x)
        if kind == "table":
            points = self._table_points(part.get("points"))
            points[:, 0] += x - points[0, 0]
            return table(points)
        sizes = {}
        for key in _PARTS[kind]:
            if key == "pole":
                continue
            sizes[key] = self.number(part, key, "m", None).si
            if sizes[key] < _LEAST_M:
                self.refuse(
                    key,
                    f"{key} = {1e3 * sizes[key]:g} mm: the mandrel would reach its axis"
                    if "radius" in key or key == "opening"
                    else f"{key} = {1e3 * sizes[key]:g} mm, the least is {1e3 * _LEAST_M:g} mm",
                    f'Write {key} = "50 mm".',
                )
        radius = sizes["radius"]
        if kind == "cylinder":
            return [line(x, radius, x + sizes["length"], radius)]
        if kind == "cone":
            return [line(x, radius, x + sizes["length"], sizes["end_radius"])]
        pole = part.get("pole")
        if pole not in ("left", "right"):
            self.refuse("pole", f"pole = {pole!r}", 'Write pole = "left" or pole = "right".')
        left, opening = pole == "left", sizes["opening"]
        most = radius / math.sqrt(1.5) if kind == "isotensoid" else radius
        if opening >= 0.999 * most:
            self.refuse(
                "opening",
                f"the opening of {1e3 * opening:g} mm is too large for a radius of "
                f"{1e3 * radius:g} mm",
                f"It must be below {1e3 * most:.4g} mm.",
            )
        height = sizes.get("height", radius)
        # With the pole on the left the equator comes last: shift the part to begin at x.
        shift = 0.0
        for _ in range(2):
            if kind == "isotensoid":
                made = isotensoid(x - shift, radius, opening, left=left)
            elif kind == "nose":
                made = nose(x - shift, radius, height, opening, left=left)
            else:
                made = [ellipse(x - shift, radius, height, opening, left=left)]
            shift = float(made[0].x[0, 0]) - x
        return made

    def _table_points(self, points: Any) -> FloatArray:
        try:
            found = np.array(points, dtype=np.float64)
        except (TypeError, ValueError):
            found = np.empty(0)
        if found.ndim != 2 or found.shape[1:] != (2,) or len(found) < 2:
            self.refuse("file", "a table needs a file", 'Write file = "meridian.csv".')
        if not (np.isfinite(found).all() and (np.diff(found[:, 0]) > 0.0).all()):
            self.refuse(
                "file",
                "the points of a meridian must go from left to right",
                "Sort the rows of the table by x_mm.",
            )
        return found
