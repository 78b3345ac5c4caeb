"""``kill -9`` of an executor and of its machine, for every kind of work with rows or turns.

Processes are forks of this one, so that nothing has to be imported anew. A black box records the
motion of the machine to the very end.
"""

from __future__ import annotations

import os
import pickle
import signal
import socket
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tests.live.bench import table_of_counts, there_and_back, winder
from tests.live.memory_sink import MemorySink
from threadline.files import Commands
from threadline.live import sim_process
from threadline.live.executor import Executor
from threadline.live.kinds_run import run_kind_of
from threadline.live.sim_machine import SimMachine
from threadline.live.sim_process import simulated_of
from threadline.live.states import Desk, Hold
from threadline.live.wire import Connection, Message
from threadline.machine import Machine, load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job

EXAMPLES = Path(__file__).parents[2] / "examples"
SEND_S = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """Commands of one kind of work, and the machine that they are for."""

    machine: Machine
    commands: Commands
    ticks: int
    hold: Hold = Hold.AT_ONCE

    @property
    def start(self) -> np.ndarray:
        return run_kind_of(self.machine).start(self.commands)


@cache
def case(name: str) -> Case:
    """Return a case by its name: loops, steppers, cylinders, step-tables."""
    if name == "loops":
        rows = there_and_back(peak=10.0, cruise=600)  # 36 mm/s on X
        return Case(winder(), table_of_counts(rows), len(rows))
    machine_name, job = {
        "steppers": ("stepper-winder", "helix.gcode"),
        "cylinders": ("letter-placer", "letter-cycle.toml"),
        "step-tables": ("schiffli-frame", "rosette.dst"),
    }[name]
    machine = load_machine(machine_name)
    plan = plan_job(open_job(EXAMPLES / job, machine, Options()), machine, Options())
    ticks = int(plan.duration_s / float(machine.command_clock.period_s))
    hold = Hold.AT_REST if name == "cylinders" else Hold.AT_ONCE
    return Case(machine, plan.commands, ticks, hold=hold)


def child(work: Callable[[], object]) -> int:
    """Fork; run the function in the child, and end the child."""
    pid = os.fork()
    if pid:
        return pid
    try:
        work()
        os._exit(0)
    except BaseException:
        traceback.print_exc()
        os._exit(1)


def machine_with_black_box(end: socket.socket, which: Case, box: Path) -> None:
    """Serve as a simulated machine; write all channels, and the tick of the last message heard.

    The position belongs to the instant after the last sample, in units of the machine's commands.
    """
    reports: dict[str, list[np.ndarray]] = {}
    seen: dict[str, Any] = {"heard": 0}

    class Boxed(simulated_of(which.machine)):  # type: ignore[misc, name-defined]
        def take(self, message: Message) -> None:
            seen["heard"] = self.tick
            super().take(message)

        def _report(self, first: int, parts: Any, late_by: float) -> None:
            for part in parts:
                for name, values in part.samples.items():
                    reports.setdefault(name, []).append(np.array(values, dtype=np.float64))
            seen["standing"], seen["position"] = self.standing, self.position
            super()._report(first, parts, late_by)

    boxed: type[SimMachine] = Boxed
    sim_process.simulated_of = lambda _: boxed
    sim_process.serve(end, which.machine, which.start, 0.0)
    np.savez(
        box, heard=seen["heard"], standing=seen["standing"], position=seen["position"],
        **{f"c_{name}": np.concatenate(parts) for name, parts in reports.items()},
    )  # fmt: skip


@contextmanager
def forked_link(_program: str, request: tuple[Any, ...]) -> Iterator[Connection]:
    """Stand-in for ``process_link`` of a simulated machine, which gets the same bytes."""
    ours, theirs = socket.socketpair()
    words = pickle.dumps(request)

    def machine_only() -> None:
        ours.close()
        sim_process.serve(theirs, *pickle.loads(words))  # messages of this process

    machine = child(machine_only)
    theirs.close()
    ours.settimeout(SEND_S)
    connection = Connection(ours)
    try:
        yield connection
    finally:
        connection.close()
        assert os.waitpid(machine, 0)[1] == 0


def execute(
    end: socket.socket, which: Case, at_tick: Callable[[int], object]
) -> tuple[Executor, MemorySink]:
    """Run a case to its end, or to the end of the link."""
    sink, desk = MemorySink(), Desk()
    executor = Executor(Connection(end), which.machine, desk, sink, speed=0.0)
    executor.connect()
    executor.enable()
    executor.home()
    executor.start(which.commands, pass_stops=True, hold=which.hold)
    while not executor.over:
        executor.step()
        at_tick(executor.tick)
    desk.close()
    return executor, sink


def kill_executor(which: Case, tick: int, box: Path) -> dict[str, np.ndarray]:
    """Kill the executor at a tick; return the machine's black box once it has ended by itself."""
    ours, theirs = socket.socketpair()
    there, here = os.pipe()

    def machine_only() -> None:
        ours.close()
        machine_with_black_box(theirs, which, box)

    def executor_only() -> None:
        theirs.close()
        execute(ours, which, lambda now: os.write(here, b"!") if now >= tick else None)

    machine, executor = child(machine_only), child(executor_only)
    ours.close()
    theirs.close()
    os.close(here)  # killed by this test: if the run ends before, nothing is read
    assert os.read(there, 1) == b"!"
    os.kill(executor, signal.SIGKILL)
    os.waitpid(executor, 0)
    os.close(there)
    assert os.waitpid(machine, 0)[1] == 0  # it has come to rest, and ended by itself
    with np.load(box) as counts:
        return {name.removeprefix("c_"): np.array(counts[name]) for name in counts.files}


def kill_machine(which: Case, tick: int) -> tuple[Executor, MemorySink]:
    """Kill the machine's process at a tick; return the executor and its recording."""
    ours, theirs = socket.socketpair()

    def machine_only() -> None:
        ours.close()
        sim_process.serve(theirs, which.machine, which.start, 0.0)

    machine = child(machine_only)
    theirs.close()
    found = execute(
        ours, which, lambda now: os.kill(machine, signal.SIGKILL) if now >= tick else None
    )
    os.waitpid(machine, 0)
    ours.close()
    return found


def beside(points: np.ndarray, path: np.ndarray) -> float:
    """Return the largest distance of (n, axes) points from the segments of a path, (m, axes)."""
    begin, way = path[:-1], np.diff(path, axis=0)
    long = np.maximum((way * way).sum(axis=1), 1e-30)
    worst = 0.0
    for point in points:
        share = np.clip(((point - begin) * way).sum(axis=1) / long, 0.0, 1.0)
        near = np.linalg.norm(begin + share[:, None] * way - point, axis=1).min()
        worst = max(worst, float(near))
    return worst
