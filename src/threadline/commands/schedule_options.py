"""Shaper options of the command line and move lists, and checks of a schedule's operations."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from threadline.base.option_defaults import UNSHAPED_WORD
from threadline.base.wording import nearest
from threadline.commands.schedule_moves import AxisShaping, Levels
from threadline.dynamics.pneumatic import flow_mode
from threadline.errors import OptionError, Place, PlanError
from threadline.jobs.operations import Source
from threadline.machine import Machine
from threadline.machine.pneumatics import Contact, Cylinder
from threadline.motion.shaping import FlexibleMode, ShaperKind, convolve, design, parse_mode_hz
from threadline.motion.shaping.designs import DEFAULT_TOLERANCE

_REMEDY = 'Write it like "zv", "zv*um-2ei", "zv:3.04Hz:0.17" or "X=zv, Z=none".'


@dataclass(frozen=True, slots=True)
class _ShaperRequest:
    """One requested shaper; a frequency of None means the machine's own mode."""

    kind: str
    frequency_hz: float | None
    damping_ratio: float | None
    tolerance: float


def shaping_of(
    machine: Machine, shaper: str, *, mode: str | None = None, damping_ratio: float | None = None
) -> dict[str, AxisShaping]:
    """Return the shaping of every cylinder.

    Parameters
    ----------
    shaper
        ``kind``, or ``kind:frequency``, optionally with ``:damping ratio`` and ``:tolerance``.
        ``*`` joins shapers by convolution: ``"zv*um-2ei"``, ``"zv:3.04Hz:0.17"``. ``"none"``
        leaves moves unshaped. ``"X=zv, Z=none"`` gives each cylinder its own shaper.
    mode, damping_ratio
        Undamped frequency, like ``"3.04 Hz"``, and damping ratio for shapers that give none. None:
        the value of the slowest mode under each cylinder, with the cylinder's air.

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
        for request in (_request(part.strip(), shaper) for part in text.split("*")):
            frequencies = (request.frequency_hz, frequency, own_hz)
            hz = next(value for value in frequencies if value is not None)
            ratio = request.damping_ratio
            if ratio is None and request.frequency_hz is None:
                ratio = damping_ratio if damping_ratio is not None else own_damping
            key.append((request.kind, FlexibleMode(hz, ratio or 0.0), request.tolerance))
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
    """Return the shaping that a move list gives for one move.

    Raises
    ------
    PlanError
        If a word is unknown; the error gives the line.
    """
    try:
        return shaping_of(machine, text)
    except OptionError as error:
        raise PlanError(error.message, place=place, remedy=error.remedy) from error


def _by_axis(machine: Machine, text: str) -> dict[str, str]:
    """Return the shaper text of every cylinder."""
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


def _request(text: str, whole: str) -> _ShaperRequest:
    words = [word.strip() for word in text.split(":")]
    if words[0] not in set(ShaperKind):
        known = (UNSHAPED_WORD, *ShaperKind)
        raise OptionError(
            f"unknown shaper {words[0][:40]!r}", remedy=nearest(words[0], tuple(map(str, known)))
        )
    if len(words) > 4 or not all(words):
        raise OptionError(f"shaper {whole[:80]!r} cannot be read", remedy=_REMEDY)
    return _ShaperRequest(
        kind=words[0],
        frequency_hz=parse_mode_hz(words[1]) if len(words) > 1 else None,
        damping_ratio=_number(words[2], whole) if len(words) > 2 else None,
        tolerance=_number(words[3], whole) if len(words) > 3 else DEFAULT_TOLERANCE,
    )


def _number(text: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise OptionError(
            f"shaper {whole[:80]!r}: {text!r} is not a number", remedy=_REMEDY
        ) from None


_SEEN_M = 1e-6
_MEANT = 0.25  # scans: allowed difference of distance for levels written out in the list


def reads_on(contact: Contact, place_m: float) -> bool:
    """Say whether an end switch is on while its piston is at ``place_m``."""
    assert contact.at is not None
    return place_m <= contact.at.si if contact.beyond == "below" else place_m >= contact.at.si


def check_air(machine: Machine, state: Mapping[str, int], source: Source) -> None:
    """Refuse a move while the soft-start valve is closed."""
    closed = [
        name
        for name, output in machine.outputs.items()
        if output.kind == "soft-start" and not state[name]
    ]
    if closed:
        raise PlanError(
            f"the soft-start valve {closed[0]!r} is closed when a cylinder is to move",
            place=source.place,
            remedy=f'Begin with [[operation]] valve = "{closed[0]}".',
        )


def check_timeout(timeout_s: float, scan_s: float, source: Source) -> None:
    """Refuse a timeout shorter than a scan: the wait would fail before the input is read again."""
    if timeout_s < scan_s * (1.0 - 1e-9):
        raise PlanError(
            f"timeout = {timeout_s * 1e3:g} ms is shorter than a scan, {scan_s * 1e3:g} ms",
            place=source.place,
            remedy="Give a scan or more; the PLC rounds it up to whole scans.",
        )


def check_wait(
    machine: Machine, position: Mapping[str, float], name: str, value: bool, source: Source
) -> list[str]:
    """Refuse a wait for an end switch that its piston cannot switch; warn near the switch point."""
    contact = machine.contacts[name]
    if contact.cylinder is None or contact.at is None:
        return []
    place_m, cylinder = position[contact.cylinder], machine.cylinders[contact.cylinder]
    if reads_on(contact, place_m) != value:
        raise PlanError(
            f"the input {name!r} would never {'come' if value else 'go'}: "
            f"{contact.cylinder} stands at {cylinder.place(place_m)} then, and {name} is on "
            f"{contact.beyond} {cylinder.place(contact.at.si)}",
            place=source.place,
            remedy="Wait for another input, or move there first.",
        )
    if abs(place_m - contact.at.si) > contact.at.tolerance_si:
        return []
    return [
        f"{source.place}: the input {name!r} may never {'come' if value else 'go'}: "
        f"{contact.cylinder} stands at {cylinder.place(place_m)} then, and {name} switches at "
        f"{cylinder.place(contact.at.si)} +- {cylinder.place(contact.at.tolerance_si)}; "
        "move beyond it"
    ]


def check_interlocks(
    machine: Machine,
    moving: Iterable[str],
    on: Iterable[str],
    before: Mapping[str, float],
    after: Mapping[str, float],
    on_its_way: Iterable[str],
    source: Source,
) -> None:
    """Refuse a step in which something moves or is on although an interlock forbids it.

    Parameters
    ----------
    moving, on
        Cylinders that move in the step, and outputs that are on in the step.
    before, after
        Position of every cylinder at the start and at the end of the step, m.
    on_its_way
        Cylinders that have not come to rest since their move, and whose arrival no wait confirms.

    Raises
    ------
    PlanError
        If an interlock forbids the step; with the line, the switch and the piston's position.
    """
    interlocks = [(f"{axis} moves", machine.cylinders[axis].needs) for axis in moving]
    interlocks += [(f"{name} is on", machine.outputs[name].needs) for name in on]
    going = set(on_its_way)
    for what, needs in interlocks:
        for name in needs:
            contact = machine.contacts[name]
            other = str(contact.cylinder)
            if not (reads_on(contact, before[other]) and reads_on(contact, after[other])):
                factor, unit = machine.cylinders[other].usual
                ends = dict.fromkeys(f"{m[other] * factor:g}" for m in (before, after))
                raise PlanError(
                    f"{what} only with {name} on, and {other} is at {' to '.join(ends)} {unit} "
                    "then",
                    place=source.place,
                    remedy=f"Move {other} first, or change needs in the machine file.",
                )
            if other in going:
                raise PlanError(
                    f"{what} only with {name} on, and {other} may still be on its way then",
                    place=source.place,
                    remedy=f'Write [[operation]] wait = "{name}" before it, or let {other} rest.',
                )


def tell_distance(
    warnings: list[str],
    levels: Levels,
    cylinder: Cylinder,
    axis: str,
    tick_s: float,
    source: Source,
    written: bool,
) -> None:
    """Add a warning if whole scans do not give the requested distance.

    Levels written out in the list may differ by a quarter of a scan, because the levels of a robust
    search give up a fifth of a scan for less ringing. Moves with the same difference share one
    warning.
    """
    off_m = abs(levels.commanded_m - levels.wanted_m)
    if off_m <= (_MEANT * tick_s * levels.speed_m_s if written else _SEEN_M):
        return
    text = (
        f"{axis} is commanded to {cylinder.place(levels.commanded_m, '.2f')} instead of "
        f"{cylinder.place(levels.wanted_m, '.2f')}: "
    )
    if written:
        text += "so much its levels cover"
    else:
        meets_m_s = levels.speed_m_s * levels.wanted_m / levels.commanded_m
        text += (
            f"whole scans of {tick_s * 1e3:g} ms at {cylinder.pace(levels.speed_m_s)}; set the "
            f"flow to {cylinder.pace(meets_m_s, '.6g')} to meet it"
        )
    for index, one in enumerate(warnings):
        if one.endswith(f": {text}"):
            warnings[index] = f"{one.removesuffix(f': {text}')}, {source.line}: {text}"
            return
    warnings.append(f"{source.place}: {text}")
