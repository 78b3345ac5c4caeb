"""``design`` beside CMA-ES (pycma) and scipy's differential evolution, at equal simulations.

Four problems, ten seeds each. All three evaluate candidates by the same evaluator, in one run each,
and minimise the cost of a candidate that is in specification. ``design`` spends what its Sobol
sample and its moves spend; a peer gets as many simulations. A peer minimises the cost and a penalty
for the share beyond the limit; the share of the acceleration is one more coordinate for it.

The value is the median over the seeds of the least cost; a seed without a candidate in
specification counts as the largest cost. There is no ratio where ``design`` finds that nothing has
to change, at a cost of 0. ``design`` also gives the trade of cost for margin; the peers do not.
"""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.search.design_evaluate import Effort, Evaluator
from threadline.search.design_search import SEED, first_sample, least_change
from threadline.search.design_single_proofs import JobReader
from threadline.search.design_space import Space, design_space
from threadline.verdict import load_spec

SEEDS = range(10)
EFFORT = Effort(sample_log2=6, settings_log2=4, proposals=48, rounds=12, trade_rounds=0, side=0)
_PENALTY = 20.0  # cost for each share beyond the limit
SEAM = """
[stitching]
stitch_length = "0.1 in"
needle_speed = "{needle} stitch/s"
motion = "discrete"

[[contour]]
unit = "in"
points = [[0, 0], [1, 0], [1, 0.8]]
"""
SPEC = """
name = "close"
[[criteria]]
name = "tracking_error"
axis = "X"
limit = "{limit}"
"""
TURN = "G91\nG1 X5 F2000\nG1 X-5\nM30\n"


class _Problem(NamedTuple):
    name: str
    job: str
    suffix: str
    machine: str
    spec: str | None


PLACE = Path(__file__).parents[1] / "examples" / "stitcher-place.spec.toml"
PROBLEMS = (
    _Problem("corner at 40 stitch/s", SEAM.format(needle=40), ".seam.toml", "stitcher", None),
    _Problem("corner at 75 stitch/s", SEAM.format(needle=75), ".seam.toml", "stitcher", None),
    _Problem("turn within 1.06 mm", TURN, ".prg", "lathe-winder", SPEC.format(limit="1.06 mm")),
    _Problem("turn within 0.8 mm", TURN, ".prg", "lathe-winder", SPEC.format(limit="0.8 mm")),
)
Least = Callable[["_Counted", int, int], float]


class _Counted:
    """Costs of candidates in the unit cube, and the least of those in specification so far."""

    def __init__(self, evaluator: Evaluator) -> None:
        self.evaluator, self.space = evaluator, evaluator.space
        self.least, self.used = np.inf, 0
        self.dims = len(self.space.low) + (len(self.space.levels) > 1)

    def costs(self, cube: FloatArray) -> FloatArray:
        """Return (n,) the cost and penalty of (n, dims) candidates."""
        space, own = self.space, len(self.space.low)
        points = space.low + (space.high - space.low) * np.clip(cube[:, :own], 0.0, 1.0)
        share = cube[:, own] if self.dims > own else np.zeros(len(cube))
        levels = np.minimum((share * len(space.levels)).astype(np.int64), len(space.levels) - 1)
        tried = self.evaluator.tried(points, np.maximum(levels, 0), beyond=-1.0)
        cost = space.cost(points)
        self.used += len(cube)
        self.least = min(self.least, float(cost[tried.ratio <= 1.0].min(initial=np.inf)))
        beyond = np.minimum(np.maximum(tried.ratio - 1.0, 0.0), 10.0)
        return np.asarray(cost + _PENALTY * beyond)


def run() -> Iterator[dict[str, Any]]:
    """Yield an entry for each problem and peer."""
    with tempfile.TemporaryDirectory() as folder:
        for number, problem in enumerate(PROBLEMS):
            evaluator = _evaluator(problem, Path(folder), number)
            yield from _compared(problem.name, evaluator)


