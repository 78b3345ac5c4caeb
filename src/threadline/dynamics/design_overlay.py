"""Machine files with a designed controller: the base, and what replaces its controllers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count

from threadline.base.arrays import FloatArray
from threadline.base.wording import ascii_only, toml_string
from threadline.dynamics.state_designs import Designed
from threadline.machine import Machine


def overlay_text(machine: Machine, base: str, made: str, designs: Sequence[Designed]) -> str:
    """Return a machine file that replaces controllers of ``base`` by designs.

    Parameters
    ----------
    base
        Reference to the machine, as seen from the new file.
    made
        How the numbers were made: one line.
    """
    gone = [machine.axes[axis].controller for design in designs for axis in design.axes]
    names: list[str] = []
    for design in designs:
        names.append(_name(design.axes, {*machine.controllers, *names}))
    lines = [
        f"# {ascii_only(made)}",
        f"base = {toml_string(base)}",
        "",
        "[controllers]",
        *(f'{name} = "none"' for name in dict.fromkeys(gone)),
    ]
    for name, design in zip(names, designs, strict=True):
        lines += ["", f"[controllers.{name}]", 'kind = "state-space"', f'clock = "{design.clock}"']
        if design.reference_clock is not None:
            lines.append(f'reference_clock = "{design.reference_clock}"')
        lines += [
            f"references = {_names(design.axes)}",
            f"sensors = {_names(design.sensors)}",
            f"drives = {_names(design.drives)}",
            f"made = {toml_string(made)}",
        ]
        for key in ("A", "B", "C", "D", "L"):
            lines.append(f"{key} = {_matrix(getattr(design, key))}")
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


def _name(axes: Sequence[str], taken: set[str]) -> str:
    """Return a name for the controller of axes: a machine may have a design before this one."""
    first = "-".join(axis.lower() for axis in axes) + "-designed"
    others = (f"{first}-{number}" for number in count(2))
    return first if first not in taken else next(one for one in others if one not in taken)


def _names(names: Sequence[str]) -> str:
    return "[" + ", ".join(f'"{name}"' for name in names) + "]"


def _matrix(matrix: FloatArray) -> str:
    """Return a matrix in TOML, every number with all of its digits."""
    if not matrix.size:
        return "[]"
    rows = ["  [" + ", ".join(f"{float(x)!r}" for x in row) + "]," for row in matrix]
    return "\n".join(["[", *rows, "]"])
