"""What a kernel is compiled for, and where each number lies in its workspace."""

from __future__ import annotations

from typing import NamedTuple


class Shape(NamedTuple):
    """What a kernel is compiled for."""

    states: int
    drives: int
    controllers: int
    axes: int
    guards: int
    checks: int  # rows per guard
    lengths: int
    lanes: int
    feedback: bool  # controllers use their earlier outputs
    second: bool  # controllers look two ticks back
    peak: bool  # currents are watched
    quantised: bool
    delayed: bool  # some command is under way longer than no time
    limited: bool  # some drive's input has a limit of its own
    bodies: int  # the first states are their coordinates: all that sensors and loads look at
    reversal: bool  # every controller puts a zero tick where its level changes sign
    shared: bool  # every tick each controller reads just what is its axis' load

    def layout(self) -> dict[str, int]:
        """Return where each part of the workspace begins, in rows of ``lanes`` floats."""
        n, size = self.states, self.states + self.drives + 1
        k, a, d = self.controllers, self.axes, self.drives
        parts = {
            "z": size,
            "next": n,
            "control": 18 * k,
            "sensor": self.bodies * k,
            "measure": 5 * a,
            "load": self.bodies * a,
            "peak": d,
            "current": d * size,
            "low": self.guards,
            "high": self.guards,
            "matrix": self.lengths * n * size,
            "watch": self.lengths * self.guards * self.checks * size,
        }
        offsets, at = {}, 0
        for name, rows in parts.items():
            offsets[name] = at
            at += rows
        offsets["rows"] = at
        return offsets

    def numbers(self) -> tuple[int, ...]:
        """Return all that a kernel has to know, as integers: sizes, switches, places."""
        at = self.layout()
        names = ("next", "control", "sensor", "measure", "load", "peak", "current", "low", "high")
        return (
            self.states,
            self.drives,
            self.controllers,
            self.axes,
            self.guards,
            self.checks,
            self.lengths,
            int(self.feedback),
            int(self.second),
            int(self.peak),
            int(self.quantised),
            int(self.delayed),
            int(self.limited),
            self.bodies,
            int(self.reversal),
            int(self.shared),
            *(at[name] for name in (*names, "matrix", "watch")),
        )


# Rows of a controller in the workspace.
(
    E1,
    E2,
    O1,
    O2,
    LEVEL,
    B0,
    B1,
    B2,
    A1,
    A2,
    LOW,
    HIGH,
    VOLT,
    GAIN,
    LIMIT,
    PHASE,
    ZERO,
    HELD,
) = range(18)
# Rows of an axis: largest |commanded - load|, least and greatest load of the window, last, scale.
WORST, LOWEST, HIGHEST, LAST, SCALE = range(5)
# Entries of ``clock``, before the heads of the dead times (written, read).
STEP, UNTIL_SAMPLE, TICK, HEADS = 0, 1, 2, 3
