"""Wrong seams as files: every one ends in a message with file, line and remedy."""

import random
from pathlib import Path

import ezdxf
import pytest

from threadline.errors import InputError, JobError
from threadline.geometry import read_dxf
from threadline.jobs.operations import Job
from threadline.jobs.seam import read_seam
from threadline.machine import Machine

SPEED = {"stitch_length": "2.5 mm", "needle_speed": "50 stitch/s"}
SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="50mm" height="50mm" viewBox="0 0 50 50">'
LINE = '<path d="M0 0 H40 V30" stroke="red"/>'


def read(folder: Path, machine: Machine, name: str, content: str | bytes, **more: object) -> Job:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_seam(path, machine, **{**SPEED, **more})


SEAM = "[stitching]\n{}\n[[contour]]\nunit = 'mm'\npoints = {}\n"
TWO = "[[0, 0], [30, 0]]"
BAD_TOML = {
    "not TOML": ("[stitching\n", 1, "not valid TOML"),
    "unknown table": ("[stiching]\n", 1, "Did you mean 'stitching'"),
    "unknown key": (SEAM.format("stich_length = '2 mm'", TWO), 2, "Did you mean 'stitch_length'"),
    "no unit": (SEAM.format("stitch_length = 2.5", TWO), 2, "has no unit"),
    "wrong unit": (SEAM.format("stitch_length = '2.5 s'", TWO), 2, "'m'"),
    "zero length": (SEAM.format("stitch_length = '0 mm'", TWO), 2, "at least 1e-05"),
    "absurd speed": (SEAM.format("needle_speed = '1e9 stitch/s'", TWO), 2, "at most 1000"),
    "choice": (SEAM.format("needle = 'fast'", TWO), 2, "constant or slowed"),
    "truth": (SEAM.format("reverse = 1", TWO), 2, "not of type bool"),
    "whole": (SEAM.format("lock_start = true", TWO), 2, "not of type int"),
    "backwards": (SEAM.format("start = '9 mm'\nend = '5 mm'", TWO), 3, "before it starts"),
    "too far": (SEAM.format("end = '31 mm'", TWO), 5, "of a contour of 30 mm"),
    "long lock": (SEAM.format("lock_start = 20", TWO), 5, "at most 12 stitches"),
    "side of open": (SEAM.format("allowance = '1 mm'", TWO), 5, "has no inside"),
    "one point": (SEAM.format("", "[[0, 0]]"), 5, "two or more points"),
    "no number": (SEAM.format("", "[[0, 0], [1, 'a']]"), 5, "is not a point"),
    "infinite": (SEAM.format("", "[[0, 0], [inf, 1]]"), 5, "is not a point"),
    "nowhere": (SEAM.format("", "[[1, 1], [1, 1]]"), 0, "nothing to sew"),
    "impossible arc": (SEAM.format("", "[[0, 0], {to = [9, 0], radius = 4}]"), 5, "on a circle"),
    "two arcs": (SEAM.format("", "[[0,0], {to = [9, 0], radius = 9, bulge = 1}]"), 5, "by two"),
    "off centre": (SEAM.format("", "[[0,0], {to = [9, 0], centre = [3, 0]}]"), 5, "its centre"),
    "point key": (SEAM.format("", "[[0, 0], {to = [9, 0], bulg = 1}]"), 5, "Did you mean 'bulge'"),
    "empty file": ("\n", 0, "neither [drawing] file = ... nor [[contour]]"),
    "both": ("[drawing]\nfile = 'a.dxf'\n[[contour]]\nunit = 'mm'\n", 1, "has both"),
    "empty text": ("[drawing]\nfile = ''\n", 2, "the key 'file' has an empty text"),
    "no contour": ("[stitching]\nneedle = 'slowed'\n", 0, "either"),
    "no drawing": ("[drawing]\nfile = 'gone.dxf'\n", 0, "No such file"),
    "odd drawing": ("[drawing]\nfile = 'gone.png'\n", 2, "ends in none of"),
    "bad gap": ("[drawing]\nfile = 'a.dxf'\ngap = '1 m'\n", 3, "between"),
    "bad origin": ("[drawing]\nfile = 'a.dxf'\norigin = '1 mm'\n", 3, "origin is like"),
    "bad by": ("[drawing]\nfile = 'a.dxf'\nby = 'size'\n", 3, "layer, colour or all"),
    "no contour unit": ("[[contour]]\npoints = [[0, 0], [1, 0]]\n", 2, "has no unit"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_TOML)
def test_seam_files(case: str, sewer: Machine, tmp_path: Path) -> None:
    content, line, text = BAD_TOML[case]
    with pytest.raises(JobError) as caught:
        path = tmp_path / "t.seam.toml"
        path.write_text(content)
        options = {key: value for key, value in SPEED.items() if key not in content}
        read_seam(path, sewer, **options)
    assert text in str(caught.value)
    if line:
        assert f"t.seam.toml:{line}:" in str(caught.value)


BAD_CSV = {
    "no heading": ("0,0\n1,1\n", "unknown column '0'"),
    "no unit": ("x,y\n0,0\n1,1\n", "has no unit"),
    "odd unit": ("x [kg],y [kg]\n0,0\n", "does not measure the same quantity"),
    "twice": ("x [mm],y [mm],x [mm]\n0,0,0\n", "same name"),
    "no y": ("x [mm],bulge\n0,0\n", "no column 'y'"),
    "half a centre": ("x [mm],y [mm],cx [mm]\n0,0,0\n", "cx, cy and turn"),
    "short row": ("x [mm],y [mm]\n0,0\n1\n", "t.csv:3: the row has 1 cells, the heading 2"),
    "text": ("x [mm],y [mm]\n0,0\n1,one\n", "t.csv:3: y is 'one'"),
    "nan": ("x [mm],y [mm]\n0,0\n1,nan\n", "not a finite number"),
    "blank x": ("x [mm],y [mm]\n0,0\n,1\n", "t.csv:3: a point lacks x or y"),
    "lone point": ("x [mm],y [mm]\n0,0\n\n1,1\n", "t.csv:2: a contour has one point only"),
    "layers": ("x [mm],y [mm],layer\n0,0,a\n1,1,b\n", "t.csv:3: the layer changes"),
    "arc": ("x [mm],y [mm],cx [mm],cy [mm],turn\n0,0,5,1,cw\n1,1,,,\n", "t.csv:2: the arc"),
    "half arc": ("x [mm],y [mm],cx [mm],cy [mm],turn\n0,0,5,,cw\n1,1,,,\n", "needs both cx and cy"),
    "only heading": ("x [mm],y [mm]\n", "no points"),
    "empty": (" \n", "empty"),
    "binary": (b"x [mm],y [mm]\n\0\0\n", "t.csv:2: the file is binary"),
    "latin-1": ("x [mm],y [mm],layer\n0,0,N\u00e4hte\n".encode("latin-1"), "t.csv:2: byte 0xe4"),
    "utf-16": ("x [mm],y [mm]\n".encode("utf-16"), "UTF-16"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_CSV)
def test_tables(case: str, sewer: Machine, tmp_path: Path) -> None:
    content, text = BAD_CSV[case]
    with pytest.raises(JobError) as caught:
        read(tmp_path, sewer, "t.csv", content)
    assert text in str(caught.value)


LAUGHS = (
    '<?xml version="1.0"?>\n<!DOCTYPE svg [\n<!ENTITY a "ha">\n<!ENTITY b "&a;&a;&a;">\n]>\n'
    f"{SVG}<desc>&b;</desc></svg>"
)


EXTERNAL = (
    f'<!DOCTYPE svg [<!ENTITY x SYSTEM "file:///etc/hostname">]>\n{SVG}<desc>&x;</desc></svg>'
)


CLONES = "".join(f'<g id="g{k}">' + f'<use href="#g{k - 1}"/>' * 10 + "</g>" for k in range(1, 9))
BAD_SVG = {
    "not XML": (f"{SVG}<path></svg>", "t.svg:1: not well-formed XML: mismatched tag"),
    "not SVG": ("<html><body/></html>", "the root element is 'html'"),
    "laughs": (LAUGHS, "t.svg:3: the SVG declares the entity 'a'"),
    "external": (EXTERNAL, "declares the entity 'x'"),
    "clone bomb": (f'{SVG}<path id="g0" d="M0 0H1"/>{CLONES}</svg>', "more than 1000000"),
    "clone of itself": (f'{SVG}<g id="a"><use href="#a"/></g></svg>', "clone of itself"),
    "other file": (f'{SVG}<use href="b.svg#a"/></svg>', "another file"),
    "deep": (SVG + "<g>" * 500 + "</g>" * 500 + "</svg>", "nested more than 200"),
    "text": (f'{SVG}{LINE}\n<text x="1">collar</text></svg>', "t.svg:2: layer '': text cannot be"),
    "image": (f'{SVG}{LINE}\n<image href="a.png" width="1" height="1"/></svg>', "image cannot be"),
    "nothing": (f"{SVG}</svg>", "nothing to sew"),
    "path": (f'{SVG}<path d="M0 0 L 1 abc" stroke="red"/></svg>', "the data of a path is wrong"),
    "stray": (
        f'{SVG}{LINE}\n<path d="M0 0 L10 0 foo L10 10"/></svg>',
        "t.svg:2: the data of a path is wrong: 'foo' at character 12",
    ),
    "nan": (f'{SVG}{LINE}\n<path d="M0 0L nan 9"/></svg>', "t.svg:2: 'nan' in the data of a path"),
    "em": (
        f'{SVG}{LINE}\n<rect width="3em" height="2" stroke="red"/></svg>',
        "t.svg:2: width is '3em', not a length in known units. Write it in mm",
    ),
    "blank": (f'{SVG}\n<circle r="3 mm" stroke="red"/></svg>', "r is '3 mm', not a length"),
    "page in em": ('<svg xmlns="http://www.w3.org/2000/svg" width="9em"/>', "t.svg:1: width is"),
    "half a point": (f'{SVG}{LINE}\n<path d="M0 0L 9"/></svg>', "t.svg:2: the data of a path"),
    "latin": (f"{SVG}<desc>\u00e4</desc></svg>".encode("latin-1"), "byte 0xe4 is not UTF-8"),
    "cut": (f"{SVG}{LINE}", "no element found"),
    "symbol": (f'{SVG}<symbol viewBox="0 0 1 1"/></svg>', "symbol with a viewBox"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_SVG)
def test_svgs(case: str, sewer: Machine, tmp_path: Path) -> None:
    content, text = BAD_SVG[case]
    with pytest.raises(JobError) as caught:
        read(tmp_path, sewer, "t.svg", content)
    assert text in str(caught.value)


def saved(folder: Path, document: "ezdxf.document.Drawing") -> bytes:
    document.saveas(folder / "made.dxf")
    return (folder / "made.dxf").read_bytes()


@pytest.mark.parametrize(
    ("units", "message"),
    [(0, "does not say its unit ($INSUNITS is 0)"), (99, "($INSUNITS is 99, ")],
)
def test_a_dxf_without_a_known_unit(
    units: int, message: str, sewer: Machine, tmp_path: Path
) -> None:
    document = ezdxf.new()
    document.header["$INSUNITS"] = units
    document.modelspace().add_line((0, 0), (40, 0))
    with pytest.raises(JobError) as caught:
        read(tmp_path, sewer, "made.dxf", saved(tmp_path, document))
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("value", "shown"), [("7\nENDSEC", "'ENDSEC'"), ("11\n100.0\n21\n20.0", "'(100.0, 20.0)'")]
)
def test_a_dxf_whose_unit_is_no_number(
    value: str, shown: str, sewer: Machine, tmp_path: Path
) -> None:
    text = f"0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n9\n$INSUNITS\n{value}\n0\nENDSEC\n"
    text += "0\nSECTION\n2\nENTITIES\n0\nLINE\n8\n0\n10\n0.0\n20\n0.0\n11\n40.0\n21\n0.0\n"
    text += "0\nENDSEC\n0\nEOF\n"
    with pytest.raises(JobError) as caught:
        read(tmp_path, sewer, "made.dxf", text.encode())
    assert f"$INSUNITS is {shown}, not a number" in str(caught.value)


def test_dxf_text_is_refused_unless_its_layer_is_not_chosen(sewer: Machine, tmp_path: Path) -> None:
    document = ezdxf.new(units=4)
    space = document.modelspace()
    space.add_line((0, 0), (40, 0), dxfattribs={"layer": "SEAM"})
    space.add_text("CUT 2x", dxfattribs={"layer": "NOTES"})
    content = saved(tmp_path, document)
    with pytest.raises(JobError, match=r"t\.dxf:\d+: layer 'NOTES': the text 'CUT 2x' cannot"):
        read(tmp_path, sewer, "t.dxf", content)

    seam = "[drawing]\nfile = 't.dxf'\n[[seam]]\nlayer = 'SEAM'\n"
    assert len(list(read(tmp_path, sewer, "t.seam.toml", seam))) > 10
    wrong = "[drawing]\nfile = 't.dxf'\n[[seam]]\nlayer = 'SEEM'\n"
    with pytest.raises(JobError, match=r"t\.seam\.toml:4: .*nothing to sew.*SEAM #ffffff"):
        read(tmp_path, sewer, "t.seam.toml", wrong)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda s: s.add_hatch(), "a HATCH cannot be sewn"),
        (lambda s: s.add_mtext("two\\Plines"), "the text 'two"),
        (lambda s: s.add_line((0, 0, 0), (1, 1, 5)), "a LINE is not drawn in the XY plane"),
        (lambda s: s.add_circle((0, 0), 1, dxfattribs={"extrusion": (1, 0, 0)}), "not drawn in"),
        (lambda s: s.add_blockref("GONE", (0, 0)), "block 'GONE' is not in the file"),
        (lambda s: s.add_spline([(0, 0, 0), (1, 1, 9), (2, 0, 0)]), "a SPLINE is not drawn"),
        (lambda s: s.add_lwpolyline([(1, 1)]), "fewer than two points"),
    ],
)  # fmt: skip
def test_dxf_entities_that_cannot_be_sewn(
    make: object, text: str, sewer: Machine, tmp_path: Path
) -> None:
    document = ezdxf.new(units=4)
    make(document.modelspace())
    with pytest.raises(JobError, match=text):
        read(tmp_path, sewer, "t.dxf", saved(tmp_path, document))


