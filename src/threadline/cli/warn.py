"""Warnings of every command: of its machine, its job, and more."""

from __future__ import annotations

from collections.abc import Iterable

from threadline.cli.told import warning
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.plant.suspicions import suspicions


def warn(machine: Machine, job: Job, more: Iterable[str] = ()) -> None:
    """Warn of suspicious values of ``machine`` and ``job``, and of ``more``."""
    tell([*suspicions(machine), *job.warnings, *more])


def tell(warnings: Iterable[str]) -> None:
    """Tell warnings once the command has answered."""
    for said in warnings:
        warning(said)
