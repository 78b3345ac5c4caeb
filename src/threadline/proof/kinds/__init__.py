"""The table of kinds of work: how each plans, simulates, varies, measures and writes."""

from threadline.files import Commands
from threadline.machine import Machine
from threadline.proof.kinds.kind import Kind
from threadline.proof.kinds.steps import STEPS
from threadline.proof.kinds.switches import SWITCHES
from threadline.proof.kinds.ticks import TICKS, check_loops

KINDS: dict[str, Kind] = {kind.name: kind for kind in (TICKS, SWITCHES, STEPS)}
"""Every kind of work, by its value of ``Machine.commanded_by``."""


def kind_of(machine: Machine) -> Kind:
    """Return the kind of work that a machine does."""
    return KINDS[machine.commanded_by]


def kind_of_commands(commands: Commands) -> Kind:
    """Return the kind of work that commands belong to."""
    return next(kind for kind in KINDS.values() if isinstance(commands, kind.commands))


__all__ = ["KINDS", "Kind", "check_loops", "kind_of", "kind_of_commands"]
