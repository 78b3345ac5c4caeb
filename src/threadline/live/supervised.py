"""Runs of proved jobs on a machine, from the check of the proof to the end of the run."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, TypeVar

from threadline.base.arrays import IntArray
from threadline.commands.plan import Plan
from threadline.errors import OptionError, Place, PlanError, ProofError
from threadline.files import Commands, RunEnd
from threadline.jobs.feed_times import SLOWER
from threadline.live.continuing import Continued, ContinuedSink
from threadline.live.derived import Rest
from threadline.live.executor import Executor
from threadline.live.hold_deviation import hold_waits, hold_words
from threadline.live.kinds_run import run_kind_of
from threadline.live.states import Desk, Hold, Sink, State
from threadline.live.wire import Connection
from threadline.machine import Machine
from threadline.proof.proof_file import ProofFile, check_proof, read_proof
from threadline.verdict import Result, Spec

_ASK_S = 0.05
"""Interval in s at which the operator's answer is polled."""


def check_runnable(
    proof_file: Path, plan: Plan, spec: Spec, override: str | None, key: bytes | None = None
) -> ProofFile:
    """Return the proof of a plan, if it permits running it.

    Parameters
    ----------
    proof_file
        File of the proof, whose hashes are compared with the plan.
    plan, spec
        The plan, and the specification that judged it.
    override
        Reason for running a plan that is out of specification; None: only a passed plan may run.
    key
        Key that must have signed the proof; None requires no signature.

    Raises
    ------
    ProofError
        If the proof belongs to another plan, is not signed with the key, or is out of spec and
        ``override`` is None.
    OptionError
        If an override is given for a plan that is in specification.
    """
    proof = read_proof(proof_file, key)
    place = Place(str(proof_file))
    differences = check_proof(proof, plan, spec)
    if differences:
        raise ProofError(
            f"the proof does not match the run: {'; '.join(map(str, differences))}",
            place=place,
            remedy="Prove the job again.",
        )
    if not proof.passed and not override:
        raise ProofError(
            f"{plan.job.name} is out of specification: {_failed(proof)}",
            remedy=f"{SLOWER[plan.job.paced_by]} (threadline fastest finds how), or run it all the "
            'same with --override "why", which is kept with the run.',
        )
    if proof.passed and override is not None:
        raise OptionError(
            "there is nothing to override: the job is in specification", remedy="Leave it out."
        )
    return proof


@dataclass(frozen=True, slots=True, kw_only=True)
class Interventions:
    """The holds and overrides that an operator may use in a run without spoiling the work.

    Parameters
    ----------
    hold_deviation_m
        Largest distance from the path at which a hold may stand, m; infinite if the run can be held
        only at a rest.
    hold
        When a hold brakes, and how hard.
    spoiled_by_holds
        The criteria that a hold at once would put out of specification, by simulation.
    no_override
        Why the feed of the run cannot be overridden; empty if it can.
    notes, notes_at_once
        Notes on holds and overrides for the operator before the run; ``notes_at_once`` is for a
        controller that holds on its path by itself.
    """

    hold_deviation_m: float
    hold: Hold
    spoiled_by_holds: Sequence[Result]
    no_override: str
    notes: Sequence[str]
    notes_at_once: Sequence[str]

    def at_once(self) -> Interventions:
        """Return the interventions for a controller that holds at once by itself."""
        return replace(self, hold=Hold.AT_ONCE, notes=self.notes_at_once)


def interventions(plan: Plan, spec: Spec) -> Interventions:
    """Return which holds and feed overrides of a plan keep its work in specification."""
    kind = run_kind_of(plan.machine)
    leaves_m = kind.hold_deviation_m(plan)
    hold = Hold.AT_REST if hold_waits(plan, spec, leaves_m) else Hold.AT_ONCE
    spoiled = kind.spoiled_by_holds(plan, spec, hold) if hold is Hold.AT_ONCE else ()
    if spoiled:
        spoiled_gently = kind.spoiled_by_holds(plan, spec, Hold.GENTLY)
        hold = Hold.AT_REST if spoiled_gently else Hold.GENTLY
    hold_notes = [
        hold_words(plan, leaves_m, hold, spoiled=spoiled, at_once=at_once)
        for at_once in (False, True)
    ]
    spoil_reason = kind.override_spoils(plan, spec, leaves_m, hold)
    override_note = (
        f"the feed of this run cannot be overridden: {spoil_reason}" if spoil_reason else ""
    )
    notes, notes_at_once = (
        [note for note in (hold_note, override_note) if note] for hold_note in hold_notes
    )
    return Interventions(
        hold_deviation_m=leaves_m,
        hold=hold,
        spoiled_by_holds=spoiled,
        no_override=kind.no_override or spoil_reason,
        notes=notes,
        notes_at_once=notes_at_once,
    )


