"""The error of the laid fibre: its distance to the designed fibre, on the mandrel."""

from __future__ import annotations

from collections.abc import Sequence
from threading import local

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit
from threadline.commands.plan import Plan
from threadline.verdict.replayed import Wound, WoundJob, programmed_fibre, wound_job
from threadline.winding.replay import Fibre
from threadline.winding.surface import Surface

_NEAR_M = 0.02  # laid length before and after a point in which the designed fibre is searched
_FAR_M = 0.1  # the same after a part of unknown place
_ROUNDING = 1.0 + 1e-9  # of a squared distance


@njit(nogil=True)
def _to_chord(point: FloatArray, design: FloatArray, k: int) -> tuple[float, float]:
    """Return the squared distance of a point to chord ``k``, and the share of the nearest place."""
    span, along = 0.0, 0.0
    for j in range(3):
        d = design[k + 1, j] - design[k, j]
        span += d * d
        along += d * (point[j] - design[k, j])
    share = min(max(along / span, 0.0), 1.0) if span > 0.0 else 0.0
    away = 0.0
    for j in range(3):
        d = point[j] - design[k, j] - share * (design[k + 1, j] - design[k, j])
        away += d * d
    return away, share


@njit(nogil=True)
def off_design(
    points: FloatArray, design: FloatArray, state: FloatArray, longest: float = np.inf
) -> FloatArray:
    """Return (n,) distances of points to the designed fibre; NaN where either place is unknown.

    Points and design are (n, 4): place and laid length in m, NaN for an unknown place; lengths do
    not fall. ``state`` is updated: how much more length the design had laid at the point before,
    and the length before and after it in which the design is searched. ``longest`` is the longest
    chord of the design, m: it serves to skip chords that are too far away.
    """
    found = np.full(len(points), np.nan)
    last = len(design) - 2
    for i in range(len(points)):
        if np.isnan(points[i, 0]):
            state[1] = _FAR_M
            continue
        length = points[i, 3] + state[0]
        low = max(np.searchsorted(design[:, 3], length - state[1]) - 1, 0)
        high = min(np.searchsorted(design[:, 3], length + state[1]), last)
        # The chord at the same laid length bounds the distance of the nearest one.
        guess = min(max(np.searchsorted(design[:, 3], length) - 1, low), high)
        bound = _to_chord(points[i], design, guess)[0]
        reach = (np.sqrt(bound) + longest) ** 2 * _ROUNDING if bound >= 0.0 else np.inf
        best, near, at = np.inf, -1, 0.0
        for k in range(low, high + 1):
            begin = 0.0
            for j in range(3):
                begin += (points[i, j] - design[k, j]) ** 2
            if begin > reach or np.isnan(begin) or np.isnan(design[k + 1, 0]):
                continue
            away, share = _to_chord(points[i], design, k)
            if away < best:
                best, near, at = away, k, share
        # Next to an unknown part of the design, the design has no place beside the point.
        before = near > 0 and at == 0.0 and np.isnan(design[near - 1, 0])
        behind = 0 <= near < last and at == 1.0 and np.isnan(design[near + 2, 0])
        if before or behind:
            near = -1
        if near < 0:
            state[1] = _FAR_M
            continue
        found[i] = np.sqrt(best)
        state[0] = design[near, 3] + at * (design[near + 1, 3] - design[near, 3]) - points[i, 3]
        state[1] = _NEAR_M
    return found


def _points(surface: Surface, fibre: Fibre) -> FloatArray:
    """Return (n, 4) places in the mandrel's frame and laid lengths; NaN for unknown places."""
    u = np.where(fibre.known, fibre.u, 0.0)
    x, r = surface.points_at(u).T
    places = np.column_stack([x, r * np.cos(fibre.angle), r * np.sin(fibre.angle), fibre.length_m])
    places[~fibre.known, :3] = np.nan
    return places


_LATEST = local()
"""The latest plan, and its designed fibre: many machines are judged with one plan."""


def _design_of(plan: Plan) -> FloatArray:
    """Return (n, 4) places of the designed fibre, as ``_points``; lengths do not fall."""
    if getattr(_LATEST, "plan", None) is plan:
        known: FloatArray = _LATEST.design
        return known
    job = wound_job(plan)
    assert job is not None
    rows = [np.empty((0, 4))]
    for samples in programmed_fibre(plan, job):
        fibre = samples.fibre
        points = _points(job.surface, fibre)
        # One row of an unknown part stays, so that no chord crosses it.
        known_rows = np.concatenate([[True], np.isfinite(points[:, 0])])
        is_known = (known_rows[1:] | known_rows[:-1]) & np.isfinite(fibre.length_m)
        rows.append(points[is_known])
    design = np.vstack(rows)
    design[:, 3] = np.maximum.accumulate(design[:, 3])
    _LATEST.plan, _LATEST.design = plan, design
    return design


class Apart:
    """Distance between the laid fibre and the fibre of the program."""

    def __init__(self, plan: Plan, jobs: Sequence[WoundJob]) -> None:
        self._design = _design_of(plan)
        chords = np.linalg.norm(np.diff(self._design[:, :3], axis=0), axis=1)
        self._longest = float(chords.max(where=np.isfinite(chords), initial=0.0))
        self._surfaces = [job.surface for job in jobs]
        self._state = [np.array([0.0, _FAR_M]) for _ in jobs]

    def __call__(self, samples: Wound, run: int) -> FloatArray:
        """Return (n,) distances, m, of the samples of a run; NaN where either place is unknown."""
        fibre = samples.fibre
        if len(self._design) < 2:
            return np.full(len(fibre), np.nan)
        points = _points(self._surfaces[run], fibre)
        return np.asarray(off_design(points, self._design, self._state[run], self._longest))
