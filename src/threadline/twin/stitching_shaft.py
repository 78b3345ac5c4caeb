"""When the needles are in the cloth: the angle of the shaft over time, turn by turn."""

from __future__ import annotations

from math import pi

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.machine import Machine
from threadline.signals import StepPlay, StitchBlock


class Needles:
    """The needles of a machine that plays ``commands``.

    The shaft has a constant speed in the window of the move. Over the rest of the turn the speed
    changes evenly to that of the next window.
    """

    def __init__(self, machine: Machine, commands: StepPlay) -> None:
        assert machine.shaft is not None
        self._end = commands.duration_ticks
        self._window = commands.window_angle / commands.steps_per_turn
        self._enters = machine.shaft.needle_enters.si / (2.0 * pi)
        self._leaves = machine.shaft.needle_leaves.si / (2.0 * pi)

    def down(self, block: StitchBlock, after: StitchBlock | None, ticks: IntArray) -> FloatArray:
        """Return (n,) 1 where the needle is in the cloth, at (n,) rising ticks within ``block``."""
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
        """Return (turns,) ticks from the beginning of each turn to an angle behind its window."""
        rest = ends - block.begin - block.window
        rate = (later - speed) / rest
        left = angle - self._window
        # The stable root of left = speed t + rate t^2 / 2.
        root = np.sqrt(np.maximum(speed * speed + 2.0 * rate * left, 0.0))
        return np.asarray(block.window + 2.0 * left / (speed + root))
