"""Random paths: each is planned within every limit and no slower than by ``auto``, or refused.

``python -m tools.random_paths [COUNT] [FIRST]`` runs the cases FIRST, FIRST + 1, ... Each case is
drawn from its own number, so that a case that fails is run again alone: ``... 1 NUMBER``. Half of
the cases are planned on a machine by ``optimal`` and by ``auto``; the others go through ``retime``,
with spans from 1e-9 to 1e6 m in one path, and one in five of these has something that is no path
or no limit. The exit code is 1 where a case failed.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections import Counter
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from threadline.errors import BudgetError, ThreadlineError
from threadline.files import Stream
from threadline.machine import Machine, load_machine
from threadline.machine.model import Drive
from threadline.machine.parts import DcMotor
from threadline.machine.quantity import Quantity
from threadline.motion.path import plan_path
from threadline.motion.path.runs import COINCIDENT_M
from threadline.motion.path.types import ProgrammedPath, VertexBlock
from threadline.motion.timing import limit_peaks, plan_trajectory
from threadline.motion.timing.extremes import derivatives, farthest
from threadline.motion.timing.retime import retime

ALLOWED = 1.001  # of a limit, anywhere
SLOWER = 1e-9  # of the duration: rounding
AXES = ("X", "Y", "A")
SHORT = 0.9  # of the cases: few points each, of every kind
TICKS = 20_000.0  # what a case on a machine may take: ``auto`` works tick by tick
HOSTILE = (0.0, -1.0, np.nan, np.inf, -np.inf, 1e300, 5e-324)


@dataclass
class Tally:
    """What became of the cases."""

    counted: Counter[str]
    failed: list[str]
    worst: float = 0.0
    slowest: float = 0.0

    def fail(self, number: int, what: str) -> None:
        """Take a case into the failures."""
        self.failed.append(f"case {number}: {what}")
        print(self.failed[-1], flush=True)


def _with(quantity: Quantity | None, si: float) -> Quantity:
    assert quantity is not None
    return replace(quantity, si=si)


def drawn_points(random: np.random.Generator, axes: int, scales: np.ndarray) -> np.ndarray:
    """Return (n, axes) places: any steps, tiny ones, none, reversals, single axes, arcs, noise."""
    place = np.zeros(axes)
    places = [place]
    moving = random.random(axes) < 0.85
    if not moving.any():
        moving[random.integers(axes)] = True
    short = random.random() < SHORT
    for _ in range(int(random.choice([1, 1, 1, 2, 2, 3] if short else [1, 1, 2, 2, 3, 4, 6]))):
        kind = random.choice(["any", "any", "any", "tiny", "repeat", "back", "one", "arc", "noise"])
        scale = float(random.choice(scales))
        step = random.uniform(-1.0, 1.0, axes) * scale * moving
        if kind == "tiny":
            step = step * 10.0 ** random.uniform(-9.0, -2.0)
        elif kind == "repeat":
            step = np.zeros(axes)
        elif kind == "back" and len(places) > 1:
            step = places[-2] - place
        elif kind == "one":
            step = step * (np.arange(axes) == random.integers(axes))
        elif kind in ("arc", "noise") and axes > 1:
            t = np.linspace(0.0, random.uniform(0.2, 7.0), 5 if short else 8)[1:]
            more = np.zeros((len(t), axes))
            more[:, 0], more[:, 1] = scale * np.sin(t), scale * (1.0 - np.cos(t))
            if kind == "noise":
                more += random.normal(scale=10.0 ** random.uniform(-6, -2) * scale, size=more.shape)
            places += list(place + more * moving)
            place = places[-1]
            continue
        place = place + step
        places.append(place)
    return np.array(places)


def drawn_limits(random: np.random.Generator, axes: int) -> tuple[np.ndarray, ...]:
    """Return (axes,) limits of velocity, acceleration and jerk; a jerk may be infinite."""
    velocity = 10.0 ** random.uniform(-2.0, 1.0, axes)
    acceleration = velocity * 10.0 ** random.uniform(-0.5, 2.0, axes)
    jerk = acceleration * 10.0 ** random.uniform(-0.5, 3.0, axes)
    if random.random() < 0.2:
        jerk[random.random(axes) < 0.5] = np.inf
    return velocity, acceleration, jerk


def on_machine(random: np.random.Generator, machine: Machine, tally: Tally, number: int) -> None:
    """Plan a case by ``optimal`` and ``auto``."""
    axes = AXES[: random.integers(1, 4)]
    points = drawn_points(random, len(axes), np.array([10.0 ** random.uniform(-4, 1)]))
    velocity, acceleration, jerk = drawn_limits(random, len(axes))
    limited = {
        axis: replace(
            machine.axes[axis],
            velocity=replace(machine.axes[axis].velocity, si=float(velocity[j])),
            acceleration=replace(machine.axes[axis].acceleration, si=float(acceleration[j])),
            jerk=_with(machine.axes[axis].jerk, float(jerk[j])),
        )
        for j, axis in enumerate(axes)
    }
    machine = replace(
        machine,
        axes={**machine.axes, **limited},
        tick_budget=replace(machine.tick_budget, si=TICKS),
    )
    tolerance_m = float(random.choice([1.0, 10.0 ** random.uniform(-7.0, -1.0)]))
    programmed = program_of(random, points, axes, machine)
    durations = {}
    for name in ("optimal", "auto"):
        try:
            trajectory = plan_trajectory(plan_path(programmed, machine, name, tolerance_m), machine)
            durations[name] = trajectory.duration_s
        except BudgetError:
            tally.counted["too long for the machine's ticks"] += 1
            return
        if name == "optimal":
            if not np.isfinite(trajectory(0.5 * trajectory.duration_s)).all():
                tally.fail(number, "a position is no number")
            worst = max(
                (
                    peak.ratio
                    for peak in limit_peaks(trajectory, machine)
                    if peak.quantity != "travel" and peak.axis in axes
                ),
                default=0.0,
            )
            tally.worst = max(tally.worst, worst)
            if not worst <= ALLOWED:
                tally.fail(number, f"{worst:.6g} of a limit")
    tally.counted["planned beside auto"] += 1
    if durations["auto"] > 0.0:
        ratio = durations["optimal"] / durations["auto"]
        tally.slowest = max(tally.slowest, ratio)
        if ratio > 1.0 + SLOWER:
            tally.counted["slower than auto"] += 1
            tally.fail(number, f"{ratio:.6f} of the time of auto, {durations['auto']:.6g} s")


def program_of(
    random: np.random.Generator, points: np.ndarray, axes: tuple[str, ...], machine: Machine
) -> ProgrammedPath:
    """Return points as a program: rapid, or with a feed far below or above every limit."""
    column = [machine.axis_names.index(axis) for axis in axes]
    radius_m = machine.radius_m[column]
    count = len(points)
    nominal_s = np.zeros(count)
    if random.random() < 0.5:
        way = np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]) * radius_m, axis=1)
        nominal_s = way / 10.0 ** random.uniform(-3.0, 4.0)
    rest = (random.random(count) < 0.1).astype(np.int64)
    rest[-1] = 1
    block = VertexBlock(
        positions=points,
        operation=np.maximum(np.arange(count) - 1, 0),
        nominal_s=nominal_s,
        rest=rest,
        dwell_s=np.zeros(count),
        line=np.arange(count),
    )
    return ProgrammedPath(axes=axes, radius_m=radius_m, blocks=Stream.of([block]))


def by_retime(random: np.random.Generator, tally: Tally, number: int) -> None:
    """Plan a case through the public face, with spans of fifteen decades in one path."""
    axes = int(random.integers(1, 4))
    wide = random.random() < 0.5
    scales = 10.0 ** (random.uniform(-9.0, 6.0, 4) if wide else random.uniform(-3.0, 1.0, 1))
    points = drawn_points(random, axes, scales)
    given: dict[str, Any] = dict(
        zip(("velocity", "acceleration", "jerk"), drawn_limits(random, axes), strict=True)
    )
    given["tolerance"] = float(random.choice([0.0, 1.0, *10.0 ** random.uniform(-9.0, 0.0, 6)]))
    if random.random() < 0.05:
        points = points[:1].repeat(len(points), axis=0)
    if random.random() < 0.2:
        where = random.choice(["points", "velocity", "acceleration", "jerk", "tolerance"])
        value = float(random.choice(HOSTILE))
        if where == "points":
            points[random.integers(len(points)), random.integers(axes)] = value
        elif where == "tolerance":
            given["tolerance"] = value
        else:
            given[where] = given[where].copy()
            given[where][random.integers(axes)] = value
    try:
        motion = retime(points, **given)
    except ThreadlineError as error:
        message = str(error)
        tally.counted["refused in one line"] += 1
        if "\n" in message or not message:
            tally.fail(number, f"refused with {message!r}")
        return
    tally.counted["planned by retime"] += 1
    ends = motion(np.array([0.0, motion.duration_s]))
    near = COINCIDENT_M + 1e-14 * float(np.abs(points).max())
    if not np.abs(ends - points[[0, -1]]).max() <= near:
        tally.fail(number, f"ends {np.abs(ends - points[[0, -1]]).max():.3g} beside the points")
    worst = 0.0
    limits = (given["velocity"], given["acceleration"], given["jerk"])
    for block in motion:
        if not (np.isfinite(block.coefficients).all() and np.isfinite(block.duration_s).all()):
            tally.fail(number, "a coefficient is no number")
        for j in range(axes):
            for order, poly in enumerate(derivatives(block, j, 3)[1:]):
                most = farthest(poly, -1.0)
                if most is not None:
                    worst = max(worst, most[0] / limits[order][j])
    tally.worst = max(tally.worst, worst)
    if not worst <= ALLOWED:
        tally.fail(number, f"{worst:.6g} of a limit")


def run_case(number: int, machine: Machine, tally: Tally) -> None:
    """Draw a case from its number, plan it, and take what became of it into ``tally``."""
    random = np.random.default_rng([12, number])
    try:
        if random.random() < 0.5:
            on_machine(random, machine, tally, number)
        else:
            by_retime(random, tally, number)
    except Exception as error:  # whatever else it is, it is a failure of this case
        tally.fail(number, f"{type(error).__name__}: {error}")


def main() -> int:
    """Run the cases; print what became of them."""
    parser = argparse.ArgumentParser(prog="python -m tools.random_paths", description=__doc__)
    parser.add_argument("count", nargs="?", type=int, default=1000)
    parser.add_argument("first", nargs="?", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("error")
    machine, tally = load_machine("lathe-winder"), Tally(Counter(), [])
    machine = without_drives(machine)
    began = perf_counter()
    for number in range(options.first, options.first + options.count):
        run_case(number, machine, tally)
        done = number + 1 - options.first
        if done % 1000 == 0:
            print(
                f"{done} cases, {perf_counter() - began:.0f} s, failed {len(tally.failed)}: "
                f"{dict(tally.counted)}, worst {tally.worst:.9f}, slowest {tally.slowest:.6f}",
                flush=True,
            )
    print(f"{options.count} cases from {options.first}: {dict(tally.counted)}")
    print(
        f"most of a limit {tally.worst:.9f}; most of the time of auto {tally.slowest:.6f}; "
        f"failed {len(tally.failed)}; {perf_counter() - began:.0f} s"
    )
    return 1 if tally.failed else 0


def without_drives(machine: Machine) -> Machine:
    """Return a machine whose drives give whatever its axes may do, as ``auto`` takes it."""
    drives: dict[str, Drive] = {
        name: replace(drive, amplifier=replace(drive.amplifier, current_limit=None))
        for name, drive in machine.drives.items()
        if isinstance(drive, DcMotor)
    }
    controllers = {
        name: replace(
            part, dac=replace(part.dac, range=replace(part.dac.range, si=1e9 * part.dac.range.si))
        )
        for name, part in machine.controllers.items()
    }
    return replace(machine, drives=drives, controllers=controllers)


if __name__ == "__main__":
    sys.exit(main())