def check_halts(plan: Plan, *, answered: bool) -> None:
    """Refuse a job that would wait for ever; all of its commands are read once.

    Parameters
    ----------
    answered
        Whether the operator, or an option, answers the stops of the program.

    Raises
    ------
    PlanError
        If a wait needs an input that the machine lacks, or nobody answers a stop; it names the
        line.
    """
    known_inputs = {*plan.machine.inputs, *plan.machine.contacts}
    for event in run_kind_of(plan.machine).halts(plan.commands):
        is_missing = event.kind == "wait" and event.name not in known_inputs
        if not is_missing and (event.kind != "stop" or answered):
            continue
        line = plan.intent.lines_of(plan.job, [event.operation]).get(event.operation, 0)
        raise PlanError(
            f"after this it waits for the input {event.name!r}, which {plan.machine.name} lacks"
            if is_missing
            else "the program stops after this, and nobody is at the keyboard to resume",
            place=Place(plan.job.file, line),
            remedy="Take the wait out, or run it where there is such an input."
            if is_missing
            else "Run it from a terminal, or with --pass-stops.",
        )


def check_override(override: str | None) -> None:
    """Refuse an override without a reason.

    Raises
    ------
    OptionError
        If it has no letter or digit: it is empty, or has only blanks and signs.
    """
    if override is not None and not any(map(str.isalnum, override)):
        raise OptionError(
            "--override gives no reason", remedy='Say why: --override "test of the brake".'
        )


