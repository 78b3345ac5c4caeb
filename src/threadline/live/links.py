"""The links to machines, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from threadline.base.arrays import IntArray
from threadline.commands.plan import Plan
from threadline.errors import CommandError, OptionError
from threadline.files import Channel, RunEnd
from threadline.live.continuing import ContinuedSink
from threadline.live.derived import Rest
from threadline.live.executor import Executor
from threadline.live.grbl_controller import Controller
from threadline.live.grbl_operated import GrblOperated
from threadline.live.grbl_program import notes_on, rest_of_program, written_program
from threadline.live.grbl_words import Program
from threadline.live.hal_link import WHAT, HalLink, hal_link
from threadline.live.kinds_run import run_kind_of
from threadline.live.operated import Operated, PlanToSend
from threadline.live.port import Port, check_address
from threadline.live.sim_machine import SimFault
from threadline.live.sim_process import IN_STEP, REAL_TIME, SLOWER, sim_link
from threadline.live.states import Desk, Hold, Sink
from threadline.live.supervised import (
    UNATTENDED,
    Conduct,
    ExecutedLink,
    moved_in_turn,
    moved_to_begin,
)
from threadline.live.wire import Connection
from threadline.machine import Machine
from threadline.machine.model import check_dynamics
from threadline.proof.kinds import kind_of

LINKS = ("sim", SLOWER, "hal:loopback", "hal:plant", "grbl:HOST:PORT", "grbl:/dev/ttyUSB0")


class Link(Protocol):
    """Runs checked plans on the machine at its far end."""

    label: str
    """Name of the far end if it is neither a machine nor its twin; else empty."""
    holds_at_once: bool
    """Whether the controller holds on its path by itself, and waits for no rest."""

    @property
    def after_fault(self) -> str:
        """Reaction of the machine to a fault, for people."""

    @property
    def sent(self) -> Mapping[str, bytes]:
        """Files by name that ``prepare`` made for the machine, besides the plan's rows."""

    def prepare(self, plan: Plan) -> Sequence[str]:
        """Prepare the data to send, and return notes for the operator.

        Nothing moves. ``close`` must follow, with or without a run.
        """

    def rest(self, plan: Plan, operation: int, *, at_rest: bool) -> Rest:
        """Return the rest of a job from an operation on, as ``run`` sends it to the machine.

        Call it after ``prepare``; ``at_rest`` is as for ``continued``.
        """

    def close(self) -> None:
        """End the connection, if there is one."""

    def run(
        self, plan: Plan, desk: Desk, sink: Sink, conduct: Conduct = UNATTENDED
    ) -> tuple[RunEnd, str]:
        """Run the plan, or the rest of it; return how it ended, and why."""


class SimLink(ExecutedLink):
    """The link to the simulated machine.

    Parameters
    ----------
    speed
        Seconds of machine time per second.
    fault
        Injected fault, or None.
    actual
        Machine that is simulated under the name of the planned one, if the machine is to differ
        from its file; None: the planned one.
    """

    label = ""

    def __init__(self, speed: float, fault: SimFault | None, actual: Machine | None = None) -> None:
        super().__init__(speed)
        self._fault, self._actual = fault, actual

    def _connected(self, machine: Machine, start: IntArray) -> AbstractContextManager[Connection]:
        """Return the connection to a separate process."""
        simulated = machine
        if self._actual is not None:
            mounted = None if self._actual.spool is None else machine.mounted
            simulated = replace(
                self._actual, name=machine.name, sha256=machine.sha256, mounted=mounted
            )
        return sim_link(simulated, start, self._speed, self._fault)

    @property
    def after_fault(self) -> str:
        """Reaction of the simulated machine to a fault, for people."""
        if self._fault is not None and self._fault.cuts_supply:
            return "Its drives had no supply: how far it coasted is not simulated."
        braked = "The machine has come to rest by itself."
        if self._speed == REAL_TIME:
            braked += (
                f" If the computer was too busy for real time, --link {SLOWER} goes slower "
                "instead, and --speed 0 simulates as fast as it can."
            )
        return braked

    def prepare(self, plan: Plan) -> Sequence[str]:  # noqa: ARG002
        """Return no notes."""
        return ()


