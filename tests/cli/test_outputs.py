"""Outputs of a command: refused before the work, or written whole, or not at all."""

from __future__ import annotations

import errno
import zipfile
from pathlib import Path

import pytest

import threadline as tl
from threadline.cli import prove
from threadline.cli.main import main
from threadline.cli.output import print_table
from threadline.report import pdf
from threadline.report import proof as report_of_proofs

pytestmark = pytest.mark.usefixtures("coarse_search")

JOB = Path(__file__).resolve().parents[2] / "examples" / "x-180.prg"


def stopped(
    capsys: pytest.CaptureFixture[str], *arguments: str | Path
) -> tuple[int | str | None, str]:
    """Prove the reversal test in this process; returns exit status and errors."""
    words = ["prove", JOB, "-m", "lathe-winder", "--interpolation", "linear", *arguments]
    with pytest.raises(SystemExit) as caught:
        main([str(word) for word in words])
    captured = capsys.readouterr()
    assert captured.out == ""
    return caught.value.code, captured.err


def never(*_: object) -> None:
    raise AssertionError("the work was begun")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--report", "FILE"], "is not a folder"),
        (["--report", "FILE/deep/report"], "is not a folder"),
        (["--recording", "FILE/r.npz"], "is not a folder"),
        (["--recording", "FOLDER"], "it is a folder"),
    ],
)
def test_unwritable_output_is_refused_before_the_work(
    options: list[str],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "FILE").write_text("mine")
    (tmp_path / "FOLDER").mkdir()
    monkeypatch.setattr(prove, "prove_job", never)
    code, err = stopped(capsys, options[0], tmp_path / options[1])
    assert (code, err.count("\n")) == (2, 1)
    assert words in err
    assert (tmp_path / "FILE").read_text() == "mine"


def test_folders_on_the_way_to_a_file_are_made_and_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the command line and the package alike; the folder of a report was named by the user."""
    monkeypatch.chdir(tmp_path)
    for option, place, made in (
        ("-o", "mistyped/deep/x.csv", ["mistyped", "mistyped/deep"]),
        ("-o", "mistyped/y.csv", []),
    ):
        words = ["compile", JOB, "-m", "lathe-winder", "--target", "csv", option, place]
        with pytest.raises(SystemExit) as caught:
            main([str(word) for word in words])
        errors = capsys.readouterr().err
        assert caught.value.code == 0 and (tmp_path / place).is_file()
        assert [line for line in errors.splitlines() if line.startswith("made")] == [
            f"made the folder {folder}" for folder in made
        ]
    with pytest.raises(SystemExit):
        main(["new", "winder", "way/to/mine"])
    errors = capsys.readouterr().err
    assert "made the folder way/to\n" in errors and "mine" not in errors
    (file,) = tl.compile(JOB, "lathe-winder", "csv", tmp_path / "face" / "x.csv")
    assert file.path.is_file()
    assert capsys.readouterr().err == ""


def test_a_report_that_fails_takes_the_recording_with_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An old recording stays, a new one does not appear, and no temporary file is left."""

    def fails(*_: object) -> None:
        raise OSError(28, "No space left on device", "report.html")

    monkeypatch.setattr(report_of_proofs, "write_report", fails)
    old = tmp_path / "old.npz"
    old.write_text("old")
    for file in (old, tmp_path / "new.csv", tmp_path / "made" / "for" / "it.npz"):
        code, err = stopped(capsys, "--recording", file, "--report", tmp_path / "report")
        assert (code, err.count("\n")) == (2, 1)
        assert "No space left" in err
    assert [path.name for path in tmp_path.iterdir()] == ["old.npz"]
    assert old.read_text() == "old"


def full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_names_what_was_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not its temporary file, which is gone."""
    file, folder = tmp_path / "run.npz", tmp_path / "report"
    monkeypatch.setattr(pdf, "write_pdf", full)
    assert stopped(capsys, "--report", folder) == (
        2,
        f"error: [FILE] cannot use {folder}: No space left on device. Give another path.\n",
    )
    monkeypatch.setattr(zipfile.ZipFile, "writestr", full)
    monkeypatch.setattr(zipfile.ZipFile, "open", full)
    code, err = stopped(capsys, "--recording", file)
    assert (code, err.count("\n")) == (2, 1)
    assert f"cannot write {str(file)!r}: No space left" in err
    assert list(tmp_path.iterdir()) == []


def test_a_new_project_on_a_full_disk_names_its_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(SystemExit) as caught:
        main(["new", "winder", str(tmp_path / "mine")])
    assert caught.value.code == 2
    assert f"cannot use {tmp_path / 'mine'}: No space left" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["-o", "--out", "--output"])
def test_a_file_to_write_is_named_alike_everywhere(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is a folder here, and is refused before anything else is checked."""
    folder = tmp_path / "found.toml"
    folder.mkdir()
    seam = JOB.with_name("stitcher-test-path.seam.toml")
    for words in (
        ["compile", JOB, "-m", "lathe-winder", "--target", "csv"],
        ["design", seam, "-m", "stitcher"],
    ):
        with pytest.raises(SystemExit) as caught:
            main([str(word) for word in [*words, option, folder]])
        assert caught.value.code == 2
        assert f"cannot write {str(folder)!r}: it is a folder" in capsys.readouterr().err


def test_another_machine_without_loops_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    code, err = stopped(capsys, "--actual", "letter-placer")
    assert (code, err.count("\n")) == (2, 1)
    assert "the machine letter-placer has none with a loop" in err


def test_the_folder_of_an_output_is_made_and_taken_away_if_nothing_comes(tmp_path: Path) -> None:
    table = tmp_path / "reports" / "deep" / "ticks.csv"
    words = ["compile", JOB, "-m", "lathe-winder", "--interpolation", "linear", "-o", table]
    for target, status in (("csw", 2), ("csv", 0)):
        with pytest.raises(SystemExit) as caught:
            main([*map(str, words), "--target", target])
        assert (caught.value.code or 0) == status
        assert (tmp_path / "reports").exists() is (status == 0)
    assert [path.name for path in table.parent.iterdir()] == ["ticks.csv"]


def test_notes_are_wrapped_well_or_stand_below(capsys: pytest.CaptureFixture[str]) -> None:
    """A column of 13 characters breaks every note; 40 characters are enough to wrap one."""
    long = "the recording ends before this point and goes no further than that"
    print_table("a", ["criterion", "axis", "note"], [["x" * 90, "Y", long], ["y", "", ""]])
    narrow = capsys.readouterr().out
    assert "note" not in narrow
    assert narrow.endswith(f"  {'x' * 90} Y: {long}\n")

    print_table("a", ["criterion", "axis", "note"], [["x" * 60, "Y", long]])
    wide = capsys.readouterr().out
    assert "note" in wide
    assert "the recording ends before this point" in wide


@pytest.mark.parametrize("command", ["prove", "fastest", "compare"])
def test_a_report_without_a_name_does_not_go_into_the_current_folder(
    command: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        main([command, str(JOB), "-m", "lathe-winder", "--report", ""])
    captured = capsys.readouterr()
    assert (caught.value.code, captured.out, captured.err.count("\n")) == (2, "", 1)
    assert "'--report': it is empty; name a folder" in captured.err
    assert list(tmp_path.iterdir()) == []
