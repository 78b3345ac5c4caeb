"""Duration against contour error: ``python -m tools.duration_against_contour [JOB ...]``.

One figure a job into ``docs/pictures``, at level nominal, on the winder as built. Every method is
turned from slow to fast by what slows it: its feed, a share of the limits, or the contour and the
tolerance that it is allowed. The planners of others are built here from their formulas: Klipper's
junction deviation and LinuxCNC's blends on the chords, and toppra's fastest run along a spline
through the points. All are followed by the motors but for those that say feed-forward. Where
toppra is not installed nothing is drawn, but for ``--without-toppra`` (``make bench`` makes
``.venv-bench``, which has it).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from threadline.commands.plan import Plan
from threadline.commands.ticks import compile_ticks
from threadline.errors import LimitError
from threadline.files import Stream
from threadline.jobs import Job, read_job
from threadline.machine import Machine, load_machine
from threadline.machine.vary import derate
from threadline.motion.path import programmed_path
from threadline.motion.timing import Trajectory, TrajectoryBlock
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, prove_plan
from threadline.report.style import LIMIT, figure_style
from threadline.verdict import load_spec

ROOT = Path(__file__).resolve().parent.parent
JOBS = ("cone-dome-cylinder", "x-180")
FREE = parse_feed("1000 count/tick")
FEEDS = (10, 20, 40, 80, 160, 320, 640)  # counts per tick
SHARES = (1.0, 0.5, 0.25, 0.125, 0.06, 0.03, 0.015, 0.0075)
TOLERANCES_M = (4e-4, 2e-4, 1e-4, 5e-5, 2e-5)
CONTOURS_M = (2e-5, 5e-5, 1e-4, 2e-4, 3e-4, 4.5e-4, 7e-4, 1.5e-3, np.inf)
STEP_S = 1e-3
Sampled = tuple[np.ndarray, np.ndarray]  # positions every STEP_S, and of which chord
LOOKS = ("o-", "s-", "^-", "v-", "D-", "x--", "+--", "*--", "P:", "h:")


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tools.duration_against_contour", description=__doc__
    )
    parser.add_argument("job", nargs="*", metavar="JOB", help=f"of {', '.join(JOBS)}; else all")
    parser.add_argument("--without-toppra", action="store_true", help="leave its curve out")
    asked = parser.parse_args()
    if unknown := set(asked.job) - set(JOBS):
        parser.error(f"no job {', '.join(sorted(unknown))}; there are {', '.join(JOBS)}")
    if find_spec("toppra") is None and not asked.without_toppra:
        parser.error("toppra is not installed here; its curve is left out by --without-toppra")
    machine = load_machine("lathe-winder")
    with figure_style():
        for name in asked.job or JOBS:
            job = read_job(ROOT / "examples" / f"{name}.prg", machine)
            found = curves(job, machine, toppra=not asked.without_toppra)
            draw(name, {method: list(points) for method, points in found})


def curves(
    job: Job, machine: Machine, *, toppra: bool
) -> Iterator[tuple[str, Iterator[tuple[float, float]]]]:
    """Yield the name of a method and its points: duration in s, contour error in m."""
    for name in ("linear", "b-spline"):
        feeds = [parse_feed(f"{feed} count/tick") for feed in FEEDS]
        yield name, proved(job, machine, [Options(interpolation=name, feed=f) for f in feeds])
    for name in ("parabolic", "auto"):
        ladder = [Options(interpolation=name, feed=FREE, limit_share=s) for s in SHARES]
        yield name, proved(job, machine, ladder)
    others: dict[str, Callable[[np.ndarray, Machine], Sampled]] = {
        "Klipper's corners": klipper,
        "LinuxCNC's blends": linuxcnc,
    }
    if toppra:
        others["toppra, spline"] = through_spline
    for name, timed in others.items():
        yield name, made(job, machine, timed)
    own = Options(interpolation="optimal", feed=FREE)
    ladder = [replace(own, contour_m=c, tolerance_m=min(1e-4, c)) for c in CONTOURS_M]
    yield "optimal", proved(job, machine, ladder)
    ahead = replace(own, feed_forward_s=0.01)
    ladder = [replace(ahead, tolerance_m=t) for t in TOLERANCES_M]
    ladder += [replace(ahead, tolerance_m=TOLERANCES_M[-1], limit_share=s) for s in SHARES[1:4]]
    yield "optimal, feed-forward", proved(job, machine, ladder)


def proved(job: Job, machine: Machine, ladder: list[Options]) -> Iterator[tuple[float, float]]:
    for options in ladder:
        try:
            plan = plan_job(job, machine, options)
        except LimitError:
            continue  # what smooths it breaks a limit: no motion at this rung
        begin_s, end_s = plan.motion.moving_s
        yield end_s - begin_s, contour_m(plan, machine)


def contour_m(plan: Plan, machine: Machine) -> float:
    error = prove_plan(plan, load_spec(None, machine)).verdict.result("contour_error").measured
    return np.nan if error is None else error


def made(
    job: Job, machine: Machine, timed: Callable[[np.ndarray, Machine], Sampled]
) -> Iterator[tuple[float, float]]:
    """Yield what a planner of others makes of the vertices, at shares of the acceleration."""
    plan = plan_job(job, machine, Options(interpolation="linear"))
    programmed = programmed_path(job, machine)
    points = np.concatenate([block.positions for block in programmed])
    owner = np.concatenate([block.operation for block in programmed])
    moved = np.concatenate([[True], np.abs(np.diff(points, axis=0)).max(axis=1) > 0.0])
    points, owner = points[moved], owner[moved]
    for share in SHARES:
        place, chord = timed(points, derate(machine, share))
        block = TrajectoryBlock(
            start_s=STEP_S * np.arange(len(place) - 1, dtype=np.float64),
            duration_s=np.full(len(place) - 1, STEP_S),
            coefficients=np.stack([place[:-1], np.diff(place, axis=0)], axis=1),
            operation=owner[chord[:-1] + 1],
        )
        motion = Trajectory(axes=programmed.axes, historical=True, blocks=Stream.of([block]))
        intent = replace(plan.motion, trajectory=motion, timed=None)
        commands = compile_ticks(motion, machine, job)
        yield block.end_s, contour_m(replace(plan, intent=intent, commands=commands), machine)


def chords(
    points: np.ndarray, machine: Machine
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return lengths at the tool, directions, and the speed and acceleration of each chord."""
    way = np.diff(points, axis=0) * machine.radius_m
    length = np.linalg.norm(way, axis=1)
    unit = way / length[:, None]
    with np.errstate(divide="ignore"):
        part = 1.0 / np.abs(unit)
        speed = (machine.velocity_limit * machine.radius_m * part).min(axis=1)
        push = (machine.acceleration_limit * machine.radius_m * part).min(axis=1)
    return length, unit, speed, push


