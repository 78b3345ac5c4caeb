"""Warnings of every command: about its machine, its job, and its options."""

from __future__ import annotations

from collections.abc import Iterable

from threadline.cli.messages import warning
from threadline.dynamics.suspicions import suspicions
from threadline.jobs.operations import Job
from threadline.machine import Machine


def warn(machine: Machine, job: Job, more: Iterable[str] = (), *, own_feed: bool) -> None:
    """Warn of suspicious values of ``machine`` and ``job``, and print the warnings in ``more``.

    ``own_feed``: the job runs at its own feeds, which are then checked too.
    """
    tell([*suspicions(machine), *job.suspicions(own_feed=own_feed), *more])


def tell(warnings: Iterable[str]) -> None:
    """Print warnings once the command has answered."""
    for said in warnings:
        warning(said)
