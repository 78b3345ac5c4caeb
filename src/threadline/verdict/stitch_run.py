"""Measures of stitches: the worst stitch by length, placement, speed, time, residual or force.

In embroidery the channel ``needle`` records when the needle is in the cloth, simulated or live: its
k-th entry is the k-th stitch of the design. Each measure names the worst stitch by block and
number, how many stitches exceed the limit, and the shaft speed at which the worst would not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.commands.turns import Stitched
from threadline.files import Channel, ChannelKind, Recording, RecordingBlock
from threadline.files.step_play import concatenated_intervals
from threadline.verdict.coverage import Coverage
from threadline.verdict.demands import SLACK
from threadline.verdict.finding import Finding, Hidden, RunFindings, Worst
from threadline.verdict.measure import Measure, Option, Running, RunReading
from threadline.verdict.needle import Stitches, has_stitches
from threadline.verdict.samples import (
    Block,
    Setting,
    finite_samples,
    largest_acceleration,
    sample_interval_s,
)
from threadline.verdict.sewn import Figure, SewnStitches, StitchFollower

OPTIONS = {"delay": Option(unit="s", default=0.0)}
SPEED_OPTIONS = {**OPTIONS, "over": Option(unit="s", default=0.002)}
_NONE = "the job has no stitches"
_WORDS = {False: ("too long", "too short"), True: ("too fast", "too slow")}
_ROUNDING = 1e-9
SHORT = "the recording ends before this stitch"


class _Stitching:
    """The worst stitch by its length, placement, speed or time."""

    def __init__(
        self, setting: Setting, delay_s: float, figure: Figure, over_s: float = 0.002
    ) -> None:
        self._figure: Figure = figure
        columns = [setting.axes.index(a) for a in setting.plan.job.axes]
        self._radius_m = setting.radius_m[columns]
        self._follower = (
            StitchFollower(setting, delay_s, over_s, (figure,))
            if has_stitches(setting.plan.job)
            else None
        )
        self._runs = setting.runs
        self._worst = Worst(setting.runs, len(columns), note=_NONE)

    def feed(self, block: Block) -> None:
        assert block.actual is not None
        if self._follower is None:
            return
        for sewn in self._follower.feed(block):
            self._take(sewn)

    def finish(self) -> Sequence[RunFindings]:
        left = None if self._follower is None else self._follower.unsewn
        return [self._worst.found() if left is None else too_short(left, self._runs)]

    def _take(self, sewn: SewnStitches) -> None:
        run = sewn.stitches
        at_s = sewn.down_s
        if self._figure == "placement":
            values, error = sewn.placement_m, sewn.placement_m
        else:
            if self._figure == "length":
                error = sewn.length_error
            elif self._figure == "speed":
                error, at_s = sewn.speed_error, sewn.speed_s
            else:
                turn = turn_error(run)
                error = np.broadcast_to(turn[:, None], (len(turn), self._runs))
            free = run.exempt & ~run.follows if self._figure == "time" else run.exempt
            values = np.where(free[:, None] | np.isnan(error), -1.0, np.abs(error))
        at, columns = np.argmax(values, axis=0), np.arange(self._runs)
        worst = values[at, columns]
        judged = worst >= 0.0
        if not judged.all():
            self._worst.say("every stitch is exempt")
        more, less = _WORDS[self._figure == "speed"]
        notes = np.where(error[at, columns] > 0.0, more, less)
        self._worst.offer(
            np.where(judged, worst, np.nan),
            time_s=at_s[at] if at_s.ndim == 1 else at_s[at, columns],
            operation=run.operation[at],
            line=run.line[at],
            position=run.point[at] / self._radius_m,
            note="" if self._figure == "placement" else notes.astype(object),
        )


def turn_error(run: Stitches) -> FloatArray:
    """Return (n,) relative errors of the planned times of stitches.

    They are relative to the programmed time, or for a needle that follows the head to the nearer
    bound of its speed range; beside a rest such a needle may turn as slowly as necessary.
    """
    own = (run.down_s - run.from_s) / run.period_s - 1.0
    slowest = np.where(run.departs | run.stops, 0.0, run.slowest_hz)
    with np.errstate(divide="ignore"):
        hz = 1.0 / run.period_s
        fast, slow = run.fastest_hz / hz - 1.0, np.maximum(slowest / hz - 1.0, 0.0)
    return np.asarray(np.where(run.follows, np.where(fast < 0.0, fast, slow), own))


def too_short(left: Stitches, runs: int) -> RunFindings:
    """Return the finding if the recording ends before the first stitch of ``left``."""
    finding = Finding(
        value=None, operation=int(left.operation[0]), job_line=int(left.line[0]), note=SHORT
    )
    return RunFindings.alike(finding, runs)


def start_length(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the relative error of the length of stitches that are not exempt."""
    return _Stitching(setting, options["delay"], "length")


