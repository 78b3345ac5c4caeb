"""The part of a guide that cylinders and their PLC have."""

from __future__ import annotations

from collections.abc import Iterator

from threadline.machine import Machine


def cylinder_rows(machine: Machine) -> Iterator[tuple[str, ...]]:
    """Return a row of the table of axes for each cylinder."""
    for name, cylinder in machine.cylinders.items():
        yield (
            f"{name}, cylinder",
            f"valves {cylinder.forward.valve}, {cylinder.back.valve}",
            f"{1e3 * cylinder.stroke.si:.4g} mm",
            f"{1e3 * cylinder.speed.si:.4g} mm/s ({cylinder.speed.provenance.value})",
            "-",
            "-",
        )


def cylinder_signals(machine: Machine) -> Iterator[tuple[str, ...]]:
    """Return a row of the table of signals for each output and input of the PLC."""
    for name, output in machine.outputs.items():
        needs = f"needs {', '.join(output.needs)}" if output.needs else ""
        yield name, f"PLC {output.address}", f"{output.kind} valve", needs
    for name, contact in machine.contacts.items():
        what, note = str(contact.kind), ""
        if contact.cylinder is not None and contact.at is not None:
            what = f"end switch of {contact.cylinder}"
            note = f"on at {1e3 * contact.at.si:g} mm and {contact.beyond}"
        yield name, what, f"PLC {contact.address}", note


def cylinder_steps(machine: Machine) -> Iterator[tuple[str, str]]:
    """Return the steps of calibration of the cylinders, by hand and with air."""
    for name, contact in machine.contacts.items():
        if contact.cylinder is None or contact.at is None:
            yield f"Work the input {name} ({contact.kind}).", f"{contact.address} follows it."
            continue
        yield (
            f"Without air, push {contact.cylinder} by hand past {1e3 * contact.at.si:g} mm.",
            f"{name} ({contact.address}) is on there and {contact.beyond}, within "
            f"{1e3 * contact.at.tolerance_si:g} mm.",
        )
    for name, output in machine.outputs.items():
        yield (
            f"Without air, switch the output {name} ({output.address}) on and off.",
            f"Its {output.kind} valve follows it.",
        )
    for name, cylinder in machine.cylinders.items():
        stroke_s = full_stroke_s(machine, name)
        for way, word in ((cylinder.forward, "forward"), (cylinder.back, "back")):
            flows = ", ".join(way.flows) or "flow control"
            yield (
                f"With air, and nobody near, let {name} go {word} over its whole stroke by "
                f"{way.valve} and {flows}; trim the flow control.",
                f"It arrives {1e3 * stroke_s:.0f} ms after the valve is switched.",
            )


def full_stroke_s(machine: Machine, name: str) -> float:
    """Return the time of a full stroke from the switching of the valve, s.

    The flow begins after the delay and comes to its speed with a lag of first order, which costs
    one time constant; cushion and air are left out.
    """
    cylinder = machine.cylinders[name]
    return cylinder.delay.si + cylinder.lag.si + cylinder.stroke.si / cylinder.speed.si
