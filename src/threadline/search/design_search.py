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
    for slice_index, base in enumerate((centre, _unchanged(space, centre))):
        slices[slice_index] = _slice(
            space, evaluator, base, level, (first, second), (lines[0], lines[1]),
            lambda f, t=slice_index: report((t + f) / 2.0),  # type: ignore[misc]
        )  # fmt: skip
        other_factors = np.delete(centre[: space.parameters], [first, second])
        if not other_factors.any():
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
    extra_values = [centre, 0.5 * centre, 1.5 * centre, 0.0]
    values_in_range = [value for value in extra_values if low <= value <= high]
    return np.unique(np.round([*np.linspace(low, high, side), *values_in_range], 12))


def _important(space: Space, centre: FloatArray, usage: FloatArray) -> tuple[str, str] | None:
    changeable = np.flatnonzero((space.high > space.low)[: space.parameters])
    if len(changeable) < 2:
        return None
    cost = np.abs(centre[: space.parameters]) * space.weights
    ranked = sorted(changeable.tolist(), key=lambda k: (-cost[k], -usage[k]))
    first, second = sorted(ranked[:2])
    return space.names[first], space.names[second]


def _unchanged(space: Space, centre: FloatArray) -> FloatArray:
    unchanged = centre.copy()
    unchanged[: space.parameters] = 0.0
    return unchanged


