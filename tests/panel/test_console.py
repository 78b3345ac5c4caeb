"""The console of a controller with grbl, its settings beside the machine file, and its buffer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.live.grbl_model import GrblModel
from tests.live.memory_sink import MemorySink
from tests.live.test_grbl import MACHINE, START, UNITS, settings
from tests.panel.bench import Operator, operator, served
from tests.panel.test_links import grbl, wait
from threadline.errors import CommandError
from threadline.live import grbl_run
from threadline.live.grbl_console import Traffic, console_line
from threadline.live.grbl_controller import Controller
from threadline.live.grbl_operated import GrblOperated
from threadline.live.grbl_settings import Mark, compared
from threadline.live.grbl_words import program_of
from threadline.live.port import Port
from threadline.live.states import Desk, State

LETTERS = ("X", "Y", "Z", "A")
RATE_X = 110
WRITTEN = "home the machine"


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Allow for a busy computer, which gives the model no processor time."""
    monkeypatch.setattr(grbl_run, "SILENCE_S", 3.0)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("G0 X10", "it moves, switches something on, or changes how a program is read"),
        ("x10", "it moves"),
        ("G91", "changes how a program is read"),
        ("M3 S1000", "switches something on"),
        ("$J=G91 X10 F100", "a line has no lease that ends it: jog with the buttons"),
        ("$ j = X10F100", "a line has no lease"),
        ("$H", "press Home all"),
        ("$X", "press Reset"),
        ("$C", "nothing moves"),
        ("$SLP", "the positions are lost"),
        ("$RST=*", "deletes settings"),
        ("$N0=G91", "runs by itself"),
        ("$110=fast", "only a number"),
        ("$13=1", "inches"),
        ("$10=2", "work positions"),
        ("$SD/Run=a.nc", "it is not one of"),
        ("?", "ten times a second"),
        ("!", "press Hold"),
        ("$$~", "press Resume"),
        ("$$\nG0X10", "acts on at once"),
        ("$$\x18", "acts on at once"),
        ("$$\x90", "acts on at once"),
        ("", "is empty"),
        ("$" * 71, "the most is 70"),
        ("$$;G0X10", "it is not one of"),
        ("M5G0X10", "it moves"),
    ],
)
def test_console_line_that_moves_the_machine_is_refused_with_a_sentence(
    line: str, why: str
) -> None:
    with pytest.raises(CommandError, match=why.replace("$", r"\$")):
        console_line(line)


def test_questions_what_switches_off_and_settings_are_sent_as_grbl_reads_them() -> None:
    sent = ["$", "$$", "$#", "$g", " $ i ", "$N", "m5", "M9", "$110=4800.5"]
    assert [console_line(one).text for one in sent] == [
        "$", "$$", "$#", "$G", "$I", "$N", "M5", "M9", "$110=4800.5",
    ]  # fmt: skip
    assert console_line("$110=4800.5").setting == RATE_X
    assert console_line("$$").setting is None


def test_settings_are_told_in_words_beside_the_values_of_the_machine_file() -> None:
    """Steps must be equal, a speed may be lower, and a different travel is only marked."""
    texts = {number: f"{value:.3f}" for number, value in settings().items()}
    texts |= {10: "2", 13: "0", 3: "9", 22: "1", 1: "255", 77: "4", 20: "0"}
    texts[100] = f"{1.01 * settings()[100]:.3f}"
    texts[RATE_X] = f"{0.5 * settings()[RATE_X]:.3f}"
    texts[120] = f"{2.0 * settings()[120]:.3f}"
    del texts[103]
    rows = {one.number: one for one in compared(texts, MACHINE, LETTERS)}
    marks = {number: one.mark for number, one in rows.items()}
    assert marks[100] is Mark.REFUSED and marks[RATE_X] is Mark.LOWER
    assert marks[120] is Mark.REFUSED and marks[103] is Mark.REFUSED
    assert marks[113] is Mark.SAME and marks[13] is Mark.SAME
    assert marks[10] is Mark.REFUSED and marks[77] is Mark.NONE
    assert rows[103].board == "not reported"
    assert (rows[RATE_X].name, rows[RATE_X].unit) == ("highest speed of X", "mm/min")
    assert (rows[113].name, rows[113].unit) == ("highest speed of A", "°/min")
    assert (rows[3].name, rows[3].words) == ("inverted directions", "X, A")
    assert rows[10].words == "work positions, buffer"
    assert (rows[22].words, rows[20].words, rows[1].words) == ("yes", "no", "they stay on")
    assert rows[RATE_X].file == f"{settings()[RATE_X]:.6g}"


def test_reports_jogs_and_answers_to_a_program_are_no_lines_of_the_console() -> None:
    runs = [False]
    traffic = Traffic(lambda: runs[0], lambda: runs[0])
    traffic.sent(b"?")
    traffic.heard("<Idle|MPos:0.000,0.000,0.000|Bf:15,128>")
    traffic.sent(b"$J=G21G90G53X1.0000F100.00\n")
    traffic.sent(b"\x92\x94")
    traffic.sent(b"$$\n")
    traffic.heard("ok")
    runs[0] = True
    traffic.sent(b"G1 X1 F100\n")
    traffic.heard("ok")
    traffic.heard("error:20")
    found = [(one.kind, one.text, one.words) for one in traffic.take()]
    assert found == [
        ("sent", "$$", ""),
        ("heard", "ok", ""),
        ("program", "G1 X1 F100", ""),
        ("heard", "error:20", "it does not know this command"),
    ]
    assert traffic.take() == []


