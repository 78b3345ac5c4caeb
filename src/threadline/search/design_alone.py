"""What a candidate of a redesign uses of its limits, where machines are simulated one by one."""

from __future__ import annotations

from collections.abc import Callable

from threadline.errors import MachineError, PlanError, RecordingError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.options import Options
from threadline.pipeline import NOMINAL, Trials, plan_job, prove_plan
from threadline.search.design_judge import HOPELESS
from threadline.verdict import Spec, Status, Verdict

NO_COMMANDS = "no commands"
"""The criterion of a candidate that cannot be planned for, or that never ends the job."""


class AloneProofs:
    """Proves candidates one by one, each with a plan of its own.

    Parameters
    ----------
    read
        Reads the job for a machine.
    spec, options
        How well the machine shall do it, and how it is planned.
    repeats
        Runs of a candidate that is in specification in the first.
    """

    def __init__(
        self, read: Callable[[Machine], Job], spec: Spec, options: Options, repeats: int
    ) -> None:
        self._read, self._spec, self._options, self._repeats = read, spec, options, repeats
        self.simulated = 0

    def used(self, machine: Machine, beyond: float) -> tuple[float, float, str]:
        """Return the share of its limits that a machine uses in one run and at worst, and of which.

        Parameters
        ----------
        beyond
            Further runs are tried where the share in one is at most this.
        """
        try:
            plan = plan_job(self._read(machine), machine, self._options)
            first, binding = share_used(prove_plan(plan, self._spec, trials=NOMINAL).verdict)
            self.simulated += 1
            if first > beyond or self._repeats == 1:
                return first, first, binding
            trials = Trials(repeats=self._repeats)
            worst, binding = share_used(prove_plan(plan, self._spec, trials=trials).verdict)
            self.simulated += self._repeats
        except (PlanError, MachineError, RecordingError):
            return HOPELESS, HOPELESS, NO_COMMANDS
        return first, worst, binding


def share_used(verdict: Verdict) -> tuple[float, str]:
    """Return the largest share of a limit that is used, at most 1000, and the criterion.

    The machine's own limits count where they are broken alone: a plan is made to use them. What is
    not proven for another reason than a limit counts as 1000.
    """
    shares = {
        f"{r.name} {r.axis}".strip(): min(r.measured / r.limit, HOPELESS) if r.limit > 0.0
        else HOPELESS * (r.status is Status.FAILED)
        for r in verdict.results
        if r.limit is not None and r.measured is not None
        and (not r.hard or r.status is Status.FAILED)
    }  # fmt: skip
    binding = max(shares, key=lambda name: shares[name], default="")
    share = shares.get(binding, 0.0)
    if not verdict.passed and share <= 1.0:
        lacking = [r.name for r in verdict.results if r.required and r.measured is None]
        return HOPELESS, next(iter(lacking), binding)
    return share, binding
