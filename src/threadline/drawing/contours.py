"""Contours: strokes that are joined end to end within a gap; every repair is reported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.drawing.curves import Pieces, join_pieces
from threadline.drawing.strokes import Stroke
from threadline.errors import JobError, Place

ZERO_LENGTH_M = 1e-9
_SAID = 10
_NEAR = 100.0  # ends this many gaps apart look meant to meet


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contour:
    """A curve without branches.

    The ends of neighbouring pieces are at most the gap apart. A gap is not closed: it is a jump in
    position, which adds nothing to the length.
    """

    pieces: Pieces
    closed: bool
    layer: str = ""
    colour: str = ""


def drop_zero_lengths(strokes: Sequence[Stroke], file: str) -> tuple[list[Stroke], list[str]]:
    """Return the strokes without pieces of length 0, and warnings about these.

    A stroke that has no other pieces is left out.
    """
    if not strokes:
        return [], []
    pieces = join_pieces([stroke.pieces for stroke in strokes])
    first, last = pieces.ends()
    middle = pieces.evaluate(np.arange(len(pieces)), np.full(len(pieces), 0.5))[0]
    reach = np.hypot(*(middle - first).T) + np.hypot(*(last - middle).T)
    bad = np.flatnonzero(~(reach > ZERO_LENGTH_M))
    if not len(bad):
        return list(strokes), []
    warnings = [
        f"{Place(file, int(pieces.line[k]))}: a segment of length zero at "
        f"{point_text(first[k])} was left out"
        for k in bad[:_SAID]
    ]
    if len(bad) > _SAID:
        warnings.append(f"{file}: {len(bad)} segments of length zero in all")
    counts = [len(stroke.pieces) for stroke in strokes]
    begins = np.concatenate([[0], np.cumsum(counts)])
    kept = list(strokes)
    owner = np.searchsorted(begins, bad, side="right") - 1
    for k in reversed(np.unique(owner).tolist()):
        own = np.setdiff1d(np.arange(counts[k]), bad[owner == k] - begins[k])
        if len(own):
            kept[k] = replace(strokes[k], pieces=strokes[k].pieces.take(own))
        else:
            del kept[k]
    return kept, warnings


def join_strokes(
    strokes: Sequence[Stroke], gap_m: float, file: str
) -> tuple[list[Contour], list[str]]:
    """Return the contours that ``strokes`` make, in the order of the file, and warnings.

    The start and the direction of a contour are those of its first stroke in the file.

    Parameters
    ----------
    strokes
        Strokes of one seam.
    gap_m
        Ends at most this far apart are joined.
    file
        Name of the file, for messages.

    Raises
    ------
    JobError
        If three or more ends meet, so that the continuation is ambiguous, or a stroke is shorter
        than the gap.
    """
    if not strokes:
        return [], []
    begin, end = join_pieces([s.pieces for s in strokes]).ends()
    after = np.cumsum([len(s.pieces) for s in strokes])
    first, last = begin[np.concatenate([[0], after[:-1]])], end[after - 1]
    loop = np.hypot(*(last - first).T) <= gap_m
    for k in np.flatnonzero(loop).tolist():
        _refuse_short(strokes[k], gap_m, file)
    ends = np.concatenate([first, last])  # end e of stroke e % n; the last ones from n on
    count = len(strokes)
    partner = _partners(ends, np.tile(~loop, 2), gap_m, strokes, file)
    warnings = _gap_warnings(ends, partner, strokes, file)
    contours, used = [], np.zeros(count, dtype=bool)
    for k in range(count):
        if used[k]:
            continue
        chain, closed = _walk(k, partner, count)
        used[[index for index, _ in chain]] = True
        parts = [
            strokes[index].pieces.reverse() if backwards else strokes[index].pieces
            for index, backwards in chain
        ]
        contour = Contour(
            pieces=join_pieces(parts),
            closed=closed or bool(loop[k]),
            layer=strokes[k].layer,
            colour=strokes[k].colour,
        )
        contours.append(contour)
        if not contour.closed:
            warnings += _open_warning(contour, gap_m, file)
    return contours, warnings


def _partners(
    ends: FloatArray,
    free: np.ndarray,
    gap_m: float,
    strokes: Sequence[Stroke],
    file: str,
) -> IntArray:
    """Return the (2 n,) index of the end that each end meets, -1 for none."""
    from scipy.spatial import cKDTree

    count = len(strokes)
    partner = np.full(2 * count, -1, dtype=np.int64)
    index = np.flatnonzero(free)
    if not len(index):
        return partner
    pairs = cKDTree(ends[index]).query_pairs(gap_m, output_type="ndarray")
    for i, j in index[pairs]:
        for one, other in ((i, j), (j, i)):
            if partner[one] >= 0:
                met = sorted({strokes[e % count].line for e in (one, other, partner[one])})
                which = f" (lines {', '.join(map(str, met))})" if met[0] else ""
                raise JobError(
                    f"three or more ends meet at {point_text(ends[one])}{which}",
                    place=Place(file, strokes[one % count].line),
                    remedy="Delete lines drawn twice, or put the branches on layers of their own.",
                )
            partner[one] = other
    return partner


def _walk(start: int, partner: IntArray, count: int) -> tuple[list[tuple[int, bool]], bool]:
    """Return the chain through stroke ``start``: (stroke, backwards) pairs, and if it closes."""
    chain = [(start, False)]
    end = start + count
    while partner[end] >= 0:
        entered = int(partner[end])
        if entered % count == start:
            return chain, True
        chain.append((entered % count, entered >= count))
        end = entered - count if entered >= count else entered + count
    before: list[tuple[int, bool]] = []
    end = start
    while partner[end] >= 0:
        entered = int(partner[end])
        before.append((entered % count, entered < count))
        end = entered - count if entered >= count else entered + count
    return before[::-1] + chain, False


def _gap_warnings(
    ends: FloatArray, partner: IntArray, strokes: Sequence[Stroke], file: str
) -> list[str]:
    met = np.flatnonzero(partner > np.arange(len(partner)))
    gaps = np.hypot(*(ends[met] - ends[partner[met]]).T)
    wide = met[gaps > ZERO_LENGTH_M]
    if not len(wide):
        return []
    worst = met[int(np.argmax(gaps))]
    place = Place(file, strokes[worst % len(strokes)].line)
    return [
        f"{place}: {len(wide)} gaps between strokes were passed over, the widest of "
        f"{gaps.max() * 1e3:.3g} mm at {point_text(ends[worst])}"
    ]


def _open_warning(contour: Contour, gap_m: float, file: str) -> list[str]:
    begin, end = contour.pieces.ends()[0][0], contour.pieces.ends()[1][-1]
    apart = float(np.hypot(*(end - begin)))
    if apart > _NEAR * gap_m:
        return []
    return [
        f"{Place(file, int(contour.pieces.line[0]))}: the contour is open by {apart * 1e3:.3g} mm "
        f"at {point_text(begin)}; a gap of {gap_m * 1e3:.3g} mm counts as closed"
    ]


def _refuse_short(stroke: Stroke, gap_m: float, file: str) -> None:
    first = stroke.pieces.ends()[0]
    inside = stroke.pieces.evaluate(np.arange(len(first)), np.full(len(first), 0.5))[0]
    spread = np.ptp(np.concatenate([first, inside]), axis=0)
    if np.hypot(*spread) <= gap_m:
        raise JobError(
            f"a stroke at {point_text(first[0])} is shorter than the gap of "
            f"{gap_m * 1e3:.3g} mm that counts as joined",
            place=Place(file, stroke.line),
            remedy="Delete the stroke, or set a smaller gap.",
        )


def point_text(point: FloatArray) -> str:
    """Return a point for a message, in mm."""
    return f"({point[0] * 1e3:.4g}, {point[1] * 1e3:.4g}) mm"
