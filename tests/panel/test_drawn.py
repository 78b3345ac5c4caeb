"""Drawings of the panel: reading and writing files, and outlines of text."""

from __future__ import annotations

import asyncio
import io
import os
import sys
import time
from pathlib import Path

import ezdxf
import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.panel.bench import LOCAL, served
from threadline.errors import JobError
from threadline.geometry.curves import Pieces
from threadline.geometry.svg.document import ValueRefused
from threadline.geometry.svg.paths import Subpath, path_subpaths
from threadline.panel import drawn as drawn_apart
from threadline.panel.calculation import answer_of
from threadline.panel.drawings import Lettering, Shape, dxf, opened, outlines

EXAMPLES = Path(__file__).parents[2] / "examples"
SHAPES = [
    Shape(kind="line", points=[(0, 0), (30, 40), (60, 0)]),
    Shape(kind="polygon", points=[(0, 0), (10, 0), (10, 5.5)]),
    Shape(kind="circle", points=[(5, 6), (5, 9)]),
    Shape(kind="arc", points=[(20, 0), (10, 10), (0, 0)]),
]


def test_written_dxf_reads_back_equal() -> None:
    """Every shape is compared; a circle may begin elsewhere, and an arc runs counter-clockwise."""
    found = opened("a.dxf", dxf(SHAPES))["shapes"]
    assert [one["kind"] for one in found] == [shape.kind for shape in SHAPES]
    for one, shape in zip(found[:2], SHAPES, strict=False):
        assert np.array(one["points"]) == pytest.approx(np.array(shape.points), abs=1e-6)
    centre, rim = np.array(found[2]["points"])
    assert [*centre, np.hypot(*(rim - centre))] == pytest.approx([5, 6, 3], abs=1e-6)
    assert np.array(found[3]["points"]) == pytest.approx(
        np.array([(20, 0), (10, 10), (0, 0)]), abs=1e-6
    )


@pytest.mark.parametrize("name", ["badge.dxf", "pocket.dxf", "collar.svg", "yoke.svg"])
def test_drawings_of_the_examples_can_be_edited(name: str) -> None:
    found = opened(name, (EXAMPLES / name).read_bytes())["shapes"]
    assert len(found) >= 1
    again = opened("a.dxf", dxf([Shape(kind=o["kind"], points=o["points"]) for o in found]))[
        "shapes"
    ]
    assert len(again) == len(found)


def test_looks_fills_and_leaders_are_entities_of_a_dxf() -> None:
    """ezdxf reads them; fills and leaders lie on layers of their own, and are not sewn."""
    made = dxf(
        [
            Shape(kind="line", points=[(0, 0), (30, 0)], style="dashdot"),
            Shape(kind="circle", points=[(50, 50), (60, 50)], fill="hatched"),
            Shape(kind="arc", points=[(20, 0), (10, 10), (0, 0)], fill="solid"),
            Shape(kind="spline", points=[(0, 0), (10, 5), (20, 0)], fill="crossed"),
            Shape(kind="leader", points=[(50, 60), (70, 80), (80, 80)], label="glass {2}"),
        ]
    )
    space = ezdxf.read(io.StringIO(made.decode())).modelspace()
    assert space.query("LWPOLYLINE").first.dxf.linetype == "DASHDOT"
    round_, arc, spline = space.query("HATCH")
    assert {one.dxf.layer for one in (round_, arc, spline)} == {"FILL"}
    assert (round_.dxf.pattern_name, arc.dxf.solid_fill) == ("ANSI31", 1)
    assert spline.dxf.pattern_name == "ANSI37"
    ring = np.array([vertex[:2] for vertex in round_.paths[0].vertices])
    assert np.hypot(*(ring - 50.0).T) == pytest.approx(10.0, abs=1e-6)
    half = np.array([vertex[:2] for vertex in arc.paths[0].vertices])
    assert np.hypot(*(half - (10.0, 0.0)).T) == pytest.approx(10.0, abs=1e-6)
    assert half[:, 1].min() >= -1e-6  # above its chord, as it was drawn
    smooth = np.array([vertex[:2] for vertex in spline.paths[0].vertices])
    assert np.abs(smooth - (10.0, 5.0)).sum(axis=1).min() < 1e-6  # through its points
    leader = space.query("LEADER").first
    assert np.array(leader.vertices)[0][:2] == pytest.approx((50.0, 60.0))
    assert space.query("MTEXT").first.plain_text() == "glass {2}"
    again = opened("a.dxf", made)
    kinds = [one["kind"] for one in again["shapes"]]
    assert kinds == ["line", "circle", "arc", "line", "leader"]
    assert [one.get("fill") for one in again["shapes"]] == [
        None,
        "hatched",
        "solid",
        "crossed",
        None,
    ]
    assert again["shapes"][-1]["label"] == "glass {2}"
    assert np.array(again["shapes"][-1]["points"]) == pytest.approx(
        np.array([(50.0, 60.0), (70.0, 80.0), (80.0, 80.0)])
    )
    assert again["left_out"] == []


