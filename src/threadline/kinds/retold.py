"""Commands that are played, on purpose, on another machine than the one they were made for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.machine.variants import variant
from threadline.signals import Commands, Recording, TickTable


def retold(commands: Commands, machine: Machine) -> Commands:
    """Return ``commands`` with the hash of ``machine``, so that a simulation of it accepts them.

    A simulation refuses commands that were made for a machine with another hash. A machine within
    the tolerances has its own hash, and is meant to play the commands of the nominal machine.
    """
    return replace(commands, machine_sha256=machine.sha256)


def played_by(commands: Commands, machine: Machine, actual: Machine) -> Commands:
    """Return the commands that were made for ``machine``, for ``actual`` to play.

    Tick tables are returned as they are: their simulation compares axes, clocks and counts.

    Raises
    ------
    OptionError
        If the machines differ in more than their numbers.
    """
    if actual.sha256 == machine.sha256 or isinstance(commands, TickTable):
        return commands
    for what, own, others in (
        ("what moves", machine.moving, actual.moving),
        ("contacts", machine.contacts, actual.contacts),
        ("outputs", machine.outputs, actual.outputs),
    ):
        if own.keys() != others.keys() or machine.commanded_by != actual.commanded_by:
            raise OptionError(
                f"{actual.name} cannot do what is planned for {machine.name}: they differ in "
                f"{what}, and not in numbers alone",
                remedy="Give a machine file that has the planned one as its base.",
            )
    return retold(commands, actual)


def one_by_one(
    simulate: Callable[[Commands, Machine], Recording],
    commands: Commands,
    machine: Machine,
    parts: FloatArray,
    random: np.random.Generator,  # noqa: ARG001
) -> Sequence[Recording]:
    """Simulate machines within the tolerances one after the other, as ``Kind.others`` does it.

    For kinds whose sensors do not differ from run to run: nothing is drawn from the generator.
    """
    machines = [variant(machine, row) for row in parts]
    return [simulate(retold(commands, one), one) for one in machines]