class GrblLink:
    """The link to a controller with grbl.

    Parameters
    ----------
    address
        ``HOST:PORT``, or the path of a serial device.
    machine
        The machine that it drives.
    approach
        Whether the axes first move, one after the other, to the position where the program begins.

    Raises
    ------
    OptionError
        If ``address`` is not one, or no grbl program can be written for the machine.
    """

    label = ""
    holds_at_once = True

    def __init__(self, address: str, machine: Machine, *, approach: bool = False) -> None:
        check_address(address)
        if "grbl" not in kind_of(machine).targets:
            raise OptionError(
                f"{machine.name} is not driven by part programs", remedy="Use --link sim."
            )
        self._address, self._approach = address, approach
        self.after_fault = (
            "The controller was told to hold; without its link it executes its buffer."
        )
        self._program: Program | None = None
        self._controller: Controller | None = None
        self.sent: Mapping[str, bytes] = {}

    def prepare(self, plan: Plan) -> Sequence[str]:
        """Write the program, and connect; return notes on the effect of a lost link."""
        machine = plan.machine
        self._program, self.sent = written_program(plan)
        self._controller = Controller(Port(self._address), machine)
        self._controller.meet()
        return notes_on(self._program, self._controller)

    def run(
        self, plan: Plan, desk: Desk, sink: Sink, conduct: Conduct = UNATTENDED
    ) -> tuple[RunEnd, str]:
        """Home, send the program, and record the reports of the controller.

        ``conduct.hold`` is ignored: the controller always holds on its path at once.
        """
        assert self._program is not None
        assert self._controller is not None
        machine, continued = plan.machine, conduct.again
        if continued is not None:
            rest = continued.rest
            sink = ContinuedSink(sink, machine, rest.left_out, rest.operation)
        executor = GrblOperated(self._controller, desk, sink, pass_stops=conduct.pass_stops)
        executor.enable()
        executor.home()
        if continued is not None and (
            early_end := moved_to_begin(executor, machine, continued, conduct.confirmed)
        ):
            return early_end
        to_send = PlanToSend(
            plan, program=self._program, rest=None if continued is None else continued.rest
        )
        if self._approach and continued is None:
            starts = zip(machine.axes, executor.starts(to_send).tolist(), strict=True)
            ordered_starts = sorted(
                starts, key=lambda axis_start: machine.axes[axis_start[0]].kind != "linear"
            )
            if early_end := moved_in_turn(executor, machine, ordered_starts, conduct.watch):
                return early_end
        executor.run(to_send, hold=Hold.AT_ONCE, no_override=conduct.no_override)
        while not executor.over:
            executor.step()
            conduct.watch(executor)
        assert executor.ended is not None
        return executor.ended

    def rest(self, plan: Plan, operation: int, *, at_rest: bool) -> Rest:  # noqa: ARG002  # it makes its own ramps
        """Return the rest of a job from an operation on; ``run`` sends its lines."""
        assert self._program is not None
        rest, self._program = rest_of_program(self._program, plan, operation)
        self.sent = dict.fromkeys(self.sent, b"".join(self._program.lines))
        return rest

    def close(self) -> None:
        """End the connection, if there is one."""
        if self._controller is not None:
            self._controller.port.close()


def link_of(
    text: str,
    machine: Machine,
    speed: float,
    fault: SimFault | None,
    *,
    approach: bool = False,
    actual: Machine | None = None,
) -> Link:
    """Return the link called ``text``; only a link to grbl takes ``approach``.

    See ``SimLink`` for ``actual``.

    Raises
    ------
    OptionError
        If there is no such link, or an option does not apply to it.
    """
    name, _, address = text.partition(":")
    if approach and name != "grbl":
        raise OptionError(
            f"--approach needs a controller with grbl, and --link is {text[:40]!r}",
            remedy="Leave it out: this machine stands where the program begins.",
        )
    if actual is not None:
        if name != "sim":
            raise OptionError(
                f"--actual is simulated, and --link is {text[:40]!r}", remedy="Leave it out."
            )
        check_dynamics("the motion of another machine", machine, actual)
    if text == "sim":
        return SimLink(speed, fault, actual)
    if text == SLOWER:
        if speed != REAL_TIME:
            raise OptionError(
                f"--link {SLOWER} goes at real time where it can, and has no --speed {speed:g}",
                remedy="Leave --speed out, or use --link sim.",
            )
        return SimLink(IN_STEP, fault, actual)
    if name not in {"grbl", "hal"} or not address:
        raise OptionError(f"unknown link {text[:40]!r}", remedy=f"Use {', '.join(LINKS)}.")
    if speed != REAL_TIME or fault is not None:
        raise OptionError(
            "--speed and --inject need the simulated machine", remedy="Leave them out."
        )
    if name == "hal":
        return HalLink(address, machine)
    return GrblLink(address, machine, approach=approach)


_BY_ITSELF = "grbl switches its drives by itself"
_SAFE = frozenset({"light-grid", "enable"})
"""Kinds of contacts that are on at rest on a real machine, too."""
_NO_HOME = "there is nothing to home: HAL takes where it begins for home"


