"""Machines as data: their parts, their files and the library."""

from threadline.machine.load import library_file, library_names, load_machine, overlay_names
from threadline.machine.model import Machine
from threadline.machine.quantity import Provenance, Quantity

__all__ = [
    "Machine",
    "Provenance",
    "Quantity",
    "library_file",
    "library_names",
    "load_machine",
    "overlay_names",
]
