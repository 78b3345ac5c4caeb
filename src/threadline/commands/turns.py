"""The intent of a design: every turn of the shaft, and what is sewn with each thread."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.files import Event, StepPlay
from threadline.jobs.operations import Job, Thread
from threadline.machine import Machine

if TYPE_CHECKING:
    from threadline.commands.stitch_pace import Moves, Pace
    from threadline.motion.laws import Law


_CONVERGED = 1.0 + 1e-5
"""Factor on a tolerance: a stitch beyond it is over the tolerance by more than rounding."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Turns:
    """Every turn of the shaft; n turns, A axes.

    Parameters
    ----------
    moves
        Moves of the frame.
    operation, line
        (n,) operation of the job, and record of the file.
    stitch, block
        (n,) numbers of the stitch and of its block, both from 1; stitch is 0 while the needle is
        up.
    turn_s
        (n,) planned time of each turn.
    begin, window
        (n,) start and length of each window, in ticks of the timer.
    events
        Events of the job, by turn.
    """

    moves: Moves
    operation: IntArray
    line: IntArray
    stitch: IntArray
    block: IntArray
    turn_s: FloatArray
    begin: IntArray
    window: IntArray
    events: tuple[Event, ...]

    def __len__(self) -> int:
        return len(self.stitch)

    def name(self, turn: int) -> str:
        """Return the name of a turn: its block and stitch."""
        if self.stitch[turn]:
            return f"block {self.block[turn]}, stitch {self.stitch[turn]}"
        return f"block {self.block[turn]}, travel behind stitch {self.stitch[:turn].max(initial=0)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Sewn:
    """The part of a design that is sewn with one thread.

    Parameters
    ----------
    block
        Number of the block, from 1.
    thread
        Thread of the block; None if the file does not say its colour.
    stitches
        Number of stitches.
    thread_m
        Length of the upper thread from hole to hole, jumps inside the block included, m.
    duration_s
        Time of the turns of the block, travel to its first stitch included, s.
    """

    block: int
    thread: Thread | None
    stitches: int
    thread_m: float
    duration_s: float

    def as_json(self) -> dict[str, Any]:
        """Return the entries for the JSON of a verdict."""
        return {
            "block": self.block,
            "colour": self.thread.rgb if self.thread else None,
            "name": self.thread.name if self.thread else "",
            "stitches": self.stitches,
            "thread_m": self.thread_m,
            "duration_s": self.duration_s,
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stitched:
    """The plan of a design on a machine with a main shaft.

    Parameters
    ----------
    job, machine, law
        Job, machine and motion law of the plan.
    commands
        Commands for the controller.
    turns
        Every planned turn.
    pace
        Time that each turn needs, and the swing tolerance of the plan.
    constant, speed_requested
        Whether the shaft turns at one speed, and whether the user gave that speed.
    independent_s
        Time if each stitch were planned as if the frame were at rest before it, on a spindle
        without inertia, s. A schedule that cancels the swing of earlier stitches may be shorter.
    slowest_s
        Time at the constant speed that the slowest stitch alone needs, s.
    bound_s
        No schedule on the grid of speeds takes less time, s; None without a schedule.
    """

    job: Job
    machine: Machine
    law: Law
    commands: StepPlay
    turns: Turns
    pace: Pace
    constant: bool
    speed_requested: bool
    independent_s: float
    slowest_s: float
    bound_s: float | None

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes, in the order of all columns."""
        return self.commands.axes

    @property
    def duration_s(self) -> float:
        """Duration of the commands, s."""
        return self.commands.duration_ticks * float(self.commands.clock.period_s)

    @property
    def historical(self) -> bool:
        """False: moves of a design keep the machine's limits, or the verdict checks them."""
        return False

    @property
    def warnings(self) -> tuple[str, ...]:
        """Stitches that the forecast puts beyond the tolerance, unless the user gave the speed."""
        if self.speed_requested:
            return ()
        turns, limit_m = self.turns, self.pace.tolerance_m
        swings_m = self.pace.robust_swings_m(turns.moves, turns.turn_s)
        over = np.flatnonzero(swings_m > limit_m * _CONVERGED)
        if not len(over):
            return ()
        worst = int(np.argmax(swings_m))
        return (
            f"no speeds of the shaft were found at which every needle enters within "
            f"{limit_m * 1e3:.4g} mm: {len(over)} of {int((turns.stitch > 0).sum())} stitches are "
            f"forecast beyond it, the worst by {swings_m[worst] * 1e3:.4g} mm at "
            f"{turns.name(worst)}. Give a larger --tolerance, a smaller --robust, or another --law",
        )

    def interpolation(self, options: Mapping[str, str]) -> str:  # noqa: ARG002
        """Return the motion law, which takes the place of an interpolation."""
        return f"law:{self.law.name}"

    def planned_with(self, options: Mapping[str, str]) -> str:  # noqa: ARG002
        """Return words for law and speed of the plan."""
        speed = f"{60.0 / float(self.turns.turn_s.max()):.4g}"
        if np.ptp(self.turns.turn_s) > 0.0:
            fastest = 60.0 / float(self.turns.turn_s.min())
            return f"{self.law.name}, {speed} to {fastest:.4g} stitches a minute"
        return f"{self.law.name}, {speed} stitches a minute"

    def json_entries(self, options: Mapping[str, str]) -> dict[str, Any]:  # noqa: ARG002
        """Return the entries about stitches for the JSON of a verdict."""
        sewn = self.turns.stitch > 0
        return {
            "stitches": {
                "count": int(sewn.sum()),
                "frame_moves": int(self.frame_moves.sum()),
                "longest_move_m": self.longest_move_m,
                "turns": len(self.turns),
                "steps": int(np.abs(self.turns.moves.units).sum()) * self.steps_per_unit,
                "law": self.law.name,
                "constant_speed": self.constant,
                "slowest_turn_s": float(self.turns.turn_s.max()),
                "fastest_turn_s": float(self.turns.turn_s.min()),
                "each_alone_s": self.independent_s,
                "slowest_alone_s": self.slowest_s,
                "schedule_bound_s": self.bound_s,
                "robust_share": self.pace.robust_share,
                "threads": [one.as_json() for one in self.sewn],
            }
        }

    @property
    def sewn(self) -> list[Sewn]:
        """Stitches, length and time of each thread, in the order of the design.

        A thread change behind the last stitch begins a block that sews nothing: it is left out.
        """
        threads = self.job.threads
        found = []
        for block in np.unique(self.turns.block).tolist():
            own = self.turns.block == block
            holes = self.places_m[own & (self.turns.stitch > 0)]
            if not len(holes):
                continue
            found.append(
                Sewn(
                    block=block,
                    thread=threads[block - 1] if block <= len(threads) else None,
                    stitches=len(holes),
                    thread_m=float(np.hypot(*np.diff(holes, axis=0).T).sum()),
                    duration_s=float(self.turns.turn_s[own].sum()),
                )
            )
        return found

    @property
    def frame_moves(self) -> IntArray:
        """(n,) 1 where the frame moves from stitch to stitch, pulling the thread."""
        sewn = self.turns.stitch > 0
        follows = np.concatenate(([False], sewn[:-1]))
        return np.asarray(sewn & follows, dtype=np.int64)

    @property
    def longest_move_m(self) -> float:
        """Longest travel of an axis from stitch to stitch, m."""
        travels = np.abs(self.turns.moves.units[self.frame_moves == 1])
        return float(travels.max(initial=0)) * self.pace.tables.unit.si

    @property
    def steps_per_unit(self) -> int:
        """Steps of a drive per unit of the design."""
        return round(float(self.commands.steps_per_unit[0]) * self.pace.tables.unit.si)

    @property
    def places_m(self) -> FloatArray:
        """(n, A) position of the frame after each turn, m."""
        sums = np.cumsum(self.turns.moves.units, axis=0)
        return np.asarray(sums * self.pace.tables.unit.si + np.array(self.job.start))

    def lines_of(self, job: Job, operations: Collection[int]) -> dict[int, int]:  # noqa: ARG002
        """Return the record of each operation, 0 for an operation without one."""
        at = {int(o): int(n) for o, n in zip(self.turns.operation, self.turns.line, strict=True)}
        return {operation: at.get(operation, 0) for operation in operations}