def klipper(points: np.ndarray, machine: Machine) -> Sampled:
    """Junction deviation at 5 mm/s through square corners, and its two passes (toolhead.py)."""
    length, unit, speed, push = chords(points, machine)
    count = len(length)
    most = np.zeros(count + 1)  # squared, at the vertices
    for k in range(1, count):
        cosine = -float(unit[k - 1] @ unit[k])
        half_sine, half_cosine = np.sqrt(0.5 * (1 - cosine)), np.sqrt(0.5 * (1 + cosine))
        top = min(speed[k - 1], speed[k]) ** 2
        if half_cosine > 1e-9:
            deviation = 5e-3**2 * (np.sqrt(2.0) - 1.0) / min(push[k - 1], push[k])
            radius = half_sine / max(1.0 - half_sine, 1e-12)
            own = [
                min(radius * deviation, 0.5 * length[i] * half_sine / half_cosine) * push[i]
                for i in (k - 1, k)
            ]
            top = min(top, *own)
        most[k] = top if cosine < 0.999999 else 0.0
    for k in range(count - 1, -1, -1):
        most[k] = min(most[k], most[k + 1] + 2 * push[k] * length[k])
    for k in range(count):
        most[k + 1] = min(most[k + 1], most[k] + 2 * push[k] * length[k])
    gone, chord = [np.zeros(1)], [np.zeros(1, dtype=np.int64)]
    rest_s, start = 0.0, 0.0
    for k in range(count):
        v0, v1 = np.sqrt(most[k]), np.sqrt(most[k + 1])
        top = min(speed[k], np.sqrt(push[k] * length[k] + 0.5 * (v0**2 + v1**2)))
        up, down = (top - v0) / push[k], (top - v1) / push[k]
        even = max(length[k] - 0.5 * (v0 + top) * up - 0.5 * (v1 + top) * down, 0.0) / top
        whole = up + even + down
        t = np.arange(STEP_S - rest_s, whole, STEP_S)
        left = whole - t
        way = np.where(
            t < up,
            (v0 + 0.5 * push[k] * t) * t,
            np.where(
                t < up + even,
                0.5 * (v0 + top) * up + top * (t - up),
                length[k] - (v1 + 0.5 * push[k] * left) * left,
            ),
        )
        gone.append(start + way)
        chord.append(np.full(len(t), k))
        start += length[k]
        rest_s = whole - t[-1] if len(t) else rest_s + whole
    ends = np.concatenate([[0.0], np.cumsum(length)])
    at, of = np.append(np.concatenate(gone), start), np.append(np.concatenate(chord), count - 1)
    return np.stack([np.interp(at, ends, axis) for axis in points.T], axis=1), of


