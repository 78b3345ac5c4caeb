"""Chords timed one by one: by a motion law, at programmed times, or with steps of speed.

A trajectory consists of polynomial pieces (decision 0003): a law of sines is converted to quintic
pieces that share its rise, velocity and acceleration at their ends. Limits are checked with the
peaks of the pieces, so that the conversion loses nothing.

With programmed times velocity steps at every vertex, as in the linear interpolation of the 1994
controller, but no travel time is rounded to ticks: a needle's constant speed stays constant. Rapid
moves, which have no programmed time, go from rest to rest.

A leg of a seam that starts from rest takes longer for its first stitches, to run up, but at
programmed times every stitch has one mean speed, which steps at its ends. ``with_steps`` lets the
leg rest for the time that the run-up costs, and then start at its full speed; a stop is the same
backwards. The smoothing shapes the single step. Times, places and the path of the whole leg stay.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.dynamics.eccentric import current_needed
from threadline.files import Stream
from threadline.machine import Machine
from threadline.motion.path.types import PieceBlock, PlannedPath
from threadline.motion.timing.types import Trajectory, TrajectoryBlock

if TYPE_CHECKING:
    from threadline.motion.laws import Law

_MISSED = 1e-9  # of a move: a micrometre in a kilometre
_PARTS = (1, 2, 4, 8, 16, 32)
_MOVES = 4096  # at once: each becomes as many pieces as its law has


@lru_cache(maxsize=32)
def law_pieces(law: Law) -> tuple[FloatArray, FloatArray, tuple[float, float, float]]:
    """Return a law as quintic pieces.

    Returns
    -------
    ends : (n + 1,)
        From 0 to 1.
    powers : (n, 6)
        Powers of the time since the beginning of a piece over its length.
    peaks
        Peaks of velocity, acceleration and jerk of the pieces.
    """
    sample_places = np.linspace(0.0, 1.0, 9)[1:-1]
    ends, powers = law.edges, np.zeros((0, 6))
    for parts in _PARTS:
        part_begins = np.arange(parts) / parts
        ends = np.append(
            (law.edges[:-1, None] + np.diff(law.edges)[:, None] * part_begins).ravel(), 1.0
        )
        powers = _quintic(law, ends)
        places = ends[:-1, None] + np.diff(ends)[:, None] * sample_places
        values = np.polynomial.polynomial.polyval(sample_places, powers.T)
        if np.abs(values - law(places.ravel()).reshape(places.shape)).max() <= _MISSED:
            break
    length = np.diff(ends)[:, None]
    peaks = []
    for order in (1, 2, 3):
        derived = np.polynomial.polynomial.polyder(powers, order, axis=1)
        peaks.append(_largest(derived / length**order))
    return ends, powers, (peaks[0], peaks[1], peaks[2])


def _quintic(law: Law, ends: FloatArray) -> FloatArray:
    """Return the (n, 6) powers of the pieces with the law's values and slopes at their ends."""
    h = np.diff(ends)
    s, v = law(ends), h * law(ends, 1)[:-1]
    w = h * law(ends, 1)[1:]
    # Between two stretches the acceleration may step: each piece takes the value on its side.
    a = h**2 * law(ends[:-1] + 1e-9 * h, 2)
    b = h**2 * law(ends[1:] - 1e-9 * h, 2)
    rise_rest, velocity_rest, acceleration_rest = np.diff(s) - v - 0.5 * a, w - v - a, b - a
    return np.stack(
        [
            s[:-1], v, 0.5 * a,
            10.0 * rise_rest - 4.0 * velocity_rest + 0.5 * acceleration_rest,
            -15.0 * rise_rest + 7.0 * velocity_rest - acceleration_rest,
            6.0 * rise_rest - 3.0 * velocity_rest + 0.5 * acceleration_rest,
        ],
        axis=1,
    )  # fmt: skip


