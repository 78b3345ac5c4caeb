"""The twin beside scipy, python-control and JAX: one axis of the winder, one plant, one accuracy.

Three cases: ``linear-quantised`` (encoder and DAC round, nothing limits), ``saturated`` (the 4 A
supply binds at every jump of the reference) and ``contact`` (the axis sticks and slips).

- scipy: ``solve_ivp`` (RK45, rtol 1e-8) from tick to tick, stick and slip with its events.
- python-control: ``input_output_response``. Linear: the whole loop as one discrete system over
  the exact sampled plant, its fastest form. The others: the continuous plant, tick by tick.
- JAX: see ``_twin_jax``. Ours and every formulation of JAX run in turn, on the same two cores, and
  medians are compared, by the clock; the note has the processor's time as well. There are two
  entries for the cases with events: against formulations that work for any plant, and against the
  formulas of this very plant.
- The stitcher: 10 000 variants of the whole machine over a path of two corners, against
  ``solve_ivp`` (RK45, rtol 1e-6) on one variant's linear equations from instant to instant.

Kernels are compiled before the clock runs, as are JAX's; building the variants' matrices counts for
the twin and not for JAX.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from statistics import median
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks._twin_cases import (
    BATCH_TICKS,
    CASES,
    COUNTS,
    VARIANTS,
    inertias,
    machine_of,
    rows_of,
    seconds,
    table_of,
)
from benchmarks._twin_peers import control_run, scipy_run
from threadline.dynamics.linear_model import linear_model
from threadline.machine import Machine
from threadline.machine.load import load_machine
from threadline.twin import BatchOptions, simulate, simulate_batch

SUBSTEPS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
# What the twin itself is held to against event-located references without quantisers.
WITHIN_UM = 0.1
ACCURACY_TICKS = 3000
ROUNDS = 9
STITCHERS = 10_000


def entry(
    name: str, ours: float, peer: str, value: float | None, unit: str, note: str
) -> dict[str, Any]:
    ratio = None if value is None else value / ours
    return {"name": name, "ours": ours, "peer": peer, "peer_value": value, "ratio": ratio,
            "unit": unit, "note": note}  # fmt: skip


def ours_per_tick(case: str) -> float:
    machine = machine_of(case)
    commands = table_of(machine, rows_of(case, 100_000))

    def run() -> None:
        for _ in simulate(commands, machine, settle_s=0.0, record_every=20):
            pass

    run()
    return seconds(run) / 100_000


def difference_um(case: str, other: np.ndarray) -> float:
    """Return the largest difference of the twin from a peer's angles, unquantised, in um."""
    machine = machine_of(case, reversal=False)
    commands = table_of(machine, rows_of(case, len(other)))
    load = simulate(commands, machine, quantised=False, settle_s=0.0).samples("X.load")[1]
    scale = COUNTS / machine.axes["X"].counts.si
    return float(np.abs(load[: len(other)] - other * scale).max() * 1e6)


def both(call: Callable[[], Any]) -> tuple[float, float]:
    """Return seconds by the clock and of the processor."""
    wall, busy = time.perf_counter(), time.process_time()
    call()
    return time.perf_counter() - wall, time.process_time() - busy


def in_turn(calls: Mapping[str, Callable[[], Any]], rounds: int) -> dict[str, tuple[float, float]]:
    """Return the medians by clock and processor of calls that take turns."""
    for call in calls.values():
        call()
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            taken[name].append(both(call))
    return {
        name: (median(w for w, _ in times), median(b for _, b in times))
        for name, times in taken.items()
    }


def smooth_loads(case: str) -> np.ndarray:
    """Return (ticks, variants / 100) event-located loads without quantisers, in m."""
    machine = machine_of(case, reversal=False)
    return simulate_batch(
        table_of(machine, rows_of(case, ACCURACY_TICKS)),
        machine,
        {"bodies.x.inertia": inertias()[::100]},
        options=BatchOptions(settle_s=0.0, channels=("X.load",), quantised=False),
    ).samples["X.load"][:ACCURACY_TICKS]


def against_jax(case: str) -> list[dict[str, Any]]:
    """Measure a batch, JAX with as few substeps as bring it near enough."""
    name = f"twin batch vs jax, {case}"
    machine = machine_of(case)
    commands = table_of(machine, rows_of(case, BATCH_TICKS))

    def ours() -> Any:
        variants = {"bodies.x.inertia": inertias()}
        return simulate_batch(
            commands, machine, variants, options=BatchOptions(settle_s=0.0, watch_current=False)
        )

    per = BATCH_TICKS * VARIANTS
    slow = ours().slow_ticks / per
    try:
        from benchmarks._twin_jax import formulations

        loads = smooth_loads(case)
        for substeps in SUBSTEPS:
            tried = formulations(case, substeps)
            apart = {f.name: float(np.abs(f.loads(ACCURACY_TICKS) - loads).max()) * 1e6
                     for f in tried}  # fmt: skip
            if apart[tried[0].name] < WITHIN_UM:
                break
    except ImportError:
        taken = in_turn({"ours": ours}, ROUNDS)["ours"][0] / per
        return [entry(name, taken, "jax", None, "s/tick/variant", "jax isn't installed")]
    calls: dict[str, Callable[[], Any]] = {"ours": ours}
    labels = {}
    for formulation in tried:
        ways = {(u, d): formulation.run(u, d) for u in (1, 4) for d in (1, 2)}
        quick = in_turn({str(way): call for way, call in ways.items()}, 3)
        best = min(ways, key=lambda way: quick[str(way)][0])
        calls[formulation.name] = ways[best]
        labels[formulation.name] = f"scan unrolled {best[0]}x on {best[1]} device(s)"
    medians = in_turn(calls, ROUNDS)
    wall, busy = (x / per for x in medians["ours"])
    found = []
    for formulation in tried:
        peer_wall, peer_busy = (x / per for x in medians[formulation.name])
        how = f"{substeps} substeps" if formulation.name == "substeps" else formulation.name
        own = ", closed form" if formulation.name == "closed form" else ""
        found.append(
            entry(
                name + own, wall, f"jax scan f64, {how}", peer_wall, "s/tick/variant",
                f"{VARIANTS} variants, {wall * 1e9:.2f} against {peer_wall * 1e9:.2f} ns by the "
                f"clock, {busy * 1e9:.2f} against {peer_busy * 1e9:.2f} ns of processor; {slow:.1%}"
                f" of our ticks with events; jax: {how}, {labels[formulation.name]}, "
                f"{apart[formulation.name]:.2g} um from the event-located loads",
            )
        )  # fmt: skip
    return found