def linuxcnc(points: np.ndarray, machine: Machine) -> Sampled:
    """G64 P0.1: the end of a chord's trapezoid runs beside the beginning of the next (tp.c)."""
    length, unit, speed, push = chords(points, machine)
    count = len(length)
    # Beside each other two chords may ask for both accelerations: half is for each.
    push = 0.5 * push
    top = np.minimum(speed, np.sqrt(push * length))
    start, overlap = np.zeros(count), 0.0
    duration = length / top + top / push
    for k in range(1, count):
        cosine = np.cos(0.5 * np.arccos(np.clip(-float(unit[k - 1] @ unit[k]), -1.0, 1.0)))
        both = min(push[k - 1], push[k])
        blend = 2.0 * np.sqrt(both * 1e-4 / cosine) if cosine > 1e-9 else np.inf
        overlap = min(blend / both, top[k - 1] / push[k - 1], top[k] / push[k], 0.5 * duration[k])
        start[k] = start[k - 1] + duration[k - 1] - overlap
    t = np.arange(0.0, start[-1] + duration[-1] + STEP_S, STEP_S)
    place = np.tile(points[0], (len(t), 1))
    for k in range(count):
        now = np.clip(t - start[k], 0.0, duration[k])
        left, ramp = duration[k] - now, top[k] / push[k]
        way = np.where(
            now < ramp,
            0.5 * push[k] * now**2,
            np.where(left > ramp, top[k] * (now - 0.5 * ramp), length[k] - 0.5 * push[k] * left**2),
        )
        place += way[:, None] / length[k] * (points[k + 1] - points[k])
    return place, np.searchsorted(start, t, side="right") - 1


def through_spline(points: np.ndarray, machine: Machine) -> Sampled:
    """The fastest run of toppra along a cubic spline through the points."""
    import toppra
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

    toppra.setup_logging("ERROR")
    length, _, _, _ = chords(points, machine)
    knots = np.concatenate([[0.0], np.cumsum(length)]) / length.mean()
    path = toppra.SplineInterpolator(knots, points)
    v, a = machine.velocity_limit, machine.acceleration_limit
    grid = np.linspace(0.0, knots[-1], 30 * len(points))
    solver = TOPPRA(
        [
            JointVelocityConstraint(np.stack([-v, v], axis=1)),
            JointAccelerationConstraint(np.stack([-a, a], axis=1)),
        ],
        path,
        gridpoints=grid,
        solver_wrapper="seidel",
    )
    _, speed, _ = solver.compute_parameterization(0.0, 0.0)
    when = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(grid) / (speed[1:] + speed[:-1]))])
    s = np.append(np.interp(np.arange(0.0, when[-1], STEP_S), when, grid), knots[-1])
    return path(s), np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(length) - 1)


def draw(name: str, found: dict[str, list[tuple[float, float]]]) -> None:
    figure = Figure(figsize=(7.2, 5.2))
    panel = figure.subplots()
    for (method, points), look in zip(found.items(), LOOKS, strict=False):
        seconds, metres = np.array(points).T
        print(name, method, np.round(seconds, 3).tolist(), np.round(metres * 1e3, 3).tolist())
        grey = {"color": "black"} if method.startswith("optimal") else {"linewidth": 0.9}
        panel.loglog(metres * 1e3, seconds, look, label=method, markersize=4.5, **grey)
    panel.axvline(0.5, label="limit 0.5 mm", **LIMIT)
    panel.set_xlabel("contour error, simulated [mm]")
    panel.set_ylabel("duration [s]")
    panel.set_title(f"{name} on lathe-winder: duration against contour error (nominal)")
    panel.legend(fontsize=7, ncols=2)
    file = ROOT / "docs" / "pictures" / f"duration-contour-{name}.png"
    figure.savefig(file, dpi=130, metadata={"Software": None})
    print(file.relative_to(ROOT))


if __name__ == "__main__":
    main()