def test_dxf_files_that_are_none(sewer: Machine, tmp_path: Path) -> None:
    document = ezdxf.new("R12")
    document.modelspace().add_line((0, 0), (9, 0))
    unitless = saved(tmp_path, document)
    with pytest.raises(JobError, match=r"does not say its unit.*unit = \"mm\""):
        read(tmp_path, sewer, "t.dxf", unitless)
    with pytest.raises(JobError, match="this is a DWG file"):
        read(tmp_path, sewer, "t.dxf", b"AC1032\0\0\0\0")
    for junk in (b"hello world", b"\x89PNG\r\n\x1a\n" + bytes(99), unitless[:700]):
        with pytest.raises(JobError, match=r"t\.dxf.*(not a DXF drawing|unit)"):
            read(tmp_path, sewer, "t.dxf", junk)
    millimetres = ezdxf.new(units=4)
    millimetres.modelspace().add_line((0, 0), (9, 0))
    (tmp_path / "m.dxf").write_bytes(saved(tmp_path, millimetres))
    with pytest.raises(JobError, match=r"its unit is 0\.001 m .*says in"):
        read(tmp_path, sewer, "t.seam.toml", "[drawing]\nfile = 'm.dxf'\nunit = 'in'\n")


def test_dxf_block_that_holds_itself(sewer: Machine, tmp_path: Path) -> None:
    document = ezdxf.new(units=4)
    block = document.blocks.new("LOOP")
    block.add_line((0, 0), (1, 0))
    block.add_blockref("LOOP", (1, 0))
    document.modelspace().add_blockref("LOOP", (0, 0))
    with pytest.raises(JobError, match="nested more than 32 deep"):
        read(tmp_path, sewer, "t.dxf", saved(tmp_path, document))


