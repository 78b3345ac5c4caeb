"""The firmwares that programs are written for: how one begins and ends, and what a board takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from threadline.machine import Machine
from threadline.machine.motion_planner import LinuxCncPlanner
from threadline.machine.quantity import parse_machine_quantity
from threadline.targets.firmware_shapers import (
    klipper_section,
    marlin_commands,
    reprap_command,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """How a program for a firmware begins and ends, and what it takes.

    Parameters
    ----------
    begin, end
        First and last lines of a program.
    longest
        Characters of a line, its end not counted.
    bytes_s
        Characters a second that its port takes; 0 where it reads files.
    pause
        The word of a dwell, and how many of its units a second has.
    planner
        Kind of the ``[planner]`` of machines with this firmware; empty where none is known.
    dialect
        In which it is written and read back; empty for the one of its own name.
    stops
        Whether it knows M0.
    head
        Returns comments about a machine and the axes of a job, which come first.
    """

    begin: tuple[str, ...]
    end: tuple[str, ...]
    longest: int
    bytes_s: int = 0
    pause: tuple[str, int] = ("P", 1)
    planner: str = ""
    dialect: str = ""
    stops: bool = True
    head: Callable[[Machine, Sequence[str]], list[str]] | None = None


_P_MM = "0.01"  # of G64: what the chords of a plan leave of it, once more
LINUXCNC_BLENDS = LinuxCncPlanner(
    kind="linuxcnc", tolerance=parse_machine_quantity(f"{_P_MM} mm exact, assumed", ("m",))
)
"""How programs for LinuxCNC are blended: by the P that they say."""
BOARDS: Mapping[str, Board] = {
    "grbl": Board(
        begin=("G21 G90 G94 G17",), end=("M30",), longest=79, bytes_s=11_520, planner="grbl"
    ),
    "fluidnc": Board(begin=("G21 G90 G94 G17",), end=("M30",), longest=254, planner="grbl"),
    "marlin": Board(
        begin=("G21", "G90"),
        end=("M400",),
        longest=95,
        bytes_s=11_520,
        pause=("P", 1000),
        planner="marlin",
        head=marlin_commands,
    ),
    "klipper": Board(
        begin=("G21", "G90"),
        end=("M400",),
        longest=255,
        pause=("P", 1000),
        planner="klipper",
        dialect="marlin",
        stops=False,
        head=klipper_section,
    ),
    "reprapfirmware": Board(
        begin=("G21", "G90"),
        end=("M400",),
        longest=255,
        pause=("P", 1000),
        planner="reprapfirmware",
        dialect="marlin",
        stops=False,
        head=reprap_command,
    ),
    "linuxcnc": Board(
        begin=("G21 G90 G94 G17", f"G64 P{_P_MM}"), end=("M2",), longest=255, planner="linuxcnc"
    ),
    "fanuc": Board(
        begin=("%", "O1", "G21 G90 G94 G17"), end=("M30", "%"), longest=127, pause=("X", 1)
    ),
}
"""By target. Serial ports are those of 115200 baud."""


def dialect_of(target: str) -> str:
    """Return the dialect that a target is written in."""
    return BOARDS[target].dialect or target
