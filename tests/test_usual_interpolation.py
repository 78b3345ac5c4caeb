"""On a machine whose firmware plans by itself, the firmware's plan is proved by default."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import threadline as tl
from tests.with_firmware import winder_with_grbl, winder_with_grbl_file
from threadline.cli.main import main
from threadline.errors import OptionError
from threadline.machine import load_machine
from threadline.proof.options import Options, options_of, refuse_axis_options
from threadline.proof.pipeline import open_job, plan_job

PROGRAM = "G21 G90 G94\nG1 X20 F3000\nG1 Y10\nG1 X0 Y0\nM30\n"
PLAIN = "lathe-winder"


@pytest.fixture
def job(tmp_path: Path) -> Path:
    file = tmp_path / "square.ngc"
    file.write_text(PROGRAM)
    return file


def asked(capsys: pytest.CaptureFixture[str], *words: str) -> dict:
    with pytest.raises(SystemExit) as ended:
        main([*words, "--json"])
    assert ended.value.code in (0, 1, None)
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("words", "with_firmware", "without"),
    [
        ({}, "firmware", "auto"),
        ({"interpolation": "auto"}, "auto", "auto"),
        ({"feed_forward": True}, "auto", "auto"),
        ({"interpolation": "linear"}, "linear", "linear"),
    ],
)
def test_the_default_is_of_the_machine(
    job: Path, words: dict, with_firmware: str, without: str
) -> None:
    """Commands for the loads cannot come from a firmware."""
    given = {"interpolation": Options().interpolation, "feed": None, "tolerance": "0.1 mm", **words}
    for machine, expected in ((winder_with_grbl(), with_firmware), (load_machine(PLAIN), without)):
        options = options_of(**given)
        plan = plan_job(open_job(job, machine, options), machine, options)
        assert plan.options["interpolation"] == expected


def test_prove_compare_and_fastest_take_it(
    job: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    machine = str(winder_with_grbl_file(tmp_path))
    where = (str(job), "-m", machine, "--nominal")

    assert asked(capsys, "prove", *where)["interpolation"] == "firmware"
    assert asked(capsys, "prove", *where, "--interpolation", "auto")["interpolation"] == "auto"
    cases = asked(capsys, "compare", *where, "--no-fastest")
    names = [one["interpolation"] for one in cases["proofs"]]
    assert names == ["firmware", "auto"]
    assert tl.prove(job, machine, level="nominal").json()["interpolation"] == "firmware"


def test_compile_writes_a_program_of_its_own(job: Path, tmp_path: Path) -> None:
    """It must be better than the firmware's plan of the old program: the default is auto."""
    machine = str(winder_with_grbl_file(tmp_path))
    rows = {}
    for name, words in (("usual", []), ("auto", ["--interpolation", "auto"])):
        out = tmp_path / f"{name}.csv"
        with pytest.raises(SystemExit) as ended:
            main(["compile", str(job), "-m", machine, "--target", "csv", "-o", str(out), *words])
        assert ended.value.code in (0, None)
        rows[name] = out.read_text()
    tl.compile(job, machine, "csv", tmp_path / "face.csv")
    assert rows["usual"] == rows["auto"] == (tmp_path / "face.csv").read_text()


def test_machines_without_a_path_have_nothing_to_choose() -> None:
    """The default and auto mean nothing in particular there; recordings call it auto."""
    placer = load_machine("letter-placer")
    refuse_axis_options(placer, Options())
    refuse_axis_options(placer, Options(interpolation="auto"))
    with pytest.raises(OptionError, match="--interpolation"):
        refuse_axis_options(placer, Options(interpolation="linear"))
