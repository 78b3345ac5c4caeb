"""Makes light, flexible machines move fast and land still, and proves it."""

from __future__ import annotations

from importlib import import_module

__version__ = "0.1.0"

__all__ = [
    "analyse", "compare", "compile", "control", "design", "equal", "fastest", "fit", "judge",
    "learn", "load_machine", "measure", "prove", "retime", "run", "shaper", "trim", "tune",
    "wind", "yields",
]  # fmt: skip
_WITHOUT_MACHINE = {
    "retime": "threadline.motion.timing.retime",
    "shaper": "threadline.motion.shaping.designs",
}


def __getattr__(name: str) -> object:
    """Return a function of ``threadline.face``, which is imported when the first one is used.

    ``import threadline`` alone imports neither numpy nor numba, and the functions that need no
    machine come without the others. ``__init__.pyi`` declares the types of the functions.
    """
    if name not in __all__:
        raise AttributeError(f"module 'threadline' has no attribute {name!r}")
    return getattr(import_module(_WITHOUT_MACHINE.get(name, "threadline.face")), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
