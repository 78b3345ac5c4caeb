"""FW-CNC.PAR, the parameter file of the 1994 controller, applied to a machine.

Three lines of comment; then, on each line, a whole number, a semicolon and a comment::

    20  ; Initial feed rate for manual control
    10  ; Normal feed rate
    30  ; Feed rate limit
    20  ; Number of interrupts after which actual positions are recorded
    4   ; Number of knot points to be interpolated between two points

The thesis planned to add the number of axes and the gains. They follow in the same form: the number
of axes n, then Kp and Kd once for all axes, or n times in the order of the machine's axes.
"""

from __future__ import annotations

import dataclasses
import hashlib
import re
from pathlib import Path

from threadline.base.reading import refuse_special
from threadline.errors import MachineError, Place
from threadline.machine.controllers import PdController
from threadline.machine.model import Machine
from threadline.machine.parts import Operator
from threadline.machine.quantity import Provenance, Quantity
from threadline.machine.tool import eye_within

COMMENT_LINES = 3
MAX_RECORD_EVERY = 32_767  # "where n varies from 1 to 32K"
_MAX_BYTES = 100_000
_MAX_VALUE = 1_000_000
_LINE = re.compile(r"[ \t]*([-+]?[0-9]{1,12})[ \t]*;.*", re.DOTALL)
_BASIC = ("manual feed", "normal feed", "feed limit", "record every", "knots between")


@dataclasses.dataclass(frozen=True, slots=True)
class Parameter:
    """A number in the file and its line."""

    value: int
    line: int


def read_parameters(path: str | Path, machine: Machine) -> Machine:
    """Return ``machine`` with the operator's settings, axes and gains of a parameter file.

    Parameters
    ----------
    path
        The parameter file.
    machine
        Machine with all other numbers. If the file gives fewer axes, the machine's first axes are
        kept.

    Raises
    ------
    MachineError
        If the file cannot be read or does not fit the machine; names file and line.
    """
    path = Path(path)
    data = _read(path)
    parameters = _parse(data, path)
    names = machine.axis_names
    if len(parameters) > len(_BASIC):
        count = parameters[len(_BASIC)]
        if not 1 <= count.value <= len(names):
            raise MachineError(
                f"the number of axes is {count.value}; {machine.name!r} has {len(names)}",
                place=Place(str(path), count.line),
                remedy=f"Give 1 to {len(names)}, or use another machine.",
            )
        names = names[: count.value]
    gains = _gains(parameters[len(_BASIC) + 1 :], names, path)
    operator = _operator(parameters[: len(_BASIC)], path)
    axes = {name: machine.axes[name] for name in names}
    inputs = {name: s for name, s in machine.inputs.items() if s.axis in axes}
    controllers = dict(machine.controllers)
    for name, (kp, kd) in gains.items():
        key = axes[name].controller
        controller = controllers[key]
        if not isinstance(controller, PdController):
            raise MachineError(
                f"the controller {key!r} of axis {name} is {controller.kind}: Kp and Kd are "
                "gains of a pd controller",
                place=Place(str(path), kp.line),
                remedy="Remove the gains from the file.",
            )
        controllers[key] = _with_gains(controller, kp, kd, path)
    sha256 = hashlib.sha256(machine.sha256.encode() + data).hexdigest()
    return dataclasses.replace(
        machine, operator=operator, axes=axes, inputs=inputs, controllers=controllers,
        tool=eye_within(machine.tool, axes),
        sha256=sha256, parameters=str(path),
    )  # fmt: skip


def _read(path: Path) -> bytes:
    try:
        refuse_special(path)
        with path.open("rb") as stream:
            data = stream.read(_MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise MachineError(
            f"cannot read parameter file {str(path)[:200]!r}: {reason}",
            remedy="Name an existing file.",
        ) from error
    if len(data) > _MAX_BYTES:
        raise MachineError(
            f"the parameter file has more than {_MAX_BYTES} bytes", place=Place(str(path))
        )
    return data


def _parse(data: bytes, path: Path) -> list[Parameter]:
    # latin-1 accepts any byte: comments of 1994 may have any encoding.
    lines = data.decode("latin-1").removesuffix("\x1a").splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    parameters = []
    for number, line in enumerate(lines[COMMENT_LINES:], start=COMMENT_LINES + 1):
        match = _LINE.fullmatch(line)
        if match is None:
            raise MachineError(
                f"{line.strip()[:40]!r} is not a whole number, a semicolon and a comment",
                place=Place(str(path), number),
                remedy='Write it like "10 ; Normal feed rate".',
            )
        value = int(match[1])
        if not 0 <= value <= _MAX_VALUE:
            raise MachineError(
                f"{value} is not from 0 to {_MAX_VALUE}",
                place=Place(str(path), number),
                remedy="Correct it.",
            )
        parameters.append(Parameter(value, number))
    if len(parameters) < len(_BASIC):
        raise MachineError(
            f"the file has {len(parameters)} numbers after three lines of comment, not "
            f"{len(_BASIC)}; {_BASIC[len(parameters)]!r} is missing",
            place=Place(str(path), len(lines)),
            remedy=f"It holds, in order: {', '.join(_BASIC)}.",
        )
    return parameters


def _operator(parameters: list[Parameter], path: Path) -> Operator:
    manual, normal, limit, record, _ = parameters
    for name, parameter in zip(_BASIC, parameters, strict=True):
        if parameter.value < 1:
            raise MachineError(
                f"{name} is {parameter.value}; it must be 1 or more",
                place=Place(str(path), parameter.line),
            )
    for name, parameter in (("manual feed", manual), ("normal feed", normal)):
        if parameter.value > limit.value:
            raise MachineError(
                f"{name} is {parameter.value} count/tick, above the feed limit of {limit.value}",
                place=Place(str(path), parameter.line),
                remedy="Lower it, or raise the limit.",
            )
    if record.value > MAX_RECORD_EVERY:
        raise MachineError(
            f"positions are recorded every {record.value} ticks, limit {MAX_RECORD_EVERY}",
            place=Place(str(path), record.line),
        )
    units = ("count/tick", "count/tick", "count/tick", "tick", "")
    quantities = [
        _quantity(parameter, unit, path) for parameter, unit in zip(parameters, units, strict=True)
    ]
    return Operator(
        manual_feed=quantities[0],
        normal_feed=quantities[1],
        limit_feed=quantities[2],
        record_every=quantities[3],
        knots_between=quantities[4],
    )


def _gains(
    parameters: list[Parameter], names: tuple[str, ...], path: Path
) -> dict[str, tuple[Parameter, Parameter]]:
    if not parameters:
        return {}
    if len(parameters) == 2:
        return {name: (parameters[0], parameters[1]) for name in names}
    if len(parameters) != 2 * len(names):
        raise MachineError(
            f"{len(parameters)} gains for {len(names)} axes",
            place=Place(str(path), parameters[-1].line),
            remedy="Give Kp and Kd once, or once for each axis.",
        )
    pairs = zip(parameters[::2], parameters[1::2], strict=True)
    return dict(zip(names, pairs, strict=True))


def _with_gains(controller: PdController, kp: Parameter, kd: Parameter, path: Path) -> PdController:
    return dataclasses.replace(
        controller, kp=_quantity(kp, "dac/count", path), kd=_quantity(kd, "dac/count", path)
    )


def _quantity(parameter: Parameter, unit: str, path: Path) -> Quantity:
    return Quantity(
        si=float(parameter.value),
        unit=unit,
        tolerance_si=0.0,
        provenance=Provenance.PRINTED,
        note=str(Place(str(path), parameter.line)),
    )
