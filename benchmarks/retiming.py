"""The fastest motion beside toppra and copp-py, on the very same paths.

``retime vs toppra`` compares the reachability passes of ``trajectory/profile.py`` with toppra's,
for the same rows of acceleration at the same grid points of a cubic spline through random points
of seven axes: the durations must be equal. ``optimal`` keeps its limits between the grid points,
too, and can limit the jerk; what that takes stands beside it, and copp-py where it is installed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

from benchmarks.planning import entry, timed
from threadline.path.auto import auto_pieces
from threadline.path.types import PieceBlock, PlannedPath, ProgrammedPath, Timing
from threadline.signals import Stream
from threadline.trajectory.optimal import Limits
from threadline.trajectory.optimal.fastest_motion import limited_blocks
from threadline.trajectory.profile import largest_end, largest_start
from threadline.trajectory.retime import _vertices

POINTS, AXES = 50, 7
STATIONS = 10_000
WAYPOINTS = 100_000
TOLERANCE_M = 1e-4
GAP_GRID = 20  # places between two grid points at which toppra's accelerations are looked at


def run() -> list[dict[str, Any]]:
    """Return the entries of this comparison."""
    random = np.random.RandomState(1)
    points = random.randn(POINTS, AXES)
    velocity, acceleration = 10 + random.rand(AXES) * 20, 10 + random.rand(AXES) * 2
    knots = np.arange(float(POINTS))  # toppra stops at 1e-9 of the square of the speed
    return [
        *against_toppra(knots, points, Limits(
            velocity=velocity, acceleration=acceleration, jerk=np.full(AXES, np.inf)
        )),
        without_peer("retime vs copp", stations(np.inf), "velocity and acceleration"),
        without_peer("jerk vs copp", stations(500.0), "velocity, acceleration and jerk"),
        smoothing(),
    ]  # fmt: skip


def against_toppra(knots: np.ndarray, points: np.ndarray, limits: Limits) -> list[dict[str, Any]]:
    path = splined(knots, points)
    ours_s, blocks = timed(lambda: list(limited_blocks(path, limits)), 3)
    duration_s = blocks[-1].end_s
    count = sum(len(block) for block in blocks)
    note = f"{count} polynomials in time, as many grid points"
    grid_s, on_grid_s = timed(reachable_on(knots, points, limits, count), 3)
    names = ("retime vs toppra", "optimal without jerk vs toppra", "its duration vs toppra")
    try:
        solve, excess = toppra_on(knots, points, limits, count)
    except ImportError:
        values = ((grid_s, "s"), (ours_s, "s"), (duration_s, "s"))
        return [
            entry(name, value, None, None, unit, note)
            for name, (value, unit) in zip(names, values, strict=True)
        ]
    peer_s, peer_duration_s = timed(solve, 3)
    differs = abs(on_grid_s / peer_duration_s - 1.0)
    return [
        entry(
            names[0], grid_s, peer_s, peer_s / grid_s, "s",
            f"{count} grid points; durations differ by {differs:.1e}",
        ),
        entry(names[1], ours_s, peer_s, peer_s / ours_s, "s", note),
        entry(
            names[2], duration_s, peer_duration_s, peer_duration_s / duration_s, "s",
            f"toppra's acceleration is {excess():.2f} of its limit between its grid points",
        ),
    ]  # fmt: skip


def reachable_on(
    knots: np.ndarray, points: np.ndarray, limits: Limits, grid: int
) -> Callable[[], float]:
    """Return a run of our reachability passes with toppra's rows: those at each grid point."""
    from scipy.interpolate import CubicSpline

    spline, places = CubicSpline(knots, points), np.linspace(0.0, knots[-1], grid)
    first, second = spline(places, 1), spline(places, 2)
    most = ((limits.velocity / np.abs(first)) ** 2).min(axis=1)

    def duration_s() -> float:
        squared = _passes(first, second, most, limits.acceleration, places[1] - places[0])
        speed = np.sqrt(squared)
        return float((2 * np.diff(places) / (speed[1:] + speed[:-1])).sum())

    return duration_s


@njit(cache=True)
def _passes(first, second, most, limit, step):  # type: ignore[no-untyped-def]
    """Return the (n,) largest squares of the speed along the grid, from rest to rest."""
    count, axes = first.shape
    reach = np.empty(count)
    reach[count - 1] = 0.0
    own, after = np.empty(axes), np.empty(axes)
    for i in range(count - 2, -1, -1):
        for j in range(axes):
            after[j] = first[i, j] / (2.0 * step)
            own[j] = second[i, j] - after[j]
        reach[i] = largest_start(own, after, limit, reach[i + 1], most[i])
    out = np.zeros(count)
    for i in range(count - 1):
        for j in range(axes):
            after[j] = first[i, j] / (2.0 * step)
            own[j] = second[i, j] - after[j]
        out[i + 1] = largest_end(own, after, limit, out[i], reach[i + 1])
    return out


