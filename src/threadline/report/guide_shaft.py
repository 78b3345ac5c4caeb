"""The part of a guide that the main shaft of an embroidery machine has."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees

from threadline.machine import Machine


def shaft_rows(machine: Machine) -> Iterator[tuple[str, ...]]:
    """Return the rows of the table of signals that tell of the shaft; none without one."""
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
    """Return the steps of calibration of the shaft, turned by hand; none without one."""
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
