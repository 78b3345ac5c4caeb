"""What a step of a cycle may not do: move without air, wait for ever, or against an interlock."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from threadline.errors import PlanError
from threadline.jobs.operations import Source
from threadline.machine import Machine
from threadline.machine.pneumatics import Contact
from threadline.targets.schedule_moves import Levels

_SEEN_M = 1e-6
_MEANT = 0.25  # of a scan: levels that are written out may cover so much less or more


def reads_on(contact: Contact, place_m: float) -> bool:
    """Say whether an end switch is on with its piston at a place."""
    assert contact.at is not None
    return place_m <= contact.at.si if contact.beyond == "below" else place_m >= contact.at.si


def check_air(machine: Machine, state: Mapping[str, int], source: Source) -> None:
    """Refuse a move before the soft-start valve is open."""
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
    """Refuse a wait that would be a fault before an input has been read once more."""
    if timeout_s < scan_s * (1.0 - 1e-9):
        raise PlanError(
            f"timeout = {timeout_s * 1e3:g} ms is shorter than a scan, {scan_s * 1e3:g} ms",
            place=source.place,
            remedy="Give a scan or more; the PLC rounds it up to whole scans.",
        )


def check_wait(
    machine: Machine, position: Mapping[str, float], name: str, value: bool, source: Source
) -> list[str]:
    """Refuse a wait for an end switch whose piston stands elsewhere; warn of one at its edge."""
    contact = machine.contacts[name]
    if contact.cylinder is None or contact.at is None:
        return []
    place_m = position[contact.cylinder]
    if reads_on(contact, place_m) != value:
        raise PlanError(
            f"the input {name!r} would never {'come' if value else 'go'}: "
            f"{contact.cylinder} stands at {place_m * 1e3:g} mm then, and {name} is on "
            f"{contact.beyond} {contact.at.si * 1e3:g} mm",
            place=source.place,
            remedy="Wait for another input, or move there first.",
        )
    if abs(place_m - contact.at.si) > contact.at.tolerance_si:
        return []
    return [
        f"{source.place}: the input {name!r} may never {'come' if value else 'go'}: "
        f"{contact.cylinder} stands at {place_m * 1e3:g} mm then, and {name} switches at "
        f"{contact.at.si * 1e3:g} mm +- {contact.at.tolerance_si * 1e3:g} mm; move beyond it"
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
    """Refuse a step in which something moves or is on that an interlock forbids there.

    Parameters
    ----------
    moving, on
        Cylinders that move in the step, and outputs that are on in it.
    before, after
        Where every cylinder stands at its begin and at its end, m.
    on_its_way
        Cylinders that have not come to rest since they moved, and whose arrival no wait has told.

    Raises
    ------
    PlanError
        With the line, the switch and where its piston is.
    """
    told = [(f"{axis} moves", machine.cylinders[axis].needs) for axis in moving]
    told += [(f"{name} is on", machine.outputs[name].needs) for name in on]
    going = set(on_its_way)
    for what, needs in told:
        for name in needs:
            contact = machine.contacts[name]
            other = str(contact.cylinder)
            if not (reads_on(contact, before[other]) and reads_on(contact, after[other])):
                ends = dict.fromkeys(f"{m[other] * 1e3:g}" for m in (before, after))
                raise PlanError(
                    f"{what} only with {name} on, and {other} is at {' to '.join(ends)} mm then",
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
    axis: str,
    tick_s: float,
    source: Source,
    *,
    written: bool,
) -> None:
    """Add a warning where whole scans do not meet a distance; none where they do.

    Levels that the list writes out itself are what it means, to a quarter of a scan: those of a
    robust search trade a fifth of one for less ringing. Moves that miss alike share a warning.
    """
    off_m = abs(levels.commanded_m - levels.wanted_m)
    if off_m <= (_MEANT * tick_s * levels.speed_m_s if written else _SEEN_M):
        return
    told = (
        f"{axis} is told {levels.commanded_m * 1e3:.2f} mm instead of "
        f"{levels.wanted_m * 1e3:.2f} mm: "
    )
    if written:
        told += "so much its levels cover"
    else:
        meets_m_s = levels.speed_m_s * levels.wanted_m / levels.commanded_m
        told += (
            f"whole scans of {tick_s * 1e3:g} ms at {levels.speed_m_s:g} m/s; set the flow to "
            f"{meets_m_s:.6g} m/s to meet it"
        )
    for index, one in enumerate(warnings):
        if one.endswith(f": {told}"):
            warnings[index] = f"{one.removesuffix(f': {told}')}, {source.line}: {told}"
            return
    warnings.append(f"{source.place}: {told}")
