"""Fibre and patterns against closed forms, printed figures and a Cartesian integrator."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.winding.cartesian import Quadric, cone, ellipsoid
from threadline.base.arrays import FloatArray
from threadline.errors import JobError
from threadline.jobs.winding.build_up import Laid, bridged, design
from threadline.jobs.winding.circuit import Site, traced, turn_of
from threadline.jobs.winding.closing_patterns import patterns
from threadline.jobs.winding.eye_path import eye_path
from threadline.jobs.winding.layers import read_layers
from threadline.jobs.winding.on_mandrel import wrap_of
from threadline.winding.shapes import ellipse
from threadline.winding.surface import line, surface_of

VESSEL = """
[[part]]
kind = "hemisphere"
radius = "100 mm"
opening = "15 mm"
pole = "left"
[[part]]
kind = "cylinder"
radius = "100 mm"
length = "400 mm"
[[part]]
kind = "hemisphere"
radius = "100 mm"
opening = "15 mm"
pole = "right"
[band]
width = "6 mm"
thickness = "0.25 mm"
tex = 1200
[friction]
value = "0.25 +- 0.05"
"""
"""A vessel: the centre of its band turns at a radius of 20 mm."""


def laid(folder: Path, text: str) -> tuple[Laid, ...]:
    file = folder / "made.wind.toml"
    file.write_text(text, encoding="utf-8")
    return design(read_layers(file))


def test_the_vessel_of_the_text(tmp_path: Path) -> None:
    """Closed forms: 360 deg + 2 L tan(a) / R, great circles, 180 deg + 2 atan(l / cos a)."""
    text = VESSEL + '[[layer]]\nturn = "20 mm"\ncircuits = 103\nshift = 27\n'
    (one,) = laid(tmp_path, text)

    angle, base = math.asin(0.2), one.wrap.base
    assert base.angle == pytest.approx(angle, abs=1e-12)
    around = 2.0 * math.pi + 2.0 * 0.4 * math.tan(angle) / 0.1
    assert base.advance == pytest.approx(around, abs=1e-9)
    assert math.degrees(base.advance) == pytest.approx(453.5636, abs=5e-5)
    assert base.length_m == pytest.approx(0.8 / math.cos(angle) + 0.2 * math.pi, abs=1e-9)
    assert 103 * base.length_m == pytest.approx(148.82, abs=0.005)
    pattern = one.pattern
    assert (pattern.circuits, pattern.shift, pattern.beside, pattern.leading) == (103, 27, 42, True)
    assert 103 - pattern.beside == 61
    assert math.degrees(pattern.off) == pytest.approx(0.8053, abs=5e-5)
    assert pattern.coverage == pytest.approx(1.0039, abs=5e-5)
    # Both domes have the same ratio l: together they turn 4 atan(l / cos a) further.
    ratio = math.cos(angle) * math.tan(0.25 * pattern.off)
    assert one.circuit.left.ratio == one.circuit.right.ratio == pytest.approx(-ratio, abs=1e-9)
    assert ratio == pytest.approx(0.00344, abs=5e-6)
    # A circle whose plane lies l R / sqrt(1 + l^2) from the centre.
    size = math.hypot(1.0, ratio)
    turn = 0.1 * math.sin(math.acos(ratio / size) - math.acos(math.sin(angle) / size))
    assert one.circuit.right.radius_m == pytest.approx(turn, abs=1e-9)
    assert 1e3 * turn == pytest.approx(19.662, abs=1e-3)
    whole = 103 * one.circuit.advance / (2.0 * math.pi)
    assert whole == pytest.approx(130.0, abs=1e-10)


@pytest.mark.parametrize(
    ("room_mm", "ratio"),
    [(200.0, 0.15), (70.0, None), (62.0, 0.18)],
    ids=["long", "short", "too short for half a band"],
)
def test_an_open_end_turns_as_gently_as_the_mandrel_is_long(
    tmp_path: Path, room_mm: float, ratio: float | None
) -> None:
    """On a cylinder a ratio l turns within R (1 / sin a - 1) / l; 15 % to 18 % of 20 % are used.

    The whole band stays on the mandrel: its centre turns half a band before the end.
    """
    radius, width, angle = 50.0, 6.0, math.radians(55.0)
    text = f'''
[[part]]
kind = "cylinder"
radius = "{radius} mm"
length = "{2.0 * room_mm + 250.0} mm"
[band]
width = "{width} mm"
[friction]
value = "0.2"
[coverage]
begin = "{room_mm} mm"
end = "{room_mm + 250.0} mm"
[[layer]]
angle = "55 deg"
'''
    (one,) = laid(tmp_path, text)
    way = radius * (1.0 / math.sin(angle) - 1.0)
    for turn in (one.circuit.left, one.circuit.right):
        used = ratio or way / (room_mm - 0.5 * width)
        assert turn.ratio == pytest.approx(used, rel=1e-4)
        assert turn.ratio >= used * (1.0 - 1e-9) or ratio is not None
        beyond = abs(turn.rows[-1, 1] - turn.rows[0, 1])
        assert 1e3 * beyond == pytest.approx(way / turn.ratio, rel=1e-6)
    if ratio != 0.18:  # another angle turns as far beyond the joint
        other = one.wrap.circuit(constant_m=1e-3 * radius * math.sin(math.radians(54.5)))
        rows = other.right.rows
        assert abs(rows[-1, 1] - rows[0, 1]) == pytest.approx(beyond, rel=1e-6)


def test_a_dwell_on_a_dome_needs_a_boss(tmp_path: Path) -> None:
    layer = '[[layer]]\nturn = "20 mm"\ncircuits = 103\nshift = 27\nclose = "dwell"\n'
    with pytest.raises(JobError, match=r"closes by dwell") as caught:
        laid(tmp_path, VESSEL + layer)
    assert "slip tendency of 4.9" in caught.value.remedy
    assert "the friction holds 0.18" in caught.value.remedy
    boss = "".join(
        f'[[boss]]\nat = "{at} mm"\nlength = "20 mm"\nradius = "14 mm"\n' for at in (-20, 597)
    )
    (one,) = laid(tmp_path, VESSEL + boss + layer)
    assert one.by == "dwell"
    dwells = one.circuit.left.dwell + one.circuit.right.dwell
    assert dwells == pytest.approx(one.pattern.off, abs=1e-12)
    assert one.dwells_m == pytest.approx(103 * one.pattern.off * 0.02, rel=1e-9)
    assert one.length_m == pytest.approx(103 * one.wrap.base.length_m, rel=1e-12)


@pytest.mark.parametrize(("ratio", "angle"), [(0.2, 55.0), (0.1, 70.0)])
def test_the_turn_on_a_cylinder(ratio: float, angle: float) -> None:
    """Axial way R / mu (1 / sin a - 1): 55.194 mm from 55 to 90 degrees on a radius of 50 mm."""
    surface = surface_of([line(0.0, 0.05, 1.0, 0.05)], 1e-3)
    constant = 0.05 * math.sin(math.radians(angle))
    for site in Site(1, 0.5, False), Site(-1, 0.5, False):
        turn = turn_of(surface, site, constant, ratio)
        way = 0.05 / ratio * (1.0 / math.sin(math.radians(angle)) - 1.0)
        assert abs(turn.rows[-1, 1] - 0.5) == pytest.approx(way, abs=1e-12)
    if ratio == 0.2:
        assert 1e3 * way == pytest.approx(55.194, abs=5e-4)


def _cartesian(
    surface: Quadric, begin: FloatArray, tangent: FloatArray, ratio: float, until: float
):
    """Return place and direction along a fibre with k_g / k_n = ratio on an implicit surface.

    n points inwards, and the fibre is steered to the side of b = n x t.
    """

    def rates(_: float, y: FloatArray) -> FloatArray:
        place, t = y[:3], y[3:]
        gradient = surface.gradient(place)
        size = float(np.linalg.norm(gradient))
        inwards = -gradient / size
        normal = surface.along(t) / size
        return np.concatenate([t, normal * inwards + ratio * normal * np.cross(inwards, t)])

    return solve_ivp(
        rates, (0.0, until), np.concatenate([begin, tangent]), method="DOP853", rtol=1e-11,
        atol=1e-13, dense_output=True,
    ).sol  # fmt: skip


@pytest.mark.parametrize("ratio", [0.0, -0.05, 0.15])
def test_a_turn_on_an_ellipsoid_is_the_cartesian_one(ratio: float) -> None:
    """Within 1e-6 rad."""
    height, radius, angle = 0.06, 0.1, math.radians(25.0)
    surface = surface_of([ellipse(0.0, radius, height, 0.02, left=False)], 1e-3)
    turn = turn_of(surface, Site(1, 0.0, True), radius * math.sin(angle), ratio)

    begin = np.array([0.0, radius, 0.0])
    # Along x, and round from y to z: n x t points to the side of a growing angle.
    tangent = np.array([math.cos(angle), 0.0, math.sin(angle)])
    path = _cartesian(ellipsoid(0.0, height, radius), begin, tangent, ratio, turn.length_m)
    for row in turn.rows[:: len(turn.rows) // 7]:
        place, t = path(row[0])[:3], path(row[0])[3:]
        round_ = np.array([0.0, -place[2], place[1]])
        assert math.atan2(place[2], place[1]) == pytest.approx(row[2], abs=1e-8)
        cos = float(t @ round_) / float(np.linalg.norm(round_))
        assert cos == pytest.approx(math.sin(row[3]), abs=1e-8)
    end = path(turn.length_m)
    assert math.atan2(end[2], end[1]) == pytest.approx(turn.round, abs=1e-8)
    assert end[3] == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("ratio", [0.0, 0.1])
def test_a_way_along_a_cone_is_the_cartesian_one(ratio: float) -> None:
    surface = surface_of([line(0.0, 0.04, 0.3, 0.1)], 1e-3)
    angle = math.radians(60.0)
    rows = traced(surface, (0.0, 0.04 * math.sin(angle)), ratio, 1, 0.2)
    assert rows is not None
    slope = math.atan(0.2)
    tangent = np.array(
        [math.cos(angle) * math.cos(slope), math.cos(angle) * math.sin(slope), math.sin(angle)]
    )
    path = _cartesian(cone(-0.2, 0.2), np.array([0.0, 0.04, 0.0]), tangent, ratio, rows[-1, 0])
    end = path(rows[-1, 0])
    turned = math.remainder(math.atan2(end[2], end[1]) - rows[-1, 2], 2.0 * math.pi)
    assert turned == pytest.approx(0.0, abs=1e-8)
    if ratio == 0.0:  # the invariant of a geodesic
        radius = surface.at(rows[:, 1])[1][:, 0]
        assert np.ptp(radius * np.sin(rows[:, 3])) < 1e-13


def test_the_eye_on_its_envelope() -> None:
    """Free length sqrt(130^2 - 100^2) / sin 55 deg = 101.405 mm, lead 58.164 mm."""
    surface = surface_of([line(0.0, 0.1, 1.0, 0.1)], 1e-3)
    angle = math.radians(55.0)
    course = np.array([[0.0, 0.5, 0.0, angle], [0.1, 0.55, 0.1, angle]])
    for far, round_ in ((0.03, False), (0.13, True)):
        path = eye_path(surface, course, far, round_)
        assert path.free_m == pytest.approx(math.sqrt(0.13**2 - 0.1**2) / math.sin(angle), abs=1e-9)
        assert 1e3 * path.free_m[0] == pytest.approx(101.405, abs=5e-4)
        assert 1e3 * (path.eye[0, 1] - 0.5) == pytest.approx(58.164, abs=5e-4)
        assert path.eye[:, 2] == pytest.approx(0.13, abs=1e-12)


def test_patterns_close_and_cover(tmp_path: Path) -> None:
    """Every pattern of the table: no place twice, one band beside the other, covered."""
    file = tmp_path / "made.wind.toml"
    file.write_text(VESSEL + '[[layer]]\nturn = "20 mm"\n', encoding="utf-8")
    winding = read_layers(file)
    wrap = wrap_of(winding, winding.layers[0], winding.product.surface)
    table = patterns(wrap)
    assert len(table) > 50
    for one in table:
        places = np.arange(one.circuits) * one.shift % one.circuits
        assert len(set(places.tolist())) == one.circuits
        assert places[one.beside] in (1, one.circuits - 1)
        assert (places[one.beside] == 1) == one.leading
        assert one.coverage >= 1.0
        advance = wrap.base.advance + one.off
        assert math.remainder(advance * one.circuits, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)
        assert round(advance * one.circuits / (2.0 * math.pi)) == one.turns
        # A circle of ratio l on a hemisphere turns at R sin(a - atan l), at the band's opening.
        if not math.isnan(one.ratio):
            assert 0.1 * math.sin(math.asin(0.2) - math.atan(one.ratio)) > 0.018 - 1e-5


@pytest.mark.parametrize("layer", ['turn = "20 mm"', 'turn = "60 mm"', 'angle = "25 deg"'])
def test_a_layer_keeps_the_volume_of_its_fibre(tmp_path: Path, layer: str) -> None:
    """Within 1 %; the fibre's length comes from the course, not from the thickness."""
    (one,) = laid(tmp_path, f"{VESSEL}[[layer]]\n{layer}\n")
    spread = one.spread()
    assert spread is not None
    fibre = one.length_m * 0.006 * 0.25e-3
    assert spread.volume_m3(one.circuit.surface) == pytest.approx(fibre, rel=1e-3)
    assert spread.t.min() > 0.0
    middle = spread.at(np.array([0.342]))[0]
    assert middle == pytest.approx(one.thickness_m, rel=1e-9)
    # t / t_cyl = R cos(a_R) / (r cos(a_r)), well before the turn.
    u = np.array([0.5420228 + 0.05])
    r = float(one.circuit.surface.at(u)[1][0, 0])
    constant = one.circuit.constant_m
    if one.by == "friction" and abs(one.circuit.right.ratio) < 0.01:
        expected = 0.1 * math.cos(one.circuit.angle) / (r * math.sqrt(1.0 - (constant / r) ** 2))
        assert spread.at(u)[0] / middle == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("ratio", [0.15, -0.08])
