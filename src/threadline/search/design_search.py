"""Search for the least change, and the region in spec around a design in two parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.search.design_evaluate import Evaluator, Tried
from threadline.search.design_space import Space

_CROSSOVERS = (0.7, 0.85, 1.0, 1.25, 1.6)
_MARGINS = (0.0, -15.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Region:
    """The least ratio of measured to limit on a grid of two parameters.

    Parameters
    ----------
    names
        Names of the parameters on the abscissa and the ordinate.
    factors
        (m,) factors of each parameter.
    found
        (m, m) ratio without tolerances, at the best of some settings, with the other parameters as
        in the design; ordinate first.
    unchanged
        (m, m) ratio with the other parameters as in the original machine.
    others
        The other parameters of the design that differ from the machine: name to factor.
    """

    names: tuple[str, str]
    factors: tuple[FloatArray, FloatArray]
    found: FloatArray
    unchanged: FloatArray
    others: dict[str, float]


def region_of(
    space: Space,
    evaluator: Evaluator,
    centre: FloatArray,
    level: int,
    usage: FloatArray,
    plotted: tuple[str, str] | None,
    report: Callable[[float], None],
) -> Region | None:
    """Return the region about ``centre``; None with fewer than two parameters, or no grid.

    Parameters
    ----------
    centre, level
        (dims,) point of the design, and the index of its share of the acceleration.
    usage
        (P,) typical change of each parameter along the Pareto set, times its weight.
    plotted
        Two parameters; None: first the costliest at ``centre``, then the most used.
    """
    names = plotted or _important(space, centre, usage)
    if names is None or not evaluator.effort.side:
        return None
    first, second = (space.names.index(name) for name in names)
    side = evaluator.effort.side
    lines = [
        _line(float(space.low[k]), float(space.high[k]), float(centre[k]), side)
        for k in (first, second)
    ]
    slices = {}
    for turn, base in enumerate((centre, _unchanged(space, centre))):
        slices[turn] = _slice(
            space, evaluator, base, level, (first, second), (lines[0], lines[1]),
            lambda f, t=turn: report((t + f) / 2.0),  # type: ignore[misc]
        )  # fmt: skip
        rest = np.delete(centre[: space.parameters], [first, second])
        if not rest.any():
            slices[1] = slices[0]
            break
    return Region(
        names=(names[0], names[1]),
        factors=(np.exp(lines[0]), np.exp(lines[1])),
        found=slices[0],
        unchanged=slices[1],
        others={
            name: float(np.exp(centre[k]))
            for k, name in enumerate(space.names)
            if k not in {first, second} and centre[k] != 0.0
        },
    )


def _line(low: float, high: float, centre: float, side: int) -> FloatArray:
    """Return about ``side`` values from low to high, with the centre and two values towards 0.

    The edge of the region lies near the design, so the grid is finer there.
    """
    near = [centre, 0.5 * centre, 1.5 * centre, 0.0]
    inside = [value for value in near if low <= value <= high]
    return np.unique(np.round([*np.linspace(low, high, side), *inside], 12))


def _important(space: Space, centre: FloatArray, usage: FloatArray) -> tuple[str, str] | None:
    free = np.flatnonzero((space.high > space.low)[: space.parameters])
    if len(free) < 2:
        return None
    cost = np.abs(centre[: space.parameters]) * space.weights
    rank = sorted(free.tolist(), key=lambda k: (-cost[k], -usage[k]))
    first, second = sorted(rank[:2])
    return space.names[first], space.names[second]


def _unchanged(space: Space, centre: FloatArray) -> FloatArray:
    base = centre.copy()
    base[: space.parameters] = 0.0
    return base


def _slice(
    space: Space,
    evaluator: Evaluator,
    base: FloatArray,
    level: int,
    pair: tuple[int, int],
    lines: tuple[FloatArray, FloatArray],
    report: Callable[[float], None],
) -> FloatArray:
    """Return (m, m) the least ratio on a grid, ordinate first."""
    across, up = np.meshgrid(*lines)
    grid = np.repeat(base[None], across.size, axis=0)
    grid[:, pair[0]], grid[:, pair[1]] = across.ravel(), up.ravel()
    tries = [grid]
    if space.designs_gains:
        tries = []
        for factor, turn in product(_CROSSOVERS, _MARGINS):
            other = grid.copy()
            other[:, -2] += np.log(factor)
            other[:, -1] += turn
            tries.append(np.clip(other, space.low, space.high))
    best = np.full(across.size, np.inf)
    for k, points in enumerate(tries):
        # Judged without tolerances: their corners would take too long.
        found = evaluator.tried(points, np.full(len(points), level), beyond=-1.0)
        best = np.minimum(best, found.nominal)
        report((k + 1) / len(tries))
    return best.reshape(across.shape)


SEED = 1994
_ELITE = 8
_PATIENCE = 4
_ENOUGH = 2e-3  # relative gain of cost: a smaller gain over several rounds ends the search
_FIRST_STEP, _STEP_DECAY = 0.15, 0.85
_SHRINK = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98)
TARGETS = (0.8, 0.6)
"""Further ratios for which the least change is searched, for the Pareto set."""

Report = Callable[[float], None]


def first_sample(space: Space, evaluator: Evaluator, report: Report, seed: int = SEED) -> Tried:
    """Return a Sobol sample of the whole space at every level, and samples of the settings alone.

    The samples of the settings keep the parameters of the original machine, or of a known answer.
    """
    from scipy.stats import qmc

    dims, effort = len(space.low), evaluator.effort
    points: list[FloatArray] = []
    levels: list[int] = []
    for level in range(len(space.levels)):
        cube = qmc.Sobol(dims, seed=seed + level).random_base2(effort.sample_log2)
        points.append(qmc.scale(cube, space.low, np.maximum(space.high, space.low + 1e-12)))
        for fixed in [np.zeros(space.parameters), *known_points(space).values()]:
            points.append(with_settings(space, fixed, effort.settings_log2, seed))
        levels += [level] * (sum(len(p) for p in points) - len(levels))
    everything, of_level = np.concatenate(points), np.array(levels, dtype=np.int64)
    found: Tried | None = None
    step = max(len(everything) // 4, 1)
    for at in range(0, len(everything), step):
        part = evaluator.tried(everything[at : at + step], of_level[at : at + step], beyond=-1.0)
        found = part if found is None else found.join(part)
        report(0.7 * (at + len(part)) / len(everything))
    assert found is not None
    if not evaluator.others.asked:
        return found
    # Only the cheapest candidates are tried in further runs; other candidates in spec are dropped.
    good = np.flatnonzero(found.nominal <= 1.0)
    cheap = good[np.argsort(space.cost(found.points[good]), kind="stable")][: effort.proposals]
    out = found.taken(np.flatnonzero(found.nominal > 1.0))
    return out.join(evaluator.tried(found.points[cheap], found.level[cheap])) if len(cheap) else out


def known_points(space: Space) -> dict[str, FloatArray]:
    """Return the (P,) coordinates of the known answers."""
    return {
        name: np.array([np.log(factors.get(p, 1.0)) for p in space.names])
        for name, factors in space.known.items()
    }


def with_settings(space: Space, parameters: FloatArray, log2: int, seed: int = SEED) -> FloatArray:
    """Return points with the same parameters and a Sobol sample of the settings."""
    from scipy.stats import qmc

    settings = len(space.low) - space.parameters
    if not settings:
        return parameters[None]
    cube = qmc.Sobol(settings, seed=seed).random_base2(log2)
    low, high = space.low[space.parameters :], space.high[space.parameters :]
    scaled = np.minimum(qmc.scale(cube, low, np.maximum(high, low + 1e-12)), high)
    return np.hstack([np.broadcast_to(parameters, (len(scaled), len(parameters))), scaled])


def least_change(
    space: Space,
    evaluator: Evaluator,
    tried: Tried,
    report: Report,
    *,
    target: float = 1.0,
    seed: int = SEED,
) -> Tried:
    """Return all tried candidates, with the candidates of a search for the least cost at a ratio.

    Parameters
    ----------
    tried
        Candidates to start from.
    target
        Largest ratio of measured to limit.
    seed
        Seed of the random moves.
    """
    random = np.random.default_rng(seed)
    step, stale = _FIRST_STEP, 0
    effort = evaluator.effort
    rounds = effort.rounds if target == 1.0 else effort.trade_rounds
    best = _least(space, tried, target)
    for turn in range(rounds):
        elite = _elite(space, tried, target)
        on_edge = len(space.low) <= _FEW and _both_sides(tried, elite, target)
        each = max(effort.proposals // 3, 1) if on_edge else effort.proposals
        points, level = _proposals(space, tried, elite, step, random, each)
        if on_edge:
            others, of_level = _along_edge(space, tried, elite, target, random, 2 * each)
            points, level = np.concatenate([points, others]), np.concatenate([level, of_level])
        if effort.modelled:
            steps, of_level = cheapest_by_planes(space, tried, elite, step, target)
            points, level = np.concatenate([points, steps]), np.concatenate([level, of_level])
        if np.isfinite(best):
            cheaper = space.cost(points) < best
            points, level = points[cheaper], level[cheaper]
        if len(points):
            tried = tried.join(evaluator.tried(points, level))
        now = _least(space, tried, target)
        stale = stale + 1 if now > best * (1.0 - _ENOUGH) or not np.isfinite(now) else 0
        best, step = now, step * _STEP_DECAY
        report((turn + 1) / rounds)
        if stale >= _PATIENCE or best == 0.0:
            break
    return tried


def _least(space: Space, tried: Tried, target: float) -> float:
    cost = space.cost(tried.points)[tried.ratio <= target]
    return float(cost.min(initial=np.inf))


def _elite(space: Space, tried: Tried, target: float) -> IntArray:
    """Return the cheapest candidates that meet the target, and the nearest cheaper ones."""
    cost = space.cost(tried.points)
    good = np.flatnonzero(tried.ratio <= target)
    chosen = good[np.argsort(cost[good], kind="stable")][:_ELITE]
    limit = cost[chosen[0]] if len(chosen) else np.inf
    near = np.flatnonzero((tried.ratio > target) & (cost < limit))
    near = near[np.argsort(tried.ratio[near], kind="stable")][
        : _ELITE if len(chosen) else 3 * _ELITE
    ]
    return np.concatenate([chosen, near]).astype(np.int64)


_FITTED = 4  # number of candidates per dimension for the fit of a plane
_FAR = 1.6  # largest ratio of a candidate that is used for a plane
_ROOM = (0.0, 0.01, 0.03)  # shares of the target that a modelled candidate should leave free
_MODELLED = 6  # number of candidates around which planes are fitted


def cheapest_by_planes(
    space: Space, tried: Tried, elite: IntArray, step: float, target: float
) -> tuple[FloatArray, IntArray]:
    """Return the cheapest candidates by planes that are fitted to the ratio about the elite.

    The least sum of magnitudes lies where one number trades against another; moves of one number,
    or of all numbers in proportion, do not find it. Each plane holds within ``step`` of the range.
    It is also used with each changed number left unchanged, because fewer changes may be cheaper.
    """
    from scipy.optimize import linprog

    count, dims = space.parameters, len(space.low)
    span = np.maximum(space.high - space.low, 1e-12)
    known = np.flatnonzero(tried.ratio < _FAR * target)
    points, levels = [], []
    if len(known) <= dims:
        return np.empty((0, dims)), np.empty(0, dtype=np.int64)
    scaled = tried.points[known] / span
    for index in elite[:_MODELLED].tolist():
        own = tried.points[index]
        away = np.linalg.norm(scaled - own / span, axis=1)
        near = known[np.argsort(away, kind="stable")[: _FITTED * dims]]
        offset = (tried.points[near] - own) / span
        rows = np.column_stack([np.ones(len(near)), offset])
        plane = np.linalg.lstsq(
            np.vstack([rows, 1e-3 * np.eye(dims + 1)[1:]]),
            np.concatenate([tried.ratio[near], np.zeros(dims)]),
            rcond=None,
        )[0]
        # Unknowns: the point, then the magnitudes of its parameters.
        cost = np.concatenate([np.zeros(dims), space.weights])
        slope = plane[1:] / span
        size = np.hstack([np.eye(count, dims), -np.eye(count)])
        mirrored = np.hstack([-np.eye(count, dims), -np.eye(count)])
        for without in (None, *np.flatnonzero(own[:count]).tolist()):
            reach = step * span
            low, high = np.maximum(own - reach, space.low), np.minimum(own + reach, space.high)
            if without is not None:
                low[without] = high[without] = 0.0
            for room in _ROOM:
                most = target * (1.0 - room) - plane[0] + float(slope @ own)
                found = linprog(
                    cost,
                    np.vstack([np.append(slope, np.zeros(count)), size, mirrored]),
                    np.concatenate([[most], np.zeros(2 * count)]),
                    bounds=[*zip(low, high, strict=True), *[(0.0, None)] * count],
                )
                if found.x is not None and found.status == 0:
                    points.append(np.clip(found.x[:dims], space.low, space.high))
                    levels.append(int(tried.level[index]))
    if not points:
        return np.empty((0, dims)), np.empty(0, dtype=np.int64)
    every, first = np.unique(np.round(points, 6), axis=0, return_index=True)
    return every, np.array(levels, dtype=np.int64)[first]


def _proposals(
    space: Space,
    tried: Tried,
    elite: IntArray,
    step: float,
    random: np.random.Generator,
    most: int,
) -> tuple[FloatArray, IntArray]:
    """Return candidates about the elite: shrunk towards no change, and moved at random.

    The least sum of magnitudes often leaves some numbers unchanged, so a shrunk coordinate often
    ends exactly at no change.
    """
    count, span = space.parameters, space.high - space.low
    points: list[FloatArray] = []
    levels: list[int] = []
    each = max(most // max(len(elite), 1), 1)
    for index in elite.tolist():
        own, level = tried.points[index], int(tried.level[index])
        moved = own + step * span * random.standard_normal((each, len(own)))
        scale = random.choice(_SHRINK[1:], size=(each, 1))
        shrunk = random.random((each, 1)) < 0.5
        moved[:, :count] = np.where(shrunk, own[:count] * scale, moved[:, :count])
        for k in np.flatnonzero(own[:count]).tolist():
            alone = np.repeat(own[None], len(_SHRINK), axis=0)
            alone[:, k] *= _SHRINK
            # If one number changes less, another may have to change more.
            alone[:, count:] += (
                step * span[count:] * random.standard_normal((len(_SHRINK), len(span) - count))
            )
            moved = np.concatenate([moved, alone])
        zero = random.random((len(moved), count)) < 0.12
        moved[:, :count] = np.where(zero, 0.0, moved[:, :count])
        still = random.random((len(moved), 1)) < 0.3
        moved = np.where(still & (np.arange(len(own)) >= count), own, moved)
        points.append(np.clip(moved, space.low, space.high))
        other = random.integers(0, len(space.levels), len(moved))
        levels += np.where(random.random(len(moved)) < 0.2, other, level).tolist()
    every, of_level = np.concatenate(points), np.array(levels, dtype=np.int64)
    if len(every) > 2 * most:
        chosen = np.sort(random.choice(len(every), 2 * most, replace=False))
        every, of_level = every[chosen], of_level[chosen]
    return every, of_level


_FEW = 3  # largest number of parameters: with more, moves along the edge find dearer designs
_WITHIN = (0.0005, 0.002, 0.005)  # shares of the target that a crossing should leave free


def _both_sides(tried: Tried, elite: IntArray, target: float) -> bool:
    """Return whether the elite has candidates that meet the target, and others that do not."""
    met = tried.ratio[elite] <= target
    return bool(met.any() and not met.all())


def _along_edge(
    space: Space,
    tried: Tried,
    elite: IntArray,
    target: float,
    random: np.random.Generator,
    most: int,
) -> tuple[FloatArray, IntArray]:
    """Return candidates on the edge of the specification and along it, ``most`` of each.

    A crossing lies between a candidate of the elite that meets the target and a cheaper one that
    does not: at the point where the ratio, interpolated linearly, is just within the target. The
    elite lies along the edge, so differences between its candidates run along the edge, too, and
    trade one number for another, as in differential evolution (Storn and Price, "Differential
    evolution", J. of Global Optimization 11, 1997).
    """
    met = tried.ratio[elite] <= target
    inside = random.choice(elite[met], most)
    outside = random.choice(elite[~met], most)
    goal = target * (1.0 - random.choice(_WITHIN, most))
    rise = np.maximum(tried.ratio[outside] - tried.ratio[inside], 1e-9)
    share = np.clip((goal - tried.ratio[inside]) / rise, 0.02, 0.98)[:, None]
    crossing = (1.0 - share) * tried.points[inside] + share * tried.points[outside]
    own, one, other = random.integers(0, len(elite), (3, most))
    points = tried.points[elite]
    moved = points[own] + random.uniform(0.3, 1.0, (most, 1)) * (points[one] - points[other])
    still = (points[own] == 0.0) & (random.random(moved.shape) < 0.5)
    moved = np.clip(np.where(still, 0.0, moved), space.low, space.high)
    levels = np.concatenate([tried.level[inside], tried.level[elite][own]])
    return np.concatenate([crossing, moved]), levels


def pareto(space: Space, tried: Tried, most: float, apart: float = 0.05) -> IntArray:
    """Return the candidates that no other beats in both cost and ratio, the cheapest first.

    Parameters
    ----------
    most
        Largest ratio of interest.
    apart
        Width of intervals of the ratio; each interval keeps its cheapest candidate.
    """
    cost = space.cost(tried.points)
    order = np.lexsort((tried.ratio, cost))
    kept, best = [], most
    for index in order.tolist():
        if np.ceil(tried.ratio[index] / apart) < np.ceil(best / apart):
            kept.append(index)
            best = tried.ratio[index]
    return np.array(kept, dtype=np.int64)