def _evaluator(problem: _Problem, folder: Path, number: int) -> Evaluator:
    job = folder / f"{number}{problem.suffix}"
    job.write_text(problem.job, encoding="utf-8")
    spec = PLACE
    if problem.spec is not None:
        spec = folder / f"{number}.toml"
        spec.write_text(problem.spec, encoding="utf-8")
    machine, options = load_machine(problem.machine), Options(interpolation="linear")
    space = design_space(machine, ())
    read = JobReader.of(job, options)
    return Evaluator(space, read, load_spec(spec, machine), options, effort=EFFORT)


def _compared(name: str, evaluator: Evaluator) -> Iterator[dict[str, Any]]:
    most = _most(evaluator.space)
    ours: list[float] = []
    spent: list[int] = []
    peers: dict[str, list[float]] = {"CMA-ES (pycma)": [], "differential evolution (scipy)": []}
    missing: dict[str, str] = {}
    for seed in SEEDS:
        least, used = _design(evaluator, seed)
        ours.append(min(least, most))
        spent.append(used)
        for peer, search in zip(peers, (_cma, _differential), strict=True):
            try:
                peers[peer].append(min(search(_Counted(evaluator), used, seed), most))
            except ImportError as error:
                missing[peer] = str(error)
    for peer, found in peers.items():
        value = float(np.median(found)) if found else None
        wins = sum(a < b - 1e-6 for a, b in zip(ours, found, strict=False))
        losses = sum(a > b + 1e-6 for a, b in zip(ours, found, strict=False))
        mine = float(np.median(ours))
        yield {
            "name": f"least cost of a redesign vs {peer}, {name}",
            "ours": mine,
            "peer": peer,
            "peer_value": value,
            "ratio": None if value is None or mine == 0.0 else value / mine,
            "unit": "cost",
            "note": f"not installed: {missing[peer]}" if value is None else
            f"cost {mine:.3g} against {value:.3g}; {len(found)} seeds at "
            f"{int(np.median(spent))} simulations each: lower in {wins}, higher in {losses}; "
            f"load {os.getloadavg()[0]:.1f}",
        }  # fmt: skip


def _most(space: Space) -> float:
    """Return the largest cost within the bounds."""
    far = np.maximum(np.abs(space.low), np.abs(space.high))
    return float(space.cost(far[None])[0])


def _design(evaluator: Evaluator, seed: int) -> tuple[float, int]:
    """Return the least cost that ``design`` finds, and the number of machines that it simulates."""
    space, before, own = evaluator.space, evaluator.simulated, SEED + 100 * seed
    tried = first_sample(space, evaluator, _silent, own)
    tried = least_change(space, evaluator, tried, _silent, seed=own)
    costs = space.cost(tried.points)[tried.ratio <= 1.0]
    return float(costs.min(initial=np.inf)), evaluator.simulated - before


def _silent(_fraction: float) -> None:
    pass


def _cma(counted: _Counted, most: int, seed: int) -> float:
    import cma

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        start: dict[str, Any] = {"bounds": [0.0, 1.0], "seed": seed + 1, "verbose": -9}
        random = np.random.default_rng(seed)
        while counted.used < most:  # it ends early where it has converged, and starts again
            own = cma.CMAEvolutionStrategy(random.random(counted.dims), 0.3, start)
            while not own.stop() and counted.used < most:
                asked = np.array(own.ask())[: most - counted.used]
                if len(asked) < own.popsize:
                    counted.costs(asked)
                    break
                own.tell(list(asked), counted.costs(asked).tolist())
            start["seed"] += 1000
    return counted.least


def _differential(counted: _Counted, most: int, seed: int) -> float:
    from scipy.optimize import differential_evolution

    size = 8 * counted.dims
    search: Any = differential_evolution  # its types know no vectorized function
    search(
        lambda cube: counted.costs(np.atleast_2d(cube.T)),
        [(0.0, 1.0)] * counted.dims,
        maxiter=max(most // size - 1, 1),
        popsize=8,
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=seed,
    )
    return counted.least
