"""Drawings as read, compared with hand-computed geometry and ezdxf's own flattening."""

from pathlib import Path

import ezdxf
import numpy as np
import pytest
from ezdxf.path import make_path
from scipy.interpolate import BSpline
from svgelements import Path as SvgPath

from threadline.geometry.arclength import arc_table
from threadline.geometry.contours import join_strokes
from threadline.geometry.read_csv import read_csv
from threadline.geometry.read_dxf import read_dxf
from threadline.geometry.strokes import Drawing
from threadline.geometry.svg import read_svg
from threadline.jobs.seam.read_toml import read_seam_file

GAP = 1e-5
SVG_HEAD = (
    '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
    'width="100mm" height="60mm" viewBox="0 0 100 60">'
)


def dxf(path: Path) -> Drawing:
    return read_dxf(path.read_bytes(), str(path))


def svg(body: str, head: str = SVG_HEAD) -> Drawing:
    return read_svg(f"{head}{body}</svg>".encode(), "test.svg")


def nearest(points: np.ndarray, drawing: Drawing) -> float:
    """Return the largest distance from ``points`` to the strokes, by dense sampling."""
    samples = []
    for stroke in drawing.strokes:
        n = len(stroke.pieces)
        u = np.tile(np.linspace(0, 1, 4001), n)
        samples.append(stroke.pieces.evaluate(np.repeat(np.arange(n), 4001), u)[0])
    cloud = np.concatenate(samples)
    return max(float(np.hypot(*(cloud - p).T).min()) for p in points)


def test_pocket_of_librecad(examples: Path) -> None:
    """Three sides of 80 mm and an arc through (60, -15): radius 44.5, as LibreCAD shows it."""
    drawing = dxf(examples / "pocket.dxf")
    pocket = [s for s in drawing.strokes if s.layer == "POCKET"]
    (contour,), warnings = join_strokes(pocket, GAP, "pocket.dxf")

    half = np.arcsin(40 / 44.5)
    assert contour.closed
    assert warnings == []
    assert arc_table(contour.pieces).length_m == pytest.approx(0.24 + 2 * half * 0.0445, abs=1e-9)
    assert {(s.layer, s.colour) for s in drawing.strokes} == {
        ("POCKET", "#ff0000"),
        ("MARKS", "#00ff00"),
    }
    text = (examples / "pocket.dxf").read_text().splitlines()
    assert [text[s.line].strip() for s in drawing.strokes] == [*["LINE"] * 3, "CIRCLE", "ARC"]


def test_collar_of_inkscape(examples: Path) -> None:
    """Lengths by svgelements' own (slow) integration, places by hand: Y up from the page's edge."""
    drawing = read_svg((examples / "collar.svg").read_bytes(), "collar.svg")
    by_colour = {s.colour: s for s in drawing.strokes}
    collar = by_colour["#d40000"]
    first, last = collar.pieces.ends()

    assert collar.layer == "Topstitch"
    assert by_colour["#008000"].layer == "Buttonholes"
    # translate(5, -2) of the layer; the page is 100 mm high.
    assert first[0] == pytest.approx([0.025, 0.022], abs=1e-12)
    assert last[-1] == pytest.approx([0.175, 0.022], abs=1e-12)
    d = "M 20,80 C 24,60 28,44 38,22 C 70,34 120,34 152,22 C 162,44 166,60 170,80"
    length = SvgPath(d).length(error=1e-9)
    assert arc_table(collar.pieces).length_m == pytest.approx(length * 1e-3, abs=1e-8)
    # A rounded rectangle keeps its length under rotation.
    label = arc_table(by_colour["#0044aa"].pieces).length_m
    assert label == pytest.approx(2 * (24 + 8) * 1e-3 + 2 * np.pi * 3e-3, abs=1e-10)
    # The layer Notes holds a text, which is no shape but remembered.
    assert [(r.layer, r.message) for r in drawing.refusals] == [("Notes", "text cannot be sewn")]
    lines = (examples / "collar.svg").read_text().splitlines()
    assert "<path" in lines[collar.line - 1]


