"""What every kind of work defines, so that nothing else asks which kind it has."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.option_table import (
    planned_by,
)
from threadline.options import Options
from threadline.plan import Intent, Plan
from threadline.signals import Commands, Recording
from threadline.targets.write import Target
from threadline.verdict import Spec


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A row of the table of kinds of work.

    Parameters
    ----------
    name
        Value of ``Machine.commanded_by`` for machines of this kind.
    takes
        Names of the formats of jobs that its machines do (``jobs/reading.py``).
    commands, intent
        Type of the commands that its controllers take, and type of what its plans intend. By the
        type of the intent the judge knows how to read a recording (``verdict/intended_runs.py``)
        and a report what to draw (``report/proof.py``).
    check
        Refuses a machine that cannot do any work, before a job is read.
    check_options
        Refuses options that have no meaning for this kind.
    plan
        Returns the plan of a job on a machine.
    simulate
        Returns the recording of one run of the commands on a machine.
    days
        Simulates the commands on a number of days: on the first the machine is as its file says, on
        the others friction, supply and encoder phases are drawn from the generator.
    others
        Simulates the commands on k machines within the tolerances of the file: a (k, n) array
        places each number within its tolerance (``machine/variants.py``), and encoder phases are
        drawn from the generator.
    together
        Whether many machines that differ in numbers alone are simulated in one call.
    asked
        Returns a specification with the criteria added that the options ask to have reported.
    release
        Refuses a plan that must not reach a controller.
    compared
        Options, with their values, that ``compare`` sets side by side by default.
    targets
        Formats in which its plans can be written, by name.
    """

    name: str
    takes: tuple[str, ...]
    commands: type[Commands]
    intent: type[Intent]
    check: Callable[[Machine], None]
    check_options: Callable[[Machine, Options], None]
    plan: Callable[[Job, Machine, Options], Plan]
    simulate: Callable[[Commands, Machine], Recording]
    days: Callable[[Commands, Machine, int, np.random.Generator], Sequence[Recording]]
    others: Callable[[Commands, Machine, FloatArray, np.random.Generator], Sequence[Recording]]
    together: Callable[[Machine], bool]
    asked: Callable[[Spec, Options], Spec]
    release: Callable[[Plan], None]
    compared: Mapping[str, tuple[str, ...]]
    targets: Mapping[str, Target]

    @property
    def planned_by(self) -> tuple[str, ...]:
        """Options of planning that have a meaning for it, as a command line names them."""
        return planned_by(self.name)
