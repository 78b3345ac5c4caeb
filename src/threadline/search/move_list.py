"""A job of an on/off machine with commands and waits of its own, and its move list.

A written move list reads back as the same job, to the last digit of every place and time.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from threadline.commands.schedule_moves import joined_levels, levels_by_axis
from threadline.errors import OptionError
from threadline.files import Stream
from threadline.jobs.moves import FIRST, OVERLAP, REST
from threadline.jobs.operations import (
    Dwell,
    Home,
    Job,
    Move,
    Operation,
    SetOutput,
    ToolEvent,
    WaitInput,
)
from threadline.machine import Machine
from threadline.units import parse_quantity

_LEAST_LEFT_M = 1e-4


def with_choices(job: Job, how: Mapping[int, tuple[str, str]], waits: Mapping[int, float]) -> Job:
    """Return ``job`` with commands and waits of its moves replaced; rests and overlaps are kept.

    Parameters
    ----------
    how
        By the index of a move's operation in ``job``: key and text of its command in a move list,
        ``("shaper", "zv")`` or ``("levels", ...)``. Other moves get no command.
    waits
        By the same index: wait before the move in s, as an operation of its own.
    """
    operations: list[Operation] = []
    for index, operation in enumerate(job):
        if isinstance(operation, Move):
            if waits.get(index, 0.0) > 0.0:
                operations.append(Dwell(waits[index], operation.source))
            tags = {k: v for k, v in operation.tags.items() if k in {REST, OVERLAP}}
            tags |= dict([how[index]]) if index in how else {}
            operations.append(replace(operation, tags=tags))
        else:
            operations.append(operation)
    return replace(job, operations=Stream.of(operations), sha256="")


def levels_of_operations(moves: Iterable[tuple[int, str, str]]) -> dict[int, tuple[str, str]]:
    """Return the levels entry of each operation, from (operation, cylinder, levels)."""
    by_operation: dict[int, dict[str, str]] = {}
    for operation, axis, text in moves:
        by_operation.setdefault(operation, {})[axis] = text
    return {
        operation: (
            "levels",
            joined_levels(by_axis) if len(by_axis) > 1 else next(iter(by_axis.values())),
        )
        for operation, by_axis in by_operation.items()
    }


def overlapped(job: Job, machine: Machine) -> Job:
    """Return ``job`` with a shorter rest after moves where the list need not wait for it.

    The rest after a move is cut if three conditions hold: the move is of one cylinder, the list
    then waits for an end switch of this cylinder, and the next move is of another cylinder. The
    remaining rest lasts until the piston passes the switch, so a switch that is stuck on does not
    start the other cylinder sooner. A vacuum that is switched on behind such a wait builds up while
    the cylinder comes to rest; the list goes on resting before the next operation. The rest stays
    if a dwell or another output comes first, or if the move has ``overlap = false`` or a ``rest``
    of its own.
    """
    operations = list(job)
    new_operations: list[Operation] = []
    resting: dict[int, Dwell] = {}
    position = job.start
    for index, operation in enumerate(operations):
        if index in resting:
            new_operations.append(resting[index])
        new_operation = operation
        if isinstance(operation, Move):
            moved_axes = _moved_axes(job.axes, position, operation.target)
            if (
                OVERLAP not in operation.tags
                and REST not in operation.tags
                and len(moved_axes) == 1
            ):
                cut = _cut(job, operations, index, position, moved_axes[0], machine)
                if cut is not None:
                    new_operation = replace(operation, tags={**operation.tags, REST: cut.rest_s})
                    if cut.left_s > 0.0:
                        resting[cut.before] = Dwell(cut.left_s, operation.source)
            position = operation.target
        elif isinstance(operation, Home):
            position = tuple(0.0 for _ in job.axes)
        new_operations.append(new_operation)
    if len(operations) in resting:
        new_operations.append(resting[len(operations)])
    return replace(job, operations=Stream.of(new_operations), sha256="")


def _moved_axes(
    axes: tuple[str, ...], begin: tuple[float, ...], end: tuple[float, ...]
) -> tuple[str, ...]:
    return tuple(axis for axis, a, b in zip(axes, begin, end, strict=True) if a != b)


@dataclass(frozen=True, slots=True)
class _Cut:
    """The shortened rest after a move.

    ``left_s`` is the part of the full rest, s, that is still due before the operation with the
    index ``before``.
    """

    rest_s: float
    left_s: float
    before: int


def _cut(
    job: Job,
    operations: list[Operation],
    index: int,
    begin: tuple[float, ...],
    axis: str,
    machine: Machine,
) -> _Cut | None:
    """Return the shortened rest after a move of one cylinder; None if the rest stays."""
    move = operations[index]
    assert isinstance(move, Move)
    assert machine.plc is not None
    scan_s = float(machine.clock(machine.plc.clock).period_s)
    from_m, to_m = (
        dict(zip(job.axes, position, strict=True))[axis] for position in (begin, move.target)
    )
    whole_s = machine.cylinders[axis].rest_s(to_m > from_m)
    rests: list[float] = []
    is_drawn, spent_s, before = False, 0.0, len(operations)
    for following_index, following in enumerate(operations[index + 1 :], start=index + 1):
        if isinstance(following, WaitInput):
            contact = machine.contacts[following.name]
            if (
                contact.cylinder == axis
                and contact.at is not None
                and following.value
                and not is_drawn
            ):
                rests.append(_end_switch_s(machine, axis, from_m, to_m, contact.at.si))
            spent_s += scan_s
        elif isinstance(following, SetOutput) and _draws(machine, following):
            is_drawn, spent_s = True, spent_s + scan_s
        elif isinstance(following, Dwell) and is_drawn:
            spent_s += following.duration_s
        elif isinstance(following, Move):
            moved_axes = _moved_axes(job.axes, move.target, following.target)
            if rests and moved_axes and axis not in moved_axes:
                return _Cut(round(max(rests), 6), 0.0, following_index)
            before = following_index
            break
        elif not isinstance(following, ToolEvent):
            before = following_index
            break
    if not rests or not is_drawn:
        return None
    rest_s = round(max(rests), 6)
    return _Cut(rest_s, round(whole_s - rest_s - spent_s, 6), before)


def _draws(machine: Machine, operation: SetOutput) -> bool:
    return machine.outputs[operation.name].kind == "vacuum" and bool(operation.value)


def _end_switch_s(
    machine: Machine, axis: str, from_m: float, to_m: float, switch_m: float
) -> float:
    """Return the time from a move's last switching until its piston passes an end switch.

    After the last switching the valves close and the dead time passes. Then the piston has at most
    speed times lag to go, and it covers this distance as an exponential.
    """
    cylinder = machine.cylinders[axis]
    distance_left_m = abs(to_m - switch_m)
    start_ratio = cylinder.speed.si * cylinder.lag.si / max(distance_left_m, _LEAST_LEFT_M)
    late_s = cylinder.way(to_m > from_m).closes_s + cylinder.delay.si
    return late_s + cylinder.lag.si * math.log(max(start_ratio, 1.0))


def move_list(job: Job, machine: Machine) -> str:
    """Return a job of an on/off machine as a move list that reads back as the same job."""
    lines = [f"name = {_quoted(job.name)}"]
    if job.home and not any(isinstance(operation, Home) for operation in job):
        lines.append(f"home = [{', '.join(map(_quoted, job.home))}]")
    step = ""
    position = dict(zip(job.axes, job.start, strict=True))
    for index, operation in enumerate(job):
        if isinstance(operation, ToolEvent):
            step = operation.name.removeprefix("step ")
            continue
        lines += ["", "[[operation]]"]
        if step:
            lines.append(f"step = {_quoted(step)}")
            step = ""
        if index < job.once:
            lines.append(f"{FIRST} = true")
        lines += _operation_lines(operation, machine, job.axes, position)
    return "\n".join(lines) + "\n"


def _operation_lines(
    operation: Operation, machine: Machine, axes: tuple[str, ...], position: dict[str, float]
) -> list[str]:
    """Return the keys of one operation; moves update ``position``."""
    match operation:
        case Move(target=target, tags=tags):
            moved_targets = {a: t for a, t in zip(axes, target, strict=True) if t != position[a]}
            shown = moved_targets or dict(zip(axes, target, strict=True))
            position.update(shown)
            target_texts = ", ".join(
                f"{axis} = {_text(at, cylinder.stroke.unit, *cylinder.usual)}"
                for axis, at in shown.items()
                for cylinder in (machine.cylinders[axis],)
            )
            return [
                f"move = {{ {target_texts} }}",
                *(_tag(key, value) for key, value in tags.items()),
            ]
        case Dwell(duration_s=duration):
            return [f"dwell = {_text(duration, 's', 1e3, 'ms')}"]
        case SetOutput(name=name, value=value):
            verb = {"soft-start": "valve", "vacuum": "vacuum"}.get(machine.outputs[name].kind)
            return [f"{verb or 'output'} = {_quoted(name)}", f"on = {str(bool(value)).lower()}"]
        case WaitInput(name=name, value=value, timeout_s=timeout, creep=creep):
            return [
                f"wait = {_quoted(name)}",
                f"is = {str(bool(value)).lower()}",
                f"timeout = {_text(timeout, 's', 1.0, 's')}",
                *([] if creep else ["creep = false"]),
            ]
        case Home(axes=order):
            position.update(dict.fromkeys(order, 0.0))
            return [f"home = [{', '.join(map(_quoted, order))}]"]
        case _:
            raise OptionError(f"a move list has no {type(operation).__name__}")


def _tag(key: str, value: float | str) -> str:
    """Return the value of a move's key as text of a move list."""
    if key == REST:
        return f"{key} = {_text(float(value), 's', 1e3, 'ms')}"
    if key == OVERLAP:
        return f"{key} = false"
    by_axis = levels_by_axis(str(value)) if key == "levels" else {}
    if by_axis:
        return f"{key} = {{ {', '.join(f'{a} = {_quoted(t)}' for a, t in by_axis.items())} }}"
    return f"{key} = {_quoted(str(value))}"


def _text(value: float, unit: str, factor: float, shown: str) -> str:
    """Return a quantity that reads back as the same number, in the usual unit where possible."""
    usual = f"{value * factor:.12g} {shown}"
    return _quoted(usual if parse_quantity(usual, unit) == value else f"{value!r} {unit}")


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
