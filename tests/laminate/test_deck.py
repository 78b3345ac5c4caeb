"""Shell models of windings, solved by CalculiX and compared with statics."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from tests.jobs.winding.test_sheet import BAND, MANDREL, run
from threadline.errors import JobError
from threadline.jobs.winding.build_up import design, rings_of
from threadline.jobs.winding.layers import read_layers
from threadline.laminate.theory import Layered, laminate_of

SHORT = MANDREL.replace("120 mm", "80 mm") + BAND
LAYERS = '[[layer]]\nturn = "20 mm"\n[[layer]]\nkind = "hoop"\n'
SOLVER = shutil.which("ccx")


def test_rings_hold_the_fibre_of_their_layers(tmp_path: Path) -> None:
    """The volume of all rings, by Pappus at the middle of the thickness, equals the bands'."""
    file = tmp_path / "short.wind.toml"
    file.write_text(SHORT + LAYERS, encoding="utf-8")
    laid = design(read_layers(file))
    rings, materials = rings_of(laid)
    middle = rings.middle
    lengths = np.hypot(*(middle[2::2] - middle[:-2:2]).T)
    volume = float((2.0 * math.pi * middle[1::2, 1] * lengths * rings.thickness_m).sum())
    bands = sum(
        (one.length_m + one.dwells_m) * 8e-3 * (one.layer.band.thickness or 0.0) for one in laid
    )
    assert volume == pytest.approx(bands, rel=0.02)
    assert list(materials) == ["MATERIAL_1"]
    at = len(rings.plies) // 2
    angle = laid[0].circuit.angle
    assert [ply.angle for ply in rings.plies[at]] == pytest.approx(
        [angle, -angle, -angle, angle, 0.5 * math.pi], abs=1e-9
    )
    for ring in rings.plies:
        plies = [(materials[p.material].stiffness(p.angle), p.thickness) for p in ring]
        assert abs(sum(q[0, 2] * t for q, t in plies)) < 1e-3


def test_a_shell_model_needs_a_material(tmp_path: Path) -> None:
    file = tmp_path / "bare.wind.toml"
    file.write_text(
        f'{MANDREL}[band]\nwidth = "8 mm"\n[[layer]]\nturn = "20 mm"\n', encoding="utf-8"
    )
    with pytest.raises(JobError, match="a shell model needs the material of layer 1"):
        rings_of(design(read_layers(file)))


def test_bad_loads_are_refused_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "short.wind.toml"
    file.write_text(SHORT + LAYERS, encoding="utf-8")
    for words, message in (
        (("--pressure", "10 bar"), "Add --deck NAME.inp"),
        (("--pressure", "0 bar", "--deck", tmp_path / "a.inp"), "above 0 and at most 10000 bar"),
        (("--pressure", "20000 bar", "--deck", tmp_path / "a.inp"), "at most 10000 bar"),
        (("--pressure", "10 mm", "--deck", tmp_path / "a.inp"), "--pressure"),
    ):
        code, out, err = run(capsys, file, *words)
        assert (code, out) == (2, "") and message in err
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.skipif(SOLVER is None, reason="CalculiX is not installed (Debian: calculix-ccx)")
def test_calculix_finds_the_hoop_stress_of_the_cylinder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By statics p r over the thickness on the cylinder, and p r / 2 on a hemisphere.

    The stress of every ply on the cylinder agrees with lamination theory.
    """
    file = tmp_path / "short.wind.toml"
    file.write_text(SHORT + LAYERS, encoding="utf-8")
    deck = tmp_path / "short.inp"
    code, out, _ = run(capsys, file, "--deck", deck, "--pressure", "20 bar")
    assert code == 0 and "Shell model:" in out
    assert SOLVER is not None
    output = subprocess.run(
        [SOLVER, deck.stem], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert "*ERROR" not in output.stdout
    found = _stresses(tmp_path / "short.dat")
    laid = design(read_layers(file))
    rings, materials = rings_of(laid)
    thickness = rings.thickness_m

    def hoop_stress(ring: int) -> float:
        total = 0.0
        for layer, ply in enumerate(rings.plies[ring], start=1):
            along, across, shear = found[ring + 1, layer]
            c, s = math.cos(ply.angle), math.sin(ply.angle)
            total += ply.thickness * (s * s * along + c * c * across - 2.0 * s * c * shear)
        return total / float(thickness[ring])

    middle = len(rings.plies) // 2
    expected = 2e6 * 0.05 / float(thickness[middle])
    assert hoop_stress(middle) == pytest.approx(expected, rel=0.02)
    dome = int(np.argmin(np.abs(rings.inside[1::2, 1] - 0.042)))
    expected = 0.5 * 2e6 * 0.05 / float(thickness[dome])
    assert hoop_stress(dome) == pytest.approx(expected, rel=0.04)

    layered = [(materials[p.material], p.angle, p.thickness) for p in rings.plies[middle]]
    stiffness = laminate_of([Layered(*one) for one in layered])
    strain = np.linalg.solve(stiffness.a, [2e6 * 0.05 / 2.0, 2e6 * 0.05, 0.0])
    for layer, (material, angle, _) in enumerate(layered, start=1):
        c, s = math.cos(angle), math.sin(angle)
        x, y, xy = material.stiffness(angle) @ strain
        fibre = c * c * x + s * s * y + 2.0 * c * s * xy
        assert found[middle + 1, layer][0] == pytest.approx(fibre, rel=0.03)


def _stresses(file: Path) -> dict[tuple[int, int], np.ndarray]:
    """Return the mean stresses along, across and in shear, Pa, by ring and layer."""
    rows = defaultdict(list)
    text = file.read_text(encoding="utf-8").partition("stresses")[2]
    for line in text.splitlines():
        words = line.split()
        name = re.match(r"O_(\d+)_\d+_(\d+)", words[-1]) if len(words) == 9 else None
        if name:
            rows[int(name[1]), int(name[2])].append([float(words[k]) for k in (2, 3, 5)])
    return {key: 1e6 * np.mean(values, axis=0) for key, values in rows.items()}
