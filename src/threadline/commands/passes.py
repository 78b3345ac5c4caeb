"""A winding as a part program of its circuits: a subroutine and its passes.

The moves come from the design, with the times in which the fibre has its speed; the control
plans the motion. The chords of a planned motion (``nc``) do not repeat: a plan begins and ends at
rest, and its chords lie elsewhere in every circuit.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.writing import staged_file
from threadline.commands.nc import NcStyle, part_program_lines
from threadline.errors import OptionError, PlanError
from threadline.jobs.gcode import read_part_program
from threadline.jobs.operations import Job, Move, MoveRun
from threadline.machine import Machine

_NEAR_M = 1e-5  # rotary axes at their radius
_NONE: Mapping[str, str] = {
    "grbl": "grbl has no subprograms",
    "fluidnc": "FluidNC has no subprograms (its loops are not written)",
    "marlin": "Marlin has no subprograms within a program (M32 P calls another file of the card)",
    "klipper": "Klipper has no subprograms within a program (its macros are in its configuration)",
    "reprapfirmware": "RepRapFirmware has no subprograms within a program (M98 calls a macro file)",
}
_STYLE_OF_TARGET = {"nc": NcStyle.LINUXCNC}


def write_passes(job: Job, machine: Machine, path: Path, dialect: str | None = None) -> str:
    """Write a job with equal passes as calls of subroutines, in a dialect, or in the machine's.

    The program is read back and compared with the job. Returns the size of the program beside that
    of the same moves one by one, for people.

    Raises
    ------
    OptionError
        If the control has no subroutines.
    PlanError
        If a part program has no word for a part of the job, or the program read back is another.
    """
    dialect = check_passes(dialect or machine.programs.dialect)
    sizes = []
    with staged_file(path) as stream:
        for passes in (False, True):
            size = 0
            for line in part_program_lines(job, machine, style=dialect, subroutines=passes):
                text = f"{line}\n".encode()
                size += len(text)
                if passes:
                    stream.write(text)
            sizes.append(size)
        stream.flush()
        off_m = _off(job, machine, Path(stream.name), dialect)
    whole, short = sizes
    summary = f"{short} bytes, {whole} with every move written out"
    if short >= whole:
        summary += ": passes save nothing, because no part is long and repeats"
    return f"{summary}; read back within {1e3 * off_m:.1g} mm"


def check_passes(control: str) -> NcStyle:
    """Return the style of programs with passes for a dialect or target.

    Raises
    ------
    OptionError
        If the control has no subroutines; says which has them.
    """
    known = _STYLE_OF_TARGET.get(control)
    if known is not None:
        return known
    if control not in set(NcStyle):
        why = _NONE.get(control, f"{control[:40]!r} is no format of a part program")
        raise OptionError(
            f"{why}: programs of passes are written for winder, linuxcnc and fanuc",
            remedy="Write linuxcnc or fanuc, or every move with threadline compile.",
        )
    return NcStyle(control)


def _off(job: Job, machine: Machine, path: Path, dialect: str) -> float:
    """Return the largest distance, m, of the moves of a program from the moves of a job."""
    radius = machine.radius_m[[machine.axis_names.index(axis) for axis in job.axes]]
    again = read_part_program(path, machine=machine, dialect=dialect)
    order = [again.axes.index(axis) for axis in job.axes]
    wanted, found = _ends(job), _ends(again)[:, order]
    if wanted.shape != found.shape:
        raise _another(f"{len(found)} moves instead of {len(wanted)}")
    off = float(np.abs((found - wanted) * radius).max())
    if off > _NEAR_M:
        raise _another(f"{1e3 * off:.3g} mm beside the job")
    return off


def _ends(job: Job) -> FloatArray:
    """Return where every move of a job ends: (moves, axes), m or rad."""
    ends = [np.empty((0, len(job.axes)))]
    for item in job.runs():
        if isinstance(item, MoveRun):
            ends.append(item.targets)
        elif isinstance(item, Move):
            ends.append(np.array([item.target]))
    return np.concatenate(ends)


def _another(what: str) -> PlanError:
    return PlanError(
        f"the program, read back, is not the job: {what}",
        remedy="Report it with the product and the machine file.",
    )
