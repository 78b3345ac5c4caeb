"""Warnings of every command: of its machine, its job, and more."""

from __future__ import annotations

from collections.abc import Iterable

from threadline.cli.messages import warning
from threadline.dynamics.suspicions import suspicions
from threadline.jobs.operations import Job
from threadline.machine import Machine


def warn(machine: Machine, job: Job, more: Iterable[str] = (), *, own_feed: bool) -> None:
    """Warn of suspicious values of ``machine`` and ``job``, and of ``more``.

    The feeds of the job itself matter with ``own_feed`` alone, where no other is asked for.
    """
    tell([*suspicions(machine), *job.suspicions(own_feed=own_feed), *more])


def tell(warnings: Iterable[str]) -> None:
    """Tell warnings once the command has answered."""
    for said in warnings:
        warning(said)
