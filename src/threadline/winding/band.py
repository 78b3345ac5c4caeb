"""The band of a product file: its material, and how much fibre its cross-section holds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from threadline.laminate.materials import (
    MOST_FIBRE_VOLUME,
    Composite,
    Material,
    composite_of,
    library,
    material_of,
)
from threadline.winding.product_reader import KeyReader

_KG_PER_TEX_M = 1e-6
_LEAVE_ONE_OUT = "Leave one of tex, thickness and fibre_volume out: it follows from the others."


@dataclass(frozen=True, slots=True)
class Band:
    """Cross-section of a band; numbers that the file does not give are None.

    Parameters
    ----------
    width
        Width, m.
    thickness
        Thickness, m.
    tex
        Grams of fibre per kilometre.
    composite
        Material.
    fibre_volume
        Share of the fibres in the volume.
    """

    width: float
    thickness: float | None
    tex: float | None
    composite: Composite | None
    fibre_volume: float | None

    @property
    def fibre_kg_m(self) -> float | None:
        """Mass of the fibres in a metre of band, kg/m."""
        return None if self.tex is None else _KG_PER_TEX_M * self.tex

    @property
    def resin_kg_m(self) -> float | None:
        """Mass of the resin in a metre of wound band, kg/m."""
        if self.composite is None or self.thickness is None or self.fibre_volume is None:
            return None
        resin_m2 = self.width * self.thickness * (1.0 - self.fibre_volume)
        return resin_m2 * self.composite.resin_density

    def stress(self, tension: float) -> float | None:
        """Return the stress of the fibres, Pa, under a tension, N."""
        if self.tex is None or self.composite is None:
            return None
        return tension * self.composite.fibre["density"] / (_KG_PER_TEX_M * self.tex)


def read_materials(reader: KeyReader, content: Mapping[str, Any]) -> Mapping[str, Material]:
    """Return the materials of the library and of a product file by name.

    Raises
    ------
    JobError
        If a ``[[material]]`` is not valid; the error names the line.
    """
    known = dict(library())
    rows = content.get("material", [])
    reader.table, reader.index = "material", 0
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        reader.refuse("material", "material must be a list of tables", "Write [[material]].")
    for reader.index, row in enumerate(rows):
        material = material_of(row, known, reader.refuse)
        if material.name in known:
            reader.refuse(
                "name", f"there is a material {material.name!r} already", "Rename this one."
            )
        known[material.name] = material
    reader.index = -1
    return known


def read_band(
    reader: KeyReader, table: Mapping[str, Any], known: Mapping[str, Material], width: float
) -> Band:
    """Return the band of a ``[band]`` table.

    Raises
    ------
    JobError
        If its keys contradict each other; the error names the line.
    """
    reader.table = "band"
    thickness = reader.number(table, "thickness", "m", "0 mm").si or None
    tex = reader.number(table, "tex", "", "0").si or None
    composite, share = None, None
    if "material" in table:
        composite = composite_of(table["material"], known, partial(reader.refuse), "material")
    if "fibre_volume" in table:
        share = reader.number(table, "fibre_volume", "", None).si
        if composite is None:
            reader.refuse(
                "fibre_volume", "a fibre_volume needs the material of the band",
                'Write material = "e-glass/epoxy" in [band].',
            )  # fmt: skip
        if composite.fibre_volume is not None:
            reader.refuse(
                "fibre_volume", f"the prepreg {composite.name} has a fibre volume of "
                f"{composite.fibre_volume:.0%} already", "Leave fibre_volume out.",
            )  # fmt: skip
        _checked_share(reader, share, "fibre_volume")
    return completed(reader, Band(width, thickness, tex, composite, share))


def own_band(
    reader: KeyReader, row: Mapping[str, Any], band: Band, known: Mapping[str, Material]
) -> Band:
    """Return the band of a layer that has a material or a tex of its own.

    Raises
    ------
    JobError
        If its keys contradict the band's; the error names the line.
    """
    composite, tex = band.composite, band.tex
    if "material" in row:
        composite = composite_of(row["material"], known, partial(reader.refuse), "material")
    if "tex" in row:
        tex = reader.number(row, "tex", "", None).si or None
    # The thickness of the mandrel's layers stays; the fibre volume follows.
    thickness = band.thickness
    own = Band(band.width, thickness, tex, composite, None)
    if composite is not None and composite.prepreg is not None and thickness is not None:
        own = Band(band.width, thickness, None, composite, None)
    return completed(reader, own)


def completed(reader: KeyReader, band: Band) -> Band:
    """Return a band with the numbers that follow from its other numbers.

    The fibres fill ``tex / density`` of the width times thickness; that share is the fibre volume.

    Raises
    ------
    JobError
        If the keys contradict each other; the error names the line.
    """
    composite = band.composite
    if composite is None:
        return band
    share = band.fibre_volume if composite.fibre_volume is None else composite.fibre_volume
    thickness, tex = band.thickness, band.tex
    density = composite.fibre["density"]
    if tex is not None:
        fibre_m2 = _KG_PER_TEX_M * tex / density
        if share is not None and thickness is not None:
            reader.refuse(
                "fibre_volume" if composite.prepreg is None else "tex",
                f"tex, thickness and a fibre volume of {share:.0%} say the same twice",
                _LEAVE_ONE_OUT,
            )  # fmt: skip
        if share is not None:
            thickness = fibre_m2 / (share * band.width)
        elif thickness is not None:
            share = fibre_m2 / (band.width * thickness)
            _checked_share(reader, share, "tex")
    elif share is not None and thickness is not None:
        tex = share * band.width * thickness * density / _KG_PER_TEX_M
    return Band(band.width, thickness, tex, composite, share)


def _checked_share(reader: KeyReader, share: float, key: str) -> None:
    if math.isfinite(share) and 0.0 < share <= MOST_FIBRE_VOLUME:
        return
    reason = "" if key == "fibre_volume" else "tex, width and thickness of the band leave "
    reader.refuse(
        key, f"{reason}a fibre volume of {share:.3g}: round fibres fill at most "
        f"{MOST_FIBRE_VOLUME:.0%}",
        'Usual are 50 to 65 %: fibre_volume = "60 %".' if not reason
        else "Correct tex, or give a wider or thicker band.",
    )  # fmt: skip
