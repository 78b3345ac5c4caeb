"""Product files: shapes, compared with closed forms, and one line for each fault."""

from __future__ import annotations

import json
import math
import random
from pathlib import Path

import ezdxf
import ezdxf.units
import numpy as np
import pytest
from scipy.integrate import quad

from threadline.errors import JobError
from threadline.winding.product import Product, product_of_text, product_text

BAND = '[band]\nwidth = "5 mm +- 0.3 mm"\n[friction]\nvalue = "0.25 +- 0.05"\n'
CYLINDER = '[[part]]\nkind = "cylinder"\nradius = "50 mm"\nlength = "200 mm"\n'


def _read(folder: Path, text: str) -> Product:
    file = folder / "p.wind.toml"
    file.write_text(text)
    return product_of_text(product_text(file))


def _refused(folder: Path, text: str) -> str:
    with pytest.raises(JobError) as caught:
        _read(folder, text)
    message = str(caught.value)
    assert "\n" not in message.strip()
    return message


def test_numbers_and_tolerances(tmp_path: Path) -> None:
    product = _read(tmp_path, CYLINDER + BAND)
    assert (product.width.si, product.width.tolerance) == pytest.approx((5e-3, 3e-4))
    assert (product.friction.si, product.friction.tolerance) == (0.25, 0.05)
    assert product.surface.length_m == pytest.approx(0.2)
    assert product_text(product.text) == product.text


def test_an_isotensoid_has_the_slope_of_netting_theory(tmp_path: Path) -> None:
    part = '[[part]]\nkind = "isotensoid"\nradius = "50 mm"\nopening = "15 mm"\npole = "right"\n'
    surface = _read(tmp_path, part + BAND).surface
    big, hole = 0.05, 0.015

    def slope(r: float) -> float:
        sin = (r / big) ** 3 * math.sqrt((big**2 - hole**2) / (r**2 - hole**2))
        return sin / math.sqrt(1.0 - sin**2)

    for r in (0.045, 0.03, 0.02):
        depth = quad(slope, r, big, limit=200, epsabs=1e-12)[0]
        u = float(surface.place_of(np.array([depth]))[0])
        x, radius = surface.at(np.array([u]))
        assert radius[0, 0] == pytest.approx(r, abs=1e-8)
        assert -x[0, 1] / radius[0, 1] == pytest.approx(slope(r), rel=1e-4)


DOME = (
    '[[part]]\nkind = "nose"\nradius = "50 mm"\nopening = "8 mm"\nheight = "9 mm"\npole = "left"\n'
)


@pytest.mark.parametrize("kind", ["hemisphere", "ellipsoid", "nose"])
def test_domes_lie_on_their_curves(tmp_path: Path, kind: str) -> None:
    height = "" if kind == "hemisphere" else 'height = "120 mm"\n'
    part = f'[[part]]\nkind = "{kind}"\nradius = "50 mm"\n{height}opening = "8 mm"\npole = "left"\n'
    surface = _read(tmp_path, part + CYLINDER + BAND).surface
    u = np.linspace(0.0, float(surface.nodes[-2]), 500)
    x, r = (values[:, 0] for values in surface.at(u))
    tall = 0.05 if kind == "hemisphere" else 0.12
    base = surface.at(np.array([surface.length_m]))[0][0, 0] - 0.2
    depth = (base - x)[:-1]
    if kind == "nose":
        p = np.arccos(1.0 - 2.0 * (tall - depth) / tall)
        expected = 0.05 * np.sqrt((p - 0.5 * np.sin(2.0 * p)) / np.pi)
    else:
        expected = 0.05 * np.sqrt(1.0 - (depth / tall) ** 2)
    np.testing.assert_allclose(r[:-1], expected, atol=2e-8)


