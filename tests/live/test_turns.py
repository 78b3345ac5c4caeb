"""An embroidery frame runs as simulated; a turn always ends at rest."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.live.bench import Bench
from tests.live.proved_and_run import check_same_when_run
from tests.made import read_once
from threadline.commands.plan import Plan
from threadline.errors import LimitError
from threadline.files import Event, Recording, RunEnd, StepPlay, StitchBlock, Stream, played
from threadline.live.sim_machine import SimFault
from threadline.live.states import Cause, State
from threadline.machine import Machine, load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.twin.stitching import COLUMNS, simulate_stitching

EXAMPLES = Path(__file__).parents[2] / "examples"
TURNS = 9


@cache
def frame() -> Machine:
    return load_machine("schiffli-frame")


@cache
def planned() -> Plan:
    job = open_job(EXAMPLES / "rosette.dst", frame(), Options())
    return plan_job(job, frame(), Options())


@cache
def sewn() -> StepPlay:
    """Return the first turns of the design, as a program of its own, in two blocks."""
    commands = played(planned().commands)
    block = next(iter(commands))
    parts = []
    for first, end in ((0, 5), (5, TURNS)):
        columns = {name: getattr(block, name)[first:end] for name in COLUMNS}
        event = Event(tick=first + 1, kind="tool", operation=int(block.operation[0]), name="x")
        parts.append(StitchBlock(first_stitch=first, events=(event,), **columns))
    return replace(commands, blocks=Stream.of(parts), duration_ticks=int(block.begin[TURNS]))


@cache
def simulated() -> Recording:
    return read_once(simulate_stitching(sewn(), frame()))


def window() -> int:
    """Return the longest window of a move, in samples."""
    return max(int(block.window.max()) for block in sewn()) // 16000 + 1


def bench(fault: SimFault | None = None) -> Bench:
    made = Bench(other=frame(), same=True, start=np.zeros(2, np.int64), fault=fault).ready()
    made.wire.group = 25
    made.executor.start(sewn())
    return made


def commanded(made: Bench) -> np.ndarray:
    """Return (samples, 2) positions, m."""
    return np.stack([made.channel(f"{name}.commanded") for name in "XY"], axis=1)


def test_undisturbed_run_equals_the_simulation_to_the_bit() -> None:
    made = bench()
    made.go_on()
    assert made.executor.ended == (RunEnd.COMPLETED, "")
    for channel in simulated().channels:
        expected = simulated().samples(channel.name)[1]
        assert np.array_equal(made.channel(channel.name), expected), channel.name
    events = [event for block in made.sink.blocks for event in block.events]
    assert events == [event for block in simulated() for event in block.events]


@pytest.mark.parametrize("tick", [1, 700, 2600, 3111])
def test_a_stop_lets_the_turn_under_way_end_and_no_more(tick: int) -> None:
    made = bench()
    made.go_on(tick)
    at = made.executor.tick
    made.desk.ask(Cause.STOP)
    made.go_on()
    assert made.executor.ended == (RunEnd.STOPPED, "stopped by the operator")
    assert made.executor.state is State.IDLE
    places = commanded(made)
    moved = np.flatnonzero(np.diff(places, axis=0).any(axis=1))
    assert not len(moved) or moved[-1] <= at + window()
    # It stands on a point of the design, where the simulation rests, too.
    whole = np.stack([simulated().samples(f"{n}.commanded")[1] for n in "XY"], axis=1)
    assert (np.abs(whole - places[-1]).max(axis=1) < 1e-12).any()


@pytest.mark.parametrize("ticks", [[900], [1503, 400, 1, 900], [700, 700, 700]])
def test_hold_and_resume_sew_every_stitch_once(ticks: list[int]) -> None:
    made = bench()
    for tick in ticks:
        made.go_on(made.executor.tick + tick)
        made.desk.ask(Cause.HOLD)
        made.go_on(made.executor.tick + 1500)
        assert made.executor.state is State.HOLDING
        assert not np.diff(commanded(made)[-500:], axis=0).any()
        made.desk.ask(Cause.RESUME)
    made.go_on()
    assert made.executor.ended == (RunEnd.COMPLETED, "")
    # The same steps in the same order: each place between them comes once.
    whole = np.stack([simulated().samples(f"{n}.commanded")[1] for n in "XY"], axis=1)
    ends = [places[-1] for places in (commanded(made), whole)]
    assert np.array_equal(*ends)
    moves = [np.abs(np.diff(places, axis=0)).sum(axis=0) for places in (commanded(made), whole)]
    np.testing.assert_allclose(moves[0], moves[1], rtol=1e-9)


@pytest.mark.parametrize("tick", [1, 900, 2503])
def test_frame_rests_after_the_present_turn_when_refills_stop(tick: int) -> None:
    made = bench()
    made.go_on(tick)
    at = made.executor.tick
    made.wire.mute = True
    machine = made.wire.machine
    for _ in range(40):
        machine.play(50)
        message = made.wire.receive()
        assert message is not None
        made.sink.block(made.executor.far_end.reported(message, None))
    assert machine.standing
    assert machine.starved
    moved = np.flatnonzero(np.diff(commanded(made), axis=0).any(axis=1))
    assert not len(moved) or moved[-1] <= at + 100 + window()


@pytest.mark.parametrize("kind", ["late-ticks", "one-late-tick", "lost-link", "power-loss"])
def test_a_fault_ends_it(kind: str) -> None:
    made = bench(SimFault(kind, 1000))
    made.go_on()
    assert made.executor.state is State.FAULT
    assert (made.executor.ended or (None,))[0] is RunEnd.FAULT


def test_turns_beyond_the_travel_are_never_sent() -> None:
    axes = frame().axes
    travel = axes["X"].travel
    assert travel is not None
    low, high = (replace(end, si=value) for end, value in zip(travel, (-3e-3, 3e-3), strict=True))
    machine = replace(frame(), axes={**axes, "X": replace(axes["X"], travel=(low, high))})
    made = Bench(other=machine, same=True, start=np.zeros(2, np.int64)).ready()
    with pytest.raises(LimitError, match=r"axis X: a turn goes to 0\.004, beyond its travel"):
        made.executor.start(sewn())
    assert made.executor.state is State.IDLE
    assert not [message for message in made.wire.sent if message.kind == "refill"]


@pytest.mark.long(shown_by="tests/live/test_checked.py::test_the_command_runs_what_it_proves")
@pytest.mark.usefixtures("forked_machine")
def test_the_command_records_what_it_proves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The machine is in a separate process, and the judge is the same."""
    check_same_when_run(tmp_path, capsys, "rosette.dst", "schiffli-frame")
