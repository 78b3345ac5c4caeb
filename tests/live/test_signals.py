"""Signals of a shell, to the program as it is run: a first one brakes, and the run is kept."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_on_the_path_and_keeps_the_run(
    number: signal.Signals, tmp_path: Path
) -> None:
    script = tmp_path / "starts.py"
    script.write_text(STARTS, "utf-8")
    done = subprocess.run(
        [sys.executable, script, str(int(number)), "run", EXAMPLES / "x-180.prg", "-m",
         "lathe-winder", "--interpolation", "linear", "--nominal", "--speed", "0", "--json",
         "--store", tmp_path / "runs"],
        capture_output=True, text=True, check=False, env=dict(os.environ), timeout=300,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    content = json.loads(done.stdout)
    assert (content["ended"], content["passed"]) == ("stopped", False)
    assert "stopped by the operator" in content["incomplete"]
    states = [
        json.loads(line)["state"]
        for line in (Path(content["trace"]).parent / "events.jsonl").read_text("utf-8").splitlines()
    ]
    assert states[-2:] == ["stopping", "idle"]
