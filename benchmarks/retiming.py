"""The fastest motion beside toppra and copp-py, on the very same paths.

``retime vs toppra`` compares the reachability passes of ``motion/timing/profile.py`` with toppra's,
for the same rows of acceleration at the same grid points of a cubic spline through random points
of seven axes: the durations must be equal; ``retime vs copp`` does so with copp-py's, at 10 000
stations. ``optimal`` keeps its limits between the grid points, too, and can limit the jerk: beside
it stand copp-py's conic program of third order on small cases, for the duration, and one of its
linear programs at 10 000 stations, for the time. Each run is timed by its processor time: a
computer that does other work beside favours neither.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from time import process_time
from typing import Any

import numpy as np
from numba import njit

from benchmarks.planning import entry
from threadline.files import Stream
from threadline.motion.path.auto import auto_pieces
from threadline.motion.path.polygon import QUARTIC
from threadline.motion.path.types import PieceBlock, PlannedPath, ProgrammedPath, Timing
from threadline.motion.timing.optimal.fastest_motion import limited_blocks
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.profile import largest_end, largest_start
from threadline.motion.timing.retime import checked_points, path_through, vertex_blocks

POINTS, AXES = 50, 7
STATIONS = 10_000
WAYPOINTS = 100_000
TOLERANCE_M = 1e-4
MILLISECONDS = 15  # runs of what takes no longer, of ours and of a peer's alike
JERKS = (500.0, 50.0)
SMALL = ((200, 2.0), (500, 4.0))
"""Stations and parameter length of the small cases, on which copp-py's conic program ends."""
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
        *against_copp(),
        *smoothing(),
    ]  # fmt: skip


def against_toppra(knots: np.ndarray, points: np.ndarray, limits: Limits) -> list[dict[str, Any]]:
    path = splined(knots, points)
    ours_s, blocks = worked(lambda: list(limited_blocks(path, limits)))
    duration_s = blocks[-1].end_s
    count = sum(len(block) for block in blocks)
    note = f"{count} polynomials in time, as many grid points"
    on_grid = reachable_on(knots, points, limits, count)
    on_grid()
    grid_s, on_grid_s = worked(on_grid)
    names = ("retime vs toppra", "optimal without jerk vs toppra", "its duration vs toppra")
    try:
        solve, excess = toppra_on(knots, points, limits, count)
    except ImportError:
        values = ((grid_s, "s"), (ours_s, "s"), (duration_s, "s"))
        return [
            entry(name, value, None, None, unit, note)
            for name, (value, unit) in zip(names, values, strict=True)
        ]
    peer_s, peer_duration_s = worked(solve)
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


def worked(work: Callable[[], Any], times: int = 2) -> tuple[float, Any]:
    """Return the processor's seconds of ``work``, the least of some runs, and what it returns."""
    seconds = []
    for _ in range(times):
        begun = process_time()
        result = work()
        seconds.append(process_time() - begun)
    return min(seconds), result


