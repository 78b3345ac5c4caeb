"""Laws as tables of rows, and laws from the B-spline of their velocity."""

from __future__ import annotations

import csv
from functools import lru_cache
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.reading import read_text
from threadline.base.writing import staged_file
from threadline.errors import OptionError, Place
from threadline.motion.laws.extremes import refuse_descent
from threadline.motion.laws.law import Law, Pieces, check_stretches, measured_law


def law_of_velocity(name: str, knots: FloatArray, coefficients: FloatArray, degree: int) -> Law:
    """Return the law whose velocity is a B-spline on [0, 1], scaled to a rise of 1.

    Parameters
    ----------
    name
        Name of the law.
    knots
        (n + degree + 1,) knots, 0 and 1 ``degree + 1`` times each.
    coefficients
        (n,) not negative, so that the law is monotone; the first and the last are 0.
    degree
        Degree of the velocity's pieces.
    """
    from scipy.interpolate import BSpline, PPoly

    forms = []
    for x, weights in ((knots, coefficients), (1.0 - knots[::-1], coefficients[::-1])):
        rise = BSpline(x, weights, degree).antiderivative()
        pieces = PPoly.from_spline(rise.tck)
        filled_pieces = np.flatnonzero(np.diff(pieces.x) > 0.0)
        powers = pieces.c[::-1, filled_pieces].T / float(rise(1.0))
        powers[0, :2] = 0.0
        forms.append(Pieces(pieces.x[filled_pieces], powers))
    inner = np.unique(knots)[1:-1]
    middle = float(inner[int(np.argmin(np.abs(inner - 0.5)))]) if len(inner) else 0.5
    return measured_law(name, forms[0], forms[1], middle)


ROWS = 1001
_MOST_BYTES = 20_000_000
_REST = 1e-6  # share of the peak velocity; a smaller velocity at an end of a table is rounding


def write_law(law: Law, file: Path, rows: int = ROWS) -> None:
    """Write time, rise, velocity, acceleration and jerk of ``law``, unit rise in unit time.

    Besides ``rows`` evenly spaced rows there is a row at each end of a smooth stretch of the law,
    so that no corner of a derivative falls between two rows.

    Raises
    ------
    OptionError, OSError
        If the file cannot be written.
    """
    even_times = np.linspace(0.0, 1.0, rows)
    # Rows closer than a thousandth of the spacing are dropped, because such short pieces are
    # rounding.
    is_apart = np.abs(law.edges[:, None] - even_times).min(axis=1) > 1e-3 / rows
    t = np.union1d(even_times, law.edges[is_apart])
    columns = [t, *(law(t, derivative) for derivative in range(4))]
    lines = [",".join(repr(float(x)) for x in row) for row in zip(*columns, strict=True)]
    with staged_file(file) as out:
        out.write("\n".join(["t,s,v,a,j", *lines, ""]).encode())


def read_law(file: Path) -> Law:
    """Return the law of a table with the columns t and s and optionally v and a.

    With v and a, quintic pieces take the table's rise, velocity and acceleration at each row;
    without them, a cubic spline at rest at both ends goes through the rows. Times and rises of any
    scale are normalised: the first row is 0 and the last is 1.

    Raises
    ------
    OptionError
        If the table cannot be read, its times do not rise, or the law goes back; the error names
        the line.
    """
    return _law_of(read_text(file, _MOST_BYTES, OptionError, "table of a motion law"), file)


