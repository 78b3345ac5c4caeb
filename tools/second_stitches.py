"""A second search for the speeds of a shaft: ``python -m tools.second_stitches DESIGN MACHINE``.

It shares nothing with the planner of designs but the moves and the numbers of the machine: masses,
springs, dampers, limits, spindle. Modes are written down by hand, the swing of a move is integrated
with the law's closed form, and the schedules are found by a beam of its own, with cells of
amplitude and phase, on a grid of its own. What it finds is checked at closer frequencies, and
searched again for less where that is over the tolerance. Prints JSON: the time of both searches,
and the largest swing that the second one leaves. MACHINE is a machine or one of ``OWN``.

Behind MACHINE may stand the share of the tolerances of loads and springs to plan for, as the
planner's ``--robust`` has it (0.05), ``exact`` to leave out that the damping may be 0.7 or 1.3
times that of the file, which the planner always allows for (``any``), and the states that are kept
for each speed (15).
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from math import ceil, log, pi
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threadline.machine import Machine, load_machine
from threadline.machine.numbers import with_numbers
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
OWN: dict[str, dict[str, float]] = {
    # A lighter frame on a stiffer drive train, 20 Hz, with four times the damping.
    "light-frame": {
        f"{part}.{axis}_{name}": value
        for axis in "xy"
        for part, name, value in (
            ("bodies", "frame.inertia", 600.0),
            ("links", "train.stiffness", 600.0 * (2.0 * pi * 20.0) ** 2),
            ("links", "train.damping", 12_000.0),
        )
    },
    # A heavier frame whose axes differ: 9 and 11 Hz.
    "heavy-frame": {
        "bodies.x_frame.inertia": 1600.0,
        "bodies.y_frame.inertia": 1300.0,
        "links.x_train.stiffness": 1600.0 * (2.0 * pi * 9.0) ** 2,
        "links.y_train.stiffness": 1300.0 * (2.0 * pi * 11.0) ** 2,
    },
}
_STEP = 0.01  # of the turn times, relative
_AMPLITUDES, _PHASES = 5, 12  # cells of a swing
_APART, _CLOSER = 0.01, 0.003  # frequencies of a band, in the search and in its check
_ROUNDS = 5
_DAMPINGS = (0.7, 1.0, 1.3)


@dataclass(frozen=True, slots=True)
class Frame:
    """What swings: (M,) poles in 1/s, and the axis of each; limits as the machine file has them."""

    poles: Complexes
    axis: NDArray[np.int64]


def machine_of(name: str) -> Machine:
    """Return a machine of ``OWN``, which are schiffli frames, or of the library."""
    base = load_machine("schiffli-frame" if name in OWN else name)
    return with_numbers(base, OWN[name]) if name in OWN else base


def frames(machine: Machine, share: float, apart: float, dampings: tuple[float, ...]) -> Frame:
    """Return the modes with motors held: ``m q'' + c q' + k q = -m y''`` for each machine."""
    poles, axes = list[complex](), list[int]()
    for column, axis in enumerate("xy"):
        mass, spring = machine.bodies[f"{axis}_frame"], machine.links[f"{axis}_train"]
        assert mass.damping is not None and spring.damping is not None
        wide = share * np.array([mass.inertia.tolerance_si, spring.stiffness.tolerance_si])
        m, k = mass.inertia.si, spring.stiffness.si
        omega, c = np.sqrt(k / m), mass.damping.si + spring.damping.si
        low = np.sqrt((k - wide[1]) / (m + wide[0])) / omega
        high = np.sqrt((k + wide[1]) / (m - wide[0])) / omega
        count = ceil(max(1.0 - low, high - 1.0) / apart - 1e-9)
        parts = np.unique([*np.linspace(low, 1.0, count + 1), *np.linspace(1.0, high, count + 1)])
        zeta = c / (2.0 * np.sqrt(k * m))
        for part in parts:
            for damping in dampings:
                ratio, at = zeta * damping, omega * part
                poles.append(complex(-ratio * at, at * np.sqrt(1.0 - ratio**2)))
                axes.append(column)
    return Frame(np.array(poles), np.array(axes))


