"""Planning beside toppra: how near to time-optimal, and how fast.

toppra follows the very path that ``auto`` planned for the cone-dome-cylinder program at 0.1 mm,
within the limits of velocity and acceleration alone, on a fine grid: a lower bound that nothing
can reach that also keeps the jerk limits and the tolerance between path and motion, as ours does.
The programmed feed is left out, or it alone would decide. Both planning times start with that
path; compiled code and toppra's set-up of the grid are ready before the clock runs.

The other entries are rates without a peer, on a generated job of straight moves with three axes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from threadline.files import Stream
from threadline.jobs import read_job
from threadline.jobs.operations import Feed, FeedMode, Job, MoveRun, Operation, OperationStream
from threadline.machine import load_machine
from threadline.motion.path import PlannedPath, path_deviation, plan_path, programmed_path
from threadline.motion.timing import plan_trajectory

MACHINE = load_machine("lathe-winder")
EXAMPLE = Path(__file__).parent.parent / "examples" / "cone-dome-cylinder.prg"
AS_FAST_AS_THE_LIMITS = Feed(FeedMode.INVERSE_TIME, 1e6)
MOVES = 200_000
GRID = 20  # points of toppra per piece
REPEATS = 5


def run() -> list[dict[str, Any]]:
    """Return the entries of this comparison."""
    return [*against_toppra(), *rates()]


def against_toppra() -> list[dict[str, Any]]:
    job = read_job(EXAMPLE, MACHINE)
    moves = sum(1 for _ in job)
    path = plan_path(programmed_path(job, MACHINE, AS_FAST_AS_THE_LIMITS), MACHINE, "auto")
    path = replace(path, blocks=Stream.of(path))  # planned once, for both
    ours_s, duration_s = timed(lambda: plan_trajectory(path, MACHINE).duration_s)
    peer_s: float | None = None
    bound_s: float | None = None
    with suppress(ImportError):
        peer_s, bound_s = timed(follower(path))
    deviation = path.summary["largest_deviation_m"] * 1e3
    return [
        entry(
            "duration of cone-dome-cylinder at 0.1 mm vs toppra",
            duration_s, bound_s, None if bound_s is None else bound_s / duration_s, "s",
            f"ours also keeps the jerk limits; path within {deviation:.3f} mm",
        ),
        entry(
            "planning rate of cone-dome-cylinder vs toppra",
            moves / ours_s, None if peer_s is None else moves / peer_s,
            None if peer_s is None else peer_s / ours_s, "move/s",
            f"toppra with {GRID} grid points per piece and its compiled solver",
        ),
    ]  # fmt: skip


def follower(path: PlannedPath) -> Callable[[], float]:
    """Return toppra's run along ``path``; it returns the duration."""
    import toppra
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

    toppra.setup_logging("ERROR")
    c = np.concatenate([block.coefficients for block in path])
    leaving = (c * np.arange(4)[None, :, None]).sum(axis=1) * path.radius_m
    ratio = np.linalg.norm(c[1:, 1] * path.radius_m, axis=1) / np.linalg.norm(leaving[:-1], axis=1)
    # The path is smooth in this parameter, metres at the tool; in others toppra's solver gives up.
    size = np.linalg.norm(c[0, 1] * path.radius_m)
    span = size * np.concatenate([[1.0], np.cumprod(ratio)])
    knots = np.concatenate([[0.0], np.cumsum(span)])

    class Pieces(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
        dof = c.shape[2]
        path_interval = np.array([0.0, knots[-1]])
        waypoints = None

        def __call__(self, s: Any, order: int = 0) -> Any:
            s = np.atleast_1d(s)
            i = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(c) - 1)
            u, h, a = ((s - knots[i]) / span[i])[:, None], span[i][:, None], c[i]
            if order == 0:
                return a[:, 0] + u * (a[:, 1] + u * (a[:, 2] + u * a[:, 3]))
            if order == 1:
                return (a[:, 1] + u * (2 * a[:, 2] + u * 3 * a[:, 3])) / h
            return (2 * a[:, 2] + 6 * u * a[:, 3]) / h**2

    # Finer near the ends of straight pieces, where the speed changes.
    even = np.linspace(0, 1, GRID + 1)
    ends = (1 - np.cos(np.linspace(0, np.pi, 4 * GRID + 1))) / 2
    straight = np.all(c[:, 2:] == 0, axis=(1, 2))
    parts = [
        begin + (ends if line else even)[:-1] * length
        for begin, length, line in zip(knots, span, straight, strict=False)
    ]
    grid = np.append(np.concatenate(parts), knots[-1])
    column = [MACHINE.axis_names.index(axis) for axis in path.axes]
    v, a = MACHINE.velocity_limit[column], MACHINE.acceleration_limit[column]
    limits = [
        JointVelocityConstraint(np.stack([-v, v], axis=1)),
        JointAccelerationConstraint(np.stack([-a, a], axis=1)),
    ]
    solver = TOPPRA(limits, Pieces(), gridpoints=grid, solver_wrapper="seidel")

    def duration_s() -> float:
        _, speed, _ = solver.compute_parameterization(0.0, 0.0)
        return float((2 * np.diff(grid) / (speed[1:] + speed[:-1])).sum())

    return duration_s


