"""Settings of the axes and of the motion planner of a firmware, whichever it is."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from threadline.errors import MachineError, Place

_LEAST, _MOST = 1e-6, 1e9  # of any sense: less is a slip of the pen, and no travel


@dataclass(frozen=True, slots=True)
class Said:
    """A number of a settings file, and its line."""

    value: float
    line: int


@dataclass(slots=True)
class AxisSettings:
    """Settings of an axis in the firmware's units; None for those that the file does not give.

    Parameters
    ----------
    steps
        Microsteps per mm, or per degree of a rotary axis.
    rate
        Largest speed, in mm (degrees) per minute.
    acceleration
        In mm (degrees) per second squared.
    travel
        Distance from the lowest to the highest position, in mm (degrees).
    microsteps
        Microsteps of its driver in a full step.
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
        ``grbl``, ``fluidnc``, ``marlin``, ``klipper`` or ``reprapfirmware``.
    file
        Path of the settings file.
    axes
        Settings of the axes by letter, in the firmware's order.
    planner
        Settings of the motion planner, by the keys of ``[planner]`` in a machine file, in mm and
        degrees; ``jump.X`` is that of axis X.
    unheeded
        What the file says that changes the motion and is not in a machine file, a sentence each.
    """

    firmware: str
    file: str
    axes: dict[str, AxisSettings] = field(default_factory=dict)
    planner: dict[str, Said] = field(default_factory=dict)
    unheeded: list[str] = field(default_factory=list)

    def say(
        self, axis: str, what: str, text: str, line: int, name: str, typed: str | None = None
    ) -> None:
        """Add a number ``text`` of an axis, for its setting ``what``; ``name`` is the file's word.

        ``typed`` is what the file has, where ``text`` was converted from it.

        Raises
        ------
        MachineError
            If it is not a number from 1e-6 to 1e9, or differs from one given before.
        """
        if typed is not None:
            self.number(typed, line, name)
        value = self._number(text, line, name, zero=False, typed=typed)
        settings = self.axes.setdefault(axis, AxisSettings())
        before: Said | None = getattr(settings, what)
        self._refuse_another(before, value, line, name)
        setattr(settings, what, Said(value, line))

    def say_of_planner(self, key: str, text: str, line: int, name: str) -> None:
        """Add a number ``text`` of the motion planner; ``name`` is the file's word for it.

        Raises
        ------
        MachineError
            If it is not 0 or a number from 1e-6 to 1e9, or differs from one given before.
        """
        value = self._number(text, line, name, zero=True)
        self._refuse_another(self.planner.get(key), value, line, name)
        self.planner[key] = Said(value, line)

    def shapes(self, name: str, line: int) -> None:
        """Record that the firmware's own input shaper is on, by the file's word for it."""
        self.unheeded.append(
            f"{Place(self.file, line)}: {name} shapes the motion; what is planned as the firmware "
            "plans is planned without it"
        )

    def refuse_inches(self, line: int) -> None:
        """Refuse a file whose lengths are in inches.

        Raises
        ------
        MachineError
            Always.
        """
        raise MachineError(
            "G20: these lengths are in inches",
            place=Place(self.file, line),
            remedy="Send G21, and dump the settings anew.",
        )

    def refuse_kinematics(self, said: str, line: int) -> None:
        """Refuse a machine of which a motor moves more than its own axis.

        Raises
        ------
        MachineError
            Always.
        """
        raise MachineError(
            f"{said}: only machines with a motor for each axis are made from settings",
            place=Place(self.file, line),
            remedy="Write the machine file by hand: docs/machines.md says how.",
        )

    def number(self, text: str, line: int, name: str) -> float:
        """Return a number of the file as it is typed.

        Raises
        ------
        MachineError
            If it is not a number from 1e-6 to 1e9.
        """
        return self._number(text, line, name, zero=False)

    def _number(
        self, text: str, line: int, name: str, *, zero: bool, typed: str | None = None
    ) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (_LEAST <= value <= _MOST or (value == 0.0 and zero)):
            raise MachineError(
                f"{name} is {(typed or text).strip()[:40]!r}; it must be "
                f"{'0, or ' if zero else ''}a number from 10^-6 up to 10^9",
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


def times(text: str, factor: float) -> str:
    """Return the number ``text`` times ``factor``; a text that is none as it stands."""
    try:
        return repr(float(text) * factor)
    except ValueError:
        return text


def unknown(line: str, file: str, number: int, form: str) -> MachineError:
    """Return the error of a line that cannot be read, by an example of a right one."""
    return MachineError(
        f"{line.strip()[:60]!r} is no line of these settings",
        place=Place(file, number),
        remedy=f"Lines are like {form}",
    )
