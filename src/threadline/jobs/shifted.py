"""A job at another place on the machine: the same shift applies to all its positions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from threadline.errors import OptionError, UnitError
from threadline.files import Stream
from threadline.jobs.operations import Job, Move, MoveRun, Operation, OperationStream
from threadline.machine import Machine
from threadline.units import parse_quantity

Offset = tuple[float, ...]


def parse_offset(text: str, machine: Machine) -> Offset:
    """Return the (axes,) shift in m and rad from a text like ``"X=12.5 mm, A=-30 deg"``.

    Raises
    ------
    OptionError
        If the text cannot be read, or names an unknown axis.
    """
    shifts = dict.fromkeys(machine.axes, 0.0)
    for part in text.split(","):
        name, _, quantity = (piece.strip() for piece in part.partition("="))
        axis = machine.axes.get(name)
        if axis is None:
            raise OptionError(
                f"offset {part.strip()[:40]!r} names no axis of {machine.name}",
                remedy=f'Write it like "X=12.5 mm"; there are {", ".join(machine.axes) or "none"}.',
            )
        try:
            unit = "m" if axis.kind == "linear" else "rad"
            shifts[name] = parse_quantity(quantity, unit)
        except UnitError as error:
            raise OptionError(
                f"offset {part.strip()[:40]!r}: {error.message}",
                remedy='Write it like "X=12.5 mm, A=-30 deg".',
            ) from error
    return tuple(shifts.values())


def shifted(job: Job, machine: Machine, text: str | None) -> Job:
    """Return ``job`` with its start and all positions shifted, or unchanged without a text.

    Raises
    ------
    OptionError
        If the text cannot be read, the job has its own place (a seam's ``origin``), or the machine
        has a mandrel whose radius depends on the place.
    """
    if text is None:
        return job
    offset = parse_offset(text, machine)
    if job.drawn or job.paced_by != "feed":
        raise OptionError(
            f"offset {text[:40]!r}: {job.name} is no part program",
            remedy="The place of a seam is origin, in its file.",
        )
    if any(axis.profile is not None for axis in machine.axes.values()):
        raise OptionError(
            f"offset {text[:40]!r}: the mandrel has a radius for each place, which would stay",
            remedy="Change the places of its radii, and give no offset.",
        )
    runs = Stream(_runs, job, offset)
    folded = Stream(_folded, job, offset)
    start = tuple(np.add(job.start, offset).tolist())
    return replace(job, start=start, operations=OperationStream(runs, folded))


def _runs(job: Job, offset: Offset) -> Iterator[Operation | MoveRun]:
    return (_shifted_item(item, offset) for item in job.runs())


def _folded(job: Job, offset: Offset) -> Iterator[tuple[Operation | MoveRun, int, int]]:
    return ((_shifted_item(item, offset), times, line) for item, times, line in job.folded())


def _shifted_item(item: Operation | MoveRun, offset: Offset) -> Operation | MoveRun:
    if isinstance(item, MoveRun):
        return replace(item, targets=item.targets + np.array(offset))
    if isinstance(item, Move):
        return replace(item, target=tuple(np.add(item.target, offset).tolist()))
    return item
