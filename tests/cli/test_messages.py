"""Messages: an error stands alone, warnings follow the answer, defects have status 70."""

from __future__ import annotations

import io
import os
import pty
import re
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numba
import pytest

from threadline.base.progress import COMPILING
from threadline.cli import messages, output, prove
from threadline.cli.main import main
from threadline.errors import PlanError
from threadline.proof.kinds import kind as watched
from threadline.proof.kinds import ticks
from threadline.report import proof as report_of_proofs

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
PROVE = ["prove", str(EXAMPLES / "x-180.prg"), "-m", "lathe-winder"]
START = [sys.executable, "-m", "threadline"]


def stopped(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[object, str, str]:
    with pytest.raises(SystemExit) as caught:
        main([str(word) for word in words])
    captured = capsys.readouterr()
    return caught.value.code, captured.out, captured.err


def test_a_defect_has_a_status_of_its_own_and_keeps_its_traceback(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Status 1 means that a job is out of specification, so a crash must have another one."""

    def crashes(*_: object) -> None:
        raise ValueError("math domain\nerror of two lines")

    monkeypatch.setattr(prove, "prove_job", crashes)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    code, out, err = stopped(capsys, *PROVE)
    assert (code, out, err.count("\n")) == (70, "", 1)
    assert "[DEFECT]" in err
    assert "ValueError at test_messages.py:" in err
    assert "math domain error of two lines" in err
    (kept,) = tmp_path.iterdir()
    assert str(kept) in err
    text = kept.read_text(encoding="utf-8")
    assert "Traceback" in text
    assert f"threadline {' '.join(PROVE)}" in text


def test_a_defect_without_room_for_its_traceback_is_reported_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def crashes(*_: object) -> None:
        raise ValueError

    monkeypatch.setattr(prove, "prove_job", crashes)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    code, out, err = stopped(capsys, *PROVE)
    assert (code, out, err.count("\n")) == (70, "", 1)
    assert "could not be kept: No such file" in err


def test_too_little_memory_is_no_defect(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def starves(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(prove, "prove_job", starves)
    code, out, err = stopped(capsys, *PROVE)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "[PLAN-BUDGET] this needs more memory" in err


def test_an_error_comes_without_the_warnings_before_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stitcher as built has eight: printed before the error, they hid it."""

    def refuses(*_: object) -> None:
        raise PlanError("too fast")

    words = ["compile", EXAMPLES / "stitcher-test-path.seam.toml", "-m", "stitcher"]
    words += ["--target", "csv", "--interpolation", "linear", "-o", tmp_path / "t.csv"]
    with monkeypatch.context() as patched:
        patched.setattr(ticks, "check_limits", refuses)
        assert stopped(capsys, *words) == (2, "", "error: [PLAN] too fast.\n")
    monkeypatch.setattr(ticks, "check_limits", lambda *_: None)
    code, out, err = stopped(capsys, *words)
    assert code == 0
    assert out.endswith("t.csv\n")
    assert 0 < err.count("\n") < 8
    assert "(likewise axes.Y)" in err


def test_warnings_come_after_the_answer(capfd: pytest.CaptureFixture[str]) -> None:
    held = []
    with messages.telling() as telling:
        messages.warning("later")
        held += telling.warnings
    messages.warning("now")
    assert held == ["later"]
    assert capfd.readouterr().err == "warning: now\n"


def test_a_long_run_says_a_word_every_minute(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only if no bar is drawn; a minute is a moment here."""
    monkeypatch.setattr(messages, "EVERY_S", 0.01)
    heard = ""
    with messages.telling():
        messages.at_work("simulating", shown=False)
        while ": simulating" not in heard:
            heard += capsys.readouterr().err
    assert re.search(r"still at work after \d+ s: simulating\n", heard)


def test_nothing_is_said_while_a_question_waits_for_its_answer(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A line in the middle of a question looks like a part of it."""

    heard = []

    class Slow(io.StringIO):
        def readline(self, size: int | None = -1) -> str:
            time.sleep(0.1)  # for a line that had begun before
            capsys.readouterr()
            time.sleep(0.3)
            heard.append(capsys.readouterr())
            return "40 mm\n"

    monkeypatch.setattr(messages, "EVERY_S", 0.01)
    monkeypatch.setattr("sys.stdin", Slow())
    with messages.telling():
        assert output.ask("radius [40 mm]: ") == "40 mm\n"
    assert heard == [("", "")]


@pytest.mark.parametrize(
    ("kept", "message"),
    [
        (True, "once on this computer: later runs begin at once"),
        (
            False,
            "as every run does on this computer: .* can be written; name one in NUMBA_CACHE_DIR",
        ),
    ],
)
def test_the_first_run_on_a_computer_says_once_that_it_compiles(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, kept: bool, message: str
) -> None:
    """A function without a cache stands for those on a new computer; the seconds are 0 here."""
    monkeypatch.setattr(messages, "LOOK_S", 0.01)
    monkeypatch.setattr(messages, "COMPILING_S", 0.0)
    monkeypatch.setattr(COMPILING, "cached", kept)
    before_s, before = COMPILING.lasted_s(), COMPILING.functions
    with messages.telling():
        time.sleep(0.1)
        assert not capsys.readouterr().err  # nothing is compiled yet

        assert numba.njit(lambda x: x + 1)(1) == 2
        heard = ""
        while not heard:
            heard += capsys.readouterr().err
        assert numba.njit(lambda x: x - 1)(1) == 0
        time.sleep(0.1)
    heard += capsys.readouterr().err
    assert re.fullmatch(f"compiling machine code, {message}\\n", heard)
    assert (COMPILING.depth, COMPILING.functions) == (0, before + 2)
    assert 0.0 < COMPILING.lasted_s() - before_s < 60.0


def test_an_error_is_the_last_line_however_slowly_a_word_before_it_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A message of a long run that has begun is finished first: not after the error, nor in it."""
    began = threading.Event()
    write = messages.note

    def slowly(text: str) -> None:
        began.set()
        time.sleep(0.2)
        write(text)

    def refuses(*_: object) -> None:
        began.clear()
        assert began.wait(60.0)
        raise PlanError("too fast")

    monkeypatch.setattr(messages, "EVERY_S", 0.01)
    monkeypatch.setattr(messages, "note", slowly)
    monkeypatch.setattr(ticks, "check_limits", refuses)
    words = ["compile", EXAMPLES / "stitcher-test-path.seam.toml", "-m", "stitcher"]
    words += ["--target", "csv", "--interpolation", "linear", "-o", tmp_path / "t.csv"]
    with pytest.raises(SystemExit):
        main([str(word) for word in words])
    time.sleep(0.5)  # for a message that is still being written
    out, err = capsys.readouterr()
    *message, error = err.splitlines()
    assert (out, error) == ("", "error: [PLAN] too fast.")
    assert message and all(line.startswith("still at work after ") for line in message)


def test_the_word_of_each_minute_says_how_long_it_will_be(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A quarter done in two hours: six are left. Without any share there is no guess."""
    now_s = time.monotonic()
    with messages.telling() as telling:
        messages.at_work("simulating", shown=False)
        assert telling.doing() == "simulating"
        monkeypatch.setattr(time, "monotonic", lambda: now_s + 7200.0)
        messages.at_work("simulating", 0.25, shown=False)
        assert telling.doing() == "simulating, 25 % done, about 6 h more"
        messages.at_work("simulating", 0.996, shown=False)
        assert telling.doing() == "simulating, nearly done"
    assert not capsys.readouterr().err
    # A first message with a share counts from the start of the command.
    monkeypatch.undo()
    with messages.telling() as telling:
        now_s = time.monotonic()
        monkeypatch.setattr(time, "monotonic", lambda: now_s + 60.0)
        messages.at_work("narrowing", 0.25, shown=False)
        assert telling.doing() == "narrowing, 25 % done, about 3 min more"


def test_the_time_left_is_shown_once_it_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first percent or a share that stands still tells nothing; the last half tells most."""
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    telling = messages.Telling(since_s=0.0)

    def at(time_s: float, share: float) -> str:
        clock[0], telling.stage, telling.fraction = time_s, "searching", share
        return telling.doing()

    assert at(100.0, 0.01) == "searching, 1 % done"
    assert at(500.0, 0.1) == "searching, 10 % done, about 67 min more"
    assert at(700.0, 0.5) == "searching, 50 % done, about 10 min more"
    assert at(800.0, 0.5) == "searching, 50 % done, about 8.5 min more"
    assert at(2000.0, 0.5) == "searching, 50 % done"


def test_a_stage_that_names_what_it_is_at_is_one_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half done in an hour: an hour is left, although the last part has only just begun."""
    now_s = time.monotonic()
    with messages.telling() as telling:
        messages.at_work("commands of 90 ticks", 0.0, shown=False)
        monkeypatch.setattr(time, "monotonic", lambda: now_s + 3600.0)
        messages.at_work("commands of 100 ticks", 0.5, shown=False)
        assert telling.doing() in {
            "commands of 100 ticks, 50 % done, about 60 min more",
            "commands of 100 ticks, 50 % done, about 1 h more",
        }
        messages.at_work("cycles side by side", 0.0, shown=False)
        monkeypatch.setattr(time, "monotonic", lambda: now_s + 3610.0)
        messages.at_work("cycles side by side", 0.5, shown=False)
        assert telling.doing() == "cycles side by side, 50 % done, about 10 s more"


def test_a_run_without_a_terminal_says_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No bar is drawn there. The messages come from the run itself, block by block."""
    monkeypatch.setattr(messages, "EVERY_S", 0.002)
    monkeypatch.setattr(watched, "LONG_S", 0.0)
    code, _, err = stopped(capsys, *PROVE, "--nominal", "--feed", "0.2 mm/s")
    assert code == 0
    assert re.search(r": simulating and judging, \d+ % done, about [\d.]+ s more\n", err)


def test_standard_streams_that_are_closed_or_full() -> None:
    """A closed stream gets nothing, and the status is the answer; a full one is a named error."""
    law = [*START, "law", "cubic"]
    shell = {"out": [*law, ">&-"], "err": [*law, "2>&-", ">", os.devnull]}
    for words in shell.values():
        done = subprocess.run(
            " ".join(words), shell=True, capture_output=True, check=False, timeout=120
        )
        assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(law, stdout=full, stderr=subprocess.PIPE, check=False, timeout=120)
    assert done.returncode == 2
    assert done.stderr.startswith(b"error: [FILE] cannot use standard output: No space left")
    assert done.stderr.count(b"\n") == 1
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [*START, "law", "none"], stdout=subprocess.PIPE, stderr=writing, check=False, timeout=120
    )
    os.close(writing)
    assert (done.returncode, done.stdout) == (2, b"")


def test_a_name_that_is_no_text_is_refused() -> None:
    """Neither JSON nor a recording could hold it."""
    done = subprocess.run(
        [*START, b"prove", b"\xff.prg", b"-m", b"lathe-winder"],
        capture_output=True,
        check=False,
        timeout=120,
    )
    assert (done.returncode, done.stdout, done.stderr.count(b"\n")) == (2, b"", 1)
    assert b"is not UTF-8 text. Rename the file." in done.stderr


@pytest.mark.parametrize(
    "text", ["[/b]", "[red]x[/]", ":warning:", "\x1b[2J", "a\nIN SPEC", "\x9b"]
)
def test_text_of_the_user_neither_marks_up_nor_drives_the_terminal(
    text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    output.print_table(text, [text, "note"], [[text, text]])
    output.say(text)
    messages.note(text)
    captured = capsys.readouterr()
    shown = text.replace("\x1b", "\\x1b").replace("\n", "\\n").replace("\x9b", "\\x9b")
    assert captured.out.count(shown) == 5
    assert captured.err == f"{shown}\n"
    assert "\x1b" not in captured.out
    assert "\x9b" not in captured.out


def test_only_one_file_writes_to_the_streams() -> None:
    """So that no text of the user reaches them unescaped."""
    cli = Path(output.__file__).parent
    for file in cli.glob("*.py"):
        text = file.read_text(encoding="utf-8")
        if file.name not in {"output.py", "messages.py", "main.py", "start.py"}:
            assert not re.search(r"typer\.echo|sys\.std(out|err)|(?<!\w)print\(", text), file


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_sees_within_a_second_that_a_command_is_loaded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The message is removed before anything else is printed, and does not come again."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    assert messages.STARTING_S < 1.0
    monkeypatch.setattr(messages, "STARTING_S", 0.0)
    with messages.telling(starting=True):
        waited = threading.Event()
        for _ in range(200):
            if terminal.getvalue():
                break
            waited.wait(0.05)
        assert terminal.getvalue() == "starting ..."
        messages.note("first")
        messages.STARTING.show()
        messages.note("second")
    assert terminal.getvalue() == f"starting ...\r{' ' * 12}\rfirst\nsecond\n"


def test_nothing_is_shown_of_the_start_without_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(messages, "STARTING_S", 0.0)
    with messages.telling(starting=True):
        time.sleep(0.2)
    assert capsys.readouterr().err == ""


def test_the_word_comes_before_the_command_is_loaded(tmp_path: Path) -> None:
    """On a terminal of its own: a command whose module takes three seconds to import."""
    slow = tmp_path / "slow.py"
    slow.write_text(
        "import sys, time\nfrom threadline.cli import lazy, main\n"
        "real = lazy.import_module\n"
        "def waits(name):\n    time.sleep(3)\n    return real(name)\n"
        "lazy.import_module = waits\nmain.main(['machines'])\n"
    )
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [sys.executable, str(slow)], stdout=subprocess.PIPE, stderr=theirs
    ) as running:
        os.close(theirs)
        message = os.read(ours, 100).decode()
        assert running.poll() is None  # it still waits
        assert message == "starting ..."
        out, _ = running.communicate()
    assert b"lathe-winder" in out
    assert os.read(ours, 100).decode().strip() == ""
    os.close(ours)


def test_a_recording_and_a_report_are_stages_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The judged run is simulated again for writing, which is far from done."""
    shares: dict[str, float] = {}

    def noted(stage: str, fraction: float = 0.0, *, shown: bool) -> None:
        shares.setdefault(stage, fraction)

    def drawn(*_: object) -> Path:
        return tmp_path / "report.html"

    monkeypatch.setattr(output, "at_work", noted)
    monkeypatch.setattr(watched, "LONG_S", -1.0)
    monkeypatch.setattr(report_of_proofs, "write_report", drawn)
    words = ["--nominal", "--interpolation", "linear", "--recording", tmp_path / "x.npz"]
    with pytest.raises(SystemExit):
        main([str(word) for word in [*PROVE, *words, "--report", tmp_path / "report"]])
    assert list(shares) == [
        "planning",
        "simulating and judging",
        "measuring the plan",
        "simulating and writing the recording",
        "drawing the report",
    ]
    assert shares["drawing the report"] == 0.0


def test_a_compilation_says_what_it_is_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    texts: list[str] = []
    monkeypatch.setattr(output, "at_work", lambda stage, *_, **__: texts.append(stage))
    words = [*PROVE[1:], "--target", "csv", "-o", tmp_path / "x.csv"]
    assert PROVE[0] == "prove"
    with pytest.raises(SystemExit):
        main(["compile", *map(str, words)])
    assert texts == ["planning", "writing and reading back"]


def test_the_bar_says_how_far_planning_is_and_no_share_that_nobody_knows() -> None:
    """A stage without a known share has no percentage; planning shows the motion so far."""
    ours, theirs = pty.openpty()
    program = (
        "import time\n"
        "from threadline.base.progress import PLANNING\n"
        "from threadline.cli.on_terminal import bar_on_terminal\n"
        "with bar_on_terminal() as update:\n"
        "    PLANNING.reach(12.5)\n"
        "    update('planning', 0.0)\n"
        "    time.sleep(1.4)\n"
        "    update('simulating', 0.25)\n"
        "    time.sleep(0.4)\n"
    )
    subprocess.run([sys.executable, "-c", program], stderr=theirs, check=True)
    shown = os.read(ours, 65536).decode()
    os.close(ours)
    os.close(theirs)
    planning, simulating = shown.split("simulating", 1)
    assert "planning, 12.5 s of motion so far" in planning and "%" not in planning
    assert "25%" in simulating


def test_the_bar_says_what_is_compiled_and_how_far() -> None:
    """While a stage waits for its machine code, its name and share would seem to stand still.

    A function within another counts too, numba's own do not.
    """
    ours, theirs = pty.openpty()
    program = (
        "import time\n"
        "from threadline.base.progress import COMPILING\n"
        "from threadline.cli.on_terminal import bar_on_terminal\n"
        "with bar_on_terminal() as update:\n"
        "    update('planning', 0.0)\n"
        "    COMPILING.begin('threadline.motion.path.runs')\n"
        "    time.sleep(1.4)\n"
        "    COMPILING.begin('numba.np.arrayobj')\n"
        "    COMPILING.begin('threadline.verdict.bow')\n"
        "    COMPILING.end(), COMPILING.end(), COMPILING.end()\n"
        "    time.sleep(0.3)\n"
        "    update('simulating', 0.25)\n"
        "    time.sleep(0.9)\n"
    )
    wide = {**os.environ, "COLUMNS": "140", "TERM": "xterm"}
    subprocess.run([sys.executable, "-c", program], stderr=theirs, env=wide, check=True)
    shown = os.read(ours, 65536).decode()
    os.close(ours)
    os.close(theirs)
    compiling, simulating = shown.split("simulating", 1)
    first, second = (
        f"compiling machine code for {part} (usually at most 90), 1 s"
        for part in ("planning: 1 function", "judging: 2 functions")
    )
    assert first in compiling and second in compiling.split(first)[-1]
    assert "%" not in compiling
    bars = [line.count("╸") + line.count("━") for line in re.split("[\r\n]", compiling)]
    assert max(bars) == 20
    assert "25%" in simulating and "compiling" not in simulating
