"""Judges variants of a machine one by one, for machines that are not simulated many at once."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import MachineError, RecordingError
from threadline.kinds import kind_of
from threadline.kinds.retold import retold
from threadline.machine.variants import uncertain, variant
from threadline.plan import Plan
from threadline.verdict import EachRun, Judge, Spec


class AloneJudge:
    """Judges machines within the tolerances of a plan's, one by one, all under its commands.

    Encoders stand in the middle of a count.
    """

    def __init__(self, plan: Plan, spec: Spec) -> None:
        self._plan = plan
        self._judge = Judge(plan, spec)

    def judged(self, parts: FloatArray, done: Callable[[int], None] | None = None) -> EachRun:
        """Return what comes of machines at (k, n) parts of their tolerances.

        One that cannot be simulated, or that never ends what it waits for, fails every criterion
        that has a limit, with an infinite value.

        Parameters
        ----------
        done
            Called with 1 after each machine.
        """
        found = []
        for row in parts:
            try:
                found.append(self._one(row))
            except (MachineError, RecordingError):
                found.append(self._own.without_answer())
            if done is not None:
                done(1)
        return EachRun.joined(found)

    @cached_property
    def _own(self) -> EachRun:
        """What comes of the machine of the plan."""
        return self._one(np.zeros(len(uncertain(self._plan.machine))))

    def _one(self, row: FloatArray) -> EachRun:
        plan = self._plan
        machine = variant(plan.machine, row)
        return self._judge.each(kind_of(machine).simulate(retold(plan.commands, machine), machine))
