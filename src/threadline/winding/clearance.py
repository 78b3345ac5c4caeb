"""Distances of eye, arm and free fibre from the growing mandrel and what turns with it.

Everything that turns is a body of revolution, so that the distance of a point in space is its
distance in the plane through the axis: exact there. Along the arm and along the fibre the least
distance is found between bounds, as a distance changes by no more than the point moves.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.machine.tool import Tool
from threadline.winding.eye import ahead, centre, turned
from threadline.winding.product import Ring
from threadline.winding.replay import Fibre
from threadline.winding.surface import Surface, meridian

_SAGITTA_M = 1e-6  # of a chord of the outline
_MOST_CHORDS = 20_000
_EXACT_M = 1e-6  # of the least distance along a line
_MOST_PLACES = 512  # along the free fibre over built-up layers
_SAMPLES = 512  # of a run with one thickness of the layers
_QUARTER = 0.25  # of the band, between two fibres that are compared with the layers
_ROUNDS = 4  # Newton steps to the foot of a normal
_TWICE = 2  # the layers above a line are searched along its normal, not the mandrel's
_PILE = 2  # number of the pair of free fibre and mandrel
_LEAF = 16  # chords that are tried together
_CELLS = 512  # of the meridian for the thickness of layers


def outline_of(surface: Surface) -> FloatArray:
    """Return increasing u, (n,), whose chords are within 1 um of the meridian."""
    u = np.unique(np.concatenate([np.linspace(0.0, surface.length_m, 65), surface.nodes]))
    while len(u) < _MOST_CHORDS:
        middle = 0.5 * (u[:-1] + u[1:])
        ends, mids = (
            np.column_stack([values[:, 0] for values in surface.at(at)]) for at in (u, middle)
        )
        chord = np.diff(ends, axis=0)
        off = mids - ends[:-1]
        away = np.abs(chord[:, 0] * off[:, 1] - chord[:, 1] * off[:, 0])
        coarse = away > _SAGITTA_M * np.hypot(*chord.T)
        if not coarse.any():
            break
        u = np.sort(np.concatenate([u, middle[coarse]]))
    return u


@njit(nogil=True)
def _to_outline(x: float, r: float, line: FloatArray, boxes: FloatArray, most: float) -> float:
    """Return the signed distance of a point in the plane to a closed outline, or above ``most``.

    ``line`` is (n, 2) places and radii, from the axis back to the axis; ``boxes`` holds least and
    largest place and radius of every ``_LEAF`` chords. Inside, the distance is negative.
    """
    best, inside, found = most * most, False, False
    for box in range(len(boxes)):
        dx = max(boxes[box, 0] - x, x - boxes[box, 1], 0.0)
        dr = max(boxes[box, 2] - r, r - boxes[box, 3], 0.0)
        across = boxes[box, 0] <= x <= boxes[box, 1]
        if dx * dx + dr * dr >= best and not across:
            continue
        for k in range(box * _LEAF, min((box + 1) * _LEAF, len(line) - 1)):
            ax, ar = line[k, 0], line[k, 1]
            bx, br = line[k + 1, 0] - ax, line[k + 1, 1] - ar
            px, pr = x - ax, r - ar
            if (ax <= x) != (line[k + 1, 0] <= x) and pr < px / bx * br:
                inside = not inside
            square = bx * bx + br * br
            share = min(max((px * bx + pr * br) / square, 0.0), 1.0) if square > 0.0 else 0.0
            gx, gr = px - share * bx, pr - share * br
            away = gx * gx + gr * gr
            if away < best:
                best, found = away, True
    if not found:
        return -math.inf if inside else math.inf
    return -math.sqrt(best) if inside else math.sqrt(best)


@njit(nogil=True)
def _to_ring(x: float, r: float, ring: FloatArray) -> float:
    """Return the signed distance of a point in the plane to a solid cylinder."""
    dx, dr = max(float(ring[0]) - x, x - float(ring[1])), r - float(ring[2])
    if dx <= 0.0 and dr <= 0.0:
        return max(dx, dr)
    return math.hypot(max(dx, 0.0), max(dr, 0.0))


@njit(nogil=True)
def _distance(
    a: FloatArray, b: FloatArray, share: float, which: int,
    line: FloatArray, boxes: FloatArray, rings: FloatArray, most: float,
) -> float:  # fmt: skip
    x = a[0] + share * (b[0] - a[0])
    across, up = a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])
    r = math.sqrt(across * across + up * up)
    if which == 0:
        return float(_to_outline(x, r, line, boxes, most))
    return float(_to_ring(x, r, rings[which - 1]))


@njit(nogil=True)
def _along(
    a: FloatArray, b: FloatArray, which: int,
    line: FloatArray, boxes: FloatArray, rings: FloatArray, most: float,
) -> float:  # fmt: skip
    """Return the least signed distance along a line in space, within 1 um; ``most`` if it is more.

    ``which`` is 0 for the mandrel, else the number of the ring plus 1.
    """
    length = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    best = most
    for k in range(2):
        found = _distance(a, b, float(k), which, line, boxes, rings, most)
        if found == -math.inf:  # deeper inside than what was asked for
            found = _distance(a, b, float(k), which, line, boxes, rings, math.inf)
        best = min(best, found)
    if length == 0.0:
        return best
    # Halves whose middles are to be tried; a half is left out as soon as it cannot be less.
    low, high = np.empty(64), np.empty(64)
    low[0], high[0], count = 0.0, 1.0, 1
    while count:
        count -= 1
        begin, end = low[count], high[count]
        reach = 0.5 * (end - begin) * length
        middle = 0.5 * (begin + end)
        found = _distance(a, b, middle, which, line, boxes, rings, best + reach)
        if found == -math.inf:
            found = _distance(a, b, middle, which, line, boxes, rings, math.inf)
        best = min(best, found)
        if reach > _EXACT_M and found - reach < best - _EXACT_M and count < 62:
            low[count], high[count] = begin, middle
            low[count + 1], high[count + 1] = middle, end
            count += 2
    return best


@njit(nogil=True)
def _free(
    laid: FloatArray, q: FloatArray, table: tuple[FloatArray, FloatArray, FloatArray],
    payout: FloatArray, hint: int, at: FloatArray, to: FloatArray,
) -> int:  # fmt: skip
    """Write the ends of the free fibre, (3,) each, on the machine; return the meridian's piece.

    ``laid`` begins with u and angle of the laid point; ``q`` is (6,) of the eye.
    """
    hint, x, r, _, _, _, _ = meridian(table[0], table[1], table[2], laid[0], hint)
    psi = laid[1] + q[0]
    cos, sin = math.cos(psi), math.sin(psi)
    dx, dr, dc, _, _, _, _ = ahead(x, r, psi, q, np.zeros(6), payout)
    at[0], at[1], at[2] = x, r * cos, r * sin
    to[0], to[1], to[2] = x + dx, (r + dr) * cos - dc * sin, (r + dr) * sin + dc * cos
    return int(hint)


@njit(nogil=True)
def _room(
    ends: FloatArray, leaves: FloatArray, known: bool, sizes: FloatArray,
    line: FloatArray, boxes: FloatArray, rings: FloatArray,
) -> tuple[float, int]:  # fmt: skip
    """Return the least room of a sample, at most 1 m, and its pair; see ``_walk``."""
    room, pair = 1.0, 0
    for which in range(len(rings) + 1):
        for part in range(3):
            if (part == 1 and sizes[2] == 0.0) or (part == 2 and (not known or which == 0)):
                continue
            taken = 0.0 if part == 2 else sizes[part] + sizes[3]
            # What is further needs no search; below 0 the depth counts.
            most = taken + max(room, 0.0)
            if part == 0:
                away = _along(ends[0], ends[0], which, line, boxes, rings, most)
            elif part == 1:
                away = _along(ends[0], ends[1], which, line, boxes, rings, most)
            else:
                away = _along(ends[2], leaves, which, line, boxes, rings, most)
            if away - taken < room:
                room, pair = away - taken, 3 * which + part
    return room, pair


@njit(nogil=True)
def _walk(
    eyes: FloatArray, laid: FloatArray, table: tuple[FloatArray, FloatArray, FloatArray],
    payout: FloatArray, sizes: FloatArray, line: FloatArray, boxes: FloatArray,
    rings: FloatArray, least: float, found: FloatArray, pair: IntArray,
) -> float:  # fmt: skip
    """Write by how much each sample is too near, and the pair; return the least room so far.

    Parameters
    ----------
    eyes
        (n, 6) coordinates of the eye from the mandrel's left end.
    laid
        (n, 3) u, angle and laid length of the fibre; NaN where it is not known.
    sizes
        Radius of the eye's body, radius and length of its arm, and the distance wanted.
    least
        Least room of the samples before: rooms above it are of no interest.
    found
        (n,) lengths, written; 0 where a sample was passed over.
    pair
        (n,) written: three times the body, 0 for the mandrel, plus 0 for the eye, 1 for the arm, 2
        for the free fibre.
    """
    still = np.zeros(6)
    across = np.array([0.0, 1.0, 0.0])
    ends = np.empty((3, 3))  # the centre of the eye, the end of the arm, the laid point
    leaves = np.empty(3)
    before = np.full((4, 3), math.inf)
    room, hint = -math.inf, 0
    for i in range(len(eyes)):
        q = eyes[i]
        ends[0, 0], ends[0, 1], ends[0, 2], _, _, _ = centre(q, still, payout)
        ends[1, 0], ends[1, 1], ends[1, 2], _, _, _ = turned(across, q, still)
        for j in range(3):
            ends[1, j] = ends[0, j] + sizes[2] * ends[1, j]
        known = math.isfinite(laid[i, 0])
        if known:
            hint = _free(laid[i], q, table, payout, hint, ends[2], leaves)
        moved = 0.0
        for k in range(4 if known else 2):
            point = leaves if k == 3 else ends[k]
            way = 0.0
            for j in range(3):
                way += (point[j] - before[k, j]) ** 2
                before[k, j] = point[j]
            moved = max(moved, math.sqrt(way))
        if not known:
            before[2, 0] = math.inf
        room -= moved
        limit = min(least, 0.0)
        if room >= limit:
            continue
        room, closest = _room(ends, leaves, known, sizes, line, boxes, rings)
        if room < limit:
            found[i], pair[i] = -room, closest
        least = min(least, room)
    return least


@njit(nogil=True)
def _above(
    x: float, r: float, u: float, hint: int, table: tuple[FloatArray, FloatArray, FloatArray]
) -> tuple[float, float, float, float, int]:
    """Return the height of a point over the bare mandrel, and the mandrel below it.

    That is u, cosine and sine of the meridian's angle, and the piece; ``u`` and ``hint`` are a
    place and a piece nearby. The height is infinite beyond the ends.
    """
    last, height, cb, sb = table[0][-1], 0.0, 1.0, 0.0
    for _ in range(_ROUNDS):
        hint, px, pr, cb, sb, bend, speed = meridian(table[0], table[1], table[2], u, hint)
        height = (r - pr) * cb - (x - px) * sb
        along = (x - px) * cb + (r - pr) * sb
        u += along / (max(1.0 + height * bend, 0.1) * speed)
        if not 0.0 <= u <= last:
            return math.inf, min(max(u, 0.0), last), cb, sb, hint
    return height, u, cb, sb, hint


@njit(nogil=True)
def _hollow(
    at: FloatArray, to: FloatArray, u: float, table: tuple[FloatArray, FloatArray, FloatArray],
    layers: FloatArray, sizes: FloatArray, hull: FloatArray,
) -> float:  # fmt: skip
    """Return the largest height of a taut fibre over the layers before it leaves them.

    The fibre from the laid point ``at`` lies on the layers from there on: as a string over what
    stands above the straight line to the pay-out point ``to``, in the plane of the line and the
    normal. It is the upper hull of the layers above the line.

    Parameters
    ----------
    u
        Place of the laid point.
    layers
        (2, m) u and thickness of the layers.
    sizes
        Length between two places along the fibre that are looked at, and the height above which no
        layer stands ahead.
    hull
        (3, k) written: length along the line, height above it, and the corners of the hull.
    """
    length = math.sqrt((to[0] - at[0]) ** 2 + (to[1] - at[1]) ** 2 + (to[2] - at[2]) ** 2)
    count = int(min(max(math.ceil(length / sizes[0]), 8.0), hull.shape[1] - 1.0))
    hint = max(int(np.searchsorted(table[0], u)) - 1, 0)
    _, _, cb, sb, hint = _above(at[0], math.hypot(at[1], at[2]), u, hint, table)
    radius, highest = math.hypot(at[1], at[2]), 0.0
    n0, n1, n2 = -sb, cb * at[1] / radius, cb * at[2] / radius
    for k in range(count + 1):
        share, high = k / count, 0.0
        for _ in range(_TWICE):
            x = at[0] + share * (to[0] - at[0]) + high * n0
            across = at[1] + share * (to[1] - at[1]) + high * n1
            up = at[2] + share * (to[2] - at[2]) + high * n2
            radius = math.hypot(across, up)
            height, u, cb, sb, hint = _above(x, radius, u, hint, table)
            level = cb * (across * n1 + up * n2) / radius - sb * n0
            high += (np.interp(u, layers[0], layers[1]) - height) / max(level, 0.1)
            if not high > -length:
                break  # beyond the end of the mandrel
        hull[0, k], hull[1, k] = share * length, high
        if k == count or height > sizes[1]:
            count = k
            break
        if k:
            highest = max(highest, high)
    if highest <= 0.0:
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
    deepest = 0.0
    for corner in range(corners - 2):  # the last stretch leads to the eye
        a, b = int(hull[2, corner]), int(hull[2, corner + 1])
        slope = (hull[1, b] - hull[1, a]) / (hull[0, b] - hull[0, a])
        for k in range(a + 1, b):
            over = hull[1, a] + slope * (hull[0, k] - hull[0, a]) - hull[1, k]
            if over < length:  # there is no layer beyond the end of the mandrel
                deepest = max(deepest, over)
    return deepest


@njit(nogil=True)
def _over_layers(
    eyes: FloatArray, laid: FloatArray, table: tuple[FloatArray, FloatArray, FloatArray],
    payout: FloatArray, layers: FloatArray, sizes: FloatArray,
    least: float, found: FloatArray, pair: IntArray,
) -> float:  # fmt: skip
    """Compare free fibres with the layers ahead; the arguments are those of ``_walk``.

    A fibre that spans a hollow higher than one band before it meets layers ahead is held off its
    place by them. A hollow that is less high is the edge of a band: the mean of the layers round
    the mandrel cannot tell it from bands that lie beside each other.

    Parameters
    ----------
    layers
        (2, m) u and thickness of the layers.
    sizes
        Those of ``_hollow``; the length between two fibres that are compared, the laid length of
        the latest, which is updated, and the thickness of the band.
    """
    a, b = np.empty(3), np.empty(3)
    hull = np.empty((3, _MOST_PLACES))
    hint = 0
    for i in range(len(eyes)):
        if not math.isfinite(laid[i, 0]) or abs(laid[i, 2] - sizes[3]) < sizes[2]:
            continue
        sizes[3] = laid[i, 2]
        hint = _free(laid[i], eyes[i], table, payout, hint, a, b)
        room = sizes[4] - _hollow(a, b, laid[i, 0], table, layers, sizes, hull)
        if room < min(least, 0.0):
            least = room
            found[i], pair[i] = -least, _PILE
    return least


_PARTS = ("the eye", "the arm", "the free fibre")


class Clearance:
    """How far eye, arm and free fibre of a run come nearer to other bodies than allowed.

    Parameters
    ----------
    surface
        The mandrel.
    rings
        What else turns about its axis.
    tool
        The eye with its sizes.
    wanted_m
        Distance that eye and arm keep; the fibre keeps off by any distance.
    layer_m2
        Section of the band, m2, with which the mandrel grows; 0 for a mandrel that does not.
    width_m
        Width of the band.
    """

    def __init__(
        self,
        surface: Surface,
        rings: Sequence[Ring],
        tool: Tool,
        wanted_m: float,
        layer_m2: float = 0.0,
        width_m: float = 0.0,
    ) -> None:
        self._surface, self._layer, self._width = surface, layer_m2, width_m
        self._names = ("the mandrel", *(ring.name for ring in rings))
        self._rings = np.array([[r.begin_m, r.end_m, r.radius_m] for r in rings]).reshape(-1, 3)
        body, (arm, reach) = tool.body_m, tool.arm_m
        self._sizes = np.array([body, arm, reach, wanted_m])
        self._payout = np.array([*tool.payout_m, *tool.roller_m, 0.0, 1.0, 0.0])
        self._edges = np.linspace(0.0, surface.length_m, _CELLS + 1)
        middle = 0.5 * (self._edges[:-1] + self._edges[1:])
        self._u = outline_of(surface)
        if layer_m2:  # the flanks of layers are between the vertices of a straight meridian, too
            self._u = np.union1d(self._u, middle)
        x, r = surface.at(self._u)
        self._x, self._r = x[:, 0], r[:, 0]
        self._normal = np.column_stack([-r[:, 1], x[:, 1]]) / np.hypot(x[:, 1], r[:, 1])[:, None]
        self._area = 2.0 * math.pi * surface.at(middle)[1][:, 0] * np.diff(self._edges)
        self._wound, self._fresh = np.zeros(_CELLS), np.zeros(_CELLS)
        self._seen = 0
        self._length, self._compared = 0.0, -math.inf
        self._least = math.inf
        self.pair: IntArray = np.zeros(0, dtype=np.int64)

    @property
    def too_near(self) -> bool:
        """Whether anything was too near so far."""
        return self._least < 0.0

    def hollow_m(self, eye: FloatArray, u: float, angle: float) -> float:
        """Return the height, m, of the fibre over the layers before it leaves them for the eye.

        ``eye`` is (6,), ``u`` and ``angle`` are the laid point; see ``_hollow``.
        """
        at, to = np.empty(3), np.empty(3)
        surface = self._surface
        table = surface.nodes, surface.x, surface.r
        _free(np.array([u, angle]), eye, table, self._payout, 0, at, to)
        layers, hull = np.array([self._u, self.thickness_m]), np.empty((3, _MOST_PLACES))
        return float(_hollow(at, to, u, table, layers, self._looked(layers), hull))

    def _looked(self, layers: FloatArray) -> FloatArray:
        """Return how far apart and up to which height the layers are looked at from a fibre."""
        # Over a hollow of the mandrel a fibre may rise first, and meet layers behind it.
        top = layers[1].max() if self._surface.convex else math.inf
        return np.array([self._edges[1], top])

    @property
    def thickness_m(self) -> FloatArray:
        """(n,) mean thickness of the layers at the vertices of the outline, m."""
        wide = max(round(self._width / (self._edges[1] - self._edges[0])), 1)
        spread = np.convolve(self._wound, np.full(wide, 1.0 / wide), mode="same")
        middle = 0.5 * (self._edges[:-1] + self._edges[1:])
        return np.asarray(np.interp(self._u, middle, spread / self._area))

    def _outline(self) -> tuple[FloatArray, FloatArray]:
        """Return the closed outline, (n, 2), of the grown mandrel, and the boxes of its chords."""
        points = np.column_stack([self._x, self._r])
        if self._layer:
            points = points + self.thickness_m[:, None] * self._normal
        line = np.vstack([[points[0, 0], 0.0], points, [points[-1, 0], 0.0]])
        starts = np.arange(0, len(line) - 1, _LEAF)
        boxes = []
        for start in starts:
            part = line[start : start + _LEAF + 1]
            boxes.append([*np.sort(part[:, 0])[[0, -1]], *np.sort(part[:, 1])[[0, -1]]])
        return np.ascontiguousarray(line), np.array(boxes)

    def feed(self, eyes: FloatArray, fibre: Fibre | None = None) -> FloatArray:
        """Take the next (n, 6) coordinates of the eye and the fibre there.

        Returns
        -------
        FloatArray
            (n,) lengths, m, by which a run is too near; 0 where it is no nearer than before.
        """
        count = len(eyes)
        laid = np.full((count, 3), np.nan)
        if fibre is not None:
            laid[fibre.known] = np.column_stack([fibre.u, fibre.angle, fibre.length_m])[fibre.known]
        found, self.pair = np.zeros(count), np.zeros(count, dtype=np.int64)
        surface, eyes = self._surface, np.ascontiguousarray(eyes)
        table = surface.nodes, surface.x, surface.r
        for part in self._parts(count):
            line, boxes = self._outline()
            self._least = _walk(
                eyes[part], laid[part], table, self._payout, self._sizes, line, boxes, self._rings,
                self._least, found[part], self.pair[part],
            )  # fmt: skip
            if self._layer and self._wound.any():
                tables = np.array([self._u, self.thickness_m])
                band = [_QUARTER * self._width, self._compared, self._layer / self._width]
                sizes = np.array([*self._looked(tables), *band])
                self._least = _over_layers(
                    eyes[part], laid[part], table, self._payout, tables, sizes,
                    self._least, found[part], self.pair[part],
                )  # fmt: skip
                self._compared = float(sizes[3])
            if fibre is not None:
                self._wind(fibre.u[part], fibre.length_m[part])
        return found

    def _parts(self, count: int) -> Iterator[slice]:
        """Return the next samples in parts that have one thickness of the layers each.

        The mandrel grows after every ``_SAMPLES`` samples of the run, however it is read in blocks.
        """
        first = 0
        while first < count:
            stop = count
            if self._layer:
                if self._seen % _SAMPLES == 0:
                    self._wound, self._fresh = self._wound + self._fresh, np.zeros(_CELLS)
                stop = min(count, first + _SAMPLES - self._seen % _SAMPLES)
            self._seen += stop - first
            yield slice(first, stop)
            first = stop

    def _wind(self, u: FloatArray, length_m: FloatArray) -> None:
        """Add fibre that lies at (n,) ``u``; the ends of its stretches have (n,) ``length_m``."""
        finite = np.isfinite(u) & np.isfinite(length_m)
        if not self._layer or not finite.any():
            return
        length = length_m[finite]
        laid = np.diff(length, prepend=self._length)
        self._length = float(length[-1])
        # Shared between the two nearest cells: an edge of a cell makes no step.
        place = np.clip(u[finite] / self._edges[1] - 0.5, 0.0, _CELLS - 1.0)
        cells = np.minimum(place.astype(np.int64), _CELLS - 2)
        share = place - cells
        for cell, part in ((cells, 1.0 - share), (cells + 1, share)):
            self._fresh += np.bincount(cell, weights=laid * part * self._layer, minlength=_CELLS)

    def words(self, pair: int) -> str:
        """Return in words which part comes too near to which body."""
        if pair == 0 and self._least < 0.0:
            fit = f"it would fit with a radius {-1e3 * self._least:.3g} mm smaller"
            return f"the eye and the mandrel: {fit}"
        other = "the layers wound before" if pair == _PILE else self._names[pair // 3]
        return f"{_PARTS[pair % 3]} and {other}"
