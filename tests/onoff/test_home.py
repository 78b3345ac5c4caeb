"""The order of the way home that a move list says: kept, or refused with its line."""

from __future__ import annotations

from pathlib import Path

import pytest

from threadline.cli.main import main
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.options import Options
from threadline.pipeline import plan_job
from threadline.search.move_list import move_list
from threadline.targets.plc_home import home_order, home_places

CYCLE = Path(__file__).parents[2] / "examples" / "letter-cycle.toml"
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
    """Without a word Z comes last, as it moves last; the list's own order goes before that."""
    machine = load_machine("letter-placer")
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
    code_of_it, said, _ = compiled(again, tmp_path, capsys)
    assert (code, code_of_it) == (0, 0)
    body = [[line for line in t.splitlines() if "sha256" not in line] for t in (plain, said)]
    assert len(body[0]) > 500
    assert body[0] == body[1]


@pytest.mark.parametrize(
    ("home", "said"),
    [
        ('["X", "Z"]', "brings X back before Z, and the list moves X only with Z at its start"),
        ('["Z"]', "home = 'Z' does not name every cylinder once"),
        ('["Z", "Z"]', "home = 'Z, Z' does not name every cylinder once"),
        ('["Z", "Y"]', "home = 'Z, Y' does not name every cylinder once"),
        ('"Z"', "home = 'Z' does not name every cylinder once"),
        ("7", "home = '7' does not name every cylinder once"),
        ("[]", "home = '' does not name every cylinder once"),
    ],
)
def test_an_order_that_brings_nothing_home_is_refused(
    home: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = CYCLE.read_text(encoding="utf-8")
    text = text.replace('name = "letter-cycle"', f'name = "letter-cycle"\nhome = {home}')
    code, written, err = compiled(text, tmp_path, capsys)
    assert (code, written, err.count("\n")) == (2, "", 1)
    assert said in err
    assert "list.toml" in err


def test_a_home_that_no_contact_tells_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The way home of X could not end: its switch at 0 is gone from the machine file."""
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
    assert "no contact tells that X is home" in err


def test_shared_addresses_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    library = Path(__import__("threadline.machine").machine.__file__).parent / "library"
    text = (library / "letter-placer.toml").read_text(encoding="utf-8")
    machine = tmp_path / "twice.toml"
    machine.write_text(text.replace('"%IX0.6"', '"%IX0.5"'), encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["prove", str(CYCLE), "-m", str(machine)])
    err = capsys.readouterr().err
    assert (ended.value.code, err.count("\n")) == (2, 1)
    assert "contacts.z_is_down.address: %IX0.5 is that of z_is_up already" in err