@lru_cache(maxsize=4)
def _law_of(text: str, file: Path) -> Law:
    """Return the law of a table's text; cached by the text, because a search needs it many times.

    The cached law keeps its derived data, such as its pieces.
    """
    where = Place(str(file))
    table, lines = _read(text, file)
    t, s = table["t"], table["s"]
    falling_rows = np.flatnonzero(np.diff(t) <= 0.0)
    if len(falling_rows):
        k = int(falling_rows[0]) + 1
        raise OptionError(
            f"motion law: time {t[k]:g} follows {t[k - 1]:g}, it must rise",
            place=Place(str(file), lines[k]),
        )
    span, rise = float(t[-1] - t[0]), float(s[-1] - s[0])
    if not rise > 0.0:
        raise OptionError(f"motion law: its rise is {rise:g}, it must be positive", place=where)
    u, s = (t - t[0]) / span, (s - s[0]) / rise
    check_stretches(file.name, u)
    v, a = table.get("v"), table.get("a")
    if v is not None and a is not None:
        v, a = v * span / rise, a * span**2 / rise
        if max(abs(float(v[0])), abs(float(v[-1]))) > _REST * float(np.abs(v).max()):
            raise OptionError("motion law: its velocity must be 0 in the first and the last row",
                              place=where)  # fmt: skip
        v[0] = v[-1] = 0.0
    law = law_through(file.stem, u, s, v, a)
    refuse_descent(law)
    return law


def law_through(
    name: str, u: FloatArray, s: FloatArray, v: FloatArray | None, a: FloatArray | None
) -> Law:
    """Return the law through (n,) rises ``s`` from 0 to 1 at ``u``, from 0 to 1.

    Parameters
    ----------
    v, a
        (n,) velocities and accelerations at the rows; if one is None, both come from the cubic
        spline through the rows with rest at both ends.
    """
    if v is None or a is None:
        from scipy.interpolate import CubicSpline

        spline = CubicSpline(u, s, bc_type="clamped")
        v, a = spline(u, 1), spline(u, 2)
    opening = _pieces(u, s, v, a)
    closing = _pieces(1.0 - u[::-1], 1.0 - s[::-1], v[::-1], -a[::-1])
    middle = float(u[int(np.argmin(np.abs(u - 0.5)))])
    return measured_law(name, opening, closing, middle if 0.0 < middle < 1.0 else 0.5)


def _pieces(u: FloatArray, s: FloatArray, v: FloatArray, a: FloatArray) -> Pieces:
    """Return the quintic pieces with these values and derivatives at their ends."""
    h = np.diff(u)
    rise_rest = np.diff(s) - h * v[:-1] - 0.5 * h**2 * a[:-1]
    velocity_rest = h * (np.diff(v) - h * a[:-1])
    acceleration_rest = h**2 * np.diff(a)
    powers = np.stack(
        [
            s[:-1],
            v[:-1],
            0.5 * a[:-1],
            (10.0 * rise_rest - 4.0 * velocity_rest + 0.5 * acceleration_rest) / h**3,
            (-15.0 * rise_rest + 7.0 * velocity_rest - acceleration_rest) / h**4,
            (6.0 * rise_rest - 3.0 * velocity_rest + 0.5 * acceleration_rest) / h**5,
        ],
        axis=1,
    )
    powers[0, :2] = 0.0
    return Pieces(u[:-1].copy(), powers)


def _read(text: str, file: Path) -> tuple[dict[str, FloatArray], list[int]]:
    header: list[str] = []
    rows: list[list[float]] = []
    lines: list[int] = []
    for number, row in enumerate(csv.reader(text.splitlines()), start=1):
        cells = [cell.strip() for cell in row]
        if not any(cells) or cells[0].startswith("#"):
            continue
        if not header:
            header = [cell.lower() for cell in cells]
            continue
        try:
            values = [float(cell) for cell in cells]
        except ValueError:
            values = []
        if len(values) != len(header) or not np.isfinite(values).all():
            raise OptionError(
                f"motion law: {','.join(cells)[:80]!r} is not a row of {len(header)} numbers",
                place=Place(str(file), number),
            )
        rows.append(values)
        lines.append(number)
    missing = [name for name in ("t", "s") if name not in header]
    if missing or len(rows) < 3:
        what = (
            f"no column {missing[0]!r}" if missing else f"{len(rows)} rows, at least 3 are needed"
        )
        raise OptionError(
            f"motion law: {what}", place=Place(str(file)),
            remedy='Its first line names the columns: "t,s" or "t,s,v,a".',
        )  # fmt: skip
    columns = np.array(rows).T
    return {name: columns[k].copy() for k, name in enumerate(header)}, lines