def test_badge_with_spline_ellipse_and_scaled_blocks(examples: Path) -> None:
    """ezdxf's own paths of the exploded blocks lie on these, in inches, and so does scipy's spline.

    (ezdxf draws an unclamped spline from its first knot, where its basis is not complete.)
    """
    path = examples / "badge.dxf"
    drawing = dxf(path)
    document = ezdxf.readfile(path)
    points = []
    for entity in document.modelspace():
        parts = entity.virtual_entities() if entity.dxftype() == "INSERT" else [entity]
        for part in parts:
            if part.dxftype() == "SPLINE":
                knots, control = np.array(part.knots), np.array(part.control_points)[:, :2]
                curve = BSpline(knots, control, part.dxf.degree)
                points += list(curve(np.linspace(knots[3], knots[-4], 50)))
            elif part.dxftype() != "MTEXT":
                points += [p.vec2 for p in make_path(part).flattening(0.05)]

    assert len(points) > 60
    # ezdxf turns arcs into Bezier curves, accurate to about 3e-4 of the radius.
    assert nearest(np.array(points) * 0.0254, drawing) < 2e-5
    assert [s.layer for s in drawing.strokes] == ["SEAM", "PETALS", "PETALS", "PETALS", "SEAM"]
    assert all(s.line > 0 for s in drawing.strokes)
    assert [r.message for r in drawing.refusals] == [
        "the text 'flower badge\\n4 in' cannot be sewn"
    ]


def make_dxf(
    folder: Path, version: str = "R2000", units: int = 4
) -> tuple[Path, ezdxf.document.Drawing]:
    document = ezdxf.new(version)
    document.header["$INSUNITS"] = units
    return folder / "made.dxf", document


def test_every_entity_in_every_version(tmp_path: Path) -> None:
    """R12 has no light polylines and no splines; binary DXF is read like text."""
    lengths = {}
    for version in ("R12", "R2000", "R2018", "binary"):
        path, document = make_dxf(tmp_path, "R2010" if version == "binary" else version)
        space = document.modelspace()
        space.add_line((0, 0), (30, 40))
        space.add_circle((0, 100), 10)
        space.add_arc((50, 100), 10, 350, 80)
        points = [(100, 0, 1.0), (110, 0, 0.0), (110, 20, 0.0)]
        space.add_polyline2d(points, format="xyb", close=True)
        document.saveas(path, fmt="bin" if version == "binary" else "asc")
        drawing = read_dxf(path.read_bytes(), str(path), "mm" if version == "R12" else None)
        lengths[version] = [arc_table(s.pieces).length_m * 1e3 for s in drawing.strokes]

    expected = [50, 20 * np.pi, np.pi * 5, 5 * np.pi + 20 + np.hypot(10, 20)]
    for version, found in lengths.items():
        assert found == pytest.approx(expected, abs=1e-9), version


def test_mirrored_entities_lie_where_ezdxf_puts_them(tmp_path: Path) -> None:
    """AutoCAD's MIRROR gives entities the extrusion (0, 0, -1)."""
    path, document = make_dxf(tmp_path)
    space = document.modelspace()
    space.add_arc((10, 5), 4, 20, 130, dxfattribs={"extrusion": (0, 0, -1)})
    space.add_lwpolyline(
        [(0, 0, 0.6), (10, 0, -0.3), (10, 10, 0)], format="xyb", close=True,
        dxfattribs={"extrusion": (0, 0, -1)},
    )  # fmt: skip
    document.saveas(path)
    drawing = dxf(path)
    points = [
        p.vec2 for e in ezdxf.readfile(path).modelspace() for p in make_path(e).flattening(0.01)
    ]

    assert nearest(np.array(points) * 1e-3, drawing) < 5e-6


