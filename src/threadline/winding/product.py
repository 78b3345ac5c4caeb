"""Product files (``NAME.wind.toml``): the mandrel, band and friction of a winding."""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.reading import read_text, within_folder
from threadline.base.wording import toml_fault
from threadline.errors import JobError, Place
from threadline.machine import Machine
from threadline.machine.spool import Mounted
from threadline.winding.meridians import (
    MAX_BYTES,
    read_points,
    read_section,
)
from threadline.winding.product_reader import TABLES, MandrelReader, Toleranced
from threadline.winding.surface import Surface

if TYPE_CHECKING:
    from threadline.winding.band import Band

_MOST_FRICTION = 1.0
_ENDLESS_M = 100.0
_TURN = 2.0 * math.pi
_EXAMPLE = '[[part]] kind = "cylinder", radius = "50 mm", length = "200 mm"'


@dataclass(frozen=True, slots=True)
class Ring:
    """A solid cylinder about the axis: a boss, a ring of pins, the shaft, chuck or tailstock."""

    name: str
    begin_m: float
    end_m: float
    radius_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Product:
    """A product of a winder.

    Parameters
    ----------
    name
        Name, for messages and reports.
    file
        Its file, for messages.
    text
        Content of the file with the tables of the mandrel, on one line; ``product_of_text`` reads
        it.
    surface
        The mandrel in its own coordinate: its left end is at 0.
    at
        Machine place of the left end of the mandrel, m.
    radius_error
        Amount by which the mandrel's radius is larger than drawn, m, with its tolerance.
    slip
        Share by which the mandrel lags the axis that turns it: a slip of 3.6 deg a turn is 0.01.
    rings
        Shaft, bosses and rings of pins, placed from the mandrel's left end.
    width, thickness
        Width and thickness of the band, m; the thickness is None if unknown.
    friction
        Coefficient of friction between fibre and mandrel.
    band
        Cross-section and material of the band.
    tied
        Place on the mandrel, m, where the fibre is tied at the start; None if unknown.
    take_up
        Slack that the tensioner takes up, m; None if unknown.
    clearance
        Least distance between eye and mandrel, m; None if it may be anything above 0.
    covered
        Places on the mandrel between which bands must cover it, m; None: no coverage is required.
    gap
        Largest allowed gap between bands, m.
    """

    name: str
    file: str
    text: str
    surface: Surface
    at: Toleranced
    radius_error: Toleranced
    slip: Toleranced
    rings: tuple[Ring, ...]
    width: Toleranced
    friction: Toleranced
    band: Band
    thickness: float | None = None
    tied: float | None = None
    take_up: float | None = None
    clearance: float | None = None
    covered: tuple[float, float] | None = None
    gap: float | None = None


def product_text(given: str | Path) -> str:
    """Return the content of a product file on one line, with the tables of its mandrel.

    From a file of FiberPath or CADFIL only mandrel and band are read (``other_planners.py``). A
    text that this function returned before is returned unchanged, so that a recording keeps its
    product.

    Raises
    ------
    JobError
        If the file cannot be read, or is no product.
    """
    text = str(given)
    if text.startswith("{"):
        return product_of_text(text).text
    from threadline.winding.other_planners import ENDINGS, foreign_product

    path = within_folder(Path(text))
    if path.suffix.lower() in ENDINGS:
        content = foreign_product(path)
        ProductReader(text, "").product(content)
        return _one_line(path, content)
    written = read_text(path, MAX_BYTES, JobError, "product file", "utf-8-sig")
    try:
        content = tomllib.loads(written)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        fault, line = toml_fault(error, written)
        raise JobError(
            fault,
            place=Place(text, line),
            remedy='A product file is TOML: write key = "value" with quotes, below its [table].',
        ) from error
    reader = ProductReader(text, written)
    parts = content.get("part")
    if isinstance(parts, list):
        for index, part in enumerate(parts):
            if isinstance(part, dict) and isinstance(part.get("file"), str):
                reader.table, reader.index = "part", index
                _embed(part, path.parent, reader)
    reader.product(content)
    return _one_line(path, content)


def _one_line(path: Path, content: Mapping[str, Any]) -> str:
    return json.dumps({"file": path.name, **content}, ensure_ascii=True, sort_keys=True)


