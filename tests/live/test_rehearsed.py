"""A simulated machine loads everything for its first tick before it greets."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from threadline.machine import load_machine

EXAMPLES = Path(__file__).parents[2] / "examples"
JOBS = {
    "letter-placer": "letter-cycle.toml",
    "schiffli-frame": "rosette.dst",
    "stepper-winder": "x-180.prg",
}
# The machine has the main thread, because it handles signals; the executor has another.
PROGRAM = """
import gc, socket, sys, threading
from pathlib import Path
from numba.core.registry import CPUDispatcher
from threadline.live.states import Desk
from threadline.live.executor import Executor
from tests.live.memory_sink import MemorySink
from threadline.live.sim_process import serve
from threadline.live.kinds_run import run_kind_of
from threadline.live.wire import Connection
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job

def loaded():
    every = [one for one in gc.get_objects() if isinstance(one, CPUDispatcher)]
    names = [f"{one.py_func.__module__}.{one.py_func.__name__}" for one in every]
    parts = zip(names, every)
    return {(name, s) for name, one in parts if ".twin." in name for s in one.signatures}

def run(connection, machine, commands):
    desk = Desk()
    executor = Executor(connection, machine, desk, MemorySink(), speed=0.0)
    executor.connect()
    before = loaded()
    executor.enable()
    executor.home()
    executor.start(commands)
    while executor.tick < 100:
        executor.step()
    late = {name for name, _ in loaded() - before}
    print(machine.name, executor.tick >= 100, sorted(late), flush=True)
    connection.close()
    desk.close()

for told in sys.argv[1:]:
    name, job = told.split("=")
    machine = load_machine(name)
    commands = plan_job(open_job(Path(job), machine, Options()), machine, Options()).commands
    ours, theirs = socket.socketpair()
    executor = threading.Thread(target=run, args=(Connection(ours), machine, commands))
    executor.start()
    serve(theirs, machine, run_kind_of(machine).start(commands), 0.0)
    executor.join()
"""

# Like the process of a machine, which has imported nothing else.
SERVES = """
import pickle, socket, sys
from threadline.live.sim_process import serve
from threadline.live.wire import Connection

for told in pickle.load(sys.stdin.buffer):
    ours, theirs = socket.socketpair()
    ours.shutdown(socket.SHUT_WR)
    serve(theirs, *told)
    print(Connection(ours).receive().head["machine_sha256"], flush=True)
"""


def test_a_process_that_knows_nothing_else_serves_each_kind() -> None:
    """Each machine is sent to the process through a pipe, and greets."""
    machines = [load_machine(name) for name in ("lathe-winder", *JOBS, "stitcher")]
    requests = [(one, np.zeros(len(one.axes), np.int64), 0.0, None) for one in machines]
    done = subprocess.run(
        [sys.executable, "-c", SERVES],
        input=pickle.dumps(requests), capture_output=True, check=False, timeout=600,
    )  # fmt: skip
    assert done.stdout.decode().splitlines() == [one.sha256 for one in machines], done.stderr


@pytest.mark.long(shown_by="test_a_process_that_knows_nothing_else_serves_each_kind")
def test_nothing_is_loaded_once_time_counts() -> None:
    """Loading machine code takes a third of a second, and a tick takes at most 10 ms."""
    arguments = [f"{name}={EXAMPLES / job}" for name, job in JOBS.items()]
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments], cwd=EXAMPLES.parent,
        capture_output=True, check=False, timeout=600,
    )  # fmt: skip
    assert done.stdout.decode().splitlines() == [f"{name} True []" for name in JOBS], done.stderr
