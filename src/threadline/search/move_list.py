"""A job of an on/off machine: with commands and waits of its own, and as a move list.

What is written reads back as the same job, to the last digit of every place and time.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace

from threadline.errors import OptionError
from threadline.jobs.moves import OVERLAP, REST
from threadline.jobs.operations import (
    Dwell,
    Job,
    Move,
    Operation,
    SetOutput,
    ToolEvent,
    WaitInput,
)
from threadline.machine import Machine
from threadline.signals import Stream
from threadline.units import parse_quantity

_LEAST_LEFT_M = 1e-4


def with_choices(job: Job, how: Mapping[int, tuple[str, str]], waits: Mapping[int, float]) -> Job:
    """Return ``job`` with commands and waits of its moves replaced; rests and overlaps are kept.

    Parameters
    ----------
    how
        By the number of a move's operation in ``job``: the key and text of its command in a move
        list, ``("shaper", "zv")`` or ``("levels", ...)``. Other moves get none.
    waits
        By the same numbers: s to wait before the move, as an operation of its own.
    """
    found: list[Operation] = []
    for index, operation in enumerate(job):
        if isinstance(operation, Move):
            if waits.get(index, 0.0) > 0.0:
                found.append(Dwell(waits[index], operation.source))
            tags = {k: v for k, v in operation.tags.items() if k in {REST, OVERLAP}}
            tags |= dict([how[index]]) if index in how else {}
            found.append(replace(operation, tags=tags))
        else:
            found.append(operation)
    return replace(job, operations=Stream.of(found), sha256="")


def overlapped(job: Job, machine: Machine) -> Job:
    """Return ``job`` with a shorter rest after moves that the next cylinder need not wait out.

    The rest after a move is cut if it moves one cylinder, the list then waits for an end switch
    that this cylinder closes, and the next move is that of another cylinder. What is left of the
    rest lasts until the piston passes the switch: a switch that is stuck on starts the other
    cylinder no sooner. The rest stays if a dwell or an output (a vacuum, a valve) comes before the
    next move, or if the move has ``overlap = false`` or a ``rest`` of its own.
    """
    operations = list(job)
    found: list[Operation] = []
    position = job.start
    for index, operation in enumerate(operations):
        kept = operation
        if isinstance(operation, Move):
            moved = _moved(job.axes, position, operation.target)
            if OVERLAP not in operation.tags and REST not in operation.tags and len(moved) == 1:
                rest_s = _least_rest_s(job, operations, index, position, moved[0], machine)
                if rest_s is not None:
                    kept = replace(operation, tags={**operation.tags, REST: rest_s})
            position = operation.target
        found.append(kept)
    return replace(job, operations=Stream.of(found), sha256="")


def _moved(
    axes: tuple[str, ...], begin: tuple[float, ...], end: tuple[float, ...]
) -> tuple[str, ...]:
    return tuple(axis for axis, a, b in zip(axes, begin, end, strict=True) if a != b)


def _least_rest_s(
    job: Job,
    operations: list[Operation],
    index: int,
    begin: tuple[float, ...],
    axis: str,
    machine: Machine,
) -> float | None:
    """Return the rest that ``overlapped`` leaves after a move; None where it stays as it is.

    After the last switching the piston stands for the dead time, and then has at most speed times
    lag to go, along an exponential. The last of the switches that are waited for counts.
    """
    move = operations[index]
    assert isinstance(move, Move)
    cylinder = machine.cylinders[axis]
    end_m = dict(zip(job.axes, move.target, strict=True))[axis]
    rests = []
    for after in operations[index + 1 :]:
        if isinstance(after, WaitInput):
            contact = machine.contacts[after.name]
            if contact.cylinder == axis and contact.at is not None and after.value:
                left_m = abs(end_m - contact.at.si)
                to_go = cylinder.speed.si * cylinder.lag.si / max(left_m, _LEAST_LEFT_M)
                way = cylinder.way(end_m > dict(zip(job.axes, begin, strict=True))[axis])
                shut_s = way.closes_s + cylinder.delay.si
                rests.append(shut_s + cylinder.lag.si * math.log(max(to_go, 1.0)))
        elif isinstance(after, Move):
            others = _moved(job.axes, move.target, after.target)
            guarded = bool(rests) and bool(others) and axis not in others
            return round(max(rests), 6) if guarded else None
        elif not isinstance(after, ToolEvent):
            return None
    return None


def move_list(job: Job, machine: Machine) -> str:
    """Return a job of an on/off machine as a move list that reads back as the same job."""
    lines = [f"name = {_quoted(job.name)}"]
    if job.home:
        lines.append(f"home = [{', '.join(map(_quoted, job.home))}]")
    step = ""
    position = dict(zip(job.axes, job.start, strict=True))
    for operation in job:
        if isinstance(operation, ToolEvent):
            step = operation.name.removeprefix("step ")
            continue
        lines += ["", "[[operation]]"]
        if step:
            lines.append(f"step = {_quoted(step)}")
            step = ""
        lines += _operation_lines(operation, machine, job.axes, position)
    return "\n".join(lines) + "\n"


def _operation_lines(
    operation: Operation, machine: Machine, axes: tuple[str, ...], position: dict[str, float]
) -> list[str]:
    """Return the keys of one operation; ``position`` goes along with the moves."""
    match operation:
        case Move(target=target, tags=tags):
            moved = {a: t for a, t in zip(axes, target, strict=True) if t != position[a]}
            shown = moved or dict(zip(axes, target, strict=True))
            position.update(shown)
            places = ", ".join(
                f"{axis} = {_text(at, 'm', 1e3, 'mm')}" for axis, at in shown.items()
            )
            return [
                f"move = {{ {places} }}",
                *(_tag(key, value) for key, value in tags.items()),
            ]
        case Dwell(duration_s=duration):
            return [f"dwell = {_text(duration, 's', 1e3, 'ms')}"]
        case SetOutput(name=name, value=value):
            verb = {"soft-start": "valve", "vacuum": "vacuum"}.get(machine.outputs[name].kind)
            return [f"{verb or 'output'} = {_quoted(name)}", f"on = {str(bool(value)).lower()}"]
        case WaitInput(name=name, value=value, timeout_s=timeout):
            return [
                f"wait = {_quoted(name)}",
                f"is = {str(bool(value)).lower()}",
                f"timeout = {_text(timeout, 's', 1.0, 's')}",
            ]
        case _:
            raise OptionError(f"a move list has no {type(operation).__name__}")


def _tag(key: str, value: float | str) -> str:
    """Return what a move says of itself beside where it goes."""
    if key == REST:
        return f"{key} = {_text(float(value), 's', 1e3, 'ms')}"
    if key == OVERLAP:
        return f"{key} = false"
    return f"{key} = {_quoted(str(value))}"


def _text(value: float, unit: str, factor: float, shown: str) -> str:
    """Return a quantity that reads back as the same number, in the unit people use if it can."""
    usual = f"{value * factor:.12g} {shown}"
    return _quoted(usual if parse_quantity(usual, unit) == value else f"{value!r} {unit}")


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