def test_a_table_of_a_sphere_has_its_curvature(tmp_path: Path) -> None:
    angles = np.radians(np.linspace(-60.0, 60.0, 121))
    rows = [f"{50 * math.sin(a):.9f},{50 * math.cos(a):.9f}" for a in angles]
    (tmp_path / "m.csv").write_text("x_mm,radius_mm\n" + "\n".join(rows) + "\n")
    surface = _read(tmp_path, '[[part]]\nfile = "m.csv"\n' + BAND).surface
    x, r = surface.at(np.linspace(0.01, surface.length_m - 0.01, 300))
    bend = -(x[:, 1] * r[:, 2] - r[:, 1] * x[:, 2])
    np.testing.assert_allclose(bend, 20.0, rtol=2e-3)


def test_a_corner_of_a_table_is_rounded(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("x_mm,radius_mm\n0,40\n50,40\n100,20\n")
    surface = _read(tmp_path, '[[part]]\nfile = "m.csv"\n' + BAND).surface
    x, r = surface.at(np.linspace(0.0, surface.length_m, 2001))
    near = np.abs(x[:, 0] - 0.05) < 1e-3
    # An edge of 1 mm takes R (1 / cos(turn / 2) - 1) off the corner.
    turn = math.atan2(20, 50)
    assert 0.04 - r[near, 0][np.argmin(np.abs(x[near, 0] - 0.05))] == pytest.approx(
        1e-3 * (1 / math.cos(turn / 2) - 1), rel=0.3
    )
    assert surface.convex


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("0,40\n10,-1\n", "m.csv:3: the mandrel crosses its axis"),
        ("0,40\n10,41\n5,42\n", "m.csv:4: the mandrel doubles back"),
        ("0,40\n10,x\n", "m.csv:3: '10,x' is no point"),
        ("0,40\n10\n", "m.csv:3: '10' is no point"),
        ("0,40\n10,nan\n", "is no point"),
        ("0,40\n", "the number of points is 1, and a meridian needs 2 to"),
        ("0,40\n1e300,40\n", "m.csv:3: '1e300,40' is no point"),
    ],
)
def test_faults_of_a_table_name_its_line(tmp_path: Path, rows: str, message: str) -> None:
    (tmp_path / "m.csv").write_text("x_mm,radius_mm\n" + rows)
    assert message in _refused(tmp_path, '[[part]]\nfile = "m.csv"\n' + BAND)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CYLINDER + BAND.replace("0.25 +- 0.05", "0"), "p.wind.toml:8: a friction of 0"),
        (CYLINDER + BAND.replace("0.25 +- 0.05", "2"), "p.wind.toml:8: a friction of 2"),
        (CYLINDER + BAND.replace("5 mm +- 0.3 mm", "120 mm"), "p.wind.toml:6: the band is 120 mm"),
        (CYLINDER + BAND.replace("5 mm +- 0.3 mm", "5"), "p.wind.toml:6: width"),
        (CYLINDER.replace("50 mm", "-1 mm") + BAND, "p.wind.toml:3: radius = -1 mm"),
        (CYLINDER.replace("200 mm", "1e-20 mm") + BAND, ":4: length = 1e-20 mm, the least is 0.0"),
        (DOME.replace("8 mm", "1e-20 mm") + CYLINDER + BAND, ":4: opening = 1e-20 mm: the mandrel"),
        (CYLINDER.replace("cylinder", "cylindre") + BAND, "Did you mean 'cylinder'?"),
        (CYLINDER + CYLINDER.replace("50", "40") + BAND, "p.wind.toml:7: the mandrel is open"),
        (BAND, "the mandrel has no [[part]]"),
        (CYLINDER, "band.width is missing"),
        (CYLINDER + BAND + '[fibre]\ntied = "300 mm"\n', "p.wind.toml:10: tied = 300 mm"),
        (CYLINDER + BAND + 'colour = "red"\n', "unknown key 'colour'"),
        (CYLINDER + BAND + "[", "not valid TOML"),
        ('[[part]]\nfile = "x.dxf"\n' + BAND, "x.dxf"),
        ('[[part]]\nfile = "x.csv"\nlayer = "A"\n' + BAND, "p.wind.toml:3: layer belongs to a"),
        (CYLINDER + BAND + '[[boss]]\nat = "0 mm"\nlength = "1 mm"\n', "boss.radius is missing"),
        (
            CYLINDER + BAND + '[[pin]]\nat = "0 mm"\ndiameter = "-1 mm"\nradius = "9 mm"\n',
            "p.wind.toml:11: diameter must be above 0",
        ),
        ("[mandrel]\nshaft = '60 mm'\n" + CYLINDER + BAND, "p.wind.toml:2: a shaft with radius 60"),
        ("[mandrel]\nslip = '100 deg'\n" + CYLINDER + BAND, "p.wind.toml:2: slip is above 90 deg"),
        (CYLINDER + BAND + '[fibre]\ntake_up = "-1 mm"\n', "p.wind.toml:10: take_up = '-1 mm' is"),
        (
            CYLINDER + BAND + '[coverage]\nbegin = "9 mm"\nend = "20 mm"\ngap = "-1 mm"\n',
            "p.wind.toml:12: gap = '-1 mm' is below 0",
        ),
        (
            '[mandrel]\nradius_error = "0 mm +- 90 mm"\n' + CYLINDER + BAND,
            "p.wind.toml:2: a radius_error of 0 +- 90 mm",
        ),
    ],
)
def test_faults_name_their_line(tmp_path: Path, text: str, message: str) -> None:
    assert message in _refused(tmp_path, text)


