"""What the options that several commands share choose: a machine, and how to plan."""

from __future__ import annotations

from pathlib import Path

from threadline.errors import OptionError
from threadline.machine import Machine, load_machine
from threadline.machine.par import read_parameters
from threadline.options import options_of
from threadline.proof_file import read_key

__all__ = ["key_of", "machine_from", "options_of"]


def machine_from(reference: str, par: Path | None) -> Machine:
    """Return the machine that the options name."""
    machine = load_machine(reference)
    return machine if par is None else read_parameters(par, machine)


def key_of(option: str, key: Path | None, proof: Path | None) -> bytes | None:
    """Return the key that an option names, None without one.

    Raises
    ------
    OptionError
        If there is no proof that it could be of, or its file holds no key.
    """
    if key is None:
        return None
    if proof is None:
        raise OptionError(f"{option} needs the file of a proof", remedy="Give --proof FILE.")
    return read_key(key)
