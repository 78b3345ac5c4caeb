"""LinuxCNC's trajectory planner: moves that end and begin at the same time.

At a corner the next move sets out while the one before still brakes, so that the speeds of both
add up (its documents, "Trajectory Planning" and "G64 Path Blending"; what they leave open was
fitted to servo cycles of version 2.9, run without a screen: no line of its source was at hand).
Both have half of the acceleration. So it blends every move in which a rotary axis takes part. Moves
of X Y Z alone it blends by arcs, unless ``[TRAJ]ARC_BLEND_ENABLE = 0``; they are taken as with that
setting. After G61 such moves have up to a tenth less acceleration (``Rules.kinks``).

A move of length L, acceleration a and speed v reaches v_r = min(v, sqrt(a L)). The blend lasts at
most t = min(L_1 / v_r1, L_2 / v_r2, max(v_r1 / a_1, v_r2 / a_2)); it begins when the first move is
as slow as min(v_r1, a_1 t), and the second makes for min(v_r2, a_2 t). With a tolerance P the first
has to be slower than 2 sqrt(a_1 P / cos(theta)), 2 theta being the angle between the moves.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.compiled import njit
from threadline.machine.motion_planner import LinuxCncPlanner
from threadline.trajectory.firmware.moves_in_hand import MovesInHand
from threadline.trajectory.firmware.rules import MM
from threadline.trajectory.types import TrajectoryBlock

_STRAIGHT = 1e-3  # of cos(theta): no corner for it


@njit()
def blended(length, acceleration, speed, cosine, tolerance, begun, ends, entered, overlap):
    """Return how fast moves are, from which on the next one moves too, and how that sets out.

    Parameters
    ----------
    length, acceleration, speed : (n,)
        Of the moves; the whole acceleration.
    cosine : (n - 1,)
        cos(theta) of the corners.
    tolerance : float
        P, 0 for none; below 0 every move ends at rest.
    begun : bool
        Whether the first move goes on from one that is out.
    ends : bool
        Whether the last move ends at rest; else it is only looked at.
    entered, overlap : float
        Speed that the first move has when the one before ends, and for how long both moved.

    Returns
    -------
    rate, enter, along, top, leave : (m,)
        Acceleration; speed when the move before ends, and the way by then; the greatest speed; the
        speed at which the next one sets out, 0 for none.
    following, lasting, slope : (m,)
        ``entered`` and ``overlap`` of the next move, and its acceleration; 0 where none follows.
    """
    count = len(length)
    out = count if ends else count - 1
    rate, enter, along = np.empty(out), np.empty(out), np.empty(out)
    top, leave = np.empty(out), np.zeros(out)
    following, lasting, slope = np.zeros(out), np.zeros(out), np.zeros(out)
    for i in range(out):
        blends = i + 1 < count and tolerance >= 0.0
        both = tolerance >= 0.0 and (blends or i > 0 or begun)
        a = acceleration[i] * (0.5 if both else 1.0)
        rate[i], enter[i] = a, entered
        along[i] = entered * overlap - entered * entered / (2.0 * a)
        left = length[i] - along[i]
        top[i] = max(entered, min(speed[i], np.sqrt(a * left + 0.5 * entered * entered)))
        entered, overlap = 0.0, 0.0
        if blends:
            after = 0.5 * acceleration[i + 1]
            slope[i] = after
            here = min(speed[i], np.sqrt(a * length[i]))
            there = min(speed[i + 1], np.sqrt(after * length[i + 1]))
            most = min(length[i] / here, length[i + 1] / there)
            lasts = min(most, max(here / a, there / after))
            slow = min(here, lasts * a)
            if tolerance > 0.0 and cosine[i] > _STRAIGHT:
                slow = min(slow, 2.0 * np.sqrt(a * tolerance / cosine[i]))
            leave[i] = min(slow, top[i])
            overlap = leave[i] / a
            # Its own way to rest still has room behind what it does until then.
            entered = min(there, lasts * after, after * overlap, length[i + 1] / overlap)
        following[i], lasting[i] = entered, overlap
    return rate, enter, along, top, leave, following, lasting, slope


@dataclass(slots=True, kw_only=True)
class BlendedRun(MovesInHand):
    """Moves that overlap."""

    planner: LinuxCncPlanner
    entered: float = 0.0  # speed that the first move has when the one before ends
    overlap: float = 0.0  # for how long both moved
    kink: float = 0.0  # share of acceleration that its first corner takes from the first move

    def _rest(self) -> None:
        self.entered, self.overlap, self.kink = 0.0, 0.0, 0.0

    def _settle(self, ends: bool) -> Iterator[TrajectoryBlock]:
        start, way, nominal_s = self.start[0], self.way[0], self.nominal_s[0]
        moves = self.rules.moves(way, nominal_s)
        kinks = np.zeros(len(way) + 1)
        if self.planner.exact_stop:
            kinks[0], kinks[1:-1] = self.kink, self.rules.kinks(moves, nominal_s == 0.0)
        found = blended(
            moves.length,
            moves.acceleration * (1.0 - np.maximum(kinks[1:], kinks[:-1])),
            moves.speed,
            self.rules.half_angles(way),
            -1.0 if self.planner.exact_stop else self.planner.tolerance_m * MM,
            self.begun,
            ends,
            self.entered,
            self.overlap,
        )
        out = len(found[0])
        if out:
            yield self._pieces(start, way / moves.length[:, None], moves.length, found)
            self.begun = True
            self.entered, self.overlap = float(found[5][-1]), float(found[6][-1])
            self.kink = float(kinks[out])
        self._keep(out)

    def _pieces(
        self,
        start: FloatArray,
        way: FloatArray,
        length: FloatArray,
        found: tuple[FloatArray, ...],
    ) -> TrajectoryBlock:
        """Return five pieces of each move that is out, those without duration left out.

        It speeds up, holds its speed and brakes; then the next one moves too, speeding up and
        then holding its speed.
        """
        rate, enter, along, top, leave, following, lasting, slope = found
        out = len(rate)
        up, down = (top**2 - enter**2) / (2.0 * rate), (top**2 - leave**2) / (2.0 * rate)
        tail = leave**2 / (2.0 * rate)
        level = np.maximum(length[:out] - along - up - down - tail, 0.0)
        # What follows has its speed before both stop to move together, or just then.
        rises = np.minimum(following / np.where(slope > 0.0, slope, 1.0), lasting)
        time_s = np.stack(
            [(top - enter) / rate, level / top, (top - leave) / rate, rises, lasting - rises],
            axis=1,
        )
        slowed = leave - rate * rises
        braked = length[:out] - tail + leave * rises - 0.5 * rate * rises**2
        zero = np.zeros(out)
        place = np.stack([along, along + up, along + up + level, length[:out] - tail, braked], 1)
        speed = np.stack([enter, top, top, leave, slowed], 1)
        bend = np.stack([rate, zero, -rate, -rate, -rate], 1)
        next_place = np.stack([zero, zero, zero, zero, 0.5 * slope * rises**2], 1)
        next_speed = np.stack([zero, zero, zero, zero, slope * rises], 1)
        next_bend = np.stack([zero, zero, zero, slope, zero], 1)
        own = np.stack([place, speed * time_s, 0.5 * bend * time_s**2], 2)
        other = np.stack([next_place, next_speed * time_s, 0.5 * next_bend * time_s**2], 2)
        ahead = np.zeros_like(way[:out])
        ahead[: min(out, len(way) - 1)] = way[1 : out + 1]
        coefficients = own[..., None] * way[:out, None, None]
        coefficients += other[..., None] * ahead[:, None, None]
        coefficients[:, :, 0] += start[:out, None]
        return self._timed(time_s, coefficients, self.operation[0][:out])
