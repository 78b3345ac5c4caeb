"""A machine as an operator's panel has it, whatever link leads to it: at rest, by hand, in runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from threadline.base.arrays import IntArray
from threadline.commands.plan import Plan
from threadline.files import Channel, Commands, Ended
from threadline.live.derived import Rest
from threadline.live.grbl_words import Program
from threadline.live.states import State


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """A plan, made ready to be sent.

    Parameters
    ----------
    plan
        The plan.
    sent
        Files by name of what was made for the machine, other than the plan's rows.
    notes
        What the operator has to know before it is sent.
    program
        Its lines, where it is sent as lines.
    rest
        What is sent in place of the plan's commands, where a run is continued; else None.
    """

    plan: Plan
    sent: Mapping[str, bytes] = field(default_factory=dict)
    notes: Sequence[str] = ()
    program: Program | None = None
    rest: Rest | None = None

    @property
    def commands(self) -> Commands:
        """What is sent, where that is rows, scans or turns."""
        return self.plan.commands if self.rest is None else self.rest.commands


class Operated(Protocol):
    """A machine at the far end of a link, for one run or jog after the other; see ``Executor``."""

    state: State
    ended: tuple[Ended, str] | None
    over: bool
    late_ticks: int
    latest: Mapping[str, float]
    homed: bool
    """Whether it is known where the axes are, or where they were when a fault came."""
    stopped_by: str
    """Who is said to have stopped what moves, where it is stopped."""
    meanwhile: Callable[[], None]
    """Called again and again while the machine homes, where that is waited for here."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels that the machine reports; empty until it was met."""

    @property
    def stands(self) -> IntArray:
        """Commanded position, (axes,) in counts; known once it is homed."""

    @property
    def lost(self) -> bool:
        """Whether the link is gone, so that the machine can be had only by connecting again."""

    @property
    def time_s(self) -> float:
        """Time of the machine since the motion began, s."""

    @property
    def age_s(self) -> float:
        """Age of the latest position when a newer one is due, s; 0 where none is due."""

    @property
    def share_done(self) -> float | None:
        """Share of a run that was executed, 0 to 1; None where its time tells it."""

    @property
    def under_way(self) -> bool:
        """Whether a run or a jog has begun and is not over: ``step`` is to be called."""

    def connect(self) -> None:
        """Meet the machine."""

    def close(self) -> None:
        """Leave it."""

    def enable(self) -> None:
        """Switch the drives on."""

    def disable(self) -> None:
        """Switch the drives off."""

    def home(self) -> None:
        """Home the machine."""

    def reset(self) -> None:
        """Leave a fault."""

    def stand(self, patience_s: float) -> None:
        """Listen to a machine at rest, and obey what is asked."""

    def step(self) -> None:
        """Go on with a motion."""

    def jog(self, axis: str, velocity: float) -> None:
        """Move an axis until it is let go."""

    def move(self, axis: str, to_counts: int, lease_s: float = ...) -> None:
        """Move an axis to a place."""

    def renew(self) -> None:
        """Renew the lease of a motion by hand."""

    def let_go(self) -> None:
        """End a motion by hand."""

    def prepare(self, plan: Plan) -> Load:
        """Make a plan ready; nothing is sent, and any thread may call it."""

    def rest(self, load: Load, operation: int, *, at_rest: bool) -> Load:
        """Return the rest of a load from an operation on; ``at_rest`` is as for ``continued``."""

    def refuse(self, load: Load) -> None:
        """Refuse a load that begins elsewhere than the machine stands."""

    def run(self, load: Load, *, hold_at_rest: bool) -> None:
        """Begin a run."""
