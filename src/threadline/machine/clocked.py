"""What of a machine runs on a clock."""

from __future__ import annotations

from threadline.machine.model import Machine


def clocked(machine: Machine) -> list[tuple[str, str]]:
    """Return the kind of each controller, and the scan of a PLC, each with the name of its clock.

    >>> from threadline.machine.load import load_machine
    >>> clocked(load_machine("letter-placer"))
    [('PLC, a scan', 'scan')]
    """
    scans = [] if machine.plc is None else [("PLC, a scan", machine.plc.clock)]
    return [*((loop.kind, loop.clock) for loop in machine.controllers.values()), *scans]
