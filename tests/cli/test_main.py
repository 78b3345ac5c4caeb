"""The output in a shell if a command does not end by itself."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from threadline.base.writing import staged_file
from threadline.cli import law, prove
from threadline.cli.main import app, main


def stopped(
    capsys: pytest.CaptureFixture[str], *arguments: str | Path
) -> tuple[int | str | None, str, str]:
    """Run the program in this process; returns exit status, output and errors."""
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return caught.value.code, captured.out, captured.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["prove", "x.prg", "-m", "lathe-winder", "--nosuch"], "--nosuch"),
        (["prove", "x.prg", "-m", "lathe-winder", "--repeats", "0"], "--repeats"),
        (["prove", "x.prg", "-m", "lathe-winder", "--repeats", "many"], "--repeats"),
        (["prove", "x.prg"], "--machine"),
        (["prove"], "'job'"),
        (["prove", "a.prg", "b.prg", "-m", "lathe-winder"], "b.prg"),
        (["proove"], "proove"),
    ],
)
def test_a_wrong_option_is_told_in_one_line(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = stopped(capsys, *arguments)

    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("error: [OPTION] ")
    assert words in err
    assert "--help" in err


@pytest.mark.parametrize("value", ["a" * 5000, "a b " * 1250])
def test_a_value_of_thousands_of_characters_is_cut_in_the_middle(
    value: str, examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The fault stays at the front, the remedy at the end; one line of 500 characters in all."""
    job = ["prove", examples / "x-180.prg", "-m", "lathe-winder"]
    code, out, err = stopped(capsys, *job, "--smoothing", value)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert len(err) < 500
    assert err.startswith(f"error: [OPTION] --smoothing '{value[:200]}")
    assert err.endswith("needs feed-forward. Give --feed-forward too.\n")
    assert " ... " in err


def test_no_argument_shows_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = stopped(capsys)
    assert (code, err) == (0, "")
    assert "prove" in out


def test_an_interrupt_is_one_line(
    examples: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(prove, "prove_job", interrupted)
    job = examples / "x-180.prg"
    report = tmp_path / "report"
    code, out, err = stopped(capsys, "prove", job, "-m", "lathe-winder", "--report", report)

    assert (code, out, err.count("\n")) == (130, "", 1)
    assert "interrupted" in err
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_that_machine_code_returned_with_is_one(
    examples: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python turns it into a SystemError: "returned a result with an exception set"."""

    def interrupted(*_: object) -> None:
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr(prove, "prove_job", interrupted)
    code, out, err = stopped(capsys, "prove", examples / "x-180.prg", "-m", "lathe-winder")
    assert (code, out) == (130, "")
    assert err == "error: interrupted; nothing was left half-written\n"


@pytest.mark.parametrize(
    ("number", "message"), [(signal.SIGTERM, "terminated"), (signal.SIGHUP, "hung up")]
)
def test_a_termination_is_one_line_and_leaves_nothing(
    number: signal.Signals,
    message: str,
    examples: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """SIGTERM from a time limit or a closed terminal, while the recording is being written."""

    def terminated(_recording: object, path: Path, **_: object) -> None:
        with staged_file(path) as file:
            file.write(b"half")
            os.kill(os.getpid(), number)

    proof = SimpleNamespace(recording=None, plan=None)
    monkeypatch.setattr(prove, "prove_job", lambda *_: proof)
    monkeypatch.setattr(prove, "Share", lambda *_: SimpleNamespace(of=list))
    monkeypatch.setattr(prove, "write_recording", terminated)

    def unanswered(*_: object) -> None:  # or all tests would end
        raise AssertionError(f"nothing answers {number}")

    outside = signal.signal(number, unanswered)
    words = "prove", examples / "x-180.prg", "-m", "lathe-winder", "--recording"
    try:
        code, out, err = stopped(capsys, *words, tmp_path / "made" / "run.npz")
    finally:
        answering = signal.signal(number, outside)

    assert (code, out) == (128 + number, "")
    assert err == f"error: {message}; nothing was left half-written\n"
    assert list(tmp_path.iterdir()) == []
    assert answering is unanswered


def test_a_second_interrupt_does_not_end_the_removing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C is pressed again while the half-written file is removed."""
    unlink = Path.unlink

    def impatient(path: Path, missing_ok: bool = False) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        unlink(path, missing_ok=missing_ok)

    def interrupted(_law: object, path: Path) -> None:
        with staged_file(path):
            monkeypatch.setattr(Path, "unlink", impatient)
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(law, "write_law", interrupted)
    # A background job ignores SIGINT, and so do the processes that it starts.
    outside = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        code, out, err = stopped(capsys, "law", "cubic", "--out", tmp_path / "law.csv")
    finally:
        signal.signal(signal.SIGINT, outside)
    assert (code, out) == (130, "")
    assert err == "error: interrupted; nothing was left half-written\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_closed_pipe_is_no_error(unbuffered: str) -> None:
    """Without a buffer the write fails in the command; otherwise only the last flush does."""
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "threadline.cli.start", "--help"],
        stdout=writing,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        check=False,
        timeout=120,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, b"")


