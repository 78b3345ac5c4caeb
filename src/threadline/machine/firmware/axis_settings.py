"""Settings of the axes and of the motion planner of a firmware, whichever it is."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from threadline.errors import MachineError, Place

_LEAST, _MOST = 1e-6, 1e9  # of any sense: less is a slip of the pen, and no travel


@dataclass(frozen=True, slots=True)
class Said:
    """A number of a settings file.

    Parameters
    ----------
    value
        In the unit in which ``AxisSettings`` or the planner has it.
    place
        File and line.
    name
        What the file calls it: ``$110``, ``M203 X``.
    typed
        The number as the file has it.
    """

    value: float
    place: Place
    name: str
    typed: str

    @property
    def source(self) -> str:
        """File and line, as a provenance in a machine file: no quotes, no commas."""
        return re.sub(r"[^\w .:+-]", "_", str(self.place), flags=re.ASCII)


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
        ``grbl``, ``fluidnc``, ``marlin``, ``klipper``, ``reprapfirmware`` or ``linuxcnc``.
    file
        Path of the settings file.
    form
        Which of several forms of these settings the file has; empty where there is one.
    axes
        Settings of the axes by letter, in the firmware's order.
    planner
        Settings of the motion planner, by the keys of ``[planner]`` in a machine file, in mm and
        degrees; ``jump.X`` is that of axis X.
    turning
        Whether an axis turns, where the settings say so.
    coupled
        What the file calls kinematics in which a motor moves more than one axis, where the limits
        are those of the axes all the same; empty for a motor for each axis.
    unheeded
        What the file says that changes the motion and is not in a machine file, a sentence each.
    notes
        What was assumed in reading, a sentence each.
    """

    firmware: str
    file: str
    form: str = ""
    axes: dict[str, AxisSettings] = field(default_factory=dict)
    planner: dict[str, Said] = field(default_factory=dict)
    turning: dict[str, bool] = field(default_factory=dict)
    coupled: str = ""
    unheeded: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def say(
        self, axis: str, what: str, text: str, place: Place, name: str, typed: str | None = None
    ) -> None:
        """Add a number ``text`` of an axis, for its setting ``what``; ``name`` is the file's word.

        ``typed`` is what the file has, where ``text`` was converted from it.

        Raises
        ------
        MachineError
            If it is not a number from 1e-6 to 1e9, or differs from one given before.
        """
        if typed is not None:
            self.number(typed, place, name)
        value = self._number(text, place, name, zero=False, typed=typed)
        settings = self.axes.setdefault(axis, AxisSettings())
        said = Said(value, place, name, (typed or text).strip())
        self._refuse_another(getattr(settings, what), said)
        setattr(settings, what, said)

    def say_of_planner(
        self,
        key: str,
        text: str,
        place: Place,
        name: str,
        *,
        zero: bool = True,
        typed: str | None = None,
    ) -> None:
        """Add a number ``text`` of the motion planner; ``name`` is the file's word for it.

        ``typed`` is what the file has, where ``text`` was converted from it.

        Raises
        ------
        MachineError
            If it is not a number from 1e-6 to 1e9, or 0 where ``zero`` allows it, or differs from
            one given before.
        """
        value = self._number(text, place, name, zero=zero, typed=typed)
        said = Said(value, place, name, (typed or text).strip())
        self._refuse_another(self.planner.get(key), said)
        self.planner[key] = said

    def leave_out(self, said: str, does: str, place: Place) -> None:
        """Record a setting that changes the motion and is not planned, by the file's words."""
        self.unheeded.append(f"{place}: {said} {does}; what is planned is planned without it")

    def shapes(self, name: str, place: Place) -> None:
        """Record that the firmware's own input shaper is on, by the file's word for it."""
        self.leave_out(name, "shapes the motion", place)

    def refuse_inches(self, place: Place) -> None:
        """Refuse a file whose lengths are in inches.

        Raises
        ------
        MachineError
            Always.
        """
        raise MachineError(
            "G20: these lengths are in inches",
            place=place,
            remedy="Send G21, and dump the settings anew.",
        )

    def refuse_kinematics(self, said: str, place: Place) -> None:
        """Refuse a machine in which a motor moves more than its own axis.

        Raises
        ------
        MachineError
            Always.
        """
        raise MachineError(
            f"{said}: only machines with a motor for each axis are made from settings",
            place=place,
            remedy="Write the machine file by hand: docs/machines.md says how.",
        )

    def number(self, text: str, place: Place, name: str) -> float:
        """Return a number of the file as it is typed.

        Raises
        ------
        MachineError
            If it is not a number from 1e-6 to 1e9.
        """
        return self._number(text, place, name, zero=False)

    def _number(
        self, text: str, place: Place, name: str, *, zero: bool, typed: str | None = None
    ) -> float:
        value = number_or_nan(text)
        if not (_LEAST <= value <= _MOST or (value == 0.0 and zero)):
            raise MachineError(
                f"{name} is {(typed or text).strip()[:40]!r}; it must be "
                f"{'0, or ' if zero else ''}a number from 10^-6 up to 10^9",
                place=place,
                remedy="Dump the settings anew, or correct that line.",
            )
        return value

    def _refuse_another(self, before: Said | None, said: Said) -> None:
        if before is not None and before.value != said.value:
            raise MachineError(
                f"{said.name} is {said.typed} here and {before.typed} on {_line(before, said)}",
                place=said.place,
                remedy="Keep the line that is in force.",
            )


def _line(before: Said, here: Said) -> str:
    if before.place.file == here.place.file:
        return f"line {before.place.line}"
    return str(before.place)


def number_or_nan(text: str) -> float:
    """Return the number that ``text`` is, not a number where it is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def times(text: str, factor: float) -> str:
    """Return the number ``text`` times ``factor``; a text that is none as it stands."""
    try:
        return repr(float(text) * factor)
    except ValueError:
        return text


def unknown(line: str, place: Place, form: str) -> MachineError:
    """Return the error of a line that cannot be read, by an example of a right one."""
    return MachineError(
        f"{line.strip()[:60]!r} is no line of these settings",
        place=place,
        remedy=f"Lines are like {form}",
    )
