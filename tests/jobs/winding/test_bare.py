"""The bare mandrel of a wanted outer shape: round trips, a closed form, and impossible shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.jobs.winding.test_sheet import BAND, MANDREL, run
from threadline.jobs.winding.build_up import design
from threadline.jobs.winding.layers import read_layers
from threadline.jobs.winding.thickness import grown

LAYER = '[[layer]]\nturn = "20 mm"\n'


def test_the_layers_on_the_bare_mandrel_end_at_the_drawn_shape(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Wound from its own file, the table grows to hemispheres and a cylinder of 50 mm."""
    drawn = tmp_path / "drawn.wind.toml"
    drawn.write_text(MANDREL + BAND + LAYER, encoding="utf-8")
    table = tmp_path / "bare.csv"
    code, out, err = run(capsys, drawn, "--bare", table)
    assert code == 0, err
    assert "Bare mandrel:" in out
    (on_drawn,) = design(read_layers(drawn))
    parts = MANDREL.partition("[friction]")
    again = tmp_path / "again.wind.toml"
    again.write_text(
        '[[part]]\nkind = "table"\nfile = "bare.csv"\n[friction]' + parts[2] + BAND
        + f'[[layer]]\nturn = "{1e3 * on_drawn.circuit.constant_m!r} mm"\n'
        f"circuits = {on_drawn.pattern.circuits}\nshift = {on_drawn.pattern.shift}\n",
        encoding="utf-8",
    )  # fmt: skip
    (one,) = design(read_layers(again))
    spread = one.spread()
    assert spread is not None
    outside = grown(one.circuit.surface, spread)
    x, r = outside.at(np.linspace(0.0, outside.length_m, 2001))
    bare = np.genfromtxt(table, delimiter=",", skip_header=1)
    # A part begins at 0: the table begins at the drawing's begin, less the layers.
    x[:, 0] += 1e-3 * bare[0, 0]
    assert f"begins {bare[0, 0]:.3f} mm right of the drawing" in out
    # Distance from a cylinder with round ends: the drawn shape, by its own definition.
    left = np.sqrt(0.05**2 - 0.01**2)
    past = np.maximum(np.maximum(left - x[:, 0], x[:, 0] - left - 0.12), 0.0)
    off = np.hypot(past, r[:, 0]) - 0.05
    assert np.abs(off).max() < 1.5e-4
    middle = np.abs(x[:, 0] - left - 0.06) < 0.05
    assert np.abs(off[middle]).max() < 1e-5
    # On the cylinder by hand: two bands in every circuit, spread round the circumference.
    thick = 2.4e-3 / 2550.0 / 0.6 / 8e-3
    radius = 1e-3 * float(np.interp(1e3 * left + 60.0, bare[:, 0], bare[:, 1]))
    around = 2.0 * np.pi * radius * np.cos(one.circuit.angle) / (8e-3 * one.pattern.circuits)
    assert 0.05 - radius == pytest.approx(2.0 * thick / around, abs=1e-5)


@pytest.mark.parametrize(
    ("band", "layers", "message"),
    [
        (
            BAND.replace("2400", "9600"),
            LAYER.replace("20 mm", "24 mm") * 2,
            "no bare mandrel gives this outer shape",
        ),
        ('[band]\nwidth = "8 mm"\n', LAYER, "an outer shape needs the thickness of the band"),
    ],
)
def test_impossible_bare_mandrel_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], band: str, layers: str, message: str
) -> None:
    file = tmp_path / "thick.wind.toml"
    file.write_text(MANDREL + band + layers, encoding="utf-8")
    code, out, err = run(capsys, file, "--bare", tmp_path / "bare.csv")
    assert (code, out) == (2, "")
    last = err.strip().splitlines()[-1]
    assert message in last and "thick.wind.toml" in last
    assert not (tmp_path / "bare.csv").exists()
