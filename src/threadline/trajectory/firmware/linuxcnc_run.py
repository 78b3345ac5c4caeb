"""LinuxCNC's trajectory planner: lines and arcs that go into each other, and moves that overlap.

Moves in which a rotary axis turns overlap: the next sets out while the one before still brakes, so
that their speeds add up, and both have half of their acceleration. Between moves of X, Y and Z
alone every corner is taken in the fastest of three ways (``corner_choice``), and what is fast at
the end of a piece is found 50 pieces ahead (``linked_speeds``). After G61 moves stop, where they do
not go straight on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.machine.motion_planner import LinuxCncPlanner
from threadline.path.types import PieceBlock
from threadline.trajectory.firmware.junctions import along_axes
from threadline.trajectory.firmware.linked_moves import Links, link
from threadline.trajectory.firmware.linked_speeds import AHEAD, motion
from threadline.trajectory.firmware.linuxcnc_moves import Course, course
from threadline.trajectory.firmware.moves_in_hand import MovesInHand
from threadline.trajectory.firmware.piece_curves import polynomials
from threadline.trajectory.firmware.rules import LINEAR, MM, Rules
from threadline.trajectory.types import TrajectoryBlock

_BACK = np.radians(2.0) ** 2  # squared sum of unit vectors: a corner goes back
_BEHIND = 2 * AHEAD  # moves behind those that are settled


class Corners(NamedTuple):
    """What LinuxCNC measures of n - 1 corners; see ``linked_moves.link``."""

    apart: NDArray[np.bool_]
    plain: NDArray[np.bool_]
    back: NDArray[np.bool_]
    turns: FloatArray
    theta: FloatArray
    cosine: FloatArray
    plane_rate: FloatArray
    plane_speed: FloatArray
    side: FloatArray
    side_2: FloatArray


def corners(rules: Rules, moves: Course) -> Corners:
    """Return the corners of moves.

    A move that leaves X, Y and Z at rest counts as one along X.
    """
    linear = np.array([axis in LINEAR for axis in rules.axes])
    alone = (moves.along[:, ~linear] == 0.0).all(axis=1)
    columns = [LINEAR.index(axis) for axis in rules.axes if axis in LINEAR]
    rate, speed = np.full(len(LINEAR), np.inf), np.full(len(LINEAR), np.inf)
    rate[columns], speed[columns] = rules.acceleration[linear], rules.velocity[linear]
    first = _tangents(moves.onward[:-1, linear], columns)
    second = _tangents(moves.along[1:, linear], columns)
    along = np.clip((first * second).sum(axis=1), -1.0, 1.0)
    aside = second - along[:, None] * first
    size = np.linalg.norm(aside, axis=1)
    aside /= np.where(size > 0.0, size, 1.0)[:, None]
    reach = np.hypot(first, aside)  # of each axis in the plane of the corner
    # Where an arc bends as its corner does, its centre lies on the same side.
    angle = moves.length[:-1] / np.where(moves.bow[:-1] > 0.0, moves.bow[:-1], 1.0)
    last = np.cos(angle)[:, None] * moves.inward[:-1] - np.sin(angle)[:, None] * moves.along[:-1]
    ahead = np.zeros_like(aside)
    ahead[:, columns] = last[:, linear]
    behind = np.zeros_like(aside)
    behind[:, columns] = moves.inward[1:, linear]
    left = along[:, None] * aside - np.sqrt(np.maximum(1.0 - along**2, 0.0))[:, None] * first
    rapid = moves.nominal_s == 0.0
    return Corners(
        rapid[1:] != rapid[:-1],
        alone[1:] & alone[:-1],
        ((first + second) ** 2).sum(axis=1) < _BACK,
        (np.abs(second - first) / rate).max(axis=1),
        0.5 * np.arccos(-along),
        np.sqrt(np.maximum(0.5 * (1.0 - along), 0.0)),
        along_axes(rate, reach),
        along_axes(speed, reach),
        np.sign((ahead * aside).sum(axis=1)),
        np.sign((behind * left).sum(axis=1)),
    )


def _tangents(way: FloatArray, columns: list[int]) -> FloatArray:
    """Return (n, 3) unit vectors along X, Y, Z."""
    found = np.zeros((len(way), len(LINEAR)))
    found[:, columns] = way
    length = np.linalg.norm(found, axis=1)
    found[length == 0.0, 0] = 1.0
    return np.asarray(found / np.where(length == 0.0, 1.0, length)[:, None])


@dataclass(slots=True, kw_only=True)
class LinkedRun(MovesInHand):
    """Moves that LinuxCNC links.

    Attributes
    ----------
    line
        Of the file, of the moves in hand.
    cut, takes, over
        What the corner before the first move in hand took from its length and acceleration, and
        whether it overlaps the move before.
    enter, entered, lasted, since
        How it begins, as in ``linked_speeds.motion``.
    """

    planner: LinuxCncPlanner
    line: list[IntArray] = field(default_factory=list)
    cut: float = 0.0
    takes: float = 0.0
    over: int = 0
    enter: float = 0.0
    entered: float = 0.0
    lasted: float = 0.0
    since: float = 0.0

    def _rest(self) -> None:
        self.cut, self.takes, self.over = 0.0, 0.0, 0
        self.enter, self.entered, self.lasted, self.since = 0.0, 0.0, 0.0, 0.0

    def extend(self, block: PieceBlock, rows: slice, *, ends: bool) -> Iterator[TrajectoryBlock]:
        """Take in moves with their lines."""
        moves = block.coefficients[rows, 1].any(axis=1)
        self.line.append(block.line[rows][moves])
        yield from MovesInHand.extend(self, block, rows, ends=ends)

    def _join(self) -> None:
        MovesInHand._join(self)
        self.line[:] = [np.concatenate(self.line)]

    def _keep(self, done: int) -> None:
        MovesInHand._keep(self, done)
        self.line[:] = [self.line[0][done:]]

    def _settle(self, ends: bool) -> Iterator[TrajectoryBlock]:
        scale = self.rules.scale
        moves = course(
            self.rules,
            self.start[0] * scale,
            self.way[0] * scale,
            self.nominal_s[0],
            self.operation[0],
            self.line[0],
            self.planner.cam_tolerance_m * MM,
        )
        done = len(moves) if ends else len(moves) - _BEHIND
        if done <= 0:
            return
        tolerance = self.planner.tolerance_m * MM
        at = corners(self.rules, moves)
        links = Links(
            *link(
                moves.length,
                *moves.limits(self.rules),
                *at,
                moves.bow,
                tolerance,
                self.planner.exact_stop,
                self.cut,
                self.takes,
                self.over,
            )
        )
        out = len(links.move) if ends else int(links.first[done])
        piece, row, self.enter, self.entered, self.lasted, self.since = motion(
            links.move, links.radius, links.lead, links.extent, links.most, links.speed,
            links.rate, links.limit, links.ends, moves.bow, at.cosine, moves.nominal_s == 0.0,
            tolerance, out, self.enter, self.entered, self.lasted, self.since,
        )  # fmt: skip
        if len(piece):
            coefficients = polynomials(links, moves, piece, row) / scale
            operation = moves.operation[links.move[piece]]
            yield self._timed(row[:, :1], coefficients[:, None], operation)
        if not ends:
            self.cut, self.takes = float(links.cut[done]), float(links.takes[done])
            self.over = int(links.over[done])
        self._keep(int(moves.last[done - 1]) + 1)
