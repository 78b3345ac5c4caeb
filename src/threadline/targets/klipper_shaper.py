"""Klipper's ``[input_shaper]`` for the modes of a machine file, as comments of a program."""

from __future__ import annotations

from collections.abc import Sequence

from threadline.machine import Machine
from threadline.plant.without_loop import modes_held
from threadline.shaping.klipper import BAND, LEFT, shortest_type
from threadline.shaping.types import FlexibleMode

SHAPED = "XYZ"
"""The axes that Klipper shapes."""


def input_shaper(machine: Machine, axes: Sequence[str]) -> list[str]:
    """Return the section to paste into ``printer.cfg``, and why an axis has no line in it.

    Each axis gets Klipper's shortest type that leaves at most ``LEFT`` of its slowest mode
    wherever that is within ``BAND`` of its frequency.

    Raises
    ------
    MachineError
        If the equations of an axis are not linear.
    """
    if machine.without_dynamics:
        return ["no [input_shaper]: the machine file has no dynamics, and no modes"]
    section, said = [], []
    for axis in axes:
        if axis not in SHAPED:
            said.append(f"{axis}: Klipper shapes {', '.join(SHAPED)} alone")
            continue
        modes = modes_held(machine, axis)
        if not modes:
            said.append(f"{axis}: rigid in the machine file, nothing to shape")
            continue
        mode = FlexibleMode(frequency_hz=modes[0].frequency_hz, damping_ratio=modes[0].damping)
        found = shortest_type(mode)
        what = f"{axis}: {mode.frequency_hz:.4g} Hz, damping ratio {mode.damping_ratio:.3g}"
        if found is None:
            said.append(f"{what}: no type of Klipper's leaves {LEFT:.0%} within {BAND:.0%} of it")
            continue
        name, left = found
        said.append(f"{what}: {name} leaves {left:.1%} of it at most, {BAND:.0%} off")
        section += [
            f"shaper_type_{axis.lower()}: {name}",
            f"shaper_freq_{axis.lower()}: {mode.frequency_hz:.6g}",
            f"damping_ratio_{axis.lower()}: {mode.damping_ratio:.6g}",
        ]
    return [*said, *(["[input_shaper]", *section] if section else [])]
