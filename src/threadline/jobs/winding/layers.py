"""The layers of a product file: what is wound on its mandrel, one ``[[layer]]`` after another."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NoReturn

from threadline.base.reading import read_text
from threadline.errors import JobError, Place
from threadline.jobs.winding.circuit import widest
from threadline.laminate.materials import Material
from threadline.winding.band import Band, own_band, read_materials
from threadline.winding.fiberpath import SUFFIX, layered
from threadline.winding.meridians import MAX_BYTES
from threadline.winding.other_planners import ENDINGS
from threadline.winding.product import Product, ProductReader, product_of_text, product_text

Closing = Literal["friction", "angle", "dwell"]
CLOSINGS: tuple[Closing, ...] = ("friction", "angle", "dwell")
KEYS = (
    "kind", "turn", "angle", "circuits", "shift", "close", "cover", "begin", "end", "material",
    "tex", "tension",
)  # fmt: skip
KINDS = ("helical", "hoop")
_HOUR = re.compile(r"\s*(\d+(?:\.\d+)?)\s*([A-Z]{3})\s*/\s*h\s*")
MOST_CIRCUITS = 100_000
MARGIN = 0.9
"""Share of the lowest friction, within its tolerance, that a planned path uses."""
OPEN_END_SHARE = 0.75
"""Share of ``MARGIN`` that a turn at an open end uses, if the mandrel is long enough for it."""
USUAL_SPEED_M_S = 0.1
"""Speed of the fibre where the file names none."""
_ENVELOPES_M = 1e-3, 1.0
"""Distances between eye and mandrel at which fibre can be laid."""
_MOST_LAYERS = 200
_LEAST_ANGLE = math.radians(1.0)


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer, as the file describes it.

    Parameters
    ----------
    number
        Number of the layer, from 1.
    line
        Line of the file.
    kind
        ``helical`` or ``hoop``.
    turn_m
        Radius where the band's centre turns back on a dome; None: chosen.
    angle
        Winding angle at the largest radius, rad; None: it follows from the turn.
    circuits, shift
        Pattern: each circuit advances by whole turns and ``shift / circuits`` of a turn; None:
        chosen.
    close
        Way to close the pattern; None: chosen.
    cover
        Least coverage at the largest radius, as a share; 0 where only circuits are given.
    begin_m, end_m
        Places along the mandrel between which an open end has the full angle; None: as in
        [coverage].
    """

    number: int
    line: int
    kind: str
    turn_m: float | None
    angle: float | None
    circuits: int | None
    shift: int | None
    close: Closing | None
    cover: float
    begin_m: float | None
    end_m: float | None
    band: Band
    tension_n: float | None


@dataclass(frozen=True, slots=True)
class HourlyRate:
    """Cost of an hour of the machine, and its currency (three letters)."""

    per_hour: float
    currency: str


@dataclass(frozen=True, slots=True)
class Winding:
    """A product file with its layers.

    Parameters
    ----------
    path
        The file.
    text
        Its content as ``product_text`` returns it.
    product
        Mandrel, band and friction.
    layers
        The layers, in the order in which they are wound.
    envelope_m
        Distance between mandrel and pay-out point; None: chosen.
    speed_m_s
        Wanted speed of the fibre; None: as fast as the axes can.
    tolerance_m
        Largest distance between the laid and the designed fibre.
    hour
        Cost of an hour of the machine; None: unknown.
    """

    path: Path
    text: str
    product: Product
    layers: tuple[Layer, ...]
    envelope_m: float | None
    speed_m_s: float | None
    tolerance_m: float
    hour: HourlyRate | None

    def refuse(self, layer: Layer, message: str, remedy: str) -> NoReturn:
        """Raise a ``JobError`` about a layer."""
        raise JobError(message, place=Place(str(self.path), layer.line), remedy=remedy)

    @property
    def friction(self) -> float:
        """Largest friction ratio of a planned path: 90 % of the lower end of the friction."""
        friction = self.product.friction
        return MARGIN * (friction.si - friction.tolerance)


def read_layers(path: str | Path) -> Winding:
    """Return the product of a file with its layers.

    Raises
    ------
    JobError
        If it cannot be read, or has no layer; the error names the line.
    """
    path = Path(path)
    text = product_text(path)
    if path.suffix.lower() == SUFFIX:
        text = json.dumps({"file": path.name, **layered(path, MARGIN)}, sort_keys=True)
    written = (
        ""
        if path.suffix.lower() in ENDINGS
        else read_text(path, MAX_BYTES, JobError, "product file", "utf-8-sig")
    )
    reader = _LayerReader(str(path), written)
    return reader.winding(path, text)


