"""Shapes as DXF, read again by the reader of drawings and by ezdxf itself."""

from __future__ import annotations

import io
from pathlib import Path

import ezdxf
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from threadline.geometry.arclength import arc_table
from threadline.geometry.read_dxf import read_dxf
from threadline.geometry.strokes import Stroke
from threadline.geometry.write_dxf import DrawnShape, ShapeKind, dxf_of, spline_controls

QUARTER = np.array([[0.03, 0.0], [0.03 * 0.5**0.5, 0.03 * 0.5**0.5], [0.0, 0.03]])
WAVE = np.array([[0.0, 0.0], [0.01, 0.02], [0.03, -0.01], [0.05, 0.0]])


def written(kind: ShapeKind, points: np.ndarray, folder: Path) -> Stroke:
    content = dxf_of([DrawnShape(kind=kind, points=points)])
    (folder / "a.dxf").write_bytes(content)
    (stroke,) = read_dxf(content, str(folder / "a.dxf")).strokes
    return stroke


def length_m(kind: ShapeKind, points: np.ndarray, folder: Path) -> float:
    stroke = written(kind, points, folder)
    return arc_table(stroke.pieces).length_m


@pytest.mark.parametrize(
    ("kind", "points", "expected_m"),
    [
        ("line", np.array([[0.0, 0.0], [0.03, 0.04], [0.03, 0.14]]), 0.15),
        ("polygon", np.array([[0.0, 0.0], [0.03, 0.0], [0.0, 0.04]]), 0.12),
        ("circle", np.array([[0.1, 0.2], [0.1, 0.21]]), 2 * np.pi * 0.01),
        ("arc", QUARTER, 0.03 * np.pi / 2),
        ("arc", QUARTER[::-1], 0.03 * np.pi / 2),
        ("arc", QUARTER[[0, 2, 1]], 0.03 * np.pi * 7 / 4),  # the long way round
        ("arc", np.array([[0.0, 0.0], [0.01, 0.0], [0.03, 0.0]]), 0.03),  # a line, not an arc
    ],
)
def test_lengths(kind: ShapeKind, points: np.ndarray, expected_m: float, tmp_path: Path) -> None:
    """Closed forms; 1e-9 m allows for the 16 digits of mm in a DXF."""
    assert length_m(kind, points, tmp_path) == pytest.approx(expected_m, abs=1e-9)


def test_a_spline_is_that_of_catmull_and_rom(tmp_path: Path) -> None:
    """Against scipy's cubic Hermite spline with the same tangents."""
    padded = np.vstack([WAVE[:1], WAVE, WAVE[-1:]])
    theirs = CubicHermiteSpline(np.arange(4.0), WAVE, (padded[2:] - padded[:-2]) / 2.0)
    stroke = written("spline", WAVE, tmp_path)
    u = np.linspace(0.0, 1.0, 11)
    assert len(stroke.pieces) == 3
    for piece in range(3):
        ours = stroke.pieces.evaluate(np.full(11, piece), u)[0]
        assert ours == pytest.approx(theirs(piece + u), abs=1e-12)
    assert spline_controls(WAVE)[::3] == pytest.approx(WAVE)


def test_units_and_line_styles_are_told() -> None:
    shapes = [DrawnShape(kind="line", points=WAVE, style=s) for s in ("solid", "dashed", "dotted")]
    document = ezdxf.read(io.StringIO(dxf_of(shapes).decode("utf-8")))
    assert document.units == ezdxf.units.MM
    found = [entity.dxf.linetype for entity in document.modelspace()]
    assert found == ["CONTINUOUS", "DASHED", "DOT"]
    assert all(name in document.linetypes for name in found)
