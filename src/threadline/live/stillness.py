"""Whether the loops of a machine have come to rest, by what their encoders say."""

from __future__ import annotations

from collections.abc import Mapping

from threadline.arrays import FloatArray
from threadline.live.ahead import SETTLE_S, ticks_in
from threadline.machine import Machine

STILL_S = 0.1
"""Time in s of the machine for which every encoder has to stay within a count."""
_COUNTS = 1.5


class Stillness:
    """What the encoders of a machine have said lately; time is that of the machine.

    The slowest pole of the loops of ``lathe-winder``, that of Y, is 66 ms: once it moves by no more
    than a count in 100 ms, it is within 0.3 counts of where it comes to rest. A loop that rings on
    is waited for no longer than a run is recorded after its last row.
    """

    def __init__(self, machine: Machine) -> None:
        self._wait, self._most = ticks_in(STILL_S, machine), ticks_in(SETTLE_S, machine)
        self._room = {
            f"{name}.measured": _COUNTS / scale
            for name, scale in zip(machine.axes, machine.counts_per_unit, strict=True)
        }
        self._within: dict[str, tuple[float, float]] = {}  # each encoder, since it was restless
        self._since = 0  # tick from which on all of them were still

    def hear(self, tick: int, samples: Mapping[str, FloatArray]) -> None:
        """Take up a report.

        Parameters
        ----------
        tick
            Tick of the commands at its end.
        samples
            (n,) samples of each channel.
        """
        for name, room in self._room.items():
            told = samples.get(name)
            if told is None or not len(told):
                continue
            last = float(told[-1])
            low, high = self._within.get(name, (last, last))
            low, high = min(low, float(told.min())), max(high, float(told.max()))
            if high - low > room:
                low, high, self._since = last, last, tick
            self._within[name] = low, high

    def settled(self, tick: int, end: int) -> bool:
        """Return whether all is still at a tick, of a motion whose commands end at tick ``end``.

        Where there are no encoders, that is the end itself.
        """
        since = max(end, self._since)
        return not self._within or tick >= min(since + self._wait, end + self._most)
