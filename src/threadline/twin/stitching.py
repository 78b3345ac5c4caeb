"""Simulates an embroidery machine: the servos of the frame, and when the needle is in the cloth.

The servos follow the steps with a lag, and move the frame through a linear network
(:mod:`threadline.twin.stitching_run`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from math import ceil, pi
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import MachineError, OptionError, RecordingError
from threadline.files import (
    Channel,
    ChannelKind,
    Event,
    Recording,
    RecordingBlock,
    RunEnd,
    StepPlay,
    StitchBlock,
    Stream,
)
from threadline.machine import Machine
from threadline.twin.prescribed import in_order
from threadline.twin.stitching_run import Driven, Library, Played, driven_of, play


class Needles:
    """Position of the needle while a machine plays ``commands``.

    The shaft has a constant speed in the window of the move. Over the rest of the turn its speed
    changes linearly to the speed in the next window.
    """

    def __init__(self, machine: Machine, commands: StepPlay) -> None:
        assert machine.shaft is not None
        self._end = commands.duration_ticks
        self._window = commands.window_angle / commands.steps_per_turn
        self._enters = machine.shaft.needle_enters.si / (2.0 * pi)
        self._leaves = machine.shaft.needle_leaves.si / (2.0 * pi)

    def down(self, block: StitchBlock, after: StitchBlock | None, ticks: IntArray) -> FloatArray:
        """Return (n,) 1 if the needle is in the cloth, for (n,) rising ticks within ``block``."""
        following = self._end if after is None else int(after.begin[0])
        speed = self._window / block.window
        last = speed[-1] if after is None else self._window / float(after.window[0])
        ends = np.append(block.begin[1:], following)
        enters, leaves = (
            block.begin + self._after(angle, speed, np.append(speed[1:], last), block, ends)
            for angle in (self._enters, self._leaves)
        )
        turn = np.searchsorted(block.begin, ticks, side="right") - 1
        inside = np.maximum(turn, 0)
        down = (ticks >= enters[inside]) & (ticks < leaves[inside]) & (turn >= 0)
        return np.asarray(down & (block.needle[inside] == 1), dtype=np.float64)

    def _after(
        self, angle: float, speed: FloatArray, later: FloatArray, block: StitchBlock, ends: IntArray
    ) -> FloatArray:
        """Return (turns,) ticks from the beginning of each turn to an angle after its window."""
        rest = ends - block.begin - block.window
        rate = (later - speed) / rest
        left = angle - self._window
        # The numerically stable root of left = speed t + rate t^2 / 2.
        root = np.sqrt(np.maximum(speed * speed + 2.0 * rate * left, 0.0))
        return np.asarray(block.window + 2.0 * left / (speed + root))


_REST_S = Fraction(2)
AT_ONCE = 1 << 16
"""Largest number of samples in a block: a turn may last a thousand periods of the drives' clock."""


def simulate_stitching(commands: StepPlay, machine: Machine) -> Recording:
    """Simulate ``machine`` playing ``commands`` once; the simulation runs while it is read.

    Channels, on the clock of the drives: per axis ``X.commanded`` (the steps so far), ``X.load``
    and ``X.torque_share`` (needed force divided by the force of the drive); ``needle``, which is 1
    while it is in the cloth; ``operation``. Two seconds of rest follow the last turn.

    Raises
    ------
    MachineError
        If an axis is not moved by a pulse servo, a part is not linear, or a sample is not a whole
        number of periods of the timer.
    RecordingError
        If the commands are not for this machine.
    """
    if commands.machine_sha256 != machine.sha256:
        raise RecordingError(
            "the step tables were made for another machine file", remedy="Compile them again."
        )
    driven = driven_of(machine)
    return Recording(
        channels=tuple(stitching_channels(machine)),
        blocks=Stream(_read, commands, machine, driven),
        simulated=True,
        machine_sha256=machine.sha256,
        job_sha256=commands.job_sha256,
    )


def stitching_channels(machine: Machine) -> Iterator[Channel]:
    """Yield the channels of a recording."""
    clock = machine.tick_clock
    for name, axis in machine.axes.items():
        unit = "m" if axis.kind == "linear" else "rad"
        for ending, kind, own in (
            ("commanded", ChannelKind.COMMANDED, unit),
            ("load", ChannelKind.LOAD, unit),
            ("torque_share", ChannelKind.TORQUE_SHARE, ""),
        ):
            yield Channel(name=f"{name}.{ending}", kind=kind, unit=own, clock=clock, axis=name)
    yield Channel(name="needle", kind=ChannelKind.OUTPUT, unit="", clock=clock)
    yield Channel(name="operation", kind=ChannelKind.OPERATION, unit="", clock=clock)


