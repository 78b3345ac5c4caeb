"""``threadline analyse``: keys, exit codes, measured data, report, wrong input."""

from __future__ import annotations

import json

import numpy as np
import pytest

from threadline.cli.main import main
from threadline.errors import RecordingError
from threadline.identify.read_response import read_response

from . import reference as ref

KEYS = {"bandwidth_hz", "gain_margin", "phase_margin_deg", "modes_hz", "dc_gain", "stable"}


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as left:
        main(["analyse", *arguments])
    out = capsys.readouterr()
    return left.value.code or 0, out.out, out.err


def test_json_has_the_keys_of_the_design(capsys):
    code, out, _ = run(capsys, "stitcher-rigid", "--json")
    content = json.loads(out)
    assert code == 0 and set(content["axes"]) == {"X", "Y"} and content["stable"] is True
    for axis, bandwidth in (("X", 33), ("Y", 36)):
        found = content["axes"][axis]
        assert set(found) >= KEYS
        assert found["bandwidth_hz"] == pytest.approx(bandwidth, rel=0.08)
        assert found["modes_hz"] == []
    assert any("disagree by 15 %" in w for w in content["warnings"])


def test_unstable_loop_exits_with_1_and_says_the_margin(capsys):
    code, out, _ = run(capsys, "stitcher+head-feedback", "--axis", "X")
    assert code == 1
    assert "the loop is UNSTABLE (2 poles); it is at its limit at 0.623 times the gain" in out


def test_lead_filters_are_designed_on_the_way(capsys):
    """The printed 13.5 Hz and 65.8 deg give back 0.89 (z - 0.976)/(z + 0.004), within 10 %."""
    code, out, _ = run(
        capsys, "stitcher-rigid", "--axis", "X", "--lead", "13.5 Hz, 65.8 deg", "--json"
    )
    found = json.loads(out)["axes"]["X"]
    assert code == 0
    assert found["crossover_hz"] == pytest.approx(13.5, rel=1e-9)
    assert found["phase_margin_deg"] == pytest.approx(65.8, abs=1e-6)
    assert found["lead"]["gain_dac_per_count"] == pytest.approx(0.89, rel=0.1)
    assert 1 - found["lead"]["zero"] == pytest.approx(1 - 0.976, rel=0.1)
    assert found["lead"]["pole"] == pytest.approx(0.004, rel=0.1)


def test_experiments_are_made_with_the_filters_that_were_designed(capsys):
    """With a crossover at 4 Hz the smallest step rises at least 3 times as slowly as at 13.5 Hz.

    A first-order loop rises in 2.2 / (2 pi f): 88 ms and 26 ms. Once the printed filters of the
    machine, which cross at 13.5 Hz, were used for any design.
    """
    rise_s = {}
    for asked in ("13.5 Hz, 65.8 deg", "4 Hz, 80 deg"):
        machine = ("stitcher-rigid", "--axis", "X")
        _, out, _ = run(capsys, *machine, "--lead", asked, "--experiments", "--json")
        smallest = json.loads(out)["axes"]["X"]["experiments"]["steps"][0]
        rise_s[asked] = smallest["rise_s"]
    assert rise_s["4 Hz, 80 deg"] > 3.0 * rise_s["13.5 Hz, 65.8 deg"]


@pytest.fixture
def measured_csv(tmp_path):
    """Return a sweep of X like the thesis' analyser: 1-200 Hz, with exact dead time and noise."""
    hertz = np.geomspace(1, 200, 150)
    s = 2j * np.pi * hertz
    speed = s * ref.motor_angle(ref.X, s) * np.exp(-s * ref.TAU)
    still = ref.X["Ka"] * ref.KT
    still /= ref.R * (ref.X["B"] + ref.X["b"] * ref.RATIO**2) + ref.KT * ref.KV
    noise = np.random.default_rng(3).normal(scale=0.2, size=len(hertz))
    file = tmp_path / "sweep.csv"
    lines = ["frequency_hz,magnitude_db,phase_deg"]
    lines += [
        f"{f},{20 * np.log10(abs(g) / still) + n},{np.degrees(np.angle(g))}"
        for f, g, n in zip(hertz, speed, noise, strict=True)
    ]
    file.write_text("\n".join(lines) + "\n")
    return file


