"""Sessions: rows in any pieces, stops and waits that halt, and the same bits elsewhere."""

from __future__ import annotations

import pickle
import subprocess
import sys
from dataclasses import replace
from itertools import repeat

import numpy as np
import pytest

from threadline.errors import OptionError
from threadline.files import Event, Outcome, RunEnd, TickBlock
from threadline.machine.load import load_machine
from threadline.twin import Session, simulate

from .belt_reference import ROWS, amplifier

FRICTION = 'friction = "8 N exact, assumed"\nstiction = "11 N exact, assumed"'


def collected(blocks):
    """Return the samples of blocks that follow each other, and all of their events."""
    blocks = list(blocks)
    samples = {
        name: np.concatenate([block.samples[name] for block in blocks])
        for name in blocks[0].samples
    }
    return samples, tuple(event for block in blocks for event in block.events)


def assert_same(one, other, ticks=None):
    assert one.keys() == other.keys()
    for name, values in one.items():
        np.testing.assert_array_equal(values[:ticks], other[name][:ticks], err_msg=name)


def block_of(rows, first=0, events=()):
    counts = np.asarray(rows, dtype=np.int64).reshape(len(rows), -1)
    operation = (first + np.arange(len(rows))) // 50
    return TickBlock(first_tick=first, counts=counts, operation=operation, events=tuple(events))


def with_events(commands, *events):
    """Return a table of one block with these events."""
    (block,) = commands
    return replace(commands, blocks=type(commands.blocks).of([replace(block, events=events)]))


@pytest.fixture
def sticking(belt_axis):
    """A belt axis that sticks, slips and is limited: its modes change many times."""
    return belt_axis(bodies_head=FRICTION, drives_m=amplifier(2.5))


@pytest.mark.parametrize("every", [1, 7])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_pieces_of_rows_do_not_matter(sticking, table, seed, every):
    """Rows and ticks in random pieces give the recording of the simulation."""
    commands = table(sticking, {"X": ROWS})
    whole, _ = collected(simulate(commands, sticking, settle_s=0.2, record_every=every))
    random = np.random.default_rng(seed)
    session = Session(sticking, record_every=every)
    blocks, at = [], 0
    while at < len(ROWS):
        count = int(random.integers(1, 30))
        part = block_of(ROWS[at : at + count], at)
        blocks.append(session.advance(part, ticks=int(random.integers(0, min(count, len(part)))))
                      if random.random() < 0.5 else session.advance(part))  # fmt: skip
        at += count
    blocks.append(session.advance())
    session.finish()
    while session.tick < len(ROWS) + 101:
        blocks.append(session.advance(ticks=min(int(random.integers(1, 40)),
                                                len(ROWS) + 101 - session.tick)))  # fmt: skip
    found, events = collected(blocks)
    assert_same(found, whole)
    assert Outcome().after(events).late_ticks == 0
    assert session.ended is RunEnd.COMPLETED


def test_a_stop_lets_the_plant_go_on(sticking, table):
    """A stop of n ticks equals n rows of nothing: the command stands, the head swings."""
    at, pause = 60, 25
    stop = Event(tick=at, kind="stop", operation=1)
    commands = with_events(table(sticking, {"X": ROWS}), stop)
    found, events = collected(simulate(commands, sticking, answers=[pause * 2e-3]))
    longer = np.insert(ROWS, at, np.zeros(pause, dtype=int))
    expected, _ = collected(simulate(table(sticking, {"X": longer}), sticking))
    del found["operation"], expected["operation"]
    assert_same(found, expected)
    assert np.ptp(found["X.load"][at : at + pause]) > 1e-4
    kinds = [(e.kind, e.tick) for e in events]
    assert kinds == [("stop", at), ("resume", at + pause), ("completed", len(ROWS) + pause)]
    assert Outcome().after(events).halted_ticks == pause


def test_stops_answered_at_once_change_nothing(sticking, table):
    """The default: the rest that the plan has, and every stop reported."""
    plain = table(sticking, {"X": ROWS})
    events = [Event(tick=t, kind="stop", operation=0) for t in (0, 31, len(ROWS))]
    expected, _ = collected(simulate(plain, sticking))
    for answers in (None, repeat(0.0)):
        commands = with_events(plain, *events)
        found, text = collected(simulate(commands, sticking, answers=answers))
        assert_same(found, expected)
        assert [e.tick for e in text if e.kind == "stop"] == [0, 31, len(ROWS)]


def test_an_unanswered_stop_ends_the_recording(sticking, table):
    stop = Event(tick=60, kind="stop", operation=1)
    commands = with_events(table(sticking, {"X": ROWS}), stop)
    recording = simulate(commands, sticking, answers=[], settle_s=0.1)
    outcome = recording.outcome()
    assert outcome.ended is RunEnd.STOPPED and outcome.incomplete
    assert (outcome.tick, outcome.operation) == (60, 1)
    assert outcome.text == "nobody answered the stop"
    assert len(recording.samples("X.load")[1]) == 60 + 51
    with pytest.raises(OptionError, match="answers"):
        list(simulate(commands, sticking, answers=[-1.0]))