def _drawn(folder: Path, *, faces: bool = True) -> Path:
    """Draw a dome of 50 mm on a cylinder as an arc, a line and a face, from right to left."""
    document = ezdxf.new("R2010", units=ezdxf.units.MM)
    space = document.modelspace()
    end = math.degrees(math.acos(0.2))
    space.add_arc((0.0, 0.0), 50.0, 90.0, 90.0 + end, dxfattribs={"layer": "MERIDIAN"})
    space.add_line((80.0, 50.0), (0.0, 50.0), dxfattribs={"layer": "MERIDIAN"})
    space.add_line((-60.0, 0.0), (90.0, 0.0), dxfattribs={"layer": "MERIDIAN"})
    if faces:
        space.add_line((80.0, 50.0), (80.0, 0.0), dxfattribs={"layer": "MERIDIAN"})
    space.add_circle((0.0, -200.0), 10.0, dxfattribs={"layer": "NOTES"})
    file = folder / "m.dxf"
    document.saveas(file)
    return file


DRAWN = '[[part]]\nfile = "m.dxf"\nlayer = "MERIDIAN"\n'


def test_a_half_section_in_dxf_is_its_arc_and_line(tmp_path: Path) -> None:
    """An arc stays an arc: a hemisphere has the radii of a circle, and its curvature."""
    _drawn(tmp_path)
    product = _read(tmp_path, DRAWN + BAND)
    surface = product.surface
    x, r = surface.at(np.linspace(0.0, surface.length_m, 501))
    centre = 0.05 * math.sqrt(1.0 - 0.2**2)  # from the dome, beginning at the left end
    dome = x[:, 0] < centre
    expected = np.sqrt(0.05**2 - np.where(dome, x[:, 0] - centre, 0.0) ** 2)
    np.testing.assert_allclose(r[:, 0], expected, atol=1e-9)
    bend = -(x[:, 1] * r[:, 2] - r[:, 1] * x[:, 2])
    np.testing.assert_allclose(bend[x[:, 0] < centre - 1e-3], 20.0, rtol=1e-4)
    assert surface.at(np.array([surface.length_m]))[0][0, 0] == pytest.approx(centre + 0.08)
    # A recording keeps the section without its file.
    (tmp_path / "m.dxf").unlink()
    again = product_of_text(product.text).surface
    np.testing.assert_array_equal(again.x, surface.x)
    damaged = product.text.replace('"section": [[[0.0,', '"section": [[["a",')
    with pytest.raises(JobError, match="damaged"):
        product_of_text(damaged)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (((-60.0, 10.0), (-49.0, 10.0)), "the mandrel is open or has two lines: one ends at x"),
        (((80.0, 50.0), (90.0, -5.0)), "the mandrel crosses its axis: y = -5 mm"),
        (((80.0, 50.0), (80.0, 60.0)), "the mandrel doubles back at x = 80 mm"),
    ],
)
def test_faults_of_a_drawing_name_its_line(
    tmp_path: Path, line: tuple[tuple[float, float], tuple[float, float]], text: str
) -> None:
    document = ezdxf.readfile(_drawn(tmp_path, faces=False))
    document.modelspace().add_line(*line, dxfattribs={"layer": "MERIDIAN"})
    document.saveas(tmp_path / "m.dxf")
    message = _refused(tmp_path, DRAWN + BAND)
    assert text in message
    assert "m.dxf:" in message
    assert "no meridian on the layer 'X'" in _refused(tmp_path, DRAWN.replace("MERIDIAN", "X"))


