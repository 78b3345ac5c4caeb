"""Warnings on standard error, said the same way by every command."""

from __future__ import annotations

from collections.abc import Iterable

from threadline.cli.told import warning
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.plant.suspicions import suspicions


def warn(machine: Machine, job: Job, more: Iterable[str] = ()) -> None:
    """Tell what is suspicious about ``machine`` and ``job``, and ``more``."""
    tell([*suspicions(machine), *job.warnings, *more])


def tell(warnings: Iterable[str]) -> None:
    """Tell warnings once the command has answered."""
    for said in warnings:
        warning(said)
