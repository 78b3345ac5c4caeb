"""The machine as data: its parts, checked references, and limits as arrays over its axes."""

from __future__ import annotations

from math import pi
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from threadline.errors import OptionError, Place
from threadline.files import Clock
from threadline.machine.controllers import (
    AxisController,
    AxisOfStateSpace,
    Controller,
    StateSpaceController,
)
from threadline.machine.motion_planner import (
    FirmwarePlanner,
    Programs,
    check_by_axis,
    check_units_of_axes,
)
from threadline.machine.parts import (
    STRICT,
    Axis,
    Body,
    DcMotor,
    Guide,
    LimitSwitch,
    Link,
    Operator,
    Period,
    Sensor,
    check_known,
)
from threadline.machine.pneumatics import (
    MOST_SCANS,
    Contact,
    Cylinder,
    Output,
    Plc,
    check_addresses,
    check_contacts,
)
from threadline.machine.quantity import Quantity, Units
from threadline.machine.shaft import Shaft, Tables
from threadline.machine.sources import Kinematic, PulseServo, Source, Stepper, check_limits_only
from threadline.machine.spool import Mounted, Spool, check_spool
from threadline.machine.tables import Design, Tolerances, check_named, quantities
from threadline.machine.tool import (
    AxisArrays,
    PathLimits,
    Tool,
    check_eye,
    check_path_limits,
    check_radii,
)

