"""Imports that do not look for garbage: what they make stays until the program ends."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType


@contextmanager
def collecting_no_garbage() -> Iterator[None]:
    """Import without looking for garbage, and never look for it among what is imported.

    Imports make a hundred thousand objects that stay until the program ends. To look through them
    for garbage again and again takes a tenth of the time of an import, and once more at the end.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def imported(name: str) -> ModuleType:
    """Return the module ``name``, imported so."""
    with collecting_no_garbage():
        return import_module(name)


def words_of(module: str, function: str) -> str:
    """Return words of Python with which a process imports a module so, and calls its function.

    >>> words_of("threadline.base.arrays", "be")
    "from threadline.base.importing import imported; imported('threadline.base.arrays').be()"
    """
    return f"from {__name__} import imported; imported({module!r}).{function}()"
