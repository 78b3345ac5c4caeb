"""The progress of a program on grbl: where it begins, and which lines a position has passed."""

from __future__ import annotations

import re

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import CommandError
from threadline.live.grbl_controller import Controller
from threadline.live.grbl_words import Program
from threadline.live.pace import place_words
from threadline.machine import Machine

OFF_PATH_M = 1e-3
"""Distance from the lines that were sent, m, beyond which a run has failed."""
_AT_END_M = 0.1 * OFF_PATH_M
_STOP = re.compile(rb"M0?0(?![0-9.])")


class Way:
    """The lines of a program from the position where it starts.

    Parameters
    ----------
    program, machine
        The program, and its machine.
    starts
        (axes,) starting position, m or rad.
    """

    def __init__(self, program: Program, machine: Machine, starts: FloatArray) -> None:
        self._lines, self._radius = program.lines, machine.radius_m
        self._durations_s = program.durations_s
        self._ends, self._starts = program.ends * self._radius, starts * self._radius

    def _begin(self, line: int) -> FloatArray:
        begin_m: FloatArray = self._ends[line - 1] if line else self._starts
        return begin_m

    def end_away_m(self, at: FloatArray) -> float:
        """Return the distance of a position from the end of the last line, m."""
        return float(np.linalg.norm(self._begin(len(self._ends)) - at * self._radius))

    def stands_at_stop(self, line: int, at: FloatArray) -> bool:
        """Return whether a line is an M0, and a position the end of the line before.

        grbl answers an M0 only after it is resumed. So the M0 is the first line without an answer,
        and the machine stands at the end of the line before. If it holds anywhere else, the
        operator pressed its button.
        """
        if line >= len(self._lines) or _STOP.search(self._lines[line]) is None:
            return False
        return float(np.linalg.norm(self._begin(line) - at * self._radius)) <= _AT_END_M

    def time_s(self, executed: int, at: FloatArray) -> float:
        """Return the time at the feeds to a position on the line after ``executed`` lines, s.

        The share of the current line counts, too: a line of a winder may take minutes, in which the
        time left would otherwise stand still.
        """
        before_s = float(self._durations_s[:executed].sum())
        if executed >= len(self._ends):
            return before_s
        return before_s + self._share(executed, at) * float(self._durations_s[executed])

    def _share(self, line: int, position: FloatArray) -> float:
        """Return the share of a line before the point of it that is nearest to a position."""
        begin_m = self._begin(line)
        line_vector_m = self._ends[line] - begin_m
        length2_m2 = float(line_vector_m @ line_vector_m)
        position_m = position * self._radius
        return (
            0.0
            if length2_m2 == 0.0
            else float(np.clip((position_m - begin_m) @ line_vector_m / length2_m2, 0.0, 1.0))
        )

    def passed(self, lines: range, at: FloatArray) -> tuple[int | None, float]:
        """Return the number of lines that a position has passed, and its distance from them, m.

        The number is None if the position is on none of ``lines``.
        """
        nearest_m = np.inf
        for k in lines:
            begin_m, share = self._begin(k), self._share(k, at)
            line_vector_m = self._ends[k] - begin_m
            distance_m = float(np.linalg.norm(begin_m + share * line_vector_m - at * self._radius))
            nearest_m = min(nearest_m, distance_m)
            if distance_m <= _AT_END_M and line_vector_m.any():
                return k + (share == 1.0), distance_m
        return None, nearest_m


def refuse_program(
    program: Program, controller: Controller, at: FloatArray, starts: FloatArray
) -> None:
    """Refuse a program that begins elsewhere, has too long a line, or leaves the travel.

    Parameters
    ----------
    at, starts
        (axes,) present position, and position where the program begins, m or rad.

    Raises
    ------
    CommandError
        If the program does so; the message says which of these it is.
    """
    machine = controller.machine
    distances_m = np.abs(at - starts) * machine.radius_m
    if distances_m.max() > OFF_PATH_M:
        k = int(distances_m.argmax())
        name = machine.axis_names[k]
        here, there = (place_words(machine, name, float(position[k])) for position in (at, starts))
        raise CommandError(
            f"axis {name} stands at {here}, the run begins at {there}",
            remedy="Move it there first (run --approach, or Approach of the panel).",
        )
    longest = max(map(len, program.lines), default=0)
    if longest > controller.room:
        raise CommandError(
            f"a line of the program has {longest} characters, the receive buffer of the "
            f"controller {controller.room}",
            remedy="Build its firmware with a larger one.",
        )
    for end in program.ends:
        if name := controller.beyond(end):
            raise CommandError(
                f"axis {name}: the program leaves its travel", remedy="Move the job."
            )


def way_passed(
    program: Program,
    machine: Machine,
    places: tuple[FloatArray, FloatArray],
    executed: tuple[int, int],
) -> tuple[FloatArray, IntArray]:
    """Return where another line began between two reports, and the operations.

    Parameters
    ----------
    program, machine
        The program, and its machine.
    places, executed
        For the two reports: the (axes,) position, and the number of executed lines.

    Returns
    -------
    tuple
        (n,) shares of the motion at which another line began, and (n + 1,) operations.
    """
    executed_before, executed_after = executed
    points_m = (
        np.vstack([places[0], *program.ends[executed_before:executed_after], places[1]])
        * machine.radius_m
    )
    travelled_m = np.cumsum(np.linalg.norm(np.diff(points_m, axis=0), axis=1))
    lines = np.minimum(np.arange(executed_before, executed_after + 1), len(program.operations) - 1)
    return travelled_m[:-1] / max(travelled_m[-1], 1e-12), program.operations[lines]
