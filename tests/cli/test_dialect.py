"""Every command that plans reads a program by the given dialect and radius."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

from threadline.cli.main import main
from threadline.machine.load import library_file

pytestmark = pytest.mark.usefixtures("coarse_search")

# Without M30, with a preamble and a shifted zero: grbl's, and not the printed winder's.
PROGRAM = "G17 G21 G90 G94\nG92 X0\nM3\nG1 X20 A180 F600\nG1 X0 A360\n"
AS_GRBL = ("-m", "lathe-winder", "--dialect", "grbl", "--radius", "A=40 mm")


@pytest.fixture
def job(tmp_path: Path) -> Path:
    file = tmp_path / "part.gcode"
    file.write_text(PROGRAM)
    return file


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, captured.err


@pytest.mark.long(but="compare")
@pytest.mark.parametrize("command", ["compare", "fastest"])
def test_without_a_dialect_it_is_guessed_and_said(
    command: str, job: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A given dialect is never overruled."""
    code, _, err = run(capsys, command, job, "-m", "lathe-winder", "--nominal")
    assert code in (0, 1)
    assert "read in the dialect grbl, guessed from the file (it has" in err
    code, out, err = run(capsys, command, job, "-m", "lathe-winder", "--dialect", "winder")
    assert (code, out) == (2, "")
    assert "part.gcode:1" in err


def test_compare_reads_it_as_prove_does(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """grbl's length of 20 mm and 180 degrees at 600 mm/min: 18.11 s each way."""
    code, out, _ = run(
        capsys,
        "compare",
        job,
        *AS_GRBL,
        "--feed-mode",
        "grbl",
        "--interpolation",
        "linear",
        "--no-fastest",
        "--nominal",
        "--json",
    )
    (compared,) = json.loads(out)["proofs"]
    same = ("--interpolation", "linear", "--nominal", "--json")
    _, proved, _ = run(capsys, "prove", job, *AS_GRBL, "--feed-mode", "grbl", *same)
    assert code in (0, 1)
    assert compared["duration_s"] == json.loads(proved)["duration_s"]
    assert compared["duration_s"] == pytest.approx(2 * (20**2 + 180**2) ** 0.5 / 10, abs=0.02)
    # The radius of A decides the size of its errors.
    assert compared["criteria"] == json.loads(proved)["criteria"]


@pytest.mark.long(shown_by="test_without_a_dialect_it_is_guessed_and_said")
def test_command_printed_by_fastest_proves_the_same_job(
    job: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The printed command proves the same job, with dialect and radius.

    The search may choose only feed and limits, and ends early: a placement limit wider than the
    machine's own 0.5 mm lets one of its first plans pass.
    """
    text = (
        library_file("lathe-winder").with_name("lathe-winder.spec.toml").read_text(encoding="utf-8")
    )
    spec = job.with_name("wide.spec.toml")
    spec.write_text(
        text.replace('"contour_error"\nlimit = "0.5 mm"', '"contour_error"\nlimit = "1 mm"')
    )
    code, out, _ = run(
        capsys, "fastest", job, *AS_GRBL, "--interpolation", "optimal", "--nominal", "-s", spec,
        "--tolerance", "0.3 mm", "--contour", "0.1 mm", "--outside", "0 mm", "--reserve", "10 %",
        "--within", "20 s",
    )  # fmt: skip
    assert code == 0
    (printed,) = re.findall(r"threadline prove .*", out)
    words = shlex.split(printed)
    for name, value in (("--dialect", "grbl"), ("--radius", "A=40 mm")):
        assert words[words.index(name) + 1] == value
    assert run(capsys, *words[1:])[0] == 0