@pytest.mark.parametrize(
    "command",
    [
        ["compile", "JOB", "-m", "MACHINE", "--target", "nc", "-o", "JOB"],
        ["compile", "JOB", "-m", "MACHINE", "--target", "csv", "-o", "LINK"],
        ["compile", "JOB", "-m", "MACHINE", "--target", "csv", "-o", "MACHINE"],
        ["prove", "JOB", "-m", "MACHINE", "-s", "SPEC", "--recording", "SPEC"],
    ],
)
def test_an_input_is_never_written_over(
    command: list[str], examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {
        "JOB": (tmp_path / "mine.prg", (examples / "x-180.prg").read_text()),
        "MACHINE": (tmp_path / "mine.toml", 'base = "lathe-winder"\n'),
        "SPEC": (tmp_path / "mine.csv", 'name = "x"\n[[criteria]]\nname = "contour_error"\n'),
    }
    for path, text in files.values():
        path.write_text(text)
    link = tmp_path / "link.csv"
    link.symlink_to(files["JOB"][0])
    names = {key: path for key, (path, _) in files.items()} | {"LINK": link}
    code, out, err = stopped(capsys, *(names.get(word, word) for word in command))

    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "would be overwritten" in err
    assert [path.read_text() for path, _ in files.values()] == [t for _, t in files.values()]
    assert link.is_symlink()


def test_errors_are_text_on_stderr_with_json_too(capsys: pytest.CaptureFixture[str]) -> None:
    """As in --help: one line with the code, and not a byte on standard output."""
    for words in (["prove", "none.prg", "-m", "lathe-winder"], ["analyse", "no-such-machine"]):
        with pytest.raises(SystemExit) as stopped:
            main([*words, "--json"])
        output = capsys.readouterr()
        assert (stopped.value.code, output.out, output.err.count("\n")) == (2, "", 1)
        assert re.match(r"error: \[[A-Z-]+\] ", output.err)
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "with --json too" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("words", "offers"),
    [
        ("threadline ver", "verify"),
        ("threadline prove --interp", "--interpolation"),
        ("threadline prove x -m la", "lathe-winder"),
        ("threadline prove x --machine lathe-winder+phy", "lathe-winder+physical"),
        ("threadline prove x -m no-such+", ""),
        ("threadline prove x --actual step", "stepper-winder"),
        ("threadline analyse la", "lathe-winder"),
        ("threadline judge x -m la", "lathe-winder"),
        ("threadline prove x --interpolation b-spline-", "b-spline-pulled"),
        ("threadline compare x --interpolation linear,qu", "linear,quintic"),
        ("threadline prove x --law modified-s", "modified-sine"),
        ("threadline prove x --dialect reprap", "reprapfirmware reprapfirmware-cnc"),
        ("threadline prove x --dialect grbl,k", ""),
        ("threadline prove x --feed-mode rs", "rs274"),
        ("threadline prove x --long-stitches sp", "split"),
        ("threadline compile x --target open", "openplc"),
        ("threadline equal x --targets csv,t1", "csv,t15"),
        ("threadline tune x --controller pi", "pi pid"),
    ],
)
def test_the_tab_key_completes_commands_options_and_values(words: str, offers: str) -> None:
    asked = {
        "_THREADLINE_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(words.count(" ")),
    }
    output = CliRunner().invoke(app, [], prog_name="threadline", env=asked)
    assert output.stdout.split() == offers.split()


def test_a_shell_without_completion_is_wrong_input(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Otherwise the exit status would be 1, which means out of spec."""
    monkeypatch.setattr("shellingham.detect_shell", lambda: ("tcsh", "/bin/tcsh"))
    with pytest.raises(SystemExit) as ended:
        main(["--install-completion"])
    assert ended.value.code == 2
    assert "[OPTION] there is no tab completion for this shell. Call it from bash, zsh," in (
        capsys.readouterr().err
    )
