"""Imports without garbage collection: imported objects stay until the program ends."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator, Mapping
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


def program_apart(program: str) -> tuple[str, ...]:
    """Return the words that start a process of this interpreter with a program.

    The process imports nothing from the folder where it starts: that may be a project folder with a
    file named like a module, such as ``token.py``.
    """
    return sys.executable, "-P", "-c", program


def later(package: str, homes: Mapping[str, str]) -> Callable[[str], object]:
    """Return a module's ``__getattr__`` that imports each name when it is first asked for.

    A package that re-exports names so costs its importers only the files that they use:
    ``tl.shaper`` needs neither the readers of jobs nor the models of machines.

    Parameters
    ----------
    package
        Name of the package whose ``__getattr__`` this is.
    homes
        Names by the file of the package that defines them, with blanks between them. None may be
        the name of a file: the package has the file by this name as soon as anyone imports it.

    Raises
    ------
    AttributeError
        By the returned function, for a name that no file defines.

    >>> later("threadline.base", {"arrays": "read_only"})("read_only").__module__
    'threadline.base.arrays'
    """
    home_of = {name: home for home, names in homes.items() for name in names.split()}

    def attribute(name: str) -> object:
        home = home_of.get(name)
        if home is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        found: object = getattr(import_module(f"{package}.{home}"), name)
        setattr(sys.modules[package], name, found)
        return found

    return attribute
