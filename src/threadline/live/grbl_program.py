"""A plan as the program that a controller with grbl is sent."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from contextvars import Context
from pathlib import Path

from threadline.kinds import kind_of
from threadline.live.grbl_controller import units_of
from threadline.live.grbl_words import Program, program_of, runs_out
from threadline.live.ways import way_of
from threadline.plan import Plan


def written_program(plan: Plan) -> tuple[Program, Mapping[str, bytes]]:
    """Return the program of a plan, and the file that it was read from, by its name.

    Raises
    ------
    PlanError
        If it holds what grbl would act on at once.
    """
    machine = plan.machine
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "program.nc"
        # In a context of its own it is there at once, and no output of the command.
        Context().run(kind_of(machine).targets["grbl"].write, plan, file)
        text = file.read_bytes()
    starts = way_of(machine).start(plan.commands) / machine.counts_per_unit
    program = program_of(text, machine.axis_names, units_of(machine), starts)
    return program, {file.name: text}


def notes_on(program: Program, blocks: int) -> tuple[str, ...]:
    """Return what the operator has to know before a program is sent.

    Parameters
    ----------
    blocks
        Blocks that the controller's planner holds.
    """
    goes_s, _ = runs_out(program, blocks)
    return (
        "grbl plans its own ramps: what is proved is the program's path, not its timing",
        f"if the link is lost, the controller runs out its own buffer: up to {goes_s:.1f} s at "
        "these feeds",
    )