def test_the_hole_of_a_letter_is_not_filled() -> None:
    """The hatch has two rings, and the drawing that is opened again has two fills."""
    rings = outlines(Lettering(text="O", height_mm=10.0))
    made = dxf([Shape(**ring, fill="solid") for ring in rings])
    (hatch,) = ezdxf.read(io.StringIO(made.decode())).modelspace().query("HATCH")
    assert (len(hatch.paths), hatch.dxf.hatch_style) == (2, 0)
    again = opened("a.dxf", made)
    assert [one["fill"] for one in again["shapes"]] == ["solid", "solid"]
    one_by_one = dxf([Shape(**{**ring, "group": 0}, fill="solid") for ring in rings])
    assert len(ezdxf.read(io.StringIO(one_by_one.decode())).modelspace().query("HATCH")) == 2


STYLES = ["solid", "dashed", "dotted", "dashdot"]


def test_styles_of_lines_come_back_from_a_dxf() -> None:
    """Every kind of shape keeps its style, through line types of the file."""
    points = {
        "line": [(0, 0), (30, 40)], "polygon": [(0, 0), (10, 0), (10, 5)],
        "circle": [(5, 6), (5, 9)],
        "arc": [(20, 0), (10, 10), (0, 0)], "spline": [(0, 0), (9, 5), (20, 0)],
        "leader": [(50, 60), (70, 80)],
    }  # fmt: skip
    for kind, at in points.items():
        drawn = [
            Shape.model_validate({"kind": kind, "points": at, "style": style}) for style in STYLES
        ]
        made = dxf([SHAPES[0], *drawn])
        document = ezdxf.read(io.StringIO(made.decode()))
        assert all(one.dxf.linetype in document.linetypes for one in document.modelspace())
        found = opened("a.dxf", made)["shapes"][1:]
        assert [one["style"] for one in found] == STYLES, kind


def test_line_types_of_layers_blocks_and_other_programs() -> None:
    document = ezdxf.new(setup=["linetypes"], units=ezdxf.units.MM)
    document.layers.add("hidden", linetype="DASHEDX2")
    document.linetypes.add("dots", [0.2, 0.0, -0.2])
    block = document.blocks.new("b")
    block.add_line((0, 0), (1, 0), dxfattribs={"linetype": "BYBLOCK"})
    space = document.modelspace()
    for look in ({"layer": "hidden"}, {"linetype": "CENTER2"}, {"linetype": "dots"}, {}):
        space.add_line((0, 0), (1, 0), dxfattribs=look)
    space.add_line((0, 0), (1, 0), dxfattribs={"linetype": "none such"})
    space.add_blockref("b", (0, 0), dxfattribs={"linetype": "DASHDOT"})
    out = io.StringIO()
    document.write(out)
    found = [one["style"] for one in opened("a.dxf", out.getvalue().encode())["shapes"]]
    assert found == ["dashed", "dashdot", "dotted", "solid", "solid", "dashdot"]