def test_the_whole_drawing_without_a_layer_says_what_crosses(tmp_path: Path) -> None:
    _drawn(tmp_path)
    assert "the mandrel crosses its axis" in _refused(tmp_path, '[[part]]\nfile = "m.dxf"\n' + BAND)


def test_bosses_pins_and_shaft_are_placed(tmp_path: Path) -> None:
    text = (
        '[mandrel]\nshaft = "8 mm"\nslip = "0 deg +- 3.6 deg"\n' + CYLINDER + BAND
        + '[[boss]]\nat = "-10 mm"\nlength = "12 mm"\nradius = "30 mm"\n'
        + '[[pin]]\nat = "180 mm"\nradius = "57 mm"\ndiameter = "3 mm"\n'
    )  # fmt: skip
    product = _read(tmp_path, text)
    found = [(ring.begin_m, ring.end_m, ring.radius_m) for ring in product.rings]
    assert found[0][1:] == (0.0, 0.008) and found[1][::2] == (pytest.approx(0.2), 0.008)
    assert found[2] == pytest.approx((-0.01, 0.002, 0.03))
    assert found[3] == pytest.approx((0.1785, 0.1815, 0.057))
    assert (product.slip.si, product.slip.tolerance) == (0.0, pytest.approx(0.01))


def test_damaged_files_are_refused_in_one_line(tmp_path: Path) -> None:
    """2000 files with a damaged byte or a missing line are read or refused in one line."""
    text = (
        '[[part]]\nkind = "nose"\nradius = "50 mm"\nheight = "90 mm"\nopening = "5 mm"\n'
        'pole = "left"\n' + CYLINDER + BAND + '[coverage]\nbegin = "95 mm"\nend = "200 mm"\n'
    )
    _read(tmp_path, text)
    chance = random.Random(1)
    refused = 0
    for _ in range(2000):
        letters = list(text)
        for _ in range(chance.randint(1, 3)):
            at = chance.randrange(len(letters))
            letters[at] = chance.choice('0123456789.-"[]=\n e\x00é')
        try:
            _read(tmp_path, "".join(letters))
        except JobError as error:
            refused += 1
            assert "\n" not in str(error).strip()
    assert refused > 500


