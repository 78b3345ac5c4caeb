"""Controllers for many sensors: the wanted design, its result, and the machine file with it."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import count
from pathlib import Path
from typing import Any

from threadline.base.arrays import FloatArray
from threadline.base.reading import note_input
from threadline.base.summary import Summarised, Summary
from threadline.base.wording import ascii_only, toml_string
from threadline.base.writing import check_machine_name, check_output
from threadline.dynamics.analysis import AxisAnalysis, analyse
from threadline.dynamics.contouring import cross_coupled
from threadline.dynamics.state_designs import (
    DESIGNS,
    PREVIEW,
    Designed,
    lqg,
    preview,
    regulators,
    zero_phase,
    zero_phase_ticks,
)
from threadline.errors import OptionError
from threadline.files.formats.common import atomic_file
from threadline.machine import Machine, load_machine
from threadline.machine.load import split_reference
from threadline.units import parse_number

_MOST_GAIN = 100.0
_MOST_SMOOTHING = 15
_REGULATORS = ("lqg", "preview", "zpetc")
_DESIGNS_WITH_OPTION: Mapping[str, tuple[str, ...]] = {
    "gain": _REGULATORS, "sensors": _REGULATORS, "ahead": ("preview",), "smoothing": ("zpetc",),
    "axes": ("cross-coupled",), "direction": ("cross-coupled",), "coupling": ("cross-coupled",),
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignGoal:
    """A design and its options; None stands for an option that was not given.

    Parameters
    ----------
    design
        One of ``DESIGNS``.
    gain
        Static gain, as a multiple of the present controllers' static gain; 1.
    sensors
        Sensors to read besides the encoders of the axes; default: none.
    ahead
        References that ``preview`` looks ahead; 4.
    smoothing
        References in each average of ``zpetc``, an odd number; 1.
    axes
        The two axes of ``cross-coupled``; the first two linear ones.
    direction, coupling
        Direction of the line of ``cross-coupled``, ``"45 deg"``, and by how much more an error
        across the line weighs than lag, ``"50 %"``.
    """

    design: str
    gain: float | None = None
    sensors: tuple[str, ...] | None = None
    ahead: int | None = None
    smoothing: int | None = None
    axes: tuple[str, ...] | None = None
    direction: str | None = None
    coupling: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ControlDesign(Summarised):
    """A designed machine; prints itself as a table.

    Parameters
    ----------
    design
        Name of the design.
    base, machine
        The machine before, and with the designed controllers.
    controllers
        The designed controllers.
    axes
        The loops of the designed machine by axis.
    file
        The written machine file.
    """

    design: str
    base: Machine
    machine: Machine
    controllers: tuple[Designed, ...]
    axes: Mapping[str, AxisAnalysis]
    file: Path

    @property
    def stable(self) -> bool:
        """Whether every loop is stable."""
        return all(one.stable for one in self.axes.values())

    def delay_s(self, controller: Designed) -> float:
        """Return the time by which a controller delays the motion."""
        return controller.delay_ticks * float(self.base.clock(controller.clock).period_s)

    def _summary(self) -> Summary:
        rows = [
            [", ".join(one.axes), ", ".join(one.sensors), str(len(one.A)),
             f"{1e3 * self.delay_s(one):g} ms"]
            for one in self.controllers
        ]  # fmt: skip
        loops = "; ".join(one.verdict() for one in self.axes.values())
        title = f"{self.design} for {self.base.name}, written to {self.file}"
        return Summary(title, ["axes", "sensors", "states", "delay"], rows, loops)

    def content(self) -> dict[str, Any]:
        """Return the answer as JSON content."""
        return {
            "machine": self.base.name,
            "design": self.design,
            "controllers": [
                {"axes": list(one.axes), "sensors": list(one.sensors), "states": len(one.A),
                 "delay_s": self.delay_s(one)}
                for one in self.controllers
            ],
            "axes": {axis: analysis.as_json() for axis, analysis in self.axes.items()},
            "stable": self.stable,
            "written": str(self.file),
        }  # fmt: skip


def design_controllers(machine: Machine, goal: DesignGoal, file: Path) -> ControlDesign:
    """Design controllers, and write the machine with them, which is based on ``machine``.

    The file is written only if the machine in it can be read and analysed.

    Raises
    ------
    OptionError
        If an option is out of range or of another design, or the file must not be written.
    MachineError
        If there is no such controller for this machine.
    RecordingError
        If the file cannot be written.
    """
    _check(machine, goal, file)
    command_text = f"threadline control {machine.reference} --design {goal.design}"
    if goal.design == "cross-coupled":
        designs, option_text = _coupled(machine, goal)
    else:
        designs, option_text = _of_regulators(machine, goal)
    with tempfile.TemporaryDirectory() as folder:
        trial_file = Path(folder) / "designed.toml"
        trial_file.write_text(
            overlay_text(machine, _base(machine, None), command_text + option_text, designs)
        )
        axes = analyse(load_machine(trial_file))
    with atomic_file(file) as stream:
        stream.write(
            overlay_text(
                machine, _base(machine, file), command_text + option_text, designs
            ).encode()
        )
    return ControlDesign(
        design=goal.design,
        base=machine,
        machine=load_machine(str(file)),
        controllers=tuple(designs),
        axes=axes,
        file=file,
    )


def _check(machine: Machine, goal: DesignGoal, file: Path) -> None:
    if goal.design not in DESIGNS:
        raise OptionError(
            f"no design {goal.design[:40]!r}", remedy=f"There are: {', '.join(DESIGNS)}."
        )
    for name, designs in _DESIGNS_WITH_OPTION.items():
        if getattr(goal, name) is not None and goal.design not in designs:
            raise OptionError(
                f"--{name} is for the design {' or '.join(designs)}, not for {goal.design}",
                remedy="Leave it out.",
            )
    if not machine.controllers or machine.takes_positions:
        raise OptionError(
            f"machine {machine.name!r} has no control loops, so there is no controller to design",
            remedy="Name a machine with controllers and axes.",
        )
    check_machine_name(file)
    note_input(Path(machine.file))
    check_output(file)


def _of_regulators(machine: Machine, goal: DesignGoal) -> tuple[list[Designed], str]:
    """Return designed regulators for all groups of coupled axes, and the options that were used."""
    gain = 1.0 if goal.gain is None else goal.gain
    ahead = 4 if goal.ahead is None else goal.ahead
    smoothing = 1 if goal.smoothing is None else goal.smoothing
    if not 0.0 < gain <= _MOST_GAIN:
        shown = f"{Decimal(gain):.4g}"  # a whole number from Python may be too large for a float
        raise OptionError(f"--gain {shown} is not above 0 and at most {_MOST_GAIN:g}")
    if not PREVIEW[0] <= ahead <= PREVIEW[1]:
        raise OptionError(f"--ahead {ahead} is not from {PREVIEW[0]} to {PREVIEW[1]}")
    if smoothing % 2 == 0 or not 1 <= smoothing <= _MOST_SMOOTHING:
        raise OptionError(f"--smoothing {smoothing} is no odd number from 1 to {_MOST_SMOOTHING}")
    other_sensors = goal.sensors or ()
    plants = regulators(machine, gain, other_sensors)
    option_text = f" --gain {gain:g}" + (
        f" --sensors {','.join(other_sensors)}" if other_sensors else ""
    )
    if goal.design == "lqg":
        return [lqg(one) for one in plants], option_text
    if goal.design == "preview":
        return [preview(one, ahead) for one in plants], f"{option_text} --ahead {ahead}"
    delay_ticks = max(zero_phase_ticks(one, smoothing) for one in plants)
    designs = [zero_phase(one, delay_ticks, smoothing) for one in plants]
    return designs, f"{option_text} --smoothing {smoothing}"


def _coupled(machine: Machine, goal: DesignGoal) -> tuple[list[Designed], str]:
    """Return the controller of two coupled axes, and the options that were used."""
    pair = _pair(machine, goal.axes)
    angle_rad = parse_number("--direction", goal.direction or "45 deg", "rad", "45 deg")
    coupling = goal.coupling or "50 %"
    weight = parse_number("--coupling", coupling, "", "50 %")
    if not 0.0 <= weight <= _MOST_GAIN:
        raise OptionError(f"--coupling {coupling!r} is not between 0 and {_MOST_GAIN:.0%}")
    option_text = f" --axes {','.join(pair)} --direction {math.degrees(angle_rad):g}deg"
    return [
        cross_coupled(machine, pair, angle_rad, weight)
    ], f"{option_text} --coupling {100 * weight:g}%"


def _pair(machine: Machine, axes: Sequence[str] | None) -> tuple[str, str]:
    linear = [name for name, axis in machine.axes.items() if axis.kind == "linear"]
    names = linear[:2] if axes is None else list(axes)
    if len(names) != 2 or len(set(names)) != 2 or not set(names) <= set(machine.axes):
        raise OptionError(
            f"--axes {', '.join(names)[:40]!r} is no pair of the axes of {machine.name!r}",
            remedy=f"It has: {', '.join(machine.axes)}.",
        )
    return names[0], names[1]


def _base(machine: Machine, file: Path | None) -> str:
    """Return the reference to the machine: relative to a file's folder, or absolute for None."""
    name, overlays = split_reference(machine.reference)
    if name.endswith(".toml"):
        machine_file = Path(machine.file).resolve()
        name = (
            str(machine_file)
            if file is None
            else os.path.relpath(machine_file, file.resolve().parent)
        )
    return "+".join([Path(name).as_posix(), *overlays])


