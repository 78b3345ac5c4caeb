"""Extreme numbers are answered, or refused in one line."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from threadline.cli.main import main

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FASTEST = ["fastest", str(EXAMPLES / "x-180.prg"), "-m", "lathe-winder"]


def run(words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[object, str, str]:
    with pytest.raises(SystemExit) as caught:
        main(words)
    output = capsys.readouterr()
    return caught.value.code or 0, output.out, output.err


@pytest.mark.parametrize(
    ("span", "words"),
    [
        (["--low", "20 mm/s", "--high", "10 mm/s"], "from 0.02 m/s to 0.01 m/s"),
        (["--low", "20 mm/s", "--high", "20 mm/s"], "from 0.02 m/s to 0.02 m/s"),
        (["--high", "0.5 mm/s"], "to 0.0005 m/s"),
    ],
)
def test_an_empty_range_is_told(
    span: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run([*FASTEST, "--interpolation", "linear", *span], capsys)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"nothing to scan {words}" in err.replace("from 0.00992184 m/s ", "")
    assert "Give a --low below --high" in err


MOVE = ["--move", "10 mm", "--acceleration", "1 m/s^2"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--mode", "5e-324Hz", "--kind", "zv"], "frequency_hz must be from 1e-06 to 1e+09"),
        (["--mode", "1e300Hz", "--kind", "zv"], "frequency_hz must be from 1e-06 to 1e+09"),
        (["--mode", "452.6Hz", "--mode", "1e9Hz", "--kind", "zv"], "the ratio 2.209e+06 is beyond"),
        (["--mode", "5Hz", "--kind", "si", "--band", "nan"], "nan"),
        (["--mode", "5Hz", "--kind", "zv", "--band", "inf", *MOVE], "inf"),
    ],
)
def test_shapers_out_of_range_are_refused(
    options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run(["shaper", *options], capsys)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err


@pytest.mark.long(only=("si-modes1", "si-modes2"))
@pytest.mark.parametrize(
    "modes", [("270Hz", "645Hz", "0.7Hz"), ("0.1Hz", "25Hz"), ("0.1Hz", "25Hz", "90Hz")]
)
@pytest.mark.parametrize("kind", ["si", "zvdd", "um-zv"])
def test_modes_far_apart_are_shaped_in_seconds(
    kind: str, modes: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """A grid over all of them took minutes, or did not converge."""
    words = [word for mode in modes for word in ("--mode", mode)]
    began = time.process_time()
    code, out, _ = run(["shaper", *words, "--kind", kind, "--json"], capsys)
    assert time.process_time() - began < 30.0
    assert code == 0
    answer = json.loads(out)
    assert answer["vibration"] <= 0.05 + 1e-9
    assert all(mode["low_hz"] < mode["frequency_hz"] < mode["high_hz"] for mode in answer["modes"])


@pytest.mark.parametrize("mode", ["0.05Hz", "0.01Hz", "0.001Hz", "1e-4Hz"])
def test_a_move_much_shorter_than_the_period_is_its_own_robust_optimum(
    mode: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """In 2 sqrt(L / a) = 0.2 s it rings the mode by less than 1 % of a full step.

    The bound is (omega T / 2)^2 = (2 pi 0.05 0.1)^2 = 0.1 % at most, for T = 0.2 s.
    """
    words = ["shaper", "--mode", mode, "--kind", "zv", *MOVE, "--json"]
    code, out, err = run(words, capsys)
    assert (code, err) == (0, "")
    assert '"robust_optimum_s": 0.2' in out


def test_a_move_that_rings_modes_far_apart_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A grid of 160 intervals over half a period of 0.003 Hz has none for each period of 2 Hz."""
    words = ["shaper", "--mode", "0.003Hz", "--mode", "2Hz", "--kind", "zv", *MOVE]
    began = time.process_time()
    code, out, err = run(words, capsys)
    assert time.process_time() - began < 30.0
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "modes at 0.003 Hz and 2 Hz" in err and "more than 80 times as fast" in err


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        (["size", "--gear-ratio", "3:1"], "'--gear-ratio' must be a number, got '3:1'"),
        (
            ["yield", "a.prg", "-m", "lathe-winder", "--variants", "2.5"],
            "'--variants' must be a whole number, got '2.5'",
        ),
        (
            ["yield", "a.prg", "-m", "lathe-winder", "--variants", "0"],
            "'--variants' must be at least 1, got '0'",
        ),
        (
            ["shaper", "--mode", "5Hz", "--damping", "small"],
            "--damping 'small': 'small' is not a number with a unit",
        ),
    ],
)
def test_a_value_that_is_no_number_is_told_with_what_was_typed(
    typed: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run(typed, capsys)

    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert "Input should" not in err


def test_a_ratio_is_typed_in_percent_or_not(capsys: pytest.CaptureFixture[str]) -> None:
    common = ["shaper", "--mode", "5Hz", "--kind", "si", "--json"]
    per_cent = run([*common, "--damping", "2 %", "--band", "10 %"], capsys)
    assert per_cent[0] == 0
    assert per_cent == run([*common, "--damping", "0.02", "--band", "0.1"], capsys)
