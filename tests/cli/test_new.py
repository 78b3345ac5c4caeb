"""A new project works as it is made, and is made whole or not at all."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from threadline.cli import new
from threadline.cli.main import main
from threadline.machine import library_names


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    """Run the program in this process; returns exit status, output and errors."""
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, captured.err


@pytest.mark.parametrize("kind", new.PROJECTS)
def test_a_new_project_is_in_spec(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "mine"
    code, out, err = run(capsys, "new", kind, folder, "--json")
    content = json.loads(out)

    assert (code, err) == (0, "")
    assert {"machine.toml", "spec.toml", "README.md"} < set(content["files"])
    assert sorted(p.name for p in folder.iterdir()) == content["files"]
    assert [p.name for p in tmp_path.iterdir()] == ["mine"]
    program, *arguments = shlex.split(content["prove"])
    assert program == "threadline"
    # The README says the same command.
    readme = (folder / "README.md").read_text(encoding="utf-8")
    written = [shlex.split(line) for line in re.findall(r"^threadline .*", readme, re.MULTILINE)]
    assert any(line[1 : len(arguments) + 1] == arguments for line in written)

    monkeypatch.chdir(folder)
    code, out, _ = run(capsys, *arguments, "--json")
    verdict = json.loads(out)
    assert code == 0
    assert verdict["passed"] is True
    # The folder's own specification was judged: its limits are those of the verdict.
    asked = tomllib.loads((folder / "spec.toml").read_text(encoding="utf-8"))["criteria"]
    limited = {row["name"] for row in asked if row.get("limit") not in {None, "machine"}}
    assert limited
    assert limited <= {c["name"] for c in verdict["criteria"] if c["limit"] is not None}


def test_every_file_that_a_readme_names_is_there() -> None:
    for kind in new.PROJECTS:
        files = new.project_files(kind)
        readme = files["README.md"].decode()
        named = set(re.findall(r"[\w-]+(?:\.seam)?\.(?:prg|toml|dst)", readme))
        assert named <= set(files)
        assert new.PROJECTS[kind].machine in library_names()


def test_an_empty_folder_is_filled(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "empty"
    folder.mkdir()
    assert run(capsys, "new", "winder", folder)[0] == 0
    assert {p.name for p in folder.iterdir()} == set(new.project_files("winder"))


@pytest.mark.parametrize("there", [True, False])
def test_a_project_that_cannot_be_written_leaves_nothing(
    there: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder = tmp_path / "mine"
    if there:
        folder.mkdir()
    replace = Path.replace

    def full(self: Path, target: Path) -> Path:
        if self.name == "spec.toml":
            raise OSError(28, "No space left on device", str(self))
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", full)
    code, _, err = run(capsys, "new", "winder", folder)

    assert code == 2
    assert "No space left" in err
    assert [p.name for p in tmp_path.rglob("*")] == (["mine"] if there else [])


@pytest.mark.parametrize(
    ("kind", "name", "words"),
    [
        (
            "loom",
            "mine",
            "There are: grbl, fluidnc, marlin, klipper, rrf, linuxcnc, winder, stepper",
        ),
        ("windr", "mine", "Did you mean 'winder'?"),
        ("winder", "full", "is not empty"),
        ("winder", "file", "is not a folder"),
        ("winder", "file/such", "is not a folder"),
    ],
)
def test_what_cannot_be_made_is_refused_in_one_line(
    kind: str, name: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    (tmp_path / "file").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    code, out, err = run(capsys, "new", kind, tmp_path / name)

    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err
    assert sorted(tmp_path.rglob("*")) == before


def test_help_lists_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = run(capsys, "new", "--help")
    assert "winder, stepper, stitcher, placer" in " ".join(out.split())
    assert "embroidery" in out


SETTINGS = """$100=80.000 (x, step/mm)
$103=26.667
$110=6000.000
$113=36000
$120=500.000
$123=2000
$130=900.000
$133=360
"""
OWNER = (
    "rotary=A", "torque=1.26 N m", "current=2.8 A", "resistance=0.9 ohm", "inductance=2.5 mH",
    "supply=36 V", "microsteps=16", "mass=1.2 kg", "inertia=4e-3 kg m^2", "radius=50 mm",
)  # fmt: skip


def test_a_dump_of_settings_becomes_a_project_in_spec(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten numbers of its owner and the answer to $$: the project's own command is in spec."""
    dump, folder = tmp_path / "settings.txt", tmp_path / "mine"
    dump.write_text(SETTINGS)
    asked = [text.partition("=")[0] for text in OWNER[1:]]
    code, _, err = run(capsys, "new", "grbl", folder, "--from", dump, "--set", OWNER[0])
    assert code == 2 and not folder.exists()
    assert all(f'--set "{name}=' in err for name in asked), "a question was cut out"
    given = [word for text in OWNER for word in ("--set", text)]
    code, out, err = run(capsys, "new", "grbl", folder, "--from", dump, *given, "--json")
    assert (code, err) == (0, "")
    content = json.loads(out)
    assert sorted(p.name for p in folder.iterdir()) == content["files"]
    monkeypatch.chdir(folder)
    code, out, _ = run(capsys, *shlex.split(content["prove"])[1:], "--json")
    assert code == 0
    assert json.loads(out)["feed_mode"] == "grbl"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["grbl", "mine"], "Name what grbl answers to $$ with --from"),
        (
            ["winder", "mine", "--set", "mass=1 kg"],
            "--limits-only are not of the kind",
        ),
        (["marlin", "mine", "--from", "dump.txt"], "threadline new grbl"),
    ],
)
def test_settings_of_another_kind_are_refused(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dump.txt").write_text(SETTINGS)
    code, _, err = run(capsys, "new", *arguments)
    assert code == 2
    assert said in err
