"""The sheet of a winding: metres, grams, time and cost of every layer; and its laminate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from threadline.errors import Place
from threadline.jobs.winding.build_up import Laid
from threadline.jobs.winding.layers import USUAL_SPEED_M_S, Winding
from threadline.laminate.theory import (
    Laminate,
    Layered,
    Netting,
    Ply,
    laminate_of,
    netting,
)

USUAL_SHARE = 0.05
"""Usual limit of the stress of a fibre over its strength: a higher tension breaks filaments."""

LEAST_VOLUME, MOST_VOLUME = 0.2, 0.75
"""Fibre volumes of wound products."""


@dataclass(frozen=True, slots=True)
class SheetRow:
    """A layer, or all of them; numbers that the product file does not give are None.

    Parameters
    ----------
    name, angle, pattern, material
        Number and kind, angle at the largest radius (rad), circuits/shift, material.
    tension_n, share
        Tension of the fibre, and its stress as a share of its strength.
    fibre_m, fibre_kg, resin_kg
        Length of the band with dwells, mass of its fibres, mass of its resin.
    time_s, cost
        Winding time, and cost in the currency of the sheet.
    """

    name: str
    angle: float | None
    pattern: str
    material: str | None
    tension_n: float | None
    share: float | None
    fibre_m: float
    fibre_kg: float | None
    resin_kg: float | None
    time_s: float
    cost: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """The quantities that a shop needs to wind a product.

    Parameters
    ----------
    title
        Name of the product.
    rows
        One for each layer, then one for all.
    currency
        Three letters; empty without a price.
    timed
        How the times were found.
    costed
        The items that the cost includes.
    """

    title: str
    rows: tuple[SheetRow, ...]
    currency: str
    timed: str
    costed: str

    def header(self) -> list[str]:
        """Return the names of the columns."""
        return [
            "layer", "angle", "pattern", "material", "tension", "fibre", "fibre mass", "resin",
            "time", "cost",
        ]  # fmt: skip

    def table(self) -> list[list[str]]:
        """Return the rows as text."""
        return [self._row(row) for row in self.rows]

    def _row(self, row: SheetRow) -> list[str]:
        def shown(value: float | None, form: str) -> str:
            return "-" if value is None else form.format(value)

        tension = shown(row.tension_n, "{:.3g} N")
        if row.share is not None:
            tension += f" ({row.share:.1%})"
        return [
            row.name, shown(None if row.angle is None else math.degrees(row.angle), "{:.2f} deg"),
            row.pattern, row.material or "-", tension, f"{row.fibre_m:.1f} m",
            shown(None if row.fibre_kg is None else 1e3 * row.fibre_kg, "{:.1f} g"),
            shown(None if row.resin_kg is None else 1e3 * row.resin_kg, "{:.1f} g"),
            _clock(row.time_s), shown(row.cost, "{:.2f} " + self.currency),
        ]  # fmt: skip

    def note(self) -> str:
        """Return in words the items that the numbers include."""
        share_note = "" if all(row.share is None for row in self.rows) else (
            " The percentage is the stress of the fibres over their strength."
        )  # fmt: skip
        return (
            f"Fibre with dwells and without joins. {self.timed} {self.costed}{share_note}".strip()
        )

    def content(self) -> dict[str, Any]:
        """Return the sheet for JSON: one list of layers, and the total."""
        rows = [
            {
                "layer": row.name, "material": row.material, "tension_n": row.tension_n,
                "share_of_strength": row.share, "fibre_m": row.fibre_m, "fibre_kg": row.fibre_kg,
                "resin_kg": row.resin_kg, "time_s": row.time_s, "cost": row.cost,
            }
            for row in self.rows
        ]  # fmt: skip
        return {"layers": rows[:-1], "total": rows[-1], "currency": self.currency or None}


def _clock(seconds: float) -> str:
    if seconds < 60.0:
        return f"{seconds:.3g} s"
    minutes, seconds_left = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes}:{seconds_left:02d} min"
    return f"{minutes // 60}:{minutes % 60:02d}:{seconds_left:02d} h"


def sheet_of(
    winding: Winding, laid: Sequence[Laid], seconds: Mapping[int, float] | None = None
) -> Sheet:
    """Return the sheet of a winding.

    Parameters
    ----------
    seconds
        Time of every layer by its number, s, from a plan; None: length over the speed of
        the fibre.
    """
    speed = winding.speed_m_s or USUAL_SPEED_M_S
    rows, currencies, unpriced = [], [], False
    if winding.hour is not None:
        currencies.append(winding.hour.currency)
    for layer_laid in laid:
        band, layer = layer_laid.layer.band, layer_laid.layer
        length = layer_laid.length_m + layer_laid.dwells_m
        fibre = None if band.fibre_kg_m is None else band.fibre_kg_m * length
        resin = None if band.resin_kg_m is None else band.resin_kg_m * length
        time_s = length / speed if seconds is None else seconds[layer.number]
        price = None
        if band.composite is not None and fibre is not None and resin is not None:
            price = band.composite.cost(fibre, resin)
        if price is not None:
            currencies.append(price.currency)
        unpriced |= price is None
        cost = None if price is None else price.per_kg
        if winding.hour is not None:
            cost = (cost or 0.0) + winding.hour.per_hour * time_s / 3600.0
        stress = None if layer.tension_n is None else band.stress(layer.tension_n)
        share = (
            None
            if stress is None or band.composite is None
            else stress / band.composite.fibre["strength"]
        )
        rows.append(
            SheetRow(
                f"{layer.number} {layer.kind}", layer_laid.circuit.angle,
                f"{layer_laid.pattern.circuits}/{layer_laid.pattern.shift}",
                None if band.composite is None else band.composite.name,
                layer.tension_n, share, length, fibre, resin, time_s, cost,
            )
        )  # fmt: skip
    parts = [] if unpriced else ["material"]
    parts += [] if winding.hour is None else ["machine time"]
    return Sheet(
        title=winding.product.name,
        rows=(*rows, _total(rows)),
        currency=currencies[0] if currencies else "",
        timed=(
            f"Times at {1e3 * speed:g} mm/s of fibre; threadline prove --report gives the times "
            "of a machine."
            if seconds is None
            else "Times of the plan, joins included."
        ),
        costed=f"Cost of {' and '.join(parts)}." if parts else "",
    )


def _total(rows: Sequence[SheetRow]) -> SheetRow:
    def summed(values: Sequence[float | None]) -> float | None:
        return None if None in values else sum(value or 0.0 for value in values)

    return SheetRow(
        "all", None, "", "", None, None, sum(row.fibre_m for row in rows),
        summed([row.fibre_kg for row in rows]), summed([row.resin_kg for row in rows]),
        sum(row.time_s for row in rows), summed([row.cost for row in rows]),
    )  # fmt: skip


def sheet_warnings(winding: Winding, sheet: Sheet) -> list[str]:
    """Return warnings about unusual tensions and fibre volumes."""
    return [
        f"{Place(str(winding.path), layer.line)}: the band has a fibre volume of {share:.0%}; "
        f"usual are {LEAST_VOLUME:.0%} to {MOST_VOLUME:.0%}. Correct tex, width or thickness."
        for layer in winding.layers
        if (share := layer.band.fibre_volume) is not None
        and not LEAST_VOLUME <= share <= MOST_VOLUME
    ] + [
        f"{Place(str(winding.path), layer.line)}: a tension of {row.tension_n:.3g} N is "
        f"{row.share:.1%} of the strength of {row.material}: above {USUAL_SHARE:.0%} filaments "
        f"break. Lower it to {row.tension_n * USUAL_SHARE / row.share:.3g} N, or take more tex."
        for layer, row in zip(winding.layers, sheet.rows, strict=False)
        if row.share is not None and row.tension_n is not None and row.share > USUAL_SHARE
    ]


@dataclass(frozen=True, slots=True, eq=False)
class WoundLaminate:
    """The laminate of a winding at its largest radius.

    Parameters
    ----------
    laminate
        Its stiffness; axis 1 along the mandrel.
    net
        The load that its fibres alone carry.
    radius_m
        Largest radius of the mandrel.
    strength
        Smallest strength of the fibres, Pa.
    """

    laminate: Laminate
    net: Netting
    radius_m: float
    strength: float

    @property
    def burst_pa(self) -> float:
        """Pressure at which the fibres of a closed cylinder reach their strength, by netting."""
        return self.strength / self.net.stress(1.0, self.radius_m)

    def rows(self) -> list[list[str]]:
        """Return names and values as text."""
        along, round_, shear, poisson = self.laminate.moduli
        return [
            ["thickness", f"{1e3 * self.laminate.thickness:.3f} mm"],
            ["moduli along, round", f"{1e-9 * along:.2f} GPa, {1e-9 * round_:.2f} GPa"],
            ["shear modulus, contraction round", f"{1e-9 * shear:.2f} GPa, {poisson:.3f}"],
            [
                "carried round over along, by netting",
                f"{self.net.ratio:.3f}; a closed cylinder needs 2",
            ],
            ["fibres reach their strength, by netting", f"{1e-5 * self.burst_pa:.4g} bar"],
        ]

    def content(self) -> dict[str, Any]:
        """Return the laminate for JSON, SI."""
        along, round_, shear, poisson = self.laminate.moduli
        ratio = self.net.ratio
        return {
            "thickness_m": self.laminate.thickness, "A": self.laminate.a.tolist(),
            "B": self.laminate.b.tolist(), "D": self.laminate.d.tolist(),
            "modulus_along_pa": along, "modulus_round_pa": round_, "shear_modulus_pa": shear,
            "poisson": poisson, "round_over_along": ratio if math.isfinite(ratio) else None,
            "burst_pa": self.burst_pa,
        }  # fmt: skip


def wound_laminate(laid: Sequence[Laid]) -> WoundLaminate | None:
    """Return the laminate at the largest radius; None if a material or thickness is unknown."""
    plies: list[Layered] = []
    fibres: list[tuple[float, float]] = []
    strengths = []
    for layer_laid in laid:
        band, thickness_m, angle = (
            layer_laid.layer.band,
            layer_laid.thickness_m,
            layer_laid.circuit.angle,
        )
        if band.composite is None or band.fibre_volume is None or thickness_m is None:
            return None
        ply = band.composite.ply(band.fibre_volume)
        plies += plies_of(ply, angle, thickness_m)
        fibres.append((angle, thickness_m * band.fibre_volume))
        strengths.append(band.composite.strength)
    radius = laid[0].circuit.widest_m
    return WoundLaminate(laminate_of(plies), netting(fibres), radius, min(strengths))


def plies_of(ply: Ply, angle: float, thickness: float) -> list[Layered]:
    """Return the plies of a layer: its fibre goes there and back, so one for either angle."""
    return [Layered(ply, angle, 0.5 * thickness), Layered(ply, -angle, 0.5 * thickness)]