@dataclass(frozen=True, slots=True)
class AtLink:
    """The far end of a link, described for people.

    Parameters
    ----------
    label
        Name of the far end if it is neither a machine nor its twin; else empty.
    lacks
        Commands that are not available there, and why.
    notes
        Notes for the operator.
    console
        Whether it takes typed lines at rest.
    """

    label: str = ""
    lacks: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    console: bool = False


def _by_nobody(machine: Machine) -> tuple[str, ...]:
    """Return a note on the inputs that no simulated part switches: they are on from the start."""
    names = [
        name.replace("_", " ")
        for name, contact in machine.contacts.items()
        if contact.cylinder is None and contact.kind not in _SAFE
    ]
    if not names:
        return ()
    joined_names = " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
    phrase = "inputs {} are" if len(names) > 1 else "input {} is"
    return (
        f"nobody is at the simulated machine: its {phrase.format(joined_names)} on from the start",
    )


def at_link(link: str, machine: Machine, speed: float) -> AtLink:
    """Return the description of the far end of a link; nothing is connected.

    Raises
    ------
    OptionError
        If there is no such link, or it cannot drive the machine.
    """
    checked_link = link_of(link, machine, speed, None)
    if link == "sim":
        return AtLink(notes=_by_nobody(machine))
    if link == SLOWER:
        slower = "where the computer is busy, the simulated machine goes slower"
        return AtLink(notes=(slower, *_by_nobody(machine)))
    if link.startswith("hal:"):
        return AtLink(checked_link.label, {}, (_NO_HOME,))
    return AtLink(
        "",
        {"disable": _BY_ITSELF},
        (
            "grbl makes its own ramps, and reports its commands ten times a second: nothing is "
            "measured, inputs and outputs are not reported",
            "reset resets the controller; if it has no homing switches, its alarm is cleared, too",
        ),
        console=True,
    )


class RowsOperated(Executor):
    """An executor of rows for a panel; see ``Operated``."""

    age_s = 0.0
    board = None
    holds_at_once = False
    meanwhile: Callable[[], None] = staticmethod(lambda: None)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels that the machine reports; empty until it has greeted."""
        return self.far_end.channels

    def type_line(self, line: str) -> None:
        """Refuse a typed line with a CommandError: the machine takes rows, not lines."""
        raise CommandError(
            f"the line {line[:40]!r} was not sent: this link has no console",
            remedy="Use the buttons of the panel.",
        )

    def prepare(self, plan: Plan) -> PlanToSend:
        """Return the plan to send: its rows."""
        return PlanToSend(plan)

    def rest(self, to_send: PlanToSend, operation: int, *, at_rest: bool) -> PlanToSend:
        """Return the rest of a plan from an operation on."""
        commands = to_send.plan.commands
        rest = self._run_kind.rest(commands, self._machine, operation, at_rest=at_rest)
        return replace(to_send, rest=rest)

    def refuse(self, to_send: PlanToSend) -> None:
        """Refuse a plan that does not begin where the machine stands."""
        self._run_kind.ahead(to_send.commands, self._machine).refuse_elsewhere(self.position_counts)

    def run(self, to_send: PlanToSend, *, hold: Hold, no_override: str = "") -> None:
        """Begin a run; see ``Executor.start``."""
        self.start(
            to_send.commands,
            hold=hold,
            loads_follow=run_kind_of(self._machine).loads_follow(to_send.plan),
            from_rest=to_send.rest is not None,
            no_override=no_override,
        )


@contextmanager
def operated(
    link: str, machine: Machine, speed: float, desk: Desk, sink: Sink
) -> Iterator[Operated]:
    """Connect to a machine for a panel, and yield it; nothing has been sent to it yet.

    Parameters
    ----------
    link
        Name of a link, checked by ``at_link``.
    machine, speed
        The machine; seconds of simulated time per second.
    desk, sink
        Queue of the operator's commands; receiver of samples, events and changes of state.
    """
    if link.startswith("grbl:"):
        yield GrblOperated(Controller(Port(link.removeprefix("grbl:")), machine), desk, sink)
        return
    speed = IN_STEP if link == SLOWER else speed
    with _rows(link, machine, speed) as connection:
        yield RowsOperated(connection, machine, desk, sink, speed=speed)


def _rows(link: str, machine: Machine, speed: float) -> AbstractContextManager[Connection]:
    start_counts = np.zeros(len(machine.axes), dtype=np.int64)
    if link.startswith("hal:"):
        assert speed == REAL_TIME
        assert link.removeprefix("hal:") in WHAT
        return hal_link(machine, start_counts, plant=link == "hal:plant")
    return sim_link(machine, start_counts, speed)