def test_a_line_is_not_sent_in_a_run_nor_in_its_hold() -> None:
    """It would wait behind the lines of the run, and act when nobody expects it any more."""
    model = GrblModel(settings(), faster=0.2)
    model.start()
    desk = Desk()
    one = GrblOperated(Controller(Port(model.address), MACHINE), desk, MemorySink())
    try:
        one.connect()
        one.enable()
        one.home()
        one.start(program_of(b"G1 A90 X40 F600\n", MACHINE.axis_names, UNITS, START), START)
        one._set_out = True
        for state in (State.RUNNING, State.HOLDING):
            one.state = state
            with pytest.raises(CommandError, match="while the machine moves or a run is held"):
                one.type_line("M5")
        assert b"M5" not in model.heard
    finally:
        one.close()
        desk.close()
        model.close()


def typed(anna: Operator, line: str) -> str:
    return anna.act("console", line=line)


def messages_of(anna: Operator, kind: str = "heard") -> list[str]:
    """Return the console lines shown so far."""
    lines = [one for event in anna.heard if event["type"] == "console" for one in event["lines"]]
    return [one["text"] for one in lines if one["kind"] == kind]


def boards(anna: Operator) -> list[dict[int, dict[str, Any]]]:
    """Return the settings by number, for each time that they were read."""
    boards_seen = [one["settings"] for one in anna.heard if one["type"] == "board"]
    return [{row["number"]: row for row in rows} for rows in boards_seen]


def test_typed_lines_are_answered_and_a_written_setting_has_to_be_compared(
    tmp_path: Path,
) -> None:
    """A question changes nothing; after a reset a lower speed is accepted, not a higher one."""
    model = GrblModel(settings())
    right = settings()[RATE_X]
    with grbl(tmp_path, model) as anna:
        welcome = next(one for one in anna.heard if one["type"] == "welcome")
        assert welcome["console"]
        wait(anna, lambda: anna.state["board"] is not None)
        full = {"blocks": 0, "of_blocks": 15, "characters": 0, "of_characters": 128}
        assert anna.state["board"] == full
        assert boards(anna)[0][RATE_X]["mark"] == "same"
        assert "[AXS:4:XYZA]" in messages_of(anna)  # the settings were read when the link was made
        assert typed(anna, "$I") == ""
        wait(anna, lambda: messages_of(anna).count("[AXS:4:XYZA]") == 2)
        assert messages_of(anna, "typed") == ["$I"]
        assert anna.state["state"] == "idle"
        assert "it moves" in typed(anna, "G0 X10")
        assert "a line has no lease" in typed(anna, "$J=X10F100")
        assert b"X10" not in model.heard
        assert typed(anna, f"$110={2 * right:g}") == ""
        wait(anna, lambda: anna.state["state"] == "fault")
        assert WRITTEN in anna.state["why"]
        assert f"${RATE_X}={2 * right:g} of the controller" in anna.act("reset")
        assert anna.until("state")["state"] == "fault"
        assert typed(anna, f"$110={right / 2:g}") == ""
        assert anna.act("reset") == ""
        assert anna.until("state")["state"] == "disabled"
        wait(anna, lambda: boards(anna)[-1][RATE_X]["mark"] == "lower")
        assert [one[RATE_X]["mark"] for one in boards(anna)][:2] == ["same", "refused"]


def test_a_board_for_another_machine_is_a_fault_that_the_console_mends(tmp_path: Path) -> None:
    """All differences are shown at once; nothing moves before they are corrected and compared."""
    wrong = settings() | {100: 10.0, 123: 1e6}
    model = GrblModel(wrong)
    with grbl(tmp_path, model, ready=False) as anna:
        anna.take()
        wait(anna, lambda: anna.until("state")["state"] == "fault")
        assert "$123=1e+06 of the controller: the acceleration of A" in anna.state["why"]
        wait(anna, lambda: bool(boards(anna)))
        refused = [row["number"] for row in boards(anna)[0].values() if row["mark"] == "refused"]
        assert refused == [100, 123]
        assert "not possible now" in anna.act("home")
        assert "$123=1e+06" in anna.act("reset")
        for number in refused:
            assert typed(anna, f"${number}={settings()[number]:.6f}") == ""
        assert anna.act("reset") == ""
        assert anna.act("enable") == ""
        assert anna.act("home") == ""
        anna.see("idle")


def test_a_line_that_is_not_answered_is_a_fault(tmp_path: Path) -> None:
    """The next answer would be taken for the missing one."""
    model = GrblModel(settings())
    with grbl(tmp_path, model) as anna:
        model.mute = True
        assert typed(anna, "$G") == ""
        wait(anna, lambda: anna.state["state"] == "fault")
        assert "did not answer '$G' within 3 s" in anna.state["why"]


def test_another_link_has_no_console(tmp_path: Path) -> None:
    with served(tmp_path) as client, operator(client) as anna:
        welcome = next(one for one in anna.heard if one["type"] == "welcome")
        assert not welcome["console"]
        anna.take().see("disabled")
        assert "not possible now" in typed(anna, "$$")