def _largest(powers: FloatArray) -> float:
    """Return the largest magnitude of polynomials (n, k) on [0, 1]: at ends or at roots."""
    sample_places = np.linspace(0.0, 1.0, 17)
    peak = 0.0
    sampled_peaks = np.abs(np.polynomial.polynomial.polyval(sample_places, powers.T)).max(axis=1)
    for k in np.flatnonzero(sampled_peaks >= 0.9 * sampled_peaks.max()).tolist():
        slope = np.trim_zeros(np.polynomial.polynomial.polyder(powers[k]), "b")
        roots = np.polynomial.polynomial.polyroots(slope) if len(slope) > 1 else np.zeros(0)
        real = roots[np.abs(roots.imag) < 1e-9].real
        candidates = np.concatenate((sample_places, real[(real > 0.0) & (real < 1.0)]))
        peak = max(
            peak, float(np.abs(np.polynomial.polynomial.polyval(candidates, powers[k])).max())
        )
    return peak


def by_law(path: PlannedPath, machine: Machine, law: Law) -> Iterator[PieceBlock]:
    """Yield the timed pieces of every chord: from rest to rest, as fast as limits and feed allow.

    The peak of the velocity equals the programmed feed at most; the time of a move is the shortest
    that keeps it and, for every axis, the limits of velocity, acceleration and jerk. If the jerk of
    the law is infinite, its limit is ignored.

    Raises
    ------
    OptionError
        If the law goes back: an axis would reverse without being programmed to.
    """
    from threadline.motion.laws import refuse_descent

    refuse_descent(law)
    ends, powers, piece_peaks = law_pieces(law)
    shares = np.diff(ends)
    count = len(shares)
    peaks = (piece_peaks[0], piece_peaks[1], None if law.jerk is None else piece_peaks[2])
    columns = [machine.axis_names.index(axis) for axis in path.axes]
    limits = [
        getattr(machine, f"{name}_limit")[columns] for name in ("velocity", "acceleration", "jerk")
    ]
    for block in path:
        for begin in range(0, len(block), _MOVES):
            rows = slice(begin, begin + _MOVES)
            start, displacement = block.coefficients[rows, 0], block.coefficients[rows, 1]
            time_s = peaks[0] * block.nominal_s[rows]
            for order, (peak, limit) in enumerate(zip(peaks, limits, strict=True), start=1):
                if peak is not None:
                    needed = (peak * np.abs(displacement) / limit).max(axis=1) ** (1.0 / order)
                    time_s = np.maximum(time_s, needed)
            time_s[~displacement.any(axis=1)] = 0.0
            coefficients = powers[None, :, :, None] * displacement[:, None, None, :]
            coefficients[:, :, 0] += start[:, None]
            moves = len(start)
            is_last = np.zeros((moves, count), dtype=np.int64)
            is_last[:, -1] = 1
            dwell = np.zeros((moves, count))
            dwell[:, -1] = block.dwell_s[rows]
            yield PieceBlock(
                coefficients=coefficients.reshape(moves * count, 6, -1),
                operation=np.repeat(block.operation[rows], count),
                nominal_s=(time_s[:, None] * shares).ravel(),
                rest_after=is_last.ravel(),
                dwell_s=dwell.ravel(),
                line=np.repeat(block.line[rows], count),
            )


def breaks_jerk(law: Law, axes: tuple[str, ...], machine: Machine) -> bool:
    """Return whether the law has infinite jerk and an axis has a jerk limit."""
    columns = [machine.axis_names.index(axis) for axis in axes]
    return law.jerk is None and bool(np.isfinite(machine.jerk_limit[columns]).any())


# The law 10 u^3 - 15 u^4 + 6 u^5: its peaks, and the places at which the current is checked.
_PEAKS = (1.875, 10.0 / np.sqrt(3.0), 60.0)
_U = np.linspace(0.0, 1.0, 65)
_SPEED = 30.0 * _U**2 * (1.0 - _U) ** 2
_ACCELERATION = 60.0 * _U * (1.0 - _U) * (1.0 - 2.0 * _U)
_CURRENT_SHARE = 0.8  # the rest is for elastic motion