def _slice(
    space: Space,
    evaluator: Evaluator,
    fixed_point: FloatArray,
    level: int,
    pair: tuple[int, int],
    axis_values: tuple[FloatArray, FloatArray],
    report: Callable[[float], None],
) -> FloatArray:
    """Return (m, m) the least ratio on a grid, ordinate first."""
    first_grid, second_grid = np.meshgrid(*axis_values)
    grid = np.repeat(fixed_point[None], first_grid.size, axis=0)
    grid[:, pair[0]], grid[:, pair[1]] = first_grid.ravel(), second_grid.ravel()
    tries = [grid]
    if space.designs_gains:
        tries = []
        for factor, margin_shift in product(_CROSSOVERS, _MARGINS):
            with_settings = grid.copy()
            with_settings[:, -2] += np.log(factor)
            with_settings[:, -1] += margin_shift
            tries.append(np.clip(with_settings, space.low, space.high))
    best = np.full(first_grid.size, np.inf)
    for k, points in enumerate(tries):
        # Judged without tolerances: their corners would take too long.
        candidates = evaluator.tried(points, np.full(len(points), level), beyond=-1.0)
        best = np.minimum(best, candidates.nominal)
        report((k + 1) / len(tries))
    return best.reshape(first_grid.shape)


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
    all_points, all_levels = np.concatenate(points), np.array(levels, dtype=np.int64)
    candidates: Tried | None = None
    batch_size = max(len(all_points) // 4, 1)
    for start in range(0, len(all_points), batch_size):
        batch = evaluator.tried(
            all_points[start : start + batch_size],
            all_levels[start : start + batch_size],
            beyond=-1.0,
        )
        candidates = batch if candidates is None else candidates.join(batch)
        report(0.7 * (start + len(batch)) / len(all_points))
    assert candidates is not None
    if not evaluator.others.asked:
        return candidates
    # Only the cheapest candidates are tried in further runs; other candidates in spec are dropped.
    in_spec = np.flatnonzero(candidates.nominal <= 1.0)
    cheapest = in_spec[np.argsort(space.cost(candidates.points[in_spec]), kind="stable")][
        : effort.proposals
    ]
    out_of_spec = candidates.taken(np.flatnonzero(candidates.nominal > 1.0))
    return (
        out_of_spec.join(evaluator.tried(candidates.points[cheapest], candidates.level[cheapest]))
        if len(cheapest)
        else out_of_spec
    )


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
    step, stale_rounds = _FIRST_STEP, 0
    effort = evaluator.effort
    rounds = effort.rounds if target == 1.0 else effort.trade_rounds
    best_cost = _least(space, tried, target)
    for round_index in range(rounds):
        elite = _elite(space, tried, target)
        on_edge = len(space.low) <= _FEW and _both_sides(tried, elite, target)
        proposal_count = max(effort.proposals // 3, 1) if on_edge else effort.proposals
        points, level = _proposals(space, tried, elite, step, random, proposal_count)
        if on_edge:
            edge_points, extra_levels = _along_edge(
                space, tried, elite, target, random, 2 * proposal_count
            )
            points, level = (
                np.concatenate([points, edge_points]),
                np.concatenate([level, extra_levels]),
            )
        if effort.modelled:
            plane_points, extra_levels = cheapest_by_planes(space, tried, elite, step, target)
            points, level = (
                np.concatenate([points, plane_points]),
                np.concatenate([level, extra_levels]),
            )
        if np.isfinite(best_cost):
            cheaper = space.cost(points) < best_cost
            points, level = points[cheaper], level[cheaper]
        if len(points):
            tried = tried.join(evaluator.tried(points, level))
        least_cost = _least(space, tried, target)
        stale_rounds = (
            stale_rounds + 1
            if least_cost > best_cost * (1.0 - _ENOUGH) or not np.isfinite(least_cost)
            else 0
        )
        best_cost, step = least_cost, step * _STEP_DECAY
        report((round_index + 1) / rounds)
        if stale_rounds >= _PATIENCE or best_cost == 0.0:
            break
    return tried


def _least(space: Space, tried: Tried, target: float) -> float:
    cost = space.cost(tried.points)[tried.ratio <= target]
    return float(cost.min(initial=np.inf))


def _elite(space: Space, tried: Tried, target: float) -> IntArray:
    """Return the cheapest candidates that meet the target, and the nearest cheaper ones."""
    cost = space.cost(tried.points)
    meeting = np.flatnonzero(tried.ratio <= target)
    cheapest = meeting[np.argsort(cost[meeting], kind="stable")][:_ELITE]
    least_cost = cost[cheapest[0]] if len(cheapest) else np.inf
    cheaper_misses = np.flatnonzero((tried.ratio > target) & (cost < least_cost))
    cheaper_misses = cheaper_misses[np.argsort(tried.ratio[cheaper_misses], kind="stable")][
        : _ELITE if len(cheapest) else 3 * _ELITE
    ]
    return np.concatenate([cheapest, cheaper_misses]).astype(np.int64)


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
    usable = np.flatnonzero(tried.ratio < _FAR * target)
    points, levels = [], []
    if len(usable) <= dims:
        return np.empty((0, dims)), np.empty(0, dtype=np.int64)
    scaled = tried.points[usable] / span
    for index in elite[:_MODELLED].tolist():
        centre = tried.points[index]
        distances = np.linalg.norm(scaled - centre / span, axis=1)
        neighbours = usable[np.argsort(distances, kind="stable")[: _FITTED * dims]]
        offsets = (tried.points[neighbours] - centre) / span
        regressors = np.column_stack([np.ones(len(neighbours)), offsets])
        plane = np.linalg.lstsq(
            np.vstack([regressors, 1e-3 * np.eye(dims + 1)[1:]]),
            np.concatenate([tried.ratio[neighbours], np.zeros(dims)]),
            rcond=None,
        )[0]
        # Unknowns: the point, then the magnitudes of its parameters.
        cost = np.concatenate([np.zeros(dims), space.weights])
        slope = plane[1:] / span
        positive_rows = np.hstack([np.eye(count, dims), -np.eye(count)])
        negative_rows = np.hstack([-np.eye(count, dims), -np.eye(count)])
        for reset in (None, *np.flatnonzero(centre[:count]).tolist()):
            reach = step * span
            low, high = (
                np.maximum(centre - reach, space.low),
                np.minimum(centre + reach, space.high),
            )
            if reset is not None:
                low[reset] = high[reset] = 0.0
            for margin in _ROOM:
                bound = target * (1.0 - margin) - plane[0] + float(slope @ centre)
                solution = linprog(
                    cost,
                    np.vstack([np.append(slope, np.zeros(count)), positive_rows, negative_rows]),
                    np.concatenate([[bound], np.zeros(2 * count)]),
                    bounds=[*zip(low, high, strict=True), *[(0.0, None)] * count],
                )
                if solution.x is not None and solution.status == 0:
                    points.append(np.clip(solution.x[:dims], space.low, space.high))
                    levels.append(int(tried.level[index]))
    if not points:
        return np.empty((0, dims)), np.empty(0, dtype=np.int64)
    unique_points, first_indices = np.unique(np.round(points, 6), axis=0, return_index=True)
    return unique_points, np.array(levels, dtype=np.int64)[first_indices]


def _proposals(
    space: Space,
    tried: Tried,
    elite: IntArray,
    step: float,
    random: np.random.Generator,
    proposal_count: int,
) -> tuple[FloatArray, IntArray]:
    """Return candidates about the elite: shrunk towards no change, and moved at random.

    The least sum of magnitudes often leaves some numbers unchanged, so a shrunk coordinate often
    ends exactly at no change.
    """
    count, span = space.parameters, space.high - space.low
    points: list[FloatArray] = []
    levels: list[int] = []
    per_elite = max(proposal_count // max(len(elite), 1), 1)
    for index in elite.tolist():
        elite_point, level = tried.points[index], int(tried.level[index])
        proposals = elite_point + step * span * random.standard_normal(
            (per_elite, len(elite_point))
        )
        scale = random.choice(_SHRINK[1:], size=(per_elite, 1))
        shrunk = random.random((per_elite, 1)) < 0.5
        proposals[:, :count] = np.where(shrunk, elite_point[:count] * scale, proposals[:, :count])
        for k in np.flatnonzero(elite_point[:count]).tolist():
            shrunk_one = np.repeat(elite_point[None], len(_SHRINK), axis=0)
            shrunk_one[:, k] *= _SHRINK
            # If one number changes less, another may have to change more.
            shrunk_one[:, count:] += (
                step * span[count:] * random.standard_normal((len(_SHRINK), len(span) - count))
            )
            proposals = np.concatenate([proposals, shrunk_one])
        set_to_zero = random.random((len(proposals), count)) < 0.12
        proposals[:, :count] = np.where(set_to_zero, 0.0, proposals[:, :count])
        keep_settings = random.random((len(proposals), 1)) < 0.3
        proposals = np.where(
            keep_settings & (np.arange(len(elite_point)) >= count), elite_point, proposals
        )
        points.append(np.clip(proposals, space.low, space.high))
        random_levels = random.integers(0, len(space.levels), len(proposals))
        levels += np.where(random.random(len(proposals)) < 0.2, random_levels, level).tolist()
    all_points, all_levels = np.concatenate(points), np.array(levels, dtype=np.int64)
    if len(all_points) > 2 * proposal_count:
        chosen = np.sort(random.choice(len(all_points), 2 * proposal_count, replace=False))
        all_points, all_levels = all_points[chosen], all_levels[chosen]
    return all_points, all_levels


_FEW = 3  # largest number of parameters: with more, moves along the edge find dearer designs
_APART = 0.05  # width of an interval of the ratio in a front
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
    meets = tried.ratio[elite] <= target
    inside = random.choice(elite[meets], most)
    outside = random.choice(elite[~meets], most)
    goal_ratio = target * (1.0 - random.choice(_WITHIN, most))
    rise = np.maximum(tried.ratio[outside] - tried.ratio[inside], 1e-9)
    share = np.clip((goal_ratio - tried.ratio[inside]) / rise, 0.02, 0.98)[:, None]
    crossing = (1.0 - share) * tried.points[inside] + share * tried.points[outside]
    base, first, second = random.integers(0, len(elite), (3, most))
    points = tried.points[elite]
    along = points[base] + random.uniform(0.3, 1.0, (most, 1)) * (points[first] - points[second])
    stays_zero = (points[base] == 0.0) & (random.random(along.shape) < 0.5)
    along = np.clip(np.where(stays_zero, 0.0, along), space.low, space.high)
    levels = np.concatenate([tried.level[inside], tried.level[elite][base]])
    return np.concatenate([crossing, along]), levels


def pareto(space: Space, tried: Tried, most: float) -> IntArray:
    """Return the candidates that no other beats in both cost and ratio, the cheapest first.

    Each interval of the ratio, ``_APART`` wide, keeps its cheapest candidate.

    Parameters
    ----------
    most
        Largest ratio of interest.
    """
    cost = space.cost(tried.points)
    order = np.lexsort((tried.ratio, cost))
    front, best_ratio = [], most
    for index in order.tolist():
        if np.ceil(tried.ratio[index] / _APART) < np.ceil(best_ratio / _APART):
            front.append(index)
            best_ratio = tried.ratio[index]
    return np.array(front, dtype=np.int64)