def stitcher_rows(machine: Machine) -> np.ndarray:
    """Return (ticks, 2) counts: X 2.5 in, Y 2.5 in, X 2.5 in, at 7.5 in/s."""
    inch, tick_s = 25.4e-3, float(machine.tick_clock.period_s)
    way = np.minimum(np.arange(round(2.5 / 7.5 / tick_s) + 1) * 7.5 * inch * tick_s, 2.5 * inch)
    leg = np.diff(np.rint(way * machine.axes["X"].counts.si)).astype(np.int64)
    still = np.zeros_like(leg)
    x, y = np.concatenate((leg, still, leg)), np.concatenate((still, leg, still))
    return np.stack((x, y), axis=1)


def stitchers() -> dict[str, Any]:
    """Measure 10 000 variants of the stitcher, both axes, 1.5 s each."""
    machine = load_machine("stitcher")
    commands = table_of(machine, stitcher_rows(machine))
    spread = np.random.default_rng(1).uniform(0.9, 1.1, (6, STITCHERS))
    paths = ("bodies.x_head.inertia", "bodies.y_head.inertia", "bodies.frame.inertia",
             "links.x_belt.stiffness", "links.y_belt.stiffness",
             "links.frame_mount.stiffness")  # fmt: skip
    variants = {}
    for path, factors in zip(paths, spread, strict=True):
        table, part, number = path.split(".")
        variants[path] = getattr(getattr(machine, table)[part], number).si * factors

    def ours() -> Any:
        return simulate_batch(
            commands, machine, variants, options=BatchOptions(settle_s=0.5, watch_current=False)
        )

    result = ours()
    wall, busy = (median(x) for x in zip(*(both(ours) for _ in range(3)), strict=True))
    # What a peer has to do for one variant: its linear equations, from one action to the next.
    step_s, advances = 68e-6, 200
    peer = 0.0
    for model in linear_model(machine):
        A, B = model.A, model.B[:, 0]

        def slope(_t: float, x: np.ndarray, A: Any = A, B: Any = B) -> Any:
            return A @ x + B * 0.5

        def one(A: Any = A, slope: Any = slope) -> None:
            x = np.zeros(len(A))
            for _ in range(advances):
                x = solve_ivp(slope, (0.0, step_s), x, rtol=1e-6, atol=1e-9).y[:, -1]

        peer += seconds(one, 2) / advances / step_s * (result.ticks * 1e-3)
    return entry(
        "twin batch of 10 000 stitcher variants",
        wall / STITCHERS,
        "scipy solve_ivp, one variant",
        peer,
        "s/variant",
        f"{wall:.1f} s by the clock, {busy:.1f} s of processor for {STITCHERS} variants of both "
        f"axes, {result.ticks} ms each, {result.events / STITCHERS:.0f} changes of modes per "
        f"variant; scipy would take {peer:.1f} s for one, without limits and quantisers",
    )


def run() -> list[dict[str, Any]]:
    """Measure every case against every peer."""
    results = []
    scalar = {case: ours_per_tick(case) for case in CASES}
    for case in CASES:
        ticks = 300
        taken = seconds(partial(scipy_run, case, ticks, True), 2) / ticks
        apart = difference_um(case, scipy_run(case, ticks, False))
        results.append(
            entry(f"twin vs scipy solve_ivp, {case}", scalar[case], "scipy solve_ivp", taken,
                  "s/tick", f"{scalar[case] * 1e9:.0f} ns against {taken * 1e6:.0f} us a tick; "
                  f"{apart:.1e} um apart without quantisers after {ticks} ticks")
        )  # fmt: skip
    for case in CASES:
        ticks = 2000 if case == "linear-quantised" else 150
        name = f"twin vs python-control, {case}"
        taken = seconds(partial(control_run, case, ticks), 2) / ticks
        results.append(
            entry(name, scalar[case], "python-control", taken, "s/tick",
                  f"{scalar[case] * 1e9:.0f} ns against {taken * 1e6:.1f} us a tick")
        )  # fmt: skip
    for case in CASES:
        results += against_jax(case)
    return [*results, stitchers()]