def test_nested_and_repeated_blocks(tmp_path: Path) -> None:
    """A block in a block, in rows and columns; layer 0 and BYBLOCK take the insert's."""
    path, document = make_dxf(tmp_path, units=5)
    inner = document.blocks.new("INNER")
    inner.add_circle((1, 0), 0.5, dxfattribs={"layer": "0", "color": 0})
    outer = document.blocks.new("OUTER", base_point=(1, 1))
    outer.add_blockref("INNER", (1, 1), dxfattribs={"rotation": 90, "layer": "0", "color": 0})
    document.layers.add("RED", color=1)
    document.modelspace().add_blockref(
        "OUTER", (10, 20), dxfattribs={
            "layer": "RED", "row_count": 2, "column_count": 3, "row_spacing": 5,
            "column_spacing": 4, "xscale": 2, "yscale": 2, "color": 5,
        },
    )  # fmt: skip
    document.saveas(path)
    strokes = dxf(path).strokes
    centres = sorted((np.round(s.pieces.top[0, 0] * 100, 9) + 0.0).tolist() for s in strokes)

    # The inner circle stands 1 cm above the outer base, twice that after scaling.
    expected = sorted([10.0 + 4 * c, 22.0 + 5 * r] for c in range(3) for r in range(2))
    assert centres == expected
    assert all(arc_table(s.pieces).length_m == pytest.approx(0.02 * np.pi) for s in strokes)
    assert {(s.layer, s.colour) for s in strokes} == {("RED", "#0000ff")}


def test_hidden_layers_are_left_out_with_a_word(tmp_path: Path) -> None:
    path, document = make_dxf(tmp_path)
    document.layers.add("OFF").off()
    document.layers.add("FROZEN").freeze()
    for layer in ("OFF", "FROZEN", "DEFPOINTS", "SEAM"):
        document.modelspace().add_line((0, 0), (1, 1), dxfattribs={"layer": layer})
    document.saveas(path)
    drawing = dxf(path)

    assert [s.layer for s in drawing.strokes] == ["SEAM"]
    assert len(drawing.warnings) == 3
    assert "'FROZEN' is hidden" in drawing.warnings[1]


def test_invisible_entities_are_left_out_with_a_word(tmp_path: Path) -> None:
    """Group code 60: a line, every entity of an invisible insert, and invisible attributes."""
    path, document = make_dxf(tmp_path)
    block = document.blocks.new("B")
    block.add_line((0, 0), (5, 0))
    block.add_line((0, 0), (6, 0), dxfattribs={"invisible": 1})
    space = document.modelspace()
    for index in range(3):
        space.add_line((index, 0), (index, 1), dxfattribs={"layer": "SEAM", "invisible": index % 2})
    space.add_line((8, 0), (8, 1), dxfattribs={"layer": "SEAM", "invisible": 1})
    space.add_text("no", dxfattribs={"invisible": 1})
    space.add_blockref("B", (10, 0), dxfattribs={"invisible": 1})
    shown = space.add_blockref("B", (10, 0))
    shown.add_attrib("SIZE", "7").is_invisible = True
    shown.add_attrib("MADE", "7", dxfattribs={"invisible": 1})
    document.saveas(path)
    assert path.read_text().count("\n 60\n1\n") == 6
    drawing = dxf(path)

    ends = [s.pieces.evaluate(np.array([0]), np.array([1.0]))[0][0] for s in drawing.strokes]
    assert np.round(1e3 * np.array(ends), 6).tolist() == [[0.0, 1.0], [2.0, 1.0], [15.0, 0.0]]
    assert drawing.refusals == ()
    assert len(drawing.warnings) == 2
    assert "a LINE on layer 'SEAM' is invisible" in drawing.warnings[0]
    assert "a TEXT on layer '0' is invisible" in drawing.warnings[1]


def test_rational_spline_is_a_circle(tmp_path: Path) -> None:
    path, document = make_dxf(tmp_path)
    w = np.sqrt(0.5)
    control = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0)]
    document.modelspace().add_rational_spline(
        [(20 * x, 20 * y, 0) for x, y in control],
        weights=[1, w, 1, w, 1, w, 1, w, 1],
        degree=2,
        knots=[0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4],
    )
    document.saveas(path)
    (stroke,) = dxf(path).strokes

    assert arc_table(stroke.pieces).length_m == pytest.approx(0.04 * np.pi, abs=1e-11)


