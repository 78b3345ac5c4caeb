"""The link to LinuxCNC's HAL: a loopback, or axes made of HAL's own components."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from contextlib import AbstractContextManager

from threadline.arrays import IntArray
from threadline.errors import OptionError
from threadline.kinds import kind_of
from threadline.live.executed_link import ExecutedLink
from threadline.live.hal_fifo import HAL_KEY, in_use
from threadline.live.hal_process import hal_link
from threadline.live.hal_session import AXES_AT_MOST, as_user, words_to_end
from threadline.live.wire import Connection
from threadline.machine import Machine
from threadline.plan import Plan

WHAT = {
    "loopback": "a loopback: HAL gives back what it is told; nothing is measured",
    "plant": "HAL's plant, a lag for each axis: not the machine",
}
"""What is at the far end, by the word behind ``hal:``."""
_PROGRAMS = ("halcmd", "halrun")


def check_hal(machine: Machine) -> None:
    """Refuse a machine or a computer that HAL cannot run on; nothing is started.

    Raises
    ------
    OptionError
        With what is missing.
    """
    if "ticks" not in kind_of(machine).targets or len(machine.axes) > AXES_AT_MOST:
        raise OptionError(
            f"{machine.name} is not driven by tables of ticks of at most {AXES_AT_MOST} axes",
            remedy="Use --link sim.",
        )
    if (10**9 * machine.tick_clock.period_s).denominator != 1:
        raise OptionError(
            f"the tick of {machine.name} is no whole number of nanoseconds",
            remedy="Use --link sim.",
        )
    lacking = [name for name in _PROGRAMS if shutil.which(name) is None]
    if lacking:
        raise OptionError(
            f"LinuxCNC's HAL is not installed: there is no {' and no '.join(lacking)}",
            remedy="Install linuxcnc-uspace.",
        )
    as_user()
    if in_use(HAL_KEY):
        raise OptionError(
            "LinuxCNC's HAL runs on this computer already",
            remedy=f"End LinuxCNC; after a run that was killed: {' '.join(words_to_end())}.",
        )


class HalLink(ExecutedLink):
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
        super().__init__(1.0)
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

    def prepare(self, plan: Plan) -> Sequence[str]:  # noqa: ARG002
        """Say what is at the far end."""
        return [self.label]

    def _connected(self, machine: Machine, start: IntArray) -> AbstractContextManager[Connection]:
        """Start HAL and the process in front of it."""
        return hal_link(machine, start, plant=self._plant)