def test_a_wait_for_an_input_of_no_part_halts_until_the_machine_resumes(sticking):
    session = Session(sticking)
    wait = Event(tick=10, kind="wait", operation=0, name="door", value=1.0)
    assert len(session.advance(block_of(ROWS, 0, [wait])).samples["X.load"]) == 10
    assert session.halted == wait
    session.advance(ticks=5)
    assert session.row == 10
    session.resume()
    block = session.advance(ticks=3)
    assert session.row == 13 and session.halted is None
    assert [(e.kind, e.tick) for e in block.events] == [("resume", 15)]


def test_a_wait_for_a_limit_switch_is_answered_by_the_plant(table):
    """X runs on past its switch; the rows go on at the first tick after the switch has tripped."""
    machine = load_machine("lathe-winder")
    start = np.array([0, round(505 * 55.358), 0])
    rows = np.zeros((400, 3), dtype=np.int64)
    rows[:18, machine.axis_names.index("X")] = 20
    wait = Event(tick=18, kind="wait", operation=0, name="x_high", value=1.0)
    session = Session(machine, start_counts=start)
    block = session.advance(block_of(rows, 0, [wait]))
    assert session.halted == wait and not block.samples["x_high"].any()
    block = session.advance(ticks=200)
    resumed = next(e.tick for e in block.events if e.kind == "resume")
    tripped = np.flatnonzero(block.samples["x_high"])
    assert resumed == 18 + tripped[0]
    assert session.row == 18 + 200 - (resumed - 18)


def test_hold_and_resume(sticking, table):
    """A hold in the middle of a move equals so many rows of nothing, too."""
    session = Session(sticking)
    blocks = [session.advance(block_of(ROWS), ticks=20)]
    session.hold()
    assert session.held
    blocks.append(session.advance(ticks=15))
    assert session.row == 20
    session.resume()
    blocks.append(session.advance())
    found, events = collected(blocks)
    longer = np.insert(ROWS, 20, np.zeros(15, dtype=int))
    expected, _ = collected(simulate(table(sticking, {"X": longer}), sticking))
    del found["operation"], expected["operation"]
    assert_same(found, expected, len(longer))
    assert [(e.kind, e.tick) for e in events] == [("hold", 20), ("resume", 35)]


def test_rows_that_come_late_are_counted(sticking):
    """Before the first row nothing is late, after the end nothing either."""
    session = Session(sticking)
    session.advance(ticks=9)
    blocks = [session.advance(block_of(ROWS[:10]), ticks=14)]
    blocks.append(session.advance(block_of(ROWS[10:20], 10), ticks=13))
    session.finish()
    blocks.append(session.advance(ticks=50))
    outcome = Outcome().after(collected(blocks)[1])
    assert (outcome.ended, outcome.late_ticks) == (RunEnd.COMPLETED, 7)
    assert session.tick == 86


def test_a_fault_drops_the_rows_that_wait(sticking):
    session = Session(sticking)
    session.advance(block_of(ROWS), ticks=20)
    session.finish(RunEnd.FAULT, "the link is gone")
    assert session.ended is RunEnd.FAULT and session.queued == 0
    block = session.advance(ticks=10)
    assert np.ptp(block.samples["X.commanded"]) == 0.0
    outcome = Outcome().after(block.events)
    assert (outcome.ended, outcome.text, outcome.tick) == (RunEnd.FAULT, "the link is gone", 20)
    with pytest.raises(OptionError, match="after the commands were fault"):
        session.advance(block_of(ROWS, len(ROWS)))


def test_rows_that_are_left_out_are_refused(sticking):
    session = Session(sticking)
    with pytest.raises(OptionError, match="the rows begin at 3, expected 0"):
        session.advance(block_of(ROWS, 3))
    with pytest.raises(OptionError, match="2 axes"):
        session.advance(TickBlock(first_tick=0, counts=np.zeros((4, 2), int), operation=[0] * 4))


GO_ON = """
import pickle, sys
session = pickle.load(sys.stdin.buffer)
pickle.dump([session.advance(), session.advance(ticks=100)], sys.stdout.buffer)
"""


@pytest.mark.long(but="sticking")
@pytest.mark.parametrize("name", ["sticking", "stitcher"])
def test_pickled_session_goes_on_in_another_process(name, sticking):
    """State, modes, dead times and waiting rows are sent; the stitcher has 16 advance lengths."""
    machine = sticking if name == "sticking" else load_machine("stitcher")
    rows = ROWS if name == "sticking" else np.full((160, 2), 50)
    session = Session(machine)
    session.advance(block_of(rows), ticks=57)
    done = subprocess.run(
        [sys.executable, "-c", GO_ON], input=pickle.dumps(session), capture_output=True, check=True
    )
    here = collected([session.advance(), session.advance(ticks=100)])[0]
    assert_same(here, collected(pickle.loads(done.stdout))[0])
    assert np.ptp(here["X.load"]) > 1e-4


def test_a_recording_travels(sticking, table):
    recording = simulate(table(sticking, {"X": ROWS}), sticking, encoder_phase=np.array([0.25]))
    copy = pickle.loads(pickle.dumps(recording))
    assert_same(collected(copy)[0], collected(recording)[0])