def layers_of_text(path: Path, text: str) -> Winding:
    """Return the winding of a text of ``product_text``, from a file that may be gone.

    Raises
    ------
    JobError
        If it has no layer.
    """
    return _LayerReader(str(path), "").winding(path, text)


def tensions_in(text: str) -> tuple[float, ...]:
    """Return the tensions that the layers of a text of ``product_text`` ask for, N.

    Raises
    ------
    JobError
        If it has layers that cannot be read.
    """
    content = json.loads(text)
    rows = content.get("layer")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        return ()
    tensions = _LayerReader("product", "").tensions(rows, content.get("fibre", {}))
    return tuple(tension for tension in tensions if tension is not None)


class _LayerReader(ProductReader):
    """Reads the layers with the messages of the product reader."""

    def winding(self, path: Path, text: str) -> Winding:
        content = json.loads(text)
        product = product_of_text(text)
        rows = content.get("layer")
        if rows is None:
            self.refuse(
                "layer", "the product has no [[layer]]: nothing is wound on it",
                'Write [[layer]] with turn = "32 mm" or angle = "55 deg"; or name a program and '
                "give this file as --product.",
            )  # fmt: skip
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            self.refuse(
                "layer",
                "layer must be a list of tables",
                'Write [[layer]] with turn = "32 mm" or angle = "55 deg".',
            )
        if not 0 < len(rows) <= _MOST_LAYERS:
            self.refuse(
                "layer",
                f"there are {len(rows)} layers; there must be 1 to {_MOST_LAYERS}",
                "Write one [[layer]] table for each layer, and wind more as a second job.",
            )
        fibre = content.get("fibre", {})
        tensions = self.tensions(rows, fibre)
        known = read_materials(self, content)
        layers = []
        self.table = "layer"
        for self.index, (row, tension) in enumerate(zip(rows, tensions, strict=True)):
            layers.append(self._layer(row, product, known, tension))
        self.index = -1
        self.table = "fibre"
        numbers: dict[str, float | None] = {}
        for key, unit in (("envelope", "m"), ("speed", "m/s"), ("tolerance", "m")):
            numbers[key] = self.number(fibre, key, unit, None).si if key in fibre else None
            if key in fibre and not (numbers[key] or 0.0) > 0.0:
                self.refuse(key, f"{key} must be above 0", 'Like "30 mm", "200 mm/s".')
        envelope = numbers["envelope"]
        if envelope is not None and not _ENVELOPES_M[0] <= envelope <= _ENVELOPES_M[1]:
            low, high = (1e3 * limit_m for limit_m in _ENVELOPES_M)
            self.refuse(
                "envelope",
                f"envelope is {1e3 * envelope:.4g} mm; it must be from {low:g} to {high:g} mm",
                "It is the distance between eye and mandrel: leave it out, and the fastest that "
                "keeps clear is taken.",
            )  # fmt: skip
        hour = self._hour(content, layers)
        return Winding(
            path, text, product, tuple(layers), numbers["envelope"], numbers["speed"],
            numbers["tolerance"] or 2e-5, hour,
        )  # fmt: skip

    def _hour(self, content: Mapping[str, Any], layers: Sequence[Layer]) -> HourlyRate | None:
        """Return the cost of an hour of the machine, in the currency of the materials."""
        cost = self.table_of(content, "cost")
        text, rate = cost.get("hour"), None
        if text is not None:
            match = _HOUR.fullmatch(text) if isinstance(text, str) else None
            if match is None:
                self.refuse(
                    "hour", f"hour = {str(text)[:40]!r} is no rate", 'Like hour = "60 EUR/h".'
                )  # fmt: skip
            rate = HourlyRate(float(match[1]), match[2])
        composites = (layer.band.composite for layer in layers)
        currencies = {
            price.currency for composite in composites if composite for price in composite.prices
        }
        if rate is not None:
            currencies.add(rate.currency)
        if len(currencies) > 1:
            if rate is None:  # then a material of the file has another currency
                self.table, self.index = "material", 0
            self.refuse(
                "price" if rate is None else "hour",
                f"prices in {' and '.join(sorted(currencies))} cannot be added",
                'Write all in one currency: [[material]] with like = "e-glass" and price, and '
                "[cost] hour.",
            )
        return rate

    def tensions(
        self, rows: Sequence[Mapping[str, Any]], fibre: Mapping[str, Any]
    ) -> list[float | None]:
        """Return the tension of every layer, N: its own, else the first tension less the taper.

        Every layer has less tension than the layer below, by the share ``taper``, so that the outer
        layers do not loosen the inner ones.
        """
        self.table = "fibre"
        first = self.number(fibre, "tension", "N", None).si if "tension" in fibre else None
        taper = self.number(fibre, "taper", "", None).si if "taper" in fibre else 0.0
        if first is not None and not first > 0.0:
            self.refuse("tension", "tension must be above 0", 'Like tension = "8 N".')
        if not 0.0 <= taper < 1.0:
            self.refuse(
                "taper",
                f"taper is {taper:g}; it must be a share from 0 to below 1 of the layer below",
                'Write it like taper = "3 %".',
            )  # fmt: skip
        if "taper" in fibre and first is None:
            self.refuse("taper", "a taper needs the tension of the first layer", 'tension = "8 N"')
        tensions: list[float | None] = []
        self.table = "layer"
        for self.index, row in enumerate(rows):
            own_n = self.number(row, "tension", "N", None).si if "tension" in row else None
            if own_n is not None and not own_n > 0.0:
                self.refuse("tension", "tension must be above 0", 'Like tension = "8 N".')
            tapered = None if first is None else first * (1.0 - taper) ** self.index
            tensions.append(tapered if own_n is None else own_n)
        self.index = -1
        return tensions

    def _layer(
        self, row: Mapping[str, Any], product: Product, known: Mapping[str, Material],
        tension: float | None,
    ) -> Layer:  # fmt: skip
        self.known(row, KEYS)
        kind = row.get("kind", "helical")
        if kind not in KINDS:
            self.refuse(
                "kind",
                f"a layer of the kind {str(kind)[:40]!r}",
                'Write kind = "helical" or kind = "hoop".',
            )
        turn = self.number(row, "turn", "m", None).si if "turn" in row else None
        angle = self.number(row, "angle", "rad", None).si if "angle" in row else None
        if turn is not None and angle is not None:
            self.refuse(
                "angle",
                "turn and angle say the same twice",
                "Keep turn on a mandrel with domes, else angle.",
            )
        largest_m = widest(product.surface)[0]
        if turn is not None and not 0.0 < turn < largest_m:
            self.refuse(
                "turn", f"a turn at {1e3 * turn:.4g} mm: the mandrel's largest radius is "
                f"{1e3 * largest_m:.4g} mm",
                "Write the radius at which the band's centre turns back.",
            )  # fmt: skip
        if angle is not None and not _LEAST_ANGLE <= angle < 0.5 * math.pi:
            self.refuse(
                "angle",
                f"an angle of {math.degrees(angle):.4g} deg",
                'Write one from 1 to 89 deg, like "55 deg"; nearer to 90 deg take a hoop layer.',
            )
        if kind == "hoop" and (turn is not None or angle is not None):
            self.refuse(
                "turn" if angle is None else "angle",
                "the angle of a hoop layer follows from the band", "Leave it out.",
            )  # fmt: skip
        counts = {}
        for key, least in (("circuits", 1), ("shift", 0)):
            value = row.get(key)
            counts[key] = value
            if value is None:
                continue
            if not isinstance(value, int) or isinstance(value, bool):
                self.refuse(
                    key,
                    f"{key} = {str(value)[:40]!r} is not a whole number",
                    f"Write it like {key} = 44.",
                )
            if not least <= value <= MOST_CIRCUITS:
                self.refuse(
                    key,
                    f"{key} is {str(value)[:40]}; it must be from {least} to {MOST_CIRCUITS}",
                    "Leave circuits and shift out: threadline wind lists the patterns that close.",
                )
        circuits, shift = counts["circuits"], counts["shift"]
        if shift is not None and circuits is None:
            self.refuse("shift", "a shift needs the circuits of its pattern", "circuits = 44")
        close = row.get("close")
        if close is not None and close not in CLOSINGS:
            self.refuse(
                "close",
                f"close = {str(close)[:40]!r} is unknown",
                'Write close = "friction", "angle" or "dwell", or leave it out.',
            )
        # Circuits that the file names may leave gaps, unless it asks for a coverage as well.
        free = circuits is not None and "cover" not in row
        cover = 0.0 if free else self.number(row, "cover", "", "1").si
        if not free and not 0.0 < cover <= 20.0:
            self.refuse(
                "cover",
                f"cover = {cover:g}: above 0 and up to 20",
                'Write it like cover = "100 %".',
            )
        ends = [self.number(row, k, "m", None).si if k in row else None for k in ("begin", "end")]
        return Layer(
            number=self.index + 1, line=self.line_of(""), kind=kind, turn_m=turn, angle=angle,
            circuits=circuits, shift=shift, close=close, cover=cover, begin_m=ends[0],
            end_m=ends[1], band=own_band(self, row, product.band, known), tension_n=tension,
        )  # fmt: skip
