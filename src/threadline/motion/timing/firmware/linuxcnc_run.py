"""Speeds along the pieces that LinuxCNC runs, and the motion of each as polynomials in time.

A piece that blends into the next ends as fast as the 50 pieces after it allow
(``[TRAJ]ARC_BLEND_OPTIMIZATION_DEPTH``). The last of these pieces may still lose half of its
length, so only half counts as distance to a stop. In a piece of less than 10 ms the speed changes
evenly (``ARC_BLEND_RAMP_FREQ``).

Moves in which a rotary axis turns overlap: the next move starts while the previous one still
brakes, so that their speeds add up, and both have half of their acceleration. Between moves of X, Y
and Z only, every corner is taken in the fastest of three ways (``linuxcnc_corners``), and the speed
at the end of a piece is found 50 pieces ahead. After G61 moves stop unless they continue straight.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.machine.motion_planner import LinuxCncPlanner
from threadline.motion.path.types import PieceBlock
from threadline.motion.timing.firmware.linuxcnc_corners import (
    CYCLE_S,
    GOES_ON,
    OVERLAPS,
    Blending,
    Corners,
    Ramp,
    overlap,
)
from threadline.motion.timing.firmware.linuxcnc_moves import Course, course
from threadline.motion.timing.firmware.look_ahead import MovesInHand
from threadline.motion.timing.firmware.piece_curves import TimedMoves, link, polynomials
from threadline.motion.timing.firmware.rules import LINEAR, MM, Rules, along_axes
from threadline.motion.timing.types import TrajectoryBlock

AHEAD = 51  # pieces that are considered, the last one included
_RAMP_S = 0.01
_INSTANT_S = 1e-12  # counts as no time
_BEND = 0.05  # rad of an arc per polynomial: 0.8 um at a radius of 10 mm, where it starts


class Started(NamedTuple):
    """How the first piece of a motion starts.

    Parameters
    ----------
    enter
        Speed at its start, if it blends with the previous piece.
    entered, lasted
        Its speed at the end of the previous piece, and the time for which both moved; 0 if they do
        not overlap.
    since
        Time since the last rest.
    """

    enter: float = 0.0
    entered: float = 0.0
    lasted: float = 0.0
    since: float = 0.0


AT_REST = Started()


class _Phases(NamedTuple):
    """(3,) durations of the phases of a piece, and (3,) accelerations: up, even, down."""

    time_s: FloatArray
    change: FloatArray


class _Next(NamedTuple):
    """How the next piece starts while a piece brakes.

    Parameters
    ----------
    lasts, rises
        Time for which both move, and for which the next piece speeds up in it.
    slope
        Acceleration of the next piece.
    """

    lasts: float
    rises: float
    slope: float


@njit()
def speeds_at_ends(extent, most, speed, rate, limit, transition):
    """Return the (m,) largest speed at the end of each of m pieces.

    F counts only at the start of the newest piece: where F falls, LinuxCNC is too fast for a
    moment.
    """
    count = len(extent)
    end_speeds = np.zeros(count)
    for i in range(count - 1):
        if transition[i] != GOES_ON:
            continue
        newest = min(count - 1, i + AHEAD)
        reachable = 0.0
        for j in range(newest - 1, i - 1, -1):
            if transition[j] != GOES_ON:
                reachable = 0.0
                continue
            n = j + 1
            gain = 1.0 if n == newest else 2.0
            reachable = np.sqrt(reachable * reachable + gain * rate[n] * extent[n])
            speed_limit = speed[n] if n == newest else most[n]
            reachable = min(reachable, limit[j], most[j], speed_limit)
        end_speeds[i] = reachable
    return end_speeds


@njit()
def _phases(length, enter, top, leave, rate, evenly, phases):
    """Write the three phases of a piece, and return the speed at the end.

    Parameters
    ----------
    length, enter, top, leave, rate : float
        Of the piece: length, first, greatest and last speed, acceleration.
    evenly : bool
        Whether the speed changes in a single ramp.
    phases : _Phases
        Output.
    """
    time_s, change = phases
    time_s[:], change[:] = 0.0, 0.0
    speed2_change = 2.0 * rate * length
    if leave * leave > enter * enter + speed2_change:
        leave = np.sqrt(enter * enter + speed2_change)
        evenly = True
    elif leave * leave < enter * enter - speed2_change:
        leave = np.sqrt(enter * enter - speed2_change)
        evenly = True
    if evenly and enter + leave > 0.0:
        time_s[0] = 2.0 * length / (enter + leave)
        change[0] = (leave - enter) / time_s[0]
        return leave
    peak = min(top, np.sqrt(0.5 * (enter * enter + leave * leave + speed2_change)))
    peak = max(peak, leave)
    rise2, fall2 = abs(peak * peak - enter * enter), peak * peak - leave * leave
    time_s[0], time_s[2] = abs(peak - enter) / rate, (peak - leave) / rate
    change[0], change[2] = (rate if peak > enter else -rate), -rate
    time_s[1] = max(0.0, length - (rise2 + fall2) / (2.0 * rate)) / peak
    return leave


@njit()
def motion(links, bow, cosine, rapid, tolerance, out, started):
    """Return rows of motion for the first ``out`` of m pieces.

    Parameters
    ----------
    links : Links
        The pieces of n moves.
    bow : (n,)
        Radius of each move, 0 for a line.
    cosine : (n - 1,)
        cos(theta) of the corners.
    rapid : (n,) bool
        Which moves are rapid.
    tolerance : float
        P of G64, 0 for none.
    out : int
        Number of pieces.
    started : Started
        Start of the first piece.

    Returns
    -------
    piece : (r,) int
        The piece of each row.
    row : (r, 7)
        Time of the row; start on the piece, speed there, and acceleration; the same along the next
        piece, which may move too.
    started : Started
        Start of the next piece.
    """
    move, radius, lead, extent = links.move, links.radius, links.lead, links.extent
    speed, rate, transition = links.speed, links.rate, links.transition
    enter, entered, lasted, since = started
    leaves = speeds_at_ends(extent, links.most, speed, rate, links.limit, transition)
    round_ = np.where(radius > 0.0, radius, bow[move])
    bends = np.where(round_ > 0.0, (extent - lead) / np.where(round_ > 0.0, round_, 1.0), 0.0)
    room = 9 * out + int(np.ceil(bends[:out] / _BEND).sum())
    piece, row = np.zeros(room, np.int64), np.zeros((room, 7))
    phases = _Phases(np.zeros(3), np.zeros(3))
    r = 0
    for j in range(out):
        a = rate[j]
        place = 0.0
        if lasted > 0.0:
            enter, place = entered, entered * lasted - entered * entered / (2.0 * a)
        entered, lasted = 0.0, 0.0
        leave = min(leaves[j], speed[j])
        if transition[j] == GOES_ON:
            leave = min(leave, speed[j + 1])
        evenly = (
            transition[j] == GOES_ON
            and not rapid[move[j]]
            and leave > 1e-8
            and 2.0 * (extent[j] - place) < _RAMP_S * (enter + leave)
        )
        tail, rises, slope = 0.0, 0.0, 0.0
        if transition[j] == OVERLAPS and j + 1 < len(extent):
            n = j + 1
            slope = rate[n]
            reach = 0.5 * extent[n] if n == len(extent) - 1 else extent[n]
            braking = Ramp(a, extent[j], extent[j], speed[j])
            following = Ramp(slope, extent[n], reach, speed[n])
            slow, _ = overlap(braking, following, cosine[move[j]], tolerance)
            left = extent[j] - place
            leave = min(slow, max(enter, min(speed[j], np.sqrt(a * left + 0.5 * enter * enter))))
            lasted, tail = leave / a, leave * leave / (2.0 * a)
            # The next one speeds up normally, and has room for its own braking after that.
            follow = min(speed[n], np.sqrt(slope * extent[n]))
            entered = min(follow, slope * lasted, extent[n] / lasted)
            rises = min(entered / slope, lasted)
        v = enter
        enter = _phases(extent[j] - place - tail, v, speed[j], leave, a, evenly, phases)
        begin = r
        r, place = _write_phases(row, r, phases, place, v, lead[j], round_[j])
        if lasted > 0.0:
            r = _together(row, r, place, enter, a, _Next(lasted, rises, slope))
            enter = 0.0
        piece[begin:r] = j
        since += phases.time_s.sum() + lasted
        if transition[j] != GOES_ON and lasted == 0.0:
            # At rest to the end of the cycle.
            wait = CYCLE_S * np.ceil(since / CYCLE_S - 1e-6) - since
            since = 0.0
            if wait > _INSTANT_S:
                piece[r], row[r, 0], row[r, 1] = j, wait, place
                r += 1
    return piece[:r], row[:r], Started(enter, entered, lasted, since)


@njit()
def _write_phases(row, r, phases, place, v, lead, radius):
    """Write the phases of a piece from row ``r`` on; return the next row and place.

    On an arc of ``radius`` after a line of length ``lead`` a row ends after each ``_BEND``.
    """
    time_s, change = phases
    for q in range(3):
        left_s = time_s[q]
        while left_s > _INSTANT_S:
            t = left_s
            if radius > 0.0:
                t = _until(place, v, change[q], lead, radius)
                if t > left_s - _INSTANT_S:
                    t = left_s
            row[r, 0], row[r, 1], row[r, 2], row[r, 3] = t, place, v, change[q]
            r += 1
            place += v * t + 0.5 * change[q] * t * t
            v += change[q] * t
            left_s -= t
    return r, place


@njit()
def _together(row, r, place, v, rate, following):
    """Write how a piece brakes to rest while the next speeds up; return the next row."""
    lasts, rises, slope = following
    for q in range(2):
        t = rises if q == 0 else lasts - rises
        if t > _INSTANT_S:
            row[r, 0], row[r, 1], row[r, 2], row[r, 3] = t, place, v, -rate
            if q == 0:
                row[r, 6] = slope
            else:
                row[r, 4], row[r, 5] = 0.5 * slope * rises * rises, slope * rises
            r += 1
            place += v * t - 0.5 * rate * t * t
            v -= rate * t
    return r


@njit()
def _until(place, v, change, lead, radius):
    """Return when a motion along an arc reaches the end of its line, or has turned by a bend."""
    if place < lead - 1e-9:
        distance = lead - place
    else:
        step = radius * _BEND
        bends_done = np.floor((place - lead) / step + 1e-6)
        distance = lead + (bends_done + 1.0) * step - place
    speed2 = v * v + 2.0 * change * distance
    if speed2 <= 0.0:
        return np.inf
    return 2.0 * distance / (v + np.sqrt(speed2))


_BACK = np.radians(2.0) ** 2  # squared sum of unit vectors below which a corner reverses
_BEHIND = 2 * AHEAD  # moves after the settled ones


def corners(rules: Rules, moves: Course) -> Corners:
    """Return the corners of moves.

    A move that leaves X, Y and Z at rest counts as one along X.
    """
    linear = np.array([axis in LINEAR for axis in rules.axes])
    only_xyz = (moves.along[:, ~linear] == 0.0).all(axis=1)
    columns = [LINEAR.index(axis) for axis in rules.axes if axis in LINEAR]
    rate, speed = np.full(len(LINEAR), np.inf), np.full(len(LINEAR), np.inf)
    rate[columns], speed[columns] = rules.acceleration[linear], rules.velocity[linear]
    direction_before = _tangents(moves.onward[:-1, linear], columns)
    direction_after = _tangents(moves.along[1:, linear], columns)
    cosine = np.clip((direction_before * direction_after).sum(axis=1), -1.0, 1.0)
    across = direction_after - cosine[:, None] * direction_before
    across_length = np.linalg.norm(across, axis=1)
    across /= np.where(across_length > 0.0, across_length, 1.0)[:, None]
    reach = np.hypot(direction_before, across)  # of each axis in the plane of the corner
    # If an arc bends the same way as its corner, its centre lies on the same side.
    angle = moves.length[:-1] / np.where(moves.bow[:-1] > 0.0, moves.bow[:-1], 1.0)
    last_inward = (
        np.cos(angle)[:, None] * moves.inward[:-1] - np.sin(angle)[:, None] * moves.along[:-1]
    )
    centre_before = np.zeros_like(across)
    centre_before[:, columns] = last_inward[:, linear]
    centre_after = np.zeros_like(across)
    centre_after[:, columns] = moves.inward[1:, linear]
    left_normal = (
        cosine[:, None] * across
        - np.sqrt(np.maximum(1.0 - cosine**2, 0.0))[:, None] * direction_before
    )
    rapid = moves.nominal_s == 0.0
    return Corners(
        rapid[1:] != rapid[:-1],
        only_xyz[1:] & only_xyz[:-1],
        ((direction_before + direction_after) ** 2).sum(axis=1) < _BACK,
        (np.abs(direction_after - direction_before) / rate).max(axis=1),
        0.5 * np.arccos(-cosine),
        np.sqrt(np.maximum(0.5 * (1.0 - cosine), 0.0)),
        along_axes(rate, reach),
        along_axes(speed, reach),
        np.sign((centre_before * across).sum(axis=1)),
        np.sign((centre_after * left_normal).sum(axis=1)),
    )


def _tangents(vectors: FloatArray, columns: list[int]) -> FloatArray:
    """Return (n, 3) unit vectors along X, Y, Z."""
    tangents = np.zeros((len(vectors), len(LINEAR)))
    tangents[:, columns] = vectors
    length = np.linalg.norm(tangents, axis=1)
    tangents[length == 0.0, 0] = 1.0
    return np.asarray(tangents / np.where(length == 0.0, 1.0, length)[:, None])


@dataclass(slots=True, kw_only=True)
class LinkedRun(MovesInHand):
    """Moves that LinuxCNC links.

    Attributes
    ----------
    line
        Line in the file of each buffered move.
    cut, takes, over
        Length and acceleration that the corner before the first buffered move took from it, and
        whether it overlaps the previous move.
    started
        Start of that move.
    """

    planner: LinuxCncPlanner
    line: list[IntArray] = field(default_factory=list)
    cut: float = 0.0
    takes: float = 0.0
    over: int = 0
    started: Started = AT_REST

    def _rest(self) -> None:
        self.cut, self.takes, self.over = 0.0, 0.0, 0
        self.started = AT_REST

    def extend(self, block: PieceBlock, rows: slice, *, is_last: bool) -> Iterator[TrajectoryBlock]:
        """Add moves with their lines."""
        moving = block.coefficients[rows, 1].any(axis=1)
        self.line.append(block.line[rows][moving])
        yield from MovesInHand.extend(self, block, rows, is_last=is_last)

    def _join(self) -> None:
        MovesInHand._join(self)
        self.line[:] = [np.concatenate(self.line)]

    def _keep(self, done: int) -> None:
        MovesInHand._keep(self, done)
        self.line[:] = [self.line[0][done:]]

    def _settle(self, is_last: bool) -> Iterator[TrajectoryBlock]:
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
        settled_count = len(moves) if is_last else len(moves) - _BEHIND
        if settled_count <= 0:
            return
        blending = Blending(self.planner.tolerance_m * MM, self.planner.exact_stop)
        corner_geometry = corners(self.rules, moves)
        timed = TimedMoves(moves.length, *moves.limits(self.rules), moves.bow)
        links = link(timed, corner_geometry, blending, self.cut, self.takes, self.over)
        piece_count = len(links.move) if is_last else int(links.first[settled_count])
        rapid = moves.nominal_s == 0.0
        piece, row, self.started = motion(
            links,
            moves.bow,
            corner_geometry.cosine,
            rapid,
            blending.tolerance,
            piece_count,
            self.started,
        )
        if len(piece):
            coefficients = polynomials(links, moves, piece, row) / scale
            operation = moves.operation[links.move[piece]]
            yield self._timed(row[:, :1], coefficients[:, None], operation)
        if not is_last:
            self.cut, self.takes = (
                float(links.cut[settled_count]),
                float(links.takes[settled_count]),
            )
            self.over = int(links.over[settled_count])
        self._keep(int(moves.last[settled_count - 1]) + 1)
