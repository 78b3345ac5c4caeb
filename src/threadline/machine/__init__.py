"""Machines as data: the parts, the file, the library."""

from threadline.machine.load import library_names, load_machine
from threadline.machine.model import Machine
from threadline.machine.quantity import Provenance, Quantity

__all__ = ["Machine", "Provenance", "Quantity", "library_names", "load_machine"]
