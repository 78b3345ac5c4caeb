"""Soak: a day of simulated running at 100 times real time, and hundreds of kills.

``python -m tools.soak [--hours 24] [--kills 200] [--speed 100] [--inside]``; it writes a line as it
goes and ends with status 1 where memory grows, a run is not whole, or the store is not intact.
Executor and machine run in processes of their own, and every run goes into a store.
``docs/safety.md`` has figures and date.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.live.bench import GROUP, Wire
from tests.live.kill_bench import child

from threadline.commands.plan import Plan
from threadline.files import RunEnd
from threadline.files.formats import read_recording
from threadline.live import sim_process
from threadline.live.executor import Executor
from threadline.live.kinds_run import run_kind_of
from threadline.live.sim_process import sim_link, simulated_of
from threadline.live.states import Desk, Hold
from threadline.live.store.run_store import INDEX, RunStore
from threadline.live.supervised import Conduct, Running, run_commands
from threadline.live.wire import Connection, Message
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, prove_plan
from threadline.proof.proof_file import ProofFile, read_proof, write_proof
from threadline.verdict import load_spec

ROUND_S = 10.3  # of x-180 there and back, as it is planned here, about
MOST_MIB = 10.0
"""Memory may grow by this from the first tenth of the run to its end."""
LOST_S = 1.0
"""A program that is killed may lose this much of its recording."""
_EACH_S = 60.0  # of machine time, from one look at the memory to the next


def winding(folder: Path, rounds: int) -> Path:
    """Write a program that goes 180 mm there and back again and again."""
    steps = [f"X {sign}25.71;" for sign in ("", "-") for _ in range(7)]
    lines = ["%", "O 999;", *steps, "M99;", "O 998;", "G01 F 2160;", "G91;"]
    file = folder / f"soak-{rounds}.prg"
    calls = [f"M98 P 999 L {min(90, rounds - done)};" for done in range(0, rounds, 90)]
    file.write_text("\n".join([*lines, *calls, "M30;", "%", ""]), "ascii")
    return file


def proven(job: Path, machine: str, folder: Path) -> tuple[Plan, ProofFile]:
    """Plan and prove a job, nominally."""
    chosen = load_machine(machine)
    plan = plan_job(open_job(job, chosen, Options()), chosen, Options())
    write_proof(prove_plan(plan, load_spec(None, chosen)), folder / f"{job.stem}.proof.json")
    return plan, read_proof(folder / f"{job.stem}.proof.json")


def resident_mib(pid: int) -> float:
    """Return the memory that a process has of its own, MiB; 0 where it is gone."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def processor_s() -> float:
    """Return the time that processors spent on this process and the children that have ended, s."""
    used = [resource.getrusage(of) for of in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def children() -> list[int]:
    """Return the processes that this one has started and that still run."""
    task = Path(f"/proc/self/task/{os.getpid()}/children")
    return [int(pid) for pid in task.read_text("ascii").split()]


class Memory:
    """The memory of executor and machine over the machine's time."""

    def __init__(self) -> None:
        self.seen: list[tuple[float, float, float]] = []
        self._due_s = 0.0

    def look(self, executor: Running) -> None:
        """Look at it where that is due."""
        time_s = executor.time_s
        if time_s >= self._due_s:
            self._due_s = time_s + _EACH_S
            machine = sum(resident_mib(pid) for pid in children())
            self.seen.append((time_s, resident_mib(os.getpid()), machine))

    def grown_mib(self) -> tuple[float, float]:
        """Return how much either grew from the end of the first tenth to the most behind it."""
        warm = self.seen[len(self.seen) // 10 :]
        first = warm[0]
        return (
            max(one[1] for one in warm) - first[1],
            max(one[2] for one in warm) - first[2],
        )


class Inside(Wire):
    """A machine in this process, as ``Wire`` has it, without a list of all that was sent."""

    def send(self, message: Message) -> None:
        self.sent.clear()
        self.group = max(GROUP, int(message.head.get("ticks", GROUP)))
        super().send(message)


@contextmanager
def link_to(plan: Plan, speed: float, *, inside: bool) -> Iterator[Any]:
    """Yield the link to a machine in this process, or in one of its own."""
    starts = run_kind_of(plan.machine).start(plan.commands)
    if inside:
        yield Inside(plan.machine, starts)
        return
    with sim_link(plan.machine, starts, speed) as link:
        yield link


def run_a_day(hours: float, speed: float, folder: Path, *, inside: bool) -> Iterator[str]:
    """Run for hours of the machine's time, an hour at a time; yield what is wrong."""
    store = RunStore(folder / "day")
    parts = max(1, round(hours))
    plan, known = proven(
        winding(folder, round(3600 * hours / parts / ROUND_S)), "lathe-winder", folder
    )
    whole_s, began, used_s = 0.0, time.monotonic(), 0.0
    ours: list[float] = []
    for part in range(parts):
        memory, desk = Memory(), Desk()
        kept, before_s = store.begin(plan, known, {"link": "sim"}, speed), processor_s()
        with kept:
            ended, text, late = run_commands(
                plan.commands, plan.machine, link_to(plan, speed, inside=inside), desk, kept,
                Conduct(watch=memory.look), speed=0.0 if inside else speed,
            )  # fmt: skip
        desk.close()
        used_s += processor_s() - before_s
        store.index.end(kept.path.name, ended=ended.value, text=text, late_ticks=late, passed=None)
        if ended is not RunEnd.COMPLETED:
            yield f"run {part} ended in {ended.value}: {text}"
        samples = _whole(kept.trace)
        expected = plan.duration_s / float(plan.machine.tick_clock.period_s)
        if samples < expected:
            yield f"run {part}: {samples} samples in its trace, {expected:.0f} were due"
        kept.trace.unlink()  # 70 MB an hour
        executor, machine = memory.grown_mib()
        ours.append(memory.seen[-1][1])
        whole_s += plan.duration_s
        took_s = time.monotonic() - began
        print(
            f"{whole_s / 3600:.2f} h of machine in {took_s:.0f} s ({whole_s / took_s:.0f} times "
            f"real time), {used_s:.0f} s of processor ({whole_s / used_s:.0f} times); grown "
            f"within the run: executor {executor:.1f} MiB, machine {machine:.1f} MiB; executor "
            f"{ours[-1]:.0f} MiB",
            flush=True,
        )
        if max(executor, machine) > MOST_MIB:
            yield f"run {part}: memory grew by {max(executor, machine):.1f} MiB"
    if ours[-1] - ours[min(1, len(ours) - 1)] > MOST_MIB:
        yield f"memory of the executor grew from run to run: {ours}"
    if len(store.index.runs()) != parts:
        yield f"the index has {len(store.index.runs())} runs of {parts}"


def _whole(trace: Path) -> int:
    """Return the samples of a trace, read to its end."""
    recording = read_recording(trace)
    name = recording.channels[0].name
    return sum(len(block.samples[name]) for block in recording.blocks)


@contextmanager
def machine_of(plan: Plan) -> Iterator[tuple[socket.socket, int]]:
    """Start a machine as a fork of this process."""
    ours, theirs = socket.socketpair()
    starts = run_kind_of(plan.machine).start(plan.commands)

    def serve() -> None:
        ours.close()
        sim_process.serve(theirs, plan.machine, starts, 0.0)

    pid = child(serve)
    theirs.close()
    try:
        yield ours, pid
    finally:
        ours.close()
        os.waitpid(pid, 0)


def run_until_killed(
    end: socket.socket, plan: Plan, known: ProofFile, folder: Path, at_tick: Callable[[int], None]
) -> None:
    """Run a plan into a store."""
    store, desk = RunStore(folder), Desk()
    with store.begin(plan, known, {"link": "sim"}, 0.0) as kept:
        executor = Executor(Connection(end), plan.machine, desk, kept, speed=0.0)
        executor.connect()
        executor.enable()
        executor.home()
        executor.start(plan.commands, pass_stops=True, hold=Hold.AT_REST)
        while not executor.over:
            executor.step()
            at_tick(executor.tick)


def kill(count: int, folder: Path) -> Iterator[str]:
    """Kill executors and machines of four kinds of work at random moments; yield what is wrong."""
    examples = Path(__file__).parents[1] / "examples"
    jobs = [
        proven(examples / job, machine, folder)
        for job, machine in (
            ("x-180.prg", "lathe-winder"), ("helix.gcode", "stepper-winder"),
            ("letter-cycle.toml", "letter-placer"), ("rosette.dst", "schiffli-frame"),
        )
    ]  # fmt: skip
    for plan, _ in jobs:  # every fork has the twin then
        run_kind = run_kind_of(plan.machine)
        made = simulated_of(plan.machine)
        made(plan.machine, run_kind.start(plan.commands), lambda _: None).play(10)
    chance, kept, wrong = random.Random(1994), folder / "kills", 0
    for number in range(count):
        plan, known = jobs[number % len(jobs)]
        whom = ("executor", "machine")[number // len(jobs) % 2]
        ticks = int(plan.duration_s / float(plan.machine.command_clock.period_s))
        for why in _one_kill(plan, known, kept, whom, chance.randrange(5, min(ticks, 3000))):
            wrong += 1
            yield f"kill {number} of the {whom} of {plan.machine.name}: {why}"
        if number % 20 == 19:
            print(f"{number + 1} kills, {wrong} wrong", flush=True)
    runs = len(RunStore(kept).index.runs())
    if runs != count:
        yield f"the index has {runs} runs of {count}"


def _one_kill(plan: Plan, known: ProofFile, folder: Path, whom: str, tick: int) -> Iterator[str]:
    there, here = os.pipe()
    with machine_of(plan) as (end, machine):

        def tell(now: int) -> None:
            if now >= tick:
                os.write(here, b"!")
                time.sleep(30.0 if whom == "executor" else 0.0)

        executor = child(lambda: run_until_killed(end, plan, known, folder, tell))
        os.close(here)  # ours: where the child fails, nothing is read
        if os.read(there, 1) != b"!":
            os.kill(machine, signal.SIGKILL)
            os.waitpid(executor, 0)
            os.close(there)
            yield "it did not get that far"
            return
        os.kill(executor if whom == "executor" else machine, signal.SIGKILL)
        end.close()
        _, status = os.waitpid(executor, 0)
    os.close(there)
    if whom == "machine" and status:
        yield f"the executor ended with status {status}"
    store = RunStore(folder)
    kept = store.find("last")
    recording = read_recording(kept / "trace.mcap")
    clock = recording.channels[0].clock
    last = max(block.first_tick[clock.name] + len(next(iter(block.samples.values())))
               for block in recording.blocks)  # fmt: skip
    commanded_s = tick * float(plan.machine.command_clock.period_s)
    if commanded_s - last * float(clock.period_s) > LOST_S:
        yield f"the trace ends at {last * float(clock.period_s):.2f} s, {commanded_s:.2f} s sent"
    (kept / "trace.mcap").unlink()


def main() -> None:
    """Soak."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--speed", type=float, default=100.0)
    parser.add_argument(
        "--inside", action="store_true",
        help="the machine in the executor's process, as fast as it can: where others are at work",
    )  # fmt: skip
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="soak-") as name:
        folder = Path(name)
        wrong = [
            *kill(options.kills, folder),
            *run_a_day(options.hours, options.speed, folder, inside=options.inside),
        ]
        print(f"index {(folder / 'day' / INDEX).stat().st_size} bytes")
    for line in wrong:
        print("WRONG:", line)
    print("soaked" if not wrong else f"{len(wrong)} wrong")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
