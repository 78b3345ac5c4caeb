"""Settings of the axes and the motion planner, common to all firmwares."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from threadline.errors import MachineError, Place

_LEAST_NUMBER, _LARGEST_NUMBER = 1e-6, 1e9  # plausible range: anything outside is a typing error


@dataclass(frozen=True, slots=True)
class SettingValue:
    """A number in a settings file.

    Parameters
    ----------
    value
        In the unit of the field in ``AxisSettings`` or of the planner.
    place
        File and line.
    name
        Its name in the file: ``$110``, ``M203 X``.
    typed
        The number as typed in the file.
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
    """Settings of an axis in the firmware's units; None if the file gives none.

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
        Microsteps per full step of its driver.
    wrapped
        Whether the control reads angles of a rotary axis modulo one turn.
    """

    steps: SettingValue | None = None
    rate: SettingValue | None = None
    acceleration: SettingValue | None = None
    travel: SettingValue | None = None
    microsteps: SettingValue | None = None
    wrapped: bool = False


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
        Variant of the settings format; empty if there is only one.
    dialect
        Dialect of its part programs; empty for the dialect with the name of the firmware.
    axes
        Settings of the axes by letter, in the firmware's order.
    planner
        Settings of the motion planner, by the keys of ``[planner]`` in a machine file, in mm and
        degrees; ``jump.X`` is the jump of axis X.
    turning
        Axis -> whether it is rotary, if the settings say so.
    coupled
        Name, in the file, of kinematics in which a motor moves more than one axis but the limits
        apply to axes; empty for one motor per axis.
    ignored
        Settings that change the motion but have no place in a machine file: a sentence for each.
    notes
        Assumptions made during reading: a sentence for each.
    """

    firmware: str
    file: str
    form: str = ""
    dialect: str = ""
    axes: dict[str, AxisSettings] = field(default_factory=dict)
    planner: dict[str, SettingValue] = field(default_factory=dict)
    turning: dict[str, bool] = field(default_factory=dict)
    coupled: str = ""
    ignored: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def record(
        self, axis: str, what: str, text: str, place: Place, name: str, typed: str | None = None
    ) -> None:
        """Set ``what`` of an axis to the number ``text``; ``name`` is its name in the file.

        ``typed`` is the text in the file, if ``text`` was converted from it.

        Raises
        ------
        MachineError
            If it is not a number from 1e-6 to 1e9, or contradicts an earlier line.
        """
        if typed is not None:
            self.number(typed, place, name)
        value = self._number(text, place, name, zero=False, typed=typed)
        settings = self.axes.setdefault(axis, AxisSettings())
        setting = SettingValue(value, place, name, (typed or text).strip())
        self._refuse_another(getattr(settings, what), setting)
        setattr(settings, what, setting)

    def set_planner(
        self,
        key: str,
        text: str,
        place: Place,
        name: str,
        *,
        zero: bool = True,
        typed: str | None = None,
    ) -> None:
        """Set ``key`` of the planner to the number ``text``; ``name`` is its name in the file.

        ``typed`` is the text in the file, if ``text`` was converted from it.

        Raises
        ------
        MachineError
            If it is not a number from 1e-6 to 1e9 (or 0, if ``zero`` allows it), or contradicts an
            earlier line.
        """
        value = self._number(text, place, name, zero=zero, typed=typed)
        setting = SettingValue(value, place, name, (typed or text).strip())
        self._refuse_another(self.planner.get(key), setting)
        self.planner[key] = setting

    def leave_out(self, setting: str, does: str, place: Place) -> None:
        """Record a setting that changes the motion but that the planner ignores."""
        self.ignored.append(f"{place}: {setting} {does}; the planner ignores it")

    def shapes(self, name: str, place: Place) -> None:
        """Record that the firmware's input shaper is on; ``name`` is its name in the file."""
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
            remedy="Send G21 and dump the settings again.",
        )

    def refuse_kinematics(self, setting: str, place: Place) -> None:
        """Refuse a machine in which a motor moves more than one axis.

        Raises
        ------
        MachineError
            Always.
        """
        raise MachineError(
            f"{setting}: settings can be read only for machines with one motor per axis",
            place=place,
            remedy="Write the machine file by hand; see docs/machines.md.",
        )

    def number(self, text: str, place: Place, name: str) -> float:
        """Return a number typed in the file.

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
        if not (_LEAST_NUMBER <= value <= _LARGEST_NUMBER or (value == 0.0 and zero)):
            raise MachineError(
                f"{name} is {(typed or text).strip()[:40]!r}; it must be "
                f"{'0, or ' if zero else ''}a number from 10^-6 up to 10^9",
                place=place,
                remedy="Dump the settings again, or correct that line.",
            )
        return value

    def _refuse_another(self, earlier: SettingValue | None, setting: SettingValue) -> None:
        if earlier is not None and earlier.value != setting.value:
            raise MachineError(
                f"{setting.name} is {setting.typed} here and {earlier.typed} on "
                f"{_line_text(earlier, setting)}",
                place=setting.place,
                remedy="Keep only the valid line.",
            )


def _line_text(earlier: SettingValue, later: SettingValue) -> str:
    if earlier.place.file == later.place.file:
        return f"line {earlier.place.line}"
    return str(earlier.place)


def number_or_nan(text: str) -> float:
    """Return ``text`` as a number, NaN if it is not a number."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def times(text: str, factor: float) -> str:
    """Return the number ``text`` times ``factor``; any other text unchanged."""
    try:
        return repr(float(text) * factor)
    except ValueError:
        return text


def unknown(line: str, place: Place, form: str) -> MachineError:
    """Return the error for an unreadable line, with an example of a valid one."""
    return MachineError(
        f"{line.strip()[:60]!r} is not a line of these settings",
        place=place,
        remedy=f"Lines are like {form}",
    )
