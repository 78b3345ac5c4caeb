"""Which machines have dynamics: masses, motors and loops that a simulation can use."""

from __future__ import annotations

from threadline.errors import OptionError
from threadline.machine.model import Machine


def check_dynamics(asked: str, *machines: Machine | None) -> None:
    """Refuse a question that needs dynamics about machines of which only limits are known.

    Parameters
    ----------
    asked
        The question, as the subject of a sentence: ``"how axis X swings"``.
    machines
        The machines that it is about; None for one that was not given.

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