def as_programmed(path: PlannedPath, machine: Machine) -> Iterator[PieceBlock]:
    """Yield one timed piece per chord: straight at its programmed time, quintic if it is rapid.

    Parameters
    ----------
    path
        Chords, with nominal time 0 for rapid ones.
    machine
        Machine with the limits of rapid moves.
    """
    for block in path:
        start, displacement = block.coefficients[:, 0], block.coefficients[:, 1]
        coefficients = np.zeros((len(block), 6, displacement.shape[1]))
        coefficients[:, 0] = start
        timed = block.nominal_s > 0
        coefficients[timed, 1] = displacement[timed]
        for power, factor in ((3, 10.0), (4, -15.0), (5, 6.0)):
            coefficients[~timed, power] = factor * displacement[~timed]
        duration = np.array(block.nominal_s)
        if not timed.all():
            duration[~timed] = rapid_time_s(displacement[~timed], path.axes, machine)
        yield PieceBlock(
            coefficients=coefficients,
            operation=block.operation,
            nominal_s=duration,
            rest_after=block.rest_after,
            dwell_s=block.dwell_s,
            line=block.line,
        )


def rapid_time_s(displacement: FloatArray, axes: tuple[str, ...], machine: Machine) -> FloatArray:
    """Return the (n,) shortest times of moves from rest to rest by the law 10 u^3 - 15 u^4 + 6 u^5.

    They keep the limits of velocity, acceleration and jerk of every axis, and four fifths of the
    current of its motor, with all links taken as rigid.

    Parameters
    ----------
    displacement
        (n, axes) m or rad.
    """
    needed = np.zeros(len(displacement))
    for column, name in enumerate(axes):
        distance = np.abs(displacement[:, column])
        axis = machine.axes[name]
        needed = np.maximum(needed, _PEAKS[0] * distance / axis.velocity.si)
        needed = np.maximum(needed, np.sqrt(_PEAKS[1] * distance / axis.acceleration.si))
        if axis.jerk is not None:
            needed = np.maximum(needed, np.cbrt(_PEAKS[2] * distance / axis.jerk.si))
        needed = np.maximum(needed, _current_time_s(distance, name, machine))
    return needed


def _current_time_s(distance: FloatArray, axis: str, machine: Machine) -> FloatArray:
    """Return (n,) times that keep the current of a rigid axis within its share.

    At each u the current is f + c v/T + k a/T^2, so that 1/T is bounded by a quadratic equation.
    """
    if machine.axes[axis].drive:  # a position interface: its torque is judged
        return np.zeros(len(distance))
    drive = machine.drive_of(axis)
    current_limit = drive.amplifier.current_limit
    if current_limit is None:
        return np.zeros(len(distance))
    per_speed = current_needed(machine, axis, 2.0, 0.0) - current_needed(machine, axis, 1.0, 0.0)
    friction = current_needed(machine, axis, 1.0, 0.0) - per_speed
    spare_a = max(_CURRENT_SHARE * current_limit.si - friction, 0.05 * current_limit.si)
    a = current_needed(machine, axis, 0.0, 1.0) * distance[:, None] * _ACCELERATION
    b = per_speed * distance[:, None] * _SPEED
    # If the motor brakes, the curve may stay below its bound at any speed.
    root = np.sqrt(np.maximum(b * b + 4.0 * a * spare_a, 0.0))
    bound = np.where(b * b + 4.0 * a * spare_a >= 0.0, b + root, 0.0)
    return np.asarray((bound / (2.0 * spare_a)).max(axis=1))


