"""The free fibre over built-up layers, compiled: a taut string, which may span hollows."""

from __future__ import annotations

import math

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.winding.apart import free_fibre
from threadline.winding.surface import meridian

MOST_PLACES = 512
"""Most places along the free fibre at which it is compared with the layers."""
PILE = 2
"""Number of the pair of free fibre and mandrel, as in ``apart.walk``."""
_ROUNDS = 4  # most Newton steps to the foot of a normal
_FOOT_M = 1e-7  # error of the foot of a normal; the height error grows with its square
_NORMAL_STEPS = 2  # steps to the layers along the normal of the line, which is not the mandrel's
BLOCK = 16
"""Number of cells of the meridian that are compared at once, by their largest thickness."""


@njit(nogil=True)
def _height_over_mandrel(
    x: float, r: float, u: float, hint: int, table: tuple[FloatArray, FloatArray, FloatArray]
) -> tuple[float, float, float, float, int]:
    """Return the height of a point over the bare mandrel, and the mandrel below it.

    The place on the mandrel below the point is returned as u, cosine and sine of the meridian's
    angle, and piece. The arguments ``u`` and ``hint`` are a place and a piece nearby. The height is
    infinite beyond the ends.
    """
    last, height_m, cb, sb = table[0][-1], 0.0, 1.0, 0.0
    for _ in range(_ROUNDS):
        hint, px, pr, cb, sb, bend, speed = meridian(table[0], table[1], table[2], u, hint)
        height_m = (r - pr) * cb - (x - px) * sb
        along_m = (x - px) * cb + (r - pr) * sb
        u += along_m / (max(1.0 + height_m * bend, 0.1) * speed)
        if not 0.0 <= u <= last:
            return math.inf, min(max(u, 0.0), last), cb, sb, hint
        if abs(along_m) < _FOOT_M:
            break
    return height_m, u, cb, sb, hint


@njit(nogil=True)
def _thickness(u: float, cell: float, layers: FloatArray) -> float:
    """Return the thickness of the layers at ``u``, linear between the middles of the cells."""
    cell_position = min(max(u / cell - 0.5, 0.0), len(layers) - 1.0)
    low = min(int(cell_position), len(layers) - 2)
    return float(layers[low] + (cell_position - low) * (layers[low + 1] - layers[low]))


