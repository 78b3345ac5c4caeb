"""Definitions of FiberPath (``.wind``): written from layers, and read back."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from threadline.cli.main import main
from threadline.errors import JobError
from threadline.jobs.winding.build_up import Laid, design
from threadline.jobs.winding.layers import read_layers

TUBE = """name = "tube"
[mandrel]
at = "-110 mm"
[[part]]
kind = "cone"
radius = "{left} mm"
length = "470 mm"
end_radius = "{right} mm"
[band]
width = "6.05 mm"
thickness = "0.25 mm"
[friction]
value = 0.2
[coverage]
begin = "110 mm"
end = "360 mm"
"""
LAYERS = """[[layer]]
kind = "hoop"
[[layer]]
angle = "50 deg"
circuits = 34
[[layer]]
angle = "55 deg"
circuits = 30
shift = 19
"""


def run(*words: object) -> int:
    """Return the exit status of the program."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return int(ended.value.code or 0)


def _written(folder: Path, text: str, *, left: float = 50.0, right: float = 50.0) -> dict[str, Any]:
    product, file = folder / "tube.wind.toml", folder / "out" / "tube.wind"
    product.write_text(TUBE.format(left=left, right=right) + text)
    assert run("wind", product, "--wind", file) == 0
    found = json.loads(file.read_text())
    assert isinstance(found, dict)
    return found


def _designed(path: Path) -> tuple[Laid, ...]:
    return design(read_layers(path))


@pytest.mark.parametrize(("left", "right"), [(50.0, 50.0), (52.0, 47.0)])
def test_mandrel_band_and_layers_come_back(tmp_path: Path, left: float, right: float) -> None:
    layers = LAYERS if left == right else '[[layer]]\nangle = "55 deg"\ncircuits = 29\n'
    _written(tmp_path, layers, left=left, right=right)
    ours = _designed(tmp_path / "tube.wind.toml")
    back = _designed(tmp_path / "out" / "tube.wind")

    one, other = (laid[0].wrap.winding.product for laid in (ours, back))
    assert (other.width.si, other.thickness) == pytest.approx((one.width.si, one.thickness))
    for share in (0.0, 0.3, 1.0):  # of the covered length
        radii = []
        for product in (one, other):
            assert product.covered is not None
            begin, end = product.covered
            assert product.at.si + begin == pytest.approx(0.0, abs=1e-12)
            at = product.surface.place_of(np.array([begin + share * (end - begin)]))
            radii.append(product.surface.at(at)[1][0, 0])
        assert radii[1] == pytest.approx(radii[0], abs=1e-9)
    assert len(back) == len(ours)
    for mine, again in zip(ours, back, strict=True):
        assert again.layer.kind == mine.layer.kind
        assert (again.pattern.circuits, again.pattern.shift) == (
            mine.pattern.circuits,
            mine.pattern.shift,
        )
        # The samples of a grown surface lie elsewhere on a mandrel with other ends.
        near = 1e-9 if mine is ours[0] else 1e-6
        assert again.circuit.constant_m == pytest.approx(mine.circuit.constant_m, abs=near)
        assert again.circuit.advance == pytest.approx(mine.circuit.advance, abs=1e3 * near)


def test_written_definition_keeps_the_rules_of_fiberpath(tmp_path: Path) -> None:
    """By hand from FiberPath's guide: its coverage is the pattern of the product.

    The number of circuits follows from angle and tow and is a multiple of patternNumber; skipIndex
    is below it and coprime; lockDegrees is a multiple of 180 / patternNumber; a circuit turns by
    two locks and skipIndex / patternNumber of a turn more. 30 and 19/30 are the product's.
    """
    hoop, _, first = _written(tmp_path, LAYERS)["layers"]
    assert hoop == {"windType": "hoop", "terminal": False}
    assert first["windAngle"] == pytest.approx(55.0, abs=1e-9)
    count = math.ceil(2.0 * math.pi * 50.0 / (6.05 / math.cos(math.radians(55.0))))
    pattern, skip, lock = (first[key] for key in ("patternNumber", "skipIndex", "lockDegrees"))
    assert count == 30 and count % pattern == 0
    assert 0 < skip < pattern and math.gcd(skip, pattern) == 1
    assert lock * pattern / 180.0 == pytest.approx(round(lock * pattern / 180.0), abs=1e-9)
    further = 2.0 * lock + 360.0 * skip / pattern
    assert further % 360.0 == pytest.approx(360.0 * 19 / 30, abs=1e-9)
    assert 0.0 < first["leadInMM"] < 250.0 and 0.0 < first["leadOutDegrees"] < lock


