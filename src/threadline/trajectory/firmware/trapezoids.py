"""Chords and their corners -> the motion that the firmware makes of them by itself.

Every move is sped up, held and braked at the acceleration that its axes allow. At a corner the
speed of an axis steps: that is what these planners do, and the twin shows what comes of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.machine import Machine
from threadline.machine.motion_planner import FirmwarePlanner, KlipperPlanner, LinuxCncPlanner
from threadline.path.types import PlannedPath
from threadline.trajectory.firmware.firmware_moves import Moves
from threadline.trajectory.firmware.linuxcnc_run import LinkedRun
from threadline.trajectory.firmware.look_ahead import entries_of_ring, speeds_with_cruise
from threadline.trajectory.firmware.moves_in_hand import MovesInHand
from threadline.trajectory.firmware.rules import Rules
from threadline.trajectory.types import TrajectoryBlock


def firmware_blocks(
    path: PlannedPath, machine: Machine, planner: FirmwarePlanner
) -> Iterator[TrajectoryBlock]:
    """Yield the motion along the chords of ``path`` as ``planner`` of ``machine`` times it.

    The firmware is taken to have as many blocks in hand as it can: its link keeps up.
    """
    rules = Rules.of(planner, machine, path.axes)
    under_way: MovesInHand = _Run(rules)
    if isinstance(planner, LinuxCncPlanner):
        under_way = LinkedRun(rules, planner=planner)
    for block in path:
        edges = [0, *(np.flatnonzero(block.rest_after) + 1).tolist()]
        for first, stop in zip(edges, [*edges[1:], len(block)], strict=True):
            if first < stop:
                ends = bool(block.rest_after[stop - 1])
                yield from under_way.extend(block, slice(first, stop), ends=ends)


@dataclass(slots=True)
class _Run(MovesInHand):
    """Moves that follow each other in trapezoids of speed."""

    speed: float = 0.0  # v^2 at which the first move in hand begins
    smooth: float = 0.0  # the same in Klipper's second plan
    cruise: float = 0.0  # the greatest v^2 of the move that is out

    def _rest(self) -> None:
        self.speed, self.smooth, self.cruise = 0.0, 0.0, 0.0

    def _settle(self, ends: bool) -> Iterator[TrajectoryBlock]:
        moves = self.rules.moves(self.way[0], self.nominal_s[0])
        most = self.rules.corners(moves)
        if not self.begun:
            self.speed = most[0]
        gain = 2.0 * moves.acceleration * moves.length
        planner = self.rules.planner
        if isinstance(planner, KlipperPlanner):
            slow = (1.0 - planner.cruise_ratio) * moves.most_acceleration
            smooth = np.minimum(2.0 * slow * moves.length, gain)
            enter, leave, peak, fixed, first, second = speeds_with_cruise(
                most, moves.speed**2, gain, smooth, self.speed, self.smooth, self.cruise
            )
        else:
            assert not isinstance(planner, LinuxCncPlanner)  # it has a run of its own
            ends_at = entries_of_ring(most, gain, planner.look_ahead, self.speed)
            enter, leave = ends_at[:-1], ends_at[1:]
            peak = np.minimum(moves.speed**2, 0.5 * (enter + leave + gain))
            fixed = len(moves) - planner.look_ahead
            first = second = ends_at
        out = len(moves) if ends else min(fixed, len(moves) - 1)
        if out <= 0:
            return
        yield from self._trapezoids(moves, enter, leave, peak, out)
        self.begun = True
        if out < len(moves):
            self.speed, self.smooth = float(first[out]), float(second[out])
        self.cruise = float(peak[out - 1])
        self._keep(out)

    def _trapezoids(
        self, moves: Moves, enter: FloatArray, leave: FloatArray, peak: FloatArray, count: int
    ) -> Iterator[TrajectoryBlock]:
        rows = slice(0, count)
        length, rate = moves.length[rows], moves.acceleration[rows]
        v0, v1, top = (np.sqrt(v[rows]) for v in (enter, leave, peak))
        up = (peak[rows] - enter[rows]) / (2.0 * rate)
        down = (peak[rows] - leave[rows]) / (2.0 * rate)
        level = np.maximum(length - up - down, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            time_s = np.stack(
                [
                    np.where(up > 0.0, (top - v0) / rate, 0.0),
                    np.where(level > 0.0, level / top, 0.0),
                    np.where(down > 0.0, (top - v1) / rate, 0.0),
                ],
                axis=1,
            )
        # Along the move, as shares of its way: where each part begins, its speed and acceleration.
        ends = np.stack([np.zeros(count), up, up + level], axis=1) / length[:, None]
        speed = np.stack([v0, top, top], axis=1) / length[:, None]
        bend = np.stack([rate, np.zeros(count), -rate], axis=1) / length[:, None]
        way, start = self.way[0][rows], self.start[0][rows]
        shares = np.stack([ends, speed * time_s, 0.5 * bend * time_s**2], axis=2)
        coefficients = shares[:, :, :, None] * way[:, None, None, :]
        coefficients[:, :, 0] += start[:, None]
        yield self._timed(time_s, coefficients, self.operation[0][rows])
