"""The wound mandrel in space, as a binary glTF 2.0 file (GLB) that viewers and browsers open.

The mandrel is one node. The bands are divided into nodes of equal laid length, in the order of
laying, so that a viewer that hides the later nodes shows an earlier state of the winding. A band is
red where it needs more friction than the lower end of the product's friction range. Lengths are in
m, as glTF demands.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.winding.surface import Surface

_ALONG, _ROUND = 240, 96  # quadrangles of the mandrel
_NODES = 20
"""Number of nodes of the bands; each node has a twentieth of the laid length."""
_MOST_PLACES = 120_000  # largest number of drawn places on the centre line of the bands
_LIFT = 0.002  # share of the largest radius by which bands lie above the mandrel, to avoid flicker
_FLOAT, _UINT, _TRIANGLES = 5126, 5125, 4
_MATERIALS = (
    ("mandrel", (0.82, 0.82, 0.80)),
    ("band", (0.0, 0.447, 0.698)),
    ("band that slips", (0.835, 0.369, 0.0)),
)


def wound_glb(
    surface: Surface, width_m: float, fibre: FloatArray, slips: NDArray[np.bool_], name: str
) -> bytes:
    """Return the mandrel with its bands as a GLB.

    Parameters
    ----------
    width_m
        Width of the band.
    fibre
        (n, 3) in order of laying: arc length u along the meridian in m, angle about the axis and
        winding angle to the meridian in rad; NaN where the place is unknown.
    slips
        (n,) whether the fibre needs more friction at a place than the product has.
    name
        Name of the scene, for people.
    """
    glb = _Glb(name)
    glb.add("mandrel", 0, *_mandrel(surface))
    rows = _thinned(surface, fibre, width_m)
    vertices, normals = _edges(surface, fibre[rows], width_m)
    # A quadrangle joins each place to the next if both are known and neighbours in the run.
    is_joined = np.isfinite(fibre[rows, 0])
    is_joined = is_joined[:-1] & is_joined[1:]
    starts, slipped = np.flatnonzero(is_joined), np.cumsum(slips)
    for number, node_starts in enumerate(np.array_split(starts, _NODES)):
        for material in (1, 2):
            slipping = slipped[rows[node_starts + 1]] > slipped[rows[node_starts]]
            chosen = node_starts[slipping == (material == 2)]
            if not len(chosen):
                continue
            label = f"wound {100 * number // _NODES} to {100 * (number + 1) // _NODES} %"
            corners = 2 * chosen[:, None] + np.array([0, 2, 1, 1, 2, 3])
            vertex_numbers, triangle_corners = np.unique(corners, return_inverse=True)
            suffix = ", slips" if material == 2 else ""
            glb.add(
                label + suffix,
                material,
                vertices[vertex_numbers],
                normals[vertex_numbers],
                triangle_corners.ravel(),
            )
    return glb.content()


def _thinned(surface: Surface, fibre: FloatArray, width_m: float) -> IntArray:
    """Return the rows to draw: evenly spaced along the fibre, and the ends of known stretches."""
    radius = float(surface.r[:, 0].min())
    spacing_m = max(min(0.5 * width_m, 0.2 * radius), 1e-6)
    is_known = np.isfinite(fibre[:, 0])
    u, angle = np.where(is_known, fibre[:, 0], 0.0), np.where(is_known, fibre[:, 1], 0.0)
    r = surface.at(u)[1][:, 0]
    steps_m = np.hypot(np.diff(u, prepend=u[:1]), r * np.diff(angle, prepend=angle[:1]))
    begins = is_known & np.concatenate([[True], ~is_known[:-1]])
    steps_m[begins | ~is_known] = 0.0
    along_m = np.cumsum(steps_m)
    spacing_m = max(spacing_m, float(along_m[-1]) / _MOST_PLACES)
    spacing_number = np.floor(along_m / spacing_m)
    is_kept = np.concatenate([[True], np.diff(spacing_number) > 0.0]) & is_known
    # Both ends of each known stretch are kept, and one unknown row after it, so that no band
    # crosses the gap.
    ends = is_known & np.concatenate([~is_known[1:], [True]])
    is_gap = ~is_known & np.concatenate([[False], is_known[:-1]])
    return np.asarray(np.flatnonzero(is_kept | begins | ends | is_gap))


def _in_space(surface: Surface, u: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (n, 3) places and outward normals."""
    x, r = surface.at(np.clip(u, 0.0, surface.length_m))
    cos, sin = np.cos(angle), np.sin(angle)
    slope_length = np.hypot(x[:, 1], r[:, 1])
    outward, axial = x[:, 1] / slope_length, -r[:, 1] / slope_length
    return (
        np.column_stack([x[:, 0], r[:, 0] * cos, r[:, 0] * sin]),
        np.column_stack([axial, outward * cos, outward * sin]),
    )


