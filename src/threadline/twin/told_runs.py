"""Machines that are told positions, side by side under the same rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from threadline.arrays import FloatArray
from threadline.machine import Machine
from threadline.signals import (
    ChannelKind,
    Ended,
    Event,
    Recording,
    RecordingBlock,
    Stream,
    TickBlock,
    TickTable,
)
from threadline.twin.channels import run_phases
from threadline.twin.prescribed import Advance, advances_of
from threadline.twin.simulate import DEFAULT_SETTLE_S, RunOptions, check_commands, run_over
from threadline.twin.told_session import ToldSession, told_channels

_SHARED = (ChannelKind.COMMANDED, ChannelKind.OPERATION)
"""Channels that all runs have in common."""


def simulate_told_runs(
    commands: TickTable, machines: Sequence[Machine], *, encoder_phase: FloatArray
) -> Recording | None:
    """Simulate machines that are told positions side by side, to the bit as ``simulate`` does each.

    Parameters
    ----------
    machines
        Of the same parts, with numbers of their own.
    encoder_phase
        (machines, axes) where in a full step each stepper stands at the start.

    Returns
    -------
    Recording or None
        One of as many runs as machines; None where a belt of one may fall slack, which ends its
        run before the others.
    """
    machine = machines[0]
    advances = tuple(advances_of(one) for one in machines)
    if any(advance.piece.belts for own in advances for advance in own):
        return None
    check_commands(commands, machine, 1, DEFAULT_SETTLE_S)
    options = RunOptions(
        phases=run_phases(machine, encoder_phase, len(machines)),
        record_every=1,
        settle_s=DEFAULT_SETTLE_S,
        quantised=True,
        answers=None,
    )
    return Recording(
        channels=told_channels(machine, 1),
        blocks=Stream(_told_runs_blocks, advances, tuple(machines), commands, options),
        job_sha256=commands.job_sha256,
        machine_sha256=machine.sha256,
        simulated=True,
        runs=len(machines),
    )


def _told_runs_blocks(
    advances: tuple[tuple[Advance, ...], ...],
    machines: tuple[Machine, ...],
    commands: TickTable,
    options: RunOptions,
) -> Iterator[RecordingBlock]:
    """Run sessions of all machines over the commands and their settling."""
    sessions = [
        ToldSession(machine, start_counts=commands.start_counts, phases=phase, advances=own)
        for own, machine, phase in zip(advances, machines, options.phases, strict=True)
    ]
    yield from run_over(ToldRuns(sessions), commands, options)


class ToldRuns:
    """Sessions of machines that differ in their numbers, under the same rows, as one recording.

    Nothing in them may fail, so that all of them have as many samples.

    Parameters
    ----------
    sessions
        At least one.
    """

    failed = False  # none of them can

    def __init__(self, sessions: Sequence[ToldSession]) -> None:
        self._sessions = tuple(sessions)

    @property
    def halted(self) -> Event | None:
        """The stop or wait at which the rows stand."""
        return self._sessions[0].halted

    def resume(self) -> None:
        """Go on with the rows after a stop, in every run."""
        for session in self._sessions:
            session.resume()

    def finish(self, ended: Ended = Ended.COMPLETED, text: str = "") -> None:
        """Say that no more rows come."""
        for session in self._sessions:
            session.finish(ended, text)

    def advance(self, rows: TickBlock | None = None, *, ticks: int | None = None) -> RecordingBlock:
        """Take up rows and go on, as ``RowSession.advance``; the runs side by side."""
        blocks = [session.advance(rows, ticks=ticks) for session in self._sessions]
        own = [c.name for c in self._sessions[0].channels if c.kind not in _SHARED]
        samples = dict(blocks[0].samples)
        # The runs of one axis at one instant side by side, the axes of one kind beside them.
        for ending in dict.fromkeys(name.rpartition(".")[2] for name in own):
            names = [name for name in own if name.rpartition(".")[2] == ending]
            whole = np.empty((len(samples[names[0]]), len(names), len(blocks)))
            for column, name in enumerate(names):
                for run, block in enumerate(blocks):
                    whole[:, column, run] = block.samples[name]
                samples[name] = whole[:, column]
        return replace(blocks[0], samples=samples)
