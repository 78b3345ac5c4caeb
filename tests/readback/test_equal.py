"""``equal``: the files of controllers beside the plan, and one changed digit in each."""

from __future__ import annotations

import html
import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

import threadline as tl
from threadline.cli.main import main
from threadline.commands.boards import BOARDS
from threadline.errors import InputError
from threadline.readback.equal import Equal

MACHINE = "lathe-winder"
PROGRAM = "G91 G1 X2 A10 F600\nX-2 A-5\nG4 P0.1\nY1\nM30\n"


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("job") / "a.prg"
    file.write_text(PROGRAM)
    return file


def compiled(job: Path, target: str, folder: Path) -> Path:
    file = folder / f"a.{target}"
    tl.compile(job, MACHINE, target, file)
    return file


def beside(job: Path, target: str, file: Path) -> Equal:
    return tl.equal(job, MACHINE, files=[f"{target}={file}"]).targets[0]


def status(line: list[str]) -> int:
    with pytest.raises(SystemExit) as ended:
        main(line)
    return int(ended.value.code or 0)


def needs(target: str) -> None:
    if target in {"nc", "linuxcnc"} and shutil.which("rs274") is None:
        pytest.skip("rs274 (Debian's linuxcnc-uspace) is not installed")


def test_every_target_of_the_winder_is_the_plan(job: Path) -> None:
    """Tables to the count; programs within 20 um. Only targets without a reader are skipped."""
    found = tl.equal(job, MACHINE)
    verdicts = {one.target: one.verdict for one in found.targets}
    lacking = {"nc", "linuxcnc"} if shutil.which("rs274") is None else set()
    assert {name for name, verdict in verdicts.items() if verdict == "skipped"} == lacking
    # No machine file of this winder has a planner, so no firmware code has run.
    single = {name for name, verdict in verdicts.items() if verdict == "read back"}
    assert single == set(BOARDS) - {"linuxcnc"}
    assert found.passed and set(verdicts) >= {"csv", "npz", "ticks", "nc", "grbl", "klipper"}
    for one in found.targets:
        if one.verdict != "skipped" and one.unit == "m":
            assert one.place is not None and 0.0 < one.place < 12e-6  # chords: 10 um, sampled 1 um


