"""kill -9 at random moments, for kinds of work other than loops: ten each, at either end.

``tests/live/test_killed.py`` has the winder's loops, ``test_hal.py`` LinuxCNC's HAL.
"""

from __future__ import annotations

import os
import random
import signal
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.live.grbl_model import BLOCKS, GrblModel
from tests.live.kill_bench import beside, case, child, kill_executor, kill_machine
from tests.live.memory_sink import MemorySink
from tests.live.test_grbl import MACHINE, START, program, settings
from threadline.files import RunEnd, played, tick_table
from threadline.live import grbl_run
from threadline.live.grbl_controller import Controller
from threadline.live.grbl_run import GrblRun
from threadline.live.grbl_words import runs_out
from threadline.live.port import Port
from threadline.live.sim_process import group_ticks, simulated_of
from threadline.live.states import Desk, State
from threadline.twin.stitching import simulate_stitching

DEPTH_S = 0.1
LONGEST = 2500  # ticks
RESTS_MS = 50  # between two turns the frame rests for longer, and within a turn never as long


def some_ticks(name: str) -> list[int]:
    """Return ten moments of a run, with a fixed seed; of a long run, near its begin."""
    return random.Random(name).sample(range(5, min(case(name).ticks, LONGEST)), 10)


@pytest.fixture(scope="module", autouse=True)
def warm() -> None:
    """Compile the twins here, so that every fork has them."""
    for name in ("steppers", "cylinders", "step-tables"):
        which = case(name)
        simulated_of(which.machine)(which.machine, which.start, lambda _: None).play(10)


def left_alone(name: str, heard: int) -> int:
    """Return the tick after which nothing may be sent any more: depth, and a report."""
    machine = case(name).machine
    tick_s = float(machine.command_clock.period_s)
    return heard + round(DEPTH_S / tick_s) + group_ticks(machine, 0.0)


@pytest.mark.long(but=("0", "1", "2"))
@pytest.mark.parametrize("k", range(10))
def test_steppers_brake_along_their_path(k: int, tmp_path: Path) -> None:
    """Within the rows of the link and 0.1 s of braking; on the path within a count of each axis."""
    which = case("steppers")
    box = kill_executor(which, some_ticks("steppers")[k], tmp_path / "box.npz")
    assert box["standing"]
    table = tick_table(which.commands)
    (block,) = table
    scale = which.machine.counts_per_unit
    rows = np.vstack([np.zeros((1, 2)), np.cumsum(block.counts, axis=0)]) + table.start_counts
    commanded = np.stack([box[f"{name}.commanded"] for name in which.machine.axes], axis=1) * scale
    moved = np.flatnonzero(np.diff(commanded, axis=0).any(axis=1))
    heard = int(box["heard"])
    assert not len(moved) or moved[-1] <= left_alone("steppers", heard) + 100
    # Rounding: one count on each of two axes, of the point and of the row.
    assert (
        beside(np.unique(commanded[heard:], axis=0), rows[max(heard - 200, 0) : heard + 500]) <= 2.0
    )


@pytest.mark.long(but=("0", "1", "2"))
@pytest.mark.parametrize("k", range(10))
def test_valves_are_off(k: int, tmp_path: Path) -> None:
    """Every output is off 100 ms and a report after the last message, and to the end."""
    which = case("cylinders")
    box = kill_executor(which, some_ticks("cylinders")[k], tmp_path / "box.npz")
    assert box["standing"]
    on = np.stack([box[name] for name in which.machine.outputs], axis=1).any(axis=1)
    per_scan = 10  # samples of 1 ms
    assert len(on) > per_scan * int(box["heard"])
    assert not on[per_scan * (left_alone("cylinders", int(box["heard"])) + 1) :].any()


