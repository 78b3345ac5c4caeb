"""Types of the functions, written by python -m tools.options_reference."""

from collections.abc import Sequence
from typing import Literal

from threadline.answers import Answer, Found, PathLike, Proved
from threadline.face import load_machine as load_machine
from threadline.face import retime as retime
from threadline.face import shaper as shaper
from threadline.machine import Machine
from threadline.search import Comparison
from threadline.signals.files import Written
from threadline.verdict import Spec

__version__: str
__all__ = ["compare", "compile", "fastest", "judge", "load_machine", "prove", "retime", "shaper"]

def compare(
    job: PathLike,
    machine: PathLike | Machine,
    interpolations: Sequence[str] = ...,
    feeds: Sequence[str] = (),
    *,
    shapers: Sequence[str] = (),
    with_fastest: bool = False,
    spec: PathLike | Spec | None = None,
    par: PathLike | None = None,
    dialect: str | None = None,
    feed_mode: str | None = None,
    radius: str | None = None,
    offset: str | None = None,
    needle: str | None = None,
    tolerance: str = "0.1 mm",
    limits: str = "100 %",
    mode: str | None = None,
    damping: float | str | None = None,
    feed_forward: bool = False,
    smoothing: str | None = None,
    robust: str | None = None,
    contour: str | None = None,
    level: Literal["nominal", "repeated", "over tolerances"] = "repeated",
    repeats: int | None = None,
    yield_: str | None = None,
    ends: str | None = None,
) -> Comparison: ...

def compile(
    job: PathLike,
    machine: PathLike | Machine,
    target: str,
    out: PathLike,
    *,
    par: PathLike | None = None,
    interpolation: str = "auto",
    law: str | None = None,
    feed: str | None = None,
    dialect: str | None = None,
    feed_mode: str | None = None,
    radius: str | None = None,
    offset: str | None = None,
    needle: str | None = None,
    tolerance: str = "0.1 mm",
    limits: str = "100 %",
    shaper: str | None = None,
    mode: str | None = None,
    damping: float | str | None = None,
    feed_forward: bool = False,
    smoothing: str | None = None,
    robust: str | None = None,
    contour: str | None = None,
) -> list[Written]: ...

def fastest(
    job: PathLike,
    machine: PathLike | Machine,
    *,
    spec: PathLike | Spec | None = None,
    par: PathLike | None = None,
    actual: PathLike | Machine | None = None,
    interpolation: str = "auto",
    law: str | None = None,
    dialect: str | None = None,
    feed_mode: str | None = None,
    radius: str | None = None,
    offset: str | None = None,
    tolerance: str = "0.1 mm",
    shaper: str | None = None,
    feed_forward: bool = False,
    smoothing: str | None = None,
    robust: str | None = None,
    contour: str | None = None,
    level: Literal["nominal", "repeated", "over tolerances"] = "repeated",
    repeats: int | None = None,
    yield_: str | None = None,
    margin: str = "0 %",
) -> Found: ...

def judge(
    recordings: PathLike | Sequence[PathLike],
    *,
    job: PathLike | None = None,
    machine: str | None = None,
    spec: PathLike | Spec | None = None,
    par: PathLike | None = None,
    actual: PathLike | Machine | None = None,
    interpolation: str | None = None,
    law: str | None = None,
    feed: str | None = None,
    dialect: str | None = None,
    feed_mode: str | None = None,
    radius: str | None = None,
    offset: str | None = None,
    needle: str | None = None,
    tolerance: str | None = None,
    limits: str | None = None,
    shaper: str | None = None,
    mode: str | None = None,
    damping: float | str | None = None,
    feed_forward: bool = False,
    smoothing: str | None = None,
    robust: str | None = None,
    contour: str | None = None,
) -> Answer: ...

def prove(
    job: PathLike,
    machine: PathLike | Machine,
    *,
    spec: PathLike | Spec | None = None,
    par: PathLike | None = None,
    actual: PathLike | Machine | None = None,
    interpolation: str = "auto",
    law: str | None = None,
    feed: str | None = None,
    dialect: str | None = None,
    feed_mode: str | None = None,
    radius: str | None = None,
    offset: str | None = None,
    needle: str | None = None,
    tolerance: str = "0.1 mm",
    limits: str = "100 %",
    shaper: str | None = None,
    mode: str | None = None,
    damping: float | str | None = None,
    feed_forward: bool = False,
    smoothing: str | None = None,
    robust: str | None = None,
    contour: str | None = None,
    level: Literal["nominal", "repeated", "over tolerances"] = "repeated",
    repeats: int | None = None,
    yield_: str | None = None,
    ends: str | None = None,
) -> Proved: ...
