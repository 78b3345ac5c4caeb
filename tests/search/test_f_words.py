"""A feed as an F word: the found F can be typed into the program and gives the same motion."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from threadline.cli.main import main
from threadline.errors import OptionError
from threadline.jobs import Job, read_job
from threadline.jobs.gcode.feeds import as_f_words
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import Machine, load_machine
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.search.feed import feed_range_m_s, searched_by

EXAMPLES = Path(__file__).parents[2] / "examples"
PROGRAM = "G21 G90 G94 F100\nG1 X30 A400\nG1 A500 F250\nG1 X2 A560\nG4 P0.2\nG1 X0\nM30\n"
RULES = (
    "fastest-axis",
    "path",
    "base-axes:A",
    "base-axes:A,X",
    "cadfil",
    "grbl",
    "fluidnc",
    "fanuc",
)
IN_TURN = ("linuxcnc", "marlin")


@pytest.fixture
def winder(tmp_path: Path) -> Machine:
    """A winder with X and A and without an operator, whose feed would cap F."""
    file = tmp_path / "mine.toml"
    file.write_text('base = "lathe-winder"\nname = "mine"\n')
    return load_machine(file)


def job_of(folder: Path, machine: Machine, text: str, rule: str) -> Job:
    path = folder / f"{len(list(folder.iterdir()))}.ngc"
    path.write_text(text)
    name, _, base = rule.partition(":")
    more = {"base_axes": tuple(base.split(","))} if base else {}
    return read_job(path, machine, dialect="linuxcnc", feed_mode=name, **more)


@pytest.mark.parametrize("rule", [*RULES, *IN_TURN])
def test_an_f_word_is_the_f_of_the_program(tmp_path: Path, winder: Machine, rule: str) -> None:
    """``--feed "F 3000"`` equals the program with every F replaced by hand, up to rounding."""
    typed_in = job_of(tmp_path, winder, re.sub(r"F\d+", "F3000", PROGRAM), rule)
    by_hand = plan_job(typed_in, winder, Options())
    asked = plan_job(
        job_of(tmp_path, winder, PROGRAM, rule), winder, Options(feed=parse_feed("F 3000"))
    )
    assert asked.duration_s == pytest.approx(by_hand.duration_s, rel=1e-12)
    ours, theirs = (
        np.concatenate([block.nominal_s for block in plan.motion.programmed])
        for plan in (asked, by_hand)
    )
    assert ours == pytest.approx(theirs, rel=1e-12)


def test_an_f_word_has_its_unit() -> None:
    """3000 mm/min are 50 mm/s; blanks, a small letter and other units are accepted."""
    for text in ("F 3000", "f3000", " F3000 mm/min", "F 50 mm/s", "F 0.05 m/s"):
        assert parse_feed(text) == Feed(FeedMode.F_WORD, pytest.approx(0.05, rel=1e-15))
    for text in ("F", "F x", "F -1", "F 0", "F 3 count/tick", "F nan"):
        with pytest.raises(OptionError):
            parse_feed(text)


def test_the_ends_of_the_search_are_those_of_the_axes(tmp_path: Path, winder: Machine) -> None:
    """At all axes' limits grbl's F is the root of squares; Marlin takes X and Y, or A."""
    limits = dict(zip(winder.axis_names, winder.velocity_limit, strict=True))
    turns = [axis in winder.rotary for axis in limits]
    speeds = np.where(turns, np.degrees(list(limits.values())), 1e3 * np.array([*limits.values()]))
    one = {axis: speed for axis, speed in zip(limits, speeds, strict=True)}
    of_all = 1e3 * feed_range_m_s(winder, FeedMode.F_WORD, "grbl")[1]
    in_turn = 1e3 * feed_range_m_s(winder, FeedMode.F_WORD, "marlin")[1]
    assert of_all == pytest.approx(np.linalg.norm(speeds), rel=1e-5)
    assert in_turn == pytest.approx(max(one["A"], np.hypot(one["X"], one["Y"])), rel=1e-5)
    one_f = PROGRAM.replace("F250", "F100")
    job = job_of(tmp_path, winder, one_f, "fastest-axis")
    assert searched_by(job, winder) is FeedMode.FASTEST_AXIS
    assert searched_by(job_of(tmp_path, winder, one_f, "cadfil"), winder) is FeedMode.F_WORD


def left_with(words: list[str]) -> int:
    with pytest.raises(SystemExit) as left:
        main(words)
    assert isinstance(left.value.code, int)
    return left.value.code


@pytest.mark.usefixtures("coarse_search")
def test_fastest_f_typed_into_the_program_gives_the_printed_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By grbl's own rule: the file with this F takes the printed time."""
    settings = EXAMPLES / "grbl-settings.txt"
    words = ["--limits-only", "--set", "rotary=A", "--set", "radius=50 mm"]
    mine = tmp_path / "mine"
    assert left_with(["new", "grbl", str(mine), "--from", str(settings), *words]) == 0
    machine, file = str(mine / "machine.toml"), tmp_path / "helix.gcode"
    text = (EXAMPLES / "helix.gcode").read_text()
    file.write_text(text)
    span = ["--low", "F 3000", "--high", "F 9000"]
    capsys.readouterr()
    assert left_with(["fastest", str(file), "-m", machine, *span, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["feed"] == "grbl"
    assert found["best"] == pytest.approx(0.15)
    again = shlex.split(found["command"])
    assert again[again.index("--feed") + 1] == "F 9000"
    file.write_text(re.sub(r"F6000", f"F{60_000.0 * found['best']:g}", text))
    assert left_with(["prove", str(file), "-m", machine, "--json"]) == 0
    proved = json.loads(capsys.readouterr().out)
    assert proved["duration_s"] == pytest.approx(found["duration_s"], rel=1e-9)
    assert left_with(["fastest", str(file), "-m", machine, *span[:3], "150 mm/s"]) == 2
    assert "different kinds" in capsys.readouterr().err


@pytest.mark.parametrize("rule", ["x-winder", ""])
def test_f_that_is_no_speed_is_not_asked_for(rule: str) -> None:
    """The F of X-Winder counts the carriage alone, and a seam has no F."""
    with pytest.raises(OptionError, match="is not the speed of its moves"):
        as_f_words(0.1, rule)
