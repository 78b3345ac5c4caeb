"""Coverage, compared with closed forms, and with shapely on the unrolled cylinder if installed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from threadline.base.arrays import FloatArray
from threadline.winding.raster import Raster
from threadline.winding.shapes import ellipse
from threadline.winding.surface import line, surface_of

RADIUS, WIDTH = 0.05, 5e-3
CYLINDER = surface_of([line(0.0, RADIUS, 0.3, RADIUS)], 1e-3)


def _strip(raster: Raster, winding: float, angle: float, step: float = 2e-3) -> None:
    """Lay a helix across the cylinder at an angle with the meridian."""
    u = np.arange(0.0, 0.3, step)
    u = u if math.cos(winding) > 0.0 else u[::-1]
    round_ = angle + u * math.tan(winding) / RADIUS
    full = np.full(len(u), winding)
    raster.lay(u, round_, full, np.ones(len(u), dtype=bool), np.arange(len(u)))
    gone = np.full(1, np.nan)
    raster.lay(gone, gone, gone, np.zeros(1, dtype=bool), np.zeros(1, dtype=np.int64))


def _overlap(raster: Raster) -> float:
    """The mean number of bands where the cylinder is covered."""
    return float(raster.count.mean()) / raster.covered()


@pytest.mark.parametrize("winding", [0.3, 0.9, 1.3, -0.5, math.pi - 0.4])
def test_strips_cover_their_share(winding: float) -> None:
    """The share of parallel strips is number times width over circumference and cosine."""
    strips = 4
    raster = Raster(CYLINDER, WIDTH, 0.05, 0.25)
    for k in range(strips):
        _strip(raster, winding, 2.0 * math.pi * k / strips)
    share = strips * WIDTH / (2.0 * math.pi * RADIUS * abs(math.cos(winding)))
    assert raster.covered() == pytest.approx(share, abs=1e-3)
    assert _overlap(raster) == pytest.approx(1.0, abs=1e-3)


def test_crossing_strips_overlap() -> None:
    """Two crossing sets cover a + b - a b of the surface, with (a + b) / that many bands on it."""
    raster = Raster(CYLINDER, WIDTH, 0.05, 0.25)
    strips = 20
    for winding in (0.6, -0.6):
        for k in range(strips):
            _strip(raster, winding, 2.0 * math.pi * k / strips)
    a = strips * WIDTH / (2.0 * math.pi * RADIUS * math.cos(0.6))
    # The part of 200 mm is no whole number of meshes of the net: 0.3 % of it.
    assert raster.covered() == pytest.approx(2.0 * a - a * a, abs=3e-3)
    assert _overlap(raster) == pytest.approx(2.0 * a / (2.0 * a - a * a), abs=1e-2)


@pytest.mark.parametrize("winding", [0.3, 0.8, 1.2])
def test_a_gap_has_its_width_across(winding: float) -> None:
    strips = 30
    raster = Raster(CYLINDER, WIDTH, 0.05, 0.25)
    for k in range(strips):
        _strip(raster, winding, 2.0 * math.pi * k / strips)
    expected = 2.0 * math.pi * RADIUS * math.cos(winding) / strips - WIDTH
    if expected <= 0.0:
        assert raster.gap().width_m == 0.0
        return
    # A cell on either side.
    assert raster.gap().width_m == pytest.approx(expected, abs=2.1 * WIDTH / 20.0)


def test_a_gap_names_the_band_beside_it() -> None:
    """Of two rings far from each other, the one nearer to the widest gap, in any direction."""
    raster = Raster(CYLINDER, WIDTH, 0.05, 0.25)
    for number, u in ((7, 0.06), (8, 0.20)):
        angle = np.linspace(0.0, 2.0, 400)
        places = np.full(400, u)
        laid = np.ones(400, dtype=bool)
        full = np.full(400, number, dtype=np.int64)
        raster.lay(places, angle, np.full(400, 0.5 * math.pi), laid, full)
        raster.lay(places[:1], angle[:1], angle[:1], ~laid[:1], full[:1])
    gap = raster.gap()
    # No band crosses it round the mandrel: it is as wide as the bare part, about 3.2 rad of arc.
    assert gap.width_m > 0.1
    assert gap.operation in (7, 8)


def test_no_fibre_is_a_gap_and_all_is_none() -> None:
    raster = Raster(CYLINDER, WIDTH, 0.05, 0.25)
    assert raster.gap().share == pytest.approx(1.0)
    for k in range(80):
        _strip(raster, 0.3, 2.0 * math.pi * k / 80)
    assert raster.gap().width_m == 0.0
    assert raster.covered() == pytest.approx(1.0)


def test_a_band_along_a_dome_keeps_its_width() -> None:
    """The area of a meridian band of a sphere is nearly its width times its length."""
    dome = surface_of([ellipse(0.0, 0.1, 0.1, 0.02, left=False)], 1e-3)
    end = 0.09
    raster = Raster(dome, WIDTH, 0.0, end)
    u = np.arange(0.0, dome.length_m, 1e-3)
    none = np.zeros(len(u))
    raster.lay(u, none, none, np.ones(len(u), dtype=bool), np.zeros(len(u), dtype=np.int64))
    area = 2.0 * math.pi * 0.1 * end
    length = 0.1 * math.asin(end / 0.1)
    assert raster.covered() * area == pytest.approx(WIDTH * length, rel=5e-3)


def test_the_unrolled_cylinder_agrees_with_polygons() -> None:
    """The union of random bands agrees with shapely's within 0.1 % of the surface."""
    shapely = pytest.importorskip("shapely")
    raster = Raster(CYLINDER, WIDTH, 0.05, 0.25)
    chance = np.random.default_rng(3)
    shapes = []
    around = 2.0 * math.pi * RADIUS
    for winding, angle in zip(chance.uniform(-1.2, 1.2, 25), chance.uniform(0, 6, 25), strict=True):
        _strip(raster, float(winding), float(angle))
        ends = np.array([0.0, 0.298])
        across = RADIUS * (angle + ends * math.tan(winding) / RADIUS)
        half = 0.5 * WIDTH * np.array([-math.sin(winding), math.cos(winding)])
        middle: FloatArray = np.column_stack([ends, across])
        for turn in range(-20, 21):
            shift = np.array([0.0, turn * around])
            corners = np.vstack([middle + half, (middle - half)[::-1]]) + shift
            shapes.append(shapely.Polygon(corners))
    box = shapely.box(0.05, 0.0, 0.25, around)
    share = shapely.unary_union(shapes).intersection(box).area / box.area
    assert raster.covered() == pytest.approx(share, abs=1e-3)
