"""The links of an operator's panel, by name: what is at their far ends, and what is not had."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from threadline.live.desk import Desk
from threadline.live.executor import Executor
from threadline.live.grbl_controller import Controller
from threadline.live.grbl_operated import GrblOperated
from threadline.live.grbl_port import Port
from threadline.live.hal_link import WHAT
from threadline.live.hal_process import hal_link
from threadline.live.kept import Sink
from threadline.live.links import link_of
from threadline.live.operated import Load, Operated
from threadline.live.sim_process import IN_STEP, REAL_TIME, SLOWER, sim_link
from threadline.live.ways import way_of
from threadline.live.wire import Connection
from threadline.machine import Machine
from threadline.plan import Plan
from threadline.signals import Channel

_BY_ITSELF = "grbl switches its drives by itself"
_NO_HOME = "there is nothing to home: HAL takes where it begins for home"


@dataclass(frozen=True, slots=True)
class AtLink:
    """What is at the far end of a link, for people.

    Parameters
    ----------
    label
        What it is, where it is neither a machine nor its twin; else empty.
    lacks
        Commands that are not had there, and why.
    notes
        What the operator has to know of it.
    """

    label: str = ""
    lacks: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def at_link(link: str, machine: Machine, speed: float) -> AtLink:
    """Return what is at the far end of a link; nothing is connected.

    Raises
    ------
    OptionError
        If there is no such link, or it does not lead to such a machine.
    """
    found = link_of(link, machine, speed, None)
    if link == "sim":
        return AtLink()
    if link == SLOWER:
        return AtLink("", {}, ("where the computer is busy, the simulated machine goes slower",))
    if link.startswith("hal:"):
        return AtLink(found.label, {}, (_NO_HOME,))
    return AtLink(
        "",
        {"disable": _BY_ITSELF},
        (
            "grbl makes its own ramps, and reports what it commanded, ten times a second: nothing "
            "is measured, inputs and outputs are not reported",
            "reset resets the controller; where it has no switches, its alarm is cleared, too",
        ),
    )


class RowsOperated(Executor):
    """An executor of rows, as a panel has it; see ``Operated``."""

    share_done = None
    age_s = 0.0
    meanwhile: Callable[[], None] = staticmethod(lambda: None)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels that the machine reports; empty until it has greeted."""
        return self.far_end.channels

    def prepare(self, plan: Plan) -> Load:
        """Return the plan: its rows are what is sent."""
        return Load(plan)

    def rest(self, load: Load, operation: int, *, at_rest: bool) -> Load:
        """Return the rest of a load from an operation on."""
        commands = load.plan.commands
        found = self._way.rest(commands, self._machine, operation, at_rest=at_rest)
        return replace(load, rest=found)

    def refuse(self, load: Load) -> None:
        """Refuse a plan that begins elsewhere than the machine stands."""
        self._way.ahead(load.commands, self._machine).refuse_elsewhere(self.stands)

    def run(self, load: Load, *, hold_at_rest: bool) -> None:
        """Begin a run; see ``Executor.start``."""
        self.start(
            load.commands,
            hold_at_rest=hold_at_rest,
            loads_follow=way_of(self._machine).loads_follow(load.plan),
            from_rest=load.rest is not None,
        )


@contextmanager
def operated(
    link: str, machine: Machine, speed: float, desk: Desk, sink: Sink
) -> Iterator[Operated]:
    """Lead to a machine, and yield it as a panel has it; nothing was said to it yet.

    Parameters
    ----------
    link
        Name of a link, as ``at_link`` has checked it.
    machine, speed
        The machine; seconds of a simulated one in a second.
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
    at = np.zeros(len(machine.axes), dtype=np.int64)
    if link.startswith("hal:"):
        assert speed == REAL_TIME
        assert link.removeprefix("hal:") in WHAT
        return hal_link(machine, at, plant=link == "hal:plant")
    return sim_link(machine, at, speed)
