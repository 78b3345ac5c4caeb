"""How far the runs of a proof are: told while they are read, one by one or in step."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from threadline.plan import Plan
from threadline.signals import Recording, RecordingBlock

_LONG_S = 1.0  # of simulating, after which progress is reported
_DOING = "simulating and judging"
WRITING = "simulating and writing the recording"


class Share:
    """The share of all runs that has been read.

    Parameters
    ----------
    plan
        Its duration, which may cost a reading of the whole trajectory, is asked for only after a
        second.
    progress
        Is told what is done, and the share of it; None to tell nobody.
    runs
        How many runs there are.
    doing
        What is done with them, in words.
    """

    def __init__(
        self,
        plan: Plan,
        progress: Callable[[str, float], None] | None,
        runs: int,
        doing: str = _DOING,
    ) -> None:
        self._plan, self._progress, self._doing = plan, progress, doing
        self._done = [0.0] * runs
        self._began = time.monotonic()

    def of(self, recordings: Sequence[Recording], before: int = 0) -> Sequence[Recording]:
        """Return recordings that tell how far they are; ``before`` runs come before them."""
        if self._progress is None:
            return recordings
        return [
            replace(one, blocks=_Watched(one.blocks, self, number))
            for number, one in enumerate(recordings, start=before)
        ]

    def tell(self, number: int, block: RecordingBlock | None) -> None:
        """Note that a run was read up to a block, or to its end."""
        assert self._progress is not None
        if block is None:
            self._done[number] = 1.0
        if time.monotonic() - self._began <= _LONG_S:
            return
        if block is not None:
            clock = self._plan.commands.clock
            done_s = clock.time_s(block.first_tick.get(clock.name, 0))
            self._done[number] = min(done_s / max(self._plan.duration_s, 1e-9), 1.0)
        self._progress(self._doing, sum(self._done) / len(self._done))


@dataclass(frozen=True, slots=True, eq=False)
class _Watched:
    """The blocks of a recording. It is no ``Stream``: a callback cannot go to another process."""

    blocks: Iterable[RecordingBlock]
    share: Share
    number: int

    def __iter__(self) -> Iterator[RecordingBlock]:
        for block in self.blocks:
            yield block
            self.share.tell(self.number, block)
        self.share.tell(self.number, None)
