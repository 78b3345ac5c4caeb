"""Input shapers of firmwares for the modes of a machine file, as comments in a program."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from threadline.dynamics.without_loop import modes_held
from threadline.machine import Machine
from threadline.motion.shaping.firmwares import (
    damped_frequency_hz,
    marlin_impulses,
    shortest_for_all,
    shortest_type,
)
from threadline.motion.shaping.response import BAND, LEFT, most_left
from threadline.motion.shaping.types import FlexibleMode

_KLIPPER_AXES, _MARLIN_AXES = "XYZ", "XY"


def klipper_section(machine: Machine, axes: Sequence[str]) -> list[str]:
    """Return the section to paste into ``printer.cfg``, and reasons for axes without a line.

    Each axis gets the shortest type of Klipper that leaves at most ``LEFT`` of the axis' slowest
    mode, wherever the mode lies within ``BAND`` of its frequency.

    Raises
    ------
    MachineError
        If the equations of an axis are not linear.
    """
    if machine.without_dynamics:
        return ["no [input_shaper]: the machine file has no dynamics, and no modes"]
    section, said = [], []
    for axis, mode, why in _modes(machine, axes, _KLIPPER_AXES, "Klipper"):
        if mode is None:
            said.append(why)
            continue
        found = shortest_type(mode)
        if found is None:
            said.append(f"{why}: no type of Klipper's leaves {LEFT:.0%} within {BAND:.0%} of it")
            continue
        name, left = found
        said.append(f"{why}: {name} leaves {left:.1%} of it at most, {BAND:.0%} off")
        section += [
            f"shaper_type_{axis.lower()}: {name}",
            f"shaper_freq_{axis.lower()}: {mode.frequency_hz:.6g}",
            f"damping_ratio_{axis.lower()}: {mode.damping_ratio:.6g}",
        ]
    return [*said, *(["[input_shaper]", *section] if section else [])]


def marlin_commands(machine: Machine, axes: Sequence[str]) -> list[str]:
    """Return ``M593`` for each axis that Marlin shapes, and how much of the mode its train leaves.

    Marlin has one shaper type; its F is the damped frequency.

    Raises
    ------
    MachineError
        If the equations of an axis are not linear.
    """
    if machine.without_dynamics:
        return ["no M593: the machine file has no dynamics, and no modes"]
    said, commands = [], []
    for axis, mode, why in _modes(machine, axes, _MARLIN_AXES, "Marlin"):
        if mode is None:
            said.append(why)
            continue
        damped_hz = damped_frequency_hz(mode)
        train = marlin_impulses(damped_hz, mode.damping_ratio)
        said.append(
            f"{why}: Marlin's ZV leaves {most_left(train, [mode], band=0.0):.1%} of it, and "
            f"{most_left(train, [mode]):.0%} at most, {BAND:.0%} off"
        )
        commands.append(f"M593 {axis} F{damped_hz:.6g} D{mode.damping_ratio:.6g}")
    return [*said, *commands]


def reprap_command(machine: Machine, axes: Sequence[str]) -> list[str]:
    """Return the one ``M593`` of RepRapFirmware for the slowest mode of every axis.

    RepRapFirmware has one train for all axes, and applies it to moves in which X or Y takes part.

    Raises
    ------
    MachineError
        If the equations of an axis are not linear.
    """
    if machine.without_dynamics:
        return ["no M593: the machine file has no dynamics, and no modes"]
    said, modes = [], []
    for _, mode, why in _modes(machine, axes, "".join(axes), "RepRapFirmware"):
        said.append(why)
        if mode is not None:
            modes.append(mode)
    if not modes:
        return said
    found = shortest_for_all(modes)
    which = "it" if len(modes) == 1 else "each"
    if found is None:
        return [
            *said,
            f"no M593: no type of RepRapFirmware's leaves {LEFT:.0%} within {BAND:.0%} of {which}",
        ]
    return [
        *said,
        f"{found.type} leaves {found.left:.1%} of {which} at most, {BAND:.0%} off",
        f'M593 P"{found.type}" F{found.frequency_hz:.6g} S{found.damping_ratio:.6g}',
    ]


def _modes(
    machine: Machine, axes: Sequence[str], shaped: str, firmware: str
) -> Iterator[tuple[str, FlexibleMode | None, str]]:
    """Yield each axis with its slowest mode, or None, and a comment about the axis."""
    for axis in axes:
        if axis not in shaped:
            yield axis, None, f"{axis}: {firmware} shapes {', '.join(shaped)} alone"
            continue
        held = modes_held(machine, axis)
        if not held:
            yield axis, None, f"{axis}: rigid in the machine file, nothing to shape"
            continue
        mode = FlexibleMode(frequency_hz=held[0].frequency_hz, damping_ratio=held[0].damping)
        said = f"{axis}: {mode.frequency_hz:.4g} Hz, damping ratio {mode.damping_ratio:.3g}"
        yield axis, mode, said