def modified_sine(u: Floats) -> Floats:
    """Return the acceleration of a unit move in unit time, in closed form."""
    most = 4.0 * pi**2 / (pi + 4.0)
    ends = np.where(u < 0.5, np.sin(4.0 * pi * u), np.sin(4.0 * pi * (u - 1.0)))
    middle = np.cos(4.0 * pi / 3.0 * (u - 0.125))
    return np.asarray(most * np.where((u < 0.125) | (u > 0.875), ends, middle))


def fresh_swings(frame: Frame, windows_s: Floats) -> Complexes:
    """Return (N, M) complex swing at the end of a move of 1 m; its modulus is the amplitude, m."""
    edges = np.linspace(0.0, 1.0, 8 * 40 + 1)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    half = 0.5 * np.diff(edges)[:, None]
    u = (0.5 * (edges[:-1] + edges[1:])[:, None] + half * nodes).ravel()
    moment = modified_sine(u) * (half * weights).ravel()
    grown = np.exp(windows_s[:, None, None] * (1.0 - u)[None, None, :] * frame.poles[None, :, None])
    return np.asarray(grown @ moment / (windows_s[:, None] * frame.poles.imag[None, :]))


def swings_left(
    frame: Frame, travels_m: Floats, needle: NDArray[np.int64], turn_s: Floats, share: float
) -> float:
    """Return the largest amplitude, m, with which a needle enters; it enters as the window ends."""
    fresh, now, worst = (
        fresh_swings(frame, share * turn_s),
        np.zeros(len(frame.poles), complex),
        0.0,
    )
    for k in range(len(turn_s)):
        if k:
            rest = 2.0 * (1.0 - share) / (1.0 / turn_s[k - 1] + 1.0 / turn_s[k])
            now = now * np.exp(frame.poles * (rest + share * turn_s[k]))
        now = now + travels_m[k, frame.axis] * fresh[k]
        if needle[k]:
            worst = max(worst, float(np.abs(now).max()))
    return worst


def shortest_turns(machine: Machine, travels_m: Floats) -> Floats:
    """Return (n,) the shortest turn of each move: limits of axes, step rate, loading of tables."""
    assert machine.shaft is not None and machine.tables is not None
    share, length = float(machine.shaft.window_share), np.abs(travels_m)
    window = np.zeros(len(travels_m))
    for column, axis in enumerate(machine.axes.values()):
        speed = min(axis.velocity.si, machine.tables.step_rate.si / axis.counts.si)
        by_speed = 1.7595757 * length[:, column] / speed
        by_force = np.sqrt(5.5279571 * length[:, column] / axis.acceleration.si)
        window = np.maximum(window, np.maximum(by_speed, by_force))
    loads = (travels_m[1:] != 0.0).sum(axis=1) * machine.tables.fetch.si
    turn = np.maximum(window / share, np.append(loads, 0.0) / (1.0 - share))
    return np.minimum(np.maximum(turn, float(machine.shaft.turn_s)), machine.shaft.slowest_turn.si)


@dataclass(frozen=True, slots=True)
class Problem:
    """Moves of a design on a machine: (n, 2) travel, (n,) needle, (n,) shortest turns, spindle."""

    travels_m: Floats
    needle: NDArray[np.int64]
    shortest_s: Floats
    share: float
    change: float
    slowest_s: float
    tolerance_m: float


