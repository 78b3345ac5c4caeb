"""A new project works as made, and is made whole or not at all."""

from __future__ import annotations

import io
import json
import math
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


@pytest.mark.long(only=("winding", "embroidery"))
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
    # The folder's own specification was judged: its limits are in the verdict.
    asked = tomllib.loads((folder / "spec.toml").read_text(encoding="utf-8"))["criteria"]
    limited = {row["name"] for row in asked if row.get("limit") not in {None, "machine"}}
    assert limited
    assert limited <= {c["name"] for c in verdict["criteria"] if c["limit"] is not None}


def test_every_file_that_a_readme_names_is_there() -> None:
    for kind in new.PROJECTS:
        files = new.project_files(kind)
        readme = files["README.md"].decode()
        named = set(re.findall(r"[\w-]+(?:\.seam|\.wind)?\.(?:prg|toml|dst)", readme))
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
def test_new_refuses_an_impossible_project_in_one_line(
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
    """The owner's ten numbers and the answer to $$: the project's own command is in spec."""
    dump, folder = tmp_path / "settings.txt", tmp_path / "mine"
    dump.write_text(SETTINGS)
    asked = [text.partition("=")[0] for text in OWNER[2:]]
    words = "new", "grbl", folder, "--from", dump, "--set", OWNER[0], "--set", OWNER[1]
    code, _, err = run(capsys, *words)
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
    ("arguments", "message"),
    [
        (["grbl", "mine"], "Name grbl's answer to $$ with --from"),
        (
            ["winder", "mine", "--set", "mass=1 kg"],
            "--limits-only do not apply to the kind",
        ),
        (["marlin", "mine", "--from", "dump.txt"], "threadline new grbl"),
    ],
)
def test_settings_of_another_kind_are_refused(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dump.txt").write_text(SETTINGS)
    code, _, err = run(capsys, "new", *arguments)
    assert code == 2
    assert message in err


def test_new_lists_every_setting_with_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every number: from the settings, from the owner, or assumed."""
    dump = tmp_path / "dump.txt"
    dump.write_text(SETTINGS + "$101=0.000\n")
    words = ["new", "grbl", tmp_path / "mine", "--from", dump, "--limits-only", "--set", "rotary=A"]
    code, out, _ = run(capsys, *words, "--set", "radius=50 mm")
    rows = {" ".join(line.split()[:2]): line for line in out.splitlines()}
    assert code == 0
    assert "6000 mm/min" in rows["X rate"] and "$110, dump.txt:3" in rows["X rate"]
    assert "26.667 /deg" in rows["A steps"] and "dump.txt:2" in rows["A steps"]
    assert "0.01 mm" in rows["junction deviation"]
    assert "assumed: default of grbl" in rows["junction deviation"]
    assert "50 mm" in rows["radius 50"] and "--set" in rows["radius 50"]
    assert "dump.txt:9: $101=0.000: no axis Y" in out
    words[2] = tmp_path / "again"
    code, out, _ = run(capsys, *words, "--set", "radius=50 mm", "--json")
    answer = json.loads(out)
    assert {"setting": "X travel", "value": "900 mm", "from": "$130, dump.txt:7"} in answer["read"]
    assert answer["notes"] == ["dump.txt:9: $101=0.000: no axis Y"] and answer["left_out"] == []


def test_every_proof_warns_of_controller_settings_that_the_plan_ignores(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    dump = tmp_path / "m503.txt"
    dump.write_text("M92 X80\nM203 X100\nM201 X500\nM205 J0.01\nM852 I0.02\n")
    words = ["new", "marlin", tmp_path / "mine", "--from", dump, "--limits-only"]
    code, _, err = run(capsys, *words, "--set", "travel=300 mm")
    assert code == 0 and "warning: m503.txt:5: M852 I0.02" in err
    monkeypatch.chdir(tmp_path / "mine")
    code, _, err = run(capsys, "prove", "there-and-back.gcode", "-m", "machine.toml")
    assert code == 0 and "warning: m503.txt:5: M852 I0.02" in err


class Terminal(io.StringIO):
    """A user at the keys, who types these lines."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_is_asked_for_everything(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An empty answer takes the value in brackets; a wrong one is refused and asked for again."""
    monkeypatch.chdir(tmp_path)
    Path("dump.txt").write_text(SETTINGS)
    lines = ["grbll", "", "nothing.txt", "dump.txt", "", "", "", "5 kg", "40 mm"]
    monkeypatch.setattr("sys.stdin", Terminal("\n".join(lines) + "\n"))
    code, out, _ = run(capsys, "new")
    assert code == 0
    assert "Did you mean 'grbl'?" in out and "cannot read 'nothing.txt'" in out
    assert "Folder to make [my-grbl]: " in out and "--set radius='5 kg'" in out
    machine = tomllib.loads(Path("my-grbl/machine.toml").read_text())
    assert machine["axes"]["A"]["kind"] == "rotary" and machine["tool"]["radius"][:5] == "40 mm"
    assert machine["drives"]["x"]["kind"] == "kinematic"


def test_answers_that_end_early_make_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", Terminal("winder\n"))
    code, _, err = run(capsys, "new")
    assert code == 2 and "not answered to the end" in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [[], ["grbl"], ["--json"], ["winder", "--json"]])