def test_steering_on_a_cone_keeps_its_invariant(side: int, ratio: float) -> None:
    """Along a path of constant ratio l on a cone of slope b, (1 / sin a - l cot b) / r is kept.

    From da/ds = (l cos(b) sin(a)^2 - sin(b) sin(a)) / r and dr/ds = sin(b) cos(a).
    """
    surface = surface_of([line(0.0, 0.04, 0.3, 0.1)], 1e-3)
    begin, end = (0.05, 0.2) if side > 0 else (0.2, 0.05)
    at = float(surface.at(np.array([begin]))[1][0, 0])
    rows = traced(surface, (begin, at * math.sin(math.radians(20.0))), ratio, side, end)
    assert rows is not None and len(rows) > 50
    radius = surface.at(rows[:, 1])[1][:, 0]
    kept = (1.0 / np.sin(rows[:, 3]) - ratio * side / 0.2) / radius
    assert kept == pytest.approx(kept[0], rel=1e-9)


BAND = """
[band]
width = "6 mm"
thickness = "0.25 mm"
[friction]
value = "0.25"
"""


def cone_part(radius: float, end: float, length: float) -> str:
    return (
        f'[[part]]\nkind = "cone"\nradius = "{radius} mm"\nend_radius = "{end} mm"\n'
        f'length = "{length} mm"\n'
    )