def _embed(part: dict[str, Any], folder: Path, reader: ProductReader) -> None:
    """Replace the name of a part's file by the content of the file."""
    name = part.pop("file")
    layer = part.pop("layer", None)
    if name.lower().endswith(".dxf"):
        if layer is not None and not isinstance(layer, str):
            reader.refuse("layer", "layer must be a name", 'Write layer = "MERIDIAN".')
        part["section"] = read_section(folder / name, layer)
        return
    if layer is not None:
        reader.refuse(
            "layer",
            "layer belongs to a drawing in DXF",
            "Leave layer out: a table of points has none.",
        )
    from threadline.winding.other_planners import MERIDIANS, meridian_of

    reader_of_points = meridian_of if Path(name).suffix.lower() in MERIDIANS else read_points
    part["points"] = reader_of_points(folder / name)


@lru_cache(maxsize=8)
def product_of_text(text: str) -> Product:
    """Return the product in a text of ``product_text``.

    Raises
    ------
    JobError
        If it is no product.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise JobError(
            "the product of this recording is damaged", remedy="Give --product again."
        ) from error
    file = str(content.pop("file", "product")) if isinstance(content, dict) else "product"
    return ProductReader(file, "", text).product(content)


class ProductReader(MandrelReader):
    """Reads the content of a product file."""

    def product(self, content: Any) -> Product:
        """Return the product that the content of a file describes."""
        if not isinstance(content, dict):
            self.refuse("", "a product is a table", _EXAMPLE)
        self.known(content, (*TABLES[""], "layer"))
        name = content.get("name", Path(self.file).name.removesuffix(".wind.toml"))
        if not isinstance(name, str):
            self.refuse("name", "name must be a text", 'Write name = "vessel".')
        mandrel = self.table_of(content, "mandrel")
        at = self.number(mandrel, "at", "m", "0 mm")
        radius_error = self.number(mandrel, "radius_error", "m", "0 mm")
        slip = self.number(mandrel, "slip", "rad", "0 deg")
        if abs(slip.si) + slip.tolerance > 0.5 * math.pi:
            self.refuse("slip", "slip is above 90 deg a turn", 'Like "0 deg +- 0.05 deg".')
        shaft = self.number(mandrel, "shaft", "m", "0 mm").si
        edge = self.number(mandrel, "edge", "m", "1 mm").si
        if edge <= 0.0:
            self.refuse("edge", "edge must be above 0: no mandrel is sharper", 'Like "1 mm".')
        parts = content.get("part")
        self.table, self.index = "part", 0
        if not isinstance(parts, list) or not parts or not all(isinstance(p, dict) for p in parts):
            self.refuse("part", "the mandrel has no [[part]]", f"Write its parts like {_EXAMPLE}.")
        surface = self.surface(parts, edge)
        self.index = -1
        rings = self._rings(content, shaft, surface)
        band = self.table_of(content, "band")
        width = self.number(band, "width", "m", None)
        smallest = surface.least_radius_m
        if abs(radius_error.si) + radius_error.tolerance >= smallest:
            self.table = "mandrel"
            self.refuse(
                "radius_error",
                f"a radius_error of {1e3 * radius_error.si:g} +- "
                f"{1e3 * radius_error.tolerance:g} mm leaves no "
                f"mandrel where its radius is {1e3 * smallest:.4g} mm",
                'Like "0 mm +- 0.1 mm".',
            )
        if not width.si - width.tolerance > 0.0:
            self.refuse("width", "the width of the band must be above 0", 'Like "5 mm +- 0.3 mm".')
        if width.si > 2.0 * smallest:
            self.refuse(
                "width",
                f"the band is {1e3 * width.si:g} mm wide, the smallest opening of the mandrel is "
                f"{2e3 * smallest:.4g} mm",
                "Correct the width, or end the mandrel at a larger opening.",
            )
        # Imported only here: a proof of a part program reads no materials.
        from threadline.winding.band import read_band, read_materials

        materials = read_materials(self, content)
        full_band = read_band(self, band, materials, width.si)
        self.table_of(content, "cost")
        friction = self.number(self.table_of(content, "friction"), "value", "", None)
        if not 0.0 < friction.si <= _MOST_FRICTION or friction.tolerance >= friction.si:
            self.refuse(
                "value",
                f"a friction of {friction.si:g} +- {friction.tolerance:g}: it must be above 0 "
                f"and at most {_MOST_FRICTION:g}",
                'Dry glass on a mandrel has 0.2 to 0.4: value = "0.25 +- 0.05".',
            )
        fibre = self.table_of(content, "fibre")
        tied = self.number(fibre, "tied", "m", "0 mm").si if "tied" in fibre else None
        take_up = self.number(fibre, "take_up", "m", "0 mm").si if "take_up" in fibre else None
        clearance = (
            self.number(fibre, "clearance", "m", "0 mm").si if "clearance" in fibre else None
        )
        ends = surface.at(np.array([0.0, surface.length_m]))[0][:, 0]
        if tied is not None and not ends[0] <= tied <= ends[1]:
            self.refuse(
                "tied", f"tied = {1e3 * tied:g} mm is beside the mandrel", _extent_words(ends)
            )
        covered, gap = self._coverage(content, ends)
        return Product(
            name=name, file=self.file, text=self.text, surface=surface, at=at,
            radius_error=radius_error, slip=Toleranced(slip.si / _TURN, slip.tolerance / _TURN),
            rings=rings, width=width, friction=friction,
            thickness=full_band.thickness, band=full_band, tied=tied,
            take_up=take_up, clearance=clearance, covered=covered, gap=gap,
        )  # fmt: skip

    def _coverage(
        self, content: Mapping[str, Any], ends: FloatArray
    ) -> tuple[tuple[float, float] | None, float | None]:
        coverage = self.table_of(content, "coverage")
        if not coverage:
            return None, None
        begin = self.number(coverage, "begin", "m", None).si
        end = self.number(coverage, "end", "m", None).si
        gap = self.number(coverage, "gap", "m", "0 mm").si
        if not ends[0] <= begin < end <= ends[1]:
            self.refuse("begin", "the covered part is not on the mandrel", _extent_words(ends))
        return (begin, end), gap

    def _rings(
        self, content: Mapping[str, Any], shaft: float, surface: Surface
    ) -> tuple[Ring, ...]:
        ends, rings = surface.at(np.array([0.0, surface.length_m]))[0][:, 0], []
        if shaft:
            self.table = "mandrel"
            smallest = surface.least_radius_m
            if not 0.0 < shaft <= smallest:
                self.refuse(
                    "shaft", f"a shaft with radius {1e3 * shaft:g} mm is thicker than the mandrel",
                    f"The smallest radius of the mandrel is {1e3 * smallest:.4g} mm.",
                )  # fmt: skip
            rings += [
                Ring("the shaft", -_ENDLESS_M, float(ends[0]), shaft),
                Ring("the shaft", float(ends[1]), _ENDLESS_M, shaft),
            ]
        for name, size in (("boss", "length"), ("pin", "diameter")):
            rows = content.get(name, [])
            self.table, self.index = name, 0
            if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
                self.refuse(name, f"{name} must be a list of tables", f"Write [[{name}]].")
            for self.index, row in enumerate(rows):
                self.known(row, TABLES[name])
                at = self.number(row, "at", "m", None).si
                radius = self.number(row, "radius", "m", None).si
                length_m = self.number(row, size, "m", None).si
                for key, value in (("radius", radius), (size, length_m)):
                    if value <= 0.0:
                        self.refuse(key, f"{key} must be above 0", 'Like "20 mm".')
                begin = at if name == "boss" else at - 0.5 * length_m
                words = f"the {'boss' if name == 'boss' else 'pins'} at {1e3 * at:g} mm"
                rings.append(Ring(words, begin, begin + length_m, radius))
        self.index = -1
        return tuple(rings)


def _extent_words(ends: FloatArray) -> str:
    return f"It goes from {1e3 * ends[0]:.6g} mm to {1e3 * ends[1]:.6g} mm."


def digest(product: Product) -> str:
    """Return the SHA-256 of a product's content."""
    return hashlib.sha256(product.text.encode()).hexdigest()


def with_mandrel(machine: Machine, product: str | None) -> Machine:
    """Return ``machine`` with the mandrel of a product mounted, if it has a spool to unwind.

    Radius, place and slip come from the file, without their tolerances; the friction is the lowest
    within its tolerance. The layers that grow on the mandrel are left out, as in the replay.

    Parameters
    ----------
    product
        Text of the product, as ``product_text``; None for no product.

    Raises
    ------
    JobError
        If the text is no product.
    """
    if machine.spool is None or product is None:
        return machine
    wound = product_of_text(product)
    surface = wound.surface
    if wound.radius_error.si:
        surface = surface.grown(wound.radius_error.si)
    tied = wound.tied
    mandrel = Mounted(
        nodes=surface.nodes,
        x=surface.x,
        r=surface.r,
        convex=surface.convex,
        at_m=wound.at.si,
        slip=wound.slip.si,
        friction=wound.friction.si - wound.friction.tolerance,
        tied_m=None if tied is None else float(surface.place_of(np.array([tied]))[0]),
    )
    return replace(machine, mounted=mandrel)