def beam(problem: Problem, frame: Frame, asked_m: float, width: int) -> Floats | None:
    """Return (n,) turn times; None if no state of some turn is within ``asked_m``."""
    fastest = float(problem.shortest_s.min())
    slowest = max(_alone_s(problem, frame), float(problem.shortest_s.max()))
    count = 1 + ceil(log(slowest / fastest) / _STEP)
    turn_s = np.geomspace(fastest, slowest, count)
    fresh = fresh_swings(frame, problem.share * turn_s)
    squares = turn_s**-2.0
    reach = [
        np.flatnonzero(np.abs(squares - one) <= problem.change * (1 + 1e-12)) for one in squares
    ]
    rest = 2.0 * (1.0 - problem.share) / (1.0 / turn_s[:, None] + 1.0 / turn_s[None, :])
    pair_s = rest + problem.share * turn_s[None, :]
    kept = np.exp(frame.poles[None, None, :] * pair_s[:, :, None])
    to_go = _to_go(problem, frame, fresh, turn_s, reach, pair_s, asked_m)
    named = [int(np.flatnonzero(frame.axis == column)[0]) for column in (0, 1)]
    able = np.isfinite(to_go[0])
    if problem.needle[0]:
        able &= np.abs(problem.travels_m[0, frame.axis] * fresh).max(axis=1) <= asked_m
    first = np.flatnonzero(able)
    at, time = first, np.zeros(len(first))
    swing = problem.travels_m[0, frame.axis] * fresh[first]
    backs, ats = [np.zeros(len(first), np.int64)], [first]
    for k in range(1, len(problem.travels_m)):
        source = np.repeat(np.arange(len(at)), [len(reach[j]) for j in at])
        then = np.concatenate([reach[j] for j in at])
        ends = np.isfinite(to_go[k][then])
        source, then = source[ends], then[ends]
        spent = pair_s[at[source], then]
        now = swing[source] * kept[at[source], then]
        now += problem.travels_m[k, frame.axis] * fresh[then]
        if problem.needle[k]:
            within = np.abs(now).max(axis=1) <= asked_m
            source, then, now, spent = source[within], then[within], now[within], spent[within]
        if not len(then):
            return None
        so_far = time[source] + spent
        key = then.astype(np.int64)
        for column in named:
            size = np.minimum(np.abs(now[:, column]) / asked_m * _AMPLITUDES, 15).astype(np.int64)
            turned = (np.angle(now[:, column]) + pi) / (2.0 * pi) * _PHASES
            key = (key * 16 + size) * _PHASES + np.minimum(turned.astype(np.int64), _PHASES - 1)
        order = np.argsort(so_far + to_go[k][then], kind="stable")
        _, best = np.unique(key[order], return_index=True)
        chosen = _of_each_speed(order[np.sort(best)], then, width)
        at, time, swing = then[chosen], so_far[chosen], now[chosen]
        backs.append(source[chosen])
        ats.append(at)
    state = int(np.argmin(time + (1.0 - problem.share) * turn_s[at]))
    found = np.empty(len(ats))
    for k in range(len(ats) - 1, -1, -1):
        found[k] = turn_s[ats[k][state]]
        state = int(backs[k][state])
    return found


def _alone_s(problem: Problem, frame: Frame) -> float:
    """Return a turn from which on the longest move alone leaves at most the tolerance."""
    turn_s = np.geomspace(problem.shortest_s.min(), problem.slowest_s, 2000)
    most = np.abs(problem.travels_m[problem.needle == 1]).max(axis=0)[frame.axis]
    over = (np.abs(fresh_swings(frame, problem.share * turn_s)) * most).max(axis=1)
    beyond = np.flatnonzero(over > problem.tolerance_m)
    return float(turn_s[min(beyond[-1] + 1, len(turn_s) - 1)]) if len(beyond) else float(turn_s[0])


def _of_each_speed(
    ranked: NDArray[np.int64], then: NDArray[np.int64], most: int
) -> NDArray[np.int64]:
    """Return the first ``most`` states of each speed: a long move later may need a slow one."""
    speed = then[ranked]
    order = np.argsort(speed, kind="stable")
    begins = np.searchsorted(speed[order], speed[order])
    return np.asarray(ranked[order[np.arange(len(order)) - begins < most]])


