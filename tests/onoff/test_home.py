"""The order of homing in a move list: kept, or refused with its line."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.commands.plc.driving import Bench
from tests.commands.plc.machine import Plc
from tests.commands.plc.parts import read_in_parts
from tests.commands.plc.pistons import Cell
from tests.commands.plc.stuck import forbidden
from threadline.cli.main import main
from threadline.commands.plc_watch import home_order, home_places
from threadline.commands.schedule_moves import home_stage
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, write
from threadline.search.move_list import move_list
from threadline.twin.switching import simulate_switching

CYCLE = Path(__file__).parents[2] / "examples" / "letter-cycle.toml"
LIBRARY = Path(__file__).parents[2] / "src" / "threadline" / "machine" / "library"
FREE = """
[[operation]]
valve = "main_air"

[[operation]]
move = { X = "200 mm" }

[[operation]]
move = { X = "0 mm" }

[[operation]]
move = { Z = "100 mm" }

[[operation]]
move = { Z = "0 mm" }
"""


def compiled(text: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    file = folder / "list.toml"
    file.write_text(text, encoding="utf-8")
    out = folder / "list.st"
    with pytest.raises(SystemExit) as ended:
        main(["compile", str(file), "-m", "letter-placer", "--target", "st", "-o", str(out)])
    written = out.read_text(encoding="ascii") if out.exists() else ""
    return int(ended.value.code or 0), written, capsys.readouterr().err


def test_a_list_that_says_it_is_brought_home_so(tmp_path: Path) -> None:
    """By default Z comes last, because it moves last; the list's own order goes before that.

    The slide of this machine may move with the lift anywhere.
    """
    machine = load_machine("letter-placer")
    slide = replace(machine.cylinders["X"], needs=())
    machine = replace(machine, cylinders={**machine.cylinders, "X": slide})
    found = []
    for head in ("", 'home = ["Z", "X"]\n', 'home = ["X", "Z"]\n'):
        file = tmp_path / "list.toml"
        file.write_text(head + FREE, encoding="utf-8")
        job = read_job(file, machine)
        scheduled = plan_job(job, machine, Options()).scheduled
        waits = [p.wait[0] for p in home_places(scheduled, 0, 10) if p.wait is not None]
        found.append((home_order(scheduled), waits))
        file.write_text(move_list(job, machine), encoding="utf-8")
        assert read_job(file, machine).home == job.home
    assert found == [
        (("X", "Z"), ["x_is_left", "z_is_up"]),
        (("Z", "X"), ["z_is_up", "x_is_left"]),
        (("X", "Z"), ["x_is_left", "z_is_up"]),
    ]


def test_the_cycle_may_say_what_it_does_anyway(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = CYCLE.read_text(encoding="utf-8")
    code, plain, _ = compiled(text, tmp_path, capsys)
    again = text.replace('name = "letter-cycle"', 'name = "letter-cycle"\nhome = ["Z", "X"]')
    code_of_it, message, _ = compiled(again, tmp_path, capsys)
    assert (code, code_of_it) == (0, 0)
    body = [[line for line in t.splitlines() if "sha256" not in line] for t in (plain, message)]
    assert len(body[0]) > 500
    assert body[0] == body[1]


@pytest.mark.parametrize(
    ("home", "message"),
    [
        ('["X", "Z"]', "brings X back before Z, and the list moves X only with Z at its start"),
        ('["Z"]', 'home = ["Z"] does not name every cylinder once'),
        ('["Z", "Z"]', 'home = ["Z", "Z"] does not name every cylinder once'),
        ('["Z", "Y"]', 'home = ["Z", "Y"] does not name every cylinder once'),
        ('"Z"', 'home = "Z" does not name every cylinder once'),
        ("7", "home = 7 does not name every cylinder once"),
        ("[]", "home = [] does not name every cylinder once"),
    ],
)
def test_an_order_that_brings_nothing_home_is_refused(
    home: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = CYCLE.read_text(encoding="utf-8")
    text = text.replace('name = "letter-cycle"', f'name = "letter-cycle"\nhome = {home}')
    code, written, err = compiled(text, tmp_path, capsys)
    assert (code, written, err.count("\n")) == (2, "", 1)
    assert message in err
    assert "list.toml" in err


def test_a_home_that_no_contact_tells_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Homing of X could not end: its switch at 0 is missing in the machine file."""
    machine = tmp_path / "blind.toml"
    library = Path(__import__("threadline.machine").machine.__file__).parent / "library"
    text = (library / "letter-placer.toml").read_text(encoding="utf-8")
    text = text.replace('needs = ["x_is_left", "z_is_down"]', 'needs = ["z_is_down"]')
    lines = [line for line in text.splitlines() if not line.startswith("x_is_left =")]
    machine.write_text("\n".join(lines), encoding="utf-8")
    job, out = tmp_path / "list.toml", tmp_path / "list.st"
    job.write_text('home = ["Z", "X"]\n' + FREE, encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["compile", str(job), "-m", str(machine), "--target", "st", "-o", str(out)])
    err = capsys.readouterr().err
    assert (ended.value.code, out.exists()) == (2, False)
    assert "no contact shows that X is home" in err
    job.write_text(HOMING, encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["prove", str(job), "-m", str(machine)])
    err = capsys.readouterr().err
    assert (ended.value.code, err.count("\n")) == (2, 1)
    assert "list.toml:6: no contact shows that X is home" in err


