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

    Imports create a hundred thousand objects, which stay until the program ends. A search for
    garbage among them takes a tenth of the import time, and the same time again at exit.
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
    """Return the command line, word by word, that runs a program with this interpreter.

    The process imports nothing from its working directory, because this may be a project folder
    with a file that is named like a module, such as ``token.py``.
    """
    return sys.executable, "-P", "-c", program


def later(package: str, homes: Mapping[str, str]) -> Callable[[str], object]:
    """Return a module's ``__getattr__`` that imports each name when it is first used.

    An import of a package with re-exported names then loads only the files that are used:
    ``tl.shaper`` needs neither the readers of jobs nor the models of machines.

    Parameters
    ----------
    package
        Name of the package that gets the ``__getattr__``.
    homes
        File of the package -> names that the file defines, separated by blanks. A name must not be
        the name of a file: after an import of this file the name would stand for the file.

    Raises
    ------
    AttributeError
        Raised by the returned function, for a name that no file defines.

    >>> later("threadline.base", {"arrays": "read_only"})("read_only").__module__
    'threadline.base.arrays'
    """
    home_of = {name: home for home, names in homes.items() for name in names.split()}

    def attribute(name: str) -> object:
        home = home_of.get(name)
        if home is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value: object = getattr(import_module(f"{package}.{home}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return attribute
