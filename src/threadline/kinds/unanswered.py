"""Machines within the tolerances that never reach the end of a job: out of specification."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import MachineError, RecordingError
from threadline.kinds.kind import Kind
from threadline.machine import Machine
from threadline.signals import Commands, Recording
from threadline.verdict import Result, Status

UNANSWERED = "unanswered"


def answering(
    kind: Kind, commands: Commands, machine: Machine, parts: FloatArray, random: np.random.Generator
) -> tuple[list[Recording], list[str]]:
    """Return recordings of the machines that reach the end, and the reason of each other one.

    Every recording is read through once.

    Parameters
    ----------
    parts
        (k, n) place of each of the n numbers of k machines within its tolerance.
    random
        Generator from which encoder phases are drawn.
    """
    if not len(parts):
        return [], []
    try:
        found = list(kind.others(commands, machine, parts, random))
        for recording in found:
            for _ in recording:
                pass
        return found, []
    except (MachineError, RecordingError) as error:
        if len(parts) == 1:
            return [], [error.message]
        half = len(parts) // 2
        first, why_first = answering(kind, commands, machine, parts[:half], random)
        second, why_second = answering(kind, commands, machine, parts[half:], random)
        return first + second, why_first + why_second


def unanswered(machines: int, why: list[str]) -> Result:
    """Return the criterion that all of ``machines`` reach the end of the job.

    Measured is the share of machines that do not; ``why`` has the reason for each of those.
    """
    return Result(
        name=UNANSWERED,
        axis="",
        measured=len(why) / machines,
        limit=0.0,
        unit="",
        status=Status.FAILED,
        required=True,
        note=f"{len(why)} of {machines} machines within the tolerances never end: {why[0]}",
    )
