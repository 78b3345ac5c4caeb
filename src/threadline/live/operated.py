"""A machine as an operator's panel uses it, over any link: at rest, by hand, in runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from threadline.base.arrays import IntArray
from threadline.commands.plan import Plan
from threadline.files import Channel, Commands, RunEnd
from threadline.live.derived import Rest
from threadline.live.grbl_console import GrblBoard
from threadline.live.grbl_words import Program
from threadline.live.states import Hold, State


@dataclass(frozen=True, slots=True, eq=False)
class PlanToSend:
    """A plan with all that is sent to the machine for it.

    Parameters
    ----------
    plan
        The plan.
    sent
        Files made for the machine besides the plan's rows, by name.
    notes
        Notes for the operator before it is sent.
    program
        The program to send, if the plan is sent as lines.
    rest
        Commands sent in place of the plan's, if a run is continued; else None.
    """

    plan: Plan
    sent: Mapping[str, bytes] = field(default_factory=dict)
    notes: Sequence[str] = ()
    program: Program | None = None
    rest: Rest | None = None

    @property
    def commands(self) -> Commands:
        """Commands to send, if they are rows, scans or turns."""
        return self.plan.commands if self.rest is None else self.rest.commands


class Operated(Protocol):
    """A machine at the far end of a link, for one run or jog after the other; see ``Executor``."""

    state: State
    ended: tuple[RunEnd, str] | None
    over: bool
    late_ticks: int
    latest: Mapping[str, float]
    homed: bool
    """Whether the positions of the axes are known, or were known when a fault came."""
    stopped_by: str
    """Source of the stop, if the motion was stopped."""
    holds_at_once: bool
    """Whether the controller holds on its path by itself, and waits for no rest."""
    meanwhile: Callable[[], None]
    """Called repeatedly while the machine homes, if ``home`` waits for the end of homing."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels that the machine reports; empty until it is connected."""

    @property
    def position_counts(self) -> IntArray:
        """Commanded position, (axes,) in counts; known once it is homed."""

    @property
    def lost(self) -> bool:
        """Whether the link is gone, so that only connecting again reaches the machine."""

    @property
    def time_s(self) -> float:
        """Time of the machine since the motion began, s."""

    @property
    def age_s(self) -> float:
        """Age of the latest position beyond its due time, s; 0 if none is due."""

    @property
    def percent(self) -> int:
        """Override of the feed of the run, %."""

    @property
    def no_override(self) -> str:
        """Why the feed of the run cannot be overridden; empty if it can."""

    @property
    def share_done(self) -> float | None:
        """Executed share of a run, 0 to 1; None if it follows from the time of the run."""

    @property
    def under_way(self) -> bool:
        """Whether a run or a jog has begun and is not over: ``step`` must be called."""

    def connect(self) -> None:
        """Connect to the machine."""

    def close(self) -> None:
        """Disconnect."""

    def enable(self) -> None:
        """Switch the drives on."""

    def disable(self) -> None:
        """Switch the drives off."""

    def home(self) -> None:
        """Home the machine."""

    def reset(self) -> None:
        """Leave a fault."""

    def stand(self, patience_s: float) -> None:
        """Listen to a machine at rest for at most ``patience_s``, and execute commands."""

    def step(self) -> None:
        """Continue a motion."""

    def jog(self, axis: str, velocity: float) -> None:
        """Move an axis until it is let go."""

    def move(self, axis: str, to_counts: int, lease_s: float = ...) -> None:
        """Move an axis to a position."""

    def renew(self) -> None:
        """Renew the lease of a motion by hand."""

    def let_go(self) -> None:
        """End a motion by hand."""

    @property
    def board(self) -> GrblBoard | None:
        """The grbl board, with its settings and console; None for other links."""

    def type_line(self, line: str) -> None:
        """Send a line that the operator typed, if there is a board."""

    def prepare(self, plan: Plan) -> PlanToSend:
        """Prepare a plan; nothing is sent, and any thread may call it."""

    def rest(self, to_send: PlanToSend, operation: int, *, at_rest: bool) -> PlanToSend:
        """Return the rest of a plan from an operation on; ``at_rest`` is as for ``continued``."""

    def refuse(self, to_send: PlanToSend) -> None:
        """Refuse a plan that does not begin where the machine stands."""

    def run(self, to_send: PlanToSend, *, hold: Hold, no_override: str = "") -> None:
        """Begin a run; ``no_override`` says why its feed cannot be overridden, if it cannot."""

    def override(self, percent: int) -> None:
        """Override the feed of the run, 10 to 100 %."""