WIND = {
    "schemaVersion": "1.1",
    "mandrelParameters": {"diameter": 98.0, "windLength": 120, "endDiameter": 54.0},
    "towParameters": {"width": 6, "thickness": 0.5},
    "layers": [{"windType": "helical", "windAngle": 30.0}],
    "later": {"unknown": 1},
}
"""A definition as FiberPath's specification describes it; unknown members are ignored."""
FIB = """    16
 MADE.MND
    24
     3
    1  -120.0000      .0000    30.0000   .0000000  1.0000000   .0000000
    2  -110.0000    24.0000    32.0000   .2672612   .8017837  -.5345225
   24     9.0000      .0000   -50.0000   .6000000   .1568926  -.7844629
"""
PAY = """    22 0 1 1 1 1 1
 MADE.MND
    42    24   .120000E+02   .250000E+01   .160072E+02
     2
  -120.000      .000    30.000  .0000000 1.0000000  .0000000  .0000000  .0000000 -1.000000
  -119.000    60.000    31.000    61.000
    10.000    50.000      .000  .6577299  .0983193 -.7468095  .0000000  .0000000  .0000000
    60.000    70.000   -30.000    65.000
"""
"""Paths as CADFIL's help describes them: points on the mandrel, and the width of the band."""
MND = """XRDATA   (CADFIL AXISYMMETRIC)
     0          (SYMMETRY FLAG)
     6          (NO. OF MANDREL DATA POINTS)
   -140.0000        0.000000         0    0.000000
   -135.0000        20.00000         0    0.000000
   -120.0000        40.00000         0    0.000000
   -100.0000        50.00000        17    0.000000
    60.00000        50.00000         0    0.000000
    80.00000        42.00000         0    0.000000
     2          (NO. OF ENVELOPE DATA POINTS)
   -150.0000        70.00000         0    0.000000
    150.0000        70.00000         0    0.000000
"""
"""A mandrel file: places, radii, extra points up to the next point, radii of arcs."""


def _foreign(folder: Path, name: str, text: str) -> Product:
    (folder / name).write_text(text)
    return product_of_text(product_text(folder / name))


def test_a_definition_of_fiberpath_is_a_product(tmp_path: Path) -> None:
    """A cone from 98 to 54 mm over 120 mm, and two bands longer at both ends."""
    found = _foreign(tmp_path, "cone.wind", json.dumps(WIND))
    x, r = (values[:, 0] for values in found.surface.at(np.array([0.0, found.surface.length_m])))
    slope = (27.0 - 49.0) / 120.0
    assert found.at.si == pytest.approx(-0.012)
    np.testing.assert_allclose(x, [0.0, 0.144], atol=1e-12)
    np.testing.assert_allclose(r, [0.049 - 0.012 * slope, 0.027 + 0.012 * slope], atol=1e-12)
    assert (found.width.si, found.thickness) == (pytest.approx(0.006), pytest.approx(0.0005))
    assert found.covered == (pytest.approx(0.012), pytest.approx(0.132))
    # No planner writes a friction: the name tells the assumed one.
    assert found.friction.si == 0.2 and "friction 0.2 assumed" in found.name


def test_a_nose_of_fiberpath_begins_at_its_base(tmp_path: Path) -> None:
    """Von Karman's: r = R sqrt((p - sin(2 p) / 2) / pi) at h (1 - cos p) / 2 from the tip."""
    mandrel = {"diameter": 98.0, "windLength": 200.0, "profile": {"type": "vonKarman"}}
    found = _foreign(tmp_path, "nose.wind", json.dumps(WIND | {"mandrelParameters": mandrel}))
    at = found.surface.place_of(np.array([0.012 + 0.1]))
    assert found.surface.at(at)[1][0, 0] == pytest.approx(0.049 * math.sqrt(0.5), abs=1e-6)
    assert found.surface.at(np.zeros(1))[1][0, 0] == pytest.approx(0.049)


