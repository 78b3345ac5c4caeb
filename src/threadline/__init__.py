"""Makes light, flexible machines move fast and land still, and proves it."""

from __future__ import annotations

from importlib import import_module

__version__ = "0.1.0"

__all__ = [
    "compare",
    "compile",
    "control",
    "equal",
    "fastest",
    "fit",
    "judge",
    "learn",
    "load_machine",
    "measure",
    "prove",
    "retime",
    "shaper",
    "trim",
    "tune",
    "wind",
]


def __getattr__(name: str) -> object:
    """Return a function of ``threadline.face``, which is imported when the first one is used.

    ``import threadline`` alone imports neither numpy nor numba. ``__init__.pyi`` declares the
    types of the functions.
    """
    if name not in __all__:
        raise AttributeError(f"module 'threadline' has no attribute {name!r}")
    return getattr(import_module("threadline.face"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
