"""The functions that every kind of work defines, so that no other code depends on the kind."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Intent, Plan
from threadline.commands.write import Target
from threadline.dynamics.analysis import unstable_loops
from threadline.errors import PlanError
from threadline.files import Commands, Recording, RecordingBlock
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.proof.option_table import planned_by
from threadline.proof.options import Options
from threadline.verdict import Spec


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A row of the table of kinds of work.

    Parameters
    ----------
    name
        Value of ``Machine.commanded_by`` for machines of this kind.
    takes
        Names of the job formats that its machines accept (``jobs/reading.py``).
    commands, intent
        Type of the commands that its controllers take, and type of its plans' intent. The type of
        the intent selects how a recording is read (``verdict/judge.py``) and what a report draws
        (``report/proof.py``).
    check
        Refuses an unusable machine before a job is read.
    check_options
        Refuses options that have no meaning for this kind.
    plan
        Returns the plan of a job on a machine.
    simulate
        Returns the recording of one run of the commands on a machine.
    days
        Simulates the commands on a number of days. The first day has the numbers of the machine
        file; for the other days friction, supply and encoder phases are drawn from the generator.
    ranges_of_days
        Number of ranges that ``days`` draws from: one for each encoder, one for friction, one for
        supply, and so on.
    on_days
        Simulates the commands on k days. A (k, ranges) array gives the place of each day within
        each range, from 0 to 1.
    others
        Simulates the commands on k machines within the tolerances of the file. A (k, n) array gives
        the place of each number within its tolerance (``machine/variants.py``); encoder phases are
        drawn from the generator.
    together
        Returns whether machines that differ only in numbers are simulated in one call.
    with_criteria
        Returns the specification with the criteria added that the options ask for; none by default.
    release
        Refuses a plan that must not reach a controller; by default none, because the planner
        refuses what cannot be played.
    compared
        Options, with their values, that ``compare`` compares by default.
    targets
        Formats in which plans of this kind can be written, by name.
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
    ranges_of_days: Callable[[Commands], int]
    on_days: Callable[[Commands, Machine, FloatArray], Sequence[Recording]]
    others: Callable[[Commands, Machine, FloatArray, np.random.Generator], Sequence[Recording]]
    together: Callable[[Machine], bool]
    compared: Mapping[str, tuple[str, ...]]
    targets: Mapping[str, Target]
    with_criteria: Callable[[Spec, Machine, Options], Spec] = lambda spec, _machine, _options: spec
    release: Callable[[Plan], None] = lambda _plan: None

    @property
    def planned_by(self) -> tuple[str, ...]:
        """Planning options that apply to this kind, as a command line names them."""
        return planned_by(self.name)


def check_loops(machine: Machine) -> None:
    """Refuse a machine without loops, or with an unstable loop, before any motion is planned.

    Raises
    ------
    PlanError
        If a loop is unstable (names the axis and the margin), or there is no loop.
    """
    if not machine.axes:
        raise PlanError(
            f"{machine.name} has no axes with loops: its cylinders are switched on and off",
            place=machine.place,
            remedy="threadline prove, judge and compile take its move lists.",
        )
    unstable = unstable_loops(machine)
    if unstable:
        raise PlanError(
            "; ".join(unstable),
            place=machine.place,
            remedy="Lower the gain of its controller, or correct its clock; threadline analyse "
            "shows the loop.",
        )


LONG_S = 1.0  # progress is reported after this time of simulation
_DOING = "simulating and judging"
_MEASURING = "measuring the plan"
WRITING = "simulating and writing the recording"


class Share:
    """Reports the share of all runs that has been read.

    Parameters
    ----------
    plan
        The plan. Its duration may need a pass over the whole trajectory, so it is read only if
        the simulation takes longer than ``LONG_S``.
    progress
        Receives the activity and the share done; None reports nothing.
    runs
        Number of runs.
    doing
        The activity, in words.
    """

    def __init__(
        self,
        plan: Plan,
        progress: Callable[[str, float], None] | None,
        runs: int,
        doing: str = _DOING,
    ) -> None:
        self._plan, self._progress, self._doing = plan, progress, doing
        self._done = [0.0] * runs
        self._began = time.monotonic()

    def of(self, recordings: Sequence[Recording], before: int = 0) -> Sequence[Recording]:
        """Return the recordings, which report progress as they are read.

        ``before`` is the number of runs that were read before them.
        """
        if self._progress is None:
            return recordings
        return [
            replace(recording, blocks=_Watched(recording.blocks, self, number))
            for number, recording in enumerate(recordings, start=before)
        ]

    def tell(self, number: int, block: RecordingBlock | None) -> None:
        """Note that a run was read up to a block, or to its end (None)."""
        assert self._progress is not None
        if block is None:
            self._done[number] = 1.0
        if time.monotonic() - self._began <= LONG_S:
            return
        if block is not None:
            clock = self._plan.commands.clock
            done_s = clock.time_s(block.first_tick.get(clock.name, 0))
            self._done[number] = min(done_s / max(self._plan.duration_s, 1e-9), 1.0)
        share = sum(self._done) / len(self._done)
        # The plan is measured after its runs: its fibre takes as long as the fibre of a run.
        all_read = self._doing == _DOING and share >= 1.0 and block is None
        self._progress(_MEASURING if all_read else self._doing, share)


@dataclass(frozen=True, slots=True, eq=False)
class _Watched:
    """The blocks of a recording; not a ``Stream``, as another process cannot get the callback."""

    blocks: Iterable[RecordingBlock]
    share: Share
    number: int

    def __iter__(self) -> Iterator[RecordingBlock]:
        for block in self.blocks:
            yield block
            self.share.tell(self.number, block)
        self.share.tell(self.number, None)
