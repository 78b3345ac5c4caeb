"""Coverage of a mandrel: bands of fibre on a raster of the meridian and the angle round it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.errors import JobError
from threadline.winding.surface import Surface, meridian

_CELLS_PER_BAND = 20.0  # cells in the width of a band, at least
_MOST_CELLS = 40_000_000
_SAME_PASS_BANDS = 3.0  # widths of laid fibre that count as one pass of the band
_BARE = -2  # in place of an operation, where there is no fibre; -1 is a band of no operation


@dataclass(frozen=True, slots=True)
class Gap:
    """The largest gap: its width, the share that is not covered, and the place in words.

    ``operation`` laid the band beside it; -1 if there is none.
    """

    width_m: float
    share: float
    operation: int
    words: str


def in_percent(share: float) -> str:
    """Return a share in per cent, to two digits.

    >>> in_percent(0.0065), in_percent(0.951), in_percent(0.997)
    ('0.65 %', '95 %', '100 %')
    """
    return f"{float(f'{1e2 * share:.2g}'):g} %"


@njit(nogil=True)
def _band_edge(
    nodes: FloatArray, x: FloatArray, r: FloatArray, u: float, angle: float, winding: float,
    half: float, hint: int,
) -> tuple[float, float, int]:  # fmt: skip
    """Return the place, u and angle, beside the fibre at a signed distance in the surface."""
    hint, _, _, _, _, _, speed = meridian(nodes, x, r, u, hint)
    du = -half * math.sin(winding) / speed
    middle = min(max(u + 0.5 * du, 0.0), nodes[-1])
    hint, _, r1, _, _, _, _ = meridian(nodes, x, r, middle, hint)
    return u + du, angle + half * math.cos(winding) / r1, hint


@njit(nogil=True)
def _mark_cells(
    count: NDArray[np.uint16], stamp: NDArray[np.float32], operations: NDArray[np.int32],
    first: float, cell: FloatArray, corners: FloatArray, length: float, same: float, operation: int,
) -> None:  # fmt: skip
    """Mark the cells whose centres are in a quadrangle; ``corners`` is (4, 2), in order.

    A cell counts again only if the fibre was laid on by ``same`` since it was marked. Where
    ``count`` is empty, bands are not counted.
    """
    rows, columns = operations.shape
    counting = len(count) > 0
    low_u = min(corners[0, 0], corners[1, 0], corners[2, 0], corners[3, 0])
    high_u = max(corners[0, 0], corners[1, 0], corners[2, 0], corners[3, 0])
    begin = max(math.ceil((low_u - first) / cell[0] - 0.5), 0)
    end = min(math.floor((high_u - first) / cell[0] - 0.5), rows - 1)
    for row in range(begin, end + 1):
        u = first + (row + 0.5) * cell[0]
        low, high = math.inf, -math.inf
        for k in range(4):
            a, b = corners[k], corners[(k + 1) % 4]
            if (a[0] <= u) != (b[0] <= u):
                angle = a[1] + (u - a[0]) / (b[0] - a[0]) * (b[1] - a[1])
                low, high = min(low, angle), max(high, angle)
        first_column = math.ceil(low / cell[1] - 0.5)
        end_column = math.ceil(high / cell[1] - 0.5)
        at_column = first_column % columns
        for _ in range(first_column, min(end_column, first_column + columns)):
            if counting:
                if count[row, at_column] == 0 or length - stamp[row, at_column] > same:
                    count[row, at_column] += 1
                stamp[row, at_column] = length
            operations[row, at_column] = operation
            at_column = at_column + 1 if at_column + 1 < columns else 0


@njit(nogil=True)
def _bands(
    table: tuple[FloatArray, FloatArray, FloatArray],
    path: FloatArray,
    operation: IntArray,
    raster: tuple[NDArray[np.uint16], NDArray[np.float32], NDArray[np.int32]],
    grid: FloatArray,
    last: FloatArray,
) -> None:
    """Draw the bands along a path.

    Parameters
    ----------
    path
        (n, 3) u, angle and angle with the meridian; NaN where there is no band.
    grid
        (5,) first u, cell in u, cell in angle, half width, length of one pass.
    last
        (4,) the place before and the laid length, which are updated.
    """
    nodes, x, r = table
    count, stamp, operations = raster
    corners, cell = np.empty((4, 2)), grid[1:3]
    reach_m, end_u = 2.0 * grid[3], grid[0] + len(operations) * grid[1]
    hint = 0
    for i in range(len(path)):
        u, angle, winding = path[i, 0], path[i, 1], path[i, 2]
        if not (math.isfinite(last[0]) and math.isfinite(u)):
            last[0], last[1], last[2] = u, angle, winding
            continue
        hint, _, radius, _, _, _, _ = meridian(nodes, x, r, last[0], hint)
        du, d_angle = u - last[0], angle - last[1]
        length = math.hypot(du, radius * d_angle)
        # Chords of a quarter of the band: on a cylinder the quadrangles are exact.
        steps = max(math.ceil(length / (0.5 * grid[3])), 1)
        winding_change = math.atan2(math.sin(winding - last[2]), math.cos(winding - last[2]))
        # The length of the meridian per u is nearly 1: half the band is far less than reach.
        if max(u, last[0]) + reach_m < grid[0] or min(u, last[0]) - reach_m > end_u:
            for _ in range(steps):
                last[3] += length / steps
            last[0], last[1], last[2] = u, angle, winding
            continue
        for step in range(steps):
            for end in range(2):
                share = (step + end) / steps
                at_u, at_angle = last[0] + share * du, last[1] + share * d_angle
                at_winding = last[2] + share * winding_change
                for side in range(2):
                    half_signed = grid[3] if side == end else -grid[3]
                    b_u, b_angle, hint = _band_edge(
                        nodes, x, r, at_u, at_angle, at_winding, half_signed, hint
                    )
                    k = 2 * end + side
                    corners[k, 0], corners[k, 1] = b_u, b_angle
            last[3] += length / steps
            _mark_cells(
                count, stamp, operations, grid[0], cell, corners, last[3], grid[4], operation[i]
            )
        last[0], last[1], last[2] = u, angle, winding


class Raster:
    """Bands of fibre on a part of a mandrel, in bounded memory.

    Parameters
    ----------
    surface
        The mandrel.
    width_m
        Width of the band.
    begin_m, end_m
        Places along the axis between which coverage counts.
    counting
        Whether bands are counted, for ``overlap``: it takes more than twice the memory.

    Raises
    ------
    JobError
        If the raster would have too many cells.
    """

    def __init__(
        self,
        surface: Surface,
        width_m: float,
        begin_m: float,
        end_m: float,
        *,
        counting: bool = True,
    ) -> None:
        self._surface = surface
        begin, end = surface.place_of(np.array([begin_m, end_m]))
        radius = float(surface.at(np.linspace(begin, end, 2001))[1][:, 0].max())
        rows = max(math.ceil((end - begin) / width_m * _CELLS_PER_BAND), 1)
        columns = max(math.ceil(2.0 * math.pi * radius / width_m * _CELLS_PER_BAND), 1)
        if rows * columns > _MOST_CELLS:
            raise JobError(
                f"the coverage needs {rows * columns} cells of a twentieth of the band, limit "
                f"{_MOST_CELLS}",
                remedy="Cover a shorter part of the mandrel, or give the real width of the band.",
            )
        shape = rows, columns
        counted = shape if counting else (0, 0)
        self.count = np.zeros(counted, dtype=np.uint16)
        self._stamp = np.zeros(counted, dtype=np.float32)
        self._of = np.full(shape, _BARE, dtype=np.int32)
        self._cell = np.array([(end - begin) / rows, 2.0 * math.pi / columns])
        self._grid = np.array([begin, *self._cell, 0.5 * width_m, _SAME_PASS_BANDS * width_m])
        self._last = np.array([np.nan, np.nan, np.nan, 0.0])

    @property
    def nbytes(self) -> int:
        """Memory of the raster, bytes."""
        return self.count.nbytes + self._stamp.nbytes + self._of.nbytes

    @property
    def places(self) -> FloatArray:
        """(rows,) u of the middles of the cells, m."""
        return np.asarray(self._grid[0] + (np.arange(len(self._of)) + 0.5) * self._cell[0])

    def lay(
        self,
        u: FloatArray,
        angle: FloatArray,
        winding: FloatArray,
        known: NDArray[np.bool_],
        operation: IntArray,
    ) -> None:
        """Draw the band along (n,) places; none where the place is not known."""
        path = np.column_stack([u, angle, winding])
        path[~known] = np.nan
        surface = self._surface
        _bands(
            (surface.nodes, surface.x, surface.r),
            path,
            operation,
            (self.count, self._stamp, self._of),
            self._grid,
            self._last,
        )

    def covered(self) -> float:
        """Return the share of the surface that is covered."""
        radius = self._surface.at(self.places)[1][:, 0]
        return float(radius @ (self._of != _BARE).mean(axis=1) / radius.sum())

    def gap(self) -> Gap:
        """Return the largest gap.

        The width of a strip without fibre, of length g along the meridian and h round the mandrel,
        is g h / sqrt(g^2 + h^2).
        """
        bare = self._of == _BARE
        share = 1.0 - self.covered()
        if not bare.any():
            return Gap(0.0, 0.0, -1, "")
        x, r = (values[:, 0] for values in self._surface.at(self.places))
        along = _bare_runs(np.ascontiguousarray(bare.T), False).T * self._cell[0]
        around = _bare_runs(bare, True) * (self._cell[1] * r[:, None])
        with np.errstate(invalid="ignore"):
            width = np.where(bare, along * around / np.hypot(along, around), 0.0)
        row, column = np.unravel_index(int(width.argmax()), width.shape)
        nearest = self._beside(int(row), int(column), x, r)
        words = (
            f"at {1e3 * x[row]:.4g} mm along the mandrel, "
            f"{math.degrees(self._cell[1]) * column:.4g} deg round it; {in_percent(share)} is not "
            "covered"
        )
        return Gap(float(width[row, column]), share, nearest, words)

    def _beside(self, row: int, column: int, x: FloatArray, r: FloatArray) -> int:
        """Return the operation that laid the band nearest to a cell; -1 if there is none."""
        nearest, operation = math.inf, -1
        for other_row, row_operations in enumerate(
            self._of
        ):  # row by row: the raster may fill half the memory
            laid = np.flatnonzero(row_operations >= 0)
            if not len(laid):
                continue
            columns_apart = np.abs(laid - column)
            columns_apart = np.minimum(columns_apart, len(row_operations) - columns_apart)
            nearest_index = int(columns_apart.argmin())
            arc_m = r[row] * self._cell[1] * float(columns_apart[nearest_index])
            distance = math.hypot(x[other_row] - x[row], r[other_row] - r[row], arc_m)
            if distance < nearest:
                nearest, operation = distance, int(row_operations[laid[nearest_index]])
        return operation


@njit(nogil=True)
def _bare_runs(bare: NDArray[np.bool_], is_closed: bool) -> FloatArray:
    """Return for each cell the length of the run of bare cells in its row, in cells."""
    rows, columns = bare.shape
    lengths = np.zeros((rows, columns))
    for row in range(rows):
        # Begin behind a covered cell, so that no run is cut by the seam.
        shift = 0
        while is_closed and shift < columns and bare[row, shift]:
            shift += 1
        if is_closed and shift == columns:
            lengths[row] = columns
            continue
        run = 0
        for place in range(columns + 1):
            if place < columns and bare[row, (place + shift) % columns]:
                run += 1
                continue
            for bare_place in range(place - run, place):
                lengths[row, (bare_place + shift) % columns] = run
            run = 0
    return lengths
