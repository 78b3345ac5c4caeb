"""What every kind of work defines, so that nothing else asks which kind it has."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.jobs.operations import Job
from threadline.machine import Machine
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
        What a machine of this kind says that it is commanded by (``Machine.commanded_by``).
    commands, intent
        What its controllers are given, and what its plans intend. By the type of the intent the
        judge knows how to read a recording (``verdict/intended_runs.py``) and a report what to draw
        (``report/proof.py``).
    check
        Refuses a machine that cannot do any work, before anything is read.
    check_options
        Refuses options that mean nothing to it.
    plan
        Job, machine and options to a plan.
    simulate
        What happens when the machine plays the commands once.
    days
        Runs of the machine on so many days: first as its file says, then with other friction,
        supply and phases, drawn from the generator.
    others
        Runs of other machines of the same file, each number at some (k, n) parts of its tolerance
        (``machine/variants.py``), with phases drawn from the generator.
    together
        Whether machines that differ in numbers alone are simulated many at once.
    asked
        A specification and options to the specification with what the options ask to be reported.
    release
        Refuses a plan that no controller may be given.
    compared
        What ``compare`` sets side by side unless told otherwise: options with their values.
    targets
        What its plans can be written as, by name.
    """

    name: str
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
