"""The guide to a machine: tables of axes and signals, and steps of calibration.

Everything follows from the machine file. Each step gives an action and the expected observation;
the expected numbers are computed from the machine file.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, pi
from pathlib import Path
from typing import NamedTuple

from threadline.machine import Machine
from threadline.machine.parts import Axis, DcMotor
from threadline.machine.quantity import Quantity
from threadline.machine.sources import Kinematic, PulseServo, Stepper
from threadline.report.document import Document, Table, origin_facts
from threadline.report.publish import write_document
from threadline.report.style import figure_style


def cylinder_rows(machine: Machine) -> Iterator[tuple[str, ...]]:
    """Yield a row of the table of axes for each cylinder."""
    for name, cylinder in machine.cylinders.items():
        yield (
            f"{name}, cylinder",
            f"valves {cylinder.forward.valve}, {cylinder.back.valve}",
            cylinder.place(cylinder.stroke.si, ".4g"),
            f"{cylinder.place(cylinder.speed.si, '.4g')}/s ({cylinder.speed.provenance.value})",
            "-",
            "-",
        )


def cylinder_signals(machine: Machine) -> Iterator[tuple[str, ...]]:
    """Yield a row of the table of signals for each output and input of the PLC."""
    for name, output in machine.outputs.items():
        needs = f"needs {', '.join(output.needs)}" if output.needs else ""
        yield name, f"PLC {output.address}", f"{output.kind} valve", needs
    for name, contact in machine.contacts.items():
        source, note = str(contact.kind), ""
        if contact.cylinder is not None and contact.at is not None:
            source = f"end switch of {contact.cylinder}"
            position_text = machine.cylinders[contact.cylinder].place(contact.at.si)
            note = f"on at {position_text} and {contact.beyond}"
        yield name, source, f"PLC {contact.address}", note


def cylinder_steps(machine: Machine) -> Iterator[tuple[str, str]]:
    """Yield the steps of calibration of the cylinders, by hand and with air."""
    for name, contact in machine.contacts.items():
        if contact.cylinder is None or contact.at is None:
            yield f"Work the input {name} ({contact.kind}).", f"{contact.address} follows it."
            continue
        cylinder = machine.cylinders[contact.cylinder]
        yield (
            f"Without air, push {contact.cylinder} by hand past {cylinder.place(contact.at.si)}.",
            f"{name} ({contact.address}) is on there and {contact.beyond}, within "
            f"{cylinder.place(contact.at.tolerance_si)}.",
        )
    for name, output in machine.outputs.items():
        yield (
            f"Without air, switch the output {name} ({output.address}) on and off.",
            f"Its {output.kind} valve follows it.",
        )
    for name, cylinder in machine.cylinders.items():
        stroke_s = full_stroke_s(machine, name)
        for direction, direction_word in ((cylinder.forward, "forward"), (cylinder.back, "back")):
            flows = ", ".join(direction.flows) or "flow control"
            yield (
                f"With air, and nobody near, let {name} go {direction_word} over its whole stroke "
                f"by {direction.valve} and {flows}; trim the flow control.",
                f"It arrives {1e3 * stroke_s:.0f} ms after the valve is switched.",
            )


def full_stroke_s(machine: Machine, name: str) -> float:
    """Return the time of a full stroke from the switching of the valve, s.

    The flow begins after the delay and rises with a first-order lag, which adds one time constant.
    Cushion and air are neglected.
    """
    cylinder = machine.cylinders[name]
    return cylinder.delay.si + cylinder.lag.si + cylinder.stroke.si / cylinder.speed.si


def shaft_rows(machine: Machine) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table of signals for the shaft; none without a shaft."""
    shaft, tables = machine.shaft, machine.tables
    if shaft is None or tables is None:
        return
    yield (
        "angle of the shaft",
        "main shaft",
        "controller",
        f"0 where the frame may begin to move, {degrees(shaft.window.si):g} deg where it must rest",
    )


def shaft_steps(machine: Machine) -> Iterator[tuple[str, str]]:
    """Yield the steps of calibration of the shaft, turned by hand; none without a shaft."""
    shaft, tables = machine.shaft, machine.tables
    if shaft is None or tables is None:
        return
    for text, angle in (
        ("the needle has just left the cloth and the frame may move: set the angle to 0", 0.0),
        ("the frame must rest", degrees(shaft.window.si)),
        ("the needle enters the cloth", degrees(shaft.needle_enters.si)),
        ("the needle leaves the cloth", degrees(shaft.needle_leaves.si)),
    ):
        yield f"Turn the shaft by hand until {text}.", f"The controller shows {angle:g} deg."
    for name, axis in machine.axes.items():
        steps = axis.counts.si * tables.unit.si
        yield (
            f"Play the table of one unit for {name}, a hundred times.",
            f"It has moved by {1e5 * tables.unit.si:g} mm in {100 * round(steps)} steps.",
        )


