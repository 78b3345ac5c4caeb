"""Interlocks of the machine file: contradicting steps and wrong levels are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from threadline.cli.main import main

AIR = '[[operation]]\nvalve = "main_air"\n'
DOWN = '[[operation]]\nmove = { Z = "100 mm" }\n'
KNIFE = '[[operation]]\noutput = "knife"\n'
LIBRARY = Path(__import__("threadline.machine").machine.__file__).parent / "library"


def errors_of(text: str, machine: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one line with which ``prove`` refuses a list."""
    file = folder / "list.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["prove", str(file), "-m", machine])
    err = capsys.readouterr().err
    assert (ended.value.code, err.count("\n")) == (2, 1), err
    return err


@pytest.mark.parametrize(
    ("steps", "line", "words"),
    [
        (AIR + KNIFE, 3, "knife is on only with z_is_down on, and Z is at 0 mm then"),
        (
            AIR + DOWN + KNIFE + '[[operation]]\nmove = { Z = "0 mm" }\n',
            7,
            "knife is on only with z_is_down on, and Z is at 100 to 0 mm then",
        ),
        (
            AIR + '[[operation]]\nmove = { X = "200 mm" }\n' + DOWN + KNIFE,
            7,
            "knife is on only with x_is_left on, and X is at 200 mm then",
        ),
        (
            AIR + '[[operation]]\nmove = { Z = "100 mm" }\nrest = "50 ms"\n' + KNIFE,
            6,
            "knife is on only with z_is_down on, and Z may still be on its way then",
        ),
    ],
)
def test_steps_that_contradict_the_interlocks_are_refused_with_their_line(
    steps: str, line: int, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    err = errors_of(steps, "letter-placer", tmp_path, capsys)
    assert f"list.toml:{line}: {words}" in err


def with_x_locked(folder: Path, needs: str) -> str:
    text = (LIBRARY / "letter-placer.toml").read_text(encoding="utf-8")
    own = 'needs = ["z_is_up"]\n'
    assert text.count(own) == 1
    text = text.replace(own, f"needs = {needs}\n")
    file = folder / "locked.toml"
    file.write_text(text, encoding="utf-8")
    return str(file)


def test_a_cylinder_moves_only_where_its_interlock_holds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A move with the lift down, or moving, is refused; with the lift up the example is proved."""
    machine = "letter-placer"
    out = '[[operation]]\nmove = { X = "200 mm" }\n'
    both = '[[operation]]\nmove = { X = "200 mm", Z = "100 mm" }\n'
    err = errors_of(AIR + DOWN + out, machine, tmp_path, capsys)
    assert "list.toml:5: X moves only with z_is_up on, and Z is at 100 mm then" in err
    err = errors_of(AIR + both, machine, tmp_path, capsys)
    assert "X moves only with z_is_up on, and Z is at 0 to 100 mm then" in err
    up = '[[operation]]\nmove = { X = "200 mm", Z = "0 mm" }\n'
    err = errors_of(AIR + DOWN + up, machine, tmp_path, capsys)
    assert "list.toml:5: X moves only with z_is_up on, and Z is at 100 to 0 mm then" in err
    free = with_x_locked(tmp_path, "[]")
    with pytest.raises(SystemExit) as ended:
        main(["prove", str(tmp_path / "list.toml"), "-m", free])
    assert ended.value.code == 1, "where it has no interlock a list may do so"
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main(["prove", "examples/letter-cycle.toml", "-m", machine])
    assert ended.value.code == 1, "it rings too much unshaped, and is not refused"


@pytest.mark.parametrize(
    ("needs", "words"),
    [
        ('["z_is_upp"]', "cylinders.X.needs names 'z_is_upp', which is not an end switch"),
        ('["letter_held"]', "cylinders.X.needs names 'letter_held', which is not an end switch"),
        ('["x_is_left"]', "cylinders.X.needs names 'x_is_left', an end switch of X itself"),
    ],
)
def test_interlocks_that_cannot_be_are_refused(
    needs: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    machine = with_x_locked(tmp_path, needs)
    assert words in errors_of(AIR + DOWN, machine, tmp_path, capsys)


@pytest.mark.parametrize(
    ("levels", "words"),
    [
        ("0 for 50 ms, 1 for 460 ms", "'0 for 50 ms' repeats the level before it"),
        ("1 for 100 ms, 1 for 360 ms", "'1 for 360 ms' repeats the level before it"),
        ("1 for 460 ms, 0 for 50 ms", "they end with 0"),
        ("1 for -30 ms, 0 for 20 ms, 1 for 490 ms", "-30 ms is not a duration above 0"),
        ("1 for 0 s", "0 s is not a duration above 0"),
        ("1 for 455 ms", "no whole number of scans of 10 ms"),
        ("2 for 230 ms", "passes through level 2.000, outside the unshaped 0 ... 1"),
        ("1 for 400 ms", "by 172.00 mm, and its move is 200.00 mm"),
        ("1 for 450 ms, 0.63 for 10 ms, 0.37 for 10 ms", "would switch again after 10 ms"),
    ],
)
def test_levels_that_are_out_of_order_are_refused_with_their_line(
    levels: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    move = f'[[operation]]\nmove = {{ X = "200 mm" }}\nlevels = "{levels}"\n'
    err = errors_of(AIR + move, "letter-placer", tmp_path, capsys)
    assert "list.toml:" in err and words in err


def test_a_dwell_longer_than_the_move_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """4.3 mm take one scan of 10 ms at 0.43 m/s; the valves need 20 ms between two switchings."""
    err = errors_of(
        AIR + '[[operation]]\nmove = { X = "4.3 mm" }\n', "letter-placer", tmp_path, capsys
    )
    assert "would switch again after 10 ms; it needs 20 ms" in err
