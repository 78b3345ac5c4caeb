"""``threadline law``: the table of laws, compared with closed forms of the literature."""

from __future__ import annotations

import json
import math

import pytest

from threadline.cli.main import main

PI = math.pi


def ran(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int | str | None, str, str]:
    with pytest.raises(SystemExit) as caught:
        main(["law", *arguments])
    captured = capsys.readouterr()
    return caught.value.code, captured.out, captured.err


@pytest.mark.parametrize(
    ("name", "cv", "ca", "cj"),
    [
        ("cycloidal", 2.0, 2 * PI, 4 * PI**2),
        ("modified-sine", 4 * PI / (4 + PI), 4 * PI**2 / (4 + PI), 16 * PI**3 / (4 + PI)),
        ("simple-harmonic", PI / 2, PI**2 / 2, None),
        ("3-4-5", 1.875, 10 / math.sqrt(3), 60.0),
    ],
)
def test_json_has_the_published_characteristics(
    name: str, cv: float, ca: float, cj: float | None, capsys: pytest.CaptureFixture[str]
) -> None:
    """Cv, Ca, Cj by their formulas, up to the rounding of floats; null if infinite."""
    code, out, err = ran(capsys, name, "--json")
    content = json.loads(out)
    assert (code, err) == (0, "")
    assert content["Cv"] == pytest.approx(cv, rel=1e-12)
    assert content["Ca"] == pytest.approx(ca, rel=1e-12)
    assert content["Cj"] is None if cj is None else content["Cj"] == pytest.approx(cj, rel=1e-12)


def test_the_efficiency_is_that_of_the_heat(capsys: pytest.CaptureFixture[str]) -> None:
    """The cubic law has the least heat, 12; the cycloidal law has 2 pi^2 (sin squared)."""
    _, out, _ = ran(capsys, "--json")
    laws = json.loads(out)["laws"]
    assert laws["cubic"]["efficiency"] == pytest.approx(1.0, rel=1e-9)
    assert laws["cycloidal"]["efficiency"] == pytest.approx(12.0 / (2.0 * PI**2), rel=1e-9)


def test_people_get_a_table_and_a_hint(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = ran(capsys)
    assert code == 0
    assert "modified-trapezoid" in out
    assert "infinite" in out
    code, out, err = ran(capsys, "modified-sin")
    assert (code, out) == (2, "")
    assert "Did you mean 'modified-sine'?" in err


@pytest.mark.parametrize("option", ["--move", "--time", "--mass", "--residual", "--limit"])
def test_a_number_that_is_not_positive_is_told_by_its_option(
    option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    units = {"--move": "mm", "--time": "ms", "--mass": "kg", "--residual": "mm", "--limit": "m/s^2"}
    given = {"--move": "16.5 mm", "--time": "120 ms", "--residual": "0.05 mm"}
    given[option] = text = f"0 {units[option]}"
    words = [word for pair in given.items() for word in pair]
    code, out, err = ran(capsys, "cycloidal", "--mode", "12Hz", *words)
    assert (code, out) == (2, "")
    assert f"{option} '{text}' must be greater than 0, and finite. Write it like {option}" in err
