"""Firmwares that programs are written for: limits of a board, and words that it knows.

A part program switches spindles, lasers, pens, coolants and fans, and changes tools. In a program
for the job's own firmware these words stay as they are. In a program for another firmware a word is
accepted only if it means the same to both. For example, M4 turns a spindle in reverse in LinuxCNC
and makes the laser power follow the speed in grbl; S of Marlin is a share of 255, not a speed.

Sources: grbl 1.1 and FluidNC (``gcode.c``, ``GCode.cpp``), LinuxCNC's and Fanuc's lists of M codes,
marlinfw.org/meta/gcode, Klipper's and RepRapFirmware's G-code documentation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from threadline.errors import Place, PlanError
from threadline.jobs.operations import Job, Move, MoveRun, Stop, ToolEvent
from threadline.machine import Machine
from threadline.machine.motion_planner import LinuxCncPlanner
from threadline.machine.quantity import parse_machine_quantity


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """First and last lines of a firmware's programs, and limits of its board.

    Parameters
    ----------
    begin, end
        First and last lines of a program.
    longest
        Longest line in characters, without the line end.
    bytes_s
        Characters per second of the serial port; 0 if the board reads files.
    pause
        Word of a dwell, and its units per second.
    planner
        Kind of the ``[planner]`` of machines with this firmware; empty if none is known.
    stops
        Whether M0 is a stop for the firmware.
    rezero
        Word that sets the firmware's own position of an axis; empty if it has none. G92 of grbl,
        FluidNC and Marlin only shifts the numbers of the program.
    head
        Function that returns comments about a machine and the axes of a job, for the first lines.
    """

    begin: tuple[str, ...]
    end: tuple[str, ...]
    longest: int
    bytes_s: int = 0
    pause: tuple[str, int] = ("P", 1)
    planner: str = ""
    stops: bool = True
    rezero: str = ""
    head: Callable[[Machine, Sequence[str]], list[str]] | None = None


def _shaper_lines(name: str) -> Callable[[Machine, Sequence[str]], list[str]]:
    """Return a function of ``firmware_shapers``, which is imported when it is first called."""

    def head(machine: Machine, axes: Sequence[str]) -> list[str]:
        found: list[str] = getattr(import_module("threadline.commands.firmware_shapers"), name)(
            machine, axes
        )
        return found

    return head


_P_MM = "0.01"  # P of G64: as large as the chord tolerance of a plan
LINUXCNC_BLENDS = LinuxCncPlanner(
    kind="linuxcnc", tolerance=parse_machine_quantity(f"{_P_MM} mm exact, assumed", ("m",))
)
"""Blending of programs for LinuxCNC: each program states this P."""
BOARDS: Mapping[str, Board] = {
    "grbl": Board(
        begin=("G21 G90 G94 G17",), end=("M30",), longest=79, bytes_s=11_520, planner="grbl"
    ),
    "fluidnc": Board(begin=("G21 G90 G94 G17",), end=("M30",), longest=127, planner="grbl"),
    "marlin": Board(
        begin=("G21", "G90"),
        end=("M400",),
        longest=95,
        bytes_s=11_520,
        pause=("P", 1000),
        planner="marlin",
        rezero="G92.9",
        head=_shaper_lines("marlin_commands"),
    ),
    "klipper": Board(
        begin=("G21", "G90"),
        end=("M400",),
        longest=255,
        pause=("P", 1000),
        planner="klipper",
        stops=False,
        head=_shaper_lines("klipper_section"),
    ),
    "reprapfirmware": Board(
        begin=("G21", "G90"),
        end=("M400",),
        longest=255,
        pause=("P", 1000),
        planner="reprapfirmware",
        rezero="G92",
        stops=False,
        head=_shaper_lines("reprap_command"),
    ),
    "linuxcnc": Board(
        begin=("G21 G90 G94 G17", f"G64 P{_P_MM}"), end=("M2",), longest=252, planner="linuxcnc"
    ),
    "fanuc": Board(
        begin=("%", "O1", "G21 G90 G94 G17"), end=("M30", "%"), longest=127, pause=("X", 1)
    ),
}
"""Board of each target. Serial ports run at 115200 baud."""


_SHOWN = 5
_CNC = frozenset({"grbl", "fluidnc", "linuxcnc", "fanuc"})
_TURNS_BACK = frozenset({"linuxcnc", "fanuc"})
_PRINTERS = frozenset({"marlin", "klipper", "reprapfirmware"})
_CHANGES = frozenset({"linuxcnc", "fanuc", "fluidnc"})
_SAME: Mapping[str, tuple[frozenset[str], ...]] = {
    "M0": (frozenset({"winder", *_CNC, "marlin"}),),
    "M1": (_TURNS_BACK,),
    "M3": (_CNC,),
    "M4": (_TURNS_BACK, frozenset({"grbl", "fluidnc"})),
    "M5": (frozenset({"winder", *_CNC, "marlin", "reprapfirmware"}),),
    "M6": (_CHANGES,),
    "M7": (_CNC | {"marlin"},),
    "M8": (_CNC | {"marlin"},),
    "M9": (_CNC | {"marlin"},),
    "M17": (frozenset({"marlin", "reprapfirmware"}),),
    **dict.fromkeys(("M62", "M63", "M64", "M65"), (frozenset({"linuxcnc", "fluidnc"}),)),
    **dict.fromkeys(
        ("M18", "M82", "M83", "M84", "M104", "M106", "M107", "M109", "M140", "M190", "G28"),
        (_PRINTERS,),
    ),
    **dict.fromkeys(("G55", "G56", "G57", "G58", "G59"), (_CNC,)),
    **dict.fromkeys(("G43", "G49"), (frozenset({"linuxcnc"}),)),
    "G92": (_CNC | _PRINTERS,),
    "S": (_CNC,),
    "T": (_CHANGES,),
}
"""For each word (S and T: their letter), groups of firmwares that give it the same meaning."""
_ARGUMENTS = frozenset("SXYZABCUVW")
"""Argument letters whose meaning follows from their word; P and others name a pin."""


def firmware_of(job: Job, machine: Machine) -> str:
    """Return the firmware of a job's program; for Marlin's dialect, the machine's firmware."""
    planner = machine.planner
    if job.dialect == "marlin" and planner is not None and planner.kind in _PRINTERS:
        return planner.kind
    return job.dialect


