"""Machines as data: their parts, their files and the library."""

from typing import TYPE_CHECKING

from threadline.base.importing import later

if TYPE_CHECKING:
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

__getattr__ = later(
    __name__,
    {
        "load": "library_file library_names load_machine overlay_names",
        "model": "Machine",
        "quantity": "Provenance Quantity",
    },
)
