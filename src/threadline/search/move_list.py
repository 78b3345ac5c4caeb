"""A job of an on/off machine: with commands and waits of its own, and as a move list.

What is written reads back as the same job, to the last digit of every place and time.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace

from threadline.errors import OptionError
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


def with_choices(job: Job, how: Mapping[int, tuple[str, str]], waits: Mapping[int, float]) -> Job:
    """Return ``job`` with its moves commanded as told, and waits before them.

    Operations that it is told of are those of ``job``; a wait is one more operation.
    """
    found: list[Operation] = []
    for index, operation in enumerate(job):
        if isinstance(operation, Move):
            if waits.get(index, 0.0) > 0.0:
                found.append(Dwell(waits[index], operation.source))
            tags = dict([how[index]]) if index in how else {}
            found.append(replace(operation, tags=tags))
        else:
            found.append(operation)
    return replace(job, operations=Stream.of(found), sha256="")


def move_list(job: Job, machine: Machine) -> str:
    """Return a job of an on/off machine as a move list that reads back as the same job."""
    lines = [f"name = {_quoted(job.name)}"]
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
                *(f"{k} = {_quoted(str(v))}" for k, v in tags.items()),
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


def _text(value: float, unit: str, factor: float, shown: str) -> str:
    """Return a quantity that reads back as the same number, in the unit people use if it can."""
    usual = f"{value * factor:.12g} {shown}"
    return _quoted(usual if parse_quantity(usual, unit) == value else f"{value!r} {unit}")


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
