"""LinuxCNC's HAL for tests: one at a time on a computer, and never as root."""

from __future__ import annotations

import contextlib
import functools
import gc
import os
import shutil
import socket
import subprocess
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import ParamSpec

import numpy as np
import pytest

from tests.live.memory_sink import MemorySink
from tests.one_hal import one_hal
from threadline.files import RunEnd
from threadline.live import hal_link as hal_process
from threadline.live import hal_session
from threadline.live.executor import Executor
from threadline.live.hal_session import (
    HAL_KEY,
    SAMPLER_KEY,
    HalFifo,
    HalSession,
    Samples,
    in_use,
    remove_left,
    words_to_end,
)
from threadline.live.states import Desk
from threadline.live.wire import Connection
from threadline.machine import Machine


def end_hal() -> None:
    """End a HAL that a test has left, with every process that it had killed."""
    if not in_use(HAL_KEY):  # less than a second each time
        remove_left()
        return
    subprocess.run(words_to_end(), cwd="/", capture_output=True, check=False)
    for _ in range(100):
        if not in_use(HAL_KEY):
            remove_left()
            return
        time.sleep(0.05)
    raise AssertionError("HAL is still there")


@contextlib.contextmanager
def hal_alone(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Reserve HAL for this test; LinuxCNC refuses root, so it runs as another user then."""
    if shutil.which("halcmd") is None:
        pytest.skip("no LinuxCNC here (linuxcnc-uspace)")
    if os.geteuid() == 0:
        monkeypatch.setenv("SUDO_UID", "65534")
    with one_hal():
        end_hal()
        yield
        end_hal()


SLEPT = (
    "refills came too late",
    "has stood still",
    "the machine was silent",
    "that tick is past",
    "this computer slept",
)
"""What is told of a run for which nobody had the processor for a tenth of a second."""
TRIES = 6
P = ParamSpec("P")


class SleptError(AssertionError):
    """This computer slept during a run."""


def refuse_slept(ended: tuple[RunEnd, str] | None) -> None:
    """Raise if a run ended because the process got no processor time.

    The whole reason is checked: for a failed comparison pytest shows only the first 240 letters.
    """
    if ended is not None and ended[0] is RunEnd.FAULT and any(one in ended[1] for one in SLEPT):
        raise SleptError(ended[1])


def awake(test: Callable[P, None]) -> Callable[P, None]:
    """Repeat a test in a new folder if this computer slept during it.

    HAL is right to brake then, and other tests cover that.
    """

    @functools.wraps(test)
    def again(*given: P.args, **named: P.kwargs) -> None:
        folder = named.get("tmp_path")
        for k in range(TRIES):
            if isinstance(folder, Path):
                named["tmp_path"] = folder / f"try-{k}"
                (folder / f"try-{k}").mkdir()
            try:
                test(*given, **named)
            except AssertionError as error:
                if k == TRIES - 1 or not any(text in str(error) for text in SLEPT):
                    raise
                slept = error
            else:
                return
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ResourceWarning)  # a failing test closes nothing
                del slept  # and closes everything that the test had open
                gc.collect()
            end_hal()

    return again


@contextlib.contextmanager
def unhurried(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Allow late ticks without a fault: HAL has no real time here, and other programs run."""
    monkeypatch.setattr("threadline.live.guards.LATE_IN_A_ROW", 1 << 30)
    monkeypatch.setattr("threadline.live.guards.LATE_PERIODS", 1e9)
    yield


class Recorded(HalSession):
    """Records the commands from HAL to its drives, to the very end."""

    box: Path

    def samples(self) -> Samples:
        found = super().samples()
        with self.box.open("ab") as box:
            box.write(np.column_stack([found.record, found.commanded]).astype(np.float64).tobytes())
        return found

    def _play_out(self) -> None:
        super()._play_out()
        self.samples()


def left_samples(machine: Machine) -> np.ndarray:
    """Return the records that the sampler still holds unread; as ``commanded_in``."""
    axes, tick_s = len(machine.axes), float(machine.tick_clock.period_s)
    depth = int(hal_session.SAMPLED_S / tick_s) + 100
    fifo = HalFifo(SAMPLER_KEY, depth, "ss" + "ff" * axes)
    words, numbers = fifo.take()
    fifo.close()
    return np.column_stack([words[:, 0], numbers[:, 2 : 2 + axes]]).astype(np.float64)


def commanded_in(box: Path, axes: int) -> np.ndarray:
    """Return (n, 1 + axes) record numbers and commanded counts, as the black box has them."""
    return np.frombuffer(box.read_bytes()).reshape(-1, 1 + axes)


@contextlib.contextmanager
def bridge(
    machine: Machine, start: np.ndarray, box: Path, *, plant: bool
) -> Iterator[SimpleNamespace]:
    """Start the process in front of HAL as a fork; return this end of the link and its number."""
    ours, theirs = socket.socketpair()
    pid = os.fork()
    if not pid:
        try:
            ours.close()
            Recorded.box = box
            hal_process.HalSession = Recorded  # type: ignore[misc]
            hal_process.serve_hal(theirs, machine, start, plant=plant)
            os._exit(0)
        except BaseException:
            os._exit(1)
    theirs.close()
    try:
        yield SimpleNamespace(end=ours, pid=pid)
    finally:
        ours.close()
        with contextlib.suppress(ChildProcessError):
            os.waitpid(pid, 0)


def execute(
    end: socket.socket,
    machine: Machine,
    table: object,
    at_tick: Callable[[Executor, Desk], None],
    *,
    may_stand_still: bool = False,
) -> tuple[Executor, MemorySink]:
    """Run a table to its end; a sleep of the computer is an error unless a test causes it."""
    sink, desk = MemorySink(), Desk()
    executor = Executor(Connection(end), machine, desk, sink, speed=1.0)
    executor.connect()
    executor.enable()
    executor.home()
    executor.start(table)  # type: ignore[arg-type]
    while not executor.over:
        executor.step()
        at_tick(executor, desk)
    executor.close()
    desk.close()
    if not may_stand_still:
        refuse_slept(executor.ended)
    return executor, sink