def test_a_definition_in_another_order_of_circuits_keeps_angle_and_number(tmp_path: Path) -> None:
    """Three places to begin, ten circuits at each: no shift of 30 equal circuits does that."""
    found = _written(tmp_path, LAYERS)
    found["layers"] = [found["layers"][2] | {"patternNumber": 3, "lockDegrees": 540.0}]
    (tmp_path / "three.wind").write_text(json.dumps(found))
    winding = read_layers(tmp_path / "three.wind")
    (layer,) = winding.layers
    assert layer.angle == pytest.approx(math.radians(55.0))
    assert (layer.circuits, layer.shift) == (30, None)


DOME = """[[part]]
kind = "hemisphere"
radius = "50 mm"
opening = "20 mm"
pole = "right"
"""


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[band]", DOME + "[band]"), "[[part]] 2 is a dome (hemisphere), and a .wind has"),
        (
            ("[band]", '[[part]]\nkind = "cone"\nradius = "50 mm"\nlength = "9 mm"\n'
             'end_radius = "60 mm"\n[band]'),
            "the mandrel has several radii",
        ),
        (('thickness = "0.25 mm"\n', ""), "made.wind.toml:16: the thickness of the band is not"),
        (("circuits = 30\nshift = 19", "circuits = 31"), "31 circuits; FiberPath winds 30 at 55"),
        (('"hoop"', '"hoop"\ncircuits = 2'), "Write 2 hoop layers"),
        (('"50 deg"', '"50 deg"\nend = "340 mm"'), "its end is 340 mm, and [coverage] has 360 mm"),
        (('radius = "50 mm"\nlen', 'radius = "49 mm"\nlen'), "the cone widens to the right"),
    ],
)  # fmt: skip
def test_fiberpath_export_refuses_values_that_the_format_cannot_hold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], message: str
) -> None:
    text = (TUBE.format(left=50, right=50) + LAYERS).replace(*change)
    (tmp_path / "made.wind.toml").write_text(text)
    file = tmp_path / "new" / "made.wind"
    assert run("wind", tmp_path / "made.wind.toml", "--wind", file) == 2
    errors = capsys.readouterr().err.strip()
    assert message in errors and "\n" not in errors
    assert not file.parent.exists()


def test_fiberpath_export_warns_of_values_without_a_place_in_the_format(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (TUBE.format(left=50, right=50) + LAYERS).replace("-110 mm", "-100 mm")
    (tmp_path / "made.wind.toml").write_text(text.replace("value = 0.2", "value = 0.3"))
    assert run("wind", tmp_path / "made.wind.toml", "--wind", tmp_path / "a.wind") == 0
    errors = " ".join(capsys.readouterr().err.split())
    assert "no place for: the machine place of its 0, 10 mm; the friction of 0.3; dwells" in errors


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"windType": "skip", "mandrelRotation": 90.0}, "layer 1: windType 'skip'"),
        ({"windType": "hoop", "terminal": True}, "layer 1: a terminal hoop layer"),
        ({"windType": "helical", "windAngle": 95.0}, "layer 1: windAngle 95: 1 to 89 deg"),
        ({"windType": "helical", "windAngle": True}, "layer 1: windAngle is True"),
        ({"windType": "helical", "windAngle": 30.0}, "layer 1: patternNumber is None"),
        ({"windType": "helical", "windAngle": 30.0, "frictionLambda": 0.1}, "frictionLambda"),
        (None, "layers is no list of layers"),
    ],
)
def test_a_layer_that_is_not_wound_here_is_refused(
    tmp_path: Path, row: dict[str, Any] | None, message: str
) -> None:
    content = {
        "mandrelParameters": {"diameter": 100.0, "windLength": 250.0},
        "towParameters": {"width": 6.05, "thickness": 0.25},
        "layers": [row],
    }
    (tmp_path / "bad.wind").write_text(json.dumps(content))
    with pytest.raises(JobError, match=message):
        read_layers(tmp_path / "bad.wind")
