"""From words of the command line to how the cylinders are shaped."""

from __future__ import annotations

import re
from dataclasses import dataclass

from threadline.errors import OptionError, Place, PlanError
from threadline.foreign_messages import nearest
from threadline.machine import Machine
from threadline.option_defaults import UNSHAPED_WORD
from threadline.plant.pneumatic import flow_mode
from threadline.shaping import FlexibleMode, ShaperKind, convolve, design, parse_mode_hz
from threadline.shaping.designs import DEFAULT_TOLERANCE
from threadline.targets.schedule_moves import AxisShaping

_REMEDY = 'Write it like "zv", "zv*um-2ei", "zv:3.04Hz:0.17" or "X=zv, Z=none".'


@dataclass(frozen=True, slots=True)
class _Wanted:
    """One shaper as it was asked for; None is the machine's own mode."""

    kind: str
    frequency_hz: float | None
    damping_ratio: float | None
    tolerance: float


def shaping_of(
    machine: Machine,
    shaper: str,
    *,
    mode: str | None = None,
    damping_ratio: float | None = None,
) -> dict[str, AxisShaping]:
    """Return the shaping of every cylinder.

    Parameters
    ----------
    shaper
        ``kind``, or ``kind:frequency``, then where wanted ``:damping ratio`` and ``:tolerance``;
        joined by ``*``, which convolves: ``"zv*um-2ei"``, ``"zv:3.04Hz:0.17"``. ``"none"`` for
        unshaped moves. ``"X=zv, Z=none"`` gives cylinders their own.
    mode, damping_ratio
        Undamped frequency, like ``"3.04 Hz"``, and damping ratio of shapers that name none;
        where one is None, it is that of the slowest mode under each cylinder with its air.

    Raises
    ------
    OptionError
        If a word is unknown.
    """
    frequency = None if mode is None else parse_mode_hz(mode)
    texts = _by_axis(machine, shaper)
    made: dict[tuple[tuple[str, FlexibleMode, float], ...], AxisShaping] = {}
    shaping = {}
    for axis, text in texts.items():
        if text == UNSHAPED_WORD:
            continue
        own_hz, own_damping = flow_mode(machine, axis)
        key = []
        for wanted in (_wanted(part.strip(), shaper) for part in text.split("*")):
            given = (wanted.frequency_hz, frequency, own_hz)
            hz = next(value for value in given if value is not None)
            ratio = wanted.damping_ratio
            if ratio is None and wanted.frequency_hz is None:
                ratio = damping_ratio if damping_ratio is not None else own_damping
            key.append((wanted.kind, FlexibleMode(hz, ratio or 0.0), wanted.tolerance))
        if tuple(key) not in made:
            trains = [design(kind, used, tolerance=tolerance) for kind, used, tolerance in key]
            made[tuple(key)] = AxisShaping(
                shaper=convolve(*trains),
                modes=tuple(dict.fromkeys(used for _, used, _ in key)),
                tolerance=max(tolerance for _, _, tolerance in key),
            )
        shaping[axis] = made[tuple(key)]
    return shaping


def shaping_at(machine: Machine, text: str, place: Place) -> dict[str, AxisShaping]:
    """Return the shaping that a move list writes for a move.

    Raises
    ------
    PlanError
        If a word is unknown; with the line.
    """
    try:
        return shaping_of(machine, text)
    except OptionError as error:
        raise PlanError(error.message, place=place, remedy=error.remedy) from error


def _by_axis(machine: Machine, text: str) -> dict[str, str]:
    """Return the text of every cylinder's shaper."""
    parts = [part.strip() for part in text.split(",")]
    named = [re.fullmatch(r"([A-Za-z])\s*=\s*(.+)", part) for part in parts]
    if len(parts) == 1 and named[0] is None:
        return dict.fromkeys(machine.cylinders, parts[0])
    found: dict[str, str] = {}
    for part, match in zip(parts, named, strict=True):
        if match is None:
            raise OptionError(f"shaper {text!r}: {part!r} has no axis before it", remedy=_REMEDY)
        if match[1] not in machine.cylinders:
            raise OptionError(
                f"shaper {text!r}: there is no cylinder {match[1]!r}",
                remedy=f"There are {', '.join(machine.cylinders)}.",
            )
        if match[1] in found:
            raise OptionError(f"shaper {text!r}: cylinder {match[1]} has two", remedy=_REMEDY)
        found[match[1]] = match[2].strip()
    return found


def _wanted(text: str, whole: str) -> _Wanted:
    words = [word.strip() for word in text.split(":")]
    if words[0] not in set(ShaperKind):
        known = (UNSHAPED_WORD, *ShaperKind)
        raise OptionError(
            f"unknown shaper {words[0][:40]!r}", remedy=nearest(words[0], tuple(map(str, known)))
        )
    if len(words) > 4 or not all(words):
        raise OptionError(f"shaper {whole[:80]!r} cannot be read", remedy=_REMEDY)
    return _Wanted(
        kind=words[0],
        frequency_hz=parse_mode_hz(words[1]) if len(words) > 1 else None,
        damping_ratio=_number(words[2], whole) if len(words) > 2 else None,
        tolerance=_number(words[3], whole) if len(words) > 3 else DEFAULT_TOLERANCE,
    )


def _number(text: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise OptionError(f"shaper {whole[:80]!r}: {text!r} is no number", remedy=_REMEDY) from None
