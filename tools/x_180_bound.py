"""How short x-180.prg can be on lathe-winder while its load keeps 0.5 mm, whoever plans it.

X goes to 180 mm and back: one axis on a straight line, so that every limit is linear in what the
motor is told at instants ``STEPS`` to a tick. A linear program asks for the farthest that the load
comes at one tick, with what is told at rest before and after the motion. What is told keeps
velocity, acceleration and jerk of the axis (a mean over a few instants of a motion that keeps them
does); the load is never 0.5 mm beyond either end. A reserve of volts and current is kept in one of
two ways: of what controller and motor need in the loop as it is, tick by tick, or of what a drive
with rigid links needs for the motion that is told, which is what ``optimal`` keeps. A motion of
fewer instants exists only if that of one more does. So the fewest with which the load comes within
0.5 mm of 180 mm bound every plan from below, up to the rounding to counts and to levels of the DAC.

A third bound leaves what is told free and limits the load instead, tick by tick: what a plan of
the load with a reference of any shape could reach, from its first tick to its last.

Run: python -m tools.x_180_bound
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.optimize import linprog

from threadline.dynamics.loop import axis_loops
from threadline.machine import Machine, load_machine
from threadline.machine.parts import DcMotor
from threadline.motion.timing.optimal.motion_limits import RESERVE, demands_of

WAY_M, WITHIN_M, TOLERANCE_M = 0.18, 5e-4, 1e-4
REMEMBERED, AFTER = 100, 40  # ticks: of the loop's answers, and judged after the motion
LATEST = 14  # ticks after the middle of what is told, until the load is at its farthest
STEPS = 2  # instants to a tick at which a motion that is limited itself is told
CASES = ((0.1, "rigid"), (0.1, "loop"), (0.05, "rigid"), (0.05, "loop"), (0.1, "free"))
LOW, HIGH = 142, 162  # ticks between which the fewest are looked for
MM = 1e3  # lengths in mm: the program is scaled so


def responses(machine: Machine) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Return the tick, and what load (m), controller (V) and motor (A) answer to 1 m in a tick."""
    loop = axis_loops(machine)["X"]
    closed = loop.closed()
    commanded = np.zeros((REMEMBERED, len(loop.filters)))
    commanded[0, loop.index] = loop.counts_per_unit
    answer = closed.respond(commanded)
    load = answer[:, closed.outputs.index("X.load")]
    volts = answer[:, closed.outputs.index("controllers.x")]
    drive, inertia = machine.drives["x"], machine.bodies["x"].inertia.si
    assert isinstance(drive, DcMotor)
    emf, ohms, torque = drive.back_emf.si, drive.resistance.si, drive.torque_constant.si
    kept = np.exp(-torque * emf / (ohms * inertia) * closed.period_s)
    gain = drive.amplifier.gain.si
    turns = np.zeros(REMEMBERED)  # rad/s of the motor at each tick, its exact answer to held volts
    for k in range(1, REMEMBERED):
        turns[k] = kept * turns[k - 1] + (1.0 - kept) * gain / emf * volts[k - 1]
    return closed.period_s, load / load.sum(), volts, (gain * volts - emf * turns) / ohms