def start_placement(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the distance of needle-downs from the seam."""
    return _Stitching(setting, options["delay"], "placement")


def start_speed(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the relative error of the head's speed, in stitches that are not exempt."""
    return _Stitching(setting, options["delay"], "speed", options["over"])


def start_needle(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the relative error of the time of stitches that are not exempt.

    No stitch is exempt if the needle follows the head.
    """
    return _Stitching(setting, options["delay"], "time")


NEEDLE = "needle"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sewn:
    """Results of each stitch; s stitches, A axes; NaN for a stitch that was not seen.

    Parameters
    ----------
    residual_m
        (s, A) largest distance of the frame from its place while the needle was in the cloth.
    time_s
        (s, A) time of that distance.
    force
        (s, A) largest share of the servo's force since the previous stitch.
    force_s
        (s, A) time of that force.
    seen
        Number of recorded needle entries.
    until_s
        When the needle was last seen in the cloth, s.
    """

    residual_m: FloatArray
    time_s: FloatArray
    force: FloatArray
    force_s: FloatArray
    seen: int
    until_s: float


class StitchRun:
    """A recording with its stitches; one block of samples is in memory at a time.

    Parameters
    ----------
    recording, plan
        The recording and its plan.
    """

    of: ClassVar[str] = "an embroidery machine"
    absent: ClassVar[str] = "nothing of axis {axis} was measured"
    by_time = False
    fallback = None

    def __init__(self, recording: Recording, plan: Plan) -> None:
        self.plan = plan
        self.stitched = plan.stitched
        self._coverage = Coverage(recording)
        self.recording = self._coverage.watched
        self._sewn: Sewn | None = None

    @cached_property
    def turns(self) -> IntArray:
        """(s,) turn of each stitch."""
        return np.flatnonzero(self.stitched.turns.moves.needle == 1)

    @cached_property
    def places_m(self) -> FloatArray:
        """(s, A) intended places of the frame."""
        return self.stitched.places_m[self.turns]

    def hidden(self, axis: str) -> Hidden | None:
        """Return by how much the frame may be farther from its place than at the samples, m.

        While it brakes at the acceleration a of the machine file, a frame is a T^2 / 2 from its
        place at a time T before; an excursion between two samples is a quarter of that. None for
        a simulated recording with a sample at each tick.
        """
        load = self.recording.find(ChannelKind.LOAD, axis)
        if load is None:
            return None
        interval_s, tick_s = sample_interval_s(load), float(self.plan.machine.tick_clock.period_s)
        if self.recording.simulated and interval_s <= tick_s * (1.0 + _ROUNDING):
            return None
        most_m_s2 = largest_acceleration(self.plan.machine.axes[axis])
        most_m = 0.5 * most_m_s2 * interval_s**2
        why = (
            f"between two of them the frame may be {1e3 * most_m:.4g} mm farther away, at the "
            f"{most_m_s2:.4g} m/s^2 of the machine file"
        )
        return Hidden(load.name, interval_s, most_m, why)

    @property
    def sewn(self) -> Sewn:
        """Results of each stitch; reads the recording once."""
        if self._sewn is None:
            self._sewn = self._read()
        return self._sewn

    def lacks(self, reading: RunReading, per_axis: bool) -> str:  # noqa: ARG002
        """Return which channel for its measures is missing; empty if none is."""
        for alternatives in reading.needs:
            for axis in self.plan.axes:
                if not any(self.recording.find(kind, axis) for kind in alternatives):
                    names = " or ".join(kind.value for kind in alternatives)
                    return f"no {names} channel of {axis}"
        if not any(c.name == NEEDLE for c in self.recording.channels):
            return "no needle channel: nobody knows when it was in the cloth"
        needle = self.recording.channel(NEEDLE)
        for channel in self._read_together:
            if (channel.clock, channel.stride) != (needle.clock, needle.stride):
                return f"{channel.name} and {NEEDLE} are not of the same instants"
        return ""

    def blocks(self) -> Iterator[Block]:
        """Yield nothing: its measures read the whole run."""
        return iter(())

    def release(self) -> None:
        """Do nothing: a run holds no more samples than one block."""

    def leave(self) -> None:
        """Do nothing: the run is read as a whole."""

    def results(self, running: Sequence[Running], last: Block | None) -> list[list[RunFindings]]:  # noqa: ARG002
        """Return the findings of each measure, as far as the stitches were seen."""
        found = [list(one.measure.finish()) for one in running]
        why = self.unseen_why()
        if not why:
            return found
        return [[f.each(partial(replace, unseen=why)) for f in row] for row in found]

    def unseen_why(self) -> str:
        """Return which stitches were not seen; empty if all were."""
        if self._sewn is None:
            return ""
        planned_count, seen = len(self.turns), self._sewn.seen
        if seen != planned_count:
            return f"the needle entered {seen} times, the design has {planned_count} stitches"
        own = [c for c in self.recording.channels if c.axis in self.plan.axes or c.name == NEEDLE]
        lack = self._coverage.lack(own, 0.0, self._sewn.until_s)
        return "" if lack is None else lack.why

    def unseen(self, reading: RunReading) -> str:  # noqa: ARG002
        """Return which stitches were not seen, for a measure of many runs."""
        _ = self.sewn
        return self.unseen_why()

    @property
    def _read_together(self) -> list[Channel]:
        """Channels that are read sample by sample with the needle's channel."""
        kinds = (ChannelKind.LOAD, ChannelKind.TORQUE_SHARE)
        found = [self.recording.find(kind, axis) for kind in kinds for axis in self.plan.axes]
        return [channel for channel in found if channel is not None]

    def _read(self) -> Sewn:
        axes, count = self.plan.axes, len(self.turns)
        shape = (count, len(axes))
        residual, at = np.full(shape, np.nan), np.full(shape, np.nan)
        force, force_at = np.full(shape, np.nan), np.full(shape, np.nan)
        seen, was, until_s = 0, False, 0.0
        for block in self.recording:
            times, needle = (
                self._times(block),
                finite_samples(self.recording.channel(NEEDLE), block) != 0,
            )
            if not len(needle):
                continue
            enters = needle & ~np.concatenate(([was], needle[:-1]))
            number = seen + np.cumsum(enters) - 1  # of the stitch, -1 before the first
            for k, axis in enumerate(axes):
                load = self.recording.find(ChannelKind.LOAD, axis)
                if load is not None:
                    stood = finite_samples(load, block)[: len(needle)]
                    inside = (needle & (number >= 0) & (number < count))[: len(stood)]
                    of = number[: len(stood)][inside]
                    off = np.abs(stood[inside] - self.places_m[of, k])
                    _keep(residual[:, k], at[:, k], of, off, times[: len(stood)][inside])
                pull = self.recording.find(ChannelKind.TORQUE_SHARE, axis)
                if pull is not None:
                    # Between two stitches the frame moves to the next one.
                    pulls = finite_samples(pull, block)[: len(needle)]
                    to = np.minimum(number + ~needle, count - 1)[: len(pulls)]
                    _keep(force[:, k], force_at[:, k], to, pulls, times)
            seen += int(enters.sum())
            was = bool(needle[-1])
            if needle.any():
                until_s = float(times[needle][-1])
        return Sewn(
            residual_m=residual,
            time_s=at,
            force=force,
            force_s=force_at,
            seen=seen,
            until_s=until_s,
        )

    def _times(self, block: RecordingBlock) -> FloatArray:
        channel = self.recording.channel(NEEDLE)
        first = block.first_tick[channel.clock.name]
        return channel.clock.times_s(first, len(block.samples[NEEDLE]), channel.stride)


def _keep(
    worst: FloatArray, when: FloatArray, number: IntArray, values: FloatArray, times: FloatArray
) -> None:
    """Keep the largest value of each stitch; the numbers ascend."""
    for begin, end in _runs(number):
        at = begin + int(np.argmax(values[begin:end]))
        stitch = int(number[begin])
        if not worst[stitch] >= values[at]:
            worst[stitch], when[stitch] = values[at], times[at]


def _runs(number: IntArray) -> Iterator[tuple[int, int]]:
    """Yield begin and end of each run of equal numbers."""
    if len(number):
        edges = np.flatnonzero(np.diff(number)) + 1
        yield from zip([0, *edges.tolist()], [*edges.tolist(), len(number)], strict=True)


_MINUTE = 60.0


def measure_tables(plan: Plan) -> Mapping[str, Sequence[Finding]]:
    """Return the measures of the plan alone: use of windows, step rate, table loading, travel."""
    stitched = plan.stitched
    return {
        "window_use": [_window_use(stitched)],
        "step_rate": _step_rates(stitched),
        "fetch_use": [_fetch_use(stitched)],
        "travel": _travel(stitched),
    }


def _at(stitched: Stitched, turn: int, value: float, note: str = "", axis: str = "") -> Finding:
    """Return a finding of a turn, with its name."""
    turns = stitched.turns
    named = stitched.turns.name(turn)
    return Finding(
        value=value,
        axis=axis,
        time_s=float(turns.begin[turn] * float(stitched.commands.clock.period_s)),
        operation=int(turns.operation[turn]),
        job_line=int(turns.line[turn]),
        position=tuple(stitched.places_m[turn].tolist()),
        note="; ".join(filter(None, (named, note))),
    )


def _window_use(stitched: Stitched) -> Finding:
    """Return the largest share of its window that a move needs within the limits of the axes."""
    use = window_uses(stitched)
    worst = int(np.argmax(use))
    note = ""
    if use[worst] > SLACK:
        needed = stitched.pace.rigid_windows_s(stitched.turns.moves)
        turn_s = float(needed[worst]) / stitched.pace.share
        note = f"{_out(use > SLACK, 'turns')}; it can at {_speed(turn_s)}"
    # A window is rounded to a period of the timer; that does not make it too short.
    rounded = 1.0 / float(stitched.turns.window[worst])
    return _at(stitched, worst, max(0.0, float(use[worst]) - rounded), note)


def window_uses(stitched: Stitched) -> FloatArray:
    """Return (n,) share of its window that the move of each turn needs within the limits."""
    windows = stitched.turns.window * float(stitched.commands.clock.period_s)
    return np.asarray(stitched.pace.rigid_windows_s(stitched.turns.moves) / windows)


def step_rates_hz(stitched: Stitched, column: int) -> FloatArray:
    """Return (n,) highest step rate of an axis in each turn, Hz; 0 while it rests."""
    commands, turns = stitched.commands, stitched.turns
    shortest = np.minimum.reduceat(*concatenated_intervals(commands.library)).astype(np.float64)
    tick_s = np.full(len(turns), float(commands.clock.period_s))
    if commands.counted_by == "angle":
        tick_s *= turns.window / commands.window_angle
    table = np.abs(turns.moves.units[:, column]) - 1
    return np.where(table >= 0, 1.0 / (shortest[np.maximum(table, 0)] * tick_s), 0.0)


def _step_rates(stitched: Stitched) -> list[Finding]:
    """Return the highest step rate of each axis, Hz."""
    found = []
    for k, axis in enumerate(stitched.axes):
        rates = step_rates_hz(stitched, k)
        worst = int(np.argmax(rates))
        found.append(_at(stitched, worst, float(rates[worst]), axis=axis))
    return found


def _fetch_use(stitched: Stitched) -> Finding:
    """Return the largest share of the time between two moves that loading tables takes."""
    turns = stitched.turns
    if len(turns) < 2:
        return Finding(value=0.0, note="one turn: its tables are there before")
    period_s = float(stitched.commands.clock.period_s)
    free_s = (turns.begin[1:] - turns.begin[:-1] - turns.window[:-1]) * period_s
    loads = np.count_nonzero(turns.moves.units[1:], axis=1) * stitched.pace.tables.fetch.si
    use = loads / free_s
    worst = int(np.argmax(use))
    note = f"{loads[worst] * 1e3:.4g} of {free_s[worst] * 1e3:.4g} ms"
    return _at(stitched, worst + 1, float(use[worst]), note)


def _travel(stitched: Stitched) -> list[Finding]:
    """Return the distance of the frame beyond its travel on each axis, m."""
    places = stitched.places_m
    found = []
    for k, axis in enumerate(stitched.axes):
        low, high = stitched.machine.travel[k]
        beyond = np.maximum(places[:, k] - high, low - places[:, k])
        worst = int(np.argmax(beyond))
        found.append(_at(stitched, worst, max(0.0, float(beyond[worst])), axis=axis))
    return found


def stitch_residual(run: StitchRun, _options: Mapping[str, float]) -> list[Finding]:
    """Per axis: the largest distance of the frame from its place while the needle is in, m."""
    sewn, pace = run.sewn, run.stitched.pace
    needed_s = pace.needed_turns_s(run.stitched.turns.moves)[run.turns]
    # A stitch is out if any axis is: a single needle enters.
    out = _out(np.asarray((sewn.residual_m > pace.tolerance_m).any(axis=1)), "stitches")
    found = []
    for k, axis in enumerate(run.plan.axes):
        residual = sewn.residual_m[:, k]
        worst = _worst(run, residual, sewn.time_s[:, k], axis)
        if (residual > pace.tolerance_m).any():
            # Counted against the planner's tolerance: a measure does not know its limit.
            note = (
                f"{out} beyond {pace.tolerance_m * 1e3:.4g} mm on an axis; alone it can "
                f"at {_speed(float(needed_s[int(np.nanargmax(residual))]))}"
            )
            worst = replace(worst, note=f"{worst.note}; {note}")
        found.append(replace(worst, hidden=run.hidden(axis)))
    return found


def servo_force(run: StitchRun, _options: Mapping[str, float]) -> list[Finding]:
    """Per axis: the largest used share of the servo's force."""
    sewn = run.sewn
    return [
        _worst(run, sewn.force[:, k], sewn.force_s[:, k], axis)
        for k, axis in enumerate(run.plan.axes)
    ]


def _worst(run: StitchRun, values: FloatArray, times: FloatArray, axis: str) -> Finding:
    if np.isnan(values).all():
        return Finding(value=None, axis=axis, note="no stitch was seen")
    worst = int(np.nanargmax(values))
    turn = int(run.turns[worst])
    found = _at(run.stitched, turn, float(values[worst]), axis=axis)
    return replace(found, time_s=float(times[worst]))


def _out(over: NDArray[np.bool_], what: str) -> str:
    return f"{int(over.sum())} of {len(over)} {what}"


def _speed(turn_s: float) -> str:
    return f"{_MINUTE / turn_s:.4g} stitches a minute"
