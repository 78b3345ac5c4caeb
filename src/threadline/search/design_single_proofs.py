"""Candidates of a redesign that are proved one by one, each with a plan of its own."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from threadline.base.workers import Done
from threadline.errors import JobError, MachineError, PlanError, RecordingError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.numbers import with_numbers
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, Trials, open_job, plan_job, prove_plan
from threadline.search.design_judge import HOPELESS
from threadline.verdict import Spec, Status, Verdict

NO_COMMANDS = "no commands"
"""Criterion name of a candidate that cannot be planned for, or that never ends the job."""


@dataclass(frozen=True, slots=True)
class JobReader:
    """Reads a job anew for each machine; every computer needs the file at the same path.

    Parameters
    ----------
    file
        The job.
    options
        Planning options.
    sha256
        SHA-256 of the file when it was first read.
    """

    file: Path
    options: Options
    sha256: str

    @classmethod
    def of(cls, file: Path, options: Options) -> JobReader:
        """Return the reader of a file of this computer."""
        return cls(file.absolute(), options, _sha256(file))

    def __call__(self, machine: Machine) -> Job:
        """Return the job for a machine.

        Raises
        ------
        JobError
            If the file has another content than at the beginning.
        """
        if _sha256(self.file) != self.sha256:
            raise JobError(
                f"{str(self.file)!r} is not the job that the search began with",
                remedy="Begin again, and leave the file alone; every worker needs the same file.",
            )
        return open_job(self.file, machine, self.options)


def _sha256(file: Path) -> str:
    if not file.is_file():
        return ""  # the reader reports the error of the file
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class SingleItem:
    """A candidate: changed numbers by path, and the largest ratio with further runs."""

    numbers: Mapping[str, float]
    beyond: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Used:
    """The used share of a candidate's limits.

    Parameters
    ----------
    first, worst
        In one run, and at worst over all runs.
    binding
        Criterion that uses the largest share.
    simulated
        Number of simulated machines.
    """

    first: float
    worst: float
    binding: str
    simulated: int


def bits_of_used(used: Used) -> bytes:
    """Return the bits of the shares, and the criterion."""
    return struct.pack("<dd", used.first, used.worst) + used.binding.encode()


@dataclass(frozen=True, slots=True)
class SingleProofs:
    """Proves candidates one by one, each with a plan of its own.

    Parameters
    ----------
    machine
        The machine whose numbers the candidates change.
    read
        Reads the job for a given machine.
    spec, options
        Specification and planning options of the job.
    repeats
        Number of runs of a candidate that passes the first run.
    """

    machine: Machine
    read: Callable[[Machine], Job]
    spec: Spec
    options: Options
    repeats: int

    def answer(self, item: SingleItem, _done: Done | None = None) -> Used:
        """Return the used share of a candidate's limits.

        Further runs follow where the share in the first run is at most ``item.beyond``.
        """
        machine = with_numbers(self.machine, dict(item.numbers))
        simulated = 0
        try:
            plan = plan_job(self.read(machine), machine, self.options)
            first, binding = share_used(prove_plan(plan, self.spec, trials=NOMINAL).verdict)
            simulated += 1
            if first > item.beyond or self.repeats == 1:
                return Used(first=first, worst=first, binding=binding, simulated=simulated)
            trials = Trials(repeats=self.repeats)
            worst, binding = share_used(prove_plan(plan, self.spec, trials=trials).verdict)
            simulated += self.repeats
        except (PlanError, MachineError, RecordingError):
            return Used(first=HOPELESS, worst=HOPELESS, binding=NO_COMMANDS, simulated=simulated)
        return Used(first=first, worst=worst, binding=binding, simulated=simulated)

    def machines(self, _item: SingleItem) -> int:
        """Return 1: candidates are proved one by one."""
        return 1

    def known(self) -> bytes:
        """Return the bits of the result of the machine as its file says, in one run."""
        return bits_of_used(self.answer(SingleItem(numbers={}, beyond=-1.0)))


def share_used(verdict: Verdict) -> tuple[float, str]:
    """Return the largest used share of a limit, at most 1000, and its criterion.

    The machine's own limits count only where they are broken, because plans use them fully. A
    verdict that fails without a broken limit counts as 1000.
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
        not_measured = [r.name for r in verdict.results if r.required and r.measured is None]
        return HOPELESS, next(iter(not_measured), binding)
    return share, binding
