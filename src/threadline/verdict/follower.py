"""One channel at the instants of another that has another clock or another stride."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import RecordingError
from threadline.signals import Channel, RecordingBlock

MOST_WAITING = 1 << 16
"""Samples that wait for a channel that is behind; what comes later than that is refused."""
_ROUNDING = 1e-9  # of a sample: instants of two clocks that should be one may differ by a rounding


def sample_interval_s(channel: Channel) -> float:
    """Return the time between two samples of a channel."""
    period_s = channel.clock.period_s
    # The quotient of two whole numbers is correctly rounded, and no fraction is shortened.
    return period_s.numerator * channel.stride / period_s.denominator


class Follower:
    """One channel at the instants of another: its own samples, or the last one until the next.

    Of a finer channel that is ``largest`` it is the sample of largest magnitude since the instant
    before: between two instants nothing of it is lost.

    Parameters
    ----------
    channel, master
        The channel whose samples are read, and the channel at whose instants.

    Attributes
    ----------
    same
        Whether both have the same instants, so that samples are taken block by block.
    """

    def __init__(self, channel: Channel, master: Channel, *, largest: bool = False) -> None:
        self._channel, self._master = channel, master
        self.same = channel.clock == master.clock and channel.stride == master.stride
        self._slack_s = _ROUNDING * sample_interval_s(master)
        self._largest, self._fresh = largest, 0
        self._time_s: FloatArray = np.empty(0)  # of samples that may still be needed
        self._values: FloatArray = np.empty(0)
        self._due_s = -np.inf  # when the next sample is due
        self._asked_s = -np.inf  # the last instant at which it was asked for

    def values(self, block: RecordingBlock, count: int) -> FloatArray:
        """Return (count, ...) samples of a block, where it has the same instants."""
        values = self._checked(block)
        # What is missing of it in this block is no number; whoever needs it is told so.
        lacking = max(count - len(values), 0)
        known = values[:count]
        return known if not lacking else np.concatenate([known, np.full(lacking, np.nan)])

    def _checked(self, block: RecordingBlock) -> FloatArray:
        values = block.samples[self._channel.name]
        if values.ndim == 1 and not np.isfinite(values).all():
            first = block.first_tick[self._channel.clock.name]
            raise RecordingError(
                f"channel {self._channel.name!r} holds a value that is not finite near "
                f"{self._channel.clock.time_s(first):.6g} s",
                remedy="Repair the trace, or leave the channel out.",
            )
        return values

    def take(self, block: RecordingBlock) -> None:
        """Keep the channel's samples in a block until they are asked for.

        Raises
        ------
        RecordingError
            If they come after their instants were taken for missing.
        """
        values = self._checked(block)
        if not len(values):
            return
        channel = self._channel
        first = block.first_tick[channel.clock.name]
        times = channel.clock.times_s(first, len(values), channel.stride)
        if times[0] <= self._asked_s + self._slack_s:
            raise RecordingError(
                f"channel {channel.name!r} comes with {times[0]:.6g} s when "
                f"{self._master.name!r} is at {self._asked_s:.6g} s, more than {MOST_WAITING} "
                "samples later",
                remedy="Record the channels of one instant in blocks that follow each other.",
            )
        self._time_s = np.concatenate([self._time_s, times])
        self._values = np.concatenate([self._values, values])
        self._due_s = float(times[-1]) + sample_interval_s(channel)

    def known(self, time_s: FloatArray) -> int:
        """Return at how many of some instants no sample can change its value any more."""
        return int(np.searchsorted(time_s, self._due_s - self._slack_s))

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the channel's values at instants later than those asked for before."""
        if not len(time_s):
            return np.empty(0)
        self._asked_s = float(time_s[-1])
        times, values = self._time_s, self._values
        if not len(times):
            return np.full(len(time_s), np.nan)
        held = np.maximum(np.searchsorted(times, time_s + self._slack_s, side="right") - 1, 0)
        keep = int(held[-1])
        self._time_s, self._values = times[keep:], values[keep:]
        if not self._largest:
            return np.asarray(values[held])
        # The first value that was kept belongs to the instant before: it counted there already.
        begin = np.minimum(np.concatenate([[self._fresh], held[:-1] + 1]), held)
        self._fresh = 1
        # ``reduceat`` takes stretches from each place to the next: every other one is wanted.
        pairs = np.column_stack([begin, held + 1]).ravel()
        sizes = np.append(np.abs(values[: keep + 1]), 0.0)
        return np.asarray(np.maximum.reduceat(sizes, pairs)[::2])