def farthest_m(
    machine: Machine, count: int, at: int, reserve: float, kept: str, within_m: float = WITHIN_M
) -> float:
    """Return how far the load can be at tick ``at``, -inf if there is no motion.

    Parameters
    ----------
    count
        Instants that the motion takes: ``STEPS`` to a tick, ticks where the reference is free.
    reserve
        Share of volts and current that is kept.
    kept
        ``"loop"``, ``"rigid"`` or ``"free"``: of which the reserve is, and what is limited.
    within_m
        How far beyond either end the load may be.
    """
    period_s, load, volts, amperes = responses(machine)
    steps = 1 if kept == "free" else STEPS
    last, free, step_s = -(-count // steps) + AFTER, count - 1, period_s / steps
    commanded: Any = sp.csr_matrix(
        sp.vstack(
            [sp.csr_matrix((4, free)), sp.eye(free), sp.csr_matrix((last * steps - free, free))]
        )
    )

    def answered(taps: np.ndarray) -> sp.csr_matrix:
        memory = sp.diags_array(
            [np.full(last + 1, tap).tolist() for tap in taps],
            offsets=[-k for k in range(len(taps))],
            shape=(last + 1, last + 1),
        )
        return sp.csr_matrix(memory @ commanded[3::steps])

    where = answered(load)
    rates = [where if kept == "free" else commanded]
    for _ in range(3):
        rates.append((rates[-1][1:] - rates[-1][:-1]) / step_s)
    axis, drive = machine.axes["X"], machine.drives["x"]
    assert isinstance(drive, DcMotor)
    assert drive.amplifier.current_limit is not None
    assert axis.jerk is not None
    most = [q.si for q in (axis.velocity, axis.acceleration, axis.jerk)]
    rows = [rate / limit for rate, limit in zip(rates[1:], most, strict=True)]
    if kept == "rigid":
        # The mean velocity over two steps, and that beside the mean acceleration, differ by this.
        apart_m_s = step_s**2 / 12.0 * most[2]
        for speed, push in demands_of(machine, ("X",))[:, 0] * (1.0 - RESERVE) / (1.0 - reserve):
            both = 0.5 * speed * (rates[1][1:] + rates[1][:-1]) + push * rates[2]
            rows.append(both / (1.0 + speed * apart_m_s))
    else:
        clamp_v, clamp_a = machine.controllers["x"].dac.range.si, drive.amplifier.current_limit.si
        rows += [answered(volts) / ((1.0 - reserve) * clamp_v)]
        rows += [answered(amperes) / ((1.0 - reserve) * clamp_a)]
    all_rows = sp.vstack(rows)
    matrix: Any = sp.vstack([all_rows, -all_rows, where * MM, -where * MM])
    ones, places = np.ones(2 * all_rows.shape[0]), np.ones(where.shape[0])
    bound = [ones, (WAY_M + within_m) * MM * places, within_m * MM * places]
    room_m = np.inf if kept == "free" else TOLERANCE_M
    found = linprog(
        -where[[at]].toarray().ravel() * MM,
        A_ub=matrix,
        b_ub=np.concatenate(bound),
        bounds=(-room_m, WAY_M + room_m),
        method="highs",
    )
    return -np.inf if found.status or found.fun is None else -found.fun / MM


def fewest(comes: Callable[[int], bool], low: int, high: int) -> int:
    """Return the least number above ``low`` that ``comes``, which ``high`` does."""
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if comes(middle) else (middle, high)
    return high


def comes(
    machine: Machine, count: int, reserve: float, kept: str, within_m: float = WITHIN_M
) -> bool:
    """Say whether a motion of ``count`` instants may come to its end; all as of ``farthest_m``."""
    middle = count // (2 * (1 if kept == "free" else STEPS))
    # Between two ticks it may have been farther by this.
    short_m = within_m + machine.axes["X"].acceleration.si * responses(machine)[0] ** 2 / 8.0
    return any(
        farthest_m(machine, count, at, reserve, kept, within_m) >= WAY_M - short_m
        for at in range(middle, middle + LATEST)
    )


def least_s(machine: Machine, reserve: float, kept: str, within_m: float = WITHIN_M) -> float:
    """Return a time that every plan takes more than, s; ``kept`` as of ``farthest_m``."""
    steps = 1 if kept == "free" else STEPS
    count = fewest(
        lambda count: comes(machine, count, reserve, kept, within_m), LOW * steps, HIGH * steps
    )
    return (count - 1) * responses(machine)[0] / steps


def answers(kept: str) -> dict[str, float]:
    """Return the bound with a tenth of reserve, s; ``kept`` as of ``farthest_m``."""
    return {kept: least_s(load_machine("lathe-winder"), 0.1, kept)}


def main() -> int:
    """Print the bounds at several reserves."""
    machine = load_machine("lathe-winder")
    sys.stdout.write("reserve  kept of  every plan takes more than\n")
    for reserve, kept in CASES:
        bound_s = least_s(machine, reserve, kept)
        sys.stdout.write(f"{reserve:7.0%}  {kept:7}  {bound_s:.4f} s\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
