"""Which words that work a machine beside its axes a target takes, with the meaning they have.

A part program switches spindles, lasers, pens, coolants and fans, and changes tools. Written for
the firmware that it was made for, its words go over as they are. For another firmware each is
taken only where both know it as the same: M4 turns a spindle the other way round in LinuxCNC and
makes the power of a laser follow its speed in grbl, S of Marlin is a share of 255 and no speed.

Sources: grbl 1.1 and FluidNC (``gcode.c``, ``GCode.cpp``), LinuxCNC's and Fanuc's lists of M codes,
marlinfw.org/meta/gcode, Klipper's and RepRapFirmware's documents of G-codes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from threadline.errors import Place, PlanError
from threadline.jobs.operations import Job, Move, MoveRun, Stop, ToolEvent
from threadline.machine import Machine
from threadline.targets.boards import BOARDS

_SHOWN = 5
_CNC = frozenset({"grbl", "fluidnc", "linuxcnc", "fanuc"})
_TURNS_BACK = frozenset({"linuxcnc", "fanuc"})
_PRINTERS = frozenset({"marlin", "klipper", "reprapfirmware"})
_CHANGES = frozenset({"linuxcnc", "fanuc", "fluidnc"})
_SAME: Mapping[str, tuple[frozenset[str], ...]] = {
    "M0": (frozenset({"winder", *_CNC, "marlin", "reprapfirmware"}),),
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
    "G92": (_CNC | _PRINTERS,),
    "S": (_CNC,),
    "T": (_CHANGES,),
}
"""By word (S and T by their letter), the firmwares between which it means the same."""
_ARGUMENTS = frozenset("SXYZABCUVW")
"""Letters behind a word that mean the same wherever it does; P and the like name a pin there."""


def firmware_of(job: Job, machine: Machine) -> str:
    """Return the firmware that a program was made for: of Marlin's dialect that of the machine."""
    planner = machine.planner
    if job.dialect == "marlin" and planner is not None and planner.kind in _PRINTERS:
        return planner.kind
    return job.dialect


def working_words(job: Job) -> Iterator[tuple[int, str]]:
    """Yield line and text of every word that works a machine, in order."""
    for item in job.runs():
        if isinstance(item, MoveRun):
            yield from ((act.source.line, act.words) for _, acts in item.acts for act in acts)
        elif isinstance(item, Move):
            yield from ((act.source.line, act.words) for act in item.acts)
        elif isinstance(item, ToolEvent | Stop) and item.words:
            yield item.source.line, item.words


def refuse_lost(job: Job, machine: Machine, target: str) -> None:
    """Refuse to write a job for a target that does not take all of its words as they are meant.

    Parameters
    ----------
    target
        A firmware of ``BOARDS``.

    Raises
    ------
    PlanError
        With each word and its line, a few of them where they are many.
    """
    source = firmware_of(job, machine)
    if source == target:
        return
    lost = {found: None for found in working_words(job) if not _goes_over(found[1], source, target)}
    if not lost:
        return
    named = ", ".join(f"{words} (line {line})" for line, words in list(lost)[:_SHOWN])
    more = f" and {len(lost) - _SHOWN} more" if len(lost) > _SHOWN else ""
    own = f"write it for {source}, " if source in BOARDS else ""
    count = "1 word that works" if len(lost) == 1 else f"{len(lost)} words that work"
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
        return False  # it goes on by itself after a time
    for at, word in enumerate(parts):
        if at and (one_command or word[0] not in "MGST"):
            if word[0] not in _ARGUMENTS and (one_command or word[0] != "P"):
                return False
            continue
        command = word if word[0] in "MG" else word[0]
        if not any({source, target} <= group for group in _SAME.get(command, ())):
            return False
    return True