_SHARE = 0.25
"""Share of a DAC's range at which the gain of an amplifier is trimmed: 2.5 V of 10 V."""
_WAY = {"m": "100 mm", "rad": "360 deg"}


class Step(NamedTuple):
    """A step of calibration: an action, and the expected observation."""

    do: str
    see: str


def guide_of(machine: Machine) -> Document:
    """Return the guide to a machine of any kind."""
    tables = [
        Table(
            title="Axes",
            header=("axis", "moved by", "way", "speed", "acceleration", "scale"),
            rows=[*_axis_rows(machine), *cylinder_rows(machine)],
            note="From the machine file; the word in brackets is the source of a number.",
            words=("moved by", "way"),
        ),
        Table(
            title="Signals",
            header=("signal", "from", "to", "note"),
            rows=[*_signals(machine), *shaft_rows(machine), *cylinder_signals(machine)],
            words=("from", "to"),
        ),
    ]
    tables += [
        Table(
            title=f"Connector {name}: {connector.title}",
            header=("pin", "signal"),
            rows=list(connector.pins.items()),
            words=("signal",),
        )
        for name, connector in machine.guide.connectors.items()
    ]
    steps = [
        Step(
            "Keep clear of the machine; its emergency stop is within reach.", "It cuts the power."
        ),
        *(Step(text, "") for text in machine.guide.presets),
        *_switch_steps(machine),
        *shaft_steps(machine),
        *(step for axis in machine.axes for step in axis_steps(machine, axis)),
        *cylinder_steps(machine),
    ]
    tables.append(
        Table(
            title="Calibration, step by step",
            header=("step", "do", "see"),
            rows=[(str(k), step[0], step[1]) for k, step in enumerate(steps, start=1)],
            note="If you do not see the effect in the last column, do not go on.",
            words=("do", "see"),
        )
    )
    return Document(
        title=f"Guide to {machine.name}",
        subtitle=machine.title,
        verdicts=(),
        tables=tables,
        figures={},
        captions={},
        facts=origin_facts(machine),
    )