def test_without_a_terminal_nothing_is_asked(
    words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if "--json" in words:
        monkeypatch.setattr("sys.stdin", Terminal("winder\nmine\n"))
    code, out, err = run(capsys, "new", *words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "Like threadline new" in err


@pytest.mark.parametrize(
    ("old", "now"),
    [("reprapfirmware-winder", "rrf"), ("marlyn", "marlin")],
)
def test_the_kind_that_was_meant_is_named(
    old: str, now: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = run(capsys, "new", old, tmp_path / "mine")
    assert code == 2 and f"Did you mean '{now}'?" in err


def test_a_winder_on_a_firmware_is_named_after_both(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dump = tmp_path / "mine.txt"
    letters = "".join(f"$10{k}=80\n$11{k}=5000\n$12{k}=200\n$13{k}=300\n" for k in range(3))
    dump.write_text(f"$11=0.010\n{letters}")
    messages = []
    for kind in ("grbl", "grbl-winder"):
        words = ["new", kind, tmp_path / kind, "--from", dump, "--limits-only"]
        assert run(capsys, *words)[0] == 0
        messages.append((tmp_path / kind / "machine.toml").read_text())
    assert messages[0] == messages[1]
    code, _, err = run(capsys, "new", "grbl-winder", tmp_path / "other")
    assert code == 2 and "a grbl machine is made from the settings of its controller" in err


@pytest.mark.parametrize("named", ["plotter", "Laser", "router"])
def test_a_machine_by_its_work_is_sent_to_its_firmware(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], named: str
) -> None:
    """A user types the name of the work; the nearest word to plotter was placer."""
    with pytest.raises(SystemExit) as stopped:
        main(["new", named, str(tmp_path / "mine")])
    errors = capsys.readouterr().err
    assert stopped.value.code == 2
    assert "named after the firmware of its controller. There are: grbl" in " ".join(errors.split())


@pytest.mark.long(shown_by="test_a_dump_of_settings_becomes_a_project_in_spec")
def test_from_a_dump_and_a_plotter_file_to_a_faster_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command printed by ``fastest`` writes a file that takes less time.

    The corners of its chords set the speed of a circle: rounding them saves more than any F.
    """
    monkeypatch.chdir(tmp_path)
    dump = "".join(
        f"${first + axis}={value}\n"
        for first, value in ((100, 80), (110, 8000), (120, 250), (130, 200))
        for axis in range(2)
    )
    Path("dollar.txt").write_text(f">>> $$\n$11=0.010\n{dump}ok\n")
    turns = [(30 + 20 * math.cos(0.2 * i), 30 + 20 * math.sin(0.2 * i)) for i in range(32)]
    lines = [f"G1 X{x:.3f} Y{y:.3f} F3000" for x, y in turns]
    Path("plot.gcode").write_text("\n".join(["G21 G90", "M3 S1000", *lines, "M5", "M2"]))
    assert run(capsys, "new", "grbl", "mine", "--from", "dollar.txt")[0] == 0
    code, out, _ = run(capsys, "fastest", "plot.gcode", "-m", "mine/machine.toml")
    assert code == 0 and "limited by acceleration, corners and rapid moves" in out
    found, fastest_s = out, float(re.findall(r"fastest: ([\d.]+) s", out)[0])
    hint = next(line for line in out.splitlines() if line.startswith("For a faster file"))
    words = shlex.split(hint.partition(": ")[2])
    assert words[:2] == ["threadline", "compile"]
    code, out, _ = run(capsys, *words[1:], "--json")
    assert code == 0 and Path("faster-plot.gcode").is_file()
    [file] = json.loads(out)["files"]
    assert file["as_run_s"] < 0.9 * file["stands_s"], file
    hint = next(line for line in found.splitlines() if line.startswith("For a file as fast"))
    code, out, _ = run(capsys, *shlex.split(hint.partition(": ")[2])[1:], "--json")
    [plain] = json.loads(out)["files"]
    assert code == 0 and file["as_run_s"] < plain["as_run_s"] == pytest.approx(fastest_s, rel=1e-3)