def cylinder_part(radius: float, length: float) -> str:
    return f'[[part]]\nkind = "cylinder"\nradius = "{radius} mm"\nlength = "{length} mm"\n'


def covered(begin: float, end: float) -> str:
    return f'[coverage]\nbegin = "{begin} mm"\nend = "{end} mm"\n'


def test_a_cone_turns_by_clairaut_at_its_narrow_end(tmp_path: Path) -> None:
    """On the developed cone a geodesic is a straight line: closed forms of length and angle."""
    layer = '[[layer]]\nangle = "45 deg"\n'
    (one,) = laid(tmp_path, cone_part(40, 60, 300) + BAND + covered(100, 200) + layer)
    left, right = one.wrap.sites
    assert (left.dome, right.dome) == (True, False)
    base = one.wrap.base
    constant = 0.06 * math.sin(math.radians(45.0))
    assert base.left.radius_m == pytest.approx(constant, abs=1e-12)
    slope = math.atan(20.0 / 300.0)
    joint = float(base.surface.at(np.array([left.joint]))[1][0, 0])
    angle = math.acos(constant / joint)  # in the developed plane, from the turn
    assert base.left.round == pytest.approx(angle / math.sin(slope), rel=1e-9)
    way = math.sqrt(joint**2 - constant**2) / math.sin(slope)
    assert base.left.length_m == pytest.approx(way, rel=1e-9)
    course = one.circuit.course()
    assert np.abs(np.diff(course[:, 3])).max() < 0.02
    spread = one.spread()
    assert spread is not None
    fibre = one.length_m * 0.006 * 0.25e-3
    assert spread.volume_m3(one.circuit.surface) == pytest.approx(fibre, rel=0.01)