def read_written(path: Path, machine: Machine, target: str) -> Job:
    """Return the job of a program that was written for a target.

    Macros of the job are in the program, too; they move nothing in the job or in the program.
    """
    from threadline.jobs.gcode import read_part_program

    without = "macros=none" if target == "klipper" else None
    return read_part_program(path, machine=machine, dialect=target, axes=without)


def working_words(job: Job) -> Iterator[tuple[int, str]]:
    """Yield line and text of every word that switches or controls the machine, in order."""
    for item in job.runs():
        if isinstance(item, MoveRun):
            yield from ((act.source.line, act.words) for _, acts in item.acts for act in acts)
        elif isinstance(item, Move):
            yield from ((act.source.line, act.words) for act in item.acts)
        elif isinstance(item, ToolEvent | Stop) and item.words:
            yield item.source.line, item.words


def refuse_lost(job: Job, machine: Machine, target: str) -> None:
    """Refuse to write a job for a target that reads a word of the job differently or not at all.

    Parameters
    ----------
    target
        A firmware of ``BOARDS``.

    Raises
    ------
    PlanError
        If there is such a word, the message names the first few words with their lines. Also if an
        axis is wrapped: written programs count angles past one turn.
    """
    for name, axis in machine.axes.items():
        if axis.wrapped and name in job.axes:
            raise PlanError(
                f"axes.{name} is wrapped: its control reads angles within one turn, and the "
                "written program counts on past 360 degrees",
                remedy=f"Set WRAPPED_ROTARY = 0 in [AXIS_{name}] of the control, and remove "
                "wrapped from the machine file.",
            )
    source = firmware_of(job, machine).removesuffix("-cnc")  # a mode of the same firmware
    if source == target:
        return
    lost = {found: None for found in working_words(job) if not _goes_over(found[1], source, target)}
    if not lost:
        return
    named = ", ".join(f"{words} (line {line})" for line, words in list(lost)[:_SHOWN])
    more = f" and {len(lost) - _SHOWN} more" if len(lost) > _SHOWN else ""
    own = f"write it for {source}, " if source in BOARDS else ""
    count = "1 word that switches" if len(lost) == 1 else f"{len(lost)} words that switch"
    raise PlanError(
        f"{count} the machine would be lost or mean something else in a program for {target}: "
        f"{named}{more}",
        place=Place(job.file, next(iter(lost))[0]),
        remedy=f"Take them out of {job.name}, {own}or write csv or npz.",
    )


def _goes_over(words: str, source: str, target: str) -> bool:
    """Say whether all words of a text mean the same to two firmwares."""
    parts = words.split()
    one_command = source in _PRINTERS
    if one_command and parts[0] in {"M0", "M1"} and len(parts) > 1:
        return False  # a stop with an argument ends by itself after a time
    for at, word in enumerate(parts):
        if at and (one_command or word[0] not in "MGST"):
            if word[0] not in _ARGUMENTS and (one_command or word[0] != "P"):
                return False
            continue
        command = word if word[0] in "MG" else word[0]
        if not any({source, target} <= group for group in _SAME.get(command, ())):
            return False
    return True
