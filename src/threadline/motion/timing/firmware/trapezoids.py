"""Motion of chords and corners as the firmware plans it by itself.

Every move is sped up, held and braked at the acceleration limit of its axes. At a corner the speed
of an axis steps, as these planners accept; the twin shows the effect.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.machine import Machine
from threadline.machine.motion_planner import (
    FirmwarePlanner,
    KlipperPlanner,
    LinuxCncPlanner,
    MarlinPlanner,
)
from threadline.motion.path.types import PlannedPath
from threadline.motion.timing.firmware.linuxcnc_run import LinkedRun
from threadline.motion.timing.firmware.look_ahead import (
    MovesInHand,
    Taken,
    entries_in_marlin,
    entries_of_ring,
    speeds_with_cruise,
)
from threadline.motion.timing.firmware.marlin_moves import (
    executed_moves,
    held_back,
    in_steps,
    least_squares,
    whole_rates,
    whole_steps,
)
from threadline.motion.timing.firmware.rules import Moves, Rules
from threadline.motion.timing.types import TrajectoryBlock


def firmware_blocks(
    path: PlannedPath, machine: Machine, planner: FirmwarePlanner
) -> Iterator[TrajectoryBlock]:
    """Yield the motion along the chords of ``path`` with the timing of the machine's ``planner``.

    The firmware's buffer is assumed to be always full: its link keeps up.
    """
    under_way = moves_of(replace(Rules.of(planner, machine, path.axes), limits=path.limits))
    for block in path:
        edges = [0, *(np.flatnonzero(block.rest_after) + 1).tolist()]
        for first, stop in zip(edges, [*edges[1:], len(block)], strict=True):
            if first < stop:
                is_last = bool(block.rest_after[stop - 1])
                yield from under_way.extend(block, slice(first, stop), is_last=is_last)


def moves_of(rules: Rules) -> MovesInHand:
    """Return the buffer that plans moves as the firmware of ``rules`` does."""
    if isinstance(rules.planner, LinuxCncPlanner):
        return LinkedRun(rules, planner=rules.planner)
    return _MarlinRun(rules) if isinstance(rules.planner, MarlinPlanner) else _Run(rules)


@dataclass(slots=True)
class _Run(MovesInHand):
    """Consecutive moves with trapezoids of speed."""

    speed: float = 0.0  # v^2 at which the first buffered move begins
    smooth: float = 0.0  # the same in Klipper's second plan
    cruise: float = 0.0  # the largest v^2 of the last yielded move

    def _rest(self) -> None:
        self.speed, self.smooth, self.cruise = 0.0, 0.0, 0.0

    def _settle(self, is_last: bool) -> Iterator[TrajectoryBlock]:
        moves, least = self._counted()
        most = np.maximum(self.rules.corners(moves), least)
        if not self.begun:
            self.speed = least[0]
        gain = 2.0 * moves.acceleration * moves.length
        planner = self.rules.planner
        if isinstance(planner, KlipperPlanner):
            smooth_acceleration = (1.0 - moves.cruise_ratio) * moves.most_acceleration
            smooth = np.minimum(2.0 * smooth_acceleration * moves.length, gain)
            enter, leave, peak, fixed, first, second = speeds_with_cruise(
                most, moves.speed**2, gain, smooth, self.speed, self.smooth, self.cruise
            )
        else:
            assert not isinstance(planner, LinuxCncPlanner)  # it has a run of its own
            ends_at = self._ends_at(most, least, gain, planner.look_ahead)
            enter, leave = ends_at[:-1], ends_at[1:]
            peak = np.minimum(moves.speed**2, 0.5 * (enter + leave + gain))
            fixed = len(moves) - planner.look_ahead
            first = second = ends_at
        settled_count = len(moves) if is_last else min(fixed, len(moves) - 1)
        if settled_count <= 0:
            return
        yield from self._trapezoids(moves, enter, leave, peak, settled_count)
        self.begun = True
        if settled_count < len(moves):
            self.speed, self.smooth = float(first[settled_count]), float(second[settled_count])
        self.cruise = float(peak[settled_count - 1])
        self._keep(settled_count)

    def _ends_at(
        self,
        most: FloatArray,
        least: FloatArray,  # noqa: ARG002 - of Marlin alone
        gain: FloatArray,
        ring: int,
    ) -> FloatArray:
        """Return the (n + 1,) v^2 at the ends of the buffered moves."""
        return np.asarray(entries_of_ring(most, gain, ring, self.speed))

    def _counted(self) -> tuple[Moves, FloatArray]:
        """Return the buffered moves as the firmware counts them, and the (n,) least v^2 of each."""
        moves = self.rules.moves(self.way[0], self.nominal_s[0], self.operation[0])
        return moves, np.zeros(len(moves))

    def _trapezoids(
        self, moves: Moves, enter: FloatArray, leave: FloatArray, peak: FloatArray, count: int
    ) -> Iterator[TrajectoryBlock]:
        rows = slice(0, count)
        length, rate = moves.length[rows], moves.acceleration[rows]
        v0, v1, top = (np.sqrt(v[rows]) for v in (enter, leave, peak))
        length_up = (peak[rows] - enter[rows]) / (2.0 * rate)
        length_down = (peak[rows] - leave[rows]) / (2.0 * rate)
        length_level = np.maximum(length - length_up - length_down, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            time_s = np.stack(
                [
                    np.where(length_up > 0.0, (top - v0) / rate, 0.0),
                    np.where(length_level > 0.0, length_level / top, 0.0),
                    np.where(length_down > 0.0, (top - v1) / rate, 0.0),
                ],
                axis=1,
            )
        # Along the move, as shares of its length: start of each part, its speed and acceleration.
        ends = (
            np.stack([np.zeros(count), length_up, length_up + length_level], axis=1)
            / length[:, None]
        )
        speed = np.stack([v0, top, top], axis=1) / length[:, None]
        bend = np.stack([rate, np.zeros(count), -rate], axis=1) / length[:, None]
        yield self._parts(time_s, ends, speed, bend)

    def _parts(
        self, time_s: FloatArray, begin: FloatArray, speed: FloatArray, bend: FloatArray
    ) -> TrajectoryBlock:
        """Return the first buffered moves, n of them in k parts each.

        Parameters
        ----------
        time_s
            (n, k) times of the parts.
        begin, speed, bend
            (n, k) start of each, its speed there and its acceleration, as shares of the length.
        """
        rows = slice(0, len(time_s))
        displacement, start = self.way[0][rows], self.start[0][rows]
        shares = np.stack([begin, speed * time_s, 0.5 * bend * time_s**2], axis=2)
        coefficients = shares[:, :, :, None] * displacement[:, None, None, :]
        coefficients[:, :, 0] += start[:, None]
        return self._timed(time_s, coefficients, self.operation[0][rows])


@dataclass(slots=True)
class _MarlinRun(_Run):
    """Moves between whole steps; a move of a few steps waits for the next.

    Attributes
    ----------
    gone
        Number of moves yielded since the machine rested.
    held
        Starts, displacements, times and operations of waiting moves; None for none.
    rates
        (2, n) steps per second, and per second squared, of the buffered moves.
    """

    gone: int = 0
    held: Taken | None = None
    rates: FloatArray = field(default_factory=lambda: np.zeros((2, 0)))

    def _made(self, taken: Taken, is_last: bool) -> Taken:
        start, displacement, nominal_s, operation = taken
        if self.held is not None:
            start = np.concatenate((self.held[0], start))
            displacement = np.concatenate((self.held[1], displacement))
            nominal_s = np.concatenate((self.held[2], nominal_s))
            operation = np.concatenate((self.held[3], operation))
            self.held = None
        if self.rules.steps is None or not len(displacement):
            return start, displacement, nominal_s, operation
        ends_at, steps = start + displacement, self.rules.scale * self.rules.steps
        is_kept = executed_moves(ends_at * steps, start[0] * steps, last=is_last)
        waiting_count = len(is_kept) - int(is_kept[::-1].argmax()) if is_kept.any() else 0
        if waiting_count < len(is_kept):
            self.held = (
                start[waiting_count:],
                displacement[waiting_count:],
                nominal_s[waiting_count:],
                operation[waiting_count:],
            )
        begin = np.concatenate((start[:1], ends_at[is_kept]))[: is_kept.sum()]
        lengths_before = self.rules.length(displacement[is_kept])
        displacement = ends_at[is_kept] - begin
        nominal_s = nominal_s[is_kept] * self.rules.length(displacement) / lengths_before
        is_moving = displacement.any(axis=1)  # nothing is left if all waiting moves cancel out
        return (
            begin[is_moving],
            displacement[is_moving],
            nominal_s[is_moving],
            operation[is_kept][is_moving],
        )

    def _counted(self) -> tuple[Moves, FloatArray]:
        displacement, nominal_s, steps = self.way[0], self.nominal_s[0], self.rules.steps
        if steps is None:
            return super(_MarlinRun, self)._counted()
        scale = self.rules.scale
        whole_moves = whole_steps(self.start[0] * scale, displacement * scale, steps) / scale
        nominal_s = nominal_s * self.rules.length(whole_moves) / self.rules.length(displacement)
        moves = self.rules.moves(whole_moves, nominal_s)
        with np.errstate(divide="ignore"):
            programmed = np.where(nominal_s > 0.0, moves.length / nominal_s, np.inf)
        programmed = held_back(
            moves.length,
            np.maximum(programmed, self.rules.least_speed),
            self.gone,
            self.rules.short_time_s,
        )
        moves = replace(moves, speed=np.minimum(moves.speed, programmed))
        self.rates = whole_rates(moves, programmed, self.rules.most_acceleration, steps)
        return moves, least_squares(moves, steps)

    def _ends_at(
        self, most: FloatArray, least: FloatArray, gain: FloatArray, ring: int
    ) -> FloatArray:
        return np.asarray(entries_in_marlin(most, least, gain, ring, self.begun, self.speed))

    def _trapezoids(
        self, moves: Moves, enter: FloatArray, leave: FloatArray, peak: FloatArray, count: int
    ) -> Iterator[TrajectoryBlock]:
        if self.rules.steps is None:
            yield from super(_MarlinRun, self)._trapezoids(moves, enter, leave, peak, count)
            return
        rows = slice(0, count)
        ends = enter[rows], leave[rows]
        yield self._parts(*in_steps(moves.part(rows), self.rates[:, rows], *ends, self.rules.steps))

    def _keep(self, done: int) -> None:
        self.gone += done
        super(_MarlinRun, self)._keep(done)

    def _rest(self) -> None:
        self.gone = 0
        super(_MarlinRun, self)._rest()