def rates() -> list[dict[str, Any]]:
    job = generated(MOVES)
    results = []
    feed = Feed(FeedMode.FASTEST_AXIS, 0.3)
    seconds, _ = timed(lambda: sum(len(block) for block in programmed_path(job, MACHINE, feed)), 2)
    results.append(rate("programmed path", seconds, "moves as arrays -> vertices and times"))
    programmed = programmed_path(job, MACHINE, feed)
    programmed = replace(programmed, blocks=Stream.of(programmed))
    for name in ("linear", "b-spline", "b-spline-pulled", "parabolic", "cubic", "quintic", "auto"):
        path = plan_path(programmed, MACHINE, name)
        trajectory = plan_trajectory(path, MACHINE)

        def whole(name: str = name) -> float:
            return plan_trajectory(plan_path(programmed, MACHINE, name), MACHINE).duration_s

        seconds, duration_s = timed(whole, 2)
        pieces = sum(len(block) for block in trajectory)
        note = f"path and trajectory: {pieces} pieces in time, {duration_s:,.0f} s of motion"
        results.append(rate(name, seconds, note))
    path = plan_path(programmed, MACHINE, "auto")
    seconds, _ = timed(lambda: path_deviation(programmed, path).at_tool_m, 1)
    results.append(rate("path deviation of auto, planning included", seconds, ""))
    return results


def generated(moves: int) -> Job:
    """Return a job of 4 mm moves at the tool along a curve of three axes."""
    t = np.arange(1, moves + 1)
    targets = np.stack(
        [0.03 * t, 0.3 * np.sin(0.01 * t), 0.1 + 0.1 * np.sin(0.013 * t + 0.2)], axis=1
    )
    operations: Stream[Operation] = OperationStream(Stream(runs_to, targets))
    start = (0.0, 0.0, 0.1 + 0.1 * float(np.sin(0.2)))
    return Job(
        name="generated", file="generated", sha256="", axes=("A", "X", "Y"), start=start,
        operations=operations,
    )  # fmt: skip


def runs_to(targets: np.ndarray) -> Iterator[MoveRun]:
    """Yield the moves to ``targets``, 4096 at a time."""
    for first in range(0, len(targets), 4096):
        part = targets[first : first + 4096]
        line = np.arange(first + 1, first + 1 + len(part))
        yield MoveRun(part, line, ((0, AS_FAST_AS_THE_LIMITS),), "generated", ())


def timed(work: Callable[[], Any], repeats: int = REPEATS) -> tuple[float, Any]:
    """Return the least time of some repetitions after a first one, and the result."""
    result = work()
    best = np.inf
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - began)
    return best, result


def rate(name: str, seconds: float, note: str) -> dict[str, Any]:
    return entry(f"planning, {name}", MOVES / seconds, None, None, "move/s", note)


def entry(
    name: str, ours: float, peer: float | None, ratio: float | None, unit: str, note: str
) -> dict[str, Any]:
    values = f"{ours:,.4g} {unit}" if peer is None else f"{ours:,.4g} against {peer:,.4g} {unit}"
    return {
        "name": name,
        "ours": ours,
        "peer": name.rpartition(" vs ")[2] if " vs " in name else None,
        "peer_value": peer,
        "ratio": ratio,
        "unit": unit,
        "note": f"{values}; {note}" if note else values,
    }