def test_paths_of_cadfil_show_their_mandrel(tmp_path: Path) -> None:
    found = _foreign(tmp_path, "MADE.PAY", PAY)
    assert found.at.si == pytest.approx(-0.12)
    assert found.width.si == pytest.approx(0.0025)
    ends = np.array([0.0, found.surface.length_m])
    np.testing.assert_allclose(found.surface.at(ends)[1][:, 0], [0.03, 0.05], atol=1e-9)
    fibre = _foreign(tmp_path, "MADE.FIB", FIB)
    middle = fibre.surface.place_of(np.array([0.01]))
    # The corner at this point is rounded by 1 mm.
    assert fibre.surface.at(middle)[1][0, 0] == pytest.approx(0.04, abs=1e-4)
    assert fibre.width == found.width  # a point of the payout path beside it
    listed = _foreign(tmp_path, "all.ctl", "made.pay 2\nC:\\WIND\\MADE.PAY, 1\n")
    assert listed.surface.length_m == found.surface.length_m
    drawn = f'[[part]]\nfile = "MADE.FIB"\n{BAND}'
    assert _read(tmp_path, drawn).surface.length_m == fibre.surface.length_m


def test_settings_and_notes_of_cadfil_9_are_passed_over(tmp_path: Path) -> None:
    """Its files have lines that the help does not describe, and the number of points elsewhere."""
    older = _foreign(tmp_path, "MADE.PAY", PAY)
    lines = PAY.splitlines()
    noted = [*lines[:3], "$MVL-R1=50.000", "$FIBER-TEX=800.000", lines[3], "ANR08", *lines[4:]]
    found = _foreign(tmp_path, "NINE.PAY", "\n".join(noted) + "\n")
    np.testing.assert_array_equal(found.surface.r, older.surface.r)
    assert found.width == older.width
    fibre = _foreign(tmp_path, "MADE.FIB", FIB)
    (tmp_path / "NINE.FIB").write_text(FIB.replace("    24\n     3\n", " 24 3\n"))
    newer = product_of_text(product_text(tmp_path / "NINE.FIB"))
    np.testing.assert_array_equal(newer.surface.r, fibre.surface.r)
    # A message still names the line of the file.
    broken = "\n".join(noted).replace("10.000", "10.0x0")
    with pytest.raises(JobError, match=r"BAD\.PAY:10: '10\.0x0"):
        _foreign(tmp_path, "BAD.PAY", broken)


def test_the_mandrel_file_that_a_path_names_is_the_mandrel(tmp_path: Path) -> None:
    """Its divided line is straight, and the point on the axis is left out."""
    (tmp_path / "made.mnd").write_text(MND)
    (tmp_path / "other.pay").write_text(PAY.replace("50.000 ", "49.790 "))
    (tmp_path / "other.fib").write_text(FIB)
    control = " SPCTL2\n2\n1\nmade.pay\n1000.000000\n2\n\n\n1\nother.pay\n5000.0\n1\n\n\n"
    for name, text in (("MADE.PAY", PAY), ("all.ctl", control), ("other.fib", FIB)):
        found = _foreign(tmp_path, name, text)
        places = 1e3 * np.array([-135.0, -100.0 + 1e-3, -20.0, 60.0 - 1e-3, 80.0]) - -135e3
        at = found.surface.place_of(1e-6 * places)
        radii = found.surface.at(at)[1][:, 0]
        np.testing.assert_allclose(radii, 1e-3 * np.array([20.0, 50, 50, 50, 42]), atol=5e-5)
        assert radii[2] == pytest.approx(0.05, abs=1e-12)
        assert (found.at.si, found.width.si) == (pytest.approx(-0.135), pytest.approx(0.0025))
    drawn = _read(tmp_path, f'[[part]]\nfile = "made.mnd"\n{BAND}')
    assert drawn.surface.least_radius_m == pytest.approx(0.02)


