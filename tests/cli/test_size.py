"""``threadline size`` against the printed figures of the stitcher thesis."""

from __future__ import annotations

import json

import pytest

from threadline.cli.main import main

IN = 0.0254


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stopped:
        main(["size", *arguments])
    captured = capsys.readouterr()
    code = stopped.value.code
    return (0 if code is None else int(code)), captured.out, captured.err


PRODUCT = ("--needle-speed", "75 stitch/s", "--stitch-length", "0.1 in", "--placement", "0.02 in")


def test_json_has_the_printed_speed_and_acceleration(capsys: pytest.CaptureFixture[str]) -> None:
    """7.5 in/s and 281 in/s^2 are printed (281.25); the corner rule by hand, in inches."""
    code, out, err = run(capsys, *PRODUCT, "--json")
    assert (code, err) == (0, "")
    lines = {line["name"]: line for line in json.loads(out)["lines"]}
    assert lines["head speed"]["value"] / IN == pytest.approx(7.5)
    assert lines["ramp acceleration"]["value"] / IN == pytest.approx(281.25)
    rule = 2**0.5 * 7.5**2 / (8 * 0.02)
    assert lines["corner acceleration"]["value"] / IN == pytest.approx(rule)
    assert lines["corner acceleration"]["unit"] == "m/s^2"
    assert all(line["formula"] and line["source"] for line in lines.values())


def test_table_and_warnings_of_the_motor(capsys: pytest.CaptureFixture[str]) -> None:
    """X of the stitcher: 18.9 of 27 A at speed, and Kt and Kv that disagree by 15 %."""
    code, out, err = run(
        capsys, *PRODUCT, "--load-mass", "111 kg", "--pulley-radius", "29 mm",
        "--gear-ratio", "6", "--motor-inertia", "4.75e-4 kg m^2",
        "--motor-damping", "0.24 N m s/rad", "--torque-constant", "0.5 N m/A",
        "--back-emf", "60 V/krpm", "--current-limit", "27 A",
    )  # fmt: skip
    assert code == 0
    assert "18.9 of 27 A" in err
    assert "15 %" in err
    row = next(line for line in out.splitlines() if "cruise current" in line)
    assert "18.91" in row
    assert "eq 2.3" in out


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("--stitch-length", "3"), "--stitch-length"),
        (("--needle-speed", "75 kg"), "--needle-speed"),
        ((), "the demands are not enough for any result"),
        (("--speed", "1 m/s", *PRODUCT), "twice"),
        (("--profile", "square", *PRODUCT), "no profile 'square'"),
        (
            ("--needle-speed", "1e300 stitch/s", "--stitch-length", "1 m"),
            "it must be from 1e-15 to 1e15",
        ),
    ],
)
def test_wrong_input_is_one_line(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], word: str
) -> None:
    code, out, err = run(capsys, *arguments)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert word in err
