"""What deserves a second look before a plan is relied on, said the same way by every command."""

from __future__ import annotations

from collections.abc import Iterable

from threadline.cli.told import warning
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.plant.suspicions import suspicions


def warn(machine: Machine, job: Job, more: Iterable[str] = ()) -> None:
    """Print what is suspicious about ``machine`` and ``job``, and ``more``, on standard error."""
    for said in [*suspicions(machine), *job.warnings, *more]:
        warning(said)
