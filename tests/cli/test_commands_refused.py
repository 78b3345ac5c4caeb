"""Refusals and warnings of commands before the work: one line, and nothing written."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.test_commands import run

pytestmark = pytest.mark.usefixtures("coarse_search")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-m", "lathe-windr"], ["lathe-windr", "Did you mean 'lathe-winder'"]),
        (["-m", "lathe-winder", "--feed", "0 mm/s"], ["feed", "greater than zero"]),
        (["-m", "lathe-winder", "--feed", "fast"], ["feed 'fast'", "count/tick"]),
        (["-m", "stitcher", "--feed", "30 stitch/s"], ['--needle "30 stitch/s"']),
        (["-m", "lathe-winder", "--tolerance", "1 deg"], ["tolerance", "0.1 mm"]),
        (["-m", "lathe-winder", "--interpolation", "liner"], ["liner", "linear"]),
        (["-m", "lathe-winder", "-s", "no-such.toml"], ["no-such.toml"]),
        (["-m", "lathe-winder+x"], ["no overlay 'x'", "physical"]),
    ],
)
def test_wrong_options_exit_with_two_and_one_line(
    arguments: list[str], words: list[str], examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run(capsys, "prove", examples / "x-180.prg", *arguments)

    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("error: [")
    for word in words:
        assert word in err


@pytest.mark.parametrize(
    ("command", "job", "arguments", "words"),
    [
        ("compile", "letter-cycle.toml", ["--mode", "3 Hz"], ["Give --shaper too"]),
        ("compile", "letter-cycle.toml", ["--shaper", "zv", "--mode", "0 Hz"], ["positive"]),
        (
            "compile",
            "letter-cycle.toml",
            ["--limits", "50 %"],
            ["takes no --limits, ", "switches cylinders on and off"],
        ),
        (
            "fastest",
            "letter-cycle.toml",
            ["--feed-forward"],
            ["letter-placer takes no --feed-forward"],
        ),
        ("compile", "x-180.prg", ["--shaper", "zv:12Hz", "--mode", "3 Hz"], ['"zv:12Hz:0.02"']),
        ("compile", "x-180.prg", ["--feed-forward", "--smoothing", ""], ["not a number"]),
        ("fastest", "strap.seam.toml", ["--smoothing", "36 ms"], ["Give --feed-forward too"]),
        ("fastest", "strap.seam.toml", ["--report", "file"], ["not a folder"]),
        ("fastest", "strap.seam.toml", ["--mismatch", "--report", "file"], ["not a folder"]),
        ("fastest", "letter-cycle.toml", ["--low", "1 mm/s"], ["commands and waits are searched"]),
        ("fastest", "strap.seam.toml", ["--high", "1e6 stitch/s"], ["at most 1000", "--high"]),
        ("fastest", "strap.seam.toml", ["--margin", "100 %"], ["below 100 %", '"20 %"']),
        (
            "fastest",
            "x-180.prg",
            ["--margin", "1 mm"],
            ["a plain number or a percentage", '"20 %"'],
        ),
        ("design", "strap.seam.toml", ["--feed-forward", "--smoothing", ""], ["not a number"]),
        (
            "fastest",
            "x-180.prg",
            ["--interpolation", "optimal", "--low", "1 mm/s"],
            ["a search by feed", "Leave it out"],
        ),
        ("compare", "x-180.prg", ["--contour", "0.2 mm"], ["linear", "--interpolation optimal"]),
        (
            "design",
            "strap.seam.toml",
            ["--interpolation", "optimal", "--feed-forward", "--contour", "0.2 mm"],
            ["--contour", "the loads follow"],
        ),
    ],
)
def test_options_that_do_not_fit_are_refused_before_the_work(
    command: str,
    job: str,
    arguments: list[str],
    words: list[str],
    examples: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    machine = {".toml": "letter-placer", ".prg": "lathe-winder"}.get("".join(Path(job).suffixes))
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    out_file = ["--target", "st", "-o", "made.st"] if command == "compile" else []
    code, out, err = run(
        capsys, command, examples / job, "-m", machine or "stitcher", *out_file, *arguments
    )
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    for word in words:
        assert word in err


@pytest.mark.parametrize("words", [["prove", "--tolerances"], ["yield", "--variants", "2"]])
def test_the_worst_machine_has_a_name_that_commands_take(
    words: list[str], tmp_path: Path, examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Otherwise the printed command would name a file that --actual looks up in the library."""
    file, winder = tmp_path / "worst.txt", ["-m", "lathe-winder"]
    verb, *level = words

    code, out, err = run(
        capsys, verb, examples / "x-180.prg", *winder, *level, "--worst", str(file)
    )

    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "ends in .toml" in err and not file.exists()


def test_missing_job_exits_with_two(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "prove", "no-such-job.prg", "-m", "lathe-winder")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "no-such-job.prg" in err


def test_a_refused_job_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The last line leaves the travel: not a byte of the table may be written."""
    job = tmp_path / "far.prg"
    job.write_text("%\nO 1;\nN 10 G01 G90 F 600;\nN 20 X 10;\nN 30 X 900;\nN 40 M30;\n%\n")
    out_file = tmp_path / "far.csv"
    code, _, err = run(
        capsys, "compile", job, "-m", "lathe-winder", "--target", "csv", "-o", out_file
    )

    assert code == 2
    assert "far.prg:5" in err
    assert "900" in err
    assert [p.name for p in tmp_path.iterdir()] == ["far.prg"]


@pytest.mark.parametrize(
    "command",
    [
        ["prove"],
        ["prove", "--json"],
        ["compile", "--target", "csv", "-o", "inches.csv"],
        ["compare", "--no-fastest", "--interpolation", "linear"],
    ],
    ids=lambda command: " ".join(command[:2]),
)
def test_every_command_that_plans_gives_the_warnings(
    command: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("inches.prg").write_text("O9\nG91 G1 X 0.1 F 90\nM99\nO1\nG20\nM98 P9\nM30\n")
    verb, *options = command
    code, _, err = run(capsys, verb, "inches.prg", "-m", "lathe-winder", *options)

    assert code == 0
    assert err.count("warning: inches.prg:2: F 90 is 38.1 mm/s, above the normal feed") == 1


@pytest.mark.parametrize(
    "command",
    [
        ["prove", "--feed", "10 mm/s"],
        ["fastest", "--low", "10 mm/s", "--high", "11 mm/s", "--interpolation", "linear"],
    ],
    ids=lambda command: command[0],
)
def test_a_feed_that_is_not_in_force_is_no_doubt(
    command: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("inches.prg").write_text("G91 G64 G1 X 2 F 2400\nX -2\nM30\n")
    verb, *options = command
    _, _, err = run(capsys, verb, "inches.prg", "-m", "lathe-winder", "--nominal", *options)

    assert "G64 is for other controllers" in err  # the other warnings stay
    assert "normal feed" not in err


def test_a_missing_argument_is_described(capsys: pytest.CaptureFixture[str]) -> None:
    """With --merge the argument JOB takes the files of parts, which its name does not tell."""
    code, out, err = run(capsys, "yield", "--merge")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "'JOB': part program" in err and "with --merge, the files of all parts" in err
