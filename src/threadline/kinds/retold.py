"""Commands that are told to another machine than the one that they were made for, on purpose."""

from __future__ import annotations

from dataclasses import replace

from threadline.machine import Machine
from threadline.signals import Commands


def retold(commands: Commands, machine: Machine) -> Commands:
    """Return ``commands`` as they are told to ``machine``, which is not quite the planned one.

    A machine within the tolerances has a hash of its own, and the commands of the machine as its
    file says; a simulation refuses commands of another hash, for those would be a mistake.
    """
    return replace(commands, machine_sha256=machine.sha256)
