"""What the options that several commands share choose: a machine, and how to plan."""

from __future__ import annotations

from pathlib import Path

from threadline.machine import Machine, load_machine
from threadline.machine.par import read_parameters
from threadline.options import options_of

__all__ = ["machine_from", "options_of"]


def machine_from(reference: str, par: Path | None) -> Machine:
    """Return the machine that the options name."""
    machine = load_machine(reference)
    return machine if par is None else read_parameters(par, machine)