def _to_go(
    problem: Problem, frame: Frame, fresh: Complexes, turn_s: Floats,
    reach: list[NDArray[np.int64]], pair_s: Floats, asked_m: float,
) -> Floats:  # fmt: skip
    """Return (n, N) the least time to the end; infinite where the swing of a move is hopeless."""
    turns, count = len(problem.travels_m), len(turn_s)
    found = np.full((turns, count), np.inf)
    spared = np.exp(frame.poles.real[None, :] * pair_s.min())
    for k in range(turns - 1, -1, -1):
        able = turn_s >= problem.shortest_s[k] * (1.0 - 1e-12)
        if problem.needle[k] and (k == 0 or problem.needle[k - 1]):
            own = np.abs(problem.travels_m[k, frame.axis] * fresh)
            able &= (own <= asked_m * (1.0 + spared)).all(axis=1)
        for j in np.flatnonzero(able):
            if k == turns - 1:
                found[k, j] = (1.0 - problem.share) * turn_s[j]
            else:
                found[k, j] = (pair_s[j, reach[j]] + found[k + 1, reach[j]]).min()
    return found


def compared(
    design: Path, name: str, share: float, dampings: tuple[float, ...], width: int
) -> dict[str, Any]:
    """Return what both searches find for a design; the planner always allows for dampings."""
    machine = machine_of(name)
    assert machine.shaft is not None and machine.shaft.acceleration is not None
    assert machine.tables is not None
    options = Options(robust_share=share)
    plan = plan_job(open_job(design, machine, options), machine, options)
    moves = plan.stitched.turns.moves
    travels_m = np.asarray(moves.units * machine.tables.unit.si, dtype=np.float64)
    window = float(machine.shaft.window_share)
    problem = Problem(
        travels_m=travels_m,
        needle=np.asarray(moves.needle, dtype=np.int64),
        shortest_s=shortest_turns(machine, travels_m),
        share=window,
        change=2.0 * (1.0 - window) * machine.shaft.acceleration.si / (2.0 * pi),
        slowest_s=machine.shaft.slowest_turn.si,
        tolerance_m=plan.stitched.pace.tolerance_m,
    )
    frame = frames(machine, share, _APART, dampings)
    closer = frames(machine, share, _CLOSER, dampings)
    asked_m, best, left_m = problem.tolerance_m, None, np.inf
    for _ in range(_ROUNDS):
        found = beam(problem, frame, asked_m, width)
        if found is None:
            break
        left_m = swings_left(closer, travels_m, problem.needle, found, window)
        if left_m <= problem.tolerance_m * (1.0 + 1e-6):
            best = found
            break
        asked_m *= 0.997 * problem.tolerance_m / left_m
    first = plan.stitched.turns.turn_s
    result: dict[str, Any] = {
        "first_s": total_s(first, window),
        "first_leaves_m": swings_left(closer, travels_m, problem.needle, first, window),
        "bound_s": plan.stitched.bound_s,
        "second_s": None if best is None else total_s(best, window),
        "second_leaves_m": float(left_m),
    }
    if best is not None:
        result["gain"] = 1.0 - result["second_s"] / result["first_s"]
    return result


def total_s(turn_s: Floats, share: float) -> float:
    """Return the time of all turns, with a speed that changes evenly over each rest."""
    speed = 1.0 / turn_s
    rest = 2.0 * (1.0 - share) / (speed + np.append(speed[1:], speed[-1]))
    return float((share * turn_s + rest).sum())


def answers(
    design: str, machine: str, robust: str = "0.05", damping: str = "any", width: str = "15"
) -> dict[str, Any]:
    """Return what ``compared`` does, from words of a command line."""
    dampings = _DAMPINGS if damping == "any" else (1.0,)
    return compared(Path(design), machine, float(robust), dampings, int(width))


def main() -> None:
    print(json.dumps(answers(*sys.argv[1:]), indent=1))


if __name__ == "__main__":
    main()