HOMING = """
[[operation]]
step = "on"
valve = "main_air"

[[operation]]
step = "home"
home = ["Z", "X"]
"""


@pytest.mark.long(but="lift down")
@pytest.mark.parametrize(
    "places",
    [[(111.0, 5.0), (194.5, 55.0)], [(0.0, 0.0), (200.0, 100.0), (3.0, 97.0)]],
    ids=["lift down", "others"],
)
def test_a_homing_list_brings_pistons_home_from_wherever_they_stand(
    tmp_path: Path, places: list[tuple[float, float]]
) -> None:
    """The program of a list that only homes, scan by scan, with pistons that start anywhere.

    In its cycle and in its homing: the lift first, X only once the lift is really up, both slowly.
    """
    machine = load_machine("letter-placer")
    file, out = tmp_path / "home.toml", tmp_path / "home.st"
    file.write_text(HOMING, encoding="utf-8")
    write(plan_job(read_job(file, machine), machine, Options()), "st", out)
    for x, z in places:
        bench = Bench(Plc(read_in_parts(out.read_text(encoding="ascii"))), 10_000, 0.2, 5)
        bench.cell = Cell(x, z)
        for button in ("home_button", "start_button"):
            bench.cell.pistons["x"].at, bench.cell.pistons["z"].at = x, z
            bench.press(button)
            assert bench.block["busy"]
            while bench.block["busy"]:
                on = bench.scan()
                assert not forbidden(on, bench.cell)
                assert not on & {"x_right", "z_down", "x_left_a1", "z_up_a1"}, "home, slowly"
            assert not bench.block["fault"], bench.block["fault_text"]
            assert [bench.cell.pistons[a].at for a in "xz"] == [0.0, 0.0]
        assert bench.block["finished"]
        assert bench.block["count"] == 1


def test_homing_within_a_list_ends_at_the_start_on_the_twin(tmp_path: Path) -> None:
    """Out, home by the operation, out again: the piston is back at 0, no faster than its level."""
    machine = load_machine("letter-placer")
    file = tmp_path / "twice.toml"
    out = '\n[[operation]]\nmove = { X = "150 mm" }\n'
    home = '\n[[operation]]\nhome = ["Z", "X"]\n'
    file.write_text(f'[[operation]]\nvalve = "main_air"\n{out}{home}{out}', encoding="utf-8")
    job = read_job(file, machine)
    scheduled = plan_job(job, machine, Options()).scheduled
    assert [(m.begin_m, m.end_m) for m in scheduled.moves] == [(0.0, 0.15), (0.0, 0.15)]
    assert [h.axis for h in scheduled.homings] == ["Z", "X"]
    recording = simulate_switching(scheduled.commands, machine)
    (_, stroke), (times, level) = recording.samples_of(["X.load", "X.level"]).values()
    assert level.min() == -0.37
    back = np.flatnonzero(level < 0.0)
    assert stroke[back[0]] == pytest.approx(0.15, abs=0.003)
    assert stroke[back[-1]] == pytest.approx(0.0, abs=1e-4)
    speed = np.gradient(stroke, times)[back]
    assert speed.min() > -1.25 * 0.37 * 0.43
    assert stroke[-1] == pytest.approx(0.15, abs=0.003)
    written = tmp_path / "written.toml"
    written.write_text(move_list(job, machine), encoding="utf-8")
    again = plan_job(read_job(written, machine), machine, Options()).scheduled
    assert again.commands.ticks.tolist() == scheduled.commands.ticks.tolist()