def test_svg_transforms_units_and_viewbox() -> None:
    """A nest of transforms, by hand: matrix product applied to the corners."""
    drawing = svg(
        '<g transform="translate(10,5) rotate(30)"><g transform="scale(2,1) skewX(10)">'
        '<path d="M1,2 h3 v4" stroke="#123456"/></g></g>'
    )
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    matrix = (
        np.array([[1, 0, 10], [0, 1, 5], [0, 0, 1]])
        @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        @ np.diag([2.0, 1, 1])
        @ np.array([[1, np.tan(np.radians(10)), 0], [0, 1, 0], [0, 0, 1]])
    )
    (stroke,) = drawing.strokes
    begin, end = stroke.pieces.ends()
    found = np.vstack([begin, end[-1:]])
    expected = np.array([[1, 2, 1], [4, 2, 1], [4, 6, 1]]) @ matrix.T

    assert found[:, 0] * 1e3 == pytest.approx(expected[:, 0], abs=1e-9)
    assert 60 - found[:, 1] * 1e3 == pytest.approx(expected[:, 1], abs=1e-9)
    assert stroke.colour == "#123456"


@pytest.mark.parametrize(
    ("head", "millimetre"),
    [
        ('width="4in" height="2in" viewBox="0 0 400 200"', 0.254),
        ('width="72pt" height="72pt" viewBox="0 0 10 10"', 2.54),
        ('width="10cm" height="10cm" viewBox="-50 -50 100 100"', 1.0),
        ('width="96" height="96"', 25.4 / 96),
        ('viewBox="0 0 96 96"', 25.4 / 96),
    ],
)
def test_svg_page_sizes(head: str, millimetre: float) -> None:
    drawing = svg(
        '<line x1="10" y1="5" x2="40" y2="45" stroke="red"/>',
        f'<svg xmlns="http://www.w3.org/2000/svg" {head}>',
    )
    (stroke,) = drawing.strokes

    assert arc_table(stroke.pieces).length_m * 1e3 == pytest.approx(50 * millimetre, rel=1e-12)
    assert bool(drawing.warnings) == ("96" in head)


def test_svg_shapes_arcs_and_clones() -> None:
    """Every shape; an elliptic arc under a skew stays exact; a clone is its original moved."""
    drawing = svg(
        '<defs><circle id="c" r="3" stroke="blue" fill="none"/></defs>'
        '<use xlink:href="#c" x="20" y="30"/>'
        '<g id="cutting"><polygon points="0,0 4,0 4,3" stroke="blue"/>'
        '<path d="M0 0 A 5 5 0 0 1 10 0 Z M20 0 q 1 2 3 0" stroke="blue"/></g>'
        '<clipPath id="k"><rect width="5" height="5"/></clipPath>'
        '<marker id="m"><path d="M0 0 L 9 9" stroke="blue"/></marker>'
        '<path d="M1 1 L 2 2" stroke="blue" visibility="hidden"/>'
        '<path d="M1 1 L 2 2" stroke="blue" style="display:none"/>'
    )
    lengths = [arc_table(s.pieces).length_m * 1e3 for s in drawing.strokes]

    quadratic = SvgPath("M0 0 q 1 2 3 0").length(error=1e-9)
    assert lengths == pytest.approx([6 * np.pi, 12, 5 * np.pi + 10, quadratic], abs=1e-8)
    assert drawing.strokes[0].pieces.top[0, 0] == pytest.approx([0.02, 0.03], abs=1e-12)
    assert [s.layer for s in drawing.strokes] == ["", "cutting", "cutting", "cutting"]


def test_svg_style_sheet_colours_and_fills() -> None:
    drawing = svg(
        "<style>.seam{stroke:#00ff00;fill:none} #k{stroke:red}</style>"
        '<path class="seam" d="M0 0H9"/><path id="k" d="M0 1H9"/>'
        '<path d="M0 2H9" fill="#111111"/><path d="M0 3H9" fill="none"/>'
    )

    assert [s.colour for s in drawing.strokes] == ["#00ff00", "#ff0000", "none"]
    assert "without a stroke" in drawing.warnings[0]
    assert "neither stroke nor fill" in drawing.warnings[1]


def test_csv_in_all_its_spellings() -> None:
    spellings = {
        "comma": "x [mm], y [mm], bulge\n0,0,0\n80,0,1\n80,25.5,0\n0,25.5,0\n",
        "semicolon": "# strap\nX (cm);Y (cm);bulge\n0;0;\n8;0;1\n8;2,55;\n0;2,55;\n",
        "tab": "\ufeffx [m]\ty [m]\tcx [m]\tcy [m]\tturn\r\n0\t0\t\t\t\r\n"
        "0.08\t0\t0.08\t0.01275\tccw\r\n0.08\t0.0255\t\t\t\r\n0\t0.0255\t\t\t\r\n",
    }
    for name, text in spellings.items():
        (stroke,) = read_csv(text.encode(), "strap.csv").strokes
        length = arc_table(stroke.pieces).length_m
        assert length == pytest.approx(0.16 + np.pi * 0.01275, abs=1e-12), name
        assert stroke.pieces.line.tolist() == [3, 4, 5] if name == "semicolon" else [2, 3, 4]


