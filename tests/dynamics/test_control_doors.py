"""``threadline control`` and ``tl.control``: the same result, and no half-written file."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

import threadline as tl
from threadline.cli.main import main
from threadline.errors import InputError, MachineError, OptionError
from threadline.machine import load_machine


def status(*words: str) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(list(words))
    assert isinstance(stopped.value.code, int)
    return stopped.value.code


def test_python_and_the_command_write_the_same_machine(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["--design", "preview", "--gain", "2", "--ahead", "3", "--json"]
    assert status("control", "lathe-winder", *words, "-o", "line.toml") == 0
    printed = json.loads(capsys.readouterr().out)
    found = tl.control("lathe-winder", "preview", "python.toml", gain=2.0, ahead=3)
    assert Path("python.toml").read_text() == Path("line.toml").read_text()
    assert {**found.content(), "written": "line.toml"} == printed
    assert found.stable
    assert found.machine.controllers["x-designed"].kind == "state-space"
    assert found.axes["X"].stable


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--design", "lqg", "--ahead", "9"], "--ahead is for the design preview, not for lqg"),
        (["--design", "lqg", "--axes", "X,Y"], "--axes is for the design cross-coupled"),
        (["--design", "preview", "--smoothing", "3"], "--smoothing is for the design zpetc"),
        (["--design", "cross-coupled", "--gain", "9"], "--gain is for the design lqg or preview"),
        (["--design", "cross-coupled", "--sensors", "x_pot"], "--sensors is for the design lqg"),
    ],
)
def test_an_option_of_another_design_is_refused(tmp_path, capsys, words, message):
    file = tmp_path / "no.toml"
    assert status("control", "stitcher", *words, "-o", str(file)) == 2
    assert message in capsys.readouterr().err.replace("\n", " ")
    assert not file.exists()


def test_python_names_its_arguments_in_errors(tmp_path):
    with pytest.raises(OptionError, match="ahead= is for the design preview, not for lqg"):
        tl.control("stitcher", "lqg", tmp_path / "no.toml", ahead=3)
    with pytest.raises(OptionError, match="amplitude= is -1"):
        tl.measure("lathe-winder", "X", amplitude="-1 m")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "odd",
    [
        {"gain": float("nan")}, {"gain": 10**400}, {"gain": -1}, {"ahead": 10**400},
        {"ahead": True}, {"sensors": "x_pot"}, {"sensors": ["x"]},
    ],
)  # fmt: skip
def test_odd_numbers_and_names_are_refused_by_python_in_one_line(tmp_path, odd):
    with pytest.raises(InputError) as caught:
        tl.control("stitcher", "preview", tmp_path / "no.toml", **odd)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_designed_machine_can_be_designed_again(tmp_path):
    """The second file cancels the controllers of the first one, and names its own differently."""
    first = tl.control("lathe-winder", "lqg", tmp_path / "first.toml")
    second = tl.control(first.machine, "lqg", tmp_path / "second.toml", gain=2.0)
    assert second.stable
    assert "x-designed" not in second.machine.controllers
    one, two = (m.controllers[m.axes["X"].controller] for m in (first.machine, second.machine))
    assert one.matrix("D")[0, 0] != two.matrix("D")[0, 0]


def test_a_folder_of_any_name_gives_a_file_that_can_be_read(tmp_path):
    """TOML knows no surrogates: a name beyond 16 bits is one escape of eight digits."""
    folder = tmp_path / 'a "b" \U0001f9f5'
    folder.mkdir()
    (folder / "own.toml").write_text('base = "lathe-winder"\nname = "own"\n')
    found = tl.control(folder / "own.toml", "lqg", tmp_path / "made.toml")
    content = tomllib.loads((tmp_path / "made.toml").read_text())
    assert content["base"] == f"{folder.name}/own.toml"
    assert found.machine.axis_names == found.base.axis_names


@pytest.fixture(name="designed")
def _designed(tmp_path):
    return tl.control("lathe-winder", "lqg", tmp_path / "designed.toml").file


def test_rules_for_one_error_refuse_a_designed_machine_in_words(designed, capsys):
    assert status("tune", str(designed), "--axis", "X") == 2
    output = capsys.readouterr()
    assert "controllers.x-designed or one beside it has the kind state-space" in output.err
    assert output.out == ""
    with pytest.raises(MachineError, match="state-space"):
        tl.tune(designed)


def test_outputs_never_replace_what_the_call_reads(tmp_path):
    """As on the command line: machine files, data and jobs are not overwritten."""
    own, sweep = tmp_path / "own.toml", tmp_path / "sweep.toml"
    own.write_text('base = "stitcher"\nname = "own"\n')
    root = Path(__file__).parents[2] / "examples"
    sweep.write_bytes((root / "stitcher-x-sweep.csv").read_bytes())
    (tmp_path / "job.prg").write_bytes((root / "x-180.prg").read_bytes())
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    numbers = ["links.x_belt.stiffness"]
    for call in (
        lambda: tl.control(own, "lqg", own),
        lambda: tl.control(tl.load_machine(own), "lqg", own),
        lambda: tl.tune(own, own, axis="X"),
        lambda: tl.tune(tl.load_machine(own), own, axis="X"),
        lambda: tl.fit(root / "stitcher-x-sweep.csv", own, numbers, own, axis="X"),
        lambda: tl.compile(tmp_path / "job.prg", "lathe-winder", "nc", tmp_path / "job.prg"),
    ):
        with pytest.raises(InputError, match="is the input"):
            call()
    with pytest.raises(InputError, match="no name for a machine file"):
        tl.tune(own, tmp_path / "tuned.txt", axis="X")
    with pytest.raises(InputError, match="cannot hold a measurement"):
        tl.measure(own, "X", tmp_path / "sweep.txt")
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


@pytest.mark.long(shown_by="test_a_designed_machine_can_be_designed_again")
def test_a_sweep_of_a_designed_machine_finds_the_plant_that_the_old_controller_finds(
    designed, tmp_path
):
    """The response from volts to counts belongs to the plant, with any controller."""
    own, other = (
        tl.measure(machine, "X", band="2 Hz, 20 Hz").response
        for machine in ("lathe-winder", str(designed))
    )
    assert own is not None and other is not None
    np.testing.assert_allclose(other.frequency_hz, own.frequency_hz)
    apart = np.abs(other.value / own.value - 1.0)
    assert np.median(apart) < 0.02 and apart.max() < 0.1  # the DAC's rounding


def test_a_sweep_is_refused_where_volts_are_seen_at_some_ticks_only(tmp_path, capsys):
    machine = load_machine("stitcher")
    coupled = tl.control(machine, "cross-coupled", tmp_path / "coupled.toml").file
    out = tmp_path / "sweep.npz"
    assert status("measure", str(coupled), "--axis", "X", "-o", str(out)) == 2
    output = capsys.readouterr()
    assert "its references come every 1 ms, so that a recording shows" in output.err
    assert output.out == "" and not out.exists()


def test_a_machine_with_other_axes_is_refused_before_anything_is_said(tmp_path, capsys):
    words = ["--axis", "X", "-o", str(tmp_path / "no.npz"), "--actual", "stitcher"]
    assert status("measure", "lathe-winder", *words) == 2
    output = capsys.readouterr()
    assert "stitcher has other axes than lathe-winder" in output.err
    assert output.out == ""