def write_guide(machine: Machine, folder: Path) -> Path:
    """Write the guide to a machine into ``folder``; return the path of the HTML page.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    with figure_style():
        return write_document(guide_of(machine), folder, "guide")


# --- axes and signals ------------------------------------------------------------------


def _axis_rows(machine: Machine) -> Iterator[tuple[str, ...]]:
    for name, axis in machine.axes.items():
        range_text = "endless"
        if axis.travel is not None:
            range_text = f"{shown(axis.travel[0].si, axis)} to {shown(axis.travel[1].si, axis)}"
        elif axis.stroke is not None:
            range_text = f"{shown(axis.stroke.si, axis)} in all"
        yield (
            f"{name}, {axis.kind}",
            machine.moving[name] if axis.drive else f"controller {axis.controller}",
            range_text,
            shown(axis.velocity.si, axis, "/s"),
            shown(axis.acceleration.si, axis, "/s^2"),
            f"{_scale(axis)} ({axis.counts.provenance.value})",
        )


def shown(si: float, axis: Axis, per: str = "") -> str:
    """Return a number of an axis for people: millimetres, or degrees."""
    if axis.kind == "linear":
        return f"{1e3 * si:.5g} mm{per}"
    return f"{degrees(si):.5g} deg{per}"


def _scale(axis: Axis) -> str:
    if axis.kind == "linear":
        return f"{1e-3 * axis.counts.si:.6g} count/mm"
    return f"{axis.counts.si * pi / 180.0:.7g} count/deg"


def _signals(machine: Machine) -> Iterator[tuple[str, ...]]:
    for name, axis in machine.axes.items():
        if axis.drive:
            drive = machine.drives[axis.drive]
            rate = axis.velocity.si * axis.counts.si
            yield f"{name} steps", "controller", f"drive {axis.drive}", f"up to {rate:.4g} step/s"
            if isinstance(drive, Stepper):
                yield f"{name} phases", f"drive {axis.drive}", "motor", _current(drive)
            continue
        controller = machine.controller_of(name)
        dac = controller.dac
        yield (
            f"{name} command",
            f"controller {axis.controller}",
            f"drive {controller.drive}",
            f"+-{dac.range.si:g} V, {dac.bits.si:g} bit, {1e3 * dac.volt_per_level:.4g} mV a level",
        )
        reads = machine.sensors[controller.sensor].reads
        yield (
            f"{name} position",
            f"encoder {controller.sensor}",
            f"controller {axis.controller}",
            "; ".join(f"{_of_body(q)} of {body}" for body, q in reads.items()),
        )
    for name, switch in machine.inputs.items():
        position_text = shown(switch.at.si, machine.axes[switch.axis])
        yield (
            name,
            f"switch of {switch.axis} at {position_text} or {switch.beyond}",
            f"drive {switch.cuts}, controller",
            f"cuts the supply of {switch.cuts}",
        )


def _of_body(resolution: Quantity) -> str:
    if resolution.unit == "count/rad":
        return f"{resolution.si * 2.0 * pi:.6g} count/rev"
    return f"{1e-3 * resolution.si:.6g} count/mm"


def _current(drive: Stepper) -> str:
    steps = f"{drive.microsteps.si:g} microsteps"
    return steps if drive.winding is None else f"{drive.winding.current.si:g} A a phase, {steps}"


# --- calibration -----------------------------------------------------------------------


def _switch_steps(machine: Machine) -> Iterator[Step]:
    for name, switch in machine.inputs.items():
        yield Step(
            f"With the drives off, push {switch.axis} by hand onto the switch {name}.",
            f"The input {name} is on at {shown(switch.at.si, machine.axes[switch.axis])}, within "
            f"{shown(switch.at.tolerance_si, machine.axes[switch.axis])}, and {switch.cuts} has no "
            "supply there.",
        )


def axis_steps(machine: Machine, name: str) -> list[Step]:
    """Return the steps of calibration of one axis."""
    axis = machine.axes[name]
    unit = "m" if axis.kind == "linear" else "rad"
    source = machine.drives[axis.drive] if axis.drive else machine.drive_of(name)
    if isinstance(source, DcMotor):
        steps = _amplifier_steps(machine, name, source)
    elif isinstance(source, Stepper):
        steps = [
            Step(f"Set the driver of {name}: {_current(source)}.", "The motor holds its shaft."),
            _direction(name),
        ]
    else:
        assert isinstance(source, PulseServo | Kinematic)
        steps = [_direction(name)]
    way = _WAY[unit]
    return [
        *steps,
        Step(
            f"Mark {name}, tell it to move by {way} slowly, and measure how far it went.",
            f"{way}. Otherwise write into axes.{name}: counts = {_scale(axis)} x {way} / measured "
            "way, and repeat.",
        ),
    ]


def _direction(name: str) -> Step:
    return Step(
        f"Tell {name} to move a little in its positive direction.",
        "It goes that way; otherwise change the sign of its direction in the controller.",
    )


def _amplifier_steps(machine: Machine, name: str, motor: DcMotor) -> list[Step]:
    """Return the steps that trim the gain of an amplifier at a part of its range."""
    axis, controller = machine.axes[name], machine.controller_of(name)
    volts = _SHARE * controller.dac.range.si
    level = volts / controller.dac.volt_per_level
    speed = speed_at(machine, name, volts)
    if motor.amplifier.mode == "current":
        observation = (
            f"{motor.amplifier.gain.si * volts:.4g} A at the amplifier's monitor; {name} speeds up."
        )
    elif speed is None:
        observation = f"{name} begins to move, at the same speed at every trial."
    else:
        counts = speed * axis.counts.si
        observation = (
            f"{name} goes at {shown(speed, axis, '/s')} ({counts:.5g} count/s); friction makes it "
            "a little less."
        )
    travel_warning = "" if axis.endless else " It has its travel alone: stop it in time."
    return [
        Step(
            f"Take the controller's plug out, put 0 V to the command of {name}, balance the drive.",
            f"{name} stands still: less than a count a second.",
        ),
        Step(
            f"Put +{volts:g} V to the command of {name} (level {level:.0f} of its DAC), and turn "
            f"the gain up slowly until it goes as it must.{travel_warning}",
            observation,
        ),
        Step(
            f"Look at the reading of encoder {controller.sensor} meanwhile.",
            "It rises. If it falls, exchange its lines: with the wrong sign the loop runs away.",
        ),
    ]


def speed_at(machine: Machine, name: str, volts: float) -> float | None:
    """Return the speed of an axis without load at a command voltage, m/s or rad/s.

    At this speed the back EMF equals the amplifier's voltage. None if the motor drives several
    bodies, or the amplifier controls the current.
    """
    motor, controller = machine.drive_of(name), machine.controller_of(name)
    reads = machine.sensors[controller.sensor].reads
    if motor.amplifier.mode == "current" or len(motor.acts_on) != 1 or not motor.back_emf.si:
        return None
    ((body, weight),) = motor.acts_on.items()
    if set(reads) != {body}:
        return None
    body_speed = motor.amplifier.gain.si * volts / motor.back_emf.si / weight.si
    return float(body_speed * reads[body].si / machine.axes[name].counts.si)
