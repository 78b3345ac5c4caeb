"""The winder with a firmware that plans by itself, for tests over every interpolation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from threadline.machine import Machine, load_machine
from threadline.machine.motion_planner import GrblPlanner
from threadline.machine.quantity import parse_machine_quantity

GRBL = GrblPlanner(
    kind="grbl", junction_deviation=parse_machine_quantity("0.01 mm exact, assumed", ("m",))
)


def winder_with_grbl() -> Machine:
    """Return the library's winder with grbl's planner inside."""
    return replace(load_machine("lathe-winder"), planner=GRBL)


def winder_with_grbl_file(folder: Path) -> Path:
    """Write the same as a machine file."""
    file = folder / "winder-with-grbl.toml"
    file.write_text(
        'base = "lathe-winder"\n\n[planner]\nkind = "grbl"\n'
        'junction_deviation = "0.01 mm exact, assumed"\n'
    )
    return file