class Running(Protocol):
    """A run under way."""

    state: State
    why: str
    """Reason for the latest change of state; empty without one."""
    stopped_by: str
    """Source of the stop; empty if the run was not stopped."""

    @property
    def percent(self) -> int:
        """Override of the feed, %."""

    @property
    def no_override(self) -> str:
        """Why the feed cannot be overridden; empty if it can."""

    @property
    def plan_s(self) -> float:
        """Time in the plan up to which the run is known to have played it, s."""

    @property
    def time_s(self) -> float:
        """Time since the beginning of the run, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Conduct:
    """How a run is conducted, and who attends it.

    Parameters
    ----------
    pass_stops, hold, loads_follow, no_override
        See ``Executor.start``.
    watch
        Called after each step, for progress.
    again
        The rest of an interrupted run, which is run instead of the whole job.
    confirmed
        Called before such a run, while the machine stands at home: whether the operator has
        confirmed the run; None while there is no answer.
    """

    pass_stops: bool = False
    hold: Hold = Hold.AT_ONCE
    loads_follow: bool = False
    no_override: str = ""
    watch: Callable[[Running], None] = lambda _: None
    again: Continued | None = None
    confirmed: Callable[[], bool | None] = lambda: True


UNATTENDED = Conduct()
"""A whole run that nobody watches."""


def run_commands(
    commands: Commands,
    machine: Machine,
    link: AbstractContextManager[Connection],
    desk: Desk,
    sink: Sink,
    conduct: Conduct = UNATTENDED,
    *,
    speed: float,
) -> tuple[RunEnd, str, int]:
    """Run checked commands, from enabling the drives to the end of settling.

    Parameters
    ----------
    commands
        Commands of a plan that ``check_runnable`` has passed.
    machine, link
        The machine, and the link to it.
    desk, sink, speed
        See ``Executor``.

    Returns
    -------
    tuple
        How the run ended, the reason, and the number of late ticks.
    """
    continued = conduct.again
    if continued is not None:
        rest, commands = continued.rest, continued.rest.commands
        sink = ContinuedSink(sink, machine, rest.left_out, rest.operation)
    with link as connection:
        executor = Executor(connection, machine, desk, sink, speed=speed)
        executor.connect()
        executor.enable()
        executor.home()
        if executor.state is not State.IDLE:
            executor.close()
            return RunEnd.STOPPED, "stopped by the operator while it homed", 0
        if continued is not None and (
            early_end := moved_to_begin(executor, machine, continued, conduct.confirmed)
        ):
            executor.close()
            return (*early_end, executor.late_ticks)
        executor.start(
            commands,
            pass_stops=conduct.pass_stops,
            hold=conduct.hold,
            loads_follow=conduct.loads_follow,
            from_rest=continued is not None,
            no_override=conduct.no_override,
        )
        while not executor.over:
            executor.step()
            conduct.watch(executor)
        executor.close()
    assert executor.ended is not None
    ended, text = executor.ended
    return ended, text, executor.late_ticks


class MovedByHand(Protocol):
    """A homed machine that is moved by hand; see ``Operated``."""

    state: State
    ended: tuple[RunEnd, str] | None
    over: bool
    stops: int

    @property
    def position_counts(self) -> IntArray:
        """Commanded position, (axes,) in counts."""

    def stand(self, patience_s: float) -> None:
        """Listen to the machine at rest for at most ``patience_s``, and execute commands."""

    def move(self, axis: str, to_counts: int) -> None:
        """Move an axis to a position."""

    def renew(self) -> None:
        """Renew the lease of a motion by hand."""

    def step(self) -> None:
        """Continue a motion."""


MovedT = TypeVar("MovedT", bound=MovedByHand)


def moved_to_begin(
    executor: MovedByHand, machine: Machine, again: Continued, confirmed: Callable[[], bool | None]
) -> tuple[RunEnd, str] | None:
    """Wait until the operator confirms, and move to the place where the work begins.

    Returns None once the machine stands there; else how and why the run ended before.
    """
    answer = None
    while executor.state is State.IDLE and not executor.stops and answer is None:
        answer = confirmed()
        executor.stand(0.0 if answer else _ASK_S)
    if not answer or executor.stops:
        return RunEnd.STOPPED, "nobody has confirmed that it may go on"
    return moved_in_turn(executor, machine, again.approach)


def moved_in_turn(
    executor: MovedT,
    machine: Machine,
    targets: Iterable[tuple[str, int]],
    watch: Callable[[MovedT], None] = lambda _: None,
) -> tuple[RunEnd, str] | None:
    """Move axes one after the other, at their manual feeds.

    Returns None once the machine stands at the end of all moves; else how and why a move ended.

    Parameters
    ----------
    targets
        Axes in the order in which they move, each with its target in counts.
    watch
        Called after each step.
    """
    names = list(machine.axes)
    for axis, target in targets:
        if executor.position_counts[names.index(axis)] == target:
            continue
        executor.move(axis, target)
        while not executor.over:
            if executor.state is State.JOGGING:
                executor.renew()
            executor.step()
            watch(executor)
        assert executor.ended is not None
        if executor.ended[0] is not RunEnd.COMPLETED or executor.stops:
            ended, why = executor.ended
            return ended, why or "stopped by the operator on the approach"
    return None


def _failed(proof: ProofFile) -> str:
    """Return the criteria that have not passed, each once: failed, then not measured."""
    criteria = proof.content["verdict"]["criteria"]
    failed_criteria = dict.fromkeys(
        f"{criterion['name']} {criterion['axis'] or ''}".strip()
        for status in ("failed", "not-measured")
        for criterion in criteria
        if criterion["status"] == status and (status == "failed" or criterion["required"])
    )
    return ", ".join([*failed_criteria][:4]) or "its verdict is not passed"


class ExecutedLink(ABC):
    """A link to a machine that is started for each run and ends with the run.

    Parameters
    ----------
    speed
        Seconds of machine time per second.
    """

    holds_at_once = False

    def __init__(self, speed: float) -> None:
        self._speed = speed

    @abstractmethod
    def _connected(self, machine: Machine, start: IntArray) -> AbstractContextManager[Connection]:
        """Return the connection to a machine that stands at ``start``, in units of its commands."""

    @property
    def sent(self) -> Mapping[str, bytes]:
        """Programs sent to the machine: none, since only the rows of the plan are sent."""
        return {}

    def rest(self, plan: Plan, operation: int, *, at_rest: bool) -> Rest:
        """Return the rest of a job from an operation on, as sent to the machine."""
        return run_kind_of(plan.machine).rest(
            plan.commands, plan.machine, operation, at_rest=at_rest
        )

    def close(self) -> None:  # noqa: B027  # a link that holds a port has something to close
        """Do nothing: the machine ends with its run."""

    def run(
        self, plan: Plan, desk: Desk, sink: Sink, conduct: Conduct = UNATTENDED
    ) -> tuple[RunEnd, str]:
        """Run the plan; return how it ended, and why."""
        run_kind = run_kind_of(plan.machine)
        ended, text, _ = run_commands(
            plan.commands,
            plan.machine,
            self._connected(plan.machine, run_kind.start(plan.commands)),
            desk,
            sink,
            replace(conduct, loads_follow=run_kind.loads_follow(plan)),
            speed=self._speed,
        )
        return ended, text
