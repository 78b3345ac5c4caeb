"""Moves from rest to rest along their chords by a motion law.

A trajectory is of polynomial pieces (decision 0003): a law of sines goes in as quintic pieces that
have its rise, velocity and acceleration at their ends. The peaks that the limits are held by are
those of the pieces, so that nothing is lost between the two.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from threadline.arrays import FloatArray
from threadline.laws import Law, refuse_descent
from threadline.machine import Machine
from threadline.path.types import PieceBlock, PlannedPath

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
        Of the time since a piece began over its length.
    peaks
        Of velocity, acceleration and jerk of the pieces.
    """
    looks = np.linspace(0.0, 1.0, 9)[1:-1]
    ends, powers = law.edges, np.zeros((0, 6))
    for parts in _PARTS:
        at = np.arange(parts) / parts
        ends = np.append((law.edges[:-1, None] + np.diff(law.edges)[:, None] * at).ravel(), 1.0)
        powers = _quintic(law, ends)
        where = ends[:-1, None] + np.diff(ends)[:, None] * looks
        found = np.polynomial.polynomial.polyval(looks, powers.T)
        if np.abs(found - law(where.ravel()).reshape(where.shape)).max() <= _MISSED:
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
    # Between two stretches the acceleration may step: each piece has that of its own side.
    a = h**2 * law(ends[:-1] + 1e-9 * h, 2)
    b = h**2 * law(ends[1:] - 1e-9 * h, 2)
    gained, speed, bend = np.diff(s) - v - 0.5 * a, w - v - a, b - a
    return np.stack(
        [
            s[:-1], v, 0.5 * a, 10.0 * gained - 4.0 * speed + 0.5 * bend,
            -15.0 * gained + 7.0 * speed - bend, 6.0 * gained - 3.0 * speed + 0.5 * bend,
        ],
        axis=1,
    )  # fmt: skip


def _largest(powers: FloatArray) -> float:
    """Return the largest magnitude of polynomials (n, k) on [0, 1]: at ends or at roots."""
    looks = np.linspace(0.0, 1.0, 17)
    peak = 0.0
    seen = np.abs(np.polynomial.polynomial.polyval(looks, powers.T)).max(axis=1)
    for k in np.flatnonzero(seen >= 0.9 * seen.max()).tolist():
        slope = np.trim_zeros(np.polynomial.polynomial.polyder(powers[k]), "b")
        roots = np.polynomial.polynomial.polyroots(slope) if len(slope) > 1 else np.zeros(0)
        real = roots[np.abs(roots.imag) < 1e-9].real
        tried = np.concatenate((looks, real[(real > 0.0) & (real < 1.0)]))
        peak = max(peak, float(np.abs(np.polynomial.polynomial.polyval(tried, powers[k])).max()))
    return peak


def by_law(path: PlannedPath, machine: Machine, law: Law) -> Iterator[PieceBlock]:
    """Yield the timed pieces of every chord: from rest to rest, as fast as limits and feed allow.

    The peak of the velocity meets the programmed feed; the time of a move is the least that keeps
    it and, for every axis, the limits of velocity, acceleration and jerk. Where the jerk of the law
    is infinite, its limit does not bind.

    Raises
    ------
    OptionError
        If the law goes back: an axis would turn where none was programmed.
    """
    refuse_descent(law)
    ends, powers, found = law_pieces(law)
    shares = np.diff(ends)
    count = len(shares)
    peaks = (found[0], found[1], None if law.jerk is None else found[2])
    column = [machine.axis_names.index(axis) for axis in path.axes]
    limits = [
        getattr(machine, f"{name}_limit")[column] for name in ("velocity", "acceleration", "jerk")
    ]
    for block in path:
        for begin in range(0, len(block), _MOVES):
            rows = slice(begin, begin + _MOVES)
            start, way = block.coefficients[rows, 0], block.coefficients[rows, 1]
            time_s = peaks[0] * block.nominal_s[rows]
            for order, (peak, limit) in enumerate(zip(peaks, limits, strict=True), start=1):
                if peak is not None:
                    needed = (peak * np.abs(way) / limit).max(axis=1) ** (1.0 / order)
                    time_s = np.maximum(time_s, needed)
            time_s[~way.any(axis=1)] = 0.0
            coefficients = powers[None, :, :, None] * way[:, None, None, :]
            coefficients[:, :, 0] += start[:, None]
            moves = len(start)
            last = np.zeros((moves, count), dtype=np.int64)
            last[:, -1] = 1
            dwell = np.zeros((moves, count))
            dwell[:, -1] = block.dwell_s[rows]
            yield PieceBlock(
                coefficients=coefficients.reshape(moves * count, 6, -1),
                operation=np.repeat(block.operation[rows], count),
                nominal_s=(time_s[:, None] * shares).ravel(),
                rest_after=last.ravel(),
                dwell_s=dwell.ravel(),
                line=np.repeat(block.line[rows], count),
            )


def breaks_jerk(law: Law, axes: tuple[str, ...], machine: Machine) -> bool:
    """Say whether the law asks for infinite jerk where an axis has a limit."""
    column = [machine.axis_names.index(axis) for axis in axes]
    return law.jerk is None and bool(np.isfinite(machine.jerk_limit[column]).any())
