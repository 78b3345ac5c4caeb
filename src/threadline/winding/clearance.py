"""Clearance of a run: distances of eye, arm and free fibre from the mandrel and turning parts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.machine.tool import Tool
from threadline.winding.apart import LEAF, free_fibre, walk
from threadline.winding.product import Ring
from threadline.winding.replay import Fibre
from threadline.winding.surface import Surface
from threadline.winding.taut import (
    MOST_PLACES,
    PILE,
    highest_in_blocks,
    hollow_over,
    over_layers,
    wind,
)

_SAGITTA_M = 1e-6  # of a chord of the outline
_MOST_CHORDS = 20_000
_SAMPLES = 128  # samples of a run for which the layers keep one thickness
_COMPARED_SHARE = 0.25  # share of the band between two fibres that are compared with the layers
_PLACES_PER_BAND = 6  # in the width of a band, where a hollow is first looked for
_CELLS = 512  # of the meridian for the thickness of layers


def outline_of(surface: Surface) -> FloatArray:
    """Return increasing u, (n,), whose chords are within 1 um of the meridian."""
    u = np.unique(np.concatenate([np.linspace(0.0, surface.length_m, 65), surface.nodes]))
    while len(u) < _MOST_CHORDS:
        middle = 0.5 * (u[:-1] + u[1:])
        points, middles = (
            np.column_stack([values[:, 0] for values in surface.at(places)])
            for places in (u, middle)
        )
        chord = np.diff(points, axis=0)
        from_chord = middles - points[:-1]
        distances = np.abs(chord[:, 0] * from_chord[:, 1] - chord[:, 1] * from_chord[:, 0])
        is_coarse = distances > _SAGITTA_M * np.hypot(*chord.T)
        if not is_coarse.any():
            break
        u = np.sort(np.concatenate([u, middle[is_coarse]]))
    return u


@njit(nogil=True)
def _grown(
    bare_points: FloatArray, normal: FloatArray, u: FloatArray, piece: IntArray, middle: FloatArray,
    layers: FloatArray, outline: FloatArray, boxes: FloatArray,
) -> None:  # fmt: skip
    """Write the closed outline of a mandrel with its layers, and the boxes of its chords.

    Parameters
    ----------
    bare, normal
        (n, 2) vertices of the mandrel, m, and the normals there.
    u, piece
        (n,) their places, and the cell before each; -1 and the last one for vertices beyond them.
    middle, layers
        (m,) middles of the cells, and the thickness of the layers there, m.
    line, boxes
        (n + 2, 2) and (b, 4), written: see ``apart.walk``.
    """
    last = len(layers) - 1
    for k in range(len(bare_points)):
        cell = piece[k]
        if cell < 0:
            thickness_m = layers[0]
        elif cell >= last:
            thickness_m = layers[last]
        else:
            slope = (layers[cell + 1] - layers[cell]) / (middle[cell + 1] - middle[cell])
            thickness_m = slope * (u[k] - middle[cell]) + layers[cell]
        for j in range(2):
            outline[k + 1, j] = bare_points[k, j] + thickness_m * normal[k, j]
    end = len(outline) - 1
    outline[0, 0], outline[0, 1], outline[end, 0], outline[end, 1] = (
        outline[1, 0],
        0.0,
        outline[end - 1, 0],
        0.0,
    )
    for box in range(len(boxes)):
        first = box * LEAF
        for j in range(2):
            low, high = outline[first, j], outline[first, j]
            for k in range(first + 1, min(first + LEAF, end) + 1):
                low, high = min(low, outline[k, j]), max(high, outline[k, j])
            boxes[box, 2 * j], boxes[box, 2 * j + 1] = low, high


_PART_NAMES = ("the eye", "the arm", "the free fibre")


class Clearance:
    """Finds by how much eye, arm and free fibre of a run come too near to other bodies.

    Parameters
    ----------
    surface
        The mandrel.
    rings
        The other parts that turn about its axis.
    tool
        The eye with its sizes.
    wanted_m
        Least allowed distance of eye and arm, m; the fibre must only not touch.
    layer_m2
        Cross-section of the band, m2, by which the mandrel grows; 0: it does not grow.
    width_m
        Width of the band.

    Attributes
    ----------
    bare_m
        (k, 2) outline of the bare mandrel: places along its axis, and radii, m.
    normal
        (k, 2) outward unit normals of the outline.
    """

    def __init__(
        self,
        surface: Surface,
        rings: Sequence[Ring],
        tool: Tool,
        distance_m: float,
        layer_m2: float = 0.0,
        width_m: float = 0.0,
    ) -> None:
        self._surface, self._layer, self._width = surface, layer_m2, width_m
        self._names = ("the mandrel", *(ring.name for ring in rings))
        self._rings = np.array([[r.begin_m, r.end_m, r.radius_m] for r in rings]).reshape(-1, 3)
        body, (arm, reach) = tool.body_m, tool.arm_m
        self._sizes = np.array([body, arm, reach, distance_m])
        self._payout = np.array([*tool.payout_m, *tool.roller_m, 0.0, 1.0, 0.0])
        self._edges = np.linspace(0.0, surface.length_m, _CELLS + 1)
        self._wide = max(round(width_m / self._edges[1]), 1)
        self._middle = middle = 0.5 * (self._edges[:-1] + self._edges[1:])
        self._u = outline_of(surface)
        if layer_m2:  # the flanks of layers are between the vertices of a straight meridian, too
            self._u = np.union1d(self._u, middle)
        self._piece = np.searchsorted(middle, self._u, side="right") - 1
        x, r = surface.at(self._u)
        self.bare_m = np.column_stack([x[:, 0], r[:, 0]])
        self.normal = np.column_stack([-r[:, 1], x[:, 1]]) / np.hypot(x[:, 1], r[:, 1])[:, None]
        self._area = 2.0 * math.pi * surface.at(middle)[1][:, 0] * np.diff(self._edges)
        self._wound, self._fresh = np.zeros(_CELLS), np.zeros(_CELLS)
        self._layers: FloatArray | None = None
        self._line = np.empty((len(self._u) + 2, 2))
        self._boxes = np.empty(((len(self._u) + LEAF) // LEAF, 4))
        self._seen = 0
        self._latest, self._compared = np.array([math.nan, 0.0]), -math.inf
        self._least = math.inf
        self.pair: IntArray = np.zeros(0, dtype=np.int64)

    @property
    def too_near(self) -> bool:
        """Whether anything was too near so far."""
        return self._least < 0.0

    def hollow_m(self, eye: FloatArray, u: float, angle: float) -> float:
        """Return the height, m, of the fibre over the layers before it leaves them for the eye.

        ``eye`` is (6,), ``u`` and ``angle`` are the laid point; see ``hollow_over``.
        """
        fibre_begin, fibre_end = np.empty(3), np.empty(3)
        surface = self._surface
        table = surface.nodes, surface.x, surface.r
        free_fibre(np.array([u, angle]), eye, table, self._payout, 0, fibre_begin, fibre_end)
        layers, hull = self._in_cells(), np.empty((3, MOST_PLACES))
        blocks, sizes = highest_in_blocks(layers), self._looked(layers)
        return float(hollow_over(fibre_begin, fibre_end, u, table, layers, blocks, sizes, 1, hull))

    def _looked(self, layers: FloatArray) -> FloatArray:
        """Return ``sizes`` of ``hollow_over``."""
        # Over a hollow of the mandrel a fibre may rise first, and meet layers behind it.
        top = layers.max() if self._surface.convex else math.inf
        return np.array([self._edges[1], top])

    @property
    def thickness_m(self) -> FloatArray:
        """(n,) mean thickness of the layers at the vertices of the outline, m."""
        return np.asarray(np.interp(self._u, self._middle, self._in_cells()))

    def _in_cells(self) -> FloatArray:
        """Return the (m,) mean thickness of the layers in the cells of the meridian, m."""
        if self._layers is None:
            spread = np.convolve(self._wound, np.full(self._wide, 1.0 / self._wide), mode="same")
            self._layers = spread / self._area
            _grown(
                self.bare_m, self.normal, self._u, self._piece, self._middle, self._layers,
                self._line, self._boxes,
            )  # fmt: skip
        return self._layers

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
        too_near_m, self.pair = np.zeros(count), np.zeros(count, dtype=np.int64)
        surface, eyes = self._surface, np.ascontiguousarray(eyes)
        table = surface.nodes, surface.x, surface.r
        for samples in self._parts(count):
            layers = self._in_cells()
            self._least = walk(
                eyes[samples], laid[samples], table, self._payout, self._sizes, self._line,
                self._boxes, self._rings, self._least, too_near_m[samples], self.pair[samples],
            )  # fmt: skip
            if self._layer and layers.any():
                layer_m, coarse = self._layer / self._width, max(self._wide // _PLACES_PER_BAND, 1)
                band_sizes = [_COMPARED_SHARE * self._width, self._compared, layer_m, coarse]
                sizes = np.array([*self._looked(layers), *band_sizes])
                self._least = over_layers(
                    eyes[samples], laid[samples], table, self._payout, layers, sizes,
                    self._least, too_near_m[samples], self.pair[samples],
                )  # fmt: skip
                self._compared = float(sizes[3])
            if fibre is not None and self._layer:
                wind(
                    fibre.u[samples], fibre.length_m[samples], self._edges[1], self._layer,
                    self._latest, self._fresh,
                )  # fmt: skip
        return too_near_m

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
                    self._layers = None
                stop = min(count, first + _SAMPLES - self._seen % _SAMPLES)
            self._seen += stop - first
            yield slice(first, stop)
            first = stop

    def words(self, pair: int) -> str:
        """Say which part comes too near to which body."""
        if pair == 0 and self._least < 0.0:
            fit_text = f"it would fit with a radius {-1e3 * self._least:.3g} mm smaller"
            return f"the eye and the mandrel: {fit_text}"
        other_body = "the layers wound before" if pair == PILE else self._names[pair // 3]
        return f"{_PART_NAMES[pair % 3]} and {other_body}"
