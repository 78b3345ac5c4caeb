"""From a firmware's settings to proofs of its limits, with two answers of the owner."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.cli.test_commands import run
from tests.machine.test_firmware import FLUIDNC, GRBL, KLIPPER, MARLIN
from threadline.machine import load_machine
from threadline.machine.firmware import machine_text, parse_answers, read_settings

pytestmark = pytest.mark.usefixtures("coarse_search")

SETTINGS = {
    "grbl": (GRBL, "A", ["rotary", "radius"]),
    "fluidnc": (FLUIDNC, "A", ["rotary", "radius"]),
    "marlin": (MARLIN, "A", ["rotary", "travel.X", "radius"]),
    "klipper": (KLIPPER, "Y", ["rotary", "radius"]),
}


def made(
    folder: Path, firmware: str, capsys: pytest.CaptureFixture[str]
) -> tuple[Path, dict[str, str]]:
    """Return a project folder, and the questions that were asked with examples."""
    text, turning, _ = SETTINGS[firmware]
    dump = folder / "settings.txt"
    dump.write_text(text)
    words = ("new", f"{firmware}", folder / "mine", "--from", dump, "--limits-only")
    asked: dict[str, str] = {}
    given = ["--set", f"rotary={turning}"]
    if turning == "A":  # other letters are linear axes, unless their owner says otherwise
        code, _, err = run(capsys, *words)
        assert code == 2 and "rotary" in err
    asked["rotary"] = turning
    code, _, err = run(capsys, *words, *given)
    assert code == 2
    for name, value in re.findall(r'--set "([a-zX.]+)=([^"]+)"', err):
        asked[name] = value
        given += ["--set", f"{name}={value}"]
    code, out, err = run(capsys, *words, *given, "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["files"] == sorted(p.name for p in (folder / "mine").iterdir())
    return folder / "mine", asked


@pytest.mark.parametrize("firmware", SETTINGS)
def test_two_answers_make_a_machine_that_is_proven_for_limits(
    firmware: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No torque, no mass: the limits are the same as with all answers."""
    folder, asked = made(tmp_path, firmware, capsys)
    assert list(asked) == SETTINGS[firmware][2]
    machine = load_machine(folder / "machine.toml")
    assert machine.without_dynamics and not machine.bodies
    owner = [f"{name}={value}" for name, value in asked.items()] + [
        "torque=1.26 N m", "current=2.8 A", "resistance=0.9 ohm", "inductance=2.5 mH",
        "supply=36 V", "microsteps=16", "mass=1.2 kg", "inertia=4e-3 kg m^2",
    ]  # fmt: skip
    full = tmp_path / "full.toml"
    settings = read_settings(tmp_path / "settings.txt")
    full.write_text(machine_text(settings, parse_answers(owner), "full"))
    whole = load_machine(full)
    for name in ("counts_per_unit", "velocity_limit", "acceleration_limit", "travel", "radius_m"):
        assert getattr(machine, name).tolist() == getattr(whole, name).tolist(), name
    assert machine.planner == whole.planner and machine.programs == whole.programs
    monkeypatch.chdir(folder)
    # In the firmware's own plan the speed steps at corners, by its own setting.
    for words, name, more in (((), "firmware", set()), (("--interpolation", "auto"), "auto",
                                                        {"acceleration"})):  # fmt: skip
        where = ("prove", "there-and-back.gcode", "-m", "machine.toml", *words)
        code, out, _ = run(capsys, *where, "--json")
        answer = json.loads(out)
        assert code == 0 and answer["level"] == "limits and time alone"
        assert answer["interpolation"] == name
        limited = {row["name"] for row in answer["criteria"] if row["limit"] is not None}
        assert limited == {"travel", "velocity"} | more
    assert "measured" not in (folder / "spec.toml").read_text()


@pytest.mark.parametrize(
    ("firmware", "begins"),
    [("grbl", "G21 G90 G94 G17\n"), ("klipper", "; no [input_shaper]: the machine file has no")],
)
def test_the_commands_of_the_project_run(
    firmware: str,
    begins: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every command in the README, and a program for the firmware: none needs dynamics."""
    folder, _ = made(tmp_path, firmware, capsys)
    monkeypatch.chdir(folder)
    commands = re.findall(r"^threadline +(.*)$", (folder / "README.md").read_text(), re.M)
    assert len(commands) == 5
    for command in commands:
        code, out, err = run(capsys, *command.split())
        assert code == 0, (command, err)
        assert "IN SPEC" not in out
        assert "LIMITS KEPT" not in out or "KEPT (limits and time alone: placement" in out
        assert "--target" not in command or f"s as the planner of {firmware} runs it" in err + out
    assert (folder / "faster.gcode").read_text().startswith(begins)


def test_settings_without_a_motor_make_a_machine_of_limits_and_say_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first command makes a machine; one value of a motor makes it ask for all others."""
    dump = tmp_path / "printer.cfg"
    dump.write_text(KLIPPER)
    asked = "new", "klipper", tmp_path / "alone", "--from", dump, "--limits-only", "--json"
    code, out, err = run(capsys, *asked)
    assert (code, err) == (0, "")
    assert not any("motor" in note for note in json.loads(out)["notes"])
    code, out, err = run(capsys, "new", "klipper", tmp_path / "mine", "--from", dump, "--json")
    assert (code, err) == (0, "")
    assert "No motor and no mass was given" in json.loads(out)["notes"][-1]
    for name in ("machine.toml", "spec.toml"):
        assert (tmp_path / "mine" / name).read_text() == (tmp_path / "alone" / name).read_text()
    words = "new", "klipper", tmp_path / "full", "--from", dump, "--set", "torque=1.26 N m"
    code, _, err = run(capsys, *words)
    assert code == 2 and "inductance" in err and not (tmp_path / "full").exists()


def test_answers_about_motors_are_refused_beside_limits_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dump = tmp_path / "settings.txt"
    dump.write_text(GRBL)
    for given in ("mass.X=1 kg", "torque=1 N m"):
        code, _, err = run(
            capsys, "new", "grbl", tmp_path / "mine", "--from", dump, "--limits-only",
            "--set", "rotary=A", "--set", "radius=50 mm", "--set", given,
        )  # fmt: skip
        assert code == 2 and "which --limits-only omits" in err
        assert len(err.strip().splitlines()) == 1
    code, _, err = run(capsys, "new", "winder", tmp_path / "mine", "--limits-only")
    assert code == 2 and "--limits-only" in err
    assert not (tmp_path / "mine").exists()
