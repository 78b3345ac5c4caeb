"""What links have in common whose machine is led by our executor, refill by refill."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager

from threadline.arrays import IntArray
from threadline.live.continuing import Continued
from threadline.live.derived import Rest
from threadline.live.desk import Desk
from threadline.live.executor import Executor
from threadline.live.kept import Sink
from threadline.live.supervised import run_commands
from threadline.live.ways import way_of
from threadline.live.wire import Connection
from threadline.machine import Machine
from threadline.plan import Plan
from threadline.signals import Ended


class ExecutedLink(ABC):
    """A link to a machine that is begun with each run, and ends with it.

    Parameters
    ----------
    speed
        Seconds of the machine's time in a second.
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed

    @abstractmethod
    def _connected(self, machine: Machine, start: IntArray) -> AbstractContextManager[Connection]:
        """Return the connection to a machine that stands at ``start``, in units of its commands."""

    @property
    def sent(self) -> Mapping[str, bytes]:
        """Nothing: the rows of the plan are what it is sent."""
        return {}

    def rest(self, plan: Plan, operation: int, *, at_rest: bool) -> Rest:
        """Return the rest of a job from an operation on, as the machine is sent it."""
        return way_of(plan.machine).rest(plan.commands, plan.machine, operation, at_rest=at_rest)

    def close(self) -> None:  # noqa: B027  # a link that holds a port has something to close
        """Do nothing: the machine ends with its run."""

    def run(
        self,
        plan: Plan,
        desk: Desk,
        sink: Sink,
        *,
        pass_stops: bool,
        hold_at_rest: bool,
        watch: Callable[[Executor], None],
        again: Continued | None = None,
        confirmed: Callable[[], bool | None] = lambda: True,
    ) -> tuple[Ended, str]:
        """Run it; return how it ended, and why."""
        way = way_of(plan.machine)
        ended, text, _ = run_commands(
            plan.commands,
            plan.machine,
            self._connected(plan.machine, way.start(plan.commands)),
            desk,
            sink,
            speed=self._speed,
            pass_stops=pass_stops,
            hold_at_rest=hold_at_rest,
            loads_follow=way.loads_follow(plan),
            watch=watch,
            again=again,
            confirmed=confirmed,
        )
        return ended, text