@njit(nogil=True)
def highest_in_blocks(layers: FloatArray) -> FloatArray:
    """Return the largest thickness in every ``BLOCK`` cells of the meridian, m."""
    highest = np.zeros((len(layers) + BLOCK - 1) // BLOCK)
    for cell in range(len(layers)):
        highest[cell // BLOCK] = max(highest[cell // BLOCK], layers[cell])
    return highest


@njit(nogil=True)
def _is_clear(height: float, rise: float, u: float, cell: float, blocks: FloatArray) -> bool:
    """Return whether a line over a convex mandrel meets no layers beyond a place.

    The place is ``height`` over the mandrel, above ``u``, and the line rises there by ``rise`` for
    its length. Along a line the height over a convex body is a convex function: farther on, it
    rises at least as fast. The foot of the normal moves by no more than the place on the line.
    """
    for k in range(len(blocks)):
        # The thickness of a cell reaches to the middles of its neighbours.
        distance_m = max((k * BLOCK - 0.5) * cell - u, u - ((k + 1) * BLOCK + 0.5) * cell, 0.0)
        if blocks[k] >= height + rise * distance_m:
            return False
    return True


@njit(nogil=True)
def hollow_over(
    at: FloatArray, to: FloatArray, u: float, table: tuple[FloatArray, FloatArray, FloatArray],
    layers: FloatArray, blocks: FloatArray, sizes: FloatArray, cells: int, hull: FloatArray,
) -> float:  # fmt: skip
    """Return the largest height of a taut fibre over the layers before it leaves them.

    From the laid point ``at`` on, the fibre is a taut string over the layers that rise above the
    straight line to the pay-out point ``to``, in the plane of this line and the normal. Its shape
    is the upper hull of these layers.

    Parameters
    ----------
    u
        Place of the laid point.
    layers
        (m,) thickness of the layers in the middles of the cells of the meridian.
    blocks
        ``highest_in_blocks(layers)``.
    sizes
        Size of a cell, m, and the height above which no layer stands ahead; infinite where the
        mandrel is not convex.
    cells
        Distance of two compared places along the fibre, in cells.
    hull
        (3, k) work space, which becomes: length along the line, height above it, and the corners of
        the hull.
    """
    length = math.sqrt((to[0] - at[0]) ** 2 + (to[1] - at[1]) ** 2 + (to[2] - at[2]) ** 2)
    count = int(min(max(math.ceil(length / (cells * sizes[0])), 8.0), hull.shape[1] - 1.0))
    hint = max(int(np.searchsorted(table[0], u)) - 1, 0)
    _, _, cb, sb, hint = _height_over_mandrel(at[0], math.hypot(at[1], at[2]), u, hint, table)
    radius, highest_m = math.hypot(at[1], at[2]), 0.0
    n0, n1, n2 = -sb, cb * at[1] / radius, cb * at[2] / radius
    line_m, before_m, line_u = 0.0, 0.0, u
    for k in range(count + 1):
        share, over_layers_m = k / count, 0.0
        before_m = line_m
        for step in range(_NORMAL_STEPS):
            x = at[0] + share * (to[0] - at[0]) + over_layers_m * n0
            across = at[1] + share * (to[1] - at[1]) + over_layers_m * n1
            up = at[2] + share * (to[2] - at[2]) + over_layers_m * n2
            radius = math.hypot(across, up)
            height, u, cb, sb, hint = _height_over_mandrel(x, radius, u, hint, table)
            if step == 0:
                line_m, line_u = height, u
            normal_cosine = cb * (across * n1 + up * n2) / radius - sb * n0
            over_layers_m += (_thickness(u, sizes[0], layers) - height) / max(normal_cosine, 0.1)
            if not over_layers_m > -length:
                break  # beyond the end of the mandrel
        hull[0, k], hull[1, k] = share * length, over_layers_m
        if k == count or height > sizes[1]:
            count = k
            break
        if k:
            highest_m = max(highest_m, over_layers_m)
        # Beyond the last layer that is met the hull leads straight to the eye.
        if k and over_layers_m < 0.0 and math.isfinite(sizes[1]):
            rise = (line_m - before_m) * count / length
            if _is_clear(line_m, rise, line_u, sizes[0], blocks):
                count = k
                break
    if highest_m <= 0.0:
        return 0.0
    hull[0, count], hull[1, count] = length, 0.0
    corners = 1
    hull[2, 0] = 0.0
    for k in range(1, count + 1):
        while corners > 1:
            a, b = int(hull[2, corners - 2]), int(hull[2, corners - 1])
            rise = (hull[1, b] - hull[1, a]) * (hull[0, k] - hull[0, a])
            if rise > (hull[1, k] - hull[1, a]) * (hull[0, b] - hull[0, a]):
                break
            corners -= 1
        hull[2, corners] = k
        corners += 1
    deepest_m = 0.0
    for corner in range(corners - 2):  # the last stretch leads to the eye
        a, b = int(hull[2, corner]), int(hull[2, corner + 1])
        slope = (hull[1, b] - hull[1, a]) / (hull[0, b] - hull[0, a])
        for k in range(a + 1, b):
            hollow_m = hull[1, a] + slope * (hull[0, k] - hull[0, a]) - hull[1, k]
            if hollow_m < length:  # there is no layer beyond the end of the mandrel
                deepest_m = max(deepest_m, hollow_m)
    return deepest_m


@njit(nogil=True)
def over_layers(
    eyes: FloatArray, laid: FloatArray, table: tuple[FloatArray, FloatArray, FloatArray],
    payout: FloatArray, layers: FloatArray, sizes: FloatArray,
    least: float, found: FloatArray, pair: IntArray,
) -> float:  # fmt: skip
    """Compare free fibres with the layers ahead; see ``apart.walk`` for the other arguments.

    If a fibre spans a hollow deeper than one band before it meets layers ahead, these layers hold
    it off its place. A shallower hollow is the edge of a band: the mean of the layers round the
    mandrel does not distinguish it from bands that lie beside each other.

    Parameters
    ----------
    layers
        As in ``hollow_over``.
    sizes
        The two sizes of ``hollow_over``; the laid length between two compared fibres; the laid
        length of the latest one, which is updated; the thickness of the band; and the distance of
        the places in the first search for a hollow, in cells.
    """
    fibre_begin, fibre_end = np.empty(3), np.empty(3)
    hull = np.empty((3, MOST_PLACES))
    blocks = highest_in_blocks(layers)
    hint = 0
    for i in range(len(eyes)):
        if not math.isfinite(laid[i, 0]) or abs(laid[i, 2] - sizes[3]) < sizes[2]:
            continue
        sizes[3] = laid[i, 2]
        hint = free_fibre(laid[i], eyes[i], table, payout, hint, fibre_begin, fibre_end)
        u = laid[i, 0]
        # Layers are means over a band: a few places in its width show half the height of a hollow.
        if (
            hollow_over(
                fibre_begin, fibre_end, u, table, layers, blocks, sizes, int(sizes[5]), hull
            )
            < 0.5 * sizes[4]
        ):
            continue
        room_m = sizes[4] - hollow_over(
            fibre_begin, fibre_end, u, table, layers, blocks, sizes, 1, hull
        )
        if room_m < min(least, 0.0):
            least = room_m
            found[i], pair[i] = -least, PILE
    return least


@njit(nogil=True)
def wind(
    u: FloatArray, length: FloatArray, cell: float, section: float, latest: FloatArray,
    fresh: FloatArray,
) -> None:  # fmt: skip
    """Add the fibre that lies along (n,) ``u`` to ``fresh``, the fibre volumes of the cells, m3.

    Parameters
    ----------
    length
        (n,) laid length at each place; NaN where nothing is laid.
    section
        Cross-section of the band, m2.
    latest
        Place and laid length before the first element; both are updated, the place may be NaN.
    """
    last_cell = len(fresh) - 1.0
    for i in range(len(u)):
        if not (math.isfinite(u[i]) and math.isfinite(length[i])):
            continue
        begin = latest[0] if math.isfinite(latest[0]) else u[i]
        parts = int(min(max(math.ceil(abs(u[i] - begin) / cell), 1.0), last_cell))
        volume = section * (length[i] - latest[1]) / parts
        for part in range(parts):
            # Shared between the two nearest cells: an edge of a cell makes no step.
            cell_position = (begin + (part + 1.0) / parts * (u[i] - begin)) / cell - 0.5
            cell_position = min(max(cell_position, 0.0), last_cell)
            low = min(int(cell_position), len(fresh) - 2)
            fresh[low] += volume * (low + 1.0 - cell_position)
            fresh[low + 1] += volume * (cell_position - low)
        latest[0], latest[1] = u[i], length[i]