@pytest.mark.parametrize("look, style", [
    ('stroke-dasharray="4 2"', "dashed"),
    ('stroke-dasharray="0.5 1.5" stroke-width="0.3"', "dotted"),
    ('style="stroke-dasharray: 6px, 2px, 0.5px, 2px; stroke-width: .3"', "dashdot"),
    ('stroke-dasharray="5"', "dashed"),
    ('stroke-dasharray="0 3" stroke-linecap="round"', "dotted"),
    ('stroke-dasharray="none"', "solid"),
    ('stroke-dasharray="4 0"', "solid"),
    ('stroke-dasharray="calc(1px + 2px) 3"', "solid"),
    ('stroke-dasharray="a,,b" stroke-width="var(--w)"', "solid"),
    ("", "solid"),
])  # fmt: skip
def test_styles_of_lines_of_an_svg(look: str, style: str) -> None:
    """A style may be written at a shape, or inherited from a group."""
    head = b'<svg xmlns="http://www.w3.org/2000/svg" width="9mm" height="9mm" viewBox="0 0 9 9">'
    line = b'<path d="M 1 1 L 8 8" stroke="#000"'
    own = opened("a.svg", b"".join((head, line, b" ", look.encode(), b"/></svg>")))
    above = opened("a.svg", b"".join((head, b"<g ", look.encode(), b">", line, b"/></g></svg>")))
    assert [one["style"] for found in (own, above) for one in found["shapes"]] == [style, style]


def test_fills_and_leaders_of_another_program_are_kept_where_they_fit() -> None:
    """In inches; a leader keeps its label, and a fill without a drawn outline is left out."""
    document = ezdxf.new(units=ezdxf.units.IN)
    space = document.modelspace()
    space.add_lwpolyline([(0, 0), (2, 0), (2, 1), (0, 1)], close=True)
    for ring in ([(0, 0), (2, 0), (2, 1), (0, 1)], [(5, 5), (7, 5), (7, 6)]):
        space.add_hatch(color=1).paths.add_polyline_path(ring, is_closed=True)
    text = space.add_mtext("front", dxfattribs={"insert": (9, 9), "char_height": 0.1})
    space.add_leader([(1, 1), (3, 3)], dxfattribs={"annotation_handle": text.dxf.handle})
    space.add_mtext("alone", dxfattribs={"insert": (3.1, 3), "char_height": 0.1})
    out = io.StringIO()
    document.write(out)
    found = opened("a.dxf", out.getvalue().encode())
    polygon, leader = found["shapes"]
    assert (polygon["kind"], polygon["fill"]) == ("polygon", "solid")
    assert (leader["label"], leader["points"]) == ("front", [[25.4, 25.4], [76.2, 76.2]])
    assert [line.partition(": ")[2] for line in found["left_out"]] == [
        "a HATCH cannot be sewn", "the text 'alone' cannot be sewn",
    ]  # fmt: skip


def test_capital_letters_are_as_high_as_asked() -> None:
    """An H is 10 mm high and begins on the baseline; an O has two rings."""
    (ring,) = outlines(Lettering(text="H", height_mm=10.0))
    y = np.array(ring["points"])[:, 1]
    assert (y.min(), y.max()) == pytest.approx((0.0, 10.0), abs=0.05)  # hinting of the font
    assert len(outlines(Lettering(text="O", height_mm=10.0))) == 2


def test_impossible_drawing_is_refused_in_one_line() -> None:
    with pytest.raises(
        JobError, match=r"shape 1: a polygon needs 3 points or more, this one has 2"
    ):
        dxf([Shape(kind="polygon", points=[(0, 0), (1, 1)])])
    with pytest.raises(JobError, match="is not a known kind of drawing"):
        opened("a.step", b"")
    with pytest.raises(JobError, match="the drawing has 0 lines"):
        opened("a.dxf", dxf([Shape(kind="line", points=[(1, 1), (1, 1)])]))


BAD = (
    ("dxf", b"[]"), ("text", b'{"text": "", "height_mm": 5}'), ("dxf", b"{"),
    ("dxf", b'[{"kind": "line", "points": [[0, 1e9]]}]'), ("shapes?name=a.dxf", b"\xff\x00"),
    ("shapes?name=a.svg", b"<svg"), ("shapes", b""),
)  # fmt: skip


@pytest.mark.long(but="2 bad")
@pytest.mark.parametrize("bad", [BAD[:2], BAD[2:]], ids=["2 bad", "5 bad"])
def test_requests(tmp_path: Path, bad: tuple[tuple[str, bytes], ...]) -> None:
    """They keep nothing, and need no lease."""
    with served(tmp_path) as client:
        sent = b'[{"kind": "line", "points": [[0, 0], [10, 0]]}]'
        answer = post(client, "dxf", sent)
        assert answer.status_code == 200
        read = post(client, "shapes?name=a.dxf", answer.content)
        line = {"kind": "line", "points": [[0.0, 0.0], [10.0, 0.0]], "group": 1, "style": "solid"}
        assert read.json() == {"shapes": [line], "left_out": []}
        assert post(client, "text", b'{"text": "A", "height_mm": 5}').status_code == 200
        for path, content in bad:
            assert post(client, path, content).status_code == 422, (path, content)
        assert post(client, "shapes?name=a.dxf", b"0" * ((8 << 20) + 1)).status_code == 413
        refused = client.post("/api/drawing/dxf", content=sent, headers={"origin": "http://evil"})
        assert refused.status_code == 403
    assert [file for file in tmp_path.iterdir() if file.name != "runs"] == []


