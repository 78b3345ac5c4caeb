"""Signals of a shell to the real program: the first one brakes, and the run is kept."""

from __future__ import annotations

import json
import os
import pty
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from tests.live.kill_bench import child
from threadline.live.store.run_store import RunStore

EXAMPLES = Path(__file__).parents[2] / "examples"
STARTS = """
import os, signal, sys
# Whoever runs the tests in the background may have told it to ignore interrupts.
signal.signal(signal.SIGINT, signal.default_int_handler)
from threadline.cli.main import main
from threadline.live.executor import Executor
step = Executor.step
def stepped(self):
    step(self)
    if self.tick >= 400 and not told:
        told.append(self.tick)
        os.kill(os.getpid(), int(sys.argv[1]))
told = []
Executor.step = stepped
main(sys.argv[2:])  # a script without a guard: the machine's process does not run it anew
"""


def as_a_program(number: int, words: list[str], folder: Path) -> tuple[int, str]:
    """Run the command in an interpreter of its own; return its exit status and its output."""
    script = folder / "starts.py"
    script.write_text(STARTS, "utf-8")
    done = subprocess.run(
        [sys.executable, script, str(number), *words],
        capture_output=True, text=True, check=False, env=dict(os.environ), timeout=300,
    )  # fmt: skip
    return done.returncode, done.stdout


def as_a_fork(number: int, words: list[str], folder: Path) -> tuple[int, str]:
    """Run it in a fork of this process, which has imported everything; return the same."""
    out = folder / "out"

    def command_only() -> None:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # a shell may let the tests ignore them
        with out.open("w", encoding="utf-8") as written, redirect_stdout(written):
            sys.argv[1:] = [str(number), *words]
            try:
                exec(STARTS, {})  # the words of this file
            except SystemExit as ended:
                written.flush()
                os._exit(int(str(ended.code)))

    pid = child(command_only)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), out.read_text("utf-8")


@pytest.mark.long(only="2-as_a_program")
@pytest.mark.parametrize(
    ("number", "command"),
    [(signal.SIGINT, as_a_program), (signal.SIGTERM, as_a_fork), (signal.SIGHUP, as_a_fork)],
)
@pytest.mark.usefixtures("forked_machine")
def test_a_signal_stops_on_the_path_and_keeps_the_run(
    number: signal.Signals,
    command: Callable[[int, list[str], Path], tuple[int, str]],
    tmp_path: Path,
) -> None:
    words = ["run", str(EXAMPLES / "x-180.prg"), "-m", "lathe-winder", "--interpolation", "linear",
             "--nominal", "--speed", "0", "--json", "--store", str(tmp_path / "runs")]  # fmt: skip
    status, out = command(int(number), words, tmp_path)
    assert status == 1, out
    content = json.loads(out)
    assert (content["ended"], content["passed"]) == ("stopped", False)
    assert "stopped by the operator" in content["incomplete"]
    states = [
        json.loads(line)["state"]
        for line in (Path(content["trace"]).parent / "events.jsonl").read_text("utf-8").splitlines()
    ]
    assert states[-2:] == ["stopping", "idle"]


@pytest.mark.long(shown_by="test_a_signal_stops_on_the_path_and_keeps_the_run")
@pytest.mark.usefixtures("forked_machine")
def test_a_terminal_that_is_closed_stops_on_the_path_and_keeps_the_run(tmp_path: Path) -> None:
    """Neither its keys, nor its progress bar, nor the last printed line fails."""
    store = tmp_path / "runs"
    words = ["run", str(EXAMPLES / "x-180.prg"), "-m", "lathe-winder", "--nominal",
             "--speed", "2", "--store", str(store)]  # fmt: skip
    command = [sys.executable, "-m", "threadline", *words]
    pid, terminal = pty.fork()
    if pid == 0:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        os.execv(command[0], command)
    end_s = time.monotonic() + 200.0
    while not any('"running"' in file.read_text() for file in store.glob("*/events.jsonl")):
        assert time.monotonic() < end_s
        if select.select([terminal], [], [], 0.05)[0]:
            os.read(terminal, 4096)
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 1
    (record,) = RunStore(store).index.runs()
    assert (record.ended, record.text) == ("stopped", "stopped by the operator")
    assert record.passed is False
