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
from threadline.live.states import Desk, Kept
from threadline.live.wire import Connection
from threadline.machine import Machine


def end_hal() -> None:
    """End a HAL that a test has left, with whatever it had killed."""
    if not in_use(HAL_KEY):  # seconds less, each time
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
    """Have HAL for this test alone; LinuxCNC refuses root, who is somebody else then."""
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
    """This computer slept in a run."""


def refuse_slept(ended: tuple[RunEnd, str] | None) -> None:
    """Raise where a run ended because nobody had the processor.

    The whole reason is looked at: of a comparison that fails, pytest tells the first 240 letters.
    """
    if ended is not None and ended[0] is RunEnd.FAULT and any(one in ended[1] for one in SLEPT):
        raise SleptError(ended[1])


def awake(test: Callable[P, None]) -> Callable[P, None]:
    """Begin a test again, in a folder of its own, where this computer slept in it.

    That HAL brakes then is right, and is tested by itself; what is tested here comes after it.
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
                warnings.simplefilter("ignore", ResourceWarning)  # a test that fails closes nothing
                del slept  # and with it what the test had open
                gc.collect()
            end_hal()

    return again


@contextlib.contextmanager
def unhurried(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let ticks come late without a fault: HAL has no real time here, and others are at work."""
    monkeypatch.setattr("threadline.live.guards.LATE_IN_A_ROW", 1 << 30)
    monkeypatch.setattr("threadline.live.guards.LATE_PERIODS", 1e9)
    yield


class Recorded(HalSession):
    """Writes down what HAL told its drives, to the very end."""

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
    """Return what the sampler still holds, where nobody reads it any more; as ``told_in``."""
    axes, tick_s = len(machine.axes), float(machine.tick_clock.period_s)
    depth = int(hal_session.SAMPLED_S / tick_s) + 100
    fifo = HalFifo(SAMPLER_KEY, depth, "ss" + "ff" * axes)
    words, numbers = fifo.take()
    fifo.close()
    return np.column_stack([words[:, 0], numbers[:, 2 : 2 + axes]]).astype(np.float64)


def told_in(box: Path, axes: int) -> np.ndarray:
    """Return (n, 1 + axes): number of the record, counts told, as the black box has them."""
    return np.frombuffer(box.read_bytes()).reshape(-1, 1 + axes)


@contextlib.contextmanager
def bridge(
    machine: Machine, start: np.ndarray, box: Path, *, plant: bool
) -> Iterator[SimpleNamespace]:
    """Start the process in front of HAL as a fork of this one; yield our end and its number."""
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
) -> tuple[Executor, Kept]:
    """Run a table to its end; a computer that slept is an error, unless a test makes it sleep."""
    kept, desk = Kept(), Desk()
    executor = Executor(Connection(end), machine, desk, kept, speed=1.0)
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
    return executor, kept
