"""Live recordings are read once: one reading gives the same verdict as many readings."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from threadline.errors import RecordingError
from threadline.files import Clock, Recording, RecordingBlock
from threadline.files.recording import ChannelKind
from threadline.verdict import Criterion, judge, load_spec
from threadline.verdict.samples import MOST_WAITING

from .builders import SERVO, follow, plan_through, record, spec_of
from .long_jobs import long_job

XY = ("X", "Y")
POINTS = [[0, 0], [0.1, 0], [0.1, 0.05], [0.05, 0.05], [0.05, -0.05], [0.05, 0.05]]
SPEC = spec_of(
    Criterion(name="contour_error", limit=5e-4, required=True),
    Criterion(name="turning_point_error", limit=5e-4),
    Criterion(name="repeatability", options={"recordings": 2.0}, limit=1e-3),
    lag_s=0.02,
)


class Once:
    """Blocks of a live machine: a second reading is refused."""

    def __init__(self, blocks) -> None:
        self._blocks = blocks
        self._read = False

    def __iter__(self):
        assert not self._read, "read twice"
        self._read = True
        yield from self._blocks


def once(recording: Recording) -> Recording:
    return replace(recording, blocks=Once(recording.blocks), simulated=False)


def again(recording: Recording) -> Recording:
    return replace(recording, simulated=False)


def off_the_path(seed: int, text, per_block: int = 64) -> Recording:
    commanded, operation = follow(POINTS, 20)
    random = np.random.default_rng(seed)
    actual = commanded + random.normal(0.0, 1e-4, commanded.shape)
    return record(XY, {ChannelKind.LOAD: actual}, text(operation), per_block=per_block)


OPERATIONS = {
    "told": lambda operation: operation,
    "nothing": lambda operation: np.full_like(operation, -1.0),
    "late": lambda operation: np.where(operation < 2, -1.0, operation),
    "at the end": lambda operation: np.where(np.arange(len(operation)) < 130, -1.0, operation),
}


@pytest.mark.parametrize("per_block", [7, 64])
@pytest.mark.parametrize("name", OPERATIONS)
def test_one_reading_gives_the_verdict_of_two(name: str, per_block: int) -> None:
    plan = plan_through(POINTS, XY)
    made = [off_the_path(seed, OPERATIONS[name], per_block) for seed in (1, 2)]
    live = judge([once(one) for one in made], plan, SPEC)
    assert live == judge([again(one) for one in made], plan, SPEC)
    assert live.result("repeatability").measured is not None
    by_time = "operations from the plan by time" in live.result("contour_error").note
    assert by_time is (name == "nothing")
    if by_time:  # as if the column were absent
        none = [off_the_path(seed, lambda _: None, per_block) for seed in (1, 2)]
        assert live == judge([again(one) for one in none], plan, SPEC)


def test_runs_that_tell_and_runs_that_do_not_are_compared() -> None:
    """The operations by time equal the operations that the other run recorded."""
    plan = plan_through(POINTS, XY)
    silent = off_the_path(1, OPERATIONS["nothing"], 7)
    telling = off_the_path(2, OPERATIONS["told"], 64)
    mixed = judge([once(silent), once(telling)], plan, SPEC).result("repeatability")
    both = judge([off_the_path(1, OPERATIONS["told"]), telling], plan, SPEC).result("repeatability")
    assert mixed.measured == both.measured is not None
    assert (mixed.time_s, mixed.operation) == (both.time_s, both.operation)
    other = off_the_path(2, lambda operation: np.maximum(operation - 1, 0))
    note = judge([once(silent), once(other)], plan, SPEC).result("repeatability").note
    assert "differ in their operations" in note


def peak_and_verdict(chunks: int, value: float | None):
    """Judge a long job once; return its memory use, and the verdict."""
    plan, recording = long_job(chunks)
    if value is not None:
        made = recording.blocks

        def blocks():
            for block in made:
                nothing = np.full_like(block.samples["operation"], value)
                yield replace(block, samples={**block.samples, "operation": nothing})

        recording = replace(recording, blocks=blocks())
    spec = load_spec(None, plan.machine)
    tracemalloc.start()
    verdict = judge([once(recording)], plan, spec)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak, verdict


@pytest.mark.parametrize("value", [None, -1.0])
def test_ten_times_the_job_needs_no_more_memory(value: float | None) -> None:
    """Nothing before the first operation is kept; a need for ten times as much is refused.

    A quarter allows for the heap.
    """
    peak_and_verdict(3, value)  # compiles, fills caches
    short, _ = peak_and_verdict(3, value)
    long, verdict = peak_and_verdict(30, value)
    assert long < 1.25 * short
    assert verdict.result("contour_error").measured == pytest.approx(2e-4, abs=1e-12)


LOGGER = Clock("logger", Fraction(10, 1000))


def two_clocks(behind: int, per_block: int = 16) -> Recording:
    """Return positions, and every second operation on a clock of its own, some blocks late."""
    whole = off_the_path(3, OPERATIONS["told"])
    load = {name: whole.samples(name)[1] for name in ("X.load", "Y.load")}
    operation = whole.samples("operation")[1][::2]
    channels = tuple(
        replace(c, clock=LOGGER) if c.kind is ChannelKind.OPERATION else c for c in whole.channels
    )
    blocks, count, half = [], len(load["X.load"]), per_block // 2
    for k in range(-(-count // per_block) + behind):
        at, late = k * per_block, (k - behind) * half
        rows = slice(max(late, 0), max(late + half, 0))
        samples = {name: values[at : at + per_block] for name, values in load.items()}
        blocks.append(
            RecordingBlock(
                first_tick={SERVO.name: at, LOGGER.name: max(late, 0)},
                samples={**samples, "operation": operation[rows]},
            )
        )
    return replace(whole, channels=channels, blocks=blocks)


@pytest.mark.parametrize("behind", [1, 3])
def test_a_channel_may_come_later_than_the_others(behind: int) -> None:
    """The operation under way counts, in whichever block the recorder wrote it."""
    plan = plan_through(POINTS, XY)
    spec = spec_of(Criterion(name="contour_error", limit=5e-4), lag_s=0.02)
    in_step = judge([once(two_clocks(0))], plan, spec)
    assert in_step.result("contour_error").measured is not None
    assert judge([once(two_clocks(behind))], plan, spec) == in_step


def test_a_channel_that_comes_much_later_is_refused() -> None:
    """Memory is bounded: instead of a wait without end, the message has a remedy."""
    plan = plan_through(POINTS, XY)
    count = 2 * MOST_WAITING
    whole = two_clocks(0)

    def blocks():
        for at in range(0, count, 4096):
            still = np.zeros(4096)
            yield RecordingBlock(
                first_tick={SERVO.name: at, LOGGER.name: 0},
                samples={"X.load": still, "Y.load": still, "operation": np.empty(0)},
            )
        yield RecordingBlock(
            first_tick={SERVO.name: count, LOGGER.name: 0},
            samples={"X.load": np.empty(0), "Y.load": np.empty(0), "operation": np.zeros(9)},
        )

    spec = spec_of(Criterion(name="contour_error", limit=5e-4), lag_s=0.02)
    with pytest.raises(RecordingError, match="'operation' comes with 0 s when"):
        judge([replace(once(whole), blocks=Once(blocks()))], plan, spec)
