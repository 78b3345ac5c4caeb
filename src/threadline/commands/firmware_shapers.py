"""Input shapers of firmwares for the modes of a machine file, as comments in a program."""

from __future__ import annotations

from collections.abc import Sequence

from threadline.dynamics.without_loop import modes_held
from threadline.machine import Machine
from threadline.motion.shaping.firmwares import (
    damped_frequency_hz,
    marlin_impulses,
    shortest_for_all,
    shortest_type,
)
from threadline.motion.shaping.response import BAND, LEFT, largest_residual
from threadline.motion.shaping.types import FlexibleMode


def klipper_section(machine: Machine, axes: Sequence[str]) -> list[str]:
    """Return the section to paste into ``printer.cfg``, and reasons for axes without a line.

    Each axis gets the shortest type of Klipper that leaves at most ``LEFT`` of the axis' slowest
    mode, wherever the mode lies within ``BAND`` of its frequency.

    Raises
    ------
    MachineError
        If the equations of an axis are not linear, here as in the other functions.
    """
    parameters, modes = _modes(machine, axes, "XYZ", "Klipper", "[input_shaper]")
    section = []
    for axis, (mode, why) in modes.items():
        found = shortest_type(mode)
        if found is None:
            parameters[axis] = (
                f"{why}: no type of Klipper's leaves {LEFT:.0%} within {BAND:.0%} of it"
            )
            continue
        name, left = found
        parameters[axis] = f"{why}: {name} leaves {left:.1%} of it at most, {BAND:.0%} off"
        section += [
            f"shaper_type_{axis.lower()}: {name}",
            f"shaper_freq_{axis.lower()}: {mode.frequency_hz:.6g}",
            f"damping_ratio_{axis.lower()}: {mode.damping_ratio:.6g}",
        ]
    return [*parameters.values(), *(["[input_shaper]", *section] if section else [])]


def marlin_commands(machine: Machine, axes: Sequence[str]) -> list[str]:
    """Return ``M593`` for each axis that Marlin shapes, and how much of the mode its train leaves.

    Marlin has one shaper type; its F is the damped frequency.
    """
    parameters, modes = _modes(machine, axes, "XY", "Marlin", "M593")
    commands = []
    for axis, (mode, why) in modes.items():
        damped_hz = damped_frequency_hz(mode)
        train = marlin_impulses(damped_hz, mode.damping_ratio)
        parameters[axis] = (
            f"{why}: Marlin's ZV leaves {largest_residual(train, [mode], band=0.0):.1%} of it, and "
            f"{largest_residual(train, [mode]):.0%} at most, {BAND:.0%} off"
        )
        commands.append(f"M593 {axis} F{damped_hz:.6g} D{mode.damping_ratio:.6g}")
    return [*parameters.values(), *commands]


def reprap_command(machine: Machine, axes: Sequence[str]) -> list[str]:
    """Return the one ``M593`` of RepRapFirmware for the slowest mode of every axis.

    RepRapFirmware has one train for all axes, and applies it to moves in which X or Y takes part.
    """
    parameters, modes = _modes(machine, axes, "".join(axes), "RepRapFirmware", "M593")
    lines = list(parameters.values())
    if not modes:
        return lines
    found = shortest_for_all([mode for mode, _ in modes.values()])
    which = "it" if len(modes) == 1 else "each"
    if found is None:
        no = f"no type of RepRapFirmware's leaves {LEFT:.0%} within {BAND:.0%} of {which}"
        return [*lines, f"no M593: {no}"]
    return [
        *lines,
        f"{found.type} leaves {found.left:.1%} of {which} at most, {BAND:.0%} off",
        f'M593 P"{found.type}" F{found.frequency_hz:.6g} S{found.damping_ratio:.6g}',
    ]


def _modes(
    machine: Machine, axes: Sequence[str], shaped: str, firmware: str, setting: str
) -> tuple[dict[str, str], dict[str, tuple[FlexibleMode, str]]]:
    """Return a comment for each axis, and the slowest mode of each axis with modes."""
    if machine.without_dynamics:
        return {"": f"no {setting}: the machine file has no dynamics, and no modes"}, {}
    parameters: dict[str, str] = {}
    modes: dict[str, tuple[FlexibleMode, str]] = {}
    for axis in axes:
        held = modes_held(machine, axis) if axis in shaped else ()
        if axis not in shaped:
            parameters[axis] = f"{axis}: {firmware} shapes {', '.join(shaped)} alone"
        elif not held:
            parameters[axis] = f"{axis}: rigid in the machine file, nothing to shape"
        else:
            mode = FlexibleMode(frequency_hz=held[0].frequency_hz, damping_ratio=held[0].damping)
            parameters[axis] = (
                f"{axis}: {mode.frequency_hz:.4g} Hz, damping ratio {mode.damping_ratio:.3g}"
            )
            modes[axis] = mode, parameters[axis]
    return parameters, modes
