"""Which instants of each channel a recording really holds: gaps, a late beginning, an early end."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from threadline.errors import RecordingError
from threadline.signals import Channel, Recording, RecordingBlock, Stream

_ROUNDING = 1e-9  # of a sample


@dataclass(slots=True)
class _Seen:
    """Ticks of a channel: of its first sample, after its last one, and about its first gap."""

    first: int
    end: int
    gap: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class Lack:
    """What is missing of a channel.

    ``why`` says it for people. ``early`` is whether only the end is missing: what came before it
    was seen without a gap.
    """

    why: str
    early: bool


class Coverage:
    """Watches the blocks of a recording as they are read; nothing of them is kept.

    Parameters
    ----------
    recording
        The recording; what is to be judged is ``watched``.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._seen: dict[str, _Seen] = {}
        self._lacks: dict[tuple[tuple[str, ...], float, float], Lack | None] = {}
        self.watched: Recording = replace(recording, blocks=Stream(self._blocks))

    def _blocks(self) -> Iterator[RecordingBlock]:
        self._seen, self._lacks = {}, {}
        for block in self._recording:
            for channel in self._recording.channels:
                count = len(block.samples[channel.name])
                if count:
                    self._take(channel, block.first_tick[channel.clock.name], count)
            yield block

    def _take(self, channel: Channel, first: int, count: int) -> None:
        seen = self._seen.get(channel.name)
        end = first + channel.stride * count
        if seen is None:
            if first < 0:
                raise RecordingError(
                    f"channel {channel.name!r} begins at {_s(channel, first)}, before the commands",
                    remedy="Time 0 is the first tick of the job; leave out what comes before it.",
                )
            self._seen[channel.name] = _Seen(first, end)
            return
        if first < seen.end:
            last = _s(channel, seen.end - channel.stride)
            raise RecordingError(
                f"a block of channel {channel.name!r} begins at {_s(channel, first)}, and the "
                f"blocks before it go on until {last}",
                remedy="Blocks follow each other in time and do not overlap; record it again.",
            )
        if first > seen.end and seen.gap is None:
            seen.gap = (seen.end, first)
        seen.end = end

    def lack(self, channels: Iterable[Channel], begin_s: float, end_s: float) -> Lack | None:
        """Return what is missing of the channels between two instants; None where nothing is.

        A gap anywhere counts. So does a whole sample missing at the beginning or at the end, even
        if only because another of the channels goes on longer. If several channels lack samples,
        the lack that leaves least of the run to be judged is returned. Call it after the recording
        has been read to its end.
        """
        channels = list(channels)
        asked = tuple(channel.name for channel in channels), begin_s, end_s
        if asked not in self._lacks:  # many measures read the same channels
            self._lacks[asked] = self._lack(channels, begin_s, end_s)
        return self._lacks[asked]

    def _lack(self, channels: Sequence[Channel], begin_s: float, end_s: float) -> Lack | None:
        found: list[Lack] = []
        last_s, longest = max(
            (
                (float(c.clock.time_s(seen.end - c.stride)), c.name)
                for c in channels
                if (seen := self._seen.get(c.name)) is not None
            ),
            default=(0.0, ""),
        )
        for channel in channels:
            seen = self._seen.get(channel.name)
            if seen is None:
                if any(channel is c for c in self._recording.channels):
                    found.append(Lack(f"{channel.name} has no samples", early=False))
                continue  # it was not recorded but worked out, for every instant
            period_s = float(channel.clock.period_s)
            slack_s = (1.0 + _ROUNDING) * period_s * channel.stride
            if seen.gap is not None:
                low, high = (_s(channel, tick) for tick in seen.gap)
                why = f"{channel.name} has no samples from {low} to {high}"
                found.append(Lack(why, early=False))
            elif seen.first * period_s > begin_s + slack_s:
                why = f"{channel.name} begins at {_s(channel, seen.first)}, the motion before"
                found.append(Lack(why, early=False))
            elif seen.end * period_s + _ROUNDING * slack_s < end_s:
                last = _s(channel, seen.end - channel.stride)
                why = f"{channel.name} ends at {last}, the motion at {end_s:.6g} s"
                found.append(Lack(why, early=True))
            elif seen.end * period_s <= last_s + _ROUNDING * slack_s:
                last = _s(channel, seen.end - channel.stride)
                why = f"{channel.name} ends at {last}, {longest} goes on until {last_s:.6g} s"
                found.append(Lack(why, early=True))
        return min(found, key=lambda lack: lack.early, default=None)


def _s(channel: Channel, tick: int) -> str:
    return f"{channel.clock.time_s(tick):.6g} s"
