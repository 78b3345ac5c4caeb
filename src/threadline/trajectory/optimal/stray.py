"""How far loads stray from the way that they are told, both ways, within a window of time."""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.compiled import njit


@njit()
def _squared(point, start, end):
    """Return the squared distance of a point from a straight way, and where on it (0..1)."""
    along, length = 0.0, 0.0
    for k in range(len(point)):
        direction = end[k] - start[k]
        along += (point[k] - start[k]) * direction
        length += direction * direction
    where = 0.0 if length <= 0.0 else min(max(along / length, 0.0), 1.0)
    squared = 0.0
    for k in range(len(point)):
        gap = point[k] - start[k] - where * (end[k] - start[k])
        squared += gap * gap
    return squared, where


@njit()
def strayed(load, way, fine, window):
    """Return how far load and way are from each other, at the places of the way.

    Every load is held against the way of the last ``window`` ticks, every place of the way
    against the load of the ticks that follow: what lags along the way is no error. The first
    ``window`` ticks are there to be looked back at, and not judged.

    Parameters
    ----------
    load
        (k, axes) lengths at the tool, a row for each tick.
    way
        (f, axes) what was told, ``fine`` places for each tick: row i of the load belongs to row
        ``i * fine`` of the way.

    Returns
    -------
    (f, axes) from the way to the load, and the (f,) ticks of that load.
    """
    axes = way.shape[1]
    size = np.zeros(len(way))
    out = np.zeros((len(way), axes))
    tick = np.zeros(len(way), dtype=np.int64)
    for k in range(window, len(load)):
        best, at, part = np.inf, 0, 0.0
        last = min(k * fine, len(way) - 1)
        for f in range(max(last - window * fine, 0), max(last, 1)):
            squared, where = _squared(load[k], way[f], way[f + 1])
            if squared < best:
                best, at, part = squared, f, where
        if best > size[at]:
            size[at], tick[at] = best, k
            for a in range(axes):
                out[at, a] = load[k, a] - way[at, a] - part * (way[at + 1, a] - way[at, a])
    for f in range(window * fine, len(way)):
        best, at, part = np.inf, 0, 0.0
        begin = f // fine
        for k in range(begin, min(begin + window, len(load) - 1)):
            squared, where = _squared(way[f], load[k], load[k + 1])
            if squared < best:
                best, at, part = squared, k, where
        if size[f] < best < np.inf:
            size[f], tick[f] = best, at
            for a in range(axes):
                out[f, a] = load[at, a] + part * (load[at + 1, a] - load[at, a]) - way[f, a]
    return out, tick


@njit()
def blamed(error, tick, fine, acceleration, swing, tolerance):
    """Return the (f,) logarithms by which accelerations are to fall, 0 for those without blame.

    Parameters
    ----------
    error, tick
        As of ``strayed``.
    acceleration
        (f, axes) of the way, at the tool.
    swing
        (d, axes) what an axis is off, d places of the way after a change of its velocity.
    """
    out = np.zeros(len(error))
    share = np.zeros(len(swing))
    for f in range(len(error)):
        size = np.sqrt((error[f] ** 2).sum())
        if size <= tolerance:
            continue
        due = np.log(size / tolerance)
        seen = min(tick[f] * fine, len(error) - 1)
        most = 0.0
        for d in range(min(len(swing), seen + 1)):
            share[d] = (error[f] * swing[d] * acceleration[seen - d]).sum()
            most = max(most, share[d])
        for d in range(min(len(swing), seen + 1)):
            if share[d] > 0.0:
                weight = min(1.0, 2.0 * share[d] / most)
                out[seen - d] = max(out[seen - d], weight * due)
    return out


@njit()
def aligned(time_s, tangent, before_s, after_s):
    """Return the (n,) least cosine between a tangent and those within a window of time.

    0 where one of them is at a right angle or points back, or where the motion ends within it.
    """
    n = len(time_s)
    out = np.ones(n)
    low = 0
    for i in range(n):
        while time_s[low] < time_s[i] - before_s:
            low += 1
        if time_s[i] + after_s > time_s[n - 1]:
            out[i] = 0.0
        for j in range(low, n):
            if time_s[j] > time_s[i] + after_s:
                break
            cosine = 0.0
            for a in range(tangent.shape[1]):
                cosine += tangent[i, a] * tangent[j, a]
            out[i] = min(out[i], max(cosine, 0.0))
    return out
