"""Styles, transforms, clipping and sizes of SVG: applied as in CSS 2.1 and SVG 1.1, or refused."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.errors import JobError
from threadline.geometry.arclength import arc_table
from threadline.geometry.strokes import Drawing
from threadline.geometry.svg import read_svg

HEAD = '<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="60mm" viewBox="0 0 100 60">'
SHOWN = '<path id="a" class="k other" stroke="red" d="M10 10H20"/>'


def svg(body: str, head: str = HEAD) -> Drawing:
    return read_svg(f"{head}\n{body}</svg>".encode(), "t.svg")


def first_mm(drawing: Drawing) -> list[float]:
    x, y = drawing.strokes[0].pieces.ends()[0][0] * 1e3
    return [x, 60 - y]


@pytest.mark.parametrize(
    "body",
    [
        '<path style="display:none !important" stroke="red" d="M0 0H9"/>',
        '<path style="DISPLAY : None" stroke="red" d="M0 0H9"/>',
        '<g style="display:none!important"><path stroke="red" d="M0 0H9"/></g>',
        '<style>path{display:none !important}</style><path style="display:inline" d="M0 0H9"/>',
        "<style>.k{display:none} path{display:inline}</style>" + SHOWN,
        "<style>#a{display:none} .k.other{display:inline}</style>" + SHOWN,
        "<style>path{display:inline} path{display:none}</style>" + SHOWN,
        "<style>g > .k, nothing{visibility:hidden}</style><g>" + SHOWN + "</g>",
        "<style>svg g path{visibility:collapse}</style><g><g>" + SHOWN + "</g></g>",
        '<g visibility="hidden"><path stroke="red" d="M0 0H9" visibility="inherit"/></g>',
        "<style>/* path{} */ <![CDATA[ .k { display : none ; } ]]></style>" + SHOWN,
    ],
)
def test_shape_hidden_by_its_style_is_not_sewn(body: str) -> None:
    assert svg(body).strokes == ()


@pytest.mark.parametrize(
    "body",
    [
        '<style>path{display:none}</style><path style="display:inline" stroke="red" d="M0 0H9"/>',
        "<style>.k{display:inline !important} #a{display:none}</style>" + SHOWN,
        '<path display="none" style="display:inline" stroke="red" d="M0 0H9"/>',
        '<g visibility="hidden"><path visibility="visible" stroke="red" d="M0 0H9"/></g>',
        "<style>g > g > .k{display:none}</style><g>" + SHOWN + "</g>",
        "<style>rect.k, #b, .kk{display:none}</style>" + SHOWN,
        '<style type="text/other">path{display:none}</style>' + SHOWN,
        "<style>path{stroke-width:2} @font-face{src:url(x)} text:hover{font-size:2px}</style>"
        + SHOWN,
    ],
)
def test_shape_shown_by_its_style_is_sewn(body: str) -> None:
    assert len(svg(body).strokes) == 1


@pytest.mark.parametrize(
    ("body", "colour"),
    [
        ('<g stroke="blue"><path d="M0 0H9"/></g>', "#0000ff"),
        ('<path style="stroke:#0f0 !important" stroke="red" d="M0 0H9"/>', "#00ff00"),
        ('<path style="stroke:red!important;stroke:blue" d="M0 0H9"/>', "#ff0000"),
        ('<g color="#123456"><path stroke="currentColor" d="M0 0H9"/></g>', "#123456"),
        ('<path stroke="rgb(100%, 0%, 50%)" d="M0 0H9"/>', "#ff0080"),
        ('<path stroke="hsl(240, 100%, 50%)" d="M0 0H9"/>', "#0000ff"),
        ('<path stroke="url(#gradient)" fill="none" d="M0 0H9"/>', "url(#gradient)"),
    ],
)
def test_colours(body: str, colour: str) -> None:
    assert [stroke.colour for stroke in svg(body).strokes] == [colour]


def test_colours_have_the_names_of_css() -> None:
    from matplotlib.colors import CSS4_COLORS

    body = "".join(f'<path stroke="{name.title()}" d="M0 0H9"/>' for name in CSS4_COLORS)
    colours = [stroke.colour for stroke in svg(body).strokes]
    assert colours == [code.lower() for code in CSS4_COLORS.values()]
    assert len(colours) == 148


@pytest.mark.parametrize(
    ("transform", "place"),
    [
        ('transform="translate(20)"', (30, 10)),
        ('transform="translate(20 5) , scale(2)"', (40, 25)),
        ('transform="rotate(90 10 0)"', (0, 0)),
        ('transform="rotate(90)" transform-origin="10 0"', (0, 0)),
        ('style="transform:rotate(90deg);transform-origin:10px 0px"', (0, 0)),
        ('style="transform:rotate(180deg);transform-origin:center"', None),
        ('style="transform:scale(2);transform-origin:50% 50%"', (-30, -10)),
        ('style="transform:translateX(3px) rotate(0.25turn)"', (-7, 10)),
        ('transform="scale(9)" style="transform:none"', (10, 10)),
        ('transform="skewX(45)"', (20, 10)),
        ('transform="matrix(0 1 -1 0 5 6)"', (-5, 16)),
    ],
)
def test_transforms_by_hand(transform: str, place: tuple[float, float] | None) -> None:
    body = f'<path {transform} stroke="red" d="M10 10H20"/>'
    if place is None:
        with pytest.raises(JobError, match=r"transform-origin is 'center', which is not read"):
            svg(body)
        return
    assert first_mm(svg(body)) == pytest.approx(place, abs=1e-9)


REFUSED = {
    'transform="translate(20"': "the transform 'translate(20' is not understood",
    'transform="translate(2em,0)"': "the transform 'translate(2em,0)' is not understood",
    'transform="rotate(30deg)"': "'rotate(30deg)' is not understood",
    'transform="rotate(1 2)"': "has 2 numbers, not 1 or 3",
    'transform="translateX(3)"': "is not understood",
    'transform="scale(2) foo"': "'foo' is not understood",
    'transform="matrix(1 0 0 1 1e400 0)"': "is not understood",
    'style="transform:translate(20, 0)"': "'translate(20, 0)' is not understood",
    'style="transform:translate(var(--x))"': "which is not read",
    'style="translate:20px"': "translate is set to '20px' in a style",
    'style="d:path(&quot;M0 0&quot;)"': "d is set to",
    'style="display:none !wichtig"': "is not understood",
    'style="display:nonne"': "display is 'nonne', which is not understood",
    'style="display"': "the style 'display' is not understood",
    'style="stroke:url(#a"': "the style 'stroke:url(#a' is not understood",
    'style="stroke:blurple"': "'blurple' is not a known colour",
}


@pytest.mark.parametrize("written", REFUSED)
def test_unknown_style_is_refused_with_its_line(written: str) -> None:
    with pytest.raises(JobError) as caught:
        svg(f'<path {written} d="M10 10H20"/>')
    assert REFUSED[written] in str(caught.value)
    assert "t.svg:2: " in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ("<style>@media print{path{display:none}}</style>", "@media in a style sheet"),
        ("<style>@import url(a.css);</style>", "@import in a style sheet"),
        ("<style>path:first-child{display:none}</style>", "selector 'path:first-child'"),
        ("<style>path[d]{transform:none}</style>", "selector 'path[d]'"),
        ("<style>path{display:none</style>", "not understood at 'path{display:none'"),
        ('<style media="print">path{display:none}</style>', "certain media"),
        ('<rect width="-3" height="2"/>', "width is '-3', less than nothing"),
        ('<circle r="3ex"/>', "r is '3ex', not a length"),
        ('<polyline points="1 2 3"/>', "odd count"),
        ('<polyline points="1 2, 3 x"/>', "'x' is not a number"),
        ('<rect width="nan" height="2"/>', "width is 'nan', not a length"),
    ],
)
def test_sheets_and_shapes_that_are_not_read(body: str, text: str) -> None:
    with pytest.raises(JobError) as caught:
        svg(SHOWN + body)
    assert text in str(caught.value)
    assert "t.svg:2: " in str(caught.value)


@pytest.mark.parametrize(
    "way", ['clip-path="url(#c)"', 'style="clip-path:url(#c)"', 'mask="url(#m)"']
)
def test_cut_shapes_are_refused_where_they_are_wanted(way: str) -> None:
    """The whole shape was sewn; a user who does not choose it gets no message."""
    drawing = svg(
        f'<g id="cut" {way}><path stroke="red" d="M0 0H9"/><path stroke="blue" d="M0 0H9"/></g>'
        f'<g id="whole">{SHOWN}</g><path clip-path="none" stroke="red" d="M0 0H9"/>'
    )

    assert [stroke.layer for stroke in drawing.strokes] == ["whole", ""]
    assert [(r.layer, r.colour) for r in drawing.refusals] == [
        ("cut", "#ff0000"),
        ("cut", "#0000ff"),
    ]
    assert "is cut by a" in drawing.refusals[0].message


def test_shapes_by_their_closed_forms() -> None:
    """Lengths of a rounded rectangle, an ellipse in shares of the page, and a clone in a clone."""
    drawing = svg(
        '<rect width="20" height="10" rx="2" stroke="red"/>'
        '<rect width="20" height="10" ry="50" rx="3" stroke="red"/>'
        '<circle cx="50%" cy="50%" r="10%" stroke="red"/>'
        '<defs><g id="b"><path id="a" stroke="red" d="M1 1H4"/></g>'
        '<use id="c" href="#b" x="10"/></defs><use href="#c" y="5"/>'
        '<rect width="0" height="10" stroke="red"/>'
    )
    lengths = [arc_table(stroke.pieces).length_m * 1e3 for stroke in drawing.strokes]
    radius = 0.1 * np.hypot(100, 60) / np.sqrt(2)

    assert lengths[0] == pytest.approx(60 - 16 + 4 * np.pi, abs=1e-8)
    assert lengths[2] == pytest.approx(2 * np.pi * radius, abs=1e-8)
    assert lengths[3] == pytest.approx(3, abs=1e-9)
    assert len(lengths) == 4
    x, y = drawing.strokes[3].pieces.ends()[0][0] * 1e3
    assert (x, 60 - y) == pytest.approx((11, 6), abs=1e-9)


@pytest.mark.parametrize(
    ("head", "place"),
    [
        ('width="100mm" height="60mm" viewBox="0 0 50 60"', (25 + 10, 10)),
        ('width="100mm" height="60mm" viewBox="0 0 50 60" preserveAspectRatio="none"', (20, 10)),
        ('width="100mm" height="60mm" viewBox="5 5 50 60" preserveAspectRatio="xMinYMin"', (5, 5)),
        ('width="100mm" height="60mm" viewBox="0 0 50 15" preserveAspectRatio="xMaxYMax slice"',
         (-100 + 40, 40)),
    ],
)  # fmt: skip
def test_view_boxes_that_do_not_fit(head: str, place: tuple[float, float]) -> None:
    """SVG 1.1, 7.8: scaled to fit and centred, unless it says otherwise."""
    drawing = svg(SHOWN, f'<svg xmlns="http://www.w3.org/2000/svg" {head}>')
    assert first_mm(drawing) == pytest.approx(place, abs=1e-9)
