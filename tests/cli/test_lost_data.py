"""No command overwrites a file that it has read, or leaves only some of its files."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from threadline.cli.main import main

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
LIBRARY = EXAMPLES.parent / "src" / "threadline" / "machine" / "library"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a job, a machine on its own base with a default specification, and a seam."""
    for name in ("x-180.prg", "letter-cycle.toml", "strap.csv", "strap.seam.toml"):
        shutil.copy(EXAMPLES / name, tmp_path)
    shutil.copy(LIBRARY / "lathe-winder.toml", tmp_path / "base.toml")
    shutil.copy(LIBRARY / "lathe-winder.spec.toml", tmp_path / "mine.spec.toml")
    (tmp_path / "mine.toml").write_text('base = "base.toml"\n')
    (tmp_path / "hard.csv").hardlink_to(tmp_path / "base.toml")
    (tmp_path / "soft.csv").symlink_to("mine.spec.toml")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(words: str, capsys: pytest.CaptureFixture[str]) -> tuple[object, str, str]:
    with pytest.raises(SystemExit) as caught:
        main(words.split())
    output = capsys.readouterr()
    return caught.value.code or 0, output.out, output.err


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


PROVE = "prove x-180.prg -m mine.toml --interpolation linear --recording"
COMPILE = "compile x-180.prg -m mine.toml --interpolation linear --target csv -o"


@pytest.mark.parametrize(
    "words",
    [
        f"{PROVE} soft.csv",
        f"{PROVE} hard.csv",
        f"{COMPILE} base.toml",
        f"{COMPILE} hard.csv",
        f"{COMPILE} x-180.prg",
        "prove strap.seam.toml -m stitcher --interpolation linear --recording strap.csv",
        "compile strap.seam.toml -m stitcher --interpolation linear --target csv -o strap.csv",
    ],
)
def test_input_file_is_never_overwritten(
    words: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = bytes_of(folder)
    code, out, err = run(words, capsys)
    assert (code, out, err.count("\n")) == (2, "", 1), err
    assert "would be overwritten" in err
    assert bytes_of(folder) == before


def test_a_second_file_that_fails_takes_the_first_with_it(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "cycle.configuration.st").mkdir()
    before = bytes_of(folder)
    words = "compile letter-cycle.toml -m letter-placer --target st -o cycle.st"
    code, out, err = run(words, capsys)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "cycle.configuration.st': it is a folder" in err
    assert bytes_of(folder) == before


def test_a_folder_in_the_way_of_a_report_is_told_before_the_work(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "out" / "report.html").mkdir(parents=True)
    before = bytes_of(folder)
    monkeypatch.setattr("threadline.cli.prove.prove_job", None)
    code, out, err = run(f"{PROVE} run.csv --report out", capsys)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "report.html': it is a folder" in err
    assert bytes_of(folder) == before


def test_standard_output_is_written_to(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The table alone; the hash goes to standard error."""
    with pytest.raises(SystemExit):
        main(f"{COMPILE} table.csv".split())
    capfd.readouterr()
    with pytest.raises(SystemExit) as ended:
        main(f"{COMPILE} /dev/stdout".split())
    output = capfd.readouterr()
    assert not ended.value.code
    assert output.out == (folder / "table.csv").read_text("utf-8")
    assert "  /dev/stdout\n" in output.err


@pytest.mark.long(shown_by="test_standard_output_is_written_to")
def test_standard_output_is_written_to_and_not_replaced(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The table alone goes there, into a pipe or a file; the hash goes to standard error."""
    start = [sys.executable, "-m", "threadline", *COMPILE.split()]
    assert run(f"{COMPILE} table.csv", capsys)[0] == 0
    expected = (folder / "table.csv").read_bytes()
    piped = subprocess.run([*start, "/dev/stdout"], check=True, capture_output=True, timeout=300)
    assert piped.stdout == expected
    assert b"  /dev/stdout\n" in piped.stderr
    (folder / "redirected").write_bytes(b"what the shell has written before\n")
    with (folder / "redirected").open("ab") as file:
        subprocess.run(
            [*start, "/dev/stdout"], check=True, stdout=file, stderr=subprocess.DEVNULL, timeout=300
        )
    assert (folder / "redirected").read_bytes() == b"what the shell has written before\n" + expected
    assert Path("/dev/stdout").is_symlink()