@pytest.mark.linuxcnc
def test_the_tools_of_a_running_linuxcnc_are_left_alone(
    job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """LinuxCNC 2.9 keeps them in a file of the home, which only its interpreter writes, too."""
    needs("linuxcnc")
    file = compiled(job, "linuxcnc", tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    tools = tmp_path / ".tool.mmap"
    tools.write_text("tools of the machine")
    assert beside(job, "linuxcnc", file).verdict == "equal"
    assert tools.read_text() == "tools of the machine"


@pytest.mark.parametrize(
    ("target", "pattern", "digit", "message"),
    [
        ("csv", r"\n30,(-?\d+),", r"\n30,99,", "count"),
        ("ticks", r"\n1,0,0,0,(\d+),", r"\n1,0,0,0,7\1,", "count"),
        ("grbl", r"X1\.9899", "X2.0899", "place"),
        ("marlin", r"X1\.9899", "X2.0899", "place"),
        ("grbl", r"G4 P0\.1", "G4 P0.2", "text"),
        ("klipper", r"F(\d)", r"F9\1", "text"),
        pytest.param("nc", r"(\nN300 .*X\d+\.)(\d)", r"\g<1>9\2", "place",
                     marks=pytest.mark.linuxcnc),
        pytest.param("nc", r"G4 P0\.1", "G4 P0.2", "time", marks=pytest.mark.linuxcnc),
    ],
)  # fmt: skip
def test_a_changed_digit_is_found(
    job: Path, tmp_path: Path, target: str, pattern: str, digit: str, message: str
) -> None:
    """In a count, an end, a wait or a feed: the file differs, and its line is named."""
    needs(target)
    file = compiled(job, target, tmp_path)
    if target != "nc":  # rs274 takes long
        assert beside(job, target, file).verdict in {"equal", "read back"}
    text = file.read_text()
    changed = re.sub(pattern, digit, text, count=1)
    assert changed != text
    file.write_text(changed)
    one = beside(job, target, file)
    line = next(
        k for k, (a, b) in enumerate(
            zip(text.splitlines(), changed.splitlines(), strict=True), 1
        ) if a != b
    )  # fmt: skip
    assert one.verdict == "differs"
    assert f"line {line} is " in one.note
    assert one.place is not None and one.place_limit is not None
    assert (one.place > one.place_limit) == (message in {"count", "place"})
    if message == "count":
        assert one.at.startswith(f"from line {line},")
    if target in {"grbl", "marlin"} and message == "place":
        # X turns back 0.1 mm further on; the written corner lies beside the planned one already.
        assert 80e-6 < one.place < 120e-6
    if message == "time":
        assert one.time_s == pytest.approx(0.1, abs=0.002)


def test_a_count_in_an_archive_and_a_trailing_blank(job: Path, tmp_path: Path) -> None:
    file = compiled(job, "npz", tmp_path)
    with np.load(file) as archive:
        parts = {name: archive[name] for name in archive.files if name != "meta.json"}
        meta = archive["meta.json"]
    parts["counts"] = parts["counts"].copy()
    parts["counts"][40, 1] += 1
    np.savez(file, **parts)
    import zipfile

    with zipfile.ZipFile(file, "a") as archive_file:
        archive_file.writestr("meta.json", bytes(meta))
    one = beside(job, "npz", file)
    assert (one.verdict, one.place, one.at) == ("differs", 1.0, "from line 40, X")
    grbl = compiled(job, "grbl", tmp_path)
    grbl.write_bytes(grbl.read_bytes().replace(b"\n", b" \r\n"))
    assert beside(job, "grbl", grbl).verdict == "read back"


def test_foreign_files_are_refused_in_one_line(
    job: Path, tmp_path: Path, examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit status 2 for another job, another format, no file, another kind; 1 if it differs."""
    csv = compiled(job, "csv", tmp_path)
    other = examples / "x-180.prg"
    for files, words, message in [
        ([f"csv={csv}"], [], "written for another job"),
        ([f"npz={csv}"], [], "no table of target npz"),
        ([f"csv={other}"], [], "first line is not"),
        (["grbl"], [], "not TARGET=FILE"),
        ([f"grbl={tmp_path / 'none.nc'}"], [], "there is no file"),
        ([], ["--targets", "st,t15"], "another kind of machine"),
        ([f"st={csv}"], ["--targets", "csv"], "another kind of machine"),
        ([], ["--targets", "csv,nonsense"], "unknown target"),
    ]:
        typed = [part for file in files for part in ("--file", file)]
        assert status(["equal", str(other), "-m", MACHINE, *typed, *words]) == 2
        error = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
        assert len(error) == 1 and message in error[0]
    with pytest.raises(InputError, match="no target was compared: t15: no reader here"):
        tl.equal(examples / "rosette.dst", "table-embroiderer", ["t15"])


def test_skipped_targets_are_told(
    job: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A target without its reader, or one that cannot hold the plan, is a row with a reason."""
    monkeypatch.setenv("PATH", "/nonexistent")
    monkeypatch.delenv("CI", raising=False)
    line = ["equal", str(job), "-m", MACHINE, "--targets", "csv,nc"]
    assert status([*line, "--json"]) == 0
    rows = {one["target"]: one for one in json.loads(capsys.readouterr().out)["targets"]}
    assert rows["csv"]["verdict"] == "equal"
    assert rows["nc"]["verdict"] == "skipped" and "not installed" in rows["nc"]["note"]
    assert status(line) == 0
    assert "1 compared, 1 skipped" in capsys.readouterr().out
    monkeypatch.setenv("CI", "true")
    assert status(line) == 1
    assert "apt-get install linuxcnc-uspace" in capsys.readouterr().err
    shaped = tl.equal(job, MACHINE, shaper="zv:10Hz")
    assert {one.target for one in shaped.targets if one.verdict != "skipped"} == {
        "csv", "npz", "ticks",
    }  # fmt: skip


def test_a_report_repeats_the_command_and_has_no_empty_table(job: Path, tmp_path: Path) -> None:
    """The command on the page names options and files, so that it repeats the comparison."""
    file = tmp_path / "a.csv"
    tl.compile(job, MACHINE, "csv", file, limits="50 %")
    line = ["equal", str(job), "-m", MACHINE, "--limits", "50 %", "--file", f"csv={file}"]
    assert status([*line, "--report", str(tmp_path / "report")]) == 0
    page = (tmp_path / "report" / "equal.html").read_text()
    (command,) = re.findall("<code>(threadline equal [^<]*)</code>", page)
    words = shlex.split(html.unescape(command))
    assert set(line) <= set(words)
    assert status(words[1:]) == 0
    assert "Remarks" not in page


def test_targets_of_other_machines_are_rows_beside_those_of_this_one(
    job: Path,
    examples: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The list in the command's help suits every machine; CI needs no reader of other machines."""
    monkeypatch.setenv("CI", "true")
    assert status(["equal", str(job), "-m", MACHINE, "--targets", "st,csv,steps", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    verdicts = {one["target"]: one["verdict"] for one in printed["targets"]}
    assert verdicts == {"st": "skipped", "csv": "equal", "steps": "skipped"}
    kinds = [one["note"] for one in printed["targets"] if one["verdict"] == "skipped"]
    assert all("for another kind of machine than" in note for note in kinds)
    assert printed["missing"] == {} and printed["equal"]
    placed = tl.equal(examples / "letter-cycle.toml", "letter-placer", ["st", "klipper", "nc"])
    assert [one.verdict for one in placed.targets] == ["equal", "skipped", "skipped"]
    assert placed.missing == {}