def test_a_cone_between_cylinders(tmp_path: Path) -> None:
    """It turns by friction on both cylinders, and the angle is continuous over the joints."""
    text = cylinder_part(40, 300) + cone_part(40, 60, 150) + cylinder_part(60, 300)
    layer = '[[layer]]\nangle = "35 deg"\n'
    (one,) = laid(tmp_path, text + BAND.replace('0.25"\n', '0.5"\n') + covered(200, 550) + layer)
    assert not one.wrap.domes
    rows = one.circuit.middle
    radius = one.circuit.surface.at(rows[:, 1])[1][:, 0]
    assert np.ptp(radius * np.sin(rows[:, 3])) < 1e-12
    assert math.degrees(rows[0, 3]) == pytest.approx(
        math.degrees(math.asin(1.5 * math.sin(math.radians(35.0)))), abs=1e-9
    )
    assert one.circuit.left.radius_m == pytest.approx(0.04, abs=1e-12)
    # The foot of the cone is a hollow corner, which is reported before winding.
    message = bridged(one)
    assert message is not None and "bridges the hollow of the mandrel at 299" in message


def test_a_nose_cone_says_the_build_up_at_its_tip(tmp_path: Path) -> None:
    nose = (
        '[[part]]\nkind = "nose"\nradius = "50 mm"\nheight = "150 mm"\nopening = "8 mm"\n'
        'pole = "left"\n'
    )
    text = nose + cylinder_part(50, 250) + BAND + covered(200, 280)
    (one,) = laid(tmp_path, text + '[[layer]]\nturn = "35 mm"\n')
    assert [site.dome for site in one.wrap.sites] == [True, False]
    assert one.wrap.base.left.radius_m == pytest.approx(0.035, abs=1e-12)
    assert bridged(one) is None
    assert one.most_m is not None and one.thickness_m is not None
    assert one.most_m > 2.0 * one.thickness_m


def test_the_second_layer_of_a_tube_has_its_angle_on_the_tube(tmp_path: Path) -> None:
    """The turns of the first layer stand higher; the wanted angle is not meant there."""
    layer = '[[layer]]\nangle = "55 deg"\n'
    first, second = laid(tmp_path, cylinder_part(50, 600) + BAND + covered(200, 400) + 2 * layer)
    assert first.most_m is not None and first.thickness_m is not None
    assert first.most_m > 3.0 * first.thickness_m
    base = second.wrap.base
    radius = 0.05 + first.thickness_m
    assert base.constant_m == pytest.approx(radius * math.sin(math.radians(55.0)), rel=1e-3)
    assert math.degrees(base.angle) == pytest.approx(55.0, abs=0.05)
    assert second.circuit.widest_m == pytest.approx(0.05 + first.thickness_m, abs=1e-4)
    assert second.pattern.coverage == pytest.approx(1.05, abs=0.06)
