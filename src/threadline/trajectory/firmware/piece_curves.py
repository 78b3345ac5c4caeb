"""Motion along lines and arcs as polynomials in time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.trajectory.firmware.linked_moves import Links
from threadline.trajectory.firmware.linuxcnc_moves import Course

_NEAR = 1e-9  # mm


class _Curves(NamedTuple):
    """(m,) pieces: a line of length ``lead`` from ``origin`` along ``ahead``, then an arc.

    Its radius is 0 where the line goes on; it bends towards ``aside``. All of it drifts.
    """

    origin: FloatArray
    ahead: FloatArray
    aside: FloatArray
    radius: FloatArray
    lead: FloatArray
    drift: FloatArray

    def at(self, piece: IntArray, place: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (r, axes) points and directions at (r,) ways along (r,) pieces."""
        radius, lead = self.radius[piece], self.lead[piece]
        over = np.where(radius > 0.0, np.maximum(place - lead, 0.0), 0.0)
        angle = (over / np.where(radius > 0.0, radius, 1.0))[:, None]
        ahead, aside = self.ahead[piece], self.aside[piece]
        straight = (place - over)[:, None] * ahead
        bent = radius[:, None] * (np.sin(angle) * ahead + (1.0 - np.cos(angle)) * aside)
        drift = self.drift[piece]
        return (
            self.origin[piece] + straight + bent + place[:, None] * drift,
            np.cos(angle) * ahead + np.sin(angle) * aside + drift,
        )


def _curves(links: Links, moves: Course) -> _Curves:
    """Return the pieces as curves."""
    of = links.move
    bow = moves.bow[of]
    first, inward = moves.along[of], moves.inward[of]
    angle = (links.begin / np.where(bow > 0.0, bow, 1.0) * (bow > 0.0))[:, None]
    straight = np.where(bow > 0.0, 0.0, links.begin)[:, None]
    origin = moves.start[of] + straight * first
    origin += bow[:, None] * (np.sin(angle) * first + (1.0 - np.cos(angle)) * inward)
    ahead = np.cos(angle) * first + np.sin(angle) * inward
    aside = np.cos(angle) * inward - np.sin(angle) * first
    corner = np.flatnonzero(links.radius > 0.0)
    if len(corner):
        # In the plane of the corner, across the way on which the first move arrives there.
        arrives, leaves = moves.onward[of[corner]], moves.along[of[corner] + 1]
        across = leaves - (leaves * arrives).sum(axis=1)[:, None] * arrives
        across /= np.linalg.norm(across, axis=1)[:, None]
        here = ahead[corner]
        along, left = (here * arrives).sum(axis=1)[:, None], (here * across).sum(axis=1)[:, None]
        aside[corner] = along * across - left * arrives
    radius = np.where(links.radius > 0.0, links.radius, bow)
    curves = _Curves(origin, ahead, aside, radius, links.lead, np.zeros_like(origin))
    # Rounded programs leave an arc a little beside what follows.
    arcs = np.flatnonzero(radius > 0.0)
    stop = np.vstack([origin[1:], moves.start[of[-1:]] + moves.way[of[-1:]]])
    gap = stop[arcs] - curves.at(arcs, links.extent[arcs])[0]
    curves.drift[arcs] = gap / links.extent[arcs, None]
    return curves


def polynomials(links: Links, moves: Course, piece: IntArray, row: FloatArray) -> FloatArray:
    """Return (r, order, axes) coefficients of rows of ``linked_speeds.motion``, in mm and degrees.

    They are exact along lines, and have place and speed of an arc at both ends.
    """
    curves = _curves(links, moves)
    following = np.flatnonzero(row[:, 4:].any(axis=1))
    parts = [_of_rows(curves, piece, row[:, 0], row[:, 1:4])]
    if len(following):
        after = piece[following] + 1
        parts.append(_of_rows(curves, after, row[following, 0], row[following, 4:]))
        parts[1][:, 0] -= curves.origin[after]
    order = max(part.shape[1] for part in parts)
    found = np.zeros((len(row), order, moves.start.shape[1]))
    found[:, : parts[0].shape[1]] = parts[0]
    if len(following):
        found[following, : parts[1].shape[1]] += parts[1]
    return found


def _of_rows(
    curves: _Curves, piece: IntArray, time_s: FloatArray, motion: FloatArray
) -> FloatArray:
    """Return (r, order, axes) coefficients along pieces.

    ``motion`` (r, 3) is place, speed and its change.
    """
    place, speed, change = motion.T
    stop = place + speed * time_s + 0.5 * change * time_s**2
    point, direction = curves.at(piece, place)
    bent = (curves.radius[piece] > 0.0) & (stop > curves.lead[piece] + _NEAR)
    found = np.zeros((len(piece), 4 if bent.any() else 3, point.shape[1]))
    found[:, 0] = point
    found[:, 1] = direction * (speed * time_s)[:, None]
    found[:, 2] = direction * (0.5 * change * time_s**2)[:, None]
    if bent.any():
        end, last = curves.at(piece[bent], stop[bent])
        first = found[bent, 1]
        last = last * ((speed + change * time_s) * time_s)[bent][:, None]
        rise = end - point[bent]
        found[bent, 2] = 3.0 * rise - 2.0 * first - last
        found[bent, 3] = first + last - 2.0 * rise
    return found
