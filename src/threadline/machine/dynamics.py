"""Whether anything is known of what the drives of a machine move."""

from __future__ import annotations

from threadline.errors import OptionError
from threadline.machine.model import Machine


def check_dynamics(asked: str, *machines: Machine | None) -> None:
    """Refuse to tell of machines with limits alone what only masses, motors and loops tell.

    Parameters
    ----------
    asked
        What needs them, as the subject of a sentence: ``"how axis X swings"``.
    machines
        Of which it is asked; None for one that is not there.

    Raises
    ------
    OptionError
        If one of the machine files has no dynamics.
    """
    for machine in machines:
        if machine is not None and machine.without_dynamics:
            raise OptionError(
                f"the machine file of {machine.name} has no dynamics, only limits: {asked} "
                "cannot be told from it",
                place=machine.place,
                remedy="Leave it out, or describe the bodies and drives: docs/machines.md.",
            )