def ticks_of_sample(commands: StepPlay, machine: Machine) -> int:
    """Return the period of the samples as a number of timer periods.

    Raises
    ------
    MachineError
        If the ratio is not a whole number.
    """
    ratio = machine.tick_clock.period_s / commands.clock.period_s
    if ratio.denominator != 1:
        raise MachineError(
            f"a sample of {machine.tick_clock.name!r} is {float(ratio):g} periods of the timer "
            f"{commands.clock.name!r}, which is no whole number",
            place=machine.place,
            remedy="Choose a clock of the drives that is a multiple of the timer.",
        )
    return int(ratio)


def _read(commands: StepPlay, machine: Machine, driven: Driven) -> Iterator[RecordingBlock]:
    """Yield the blocks of one run; the last one includes the rest at the end."""
    every = ticks_of_sample(commands, machine)
    library = Library.of(commands)
    played = Played.at_rest(driven.step.shape[0], len(commands.axes))
    needles = Needles(machine, commands)
    first, operation = 0, 0
    for block, after in _with_next(commands):
        # A sample at the beginning of the next block belongs to that block.
        end = commands.duration_ticks if after is None else int(after.begin[0])
        rest = ceil(_REST_S / machine.tick_clock.period_s) if after is None else 0
        until = -(-end // every) + rest
        played.turn[:], played.at[:] = 0, 0
        events = [*_at_samples(block, commands, every)]
        while True:
            count = min(until - first, AT_ONCE)
            states, steps = play(driven, library, played, block, commands, (first, count, every))
            ticks = every * np.arange(first, first + count, dtype=np.int64)
            turn = np.searchsorted(block.begin, ticks, side="right") - 1
            samples = frame_samples(commands, driven, states, steps)
            samples["needle"] = needles.down(block, after, ticks)
            under_way = np.where(turn >= 0, block.operation[np.maximum(turn, 0)], operation)
            samples["operation"] = under_way.astype(np.float64)
            begun, first = first, first + count
            due = [e for e in events if e.tick < first or first == until]
            events = [e for e in events if e.tick >= first and first < until]
            yield RecordingBlock(
                first_tick={machine.tick_clock.name: begun}, samples=samples, events=tuple(due)
            )
            if first == until:
                break
        operation = int(block.operation[-1])


def frame_samples(
    commands: StepPlay, driven: Driven, states: FloatArray, steps: FloatArray
) -> dict[str, FloatArray]:
    """Return the samples of the axes from (n, m) states and (n, A) steps so far.

    Sums are made in the order of the states, so they do not depend on the number of samples.
    """
    start = commands.start_steps / commands.steps_per_unit
    forces, loads = in_order(states, driven.forces), in_order(states, driven.loads)
    samples: dict[str, FloatArray] = {}
    for k, name in enumerate(commands.axes):
        force = forces[:, k] + driven.commanded[k] * (steps[:, k] * driven.scale[k])
        samples[f"{name}.commanded"] = start[k] + steps[:, k] / commands.steps_per_unit[k]
        samples[f"{name}.load"] = start[k] + loads[:, k]
        samples[f"{name}.torque_share"] = np.abs(force) / driven.limit[k]
    return samples


def _with_next(commands: StepPlay) -> Iterator[tuple[StitchBlock, StitchBlock | None]]:
    before: StitchBlock | None = None
    for block in commands:
        if before is not None:
            yield before, block
        before = block
    if before is not None:
        yield before, None


def _at_samples(block: StitchBlock, commands: StepPlay, every: int) -> Iterator[Event]:
    """Yield the events of a block, with their ticks counted in samples of the recording."""
    for event in block.events:
        turn = event.tick - block.first_stitch
        tick = commands.duration_ticks if turn >= len(block) else int(block.begin[turn])
        yield Event(tick=tick // every, kind=event.kind, operation=event.operation, name=event.name)


COLUMNS = ("begin", "window", "table", "sign", "start", "needle", "operation")
"""Names of the arrays in a ``StitchBlock``, in their order."""


class StitchingSession:
    """One simulated embroidery frame that receives its turns in pieces.

    The samples are the same as from ``simulate_stitching``, to the bit, however the turns are
    divided into pieces, if each turn arrives before it begins, with the beginning of the next.

    Parameters
    ----------
    machine
        The simulated machine; it starts at rest.
    head
        Commands that give clock, step tables and start; their blocks are not read.

    Attributes
    ----------
    channels
        The channels of the blocks that are returned.
    tick
        Number of samples so far.
    taken
        Number of turns taken so far.

    Raises
    ------
    MachineError
        If an axis is not moved by a pulse servo, a part is not linear, or a sample is not a whole
        number of periods of the timer.
    """

    def __init__(self, machine: Machine, head: StepPlay) -> None:
        self._machine, self._head = machine, head
        self._every = ticks_of_sample(head, machine)
        self._driven, self._library = driven_of(machine), Library.of(head)
        self.channels = tuple(stitching_channels(machine))
        self._played = Played.at_rest(self._driven.step.shape[0], len(head.axes))
        axes = len(head.axes)
        self._turns: dict[str, Any] = {
            name: np.zeros((0, axes) if name in ("table", "sign") else 0, dtype=np.int64)
            for name in COLUMNS
        }
        self._following = (1, 1)  # begin and window of the turn after the last one taken
        self.tick = self.taken = 0
        self._under_way = 0
        self._events: list[Event] = []
        self._pending_events: list[Event] = []

    @property
    def steps(self) -> FloatArray:
        """(A,) steps since the beginning."""
        return self._played.steps

    @property
    def rests_at(self) -> int:
        """Sample at which the commanded motion ends, unless more turns are taken."""
        if not len(self._turns["begin"]):
            return 0
        return -(-int(self._turns["begin"][-1] + self._turns["window"][-1]) // self._every)

    def take(self, turns: StitchBlock, following: tuple[int, int] | None) -> None:
        """Take the next turns.

        Parameters
        ----------
        turns
            The turns; the ticks of their events are counted in samples.
        following
            Begin and window of the turn after them, to which the shaft changes its speed; None if
            the shaft keeps its speed.

        Raises
        ------
        OptionError
            If the first turn should have begun already, or begins in the window of the previous
            one.
        """
        begins = self._turns["begin"]
        free = int(begins[-1] + self._turns["window"][-1]) if len(begins) else 0
        if len(turns) and int(turns.begin[0]) < max(free, self.tick * self._every):
            raise OptionError(f"a turn that begins at {int(turns.begin[0])} comes too late")
        # A turn is past when all its steps have been played and another turn has begun.
        now = self.tick * self._every
        past = max(int(np.searchsorted(begins, now, side="right")) - 1, 0)
        past = min(past, int(self._played.turn.min()))
        for name in COLUMNS:
            kept = self._turns[name][past:]
            self._turns[name] = np.concatenate((kept, getattr(turns, name)))
        self._played.turn[:] -= past
        self.taken += len(turns)
        if following is None:
            if len(self._turns["begin"]):
                end = self._turns["begin"][-1] + self._of_turn(int(self._turns["window"][-1]))
                self._following = (int(end), int(self._turns["window"][-1]))
        else:
            self._following = following
        self._events += turns.events

    def _of_turn(self, window: int) -> int:
        """Return the timer counts of a whole turn whose window takes ``window`` of them."""
        return window * self._head.steps_per_turn // self._head.window_angle

    def drop_from(self, tick: int) -> None:
        """Drop the turns that begin at sample ``tick`` or later."""
        kept = int(np.searchsorted(self._turns["begin"], tick * self._every))
        gone = len(self._turns["begin"]) - kept
        if gone:
            begin, window = (int(self._turns[name][kept]) for name in ("begin", "window"))
            self._following = (begin, window)
            for name in COLUMNS:
                self._turns[name] = self._turns[name][:kept]
            self.taken -= gone
        self._events = [event for event in self._events if event.tick < tick]

    def finish(self, ended: RunEnd, text: str) -> None:
        """Record how the run ended."""
        self._pending_events.append(
            Event(tick=self.tick, kind=ended.value, operation=self._under_way, name=text)
        )

    def advance(self, samples: int) -> RecordingBlock:
        """Simulate the next ``samples`` samples, and return them with the events."""
        first, head = self.tick, self._head
        block = StitchBlock(first_stitch=0, **self._turns)
        states, steps = play(
            self._driven, self._library, self._played, block, head, (first, samples, self._every)
        )
        ticks = self._every * np.arange(first, first + samples, dtype=np.int64)
        needles = Needles(self._machine, replace(head, duration_ticks=self._following[0]))
        samples_of = frame_samples(head, self._driven, states, steps)
        samples_of["needle"] = np.zeros(samples)
        under_way = np.full(samples, self._under_way)
        if len(block):
            begin, window = (np.array([value]) for value in self._following)
            after = StitchBlock(
                first_stitch=0,
                begin=begin,
                window=window,
                **{name: self._turns[name][-1:] for name in COLUMNS[2:]},
            )
            samples_of["needle"] = needles.down(block, after, ticks)
            turn = np.searchsorted(block.begin, ticks, side="right") - 1
            under_way = np.where(turn >= 0, block.operation[np.maximum(turn, 0)], self._under_way)
        samples_of["operation"] = under_way.astype(np.float64)
        self.tick += samples
        if samples:
            self._under_way = int(under_way[-1])
        due = [event for event in self._events if event.tick < self.tick]
        self._events = [event for event in self._events if event.tick >= self.tick]
        events, self._pending_events = (*due, *self._pending_events), []
        return RecordingBlock(
            first_tick={self.channels[0].clock.name: first}, samples=samples_of, events=events
        )
