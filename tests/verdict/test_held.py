"""Held runs are judged by the plan's time: compared with closed forms, and with unheld runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.verdict.builders import TICK_S, plan_through, record, spec_of
from tests.verdict.test_stitches import COUNT, LENGTH_M, PERIOD_S, POINTS, SPEED_M_S, seam
from threadline.commands.plan import Following, Plan
from threadline.errors import RecordingError
from threadline.files import ChannelKind, Event, Recording, RecordingBlock, Stream
from threadline.verdict import Criterion, Result, Status, judge

BEGIN, TICKS = 60, 90  # the hold: its first tick, and the number of ticks until all rows go on
SLOW = 10  # ticks in which it brakes, and in which it accelerates
NAMES = (
    "stitch_length_error", "stitch_placement_error", "stitch_speed_error", "stitches_to_speed",
    "needle_time_error", "progress_error", "contour_error", "velocity_ripple", "tracking_error",
)  # fmt: skip


def pace(ticks: int) -> np.ndarray:
    """Return the plan time at each tick, in ticks: at half of the rate, at rest, at half."""
    rate = np.ones(ticks)
    rate[BEGIN : BEGIN + TICKS] = 0.0
    rate[BEGIN : BEGIN + SLOW] = rate[BEGIN + TICKS - SLOW : BEGIN + TICKS] = 0.5
    return np.concatenate([[0.0], np.cumsum(rate[:-1])])


def plan_events(places: np.ndarray) -> list[Event]:
    """Return the events of the machine: one at each tick in a hold, to be simple."""
    held = np.flatnonzero(places != np.arange(len(places)))
    held = held[held <= BEGIN + TICKS]
    return [Event(tick=int(k), kind="plan", operation=-1, value=places[k] * TICK_S) for k in held]


def sewn_run(*, tells: bool = True, off: float = 0.0, held: bool = True) -> Recording:
    """Return a run along the seam of ``seam()`` that is at the plan's place at each instant.

    ``off`` is how far the head is ahead in a hold, once it has come to rest.
    """
    ticks = round(COUNT * PERIOD_S / TICK_S) + 41 + TICKS
    places = pace(ticks) if held else np.arange(float(ticks))
    x = np.minimum(places * TICK_S, COUNT * PERIOD_S) * SPEED_M_S
    stands = np.concatenate([[False], np.diff(places) == 0.0]) & (x < COUNT * LENGTH_M)
    at = np.stack([x, 0.0 * x], axis=1)
    operation = np.minimum(places * TICK_S / PERIOD_S + 1e-9, COUNT - 1).astype(np.int64)
    run = record(("X", "Y"), {ChannelKind.LOAD: at + off * stands[:, None] * [1.0, 0.0],
                              ChannelKind.COMMANDED: at}, operation)  # fmt: skip
    return with_events(run, plan_events(places)) if tells and held else run


def with_events(run: Recording, events: list[Event]) -> Recording:
    """Return a recording with events, each in the block of its tick."""
    blocks = []
    for block in run:
        first = block.first_tick["servo"]
        own = range(first, first + len(block.samples["operation"]))
        due = tuple(event for event in events if event.tick in own)
        blocks.append(replace(block, events=due))
    return replace(run, blocks=Stream.of(blocks))


def judged(run: Recording, plan: Plan | None = None) -> dict[str, Result]:
    criteria = [Criterion(name=name, limit=0.02 if "error" in name else None) for name in NAMES]
    verdict = judge([run], plan or seam(), spec_of(*criteria))
    return {result.name: result for result in reversed(verdict.results)}  # X is judged before Y


def test_a_run_that_was_held_is_where_the_plan_was() -> None:
    held, unheld = judged(sewn_run()), judged(sewn_run(held=False))
    for name in NAMES:
        ours, other = held[name], unheld[name]
        assert ours.status is other.status, name
        assert (ours.measured is None) == (other.measured is None)
        if ours.measured is not None:
            assert ours.measured == pytest.approx(other.measured, abs=1e-9), name
    assert held["stitch_speed_error"].measured == pytest.approx(0.0, abs=1e-9)


def test_without_the_record_the_plan_goes_on_while_it_is_held() -> None:
    found = judged(sewn_run(tells=False))
    assert found["stitch_length_error"].measured == pytest.approx(1.0)  # stitches at one place
    assert found["stitch_placement_error"].status is Status.PASSED  # still on the seam
    held_s = float((np.arange(TICKS + BEGIN + 1) - pace(TICKS + BEGIN + 1)).max()) * TICK_S
    assert held_s > 0.3
    assert found["velocity_ripple"].measured == pytest.approx(1.0)


def test_motion_of_the_machine_during_a_hold_is_judged() -> None:
    found = judged(sewn_run(off=1.5e-3))
    assert found["progress_error"].measured == pytest.approx(1.5e-3)
    assert found["progress_error"].note == "ahead"
    # The needle is down once while it brakes, and again while it accelerates.
    assert found["stitch_length_error"].status is Status.PASSED
    assert found["tracking_error"].measured == pytest.approx(1.5e-3)


def test_a_stitch_that_is_sewn_wrong_in_a_hold_is_told() -> None:
    """The head is 0.5 mm behind during the whole braking, in which a needle goes down."""
    run = sewn_run()
    slow = slice(BEGIN, BEGIN + SLOW)
    blocks = []
    for block in run:
        first = block.first_tick["servo"]
        load = block.samples["X.load"].copy()
        load[max(slow.start - first, 0) : max(slow.stop - first, 0)] -= 5e-4
        blocks.append(replace(block, samples={**block.samples, "X.load": load}))
    found = judged(replace(run, blocks=Stream.of(blocks)))
    assert found["stitch_length_error"].measured == pytest.approx(0.25)
    assert found["stitch_length_error"].status is Status.FAILED


def test_loads_that_follow_are_meant_at_the_plans_time() -> None:
    """The recorded command is not used: with feed-forward, motors have another motion."""
    plan = plan_through(POINTS, move_s=PERIOD_S)
    follows = replace(plan, intent=replace(plan.motion, following=Following.LOAD))
    for tells, limit in ((True, 1e-9), (False, 0.02)):
        found = judged(sewn_run(tells=tells), follows)
        assert (found["progress_error"].measured <= limit) is tells
        assert (found["tracking_error"].measured <= limit) is tells


def test_a_run_that_stands_when_it_ends_has_not_come_to_the_end() -> None:
    """This holds however long it stood: 4 s here, for a motion of 0.8 s."""
    run = sewn_run()
    (first, second, *_) = run
    stands = {name: np.full(800, a[-1]) for name, a in second.samples.items()}
    last = RecordingBlock(first_tick={"servo": 128}, samples=stands)
    found = judged(replace(run, blocks=Stream.of([first, second, last])))
    assert found["contour_error"].status is Status.NOT_MEASURED
    assert "the motion at" in found["contour_error"].note


def test_operations_by_time_are_those_of_the_plans_time() -> None:
    run = sewn_run()
    bare = replace(run, channels=tuple(c for c in run.channels if c.name != "operation"))
    assert judged(bare)["contour_error"].measured == pytest.approx(0.0, abs=1e-9)
    assert judged(bare)["velocity_ripple"].measured == pytest.approx(0.0, abs=1e-9)


def test_runs_that_were_held_are_not_compared_with_others() -> None:
    spec = spec_of(Criterion(name="repeatability", limit=1e-3, options={"recordings": 2}))
    (found,) = (
        r for r in judge([sewn_run(), sewn_run()], seam(), spec).results
        if r.name == "repeatability"
    )  # fmt: skip
    assert (found.status, found.note) == (
        Status.NOT_MEASURED, "a run was held: its instants are its own",
    )  # fmt: skip


@pytest.mark.parametrize(("tick", "value"), [(70, -1.0), (70, 1e300), (3, 0.1)])
def test_a_record_that_no_run_can_have_is_refused(tick: int, value: float) -> None:
    """A time before the plan, one far after any, and an event that goes back."""
    blocks = list(sewn_run())
    wrong = Event(tick=tick, kind="plan", operation=-1, value=value)
    blocks[1] = replace(blocks[1], events=(*blocks[1].events, wrong))
    with pytest.raises(RecordingError, match="of the plan were due at"):
        judged(replace(sewn_run(), blocks=Stream.of(blocks)))