def test_the_order_of_the_operation_is_that_of_the_way_home(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    machine = load_machine("letter-placer")
    file = tmp_path / "list.toml"
    file.write_text(FREE + '\n[[operation]]\nhome = ["Z", "X"]\n', encoding="utf-8")
    scheduled = plan_job(read_job(file, machine), machine, Options()).scheduled
    assert home_order(scheduled) == ("Z", "X")
    two = 'home = ["X", "Z"]\n' + file.read_text(encoding="utf-8")
    code, written, err = compiled(two, tmp_path, capsys)
    assert (code, written, err.count("\n")) == (2, "", 1)
    assert "the list brings the cylinders home in two orders, X, Z and Z, X" in err


@pytest.mark.parametrize(
    ("home", "words"),
    [
        ('["Z"]', 'list.toml:4: home = ["Z"] does not name every cylinder once'),
        ("true", "list.toml:4: home = true does not name every cylinder once"),
        ('["Z", "X"]\ntimeout = "1 s"', "list.toml:5: unknown key 'timeout'"),
    ],
)
def test_a_homing_operation_that_is_wrong_is_refused_with_its_line(
    home: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = f'[[operation]]\nvalve = "main_air"\n[[operation]]\nhome = {home}\n'
    code, _, err = compiled(text, tmp_path, capsys)
    assert (code, err.count("\n")) == (2, 1)
    assert words in err


def test_a_list_that_moves_nothing_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = '[[operation]]\nvalve = "main_air"\n[[operation]]\nmove = { X = "0 mm" }\n'
    code, written, err = compiled(text, tmp_path, capsys)
    assert code == 0
    assert written
    assert "list.toml:3: this move moves nothing" in err
    assert "its own homing from other places" in err


def test_shared_addresses_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    library = Path(__import__("threadline.machine").machine.__file__).parent / "library"
    text = (library / "letter-placer.toml").read_text(encoding="utf-8")
    machine = tmp_path / "twice.toml"
    machine.write_text(text.replace('"%IX0.6"', '"%IX0.5"'), encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["prove", str(CYCLE), "-m", str(machine)])
    err = capsys.readouterr().err
    assert (ended.value.code, err.count("\n")) == (2, 1)
    assert "contacts.z_is_down.address: z_is_up already has %IX0.5" in err


@pytest.mark.parametrize(
    ("old", "new", "always"),
    [
        ('"6 mm +- 2 mm, assumed", beyond = "below"', '"206 mm", beyond = "below"', "on"),
        ('"6 mm +- 2 mm, assumed", beyond = "below"', '"200 mm", beyond = "below"', "on"),
        ('"194 mm +- 2 mm, assumed", beyond = "above"', '"201 mm", beyond = "above"', "off"),
    ],
)
def test_an_end_switch_beyond_the_stroke_is_refused(
    old: str, new: str, always: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is always on at X: homing would end, and the cycle begin, with X anywhere."""
    text = (LIBRARY / "letter-placer.toml").read_text(encoding="utf-8")
    machine = tmp_path / "beyond.toml"
    new = new.replace(" mm", " mm exact, assumed")
    machine.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["compile", str(CYCLE), "-m", str(machine), "--target", "st", "-o", "out.st"])
    err = capsys.readouterr().err
    assert (ended.value.code, err.count("\n")) == (2, 1)
    assert (
        f"is not within the stroke of X, 200 mm, so that the switch would always be {always}" in err
    )
    assert "beyond.toml:11" in err


def test_a_miss_that_two_moves_share_is_told_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = compiled(CYCLE.read_text(encoding="utf-8"), tmp_path, capsys)
    assert (code, err.count("is commanded to 202.10 mm instead of 200.00 mm")) == (0, 1)
    assert "list.toml:50, 89: X is commanded to" in err


def test_times_of_the_way_home_hold_over_the_tolerances(tmp_path: Path) -> None:
    """A soft start of 3.2 s +- 30 % lasts 4.16 s, and X at its slowest 1.86 s.

    By hand: 200 mm at 0.9 * 0.37 of 0.75 * 0.43 m/s, then 1.5 * 0.2 s and four times 1.5 * 0.12 s.
    """
    file = tmp_path / "slow.toml"
    text = (LIBRARY / "letter-placer.toml").read_text(encoding="utf-8")
    for old, new in (
        ('ramp = "1.15 s +- 30 %', 'ramp = "3.2 s +- 30 %'),
        ('speed = "0.43 m/s +- 3 %', 'speed = "0.43 m/s +- 25 %'),
        ('x_left_a2 = "0.37 +- 1 %, assumed: as forward', 'x_left_a2 = "0.37 +- 10 %, assumed'),
        ('delay = "0.2 s +- 20 %', 'delay = "0.2 s +- 50 %'),
        ('lag = "0.12 s +- 20 %', 'lag = "0.12 s +- 50 %'),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    file.write_text(text, encoding="utf-8")
    machine = load_machine(file)
    out = tmp_path / "cycle.st"
    write(plan_job(read_job(CYCLE, machine), machine, Options()), "st", out)
    written = out.read_text(encoding="ascii")
    ms = {n: int(t) for n, t in re.findall(r"(\w+) : TIME := T#(\d+)ms", written)}
    assert [ms[name] for name in ("t_start_1", "t_homing_1", "t_hand_air")] == [4160] * 3
    stroke_s = 0.2 / (0.9 * 0.37 * 0.75 * 0.43)
    rest_s = 1.5 * 0.2 + 4 * 1.5 * 0.12
    pressed = home_stage(machine, "X")
    assert stroke_s == pytest.approx(1.862, abs=1e-3)
    assert pressed.pressed_s >= stroke_s + rest_s
    assert pressed.late_s >= stroke_s + rest_s


def test_a_switch_at_the_edge_of_its_tolerance_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """z_is_down switches at 94 +- 2 mm: with Z at 95 mm it may stay off, with Z at 97 mm not."""
    file = tmp_path / "edge.toml"
    steps = '[[operation]]\nvalve = "main_air"\n[[operation]]\nmove = { Z = "95 mm" }\n'
    for place, message in ((95, True), (97, False)):
        text = steps.replace("95", str(place)) + '[[operation]]\nwait = "z_is_down"\n'
        file.write_text(text, encoding="utf-8")
        main_or_exit(["prove", str(file), "-m", "letter-placer", "--nominal"])
        err = capsys.readouterr().err
        assert ("may never come: Z stands at 95 mm then" in err) is message
        assert ("edge.toml:5" in err) is message


def main_or_exit(words: list[str]) -> None:
    with pytest.raises(SystemExit):
        main(words)


def test_cylinder_that_an_interlock_needs_is_homed_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """X needs z_is_up: Z first, although the list moves Z last; the other order is refused.

    If both are away, homing then ends at the start; X first would wait for ever.
    """
    machine = load_machine("letter-placer")
    file, out = tmp_path / "list.toml", tmp_path / "free.st"
    file.write_text(FREE, encoding="utf-8")
    plan = plan_job(read_job(file, machine), machine, Options())
    assert home_order(plan.scheduled) == ("Z", "X")
    write(plan, "st", out)
    bench = Bench(Plc(read_in_parts(out.read_text(encoding="ascii"))), cell=Cell(120.0, 60.0))
    bench.home()
    assert [bench.cell.pistons[a].at for a in "xz"] == [0.0, 0.0]
    code, written, err = compiled('home = ["X", "Z"]\n' + FREE, tmp_path, capsys)
    assert (code, written, err.count("\n")) == (2, "", 1)
    assert "home = X, Z brings X back before Z, and X moves only with z_is_up on" in err
