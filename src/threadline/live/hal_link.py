"""The link to LinuxCNC's HAL: a loopback, or axes made of HAL's own components."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from threadline.errors import OptionError
from threadline.live.desk import Desk
from threadline.live.executor import Executor
from threadline.live.hal_process import hal_link
from threadline.live.hal_session import check_hal
from threadline.live.kept import Sink
from threadline.live.supervised import run_commands
from threadline.live.ways import way_of
from threadline.machine import Machine
from threadline.plan import Plan
from threadline.signals import Ended

WHAT = {
    "loopback": "a loopback: HAL gives back what it is told; nothing is measured",
    "plant": "HAL's plant, a lag for each axis: not the machine",
}
"""What is at the far end, by the word behind ``hal:``."""


class HalLink:
    """The link to LinuxCNC's HAL.

    Parameters
    ----------
    what
        ``loopback`` or ``plant``.
    machine
        The machine whose axes and tick HAL has.

    Raises
    ------
    OptionError
        If there is no such thing, HAL cannot run, or the machine has no encoders.
    """

    def __init__(self, what: str, machine: Machine) -> None:
        if what not in WHAT:
            raise OptionError(
                f"there is no link hal:{what[:20]}", remedy="Use hal:loopback or hal:plant."
            )
        self._plant = what == "plant"
        self.label = WHAT[what]
        if self._plant and machine.told_positions:
            raise OptionError(
                f"{machine.name} has no encoders that a plant could answer with",
                remedy="Use hal:loopback.",
            )
        check_hal(machine)

    @property
    def after_fault(self) -> str:
        """What HAL has done after a fault."""
        return "HAL has played what it held, which ends at rest."

    @property
    def sent(self) -> Mapping[str, bytes]:
        """Nothing: the rows of the plan are what it is sent."""
        return {}

    def prepare(self, plan: Plan) -> Sequence[str]:  # noqa: ARG002
        """Say what is at the far end."""
        return [self.label]

    def close(self) -> None:
        """Do nothing: HAL ends with its run."""

    def run(
        self,
        plan: Plan,
        desk: Desk,
        sink: Sink,
        *,
        pass_stops: bool,
        hold_at_rest: bool,
        watch: Callable[[Executor], None],
    ) -> tuple[Ended, str]:
        """Run it."""
        start = way_of(plan.machine).start(plan.commands)
        ended, text, _ = run_commands(
            plan.commands,
            plan.machine,
            hal_link(plan.machine, start, plant=self._plant),
            desk,
            sink,
            speed=1.0,
            pass_stops=pass_stops,
            hold_at_rest=hold_at_rest,
            watch=watch,
        )
        return ended, text
