"""Mitres, which replace complete rounds at the corners of an offset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.drawing.self_crossing import crossings

_SAME_M = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mitre:
    """A round at a corner and the point that may take its place.

    Parameters
    ----------
    first, last
        First and last chord of the round in the raw chain.
    begin, apex, end
        (2,) beginning of the round, point of the mitre, and end of the round.
    """

    first: int
    last: int
    begin: FloatArray
    apex: FloatArray
    end: FloatArray


def sharpen(
    points: FloatArray, labels: IntArray, closed: bool, mitres: Sequence[Mitre]
) -> tuple[FloatArray, IntArray]:
    """Return the chain with every complete round replaced by its mitre.

    Parts of an offset are valid by their distance from the contour, which is constant on a round
    but not on a mitre. Mitres therefore replace rounds afterwards, except those that would cross
    another part of the chain.

    Parameters
    ----------
    points, labels
        (n + 1, 2) points of the offset, and (n,) chord of the raw chain that each of its chords is
        part of.
    """
    whole = _whole(points, labels, mitres)
    while True:
        sharp, names, owner = _replace(points, labels, whole)
        first, second, *_ = crossings(sharp[:-1], sharp[1:], closed)
        guilty = set(owner[np.concatenate([first, second])].tolist()) - {-1}
        if not guilty:
            return sharp, names
        whole = [found for k, found in enumerate(whole) if k not in guilty]


def _whole(
    points: FloatArray, labels: IntArray, mitres: Sequence[Mitre]
) -> list[tuple[int, int, Mitre]]:
    """Return first and last chord of every round that is complete."""
    at = {int(label): k for k, label in enumerate(labels)}
    found = []
    for mitre in mitres:
        i, j = at.get(mitre.first), at.get(mitre.last)
        if i is None or j is None or j - i != mitre.last - mitre.first:
            continue
        ends = np.hypot(*(points[i] - mitre.begin)), np.hypot(*(points[j + 1] - mitre.end))
        if max(ends) < _SAME_M:
            found.append((i, j, mitre))
    return sorted(found, key=lambda item: item[0])


def _replace(
    points: FloatArray, labels: IntArray, whole: list[tuple[int, int, Mitre]]
) -> tuple[FloatArray, IntArray, IntArray]:
    """Return points, labels, and for each chord the mitre that it belongs to or -1."""
    parts, names, owner = [], [], []
    last = 0
    for k, (i, j, mitre) in enumerate(whole):
        parts += [points[last : i + 1], mitre.apex[None]]
        names += [labels[last:i], labels[[i, j]]]
        owner += [np.full(i - last, -1), np.full(2, k)]
        last = j + 1
    parts.append(points[last:])
    names.append(labels[last:])
    owner.append(np.full(len(labels) - last, -1))
    return (
        np.concatenate(parts),
        np.concatenate(names),
        np.concatenate(owner).astype(np.int64),
    )
