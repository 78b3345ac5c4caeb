"""Imports without garbage collection: imported objects stay until the program ends."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType


@contextmanager
def collecting_no_garbage() -> Iterator[None]:
    """Import without garbage collection, and exclude the imported objects from later collections.

    Imports create a hundred thousand objects that stay until the program ends. Searching them for
    garbage takes a tenth of the import time, and as much again at exit.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def imported(name: str) -> ModuleType:
    """Import the module ``name`` without garbage collection and return it."""
    with collecting_no_garbage():
        return import_module(name)


def import_and_call(module: str, function: str) -> str:
    """Return Python source that imports a module with ``imported`` and calls its function.

    >>> import_and_call("threadline.base.arrays", "be")
    "from threadline.base.importing import imported; imported('threadline.base.arrays').be()"
    """
    return f"from {__name__} import imported; imported({module!r}).{function}()"