@pytest.mark.long(but=("0", "1", "2"))
@pytest.mark.parametrize("k", range(10))
def test_the_frame_rests_between_two_turns(k: int, tmp_path: Path) -> None:
    """The frame stops at the end of a turn, at the latest a window after 100 ms."""
    which = case("step-tables")
    box = kill_executor(which, some_ticks("step-tables")[k], tmp_path / "box.npz")
    assert box["standing"]
    commanded = np.stack([box[f"{name}.commanded"] for name in which.machine.axes], axis=1)
    whole, rests = kept_whole(), rests_of_whole()
    # Its place after the last sample: the last step of a turn may come at that instant.
    stands = box["position"] / played(which.commands).steps_per_unit + commanded[0]
    assert tuple(np.round(stands, 9)) in rests
    moved = np.flatnonzero(np.diff(commanded, axis=0).any(axis=1))
    slowest_window = 2000  # ms: a third of the slowest turn
    assert (
        not len(moved) or moved[-1] <= left_alone("step-tables", int(box["heard"])) + slowest_window
    )
    # No stitch is torn: the commands equal the whole design's commands up to there.
    assert np.array_equal(commanded[: len(moved) and moved[-1]], whole[: len(moved) and moved[-1]])


@cache
def kept_whole() -> np.ndarray:
    """Return (n, axes) commanded positions of the whole design."""
    which = case("step-tables")
    recording = simulate_stitching(played(which.commands), which.machine)
    return np.stack([recording.samples(f"{name}.commanded")[1] for name in "XY"], axis=1)


@cache
def rests_of_whole() -> set[tuple[float, ...]]:
    """Return the positions at which the frame rests for ``RESTS_MS`` or longer."""
    whole = kept_whole()
    still = ~np.diff(whole, axis=0).any(axis=1)
    rested = np.convolve(still, np.ones(RESTS_MS), "valid") == RESTS_MS
    places = np.unique(np.round(whole[np.flatnonzero(rested)], 9), axis=0)
    return set(map(tuple, places.tolist()))


@pytest.mark.parametrize("k", range(10))
@pytest.mark.parametrize("name", ["steppers", "cylinders", "step-tables"])
def test_kill_the_machines_process(name: str, k: int) -> None:
    """The executor reports it at once, in the state of a fault, with all reports until then."""
    tick = some_ticks(name)[k]
    executor, sink = kill_machine(case(name), tick)
    assert executor.ended == (RunEnd.FAULT, "the link is gone")
    assert executor.state is State.FAULT
    assert executor.tick >= tick
    assert sum(len(next(iter(block.samples.values()))) for block in sink.blocks) >= tick
    assert sink.blocks[-1].events[-1].kind == "fault"


@pytest.mark.parametrize("k", range(10))
def test_kill_the_program_that_feeds_grbl(k: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """grbl executes its buffer, as long as was stated, and stands at the end of a line."""
    monkeypatch.setattr(grbl_run, "SILENCE_S", 10.0)  # margin for a busy computer
    line = random.Random(k).randrange(1, 40)
    model = GrblModel(settings(), faster=10.0)
    there, here = os.pipe()
    what = program()
    address = model.address  # it listens already

    def feed() -> None:
        run = GrblRun(Controller(Port(address), MACHINE), Desk(), MemorySink())
        run.controller.meet()
        run.enable()
        run.home()
        run.start(what, START)
        while not run.over:
            run.step()
            if run.acknowledged >= line:
                os.write(here, b"!")

    pid = child(feed)  # before there is a thread
    model.start()
    os.close(here)  # killed by this test: if the run ends before, nothing is read
    assert os.read(there, 1) == b"!"
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    os.close(there)
    until = time.monotonic() + 100.0
    while (model.client is not None or model.state == "Run") and time.monotonic() < until:
        time.sleep(0.02)
    assert model.state == "Idle"
    assert not model.overflowed
    model.close()
    lines = model.at[0] / 5.0
    assert lines == round(lines)
    assert model.at[3] == 2.0 * model.at[0]
    goes_s, _ = runs_out(what, BLOCKS)
    assert model.moves_since_lost <= goes_s / model.faster + 1.0  # its thread was late
