"""Machines for the tests of the timing."""

from __future__ import annotations

from dataclasses import replace


def without_drives(machine):
    """Return a machine whose drives allow everything that its axes may do."""
    drives = {
        name: replace(drive, amplifier=replace(drive.amplifier, current_limit=None))
        for name, drive in machine.drives.items()
    }
    controllers = {
        name: replace(
            part, dac=replace(part.dac, range=replace(part.dac.range, si=1e6 * part.dac.range.si))
        )
        for name, part in machine.controllers.items()
    }
    return replace(machine, drives=drives, controllers=controllers)