@pytest.mark.long(shown_by="test_wrong_data_names_the_line")
def test_measured_data_is_laid_over(capsys, measured_csv, tmp_path):
    """The model misses its own noisy sweep by that noise; a wrong mass misses by far more."""
    folder = tmp_path / "report"
    code, out, _ = run(
        capsys, "stitcher", "--axis", "X", "--data", str(measured_csv),
        "--report", str(folder), "--json",
    )  # fmt: skip
    content = json.loads(out)
    found = content["axes"]["X"]["measured"]
    assert code == 0 and found["points"] == 150
    assert 0.1 < found["rms_db"] < 0.5 and found["rms_deg"] < 0.01
    page = (folder / "analysis.html").read_text()
    for name in ("bode", "plant", "nyquist", "nichols", "locus", "steps"):
        assert f'id="{name}-X"' in page and (folder / f"analysis-{name}-X.png").exists()
    assert "UNSTABLE" not in page
    _, out, _ = run(
        capsys, "stitcher+half-mass", "--axis", "X", "--data", str(measured_csv), "--json"
    )
    assert json.loads(out)["axes"]["X"]["measured"]["rms_db"] > 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["stitcher", "--axis", "Q"], "machine 'stitcher' has no axis 'Q'. It has: X, Y."),
        (["no-such"], "no machine 'no-such'"),
        (["letter-placer", "--axis", "Q"], "'letter-placer' has no axis 'Q'. It has: X, Z."),
        (["letter-placer", "--experiments"], "axis X of 'letter-placer' has none"),
        (["letter-placer", "--lead", "13 Hz, 60 deg"], "--lead needs a loop, and axis X"),
        (["stitcher", "--data", "sweep.csv"], "Name it with --axis"),
        (["stitcher", "--lead", "13 Hz"], "is not a crossover and a margin"),
        (["stitcher", "--lead", "13 mm, 60 deg"], "does not measure the same quantity as 'Hz'"),
        (["lathe-winder", "--lead", "3 Hz, 60 deg"], "controllers.a of axis A is no lead filter"),
    ],
)
def test_wrong_input_is_one_line(capsys, arguments, message):
    code, out, err = run(capsys, *arguments)
    assert code == 2 and message in err and err.count("\n") == 1 and not out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "1: column 'frequency_hz' is missing"),
        ("frequency_hz,phase_deg\n1,2\n", "1: column 'magnitude_db' is missing"),
        ("frequency_hz,magnitude_db,phase_deg\n1,2\n", "2: '1,2' does not hold three numbers"),
        ("frequency_hz,magnitude_db,phase_deg\n1,2,nan\n", "2: '1,2,nan' must hold finite"),
        (
            "frequency_hz,magnitude_db,phase_deg\n2,0,0\n2,0,0\n",
            "3: frequency 2 Hz does not increase",
        ),
        ("frequency_hz,magnitude_db,phase_deg\n", "the file holds no points"),
    ],
)
def test_wrong_data_names_the_line(text, message, tmp_path):
    file = tmp_path / "sweep.csv"
    file.write_text(text)
    with pytest.raises(RecordingError) as caught:
        read_response(file)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("gain", "place", "words"),
    [
        (
            "0",
            "mine.toml: axes.X: controllers.x",
            "gives 0 V for any error, so there is no loop to analyse. Correct its gains.",
        ),
        ("1e300", "mine.toml:4: controllers.x.gain", "are 0 or from 1e-15 to 1e+15."),
        ("1e-300", "mine.toml:4: controllers.x.gain", "are 0 or from 1e-15 to 1e+15."),
    ],
)
def test_a_gain_without_a_loop_is_told_in_one_line(capsys, tmp_path, gain, place, words):
    """A warning of numpy would fail the test; once it stood above the tables."""
    path = tmp_path / "mine.toml"
    path.write_text(
        'base = "stitcher-rigid"\nname = "mine"\n'
        f'[controllers.x]\ngain = "{gain} dac/count exact, assumed"\n'
    )
    code, out, err = run(capsys, str(path), "--axis", "X", "--json")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"error: [MACHINE] {place}")
    assert words in err