_ALIKE = 1e-9
_MOST = 4  # most pieces in which a leg reaches its speed
_AROUND = _MOST + 1  # pieces before and after one that determine its group


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leads:
    """Shortest and longest rest at the ends of legs that replaces their run-ups, s."""

    starts_s: tuple[float, float]
    stops_s: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Group:
    """Slower pieces ``first`` to ``end`` at one end of a leg with the velocity ``full``."""

    first: int
    end: int
    full: FloatArray
    rest_s: float
    stop: bool


def with_steps(planned: Trajectory) -> Trajectory:
    """Return ``planned`` with a single step of speed where its legs run up, and where they stop.

    Only straight pieces are changed: up to four at either end of a leg, each faster than its
    predecessor (successor, at a stop) and slower than the leg. A leg goes from rest to rest: there
    is an operation between two moves, or the motion is at rest.
    """
    return Trajectory(
        axes=planned.axes, historical=planned.historical, blocks=Stream(_stepped, planned)
    )


def leads_of(planned: Trajectory) -> Leads:
    """Return the rests of the legs of ``planned`` in :func:`with_steps`, 0 without any."""
    rests_by_end: dict[bool, list[float]] = {False: [], True: []}
    for pieces, done, ready in _windows(planned):
        for group in _groups(pieces):
            if done <= group.first < ready:
                rests_by_end[group.stop].append(group.rest_s)
    starts, stops = (
        (min(rests, default=0.0), max(rests, default=0.0)) for rests in rests_by_end.values()
    )
    return Leads(starts_s=starts, stops_s=stops)


def _windows(planned: Trajectory) -> Iterator[tuple[TrajectoryBlock, int, int]]:
    """Yield pieces ``done`` to ``ready`` of blocks, with enough neighbours around them."""
    pieces: TrajectoryBlock | None = None
    done = 0
    for block in planned:
        if not len(block):
            continue
        pieces = block if pieces is None else _joined(pieces, block)
        ready = len(pieces) - _AROUND
        if ready > done:
            yield pieces, done, ready
            first_kept = max(ready - _AROUND, 0)
            pieces, done = _rows(pieces, first_kept), ready - first_kept
    if pieces is not None:
        yield pieces, done, len(pieces)


def _groups(pieces: TrajectoryBlock) -> list[_Group]:
    velocity = _velocity(pieces)
    speed = np.linalg.norm(velocity, axis=1)
    continues = np.zeros(len(pieces) + 1, dtype=np.bool_)  # a leg goes on from the piece before
    continues[1:-1] = _alike(velocity[:-1], velocity[1:])
    # Between moves that follow each other the motion does not rest, even where it turns.
    rests = np.ones(len(pieces) + 1, dtype=np.bool_)
    rests[1:-1] = (np.diff(pieces.operation) > 1) | (speed[:-1] == 0.0) | (speed[1:] == 0.0)
    groups = []
    for stop in (False, True):
        direction = -1 if stop else 1
        ends = np.flatnonzero((speed > 0.0) & (rests[1:] if stop else rests[:-1]))
        for end_piece in ends.tolist():
            piece = end_piece
            while (
                abs(piece - end_piece) <= _MOST
                and continues[piece if stop else piece + 1]
                and not rests[piece if stop else piece + 1]
                and speed[piece + direction] > speed[piece] * (1.0 + _ALIKE)
            ):
                piece += direction
            if not 0 < abs(piece - end_piece) <= _MOST:
                continue
            first, stop_piece = (piece + 1, end_piece + 1) if stop else (end_piece, piece)
            part = slice(first, stop_piece)
            lasts_s = pieces.duration_s[part]
            rest_s = float(lasts_s.sum() - speed[part] @ lasts_s / speed[piece])
            groups.append(
                _Group(first=first, end=stop_piece, full=velocity[piece], rest_s=rest_s, stop=stop)
            )
    return groups