def test_points_on_chords_below_the_mandrel_are_left_out_where_a_finer_path_lies(
    tmp_path: Path,
) -> None:
    """CADFIL's joining paths have points 0.2 mm below a cylinder on which other paths lie."""

    def path(places: list[float], radii: list[float]) -> str:
        rows = [
            f" {x:.4f} 0.0 {r:.4f} 0 1 0 0 0 1\n {x:.4f} 60 31 61 0"
            for x, r in zip(places, radii, strict=True)
        ]
        head = f"46 0 0 1 1 1 1\n MADE.MND\n 1 60 19.26 4.0 7.9\n {len(places)}\n"
        return head + "\n".join(rows) + "\n"

    cylinder = np.arange(0.0, 100.5, 0.5).tolist()
    (tmp_path / "wound.pay").write_text(path(cylinder, [50.0] * len(cylinder)))
    joins = path([-20.0, -10.0, 10.1, 50.1, 90.1], [30.0, 42.0, 49.8, 49.8, 49.8])
    (tmp_path / "joins.pay").write_text(joins)
    text = "SPCTL\n2\n1\nwound.pay\n1000.0\n2\n1\njoins.pay\n1000.0\n2\n"
    surface = _foreign(tmp_path, "all.ctl", text).surface
    at = surface.place_of(1e-3 * np.array([0.0, 30.1, 70.1, 110.1]))
    np.testing.assert_allclose(surface.at(at)[1][:, 0], [0.03, 0.05, 0.05, 0.05], atol=1e-5)


@pytest.mark.parametrize(
    ("text", "expected_text"),
    [
        (MND[8:], "a.mnd:1: a mandrel file of CADFIL that turns about an axis begins with XRDATA"),
        (MND[:40], "it ends within its head"),
        (MND.replace("     0          (SYM", "     1          (SYM"), "its symmetry flag is 1"),
        (MND.replace("     6 ", "    60 "), "a.mnd:3: it states 60 points and has 9"),
        (MND.replace("17    0.000000", "17    12.00000"), "a.mnd:7: an arc of 12 mm follows"),
        (MND.replace("60.00000        50", "-120.000        50"), "a.mnd:8: the mandrel doubles"),
        (MND.replace("     6 ", "     2 "), "fewer than two points off its axis"),
        (MND.replace("-120.0000", "-12x.0000"), "a.mnd:6: '-12x.0000"),
    ],
)
def test_unknown_line_of_a_mandrel_file_is_refused_with_the_reason(
    tmp_path: Path, text: str, expected_text: str
) -> None:
    (tmp_path / "a.mnd").write_text(text)
    message = _refused(tmp_path, f'[[part]]\nfile = "a.mnd"\n{BAND}')
    assert expected_text in message and "\n" not in message


@pytest.mark.parametrize(
    ("name", "text", "expected_text"),
    [
        ("a.wind", "{\n\n", "a.wind:3: it is no JSON"),
        ("a.wind", "[]", "mandrelParameters is missing"),
        ("a.wind", json.dumps(WIND | {"schemaVersion": "2.0"}), "versions 1.x are read"),
        ("a.wind", json.dumps(WIND).replace("98.0", "-98.0"), "diameter is -98.0"),
        ("a.wind", json.dumps(WIND).replace("98.0", "true"), "diameter is True"),
        ("a.wind", json.dumps(WIND).replace('"endDiameter"', '"profile"'), "the profile '54.0'"),
        ("a.fib", FIB, "a .FIB has no width of the band. Put a.PAY beside it"),
        ("a.pay", PAY.replace("     2\n", "     9\n"), "a.pay:4: it states 9 points and has 2"),
        ("a.pay", PAY.replace("10.000", "10.0x0"), "a.pay:7: '10.0x0"),
        ("a.pay", PAY[:40], "it ends within its head"),
        ("a.ctl", "nothing here", "names no payout file"),
        ("a.ctl", "1\nlost.pay 2", "a.ctl:2: the payout file 'lost.pay' is not beside"),
    ],
)
def test_unknown_entry_of_another_planners_file_is_refused_with_the_reason(
    tmp_path: Path, name: str, text: str, expected_text: str
) -> None:
    with pytest.raises(JobError) as error:
        _foreign(tmp_path, name, text)
    message = str(error.value)
    assert expected_text in message and "\n" not in message