def _mandrel(surface: Surface) -> tuple[FloatArray, FloatArray, IntArray]:
    u = np.repeat(np.linspace(0.0, surface.length_m, _ALONG + 1), _ROUND)
    angle = np.tile(np.arange(_ROUND) * (2.0 * np.pi / _ROUND), _ALONG + 1)
    near_corner = np.arange(_ALONG)[:, None] * _ROUND + np.arange(_ROUND)
    next_corner = np.arange(_ALONG)[:, None] * _ROUND + (np.arange(_ROUND) + 1) % _ROUND
    quads = [
        near_corner,
        next_corner,
        near_corner + _ROUND,
        next_corner,
        next_corner + _ROUND,
        near_corner + _ROUND,
    ]
    return (*_in_space(surface, u, angle), np.stack(quads, axis=-1).ravel())


def _edges(surface: Surface, fibre: FloatArray, width_m: float) -> tuple[FloatArray, FloatArray]:
    """Return (2 n, 3) places of both edges of a band, above the mandrel, and their normals."""
    u, angle, winding = (np.where(np.isfinite(fibre[:, 0]), column, 0.0) for column in fibre.T)
    r = surface.at(u)[1][:, 0]
    u = np.stack([u + 0.5 * side * width_m * np.sin(winding) for side in (-1.0, 1.0)], axis=1)
    angle = np.stack(
        [angle - 0.5 * side * width_m * np.cos(winding) / r for side in (-1.0, 1.0)], axis=1
    )
    places, normals = _in_space(surface, u.ravel(), angle.ravel())
    # A flat band would cut into the curved mandrel by its sagitta.
    sagitta = width_m**2 / (8.0 * np.repeat(r, 2)[:, None])
    return places + (_LIFT * float(surface.r[:, 0].max()) + sagitta) * normals, normals


class _Glb:
    """A GLB under construction: a JSON chunk that describes the arrays in a binary chunk."""

    def __init__(self, name: str) -> None:
        self._parts: list[bytes] = []
        self._size = 0
        self._tables: dict[str, list[Any]] = {
            "nodes": [], "meshes": [], "accessors": [], "bufferViews": [],
        }  # fmt: skip
        self._name = name

    def add(
        self, name: str, material: int, places: FloatArray, normals: FloatArray, index: IntArray
    ) -> None:
        """Add a node of m triangles: (n, 3) vertices and normals, (3 m,) numbers of vertices."""
        attributes = {
            "POSITION": self._accessor(places.astype("<f4"), _FLOAT, "VEC3", bounds=True),
            "NORMAL": self._accessor(normals.astype("<f4"), _FLOAT, "VEC3"),
        }
        indices = self._accessor(index.astype("<u4"), _UINT, "SCALAR")
        primitive = {
            "attributes": attributes, "indices": indices, "material": material, "mode": _TRIANGLES,
        }  # fmt: skip
        self._tables["nodes"].append({"name": name, "mesh": len(self._tables["meshes"])})
        self._tables["meshes"].append({"name": name, "primitives": [primitive]})

    def _accessor(
        self, values: np.ndarray[Any, Any], component: int, kind: str, bounds: bool = False
    ) -> int:
        data = np.ascontiguousarray(values).tobytes()
        target = 34963 if component == _UINT else 34962
        self._tables["bufferViews"].append(
            {"buffer": 0, "byteOffset": self._size, "byteLength": len(data), "target": target}
        )
        self._parts.append(data)  # the size of every array is a multiple of four bytes
        self._size += len(data)
        accessor: dict[str, Any] = {
            "bufferView": len(self._tables["bufferViews"]) - 1,
            "componentType": component, "count": len(values), "type": kind,
        }  # fmt: skip
        if bounds:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self._tables["accessors"].append(accessor)
        return len(self._tables["accessors"]) - 1

    def content(self) -> bytes:
        """Return the file: header, JSON chunk padded with blanks, binary chunk."""
        header = {
            "asset": {"version": "2.0", "generator": "Threadline"},
            "scene": 0,
            "scenes": [{"name": self._name, "nodes": list(range(len(self._tables["nodes"])))}],
            "materials": [
                {
                    "name": name, "doubleSided": True,
                    "pbrMetallicRoughness": {
                        "baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0,
                        "roughnessFactor": 0.7,
                    },
                }
                for name, colour in _MATERIALS
            ],
            "buffers": [{"byteLength": self._size}],
            **self._tables,
        }  # fmt: skip
        text = json.dumps(header, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        data = b"".join(self._parts)
        chunks = [(b"JSON", text), (b"BIN\0", data)]
        body = b"".join(len(part).to_bytes(4, "little") + kind + part for kind, part in chunks)
        return b"glTF" + (2).to_bytes(4, "little") + (12 + len(body)).to_bytes(4, "little") + body
