"""The names of a sequence's inputs and outputs in its structured text, and times of the text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Words:
    """The names that the program uses, and some of its times.

    Parameters
    ----------
    inputs, outputs
        Name in the machine file to name in the program.
    grids, enables
        Inputs that all must be true while the machine moves.
    start, acknowledge, home
        Inputs whose rising edges count.
    fresh
        By input and value: the variable that says that the input had its other value since it last
        counted.
    watchdog_ms
        A scan that comes later than this after the one before is a fault.
    early_ms
        A transition fires in the scan nearest to its time: half a scan before it already.
    air_ms, dwell_ms
        By hand: how long the air takes to come up, and the rest of the valves between two jogs.
    """

    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    grids: tuple[str, ...]
    enables: tuple[str, ...]
    start: str
    acknowledge: str
    home: str
    fresh: Mapping[tuple[str, bool], str]
    watchdog_ms: int
    early_ms: int
    air_ms: int
    dwell_ms: int
