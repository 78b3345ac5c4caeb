"""kill -9 of the executor and of the machine's process, at random moments of a run.

Processes are forks of this one, so that ten of each take seconds: nothing has to be imported anew.
"""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.live.bench import table_of_counts, there_and_back, winder
from tests.live.memory_sink import MemorySink
from threadline.files import RunEnd
from threadline.live import sim_process
from threadline.live.executor import Executor
from threadline.live.sim_kinds import SimRows
from threadline.live.states import Desk, State
from threadline.live.wire import Connection, Message

ROWS = there_and_back(peak=10.0, cruise=600)  # 36 mm/s on X for 3 s each way
TABLE = table_of_counts(ROWS)
SPEED = 20.0  # 7.2 s of machine in 0.36 s


def child(work: object) -> int:
    """Fork; run the function in the child, and end the child."""
    pid = os.fork()
    if pid:
        return pid
    try:
        work()  # type: ignore[operator]
        os._exit(0)
    except BaseException:
        os._exit(1)


class Watched(SimRows):
    """A machine with a black box: it records commands and the load's place to the very end."""

    box: dict[str, list[float]]

    def take(self, message: Message) -> None:
        self.box["heard"] = [float(len(self.box["x"]))]
        super().take(message)

    def play(self, ticks: int, late_by: float = 0.0) -> None:
        tell, seen = self._tell, list[Message]()
        self._tell = seen.append  # type: ignore[method-assign]
        try:
            super().play(ticks, late_by)
        finally:
            self._tell = tell  # type: ignore[method-assign]
        for message in seen:
            tell(message)
            for name, channel in (("a", "A.commanded"), ("x", "X.commanded"), ("load", "X.load")):
                self.box[name].extend(message.arrays[channel].tolist())
        self.box["held"] = [float(not self.standing)]
        self.box.setdefault("clock", []).append(time.monotonic())
        self.box.setdefault("played", []).append(float(len(self.box["x"])))


def machine_with_black_box(end: socket.socket, box: Path) -> None:
    Watched.box = {"a": [], "x": [], "load": [], "heard": [0.0], "held": [0.0]}
    sim_process.simulated_of = lambda _: Watched
    sim_process.serve(end, winder(), np.zeros(3, np.int64), SPEED)
    box.write_text(json.dumps(Watched.box), "utf-8")


def execute(end: socket.socket, at_tick: Callable[[int], None]) -> tuple[Executor, MemorySink]:
    sink, desk = MemorySink(), Desk()
    executor = Executor(Connection(end), winder(), desk, sink, speed=SPEED)
    executor.connect()
    executor.enable()
    executor.home()
    executor.start(TABLE)
    while not executor.over:
        executor.step()
        at_tick(executor.tick)
    desk.close()
    return executor, sink


@pytest.fixture(scope="module", autouse=True)
def warm() -> None:
    """Compile the twin here, so that every fork has it."""
    SimRows(winder(), np.zeros(3, np.int64), lambda _: None)


def some_ticks() -> list[int]:
    """Return ten moments of the run, with a fixed seed."""
    return random.Random(1994).sample(range(5, len(ROWS)), 10)


@pytest.mark.long(but=("989", "51", "326"))
@pytest.mark.parametrize("tick", some_ticks())
def test_kill_the_executor(tick: int, tmp_path: Path) -> None:
    """The machine brakes by the rows that it holds: at 36 mm/s within 5 mm of path, on it."""
    ours, theirs = socket.socketpair()
    there, here = os.pipe()
    box = tmp_path / "black-box"

    def machine_only() -> None:
        ours.close()
        machine_with_black_box(theirs, box)

    def executor_only() -> None:
        theirs.close()
        execute(ours, lambda now: os.write(here, b"!") if now >= tick else None)

    machine, executor = child(machine_only), child(executor_only)
    ours.close()
    theirs.close()
    os.close(here)  # killed by this test: if the run ends before, nothing is read
    assert os.read(there, 1) == b"!"
    os.kill(executor, signal.SIGKILL)
    os.waitpid(executor, 0)
    os.close(there)
    assert os.waitpid(machine, 0)[1] == 0  # it has come to rest, and ended by itself
    record = json.loads(box.read_text("utf-8"))
    assert record["held"] == [0.0]
    x, load, a = (np.array(record[name]) for name in ("x", "load", "a"))
    one_by_one = slice(int(record["heard"][0]), None)  # no message came since
    assert len(x) >= tick
    # 20 rows at 36 mm/s are 3.6 mm, and braking 0.1 mm; the load lags by 1.1 mm more.
    assert np.abs(np.diff(x[one_by_one])).sum() <= 3.75e-3
    assert np.abs(np.diff(load[one_by_one])).sum() <= 5e-3
    # On the path: A has turned a count for each of X, forth and back, within a count of each.
    counts = winder().counts_per_unit
    assert a[-1] * counts[0] == pytest.approx(np.abs(np.diff(x)).sum() * counts[1], abs=2.0)


@pytest.mark.long(but=("989", "51", "326"))
@pytest.mark.parametrize("tick", some_ticks())
def test_kill_the_machines_process(tick: int) -> None:
    """The executor reports it at once, in the state of a fault, with all reports until then."""
    ours, theirs = socket.socketpair()

    def machine_only() -> None:
        ours.close()
        sim_process.serve(theirs, winder(), np.zeros(3, np.int64), SPEED)

    machine = child(machine_only)
    theirs.close()
    executor, sink = execute(
        ours, lambda now: os.kill(machine, signal.SIGKILL) if now >= tick else None
    )
    os.waitpid(machine, 0)
    ours.close()
    assert executor.ended == (RunEnd.FAULT, "the link is gone")
    assert executor.state is State.FAULT
    recorded = np.concatenate([block.samples["X.measured"] for block in sink.blocks])
    assert len(recorded) == executor.tick >= tick
    assert sink.blocks[-1].events[-1].kind == "fault"