def test_the_unit_of_a_column_goes_before_that_of_the_table():
    """An inch is 25.4 mm; a column without a unit has the given one."""
    content = b"x [in],y\n0,0\n2,3\n"
    (stroke,) = read_csv(content, "t.csv", "mm").strokes
    point, *_ = stroke.pieces.evaluate(np.array([0]), np.array([1.0]))
    assert np.ravel(point) == pytest.approx([2 * 25.4e-3, 3e-3], rel=1e-12)


def test_csv_blank_rows_part_contours_and_layers() -> None:
    text = "x [in],y [in],layer\n0,0,a\n1,0,a\n\n\n0,1,b\n1,1,b\n2,1,b\n"
    strokes = read_csv(text.encode(), "t.csv").strokes

    assert [(s.layer, len(s.pieces), s.line) for s in strokes] == [("a", 1, 2), ("b", 2, 6)]
    assert strokes[1].pieces.ends()[1][-1] == pytest.approx([0.0508, 0.0254])


def test_toml_arcs_by_bulge_centre_and_radius_are_one() -> None:
    """A quarter of a circle of 10 mm, given in three ways, in both directions."""
    for sign, turn in ((1, "ccw"), (-1, "cw")):
        bulge = sign * np.tan(np.pi / 8)
        centre = [0, 10] if sign > 0 else [10, 0]
        for arc in (
            f"bulge = {bulge}",
            f'centre = {centre}, turn = "{turn}"',
            f'radius = 10, turn = "{turn}"',
        ):
            text = f'[[contour]]\nunit = "mm"\npoints = [[0, 0], {{to = [10, 10], {arc}}}]\n'
            drawing = read_seam_file(text.encode(), "t.seam.toml").drawing
            assert isinstance(drawing, Drawing)
            table = arc_table(drawing.strokes[0].pieces)
            assert table.length_m == pytest.approx(np.pi * 0.005, abs=1e-12), arc
            middle = np.array([np.sqrt(0.5), 1 - np.sqrt(0.5)]) * 0.01
            middle = middle if sign > 0 else middle[::-1]
            assert table.points(np.array([table.length_m / 2]))[0] == pytest.approx(
                middle, abs=1e-12
            )


def test_toml_large_arc_and_full_circle() -> None:
    text = (
        '[[contour]]\nunit = "mm"\nclosed = true\n'
        'points = [[0, 0], {to = [10, 10], radius = 10, turn = "ccw", large = true}]\n'
        '[[contour]]\nunit = "mm"\npoints = [[5, 0], {to = [5, 0], centre = [0, 0], turn = "cw"}]\n'
    )
    drawing = read_seam_file(text.encode(), "t.seam.toml").drawing
    assert isinstance(drawing, Drawing)
    large, full = (arc_table(s.pieces).length_m for s in drawing.strokes)

    assert large == pytest.approx(0.015 * np.pi + np.sqrt(2) * 0.01, abs=1e-12)
    assert full == pytest.approx(0.01 * np.pi, abs=1e-12)
    assert [s.line for s in drawing.strokes] == [4, 7]


def test_entity_that_ezdxf_drops_gives_a_warning(
    examples: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """An end without a begin among the blocks: ezdxf drops it and only logs it."""
    lines = (examples / "pocket.dxf").read_text().splitlines()
    at = lines.index("BLOCKS") + 1
    file = tmp_path / "a.dxf"
    file.write_text("\n".join([*lines[:at], "  0", "ENDBLK", "  8", "0", *lines[at:]]) + "\n")
    drawing = read_dxf(file.read_bytes(), str(file))
    assert [w for w in drawing.warnings if "ENDBLK" in w and w.startswith("a.dxf: ")]
    assert capfd.readouterr().err == ""
