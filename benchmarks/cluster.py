"""A yield on two local workers of one core each beside one run, and more workers by a simulation.

The one run has one thread. Both judge the same machines in turns, and come to the same bits.
Efficiency is the time of one run over twice the time of two workers (by the clock), and over the
processor time of scheduler, workers and this process together. The clock of a shared computer says
little: its load is noted.

A yield of this size ends in seconds: what is sent, and workers that wait for the last task, weigh
more than in a yield of 100 000 machines, of which ``docs/cluster.md`` has the figures.

The figures for 8 to 64 workers are simulated, not measured: a list of tasks is dealt to workers
that are free, with the measured time of a machine, of the first answer of a fresh worker (it loads
Threadline, its machine code and the plan), and of sending a task and its answer.
"""

from __future__ import annotations

import heapq
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from threadline.base.cluster import Cluster, items_at_once
from threadline.base.workers import working_on
from threadline.machine import load_machine
from threadline.machine.pneumatics import TIMES
from threadline.machine.variants import drawn, numbers_at
from threadline.proof.judge_runs import Variants
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.search.machine_yield import (
    _AT_ONCE_AWAY,
    _AT_ONCE_LATE,
    MachineYield,
)
from threadline.verdict import load_spec

EXAMPLES = Path(__file__).parents[1] / "examples"
CASES = (
    ("x-180", "x-180.prg", "lathe-winder", Options(interpolation="linear"), 32_768),
    ("the stitcher's test path", "stitcher-test-path.seam.toml", "stitcher", Options(), 8192),
    ("the placer's letter cycle", "letter-cycle.toml", "letter-placer", Options(), 512),
)
WORKERS = (8, 16, 32, 64)
SIMULATED = 100_000
_ROUNDS, _SENT = 2, 100
QUIET = {
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "500ms",
}
"""What ``docs/cluster.md`` sets: without it scheduler and workers take 7 % of a core themselves."""
_TICK = os.sysconf("SC_CLK_TCK")


class _Times(NamedTuple):
    clock_s: float
    processor_s: float


def run() -> Iterator[dict[str, Any]]:
    """Yield an entry for each case and number of workers."""
    with _fleet() as (address, processes):
        for name, job, machine_name, options, machines in CASES:
            machine = load_machine(machine_name)
            plan = plan_job(open_job(EXAMPLES / job, machine, options), machine, options)
            judged = MachineYield(plan, load_spec(None, machine), threads=1)
            yield from _beside_one(name, judged, machines, address, processes)


