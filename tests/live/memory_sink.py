"""A sink that keeps what an executor reports."""

from __future__ import annotations

from collections.abc import Mapping

from threadline.commands.plan import Plan
from threadline.files import Channel, Recording, RecordingBlock, Stream
from threadline.live.states import Cause, State


class MemorySink:
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
        """Keep the channels."""
        self._channels, self._simulated = channels, simulated

    def block(self, block: RecordingBlock) -> None:
        """Keep a block."""
        self.blocks.append(block)

    def state(self, tick: int, state: State, cause: Cause, text: str) -> None:
        """Keep a change of state."""
        self.log.append((tick, state, cause, text))

    def recording(self, plan: Plan, origin: Mapping[str, str] | None = None) -> Recording:
        """Return the recording of a plan; its origin is the plan's options and ``origin``."""
        return Recording(
            channels=self._channels,
            blocks=Stream.of(self.blocks),
            job_sha256=plan.job.sha256,
            machine_sha256=plan.machine.sha256,
            simulated=self._simulated,
            origin={**plan.options, **(origin or {})},
        )