def knots_of(stations: int, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the knots and points of a curve of three axes with as many stations."""
    t = np.linspace(0.0, length, stations + 1)
    return t / t[-1], np.stack([np.sin(t), np.cos(1.3 * t), 0.1 * t], axis=1)


def limits_of_three(jerk: float) -> Limits:
    """Return limits for the curve of ``knots_of``."""
    return Limits(velocity=np.full(3, 1.0), acceleration=np.full(3, 10.0), jerk=np.full(3, jerk))


def against_copp() -> list[dict[str, Any]]:
    """Compare with copp-py: second order on one grid, third order in duration and in time."""
    from scipy.interpolate import CubicSpline

    knots, points = knots_of(STATIONS, 40.0)
    grid = reachable_on(knots, points, limits_of_three(np.inf), len(knots))
    grid()
    grid_s, duration_s = worked(grid)
    whole_s, _ = worked(
        lambda: list(limited_blocks(splined(knots, points), limits_of_three(JERKS[0])))
    )
    names = ("retime vs copp", "jerk vs copp, one linear program", "jerk vs copp, duration")
    try:
        from benchmarks._copp_peer import Stations

        peer = Stations(CubicSpline(knots, points), knots, limits_of_three(np.inf))
    except ImportError:
        notes = (f"{STATIONS} stations", f"{STATIONS} stations, with jerk")
        return [
            entry(name, value, None, None, "s", f"{note}; copp-py is not installed")
            for name, value, note in zip(names, (grid_s, whole_s), notes, strict=False)
        ]
    peer_s, squared = worked(peer.second_order)
    differs = abs(duration_s / peer.duration_s(squared) - 1.0)
    third = Stations(CubicSpline(knots, points), knots, limits_of_three(JERKS[0]))
    begun = process_time()
    third.third_order("topp3_lp", 1)
    program_s = process_time() - begun
    found = [
        entry(
            names[0], grid_s, peer_s, peer_s / grid_s, "s",
            f"{STATIONS} stations; durations differ by {differs:.1e}",
        ),
        entry(
            names[1], whole_s, program_s, program_s / whole_s, "s",
            f"{STATIONS} stations, all of ours against one linear program of copp-py's",
        ),
    ]  # fmt: skip
    for stations, length in SMALL:
        knots, points = knots_of(stations, length)
        for jerk in JERKS:
            limits = limits_of_three(jerk)
            ours_s = list(limited_blocks(splined(knots, points), limits))[-1].end_s
            peers_s = min(
                Stations(CubicSpline(knots, points), knots, limits).third_order("topp3_socp", 4)
            )
            found.append(entry(
                f"{names[2]}, {stations} stations, jerk {jerk:g}",
                ours_s, peers_s, peers_s / ours_s, "s",
                "its conic program four times, limits at its stations; ours everywhere",
            ))  # fmt: skip
    return found


def smoothing() -> list[dict[str, Any]]:
    """Time paths through many waypoints, from their array to the last piece.

    First 4 mm apart, a piece for each, within 0.1 mm as a CAM program or a probe writes them; then
    0.1 mm apart, by chords, as ``retime`` passes them. copp-py's own curve of 10 000 points is
    fitted twice: within 0.001, as its examples do, beside ours of the same points, and within
    1e-4, as a test of its own does, beside our 100 000 points 0.1 mm apart.
    """
    few, its, chords = WAYPOINTS // 10, noisy_curve(10_000), "smoothing by chords vs copp fit"
    points = dense(WAYPOINTS)
    return [
        smoothed("smoothing vs copp fit", noisy(WAYPOINTS, 400.0), noisy(few, 40.0), thin=False),
        smoothed(chords, points, dense(few)),
        smoothed(f"{chords}, its own curve within 0.001", its, its, 1e-3, 1e-3),
        smoothed(f"{chords} of its own curve within 1e-4", points, its),
    ]


def smoothed(
    name: str, points: np.ndarray, few: np.ndarray, ours_within: float = TOLERANCE_M,
    its_within: float = TOLERANCE_M, *, thin: bool = True,
) -> dict[str, Any]:  # fmt: skip
    """Return the entry of waypoints of ours; copp-py fits a ``few``."""

    def ours() -> int:
        places = checked_points(points)
        blocks = path_through(places, ours_within).blocks if thin else followed(places)
        return sum(len(block) for block in blocks)

    ours()
    seconds, count = worked(ours, MILLISECONDS)
    note = f"{len(points)} waypoints within {ours_within:g}, {count} pieces"
    try:
        from benchmarks._copp_peer import fitted

        peer_s, fit = worked(fitted(few, its_within), MILLISECONDS)
    except ImportError:
        return entry(name, seconds, None, None, "s", f"{note}; copp-py is not installed")
    ours_us, peer_us = 1e6 * seconds / len(points), 1e6 * peer_s / len(few)
    note += f"; its {len(few)} within {its_within:g}, {fit.smoothing_report.segments} pieces"
    return entry(name, ours_us, peer_us, peer_us / ours_us, "us", f"per waypoint; {note}")


def followed(places: np.ndarray) -> Iterator[PieceBlock]:
    """Yield the pieces of a path along every one of the places, as jobs are followed."""
    programmed = ProgrammedPath(
        axes=("X", "Y", "Z"), radius_m=np.ones(3), blocks=Stream(vertex_blocks, places, None)
    )
    return auto_pieces(programmed, 0.99 * TOLERANCE_M, 0.01 * TOLERANCE_M, degree=QUARTIC)


def noisy_curve(count: int) -> np.ndarray:
    """Return the curve of copp-py's examples: 10 long, each point up to 0.0002 beside it."""
    s = np.linspace(0.0, 1.0, count)
    points = np.stack([10 * s, np.sin(2 * np.pi * s), 0.3 * np.cos(4 * np.pi * s)], axis=1)
    points[1:-1] += np.random.default_rng(3).uniform(-2e-4, 2e-4, (count - 2, 3))
    return points


def dense(count: int) -> np.ndarray:
    """Return waypoints 0.1 mm apart on a curve, each up to 2 um beside it along each axis."""
    t = 2e-4 * np.arange(count)
    points = np.stack([0.3 * np.sin(t), 0.3 * np.cos(1.3 * t), 0.1 * np.sin(2.1 * t)], axis=1)
    beside = np.random.default_rng(3).uniform(-2e-6, 2e-6, points.shape)
    return np.asarray(points + beside)


def noisy(count: int, length: float) -> np.ndarray:
    """Return waypoints on a curve, each up to 0.02 mm beside it along each axis."""
    t = np.linspace(0.0, length, count)
    points = np.stack([np.sin(t), np.cos(1.3 * t), 0.1 * t], axis=1)
    beside = np.random.default_rng(3).uniform(-2e-5, 2e-5, points.shape)
    return np.asarray(points + beside)
