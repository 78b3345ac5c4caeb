"""What the settings of a firmware say of its axes, whatever the firmware."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from threadline.errors import MachineError, Place

_MOST = 1e9


@dataclass(frozen=True, slots=True)
class Said:
    """A number of a settings file, and where it stands."""

    value: float
    line: int


@dataclass(slots=True)
class AxisSettings:
    """What is said of an axis, in the firmware's own units; None for what is not.

    Parameters
    ----------
    steps
        Per mm, or per degree of an axis that turns.
    rate
        Greatest speed, mm (degrees) a minute.
    acceleration
        mm (degrees) per second squared.
    travel
        mm or degrees, from the lowest to the highest position.
    microsteps
        Of its driver.
    """

    steps: Said | None = None
    rate: Said | None = None
    acceleration: Said | None = None
    travel: Said | None = None
    microsteps: Said | None = None


@dataclass(slots=True)
class Settings:
    """The settings of a firmware.

    Parameters
    ----------
    firmware
        ``grbl``, ``fluidnc``, ``marlin`` or ``klipper``.
    file
        Where they were read.
    axes
        By letter, in the firmware's order.
    planner
        What it says of its motion planner, by the key of ``[planner]``, in mm and degrees;
        ``jump.X`` of an axis.
    """

    firmware: str
    file: str
    axes: dict[str, AxisSettings] = field(default_factory=dict)
    planner: dict[str, Said] = field(default_factory=dict)

    def say(self, axis: str, what: str, text: str, line: int, name: str) -> None:
        """Take a number of an axis.

        Raises
        ------
        MachineError
            If it is no number above 0 that a machine may have, or was another before.
        """
        value = self._number(text, line, name, zero=False)
        settings = self.axes.setdefault(axis, AxisSettings())
        before: Said | None = getattr(settings, what)
        self._refuse_another(before, value, line, name)
        setattr(settings, what, Said(value, line))

    def say_of_planner(self, key: str, text: str, line: int, name: str) -> None:
        """Take a number of the motion planner; 0 is one.

        Raises
        ------
        MachineError
            If it is no number from 0 on that a machine may have, or was another before.
        """
        value = self._number(text, line, name, zero=True)
        self._refuse_another(self.planner.get(key), value, line, name)
        self.planner[key] = Said(value, line)

    def _number(self, text: str, line: int, name: str, *, zero: bool) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0.0 <= value <= _MOST or (value == 0.0 and not zero):
            raise MachineError(
                f"{name} is {text.strip()[:40]!r}; it must be a number "
                f"{'from 0' if zero else 'above 0 and'} up to 10^9",
                place=Place(self.file, line),
                remedy="Dump the settings anew, or correct that line.",
            )
        return value

    def _refuse_another(self, before: Said | None, value: float, line: int, name: str) -> None:
        if before is not None and before.value != value:
            raise MachineError(
                f"{name} is {value:g} here and {before.value:g} on line {before.line}",
                place=Place(self.file, line),
                remedy="Keep the line that is in force.",
            )
