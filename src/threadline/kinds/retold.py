"""Commands that are played, on purpose, on another machine than the one they were made for."""

from __future__ import annotations

from dataclasses import replace

from threadline.machine import Machine
from threadline.signals import Commands


def retold(commands: Commands, machine: Machine) -> Commands:
    """Return ``commands`` with the hash of ``machine``, so that a simulation of it accepts them.

    A simulation refuses commands that were made for a machine with another hash. A machine within
    the tolerances has its own hash, and is meant to play the commands of the nominal machine.
    """
    return replace(commands, machine_sha256=machine.sha256)