def overlay_text(machine: Machine, base: str, made: str, designs: Sequence[Designed]) -> str:
    """Return a machine file that replaces controllers of ``base`` by designs.

    Parameters
    ----------
    base
        Reference to the machine, as seen from the new file.
    made
        How the numbers were made: one line.
    """
    replaced = [machine.axes[axis].controller for design in designs for axis in design.axes]
    names: list[str] = []
    for design in designs:
        names.append(_controller_name(design.axes, {*machine.controllers, *names}))
    lines = [
        f"# {ascii_only(made)}",
        f"base = {toml_string(base)}",
        "",
        "[controllers]",
        *(f'{name} = "none"' for name in dict.fromkeys(replaced)),
    ]
    for name, design in zip(names, designs, strict=True):
        lines += ["", f"[controllers.{name}]", 'kind = "state-space"', f'clock = "{design.clock}"']
        if design.reference_clock is not None:
            lines.append(f'reference_clock = "{design.reference_clock}"')
        lines += [
            f"references = {_toml_names(design.axes)}",
            f"sensors = {_toml_names(design.sensors)}",
            f"drives = {_toml_names(design.drives)}",
            f"made = {toml_string(made)}",
        ]
        for key in ("A", "B", "C", "D", "L"):
            lines.append(f"{key} = {_toml_matrix(getattr(design, key))}")
        dac = design.dac
        lines += [
            "",
            f"[controllers.{name}.dac]",
            f'bits = "{dac.bits.si:g} bit exact, assumed: as before"',
            f'range = "{dac.range.si!r} V exact, assumed: as before"',
            f"zero_on_reversal = {str(dac.zero_on_reversal).lower()}",
            f'rounding = "{dac.rounding}"',
        ]
    for name, design in zip(names, designs, strict=True):
        for axis in design.axes:
            lines += ["", f"[axes.{axis}]", f'controller = "{name}"']
    return "\n".join(lines) + "\n"


def _controller_name(axes: Sequence[str], taken: set[str]) -> str:
    """Return a name for the controller of the axes that is not in ``taken``."""
    base_name = "-".join(axis.lower() for axis in axes) + "-designed"
    numbered_names = (f"{base_name}-{number}" for number in count(2))
    return (
        base_name
        if base_name not in taken
        else next(one for one in numbered_names if one not in taken)
    )


def _toml_names(names: Sequence[str]) -> str:
    return "[" + ", ".join(f'"{name}"' for name in names) + "]"


def _toml_matrix(matrix: FloatArray) -> str:
    """Return a matrix in TOML, every number with all of its digits."""
    if not matrix.size:
        return "[]"
    rows = ["  [" + ", ".join(f"{float(x)!r}" for x in row) + "]," for row in matrix]
    return "\n".join(["[", *rows, "]"])
