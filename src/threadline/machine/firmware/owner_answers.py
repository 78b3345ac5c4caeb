"""Numbers of a machine that its firmware's settings lack, for which its owner is asked by name."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass

from threadline.errors import OptionError

ASKED: dict[str, tuple[str, str]] = {
    "rotary": ("the letters of the axes that turn, or none", "A"),
    "microsteps": ("of the drivers", "16"),
    "torque": ("holding torque of the motors", "1.26 N m"),
    "current": ("per phase, set in the drivers", "2.8 A"),
    "resistance": ("of a phase", "0.9 ohm"),
    "inductance": ("of a phase", "2.5 mH"),
    "supply": ("of the drivers", "36 V"),
    "mass": ("that a linear axis moves", "1.2 kg"),
    "inertia": ("that a rotary axis turns", "4e-3 kg m^2"),
    "radius": ("at which a rotary axis acts: of the mandrel or workpiece", "50 mm"),
}
"""Name of each question, with its meaning and an example of an answer."""
OPTIONAL: dict[str, tuple[str, str]] = {
    "steps": ("per mm, where the settings have none", "80 count/mm"),
    "travel": ("from end to end, where the settings have none", "600 mm"),
    "rate": ("greatest speed a minute, where the settings have none", "6000 mm/min"),
    "acceleration": ("where the settings have none", "500 mm/s^2"),
    "rotor": ("inertia of a motor's rotor and pulley", "3.2e-5 kg m^2"),
    "friction": ("of a motor and its bearings", "0.03 N m"),
}
_NONE = ("", "0", "-", "no", "none")
_OF_AN_AXIS = frozenset(ASKED) - {"rotary"} | frozenset(OPTIONAL)


@dataclass(frozen=True, slots=True)
class Answers:
    """The answers of an owner, by name or by name and axis (``mass.X``)."""

    given: dict[str, str]

    @property
    def rotary(self) -> str:
        """Letters of the rotary axes; empty where there are none."""
        said = self.given.get("rotary", "")
        if said.lower() in _NONE:
            return ""
        return "".join(c for c in said.upper() if c.isalpha())

    def of(self, name: str, axis: str) -> str | None:
        """Return the answer for an axis, or the one for all axes; None without either."""
        return self.given.get(f"{name}.{axis}", self.given.get(name))


def parse_answers(texts: Sequence[str]) -> Answers:
    """Return the answers written like ``"mass=1.2 kg"`` or ``"mass.X=1.2 kg"``.

    Raises
    ------
    OptionError
        If one has no such form, an unknown name, or is given twice.
    """
    given: dict[str, str] = {}
    known = {**ASKED, **OPTIONAL}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        base, dot, axis = name.partition(".")
        empty = not value and base != "rotary"
        if not equals or empty or base not in known or (dot and base not in _OF_AN_AXIS):
            close = difflib.get_close_matches(base, known, n=1)
            hint = f"Did you mean {close[0]}? " if close and close[0] != base else ""
            raise OptionError(
                f"--set {text[:60]!r} answers nothing that is asked",
                remedy=f'{hint}Write it like --set "mass=1.2 kg"; names: {", ".join(known)}.',
            )
        key = f"{base}.{axis.upper()}" if dot else base
        if key in given:
            raise OptionError(f"--set {key} is given twice", remedy="Keep one of them.")
        given[key] = value
    return Answers(given)
