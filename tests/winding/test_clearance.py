"""Clearance, compared with triangle meshes in space; the mandrel's growth by closed forms."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull, cKDTree

from tests.winding import programs
from threadline.base.arrays import FloatArray
from threadline.machine import load_machine
from threadline.machine.quantity import Quantity, parse_machine_quantity
from threadline.machine.tool import Arm, Tool
from threadline.winding.clearance import Clearance
from threadline.winding.product import Product, product_of_text, product_text
from threadline.winding.replay import Fibre, Replay
from threadline.winding.surface import Surface

VESSEL = Path(__file__).parents[2] / "examples" / "vessel.wind.toml"
BODIES = (
    '[[boss]]\nat = "-12 mm"\nlength = "20 mm"\nradius = "26 mm"\n'
    '[[pin]]\nat = "45 mm"\nradius = "58 mm"\ndiameter = "4 mm"\n'
)
EYE = load_machine("lathe-winder").tool
assert EYE is not None


def _mm(value: float) -> Quantity:
    return parse_machine_quantity(f"{value} mm exact, assumed: a test", ("m",))


def _tool(body: float, arm: tuple[float, float] | None = None) -> Tool:
    assert EYE is not None
    return Tool(
        kind="eye", radius=EYE.radius, turn=EYE.turn, along=EYE.along, across=EYE.across,
        body=_mm(body), arm=None if arm is None else Arm(radius=_mm(arm[0]), length=_mm(arm[1])),
    )  # fmt: skip


@pytest.fixture(scope="module")
def product(tmp_path_factory: pytest.TempPathFactory) -> Product:
    """Return the vessel of the examples with a boss and a ring of pins."""
    file = tmp_path_factory.mktemp("p") / "p.wind.toml"
    file.write_text(VESSEL.read_text() + BODIES)
    return product_of_text(product_text(file))


def _turned(outline: FloatArray, around: int = 180) -> FloatArray:
    """Return (n, 3, 3) triangles of a closed outline, (m, 2), turned about the axis."""
    rows = [outline[:1]]
    for a, b in itertools.pairwise(outline):
        count = max(int(np.hypot(*(b - a)) / 1.5e-3), 1)
        rows.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    line = np.vstack(rows)
    angle = np.linspace(0.0, 2.0 * np.pi, around + 1)
    x = np.repeat(line[:, :1], around + 1, 1)
    grid = np.stack([x, line[:, 1:] * np.cos(angle), line[:, 1:] * np.sin(angle)], -1)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    return np.concatenate([np.stack(t, 2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))])


def _off_triangles(point: FloatArray, triangles: FloatArray) -> float:
    """Return the distance of a point to the nearest of (n, 3, 3) triangles."""
    best = np.inf
    for k in range(3):
        a, b = triangles[:, k], triangles[:, (k + 1) % 3]
        edge = b - a
        square = np.maximum((edge**2).sum(1), 1e-30)
        share = np.clip(((point - a) * edge).sum(1) / square, 0.0, 1.0)
        best = min(best, float(np.linalg.norm(point - a - share[:, None] * edge, axis=1).min()))
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    size = np.maximum(np.linalg.norm(normal, axis=1), 1e-30)
    normal = normal / size[:, None]
    height = ((point - a) * normal).sum(1)
    foot = point - height[:, None] * normal
    within = size > 1e-15
    for k in range(3):
        p, q = triangles[:, k], triangles[:, (k + 1) % 3]
        within &= (np.cross(q - p, foot - p) * normal).sum(1) >= 0.0
    return min(best, float(np.abs(height[within]).min())) if within.any() else best


def _off_mesh(points: FloatArray, triangles: FloatArray, tree: cKDTree) -> float:
    """Return the least distance of points to a mesh of triangles of about 1.5 mm."""
    found = tree.query(points, k=1)[0]
    best = np.inf
    for at in np.argsort(found)[:8]:
        near = np.asarray(tree.query(points[at], k=800)[1])
        best = min(best, _off_triangles(points[at], triangles[near]))
    return best


@pytest.fixture(scope="module")
def mesh(product: Product) -> tuple[FloatArray, cKDTree]:
    """Return the triangles of mandrel, boss and pins, and a tree of their middles."""
    x, r = (v[:, 0] for v in product.surface.at(np.linspace(0.0, product.surface.length_m, 801)))
    outlines = [np.vstack([[x[0], 0.0], np.column_stack([x, r]), [x[-1], 0.0]])]
    for begin, end, radius in ((-0.012, 0.008, 0.026), (0.043, 0.047, 0.058)):
        outlines.append(np.array([[begin, 0.0], [begin, radius], [end, radius], [end, 0.0]]))
    triangles = np.concatenate([_turned(outline) for outline in outlines])
    return triangles, cKDTree(triangles.mean(1))


def test_eye_and_arm_are_as_far_as_from_a_mesh(
    product: Product, mesh: tuple[FloatArray, cKDTree]
) -> None:
    """The bar is 0.05 mm; the mesh of 1.5 mm and 2 degrees is off by at most 9 um."""
    triangles, tree = mesh
    chance = np.random.default_rng(2)
    for arm in (None, (3.0, 40.0)):
        tool, tested = _tool(4.0, arm), 0
        while tested < 6:
            eye = np.zeros(6)
            eye[1:4] = chance.uniform([-0.03, -0.06, -0.1], [0.17, 0.11, 0.1])
            eye[4:] = chance.uniform(-1.0, 1.0, 2)
            # Yaw turns across to against along.
            across = np.array([-np.sin(eye[4]), np.cos(eye[4]), 0.0])
            reach = 0.0 if arm is None else 0.04
            points = eye[1:4] + np.linspace(0.0, reach, 400)[:, None] * across
            inside = product.surface.place_of(points[:, 0])
            r = product.surface.at(inside)[1][:, 0]
            away = np.hypot(points[:, 1], points[:, 2])
            if (away < np.maximum(r, 0.058) + 1e-3).any():
                continue  # the mesh does not know its inside
            tested += 1
            expected_values = 0.2
            found = expected_values - Clearance(
                product.surface, product.rings, tool, expected_values
            ).feed(eye[None])
            whole = _off_mesh(points, triangles, tree)
            body = _off_mesh(points[:1], triangles, tree) - 4e-3
            expected = body if arm is None else min(body, whole - 3e-3)
            assert found[0] == pytest.approx(expected, abs=5e-5)


def test_the_free_fibre_is_as_deep_in_a_boss_as_by_points_on_it(product: Product) -> None:
    """A fibre from the left dome to an eye beside the boss, checked at 20 000 points."""
    surface, tool = product.surface, _tool(1.0)
    eyes = np.zeros((120, 6))
    eyes[:, 0] = -0.05 * np.arange(120)
    eyes[:, 1] = np.linspace(0.06, -0.06, 120)
    eyes[:, 2] = 0.07
    fibre = Replay(surface, tool, 10.0, 0.06).feed(eyes)
    boss = Clearance(surface, product.rings[:1], tool, 0.0)
    found = boss.feed(eyes, fibre)
    deepest = 0.0
    for at in np.flatnonzero(fibre.known):
        x, r = (float(v[0, 0]) for v in surface.at(fibre.u[at : at + 1]))
        angle = fibre.angle[at] + eyes[at, 0]
        start = np.array([x, r * np.cos(angle), r * np.sin(angle)])
        line = start + np.linspace(0.0, 1.0, 20_000)[:, None] * (eyes[at, 1:4] - start)
        depth = np.minimum(
            np.minimum(line[:, 0] + 0.012, 0.008 - line[:, 0]),
            0.026 - np.hypot(line[:, 1], line[:, 2]),
        )
        deepest = max(deepest, float(depth.max()))
    assert deepest > 1e-4
    assert found.max() == pytest.approx(deepest, abs=1e-5)
    assert boss.words(int(boss.pair[found.argmax()])) == "the free fibre and the boss at -12 mm"


def _helix(layers: int) -> tuple[Product, Tool, FloatArray, Fibre]:
    product = product_of_text(
        '{"part": [{"kind": "cylinder", "radius": "50 mm", "length": "200 mm"}], "band": {"width":'
        ' "5 mm", "thickness": "0.4 mm"}, "friction": {"value": "0.3"}}'
    )
    tool = _tool(1.0)
    share = np.linspace(0.0, 1.0, 4000)
    there = np.concatenate([share if k % 2 == 0 else 1.0 - share for k in range(layers)])
    eyes = np.zeros((len(there), 6))
    eyes[:, 1], eyes[:, 2] = 0.02 + 0.16 * there, 0.06
    eyes[:, 0] = -2.0 * np.pi * 32.0 * np.arange(len(there)) / 4000.0  # a pitch of the width
    return product, tool, eyes, Replay(product.surface, tool, 1.0, 0.02).feed(eyes)


def test_layers_grow_by_their_thickness_and_come_near_the_eye() -> None:
    """Bands lie side by side: each layer adds one thickness, and the eye has so much less room.

    When the eye winds the fifth layer, four lie below it, and some of the fifth beside it.
    """
    product, tool, eyes, fibre = _helix(5)
    assert product.thickness is not None
    near = Clearance(product.surface, (), tool, 0.009, product.width.si * product.thickness, 5e-3)
    found = near.feed(eyes, fibre)
    middle = near.thickness_m[(near.bare_m[:, 0] > 0.05) & (near.bare_m[:, 0] < 0.15)]
    np.testing.assert_allclose(middle, 5 * 0.4e-3, rtol=0.03)
    # 10 mm from the bare mandrel, less 1 mm of the eye, the wanted 9 mm, and the layers.
    assert 0.97 * 4 * 0.4e-3 < found.max() < 5 * 0.4e-3
    cut = Clearance(product.surface, (), tool, 0.009, product.width.si * product.thickness, 5e-3)
    replay = Replay(product.surface, tool, 1.0, 0.02)
    parts = [cut.feed(part, replay.feed(part)) for part in np.split(eyes, [1, 700, 5_001])]
    np.testing.assert_allclose(np.concatenate(parts), found, atol=1e-15)
    bare = Clearance(product.surface, (), tool, 0.0089)
    assert bare.feed(eyes, fibre).max() == 0.0


def _sliced(triangles: FloatArray, ends: FloatArray, normal: FloatArray) -> FloatArray:
    """Return (m, 2) points where a mesh meets the plane of a line and a normal.

    They are lengths along the line between its ``ends``, (2, 3), and heights above it.
    """
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    up = normal - (normal @ along) * along
    frame = np.stack([along, up / np.linalg.norm(up), np.cross(along, up) / np.linalg.norm(up)])
    seen = (triangles - ends[0]) @ frame.T
    found = []
    for k in range(3):
        a, b = seen[:, k], seen[:, (k + 1) % 3]
        cut = (a[:, 2] < 0.0) != (b[:, 2] < 0.0)
        share = a[cut, 2] / (a[cut, 2] - b[cut, 2])
        found.append((a[cut] + share[:, None] * (b[cut] - a[cut]))[:, :2])
    points = np.vstack(found)
    length = float(np.linalg.norm(ends[1] - ends[0]))
    near = (points[:, 0] >= 0.0) & (points[:, 0] <= length) & (points[:, 1] > -0.5 * length)
    return points[near][np.argsort(points[near, 0])]


def _hollow_of_mesh(near: Clearance, ends: FloatArray, normal: FloatArray) -> float:
    """Return the hollow under a string over the layers, by a mesh of the layers and a hull."""
    outline = near.bare_m + near.thickness_m[:, None] * near.normal
    points = _sliced(_turned(outline, 360), ends, normal)
    length = float(np.linalg.norm(ends[1] - ends[0]))
    grid = np.linspace(0.0, length, 1201)
    profile = np.interp(grid, points[:, 0], points[:, 1])
    profile[-1] = 0.0
    over = np.column_stack([grid, profile])
    corners = np.sort(ConvexHull(np.vstack([over, [[0.0, -1.0], [length, -1.0]]])).vertices)
    corners = corners[corners < len(grid)]
    string = np.interp(grid, grid[corners], profile[corners])
    lies = grid <= grid[corners[-2]]
    return float((string - profile)[lies].max())


def _free_fibre(
    product: Product, eyes: FloatArray, fibre: Fibre, at: int
) -> tuple[FloatArray, FloatArray]:
    """Return the ends of a free fibre, (2, 3), and the normal where it is laid."""
    x, r = (values[0] for values in product.surface.at(fibre.u[at : at + 1]))
    angle = fibre.angle[at] + eyes[at, 0]
    out = np.array([0.0, np.cos(angle), np.sin(angle)])
    along = np.array([1.0, 0.0, 0.0])
    normal = x[1] * out - r[1] * along
    ends = np.stack([x[0] * along + r[0] * out, eyes[at, 1:4]])
    return ends, normal / np.linalg.norm(normal)


def test_layers_that_a_free_fibre_cannot_meet_change_nothing(product: Product) -> None:
    """The hollows over the layers are the same to the bit if the whole free fibre is checked."""
    surface, tool = product.surface, _tool(0.0)
    circuit = programs.eyes(surface, programs.geodesic(surface)[1])
    turn = circuit[-1, 0]
    eyes = np.zeros((12 * len(circuit), 6))
    eyes[:, :3] = np.vstack([circuit + np.array([k * turn, 0.0, 0.0]) for k in range(12)])
    eyes[:, 1] -= programs.AT_M
    fibre = Replay(surface, tool, 1.0, product.tied).feed(eyes)
    # On a mandrel that is not declared convex nothing ahead is left out.
    whole = Surface(surface.nodes, surface.x, surface.r, convex=False)
    near, all_of_it = (Clearance(one, (), tool, 0.0, 5e-3 * 5e-4, 5e-3) for one in (surface, whole))
    for one in (near, all_of_it):
        one.feed(eyes, fibre)
    at = np.flatnonzero(fibre.known)[::17]
    found, expected = (
        [one.hollow_m(eyes[k], fibre.u[k], fibre.angle[k]) for k in at] for one in (near, all_of_it)
    )
    assert found == expected
    assert len(at) > 50 and max(found) > 1e-4


def test_a_bead_is_in_the_way_of_a_free_fibre_that_comes_back() -> None:
    """Twelve turns in one place make a bead of 5 mm; a fibre that crosses it runs into it.

    The hollow before the bead agrees with a mesh of the layers within 0.15 mm: the bead's flank is
    upright, and the layers are checked every 0.4 mm.
    """
    product, tool, _, _ = _helix(1)
    turns = np.linspace(0.0, 25.0, 5001)
    eyes = np.zeros((len(turns), 6))
    eyes[:, 0], eyes[:, 2] = -2.0 * np.pi * turns, 0.06
    eyes[:, 1] = np.interp(turns, [0.0, 12.0, 22.0, 25.0], [0.1, 0.1, 0.03, 0.17])
    fibre = Replay(product.surface, tool, 1.0, 0.1).feed(eyes)
    pile = Clearance(product.surface, (), tool, 0.0, 5e-3 * 0.4e-3, 5e-3)
    found = pile.feed(eyes, fibre)
    at = int(found.argmax())
    # The bead ends half a width beside its middle, and no hollow is as high as the bead.
    assert 1e-3 < found[at] < 12 * 0.4e-3
    assert pile.words(int(pile.pair[at])) == "the free fibre and the layers wound before"
    # It is found while the fibre comes from the left of the bead, not before.
    assert turns[at] > 22.0 and float(product.surface.at(fibre.u[at : at + 1])[0][0, 0]) > 0.085
    without = Clearance(product.surface, (), tool, 0.0)
    assert without.feed(eyes, fibre).max() == 0.0
    middle = pile.thickness_m[np.abs(pile.bare_m[:, 0] - 0.1) < 2e-3]
    np.testing.assert_allclose(middle, 12 * 0.4e-3, rtol=0.06)
    assert pile.thickness_m[np.abs(pile.bare_m[:, 0] - 0.1) > 3e-3].max() < 2 * 0.4e-3
    hollows = []
    for row in (at - 20, at, at + 5, at + 10):
        by_mesh = _hollow_of_mesh(pile, *_free_fibre(product, eyes, fibre, row))
        hollows.append(pile.hollow_m(eyes[row], fibre.u[row], fibre.angle[row]))
        assert hollows[-1] == pytest.approx(by_mesh, abs=1.5e-4)
    assert max(hollows) > 2e-3


def test_a_sound_vessel_is_clear_of_its_own_polar_layers() -> None:
    """44 circuits pile up 2 mm at the poles, and no fibre is in the way of another."""
    vessel = product_of_text(product_text(VESSEL))
    circuit = programs.eyes(vessel.surface, programs.geodesic(vessel.surface)[1])
    turn = circuit[-1, 0] - circuit[0, 0]
    eyes = np.zeros((programs.CIRCUITS * (len(circuit) - 1), 6))
    eyes[:, :3] = np.vstack(
        [circuit[:-1] + np.array([k * turn, 0.0, 0.0]) for k in range(programs.CIRCUITS)]
    )
    eyes[:, 1] -= programs.AT_M
    assert EYE is not None and vessel.thickness is not None and vessel.clearance is not None
    fibre = Replay(vessel.surface, EYE, 0.2, vessel.tied).feed(eyes)
    near = Clearance(
        vessel.surface, (), EYE, vessel.clearance, vessel.width.si * vessel.thickness,
        vessel.width.si,
    )  # fmt: skip
    assert near.feed(eyes, fibre).max() == 0.0
    assert near.thickness_m.max() > 1e-3
    # Near the pole the fibre spans less than a band before the ridge, as over a mesh.
    for row in range(len(eyes) - len(circuit) + 20, len(eyes) - 1, 60):
        found = near.hollow_m(eyes[row], fibre.u[row], fibre.angle[row])
        by_mesh = _hollow_of_mesh(near, *_free_fibre(vessel, eyes, fibre, row))
        assert found == pytest.approx(by_mesh, abs=5e-5)
        assert found < vessel.thickness
