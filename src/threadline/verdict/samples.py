"""What a measure is given: what it knows before the first sample, and the samples in blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.plan import Plan
from threadline.signals import Recording
from threadline.verdict.window import PathWindow


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """What a measure knows before the first sample.

    Parameters
    ----------
    plan, recording
        What was intended, and what is judged.
    axes, radius_m
        Of the programmed path: names, and (axes,) lengths at the tool per unit of the axis.
    interval_s
        Time between two samples.
    lag_samples
        How many samples the machine may trail its command.
    """

    plan: Plan
    recording: Recording
    axes: tuple[str, ...]
    radius_m: FloatArray
    interval_s: float
    lag_samples: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Block:
    """Consecutive samples, n of them, with every channel on the same instants.

    Parameters
    ----------
    first
        Number of the first sample since the start.
    time_s
        (n,) instants.
    commanded, actual, own, voltage, current, current_peak
        (n, axes) or None where a channel is absent: the command; the tool or the load; the axis'
        own encoder; the amplifier's input; the motor's current, and its largest since the sample
        before. A column of NaN marks an axis that lacks the channel while another has it.
    operation
        (n,) operation under way, never decreasing, or None.
    chord
        (n,) chord that the command is on, counted from the start of the path, or None.
    begin, end
        (n,) first and last chord that it was or will be on within the lag of each sample.
    path
        The programmed path about these operations, or None without an operation channel.
    torque_share
        (n, axes) or None: the torque asked of a drive over what it has, its largest since the
        sample before.
    """

    first: int
    time_s: FloatArray
    commanded: FloatArray | None
    actual: FloatArray | None
    own: FloatArray | None
    voltage: FloatArray | None
    current: FloatArray | None
    current_peak: FloatArray | None
    operation: IntArray | None
    chord: IntArray | None
    begin: IntArray | None
    end: IntArray | None
    path: PathWindow | None
    torque_share: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    def window(self) -> tuple[PathWindow, IntArray, IntArray]:
        """Return the path, and ``begin`` and ``end`` counted within what it holds."""
        assert self.path is not None and self.begin is not None and self.end is not None
        begin = np.maximum(self.begin - self.path.first, 1)
        return self.path, begin, np.maximum(self.end - self.path.first, begin)

    def operation_at(self, index: int) -> int | None:
        """Return the operation under way at a sample."""
        return None if self.operation is None else int(self.operation[index])

    def position_at(self, index: int) -> tuple[float, ...] | None:
        """Return the commanded position at a sample; None unless it is known of every axis."""
        if self.commanded is None or not np.isfinite(self.commanded[index]).all():
            return None
        return tuple(self.commanded[index].tolist())
