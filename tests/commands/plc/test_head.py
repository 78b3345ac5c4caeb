"""The head of the emitted text names its purpose, and the part that each time belongs to."""

from __future__ import annotations

import re
from pathlib import Path

from tests.commands.plc.texts import ROOT, text_of
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, write


def test_the_head_names_the_shaper_and_the_mode_that_was_asked_for() -> None:
    head = text_of("letter-placer", "um-2ei").split("VAR_INPUT")[0]
    for axis in "XZ":
        assert f"(* {axis}: shaped by um-2ei for 3.04 Hz, damping ratio 0.17 *)" in head
    assert "no safety function" in head
    assert "(* Compiling proves nothing: threadline prove of this list" in head
    assert "(* X: unshaped *)" in text_of("letter-placer", "none").split("VAR_INPUT")[0]


def test_the_head_does_not_call_moves_unshaped_whose_levels_are_written_out(tmp_path: Path) -> None:
    listed = (ROOT / "examples" / "letter-cycle.toml").read_text(encoding="utf-8")
    plain = 'move = { Z = "100 mm" }\n'
    levels = 'levels = "0.63 for 100 ms, 1 for 400 ms, 0.37 for 100 ms"\n'
    (tmp_path / "own.toml").write_text(listed.replace(plain, plain + levels), encoding="utf-8")
    machine = load_machine("letter-placer")
    job = read_job(tmp_path / "own.toml", machine)
    write(plan_job(job, machine, Options()), "st", tmp_path / "own.st")
    head = (tmp_path / "own.st").read_text(encoding="ascii").split("VAR_INPUT")[0]
    assert "(* X: unshaped *)" in head
    assert "(* Z: each move as the move list says *)" in head


def test_times_of_one_move_tell_its_parts_and_since_when_they_count() -> None:
    pattern = r"\bt_across_\d+ : TIME := T#\d+ms; \(\* (.*?) \*\)"
    notes = re.findall(pattern, text_of("letter-placer", "zv"))
    assert notes[:3] == [
        "across: X 200 mm forward, since z_is_up was on",
        "across: X 200 mm forward, part 2, since z_is_up was on",
        "across: X 200 mm forward, part 3, since z_is_up was on",
    ]


def test_comments_call_inputs_and_outputs_as_the_program_does(tmp_path: Path) -> None:
    """``if`` is a word of the language, and ``fault_code`` a variable of the block."""
    library = ROOT / "src" / "threadline" / "machine" / "library"
    texts = [library / "letter-placer.toml", ROOT / "examples" / "letter-cycle.toml"]
    for file, new in zip(texts, ("machine.toml", "list.toml"), strict=True):
        text = file.read_text(encoding="utf-8")
        text = re.sub(r"\bknife\b(?= =|\")", "fault_code", text)
        (tmp_path / new).write_text(re.sub(r"\bz_is_up\b", "if", text), encoding="utf-8")
    machine = load_machine(tmp_path / "machine.toml")
    job = read_job(tmp_path / "list.toml", machine)
    write(plan_job(job, machine, Options()), "st", tmp_path / "own.st")
    comments = re.findall(r"\(\*.*?\*\)", (tmp_path / "own.st").read_text(encoding="ascii"))
    message = " ".join(comments)
    assert "if_signal was on" in message
    assert "fault_code_2" in message
    assert not re.search(r"\bif (was|must|is)\b|\bfault_code\b", message)
