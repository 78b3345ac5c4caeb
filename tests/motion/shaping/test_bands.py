"""Several modes with a tolerance and a band each: positive, unit magnitude, on/off moves."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.optimize import linprog

from threadline.cli.main import main
from threadline.motion.shaping import Requirement, unit_magnitude_over_bands
from threadline.motion.shaping.designs import simulated_vibration
from threadline.motion.shaping.onoff.body_and_modes import RestToRest, rings_within, worst_of_each
from threadline.motion.shaping.onoff.robust import robust_optimum
from threadline.motion.shaping.types import FlexibleMode, Shaper

MODES = ("--mode", "3.04Hz:0.0089:20%", "--mode", "8Hz:0.02:10%:4%")
ASKED = ((3.04, 0.0089, 0.2, 0.05), (8.0, 0.02, 0.1, 0.04))


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stopped:
        main(list(words))
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, captured.err


def worst(train: Shaper, f: float, zeta: float, half: float) -> float:
    """Return the vibration of the simulated oscillator over the band."""
    at = f * np.linspace(1.0 - half, 1.0 + half, 81)
    return max(simulated_vibration(train, float(one), zeta) for one in at)


@pytest.mark.parametrize("kind", ["si", "um-si"])
def test_every_mode_keeps_its_own_tolerance_over_its_own_band(
    kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(capsys, "shaper", *MODES, "--kind", kind, "--json")
    content = json.loads(out)
    assert code == 0
    train = Shaper(amplitudes=np.array(content["amplitudes"]), times_s=np.array(content["times_s"]))
    for f, zeta, half, tolerance in ASKED:
        assert worst(train, f, zeta, half) <= tolerance * (1.0 + 1e-6)
        # A stricter band fails: the bands are only just met.
        assert worst(train, f, zeta, 1.25 * half) > tolerance
    if kind == "um-si":
        assert set(np.round(train.levels, 9)) == {0.0, 1.0}
    assert [m["tolerance"] for m in content["modes"]] == [0.05, 0.04]


def level_exists(duration_s: float, cells: int) -> bool:
    """Return whether levels in [0, 1] of this many cells meet ASKED: an independent program.

    Octagons around the circles demand less than the circles: if no level exists here, none does
    there.
    """
    edges = np.linspace(0.0, duration_s, cells + 1)
    rows, most = [], []
    for f, zeta, half, tolerance in ASKED:
        for one in f * np.linspace(1.0 - half, 1.0 + half, 9):
            s = 2 * np.pi * one * (zeta + 1j * np.sqrt(1 - zeta**2))
            wave = np.exp(s * (edges - duration_s))
            for turn in np.exp(0.25j * np.pi * np.arange(8)):
                rows.append(((wave[:-1] - wave[1:]) * turn).real)
                most.append(tolerance - float((wave[-1] * turn).real))
    found = linprog(np.zeros(cells), A_ub=np.array(rows), b_ub=most, bounds=(0.0, 1.0))
    return bool(found.status == 0)


def test_unit_magnitude_over_bands_is_nearly_the_shortest() -> None:
    """6 % sooner no level between 0 and 1 does it, switched or not."""
    expected = [Requirement(FlexibleMode(f, z), most, half) for f, z, half, most in ASKED]
    train = unit_magnitude_over_bands(expected)
    assert level_exists(1.01 * train.duration_s, 200)
    assert not level_exists(0.94 * train.duration_s, 200)


@pytest.mark.long(shown_by="test_every_mode_keeps_its_own_tolerance_over_its_own_band")
def test_robust_move_of_two_modes_with_bands_of_their_own() -> None:
    modes = (FlexibleMode(3.04, 0.0089), FlexibleMode(8.0, 0.02))
    move = RestToRest(0.2, 1.0, modes)
    own = robust_optimum(move, relative=(0.2, 0.1), tolerance=(0.02, 0.1), intervals=80)
    assert rings_within(own, modes, (0.2, 0.1), (0.0202, 0.101))
    wide = robust_optimum(move, relative=0.2, tolerance=0.02, intervals=80)
    assert own.duration_s < wide.duration_s
    first, second = worst_of_each(own, modes, (0.2, 0.1))
    assert first == pytest.approx(0.02, rel=0.02)
    assert second > 0.02


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["3Hz:0.01:20%", "3.5Hz:0.01:10%"], ["overlap from 3.15 to 3.6 Hz"]),
        (["3Hz:0.01:120%"], ["band must be between 0 and 100 %", "120%"]),
        (["3Hz:0.01:x"], ["'x' is not a number"]),
        (["3Hz:0.01:20%:0"], ["tolerance must be between"]),
        (["3Hz:0.01:1%:1%:1%"], ["cannot be read", "3.04Hz:0.0089:20%:5%"]),
    ],
)
def test_bands_that_cannot_be(
    arguments: list[str], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    modes = [word for mode in arguments for word in ("--mode", mode)]
    code, out, err = run(capsys, "shaper", *modes, "--kind", "si")
    assert (code, out, err.count("\n")) == (2, "", 1)
    for word in words:
        assert word in err


def test_a_band_is_of_si_of_ticks_or_of_a_move(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(capsys, "shaper", "--mode", "3Hz:0.01:20%", "--kind", "zv")
    assert code == 2
    assert "20%, has no effect on the kind zv" in err


def test_ticks_keep_each_band(capsys: pytest.CaptureFixture[str]) -> None:
    """No mode is worse than with the nearest ticks and its own tolerance."""
    code, out, _ = run(capsys, "shaper", *MODES, "--kind", "um-si", "--tick", "1 ms", "--json")
    assert code == 0
    for over in json.loads(out)["bands"]:
        assert over["worst"] <= max(over["nearest_worst"], over["tolerance"]) * (1 + 1e-9)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--mode", "3.04Hz", "--mode", "8Hz", "--kind", "um-si", "--tick", "10ms"), "were asked"),
        (("--mode", "3.04Hz:0:20%", "--kind", "um-si", "--tick", "20ms"), "within the band of"),
    ],
)
def test_a_band_that_ticks_do_not_keep_is_told(
    words: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The largest of the printed band exceeds 5 %."""
    code, _, err = run(capsys, "shaper", *words)
    assert code == 0
    assert any(message in line and "more than the 5 %" in line for line in err.splitlines())


def test_a_train_that_rings_more_than_none_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """154 % at the mode: 200 ms between switchings are longer than the half period of 164 ms."""
    words = (
        "shaper",
        "--mode",
        "3.04Hz",
        "--damping",
        "0.17",
        "--kind",
        "um-2ei",
        "--tick",
        "10 ms",
    )
    code, out, err = run(capsys, *words, "--dwell", "200 ms")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "leaves 154 % at 3.04 Hz itself, more than no shaper at all" in err