def test_dxf_block_bomb(sewer: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """2^29 points: they are counted block by block, and not copied."""
    monkeypatch.setattr(read_dxf, "MAX_LINES", 1000)
    document = ezdxf.new(units=4)
    document.blocks.new("B0").add_point((0, 0))
    for k in range(1, 30):
        block = document.blocks.new(f"B{k}")
        block.add_blockref(f"B{k - 1}", (0, 0))
        block.add_blockref(f"B{k - 1}", (1, 0))
    document.modelspace().add_blockref("B29", (0, 0))
    with pytest.raises(JobError, match="make more than 1000 entities"):
        read(tmp_path, sewer, "t.dxf", saved(tmp_path, document))


def seam(points: str, extra: str = "") -> str:
    return f"{extra}\n[[contour]]\nunit = 'mm'\npoints = {points}\n"


def test_odd_names(sewer: Machine, tmp_path: Path) -> None:
    with pytest.raises(JobError, match="is no seam"):
        read(tmp_path, sewer, "t.png", "x")
    with pytest.raises(JobError, match=r"not a file|cannot read"):
        read_seam(tmp_path, sewer, **SPEED)
    with pytest.raises(JobError, match="Did you mean 'needle_speed'"):
        read(tmp_path, sewer, "t.csv", "x [m],y [m]\n0,0\n1,0\n", needle_sped="1 stitch/s")


@pytest.mark.parametrize("name", ["pocket.dxf", "badge.dxf", "collar.svg", "strap.csv"])
def test_damaged_files_raise_nothing_else(
    name: str, sewer: Machine, examples: Path, tmp_path: Path
) -> None:
    """Bytes changed, cut and doubled at random: an input error or a job, never another error."""
    original = (examples / name).read_bytes()
    rng = random.Random(name)
    outcomes = set()
    for _ in range(40):
        data = bytearray(original)
        for _ in range(rng.randint(1, 6)):
            at = rng.randrange(len(data))
            action = rng.randrange(3)
            if action == 0:
                data[at] = rng.randrange(256)
            elif action == 1:
                del data[at : at + rng.randint(1, 40)]
            else:
                data[at:at] = data[max(0, at - 30) : at]
        try:
            read(tmp_path, sewer, name, bytes(data))
            outcomes.add("job")
        except InputError:
            outcomes.add("error")
    assert "error" in outcomes


def test_an_arc_beyond_all_numbers_is_refused(sewer: Machine, tmp_path: Path) -> None:
    """Its square overflows: once that ended in a warning of numpy."""
    points = "[[0, 0], {to = [9, 0], bulge = 1e300}]"
    with pytest.raises(JobError, match="reaches further than 10000 m"):
        read(tmp_path, sewer, "t.seam.toml", seam(points))
