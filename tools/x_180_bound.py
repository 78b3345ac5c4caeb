"""How short x-180.prg can be on lathe-winder while its load keeps 0.5 mm, whoever plans it.

X goes to 180 mm and back: one axis on a straight line, so that every limit is linear in what the
motor is told tick by tick. A linear program asks for the farthest that the load comes at one tick,
with what it is told at rest before and after the motion. What it is told keeps velocity,
acceleration and jerk of the axis (a mean over ticks of a motion that keeps them does); the load is
never 0.5 mm beyond either end; controller and motor keep a share of volts and current as a
reserve, in the loop as it is, not in a rigid drive. A motion of fewer ticks exists only if that of
one more does. So the fewest ticks with which the load comes within 0.5 mm of 180 mm bound every
plan from below, up to the rounding to counts and to levels of the DAC.

Run: python -m tools.x_180_bound
"""

from __future__ import annotations

import sys

import numpy as np
import scipy.sparse as sp
from scipy.optimize import linprog

from threadline.machine import Machine, load_machine
from threadline.plant.loop import axis_loops

WAY_M, WITHIN_M, TOLERANCE_M = 0.18, 5e-4, 1e-4
REMEMBERED, AFTER = 100, 40  # ticks: of the loop's answers, and judged after the motion
LATEST = 14  # ticks after the middle of what is told, until the load is at its farthest
MM = 1e3  # lengths in mm: the program is scaled so


def answers(machine: Machine) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Return the tick, and what load (m), controller (V) and motor (A) answer to 1 m in a tick."""
    loop = axis_loops(machine)["X"]
    closed = loop.closed()
    told = np.zeros((REMEMBERED, len(loop.filters)))
    told[0, loop.index] = loop.counts_per_unit
    answer = closed.respond(told)
    load = answer[:, closed.outputs.index("X.load")]
    volts = answer[:, closed.outputs.index("controllers.x")]
    drive, inertia = machine.drives["x"], machine.bodies["x"].inertia.si
    emf, ohms, torque = drive.back_emf.si, drive.resistance.si, drive.torque_constant.si
    kept = np.exp(-torque * emf / (ohms * inertia) * closed.period_s)
    gain = drive.amplifier.gain.si
    turns = np.zeros(REMEMBERED)  # rad/s of the motor at each tick, its exact answer to held volts
    for k in range(1, REMEMBERED):
        turns[k] = kept * turns[k - 1] + (1.0 - kept) * gain / emf * volts[k - 1]
    return closed.period_s, load / load.sum(), volts, (gain * volts - emf * turns) / ohms


def farthest_m(
    machine: Machine, ticks: int, at: int, reserve: float, within_m: float = WITHIN_M
) -> float:
    """Return how far the load can be at tick ``at`` of ``ticks``, -inf if there is no motion."""
    period_s, load, volts, amperes = answers(machine)
    last, free = ticks + AFTER, ticks - 1
    told = sp.vstack(
        [sp.csr_matrix((4, free)), sp.eye(free), sp.csr_matrix((last - ticks + 1, free))]
    ).tocsr()
    rates = [told]
    for _ in range(3):
        rates.append((rates[-1][1:] - rates[-1][:-1]) / period_s)

    def answered(taps: np.ndarray) -> sp.csr_matrix:
        memory = sp.diags_array(
            [np.full(last + 1, tap) for tap in taps],
            offsets=[-k for k in range(len(taps))],
            shape=(last + 1, last + 1),
        )
        return sp.csr_matrix(memory @ told[3:])

    axis, drive = machine.axes["X"], machine.drives["x"]
    most = [q.si for q in (axis.velocity, axis.acceleration, axis.jerk)]
    where = answered(load)
    rows = [rate / limit for rate, limit in zip(rates[1:], most, strict=True)]
    clamp_v, clamp_a = machine.controllers["x"].dac.range.si, drive.amplifier.current_limit.si
    rows += [answered(volts) / ((1.0 - reserve) * clamp_v)]
    rows += [answered(amperes) / ((1.0 - reserve) * clamp_a)]
    both = sp.vstack(rows)
    matrix = sp.vstack([both, -both, where * MM, -where * MM])
    ones, places = np.ones(2 * both.shape[0]), np.ones(where.shape[0])
    bound = [ones, (WAY_M + within_m) * MM * places, within_m * MM * places]
    found = linprog(
        -where[[at]].toarray().ravel() * MM,
        A_ub=matrix,
        b_ub=np.concatenate(bound),
        bounds=(-TOLERANCE_M, WAY_M + TOLERANCE_M),
        method="highs",
    )
    return -found.fun / MM if found.status == 0 else -np.inf


def least_ticks(machine: Machine, reserve: float, within_m: float = WITHIN_M) -> int:
    """Return the fewest ticks with which the load comes within ``within_m`` of 180 mm and back."""
    period_s = answers(machine)[0]
    # Between two ticks it may have been farther by this.
    short_m = within_m + machine.axes["X"].acceleration.si * period_s**2 / 8.0

    def comes(ticks: int) -> bool:
        middle = ticks // 2
        return any(
            farthest_m(machine, ticks, at, reserve, within_m) >= WAY_M - short_m
            for at in range(middle, middle + LATEST)
        )

    low, high = 120, 180
    while high - low > 1:
        ticks = (low + high) // 2
        low, high = (low, ticks) if comes(ticks) else (ticks, high)
    return high


def main() -> int:
    """Print the fewest ticks at several reserves."""
    machine = load_machine("lathe-winder")
    period_s = answers(machine)[0]
    sys.stdout.write("reserve  fewest ticks  every plan takes more than\n")
    for reserve in (0.1, 0.05, 0.0):
        ticks = least_ticks(machine, reserve)
        sys.stdout.write(f"{reserve:7.0%}  {ticks:12d}  {(ticks - 1) * period_s:.3f} s\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