Drive = Annotated[DcMotor | Stepper | PulseServo | Kinematic, Field(discriminator="kind")]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$")]
AxisName = Annotated[str, Field(pattern=r"^[A-Z]$")]
MAX_AXES = 6
NUMBERED = (
    "tick_budget", "clocks", "bodies", "links", "drives", "sensors", "controllers", "axes",
    "inputs", "cylinders", "outputs", "contacts", "plc", "shaft", "tables", "path", "tool",
    "spool", "operator",
)  # fmt: skip
"""Fields of ``Machine`` whose numbers can have tolerances."""
_WITH_DYNAMICS = ("bodies", "links", "sensors", "controllers", "cylinders", "tables", "design")
CommandedBy = Literal["ticks", "switches", "steps"]
"""The kinds of commands that machines take."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Machine(AxisArrays):
    """A machine from its TOML file; every number in SI with tolerance and provenance.

    All arrays over axes have the order of ``axes``.
    """

    name: str
    """Name in reports and results: letters, digits and hyphens."""
    title: str
    """One line for people."""
    sources: tuple[str, ...]
    """Where the numbers come from."""
    tick_budget: Annotated[Quantity, Units(("tick",), positive=True)]
    """Most ticks of a job; a longer job is refused before it is planned."""
    clocks: dict[Name, Period] = Field(min_length=1)
    """Exact periods by name, each an hour at most."""
    bodies: dict[Name, Body] = Field(default_factory=dict)
    """Bodies by name. Without it: all drives are kinematic."""
    links: dict[Name, Link] = Field(default_factory=dict)
    """Links by name."""
    drives: dict[Name, Drive] = Field(default_factory=dict)
    """Drives by name."""
    sensors: dict[Name, Sensor] = Field(default_factory=dict)
    """Sensors by name."""
    controllers: dict[Name, Controller] = Field(default_factory=dict)
    """Controllers by name."""
    axes: dict[AxisName, Axis] = Field(default_factory=dict, max_length=MAX_AXES)
    """Axes, each named by one capital letter; all tables have their order. A machine has at least
    one of ``axes`` and ``cylinders``."""
    inputs: dict[Name, LimitSwitch] = Field(default_factory=dict)
    """Limit switches by name."""
    cylinders: dict[AxisName, Cylinder] = Field(default_factory=dict, max_length=MAX_AXES)
    """Pneumatic axes, each named by one capital letter."""
    outputs: dict[Name, Output] = Field(default_factory=dict)
    """Digital outputs of the PLC by name."""
    contacts: dict[Name, Contact] = Field(default_factory=dict)
    """Digital inputs of the PLC by name."""
    plc: Plc | None = None
    """The controller of an on/off machine. Without it: no cylinders."""
    shaft: Shaft | None = None
    """The main shaft of an embroidery machine; it comes with ``tables``."""
    tables: Tables | None = None
    """The controller's tables of step intervals; they come with ``shaft``."""
    path: PathLimits | None = None
    """Limits of the tool along its path."""
    tool: Tool | None = None
    """The tool: the radius at which rotary axes act, or a winder's eye. Without it: each rotary
    axis has its own radius."""
    spool: Spool | None = None
    """The spool, brake and spring arm of a winder's fibre. Without it: nothing pulls at the
    eye."""
    operator: Operator | None = None
    """Settings of the operator."""
    programs: Programs = Field(default_factory=Programs)
    """How the controller reads part programs. Without it: the defaults of ``[programs]``."""
    planner: FirmwarePlanner | None = None
    """The motion planner of the controller's firmware."""
    design: Design | None = None
    """What ``threadline design`` may change."""
    tolerances: Tolerances = Field(default_factory=Tolerances)
    """How numbers vary within their ``+-``. Without it: uniformly and independently."""
    guide: Guide = Field(default_factory=Guide)
    """Connectors and presets for ``threadline guide``."""
    sha256: str = ""
    """Hash of the content, including base file and overlays. Machine files have neither this key
    nor the following ones."""
    file: str = ""
    """Path of the file."""
    reference: str = ""
    """The argument of ``load_machine``."""
    parameters: str = ""
    """Parameter file whose settings replaced settings of the machine file; empty for none."""
    mounted: Mounted | None = None
    """Mandrel on the machine; None for none."""

    @model_validator(mode="after")
    def _references(self) -> Machine:
        if self.without_dynamics:
            dynamics = {name: getattr(self, name) for name in _WITH_DYNAMICS}
            check_limits_only(self.drives, self.axes, dynamics)
        elif not self.bodies:
            raise ValueError("a machine needs at least one [bodies.x]")
        for name, link in self.links.items():
            check_known(link.stretch, self.bodies, f"links.{name}.stretch", "body")
            if link.eccentric is not None:
                key = f"links.{name}.eccentric.angle"
                check_known(link.eccentric.angle, self.bodies, key, "body")
        for name, drive in self.drives.items():
            if isinstance(drive, DcMotor):
                check_known(drive.acts_on, self.bodies, f"drives.{name}.acts_on", "body")
                continue
            check_known([drive.clock], self.clocks, f"drives.{name}.clock", "clock")
            if not isinstance(drive, Kinematic):
                check_known([drive.body], self.bodies, f"drives.{name}.body", "body")
        for name, sensor in self.sensors.items():
            check_known(sensor.reads, self.bodies, f"sensors.{name}.reads", "body")
        self._controller_references()
        for name, axis in self.axes.items():
            where = f"axes.{name}"
            if axis.drive:
                key = f"{where}.drive"
                motionless = [n for n, d in self.drives.items() if not isinstance(d, DcMotor)]
                check_known([axis.drive], motionless, key, "drive")
            else:
                check_known(
                    [axis.controller], self.controllers, f"{where}.controller", "controller"
                )
            check_known(axis.load or {}, self.bodies, f"{where}.load", "body")
            check_known(axis.frame or {}, self.bodies, f"{where}.frame", "body")
        check_known(self.programs.base_axes, self.axes, "programs.base_axes", "axis")
        for system, zero in self.programs.offsets.items():
            check_units_of_axes(zero, f"programs.offsets.{system}", "", self.axes, self.rotary)
        for name, switch in self.inputs.items():
            check_known([switch.axis], self.axes, f"inputs.{name}.axis", "axis")
            check_known([switch.cuts], self.motors, f"inputs.{name}.cuts", "drive")
        check_radii(self.axes, self.tool)
        check_eye(self.tool, self.axes)
        check_spool(self.spool, self.tool, self.axes)
        if self.planner is not None:
            check_by_axis(self.planner, self.axes, self.rotary)
        check_path_limits(self.path, self.axes, self.cylinders, self.tables)
        self._on_off_references()
        self._stitching_references()
        if self.tolerances != Tolerances():  # most variants name none; the check is slow
            tables = [quantities(getattr(self, table), table) for table in NUMBERED]
            check_named(self.tolerances, [path for of_table in tables for path, _ in of_table])
        return self

    def _controller_references(self) -> None:
        for name, controller in self.controllers.items():
            path = f"controllers.{name}"
            check_known([controller.clock], self.clocks, f"{path}.clock", "clock")
            if controller.reference_clock is not None:
                key = f"{path}.reference_clock"
                check_known([controller.reference_clock], self.clocks, key, "clock")
            encoders = [n for n, s in self.sensors.items() if s.kind == "encoder"]
            if isinstance(controller, StateSpaceController):
                axis_sensors = controller.sensors[: len(controller.references)]
                check_known(controller.references, self.axes, f"{path}.references", "axis")
                check_known(axis_sensors, encoders, f"{path}.sensors", "encoder")
                check_known(controller.sensors, self.sensors, f"{path}.sensors", "sensor")
                check_known(controller.drives, self.motors, f"{path}.drives", "drive")
                self._check_read_once(name, controller)
                axes_moved = [n for n, axis in self.axes.items() if axis.controller == name]
                if set(axes_moved) != set(controller.references):
                    raise ValueError(
                        f"{path}.references: it names {', '.join(controller.references)}, but the "
                        f"axes with this controller are {', '.join(axes_moved) or 'none'}"
                    )
                continue
            check_known([controller.sensor], encoders, f"{path}.sensor", "encoder")
            check_known([controller.drive], self.motors, f"{path}.drive", "drive")

    def _check_read_once(self, name: str, controller: StateSpaceController) -> None:
        """Refuse an additional sensor that is the encoder of another controller's loop."""
        others = controller.sensors[len(controller.references) :]
        for other, other_controller in self.controllers.items():
            if other == name:
                continue
            other_encoders = (
                other_controller.sensors[: len(other_controller.references)]
                if isinstance(other_controller, StateSpaceController)
                else (other_controller.sensor,)
            )
            for sensor in sorted(set(other_encoders) & set(others)):
                raise ValueError(
                    f"controllers.{name}.sensors: it reads the encoder {sensor!r}, which "
                    f"controllers.{other} reads: one controller that reads both encoders must move "
                    "both axes"
                )

    def _on_off_references(self) -> None:
        if not self.axes and not self.cylinders:
            raise ValueError("a machine needs at least one [axes.X] or [cylinders.X]")
        if self.cylinders and self.plc is None:
            raise ValueError("a PLC switches cylinders: [plc] is missing")
        if self.plc is not None:
            check_known([self.plc.clock], self.clocks, "plc.clock", "clock")
            scan_s = self.clocks[self.plc.clock].si
            if self.plc.watchdog.si <= scan_s:
                raise ValueError(
                    f"plc.watchdog: {1e3 * self.plc.watchdog.si:g} ms is not longer than a scan, "
                    f"{1e3 * scan_s:g} ms: every scan would be a fault"
                )
            if self.plc.watchdog.si > MOST_SCANS * scan_s:
                raise ValueError(
                    f"plc.watchdog: {1e3 * self.plc.watchdog.si:g} ms is longer than {MOST_SCANS} "
                    f"scans, {1e3 * MOST_SCANS * scan_s:g} ms: it would protect nothing"
                )
        used: dict[str, str] = {}
        for name, cylinder in self.cylinders.items():
            path = f"cylinders.{name}"
            check_known([cylinder.pushes], self.bodies, f"{path}.pushes", "body")
            check_known([cylinder.reacts_on], self.bodies, f"{path}.reacts_on", "body")
            check_known(cylinder.frame, self.bodies, f"{path}.frame", "body")
            self._check_kinds(path, cylinder)
            for sense in ("forward", "back"):
                direction = cylinder.way(sense == "forward")
                for output, kind in (
                    (direction.valve, "direction"),
                    *((f, "flow") for f in direction.flows),
                ):
                    key = f"{path}.{sense}"
                    check_known([output], self.outputs, key, "output")
                    if self.outputs[output].kind != kind:
                        raise ValueError(f"{key}: the output {output!r} is not a {kind} valve")
                    if output in used:
                        raise ValueError(f"{key}: the output {output!r} is used by {used[output]}")
                    used[output] = key
        for name, contact in self.contacts.items():
            if contact.cylinder is not None:
                key = f"contacts.{name}.cylinder"
                check_known([contact.cylinder], self.cylinders, key, "cylinder")
        check_contacts(self.cylinders, self.outputs, self.contacts)
        check_addresses(self.outputs, self.contacts)

    def _check_kinds(self, where: str, cylinder: Cylinder) -> None:
        """Check that a cylinder and its bodies all turn or all slide, and the frame is in m."""
        for key in ("pushes", "reacts_on"):
            body = getattr(cylinder, key)
            if self.bodies[body].kind != cylinder.kind:
                raise ValueError(
                    f"{where}.{key}: {body!r} is a {self.bodies[body].kind} body, and the cylinder "
                    f"is {cylinder.kind}"
                )
        for body, weight in cylinder.frame.items():
            expected = "m/rad" if self.bodies[body].kind == "rotary" else ""
            if weight.unit != expected:
                raise ValueError(
                    f"{where}.frame.{body}: the weight of a {self.bodies[body].kind} body "
                    + (f"is in {expected}" if expected else "has no unit")
                    + f", not {weight.unit or 'without unit'}"
                )

    def _stitching_references(self) -> None:
        if (self.shaft is None) != (self.tables is None):
            present, absent = ("shaft", "tables") if self.tables is None else ("tables", "shaft")
            raise ValueError(f"{present}: a machine with [{present}] needs [{absent}] too")
        if self.tables is None:
            return
        check_known([self.tables.clock], self.clocks, "tables.clock", "clock")
        if self.cylinders or not self.axes:
            raise ValueError("tables: step tables move [axes.X] and exclude cylinders")
        for name, axis in self.axes.items():
            key = f"axes.{name}"
            steps = axis.counts.si * self.tables.unit.si
            if axis.kind != "linear" or not axis.drive:
                raise ValueError(f"{key}: step tables need linear axes with a position drive")
            if abs(steps - round(steps)) > 1e-6 * steps or not round(steps):
                raise ValueError(
                    f"{key}.counts: {steps:.6g} steps in tables.unit; it must be a whole number"
                )

    def __repr__(self) -> str:
        return f"<Machine {self.name!r}: {self.title}>"

    @property
    def unwinds(self) -> bool:
        """Whether the twin simulates fibre tension: the machine has a spool and a mandrel."""
        return self.spool is not None and self.mounted is not None

    @property
    def place(self) -> Place | None:
        """Its file, for errors; None for a machine without a file."""
        return Place(self.file) if self.file else None

    @property
    def commanded_by(self) -> CommandedBy:
        """Kind of its commands; a key of ``KINDS``."""
        if self.shaft is not None:
            return "steps"
        return "switches" if self.cylinders else "ticks"

    @property
    def moving(self) -> dict[str, str]:
        """Kind of every moving part, by name.

        A kind is ``linear`` or ``rotary`` (an axis with a control loop), ``stepper``,
        ``pulse-servo``, ``kinematic``, ``cylinder``, or ``stepped`` (an axis that plays tables
        between stitches).
        """
        if self.tables is not None:
            return dict.fromkeys(self.axes, "stepped")
        drive_kinds = {
            name: self.drives[axis.drive].kind for name, axis in self.axes.items() if axis.drive
        }
        axes = {name: axis.kind for name, axis in self.axes.items()}
        return axes | drive_kinds | dict.fromkeys(self.cylinders, "cylinder")

    @property
    def rotary(self) -> frozenset[str]:
        """Names of the rotary axes and cylinders; all others are linear."""
        kinds = {name: axis.kind for name, axis in self.axes.items()}
        kinds |= {name: cylinder.kind for name, cylinder in self.cylinders.items()}
        return frozenset(name for name, kind in kinds.items() if kind == "rotary")

    def unit_of(self, axis: str, *, frame: bool = False) -> str:
        """Return the SI unit of positions of an axis or cylinder: ``m`` or ``rad``.

        The position of the frame under a cylinder is in m for both kinds of cylinder.
        """
        return "rad" if axis in self.rotary and not (frame and axis in self.cylinders) else "m"

    def usual(self, axis: str) -> tuple[float, str]:
        """Return the factor from SI to the usual unit of positions, and that unit: mm or deg."""
        return (180.0 / pi, "deg") if axis in self.rotary else (1e3, "mm")

    def acts_at_m(self, axis: str) -> float:
        """Return the distance, m, at which a rotary axis or cylinder acts; 1 for a linear axis."""
        if axis in self.cylinders:
            radius = self.cylinders[axis].radius
            assert radius is not None
            return radius.si
        return float(self.radius_m[self.axis_names.index(axis)])

    @property
    def motors(self) -> dict[str, DcMotor]:
        """Motors with control loops, commanded in volts, by name."""
        return {name: d for name, d in self.drives.items() if isinstance(d, DcMotor)}

    @property
    def position_sources(self) -> dict[str, Source]:
        """Position-commanded drives with known loads (steppers and pulse servos), by name."""
        return {n: d for n, d in self.drives.items() if isinstance(d, Stepper | PulseServo)}

    @property
    def without_dynamics(self) -> bool:
        """Whether its file has only limits, and no bodies that its drives move."""
        return any(isinstance(drive, Kinematic) for drive in self.drives.values())

    @property
    def takes_positions(self) -> bool:
        """Whether its drives take positions, so that Threadline closes no control loop."""
        return any(axis.drive for axis in self.axes.values())

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes, in the order of all arrays."""
        return tuple(self.axes)

    def controller_of(self, axis: str) -> AxisController | AxisOfStateSpace:
        """Return the controller that moves an axis; for state space, its part for this axis."""
        controller = self.controllers[self.axes[axis].controller]
        if isinstance(controller, StateSpaceController):
            return controller.of_axis(axis)
        return controller

    @property
    def observing(self) -> tuple[str, ...]:
        """Names of sensors other than the encoders of axes; recordings have them by name."""
        loops = [name for name, axis in self.axes.items() if axis.controller]
        loop_sensors = {self.controller_of(name).sensor for name in loops}
        return tuple(name for name in self.sensors if name not in loop_sensors)

    def drive_of(self, axis: str) -> DcMotor:
        """Return the drive that the axis's controller commands."""
        return self.motors[self.controller_of(axis).drive]

    def source_of(self, axis: str) -> Source | None:
        """Return the stepper or pulse servo of an axis; None for any other axis."""
        return self.position_sources.get(self.axes[axis].drive)

    def clock(self, name: str) -> Clock:
        """Return the clock called ``name``."""
        period = self.clocks[name].exact_s
        assert period is not None
        return Clock(name, period)

    @property
    def command_clock(self) -> Clock:
        """The clock of its commands: the scan of a PLC, else ``tick_clock``."""
        return self.tick_clock if self.plc is None else self.clock(self.plc.clock)

    @property
    def tick_clock(self) -> Clock:
        """The clock of the axes' references, from the first axis."""
        name = next(iter(self.axes))
        drive = self.drives.get(self.axes[name].drive)
        if drive is not None and not isinstance(drive, DcMotor):
            return self.clock(drive.clock)
        first_controller = self.controller_of(name)
        return self.clock(first_controller.reference_clock or first_controller.clock)


def clocked(machine: Machine) -> list[tuple[str, str]]:
    """Return the kind of each controller and of the PLC, with the name of its clock.

    >>> from threadline.machine.load import load_machine
    >>> clocked(load_machine("letter-placer"))
    [('PLC, a scan', 'scan')]
    """
    scans = [] if machine.plc is None else [("PLC, a scan", machine.plc.clock)]
    return [*((loop.kind, loop.clock) for loop in machine.controllers.values()), *scans]


def check_dynamics(purpose: str, *machines: Machine | None) -> None:
    """Refuse a calculation that needs dynamics if a machine has only limits.

    Parameters
    ----------
    purpose
        The calculation, as the subject of a sentence: ``"how axis X swings"``.
    machines
        The machines to check; None is skipped.

    Raises
    ------
    OptionError
        If one of the machine files has no dynamics.
    """
    for machine in machines:
        if machine is not None and machine.without_dynamics:
            raise OptionError(
                f"the machine file of {machine.name} has no dynamics, only limits: {purpose} "
                "cannot be computed",
                place=machine.place,
                remedy="Omit it, or describe the bodies and drives: docs/machines.md.",
            )