def _beside_one(
    name: str, judged: MachineYield, machines: int, address: str, processes: list[int]
) -> Iterator[dict[str, Any]]:
    begun = time.monotonic()
    cluster = Cluster(address)
    try:
        with working_on(cluster):
            judged.drawn(8, 2)  # both workers are ready
        first_s = time.monotonic() - begun
        alone, shared, bits = [], [], set()

        def bits_of() -> bytes:
            found = judged.drawn(machines, 1).found
            return b"".join(row.values.tobytes() for row in found.rows)

        judged.drawn(machines // 8, 2)  # memory is there, and what an item takes is known
        with working_on(cluster):
            judged.drawn(machines // 8, 2)
        for _ in range(_ROUNDS):
            alone.append(_timed(lambda: bits.add(bits_of()), processes))
            with working_on(cluster):
                shared.append(_timed(lambda: bits.add(bits_of()), processes))
        sent_s = _sent_s(cluster, judged)
    finally:
        cluster.close()
    if len(bits) != 1:
        raise AssertionError(f"{name}: two workers come to other bits than one run")
    clock = min(t.clock_s for t in alone) / (2.0 * min(t.clock_s for t in shared))
    processor = min(t.processor_s for t in alone) / min(t.processor_s for t in shared)
    load = os.getloadavg()[0]
    for what, share, unit in (("clock", clock, "clock"), ("processor time", processor, "CPU")):
        yield {
            "name": f"two workers vs one run by {what}, {name}",
            "ours": share,
            "peer": "one run of one thread",
            "peer_value": 1.0,
            "ratio": share,
            "unit": f"efficiency ({unit})",
            "note": f"{machines} machines in turns, the same bits; best of {_ROUNDS}, load "
            f"{load:.1f} on {os.cpu_count()} cores",
        }
    each_s = min(t.processor_s for t in alone) / machines
    machine = judged.plan.machine
    late = [
        k for k, one in enumerate(judged.numbers) if all(n.endswith(TIMES) for n in one.numbers)
    ]
    size = _AT_ONCE_AWAY if judged.together else 1
    if judged.together and late:  # an item for each choice of dead times
        size = _AT_ONCE_LATE // len(np.unique(drawn(machine, 1, np.arange(2000))[:, late], axis=0))
    for workers in WORKERS:
        whole_s = simulated_s(workers, SIMULATED // size, each_s * size, first_s, sent_s)
        share = SIMULATED * each_s / (workers * whole_s)
        yield {
            "name": f"{workers} workers, SIMULATED, {name}",
            "ours": share,
            "peer": "one core",
            "peer_value": 1.0,
            "ratio": share,
            "unit": "efficiency",
            "note": f"a simulation from measured times, no measurement: {SIMULATED} machines, "
            f"{1e3 * each_s:.3g} ms a machine, {first_s:.3g} s until a worker is ready, "
            f"{1e3 * sent_s:.2g} ms to send a task and fetch its answer: {whole_s:.3g} s",
        }


def simulated_s(workers: int, items: int, item_s: float, first_s: float, sent_s: float) -> float:
    """Return the time of a yield on ``workers``, by dealing tasks to those that are free, s.

    A task has as many items of ``item_s`` each as ``Cluster`` gives it. The command sends tasks and
    takes answers one after the other, ``sent_s`` each; every worker begins after ``first_s``.

    >>> simulated_s(2, 4, 1.0, 0.5, 0.0)
    2.5
    """
    free = [first_s] * workers
    heapq.heapify(free)
    command_s, last_s = 0.0, 0.0
    while items:
        count = min(items_at_once(item_s, items, workers), items)
        items -= count
        command_s += sent_s
        begun = max(heapq.heappop(free), command_s)
        ended = begun + item_s * count
        heapq.heappush(free, ended)
        last_s = max(last_s, ended)
    return last_s


class Nothing:
    """Work that takes no time: what is left is the way of a task and its answer."""

    def answer(self, item: Variants, _done: object = None) -> int:
        """Return the number of machines that came."""
        return item.count

    def machines(self, item: Variants) -> int:
        """Return the number of machines."""
        return item.count

    def known(self) -> bytes:
        """Return the bits that all computers come to."""
        return b""


def _sent_s(cluster: Cluster, judged: MachineYield) -> float:
    """Return the time by the clock for a task of one item that takes no time itself, s."""
    machine = judged.plan.machine
    items = [
        Variants(numbers=numbers_at(machine, drawn(machine, 1, 8 * turn + np.arange(8))))
        for turn in range(_SENT)
    ]
    sent = []
    begun = cluster._begun

    def counted(content: Any, digest: str, some: list[Any]) -> Any:
        sent.append(len(some))
        return begun(content, digest, some)

    work = Nothing()
    list(cluster.answers(work, items, None))
    with patch.object(cluster, "_begun", counted):
        begun_s = time.monotonic()
        list(cluster.answers(work, items, None))
        return (time.monotonic() - begun_s) / len(sent)


def _timed(work: Callable[[], object], processes: list[int]) -> _Times:
    """Return the time by the clock, and of the processor in this process and the fleet."""
    clock, processor = time.monotonic(), time.process_time() + _used_s(processes)
    work()
    return _Times(time.monotonic() - clock, time.process_time() + _used_s(processes) - processor)


def _used_s(processes: list[int]) -> float:
    """Return the processor time of processes so far, s."""
    found = 0.0
    for number in processes:
        fields = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()
        found += (int(fields[11]) + int(fields[12])) / _TICK
    return found


@contextmanager
def _fleet() -> Iterator[tuple[str, list[int]]]:
    """Start a scheduler and two workers of one thread; give its address and their processes."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"
        words = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
        begun = [_begun("scheduler", *words, "--scheduler-file", str(file), folder=folder)]
        try:
            own = ["--nthreads", "1", "--no-nanny", "--no-dashboard"]
            for _ in range(2):
                begun.append(_begun("worker", "--scheduler-file", str(file), *own, folder=folder))
            while not file.exists():
                time.sleep(0.1)
            yield json.loads(file.read_text())["address"], [one.pid for one in begun]
        finally:
            for one in reversed(begun):
                one.kill()
                one.wait()


def _begun(which: str, *words: str, folder: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.dask_{which}", *words],
        cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        env={
            **os.environ, **QUIET, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(EXAMPLES.parent)
        },
    )  # fmt: skip