def post(client: TestClient, path: str, content: bytes):  # type: ignore[no-untyped-def]
    return client.post(f"/api/drawing/{path}", content=content, headers=LOCAL)


def svg(*elements: str) -> bytes:
    head = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9" width="9mm" height="9mm">'
    return "\n".join([head, *elements, "</svg>"]).encode()


def test_large_drawings_are_refused_before_they_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """7 MB with 150 000 paths took the panel a minute, and 6 MB of curves some GB of memory."""
    made: list[int] = []
    pieces = Subpath.pieces

    def counted(path: Subpath, line: int) -> Pieces:
        made.append(line)
        return pieces(path, line)

    monkeypatch.setattr(Subpath, "pieces", counted)
    path = '<path stroke="red" d="M0 0L1 1"/>'
    with pytest.raises(JobError, match="have more than 5000 lines"):
        opened("a.svg", svg(*[path] * 6000))
    assert len(made) == 5000
    curves = "".join(f"C1 2 3 4 {k % 7} 5" for k in range(7000))
    with pytest.raises(JobError, match="more than 400000 points for editing"):
        opened("a.svg", svg(f'<path stroke="red" d="M0 0{curves}"/>'))
    document = ezdxf.new(units=ezdxf.units.MM)
    for k in range(5001):
        document.modelspace().add_line((0, k), (1, k))
    out = io.StringIO()
    document.write(out)
    with pytest.raises(JobError, match=r"a\.dxf:\d+: the drawing and its blocks have more than"):
        opened("a.dxf", out.getvalue().encode())


def test_a_number_behind_a_comma_is_read_without_a_look_at_all_before() -> None:
    """A path of a few MB took hours, because all text before each number was copied."""

    class Text(str):
        """A text that counts its copied characters."""

        copied = 0

        def __getitem__(self, at):  # type: ignore[no-untyped-def]
            part = super().__getitem__(at)
            Text.copied += len(part)
            return part

    data = Text("M0,0L" + ",".join(f"{k % 7},{k % 5}" for k in range(1000)))
    (path,) = path_subpaths(data)
    assert len(path.segments) == 1000
    assert Text.copied < 10 * len(data)
    with pytest.raises(ValueRefused, match=r"',1,1' at character 6"):
        path_subpaths("M0 0L,1,1")


def test_a_drawing_that_takes_too_long_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drawn_apart, "LONGEST_S", 0.5)
    monkeypatch.setattr(drawn_apart, "CHILD", "import time; time.sleep(600)")
    with served(tmp_path) as client:
        since_s = time.monotonic()
        answer = post(client, "shapes?name=a.svg", svg())
        assert answer.status_code == 422
        assert answer.text == "'a.svg' takes longer than 0.5 s. Split it, or simplify it.\n"
        monkeypatch.setattr(drawn_apart, "LONGEST_S", 300.0)
        monkeypatch.setattr(drawn_apart, "CHILD", "import os; os._exit(1)")
        assert "has ended" in post(client, "shapes?name=a.svg", svg()).text
    assert time.monotonic() < since_s + 300.0


def test_a_process_ends_with_who_waits_for_it(tmp_path: Path) -> None:
    """A thread could not be killed, and the panel had to wait for it at its end."""
    folder = tmp_path / "told"
    words = f"import os, time; open({str(folder)!r}, 'w').write(str(os.getpid())); time.sleep(60)"

    async def asked() -> None:
        waits = asyncio.create_task(answer_of(sys.executable, "-c", words))
        while not (folder.exists() and folder.read_text()):
            await asyncio.sleep(0.01)
        waits.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waits

    asyncio.run(asked())
    with pytest.raises(ProcessLookupError):
        os.kill(int(folder.read_text()), 0)
