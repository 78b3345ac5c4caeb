"""``threadline tune --trim``: wrong gains of amplifiers, found from runs within the travel."""

from __future__ import annotations

import json

import pytest

import threadline as tl
from threadline.cli.main import main
from threadline.machine import load_machine
from threadline.machine.numbers import number_at

OFF = {"x": 1.08, "y": 0.95, "a": 1.03}


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as left:
        main(["tune", *map(str, arguments)])
    out = capsys.readouterr()
    return left.value.code or 0, out.out, out.err


@pytest.fixture(scope="module", params=["lathe-winder", "lathe-winder+stiction"])
def off(request, tmp_path_factory):
    """Return the machine of the file, and one whose three amplifiers are off."""
    file = tmp_path_factory.mktemp("trim") / "off.toml"
    gains = [
        f'[drives.{name}.amplifier]\ngain = "{0.45 * factor:.5f} exact, assumed"'
        for name, factor in OFF.items()
    ]
    file.write_text("\n".join([f'base = "{request.param}"', 'name = "off"', *gains]))
    return request.param, file


@pytest.mark.usefixtures("forked_machine")
@pytest.mark.long(only="lathe-winder+stiction")
def test_gains_that_are_off_are_found_within_half_a_percent(off, capsys, tmp_path):
    """+8, -5 and +3 %, as factors for the potentiometers; friction does not matter."""
    machine, actual = off
    out_file = tmp_path / "as-found.toml"
    code, out, err = run(capsys, machine, "--trim", "--actual", actual, "-o", out_file, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)["axes"]
    assert set(answer) == {"A", "X", "Y"}
    for axis, one in answer.items():
        assert one["factor"] == pytest.approx(1 / OFF[axis.lower()], rel=5e-3)
        assert one["interval"] < 5e-3
        found = number_at(load_machine(str(out_file)), f"drives.{axis.lower()}.amplifier.gain")
        assert found.si == pytest.approx(0.45 * OFF[axis.lower()], rel=5e-3)
        assert found.provenance.value == "measured"


@pytest.mark.usefixtures("forked_machine")
def test_the_same_from_python_and_for_people(capsys):
    (one,) = tl.trim("lathe-winder", "X")
    assert one.factor == pytest.approx(1.0, abs=2e-3)
    code, out, _ = run(capsys, "lathe-winder", "--trim", "--axis", "X")
    assert code == 0 and "turn gain by" in out