def _stepped(planned: Trajectory) -> Iterator[TrajectoryBlock]:
    for pieces, done, ready in _windows(planned):
        parts: list[TrajectoryBlock] = []
        next_piece = done
        for group in sorted(_groups(pieces), key=lambda group: group.first):
            first, end = max(group.first, next_piece), min(group.end, ready)
            if first >= end:
                continue
            parts += [_rows(pieces, next_piece, first), _changed(pieces, group, first, end)]
            next_piece = end
        parts.append(_rows(pieces, next_piece, ready))
        yield from (part for part in parts if len(part))


def _changed(pieces: TrajectoryBlock, group: _Group, first: int, end: int) -> TrajectoryBlock:
    """Return pieces ``first`` to ``end`` of a group: at rest, at full speed, or split in two."""
    last = group.end - 1
    if group.stop:
        step_s = float(pieces.start_s[last] + pieces.duration_s[last]) - group.rest_s
        origin, from_s = pieces.coefficients[group.first, 0], float(pieces.start_s[group.first])
    else:
        step_s = float(pieces.start_s[group.first]) + group.rest_s
        origin, from_s = pieces.coefficients[group.first, 0], step_s
    rows: list[tuple[float, float, int]] = []
    for k in range(first, end):
        piece_begin_s, duration_s = float(pieces.start_s[k]), float(pieces.duration_s[k])
        cut_s = min(max(step_s - piece_begin_s, 0.0), duration_s)
        operation = int(pieces.operation[k])
        for begin_s, span_s in (
            (piece_begin_s, cut_s),
            (piece_begin_s + cut_s, duration_s - cut_s),
        ):
            if span_s > _ALIKE * duration_s:
                rows.append((begin_s, span_s, operation))
    start = np.array([row[0] for row in rows])
    duration = np.array([row[1] for row in rows])
    moves = (start + 0.5 * duration < step_s) == group.stop
    coefficients = np.zeros((len(rows), max(pieces.coefficients.shape[1], 2), len(origin)))
    moved_s = np.minimum(start, step_s) - from_s if group.stop else np.maximum(start - from_s, 0.0)
    coefficients[:, 0] = origin + moved_s[:, None] * group.full
    coefficients[moves, 1] = duration[moves, None] * group.full
    return TrajectoryBlock(
        start_s=start,
        duration_s=duration,
        coefficients=coefficients,
        operation=np.array([row[2] for row in rows], dtype=np.int64),
    )


def _rows(block: TrajectoryBlock, first: int, end: int | None = None) -> TrajectoryBlock:
    part = slice(first, end)
    return TrajectoryBlock(
        start_s=block.start_s[part],
        duration_s=block.duration_s[part],
        coefficients=block.coefficients[part],
        operation=block.operation[part],
    )


def _joined(first: TrajectoryBlock, second: TrajectoryBlock) -> TrajectoryBlock:
    order = max(first.coefficients.shape[1], second.coefficients.shape[1])
    padded = [
        np.pad(block.coefficients, ((0, 0), (0, order - block.coefficients.shape[1]), (0, 0)))
        for block in (first, second)
    ]
    return TrajectoryBlock(
        start_s=np.concatenate([first.start_s, second.start_s]),
        duration_s=np.concatenate([first.duration_s, second.duration_s]),
        coefficients=np.concatenate(padded),
        operation=np.concatenate([first.operation, second.operation]),
    )


def _velocity(block: TrajectoryBlock) -> FloatArray:
    """Return the (n, axes) velocity of straight pieces, and 0 of others."""
    straight = (block.coefficients[:, 2:] == 0.0).all(axis=(1, 2))
    if block.coefficients.shape[1] < 2:
        return np.zeros((len(block), block.coefficients.shape[2]))
    return np.where(straight[:, None], block.coefficients[:, 1] / block.duration_s[:, None], 0.0)


def _alike(first: FloatArray, second: FloatArray) -> NDArray[np.bool_]:
    """Return where two nonzero velocities have the same direction."""
    product = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
    return np.asarray(
        (product > 0.0) & (np.sum(first * second, axis=1) >= (1.0 - _ALIKE) * product)
    )
