"""Who keeps what a run tells, and the one who keeps it in memory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from threadline.live.states import Cause, State
from threadline.plan import Plan
from threadline.signals import Channel, Recording, RecordingBlock, Stream


class Sink(Protocol):
    """Who keeps what happens."""

    def begin(self, channels: tuple[Channel, ...], simulated: bool) -> None:
        """Keep the description of what follows."""

    def block(self, block: RecordingBlock) -> None:
        """Keep samples, and the events among them."""

    def state(self, tick: int, state: State, cause: Cause, text: str) -> None:
        """Keep that the executor went to a state."""


class Kept:
    """A sink of an executor that keeps everything in memory.

    Attributes
    ----------
    blocks
        Samples and events.
    log
        Each change of state: tick, state, cause, text.
    """

    def __init__(self) -> None:
        self._channels: tuple[Channel, ...] = ()
        self._simulated = True
        self.blocks: list[RecordingBlock] = []
        self.log: list[tuple[int, State, Cause, str]] = []

    def begin(self, channels: tuple[Channel, ...], simulated: bool) -> None:
        """Keep the description of what follows."""
        self._channels, self._simulated = channels, simulated

    def block(self, block: RecordingBlock) -> None:
        """Keep samples, and the events among them."""
        self.blocks.append(block)

    def state(self, tick: int, state: State, cause: Cause, text: str) -> None:
        """Keep that the executor went to a state."""
        self.log.append((tick, state, cause, text))

    def recording(self, plan: Plan, told: Mapping[str, str] | None = None) -> Recording:
        """Return what was recorded of a plan; ``told`` is said of it besides its options."""
        return Recording(
            channels=self._channels,
            blocks=Stream.of(self.blocks),
            job_sha256=plan.job.sha256,
            machine_sha256=plan.machine.sha256,
            simulated=self._simulated,
            origin={**plan.options, **(told or {})},
        )