def toppra_on(
    knots: np.ndarray, points: np.ndarray, limits: Limits, grid: int
) -> tuple[Callable[[], float], Callable[[], float]]:
    """Return toppra's run, which returns its duration, and its largest share of acceleration."""
    import toppra
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

    toppra.setup_logging("ERROR")
    path = toppra.SplineInterpolator(knots, points)
    places = np.linspace(0.0, knots[-1], grid)
    v, a = limits.velocity, limits.acceleration
    solver = TOPPRA(
        [
            JointVelocityConstraint(np.stack([-v, v], axis=1)),
            JointAccelerationConstraint(
                np.stack([-a, a], axis=1), toppra.constraint.DiscretizationType.Collocation
            ),
        ],
        path,
        gridpoints=places,
        solver_wrapper="seidel",
    )

    def solve() -> float:
        _, speed, _ = solver.compute_parameterization(0.0, 0.0)
        return float((2 * np.diff(places) / (speed[1:] + speed[:-1])).sum())

    def excess() -> float:
        push, speed, _ = solver.compute_parameterization(0.0, 0.0)
        worst = 0.0
        for share in np.arange(GAP_GRID) / GAP_GRID:
            s = places[:-1] + share * np.diff(places)
            squared = speed[:-1] ** 2 + share * (speed[1:] ** 2 - speed[:-1] ** 2)
            asked = path(s, 2) * squared[:, None] + path(s, 1) * push[: len(s), None]
            worst = max(worst, float((np.abs(asked) / a).max()))
        return worst

    return solve, excess


def splined(knots: np.ndarray, points: np.ndarray) -> PlannedPath:
    """Return the cubic spline that toppra puts through points, as a path."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(knots, points)
    span = np.diff(knots)[:, None]
    c = np.stack([spline.c[3 - k] * span**k for k in range(4)], axis=1)
    count = len(c)
    rest = np.zeros(count, dtype=np.int64)
    rest[-1] = 1
    block = PieceBlock(
        coefficients=c,
        operation=np.arange(count),
        nominal_s=np.zeros(count),
        rest_after=rest,
        dwell_s=np.zeros(count),
        line=np.zeros(count, dtype=np.int64),
    )
    return PlannedPath(
        axes=tuple(str(k) for k in range(points.shape[1])),
        radius_m=np.ones(points.shape[1]),
        interpolation="optimal",
        timing=Timing.FASTEST,
        historical=False,
        blocks=Stream.of([block]),
    )


def stations(jerk: float) -> float:
    """Return the seconds that a path of ``STATIONS`` pieces takes."""
    t = np.linspace(0.0, 40.0, STATIONS + 1)
    points = np.stack([np.sin(t), np.cos(1.3 * t), 0.1 * t], axis=1)
    path = splined(t / t[-1], points)
    limits = Limits(velocity=np.full(3, 1.0), acceleration=np.full(3, 10.0), jerk=np.full(3, jerk))
    seconds, _ = timed(lambda: list(limited_blocks(path, limits)), 2)
    return seconds


def without_peer(name: str, seconds: float, what: str) -> dict[str, Any]:
    note = f"{STATIONS} stations, {what}; copp-py is in no registry that was at hand"
    return entry(name, seconds, None, None, "s", note)


def smoothing() -> dict[str, Any]:
    """Time a path through many waypoints: a noisy curve, as a CAM program writes it."""
    random = np.random.default_rng(3)
    t = np.linspace(0.0, 400.0, WAYPOINTS)
    points = np.stack([np.sin(t), np.cos(1.3 * t), 0.1 * t], axis=1)
    points += random.uniform(-2e-5, 2e-5, points.shape)
    programmed = ProgrammedPath(
        axes=("X", "Y", "Z"), radius_m=np.ones(3), blocks=Stream.of([_vertices(points)])
    )
    seconds, count = timed(
        lambda: sum(
            len(b) for b in auto_pieces(programmed, 0.99 * TOLERANCE_M, 0.01 * TOLERANCE_M)
        ),
        2,
    )
    return entry(
        "smoothing vs copp fit", seconds, None, None, "s",
        f"{WAYPOINTS} waypoints at 0.1 mm, {count} pieces; copp-py is in no registry at hand",
    )  # fmt: skip
