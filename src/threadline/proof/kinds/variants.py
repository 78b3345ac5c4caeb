"""Judge machines within the tolerances under the same commands: rejects and endless runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.errors import MachineError, OptionError, RecordingError
from threadline.files import Commands, Recording, TickTable
from threadline.machine import Machine
from threadline.machine.variants import variant
from threadline.proof.kinds.kind import Kind
from threadline.verdict import Judge, Result, Status
from threadline.verdict.each_run import clopper_pearson

REJECTS = "rejects"
_AT_ONCE = 256


def rejects(
    kind: Kind,
    plan: Plan,
    judge: Judge,
    parts: FloatArray,
    wanted_yield: float,
    random: np.random.Generator,
) -> tuple[Result, int]:
    """Judge machines within the tolerances; return the result ``rejects`` and the number judged.

    The measured value is the upper end of the exact 95 % interval (Clopper and Pearson) of the
    share of machines out of specification. A machine that cannot be simulated, or that waits
    forever for an input, counts as out of specification. Judging ends early once the limit would be
    exceeded even if all remaining machines were in specification.

    Parameters
    ----------
    parts
        (k, n) position of each of the n numbers of k machines within its tolerance.
    wanted_yield
        Wanted yield, a share from 0 to 1; the limit is ``1 - wanted_yield``.
    random
        Generator for encoder phases.
    """
    judged_count = failed = 0
    largest_share, limit = 1.0, 1.0 - wanted_yield
    for begin in range(0, len(parts), _AT_ONCE):
        batch = parts[begin : begin + _AT_ONCE]
        failed += _failed_count(kind, plan, judge, batch, random)
        judged_count += len(batch)
        largest_share = 1.0 - clopper_pearson(judged_count - failed, judged_count)[0]
        if 1.0 - clopper_pearson(len(parts) - failed, len(parts))[0] > limit:
            break
    result = Result(
        name=REJECTS,
        axis="",
        measured=largest_share,
        limit=limit,
        unit="",
        status=Status.FAILED if largest_share > limit else Status.PASSED,
        required=True,
        note=f"{failed} of {judged_count} machines within the tolerances are out of specification",
    )
    return result, judged_count


def _failed_count(
    kind: Kind, plan: Plan, judge: Judge, parts: FloatArray, random: np.random.Generator
) -> int:
    """Return how many machines are out of specification.

    A machine that cannot be simulated or judged raises an error for the whole call, so the machines
    are halved until it is alone.
    """
    try:
        others = kind.others(plan.commands, plan.machine, parts, random)
        return sum(int((~judge.each(one).passed).sum()) for one in others)
    except (MachineError, RecordingError):
        if len(parts) == 1:
            return 1
        half_count = len(parts) // 2
        failed_in_first_half = _failed_count(kind, plan, judge, parts[:half_count], random)
        return failed_in_first_half + _failed_count(kind, plan, judge, parts[half_count:], random)


UNANSWERED = "unanswered"


def unanswered(machines: int, why: list[str]) -> Result:
    """Return the failed result of the criterion that every machine reaches the end of the job.

    The measured value is the share of the ``machines`` that do not reach it; ``why`` has the reason
    for each of them.
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


def with_machine_hash(commands: Commands, machine: Machine) -> Commands:
    """Return ``commands`` with the hash of ``machine``, so that its simulation accepts them.

    A simulation refuses commands made for a machine with another hash. A machine within the
    tolerances has its own hash, but plays the commands of the nominal machine.
    """
    return replace(commands, machine_sha256=machine.sha256)


def played_by(commands: Commands, machine: Machine, actual: Machine) -> Commands:
    """Return commands made for ``machine`` in a form that ``actual`` accepts.

    Tick tables are returned unchanged: their simulation compares axes, clocks and counts instead of
    the hash of the machine.

    Raises
    ------
    OptionError
        If the machines differ in more than their numbers.
    """
    if actual.sha256 == machine.sha256 or isinstance(commands, TickTable):
        return commands
    for subject, planned_names, actual_names in (
        ("what moves", machine.moving, actual.moving),
        ("contacts", machine.contacts, actual.contacts),
        ("outputs", machine.outputs, actual.outputs),
    ):
        if (
            planned_names.keys() != actual_names.keys()
            or machine.commanded_by != actual.commanded_by
        ):
            raise OptionError(
                f"{actual.name} cannot play what is planned for {machine.name}: they differ in "
                f"{subject}, and not in numbers alone",
                remedy="Give a machine file that has the planned one as its base.",
            )
    return with_machine_hash(commands, actual)


def one_by_one(
    simulate: Callable[[Commands, Machine, np.random.Generator], Recording],
    commands: Commands,
    machine: Machine,
    parts: FloatArray,
    random: np.random.Generator,
) -> Sequence[Recording]:
    """Simulate machines within the tolerances one after the other, for ``Kind.others``."""
    machines = [variant(machine, row) for row in parts]
    return [simulate(with_machine_hash(commands, one), one, random) for one in machines]
