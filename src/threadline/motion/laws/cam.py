"""A measured cam: its table of angle and distance, and the motion of its follower.

The position of a swinging follower is the angle phi between the sides b and c of a triangle. The
third side is the distance h to the centre of the roller, so cos(phi) = (b^2 + c^2 - h^2) / (2 b c).
The position of a sliding follower is h itself.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from decimal import Decimal
from math import sqrt
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray, Locked, read_only
from threadline.base.reading import read_text
from threadline.errors import OptionError, Place, UnitError
from threadline.units import parse_quantity

_MOST_BYTES = 20_000_000
_MOST_ROWS = 20_000
_FEWEST = 6
_MOST_DIGITS = 300  # largest number of decimals that count
_COLUMN = re.compile(r"(?P<name>[A-Za-z]+)\s*(?:\[(?P<unit>[^\]]+)\]|_(?P<short>\w+))?")
_KINDS = {"alpha": "rad", "h": "m", "phi": "rad"}
_USUAL = {"alpha": "deg", "h": "mm", "phi": "deg"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Triangle:
    """The two fixed sides of the triangle whose third side is the distance to the roller's centre.

    Parameters
    ----------
    b_m, c_m
        Lengths of the sides.
    roller_m
        Length added to every measured distance, which ends at an edge of the groove: the radius of
        the roller for the inner edge, its negative for the outer edge. The length is added along
        the radius of the cam, not along the normal of its edge.

    Raises
    ------
    OptionError
        If a side is not above 0 and finite.
    """

    b_m: float
    c_m: float
    roller_m: float = 0.0

    def __post_init__(self) -> None:
        for side, value in (("b", self.b_m), ("c", self.c_m)):
            if not 0.0 < value < np.inf:
                raise OptionError(f"cam: side {side} must be positive, got {value:g} m")

    def angle_rad(self, h_m: FloatArray) -> FloatArray:
        """Return (n,) phi, rad, for (n,) distances, m; NaN if the triangle cannot close."""
        side = h_m + self.roller_m
        # A distance whose square overflows does not close the triangle either.
        with np.errstate(invalid="ignore", over="ignore"):
            cosine = (self.b_m**2 + self.c_m**2 - side**2) / (2.0 * self.b_m * self.c_m)
            return np.asarray(np.where(side > 0.0, np.arccos(cosine), np.nan))

    def distance_m(self, phi_rad: FloatArray) -> FloatArray:
        """Return the (n,) distances to the edge, m, for (n,) angles, rad."""
        square = self.b_m**2 + self.c_m**2 - 2.0 * self.b_m * self.c_m * np.cos(phi_rad)
        return np.asarray(np.sqrt(square) - self.roller_m)

    def slope_rad_m(self, h_m: FloatArray) -> FloatArray:
        """Return (n,) d phi / d h, rad/m, at (n,) distances, m: (h + roller) / (b c sin phi)."""
        phi = self.angle_rad(h_m)
        return np.asarray((h_m + self.roller_m) / (self.b_m * self.c_m * np.sin(phi)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flag:
    """A row whose printed follower angle contradicts its distance."""

    row: int
    line: int
    printed_rad: float
    checked_rad: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredCam(Locked):
    """A measured cam.

    Parameters
    ----------
    file
        Name of the file that it was read from.
    alpha_rad, h_m
        (n,) angle of the cam, rising, and distance from its axis to the edge.
    lines
        Line of each row in the file.
    flags
        Rows whose printed follower angle is off by more than one unit of its last decimal.
    triangle
        Geometry of a swinging follower; None for a sliding one.
    follower
        (n,) position of the follower: phi in rad, or without a triangle the distance in m.
    follower_slope
        (n,) derivative of that position with respect to distance; 1 without a triangle.
    rounding_m
        Standard deviation of the rounding of the distances to their printed digits.
    """

    file: str
    alpha_rad: FloatArray
    h_m: FloatArray
    lines: tuple[int, ...]
    flags: tuple[Flag, ...]
    triangle: Triangle | None
    follower: FloatArray
    follower_slope: FloatArray
    rounding_m: float

    def __post_init__(self) -> None:
        for name in ("alpha_rad", "h_m", "follower", "follower_slope"):
            object.__setattr__(self, name, read_only(getattr(self, name), name, ndim=1))

    def follower_of(self, h_m: FloatArray) -> FloatArray:
        """Return the (n,) positions of the follower at (n,) distances in m."""
        return h_m if self.triangle is None else self.triangle.angle_rad(h_m)

    def distance_of(self, follower: FloatArray) -> FloatArray:
        """Return the (n,) distances in m at (n,) positions of the follower."""
        return follower if self.triangle is None else self.triangle.distance_m(follower)


def read_cam(file: Path, triangle: Triangle | None = None) -> MeasuredCam:
    """Read a CSV table with the columns alpha, h and optionally phi, the printed follower angle.

    The first line that is no comment (``#``) names the columns with their units: ``alpha [deg],
    h [mm], phi [deg]``. The default units are degrees and millimetres.

    Raises
    ------
    OptionError
        If a line is not a row of numbers, an angle repeats or falls, the triangle cannot close, or
        there are fewer than six rows; the error names the line.
    """
    text = read_text(file, _MOST_BYTES, OptionError, "table of a cam", "utf-8-sig")
    header: list[tuple[str, float]] = []
    rows: list[list[float]] = []
    lines: list[int] = []
    decimals: list[int] = []
    finest_exponent = 0
    for number, cells in enumerate(csv.reader(text.splitlines()), start=1):
        texts = [cell.strip() for cell in cells]
        if not any(texts) or texts[0].startswith("#"):
            continue
        place = Place(str(file), number)
        if not header:
            header = [_column(cell, place) for cell in texts]
            _refuse_columns(header, place)
            continue
        try:
            values = [float(cell) for cell in texts]
        except ValueError:
            values = []
        if len(values) != len(header) or not np.isfinite(values).all():
            raise OptionError(
                f"cam: {','.join(texts)[:80]!r} is not a row of {len(header)} numbers", place=place
            )
        rows.append([value * unit for value, (_, unit) in zip(values, header, strict=True)])
        lines.append(number)
        decimals.append(-_exponent(texts[-1]))
        h_column = next(k for k, (name, _) in enumerate(header) if name == "h")
        finest_exponent = min(finest_exponent, _exponent(texts[h_column]))
        if len(rows) > _MOST_ROWS:
            raise OptionError(f"cam: more than {_MOST_ROWS} rows", place=place)
    if len(rows) < _FEWEST:
        raise OptionError(
            f"cam: {len(rows)} rows, at least {_FEWEST} are needed", place=Place(str(file)),
            remedy='The first line names the columns: "alpha [deg], h [mm]".',
        )  # fmt: skip
    names = [name for name, _ in header]
    columns = dict(zip(names, np.array(rows).T, strict=True))
    alpha, h = columns["alpha"].copy(), columns["h"].copy()
    _refuse_falling(alpha, file, lines)
    follower, slope = h, np.ones_like(h)
    flags: list[Flag] = []
    if triangle is not None:
        follower = triangle.angle_rad(h)
        _refuse_open(follower, h, triangle, file, lines)
        slope = triangle.slope_rad_m(h)
        if "phi" in columns:
            unit = dict(header)["phi"]
            flags = [
                Flag(row=k, line=lines[k], printed_rad=float(printed), checked_rad=float(checked))
                for k, (printed, checked) in enumerate(zip(columns["phi"], follower, strict=True))
                # One unit of the last printed decimal: half for its rounding, half for h's.
                if abs(printed - checked) > 10.0 ** -decimals[k] * unit
            ]
    return MeasuredCam(
        file=file.name, alpha_rad=alpha, h_m=h, lines=tuple(lines), flags=tuple(flags),
        triangle=triangle, follower=follower, follower_slope=slope,
        rounding_m=10.0**finest_exponent * dict(header)["h"] / sqrt(12.0),
    )  # fmt: skip


def _exponent(cell: str) -> int:
    """Return the power of ten of the last written digit of a number, at least -300."""
    exponent = Decimal(cell.replace("_", "")).as_tuple().exponent
    return max(exponent, -_MOST_DIGITS) if isinstance(exponent, int) else 0


def _column(cell: str, place: Place) -> tuple[str, float]:
    """Return the name of a column and its unit in SI."""
    match = _COLUMN.fullmatch(cell)
    name = match["name"].lower() if match else ""
    if match is None or name not in _KINDS:
        raise OptionError(
            f"cam: {cell[:40]!r} is no column; there are alpha, h and phi", place=place,
            remedy='Name them with their units: "alpha [deg], h [mm], phi [deg]".',
        )  # fmt: skip
    unit = match["unit"] or match["short"] or _USUAL[name]
    try:
        return name, parse_quantity(f"1 {unit}", _KINDS[name])
    except UnitError as error:
        raise OptionError(f"cam: column {cell[:40]!r}: {error.message}", place=place) from error


def _refuse_columns(header: list[tuple[str, float]], place: Place) -> None:
    names = [name for name, _ in header]
    for name in ("alpha", "h"):
        if name not in names:
            raise OptionError(f"cam: there is no column {name!r}", place=place)
    if len(set(names)) != len(names):
        raise OptionError(f"cam: a column comes twice: {', '.join(names)}", place=place)
    if "phi" in names and names[-1] != "phi":
        raise OptionError("cam: phi must be the last column", place=place)


def _refuse_falling(alpha: FloatArray, file: Path, lines: list[int]) -> None:
    fallen_rows = np.flatnonzero(np.diff(alpha) <= 0.0)
    if len(fallen_rows):
        k = int(fallen_rows[0]) + 1
        what = "repeats" if alpha[k] == alpha[k - 1] else "falls: it follows"
        raise OptionError(
            f"cam: the angle {np.degrees(alpha[k]):g} deg {what} "
            f"{np.degrees(alpha[k - 1]):g} deg, angles must rise",
            place=Place(str(file), lines[k]),
            remedy="Sort the rows; of repeated measurements keep the mean.",
        )


def _refuse_open(
    follower: FloatArray, h: FloatArray, triangle: Triangle, file: Path, lines: list[int]
) -> None:
    open_rows = np.flatnonzero(~np.isfinite(follower))
    if len(open_rows):
        k = int(open_rows[0])
        low, high = abs(triangle.b_m - triangle.c_m), triangle.b_m + triangle.c_m
        raise OptionError(
            f"cam: a distance of {1e3 * (h[k] + triangle.roller_m):g} mm does not close the "
            f"triangle with b = {1e3 * triangle.b_m:g} mm and c = {1e3 * triangle.c_m:g} mm, it "
            f"must be between {1e3 * low:g} and {1e3 * high:g} mm",
            place=Place(str(file), lines[k]),
        )
