"""A simulated embroidery frame that takes the turns of its shaft piece by piece."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.signals import Ended, Event, RecordingBlock, StepPlay, StitchBlock
from threadline.twin.stitching import frame_samples, stitching_channels, ticks_of_sample
from threadline.twin.stitching_machine import driven_of
from threadline.twin.stitching_run import Library, Played, play
from threadline.twin.stitching_shaft import Needles

COLUMNS = ("begin", "window", "table", "sign", "start", "needle", "operation")
"""Columns of turns, in the order of ``StitchBlock``."""


class StitchingSession:
    """One embroidery frame under turns that arrive piece by piece.

    The same turns in pieces of any length give the same samples as ``simulate_stitching``, to the
    bit, as long as each comes before it begins, together with the beginning of the one behind it.

    Parameters
    ----------
    machine
        What is driven; it starts at rest.
    head
        Clock, tables and start of the commands; its blocks are not read.

    Attributes
    ----------
    channels
        The channels of the blocks that are returned.
    tick
        Samples so far.
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
        self._following = (1, 1)  # begin and window of the turn behind the last one taken
        self.tick = self.taken = 0
        self._under_way = 0
        self._events: list[Event] = []
        self._told: list[Event] = []

    @property
    def steps(self) -> FloatArray:
        """(A,) steps given since the beginning."""
        return self._played.steps

    @property
    def rests_at(self) -> int:
        """Sample from which on nothing is commanded, unless more turns come."""
        if not len(self._turns["begin"]):
            return 0
        return -(-int(self._turns["begin"][-1] + self._turns["window"][-1]) // self._every)

    def take(self, turns: StitchBlock, following: tuple[int, int] | None) -> None:
        """Take up the next turns.

        Parameters
        ----------
        turns
            Their events carry samples.
        following
            Begin and window of the turn behind them, by which the shaft changes its speed; None
            where the shaft keeps it.

        Raises
        ------
        OptionError
            If the first of them has begun already, or lies in the window of the one before.
        """
        begins = self._turns["begin"]
        free = int(begins[-1] + self._turns["window"][-1]) if len(begins) else 0
        if len(turns) and int(turns.begin[0]) < max(free, self.tick * self._every):
            raise OptionError(f"a turn that begins at {int(turns.begin[0])} comes too late")
        # Turns whose steps have all been given, and behind which another has begun, are past.
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
        """Forget the turns that begin at a sample, or later."""
        kept = int(np.searchsorted(self._turns["begin"], tick * self._every))
        gone = len(self._turns["begin"]) - kept
        if gone:
            begin, window = (int(self._turns[name][kept]) for name in ("begin", "window"))
            self._following = (begin, window)
            for name in COLUMNS:
                self._turns[name] = self._turns[name][:kept]
            self.taken -= gone
        self._events = [event for event in self._events if event.tick < tick]

    def finish(self, ended: Ended, text: str) -> None:
        """Tell how the run ended."""
        self._told.append(
            Event(tick=self.tick, kind=ended.value, operation=self._under_way, name=text)
        )

    def advance(self, samples: int) -> RecordingBlock:
        """Simulate the next ``samples`` samples, and return what happened."""
        first, head = self.tick, self._head
        block = StitchBlock(first_stitch=0, **self._turns)
        states, steps = play(
            self._driven, self._library, self._played, block, head, (first, samples, self._every)
        )
        ticks = self._every * np.arange(first, first + samples, dtype=np.int64)
        needles = Needles(self._machine, replace(head, duration_ticks=self._following[0]))
        told = frame_samples(head, self._driven, states, steps)
        told["needle"] = np.zeros(samples)
        under_way = np.full(samples, self._under_way)
        if len(block):
            begin, window = (np.array([value]) for value in self._following)
            after = StitchBlock(
                first_stitch=0,
                begin=begin,
                window=window,
                **{name: self._turns[name][-1:] for name in COLUMNS[2:]},
            )
            told["needle"] = needles.down(block, after, ticks)
            turn = np.searchsorted(block.begin, ticks, side="right") - 1
            under_way = np.where(turn >= 0, block.operation[np.maximum(turn, 0)], self._under_way)
        told["operation"] = under_way.astype(np.float64)
        self.tick += samples
        if samples:
            self._under_way = int(under_way[-1])
        due = [event for event in self._events if event.tick < self.tick]
        self._events = [event for event in self._events if event.tick >= self.tick]
        events, self._told = (*due, *self._told), []
        return RecordingBlock(
            first_tick={self.channels[0].clock.name: first}, samples=told, events=events
        )
