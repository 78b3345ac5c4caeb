"""The twin beside scipy, python-control and JAX: one axis of the winder, one plant, one accuracy.

Three cases: ``linear-quantised`` (encoder and DAC round, nothing limits), ``saturated`` (the 4 A
supply binds at every jump of the reference) and ``contact`` (the axis sticks and slips).

- scipy: ``solve_ivp`` (RK45, rtol 1e-8) from tick to tick, stick and slip with its events.
- python-control: ``input_output_response``. Linear: the whole loop as one discrete system over
  the exact sampled plant, its fastest form. The others: the continuous plant, tick by tick.
- JAX: ``vmap``-ed ``lax.scan`` in float64 over all ticks, variants innermost, matrices unrolled to
  scalars, its fastest form found. It has no events: the limits switch at fixed substeps, as many as
  bring it within 1 um of the event-located answer (the note has both numbers).

The twin's kernels are compiled before the clock runs, as are JAX's; building the variants' matrices
counts for the twin and not for JAX.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from threadline.machine import Machine
from threadline.machine.load import load_machine
from threadline.signals import Stream, TickBlock, TickTable
from threadline.twin import simulate, simulate_batch

H, COUNTS, R, KT = 5e-3, 4000 / (2 * np.pi), 0.4, 0.082
KE = 8.6 / (1000 * 2 * np.pi / 60)
J, GAIN, VOLT = 3.606e-4, 0.45, 20 / 4096
LIMIT, SLIDE, BREAK = 4.0, 0.05, 0.06
VARIANTS = 1000
SUBSTEPS = (1, 4, 16, 64, 256)
WITHIN_UM = 1.0
CASES = ("linear-quantised", "saturated", "contact")
BATCH_TICKS = dict.fromkeys(CASES, 20_000)


def machine_of(case: str, *, reversal: bool = True) -> Machine:
    """Return the X axis of the winder, alone and without travel switches.

    Comparisons without quantisers leave out the zero tick on reversal too: at rest the sign of a
    level of 1e-13 would decide on it.
    """
    whole = load_machine("lathe-winder" + ("+stiction" if case == "contact" else ""))
    drive = whole.drives["x"]
    if case != "saturated":
        amplifier = dataclasses.replace(drive.amplifier, current_limit=None)
        drive = dataclasses.replace(drive, amplifier=amplifier)
    controller = whole.controllers["x"]
    dac = dataclasses.replace(controller.dac, zero_on_reversal=reversal)
    return dataclasses.replace(
        whole,
        bodies={"x": whole.bodies["x"]},
        drives={"x": drive},
        sensors={"x": whole.sensors["x"]},
        controllers={"x": dataclasses.replace(controller, dac=dac)},
        axes={"X": whole.axes["X"]},
        inputs={},
    )


def rows_of(case: str, ticks: int) -> np.ndarray:
    """Return counts per tick: to and fro at 30 counts per tick, or in jumps that saturate."""
    if case == "saturated":
        once = np.zeros(400, dtype=np.int64)
        once[[0, 200]] = 2000, -2000
    else:
        once = np.concatenate((np.full(330, 30), np.zeros(40), np.full(330, -30), np.zeros(40)))
    return np.resize(once.astype(np.int64), ticks)


def table_of(machine: Machine, rows: np.ndarray) -> TickTable:
    block = TickBlock(first_tick=0, counts=rows[:, None], operation=np.zeros(len(rows), np.int64))
    return TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(1, dtype=np.int64),
        blocks=Stream.of([block]),
        job_sha256="",
        machine_sha256=machine.sha256,
    )


class Loop:
    """The controller as a peer's user writes it: PD on counts, 12-bit DAC, zero on reversal."""

    def __init__(self, quantised: bool = True) -> None:
        self.error = self.level = 0.0
        self.quantised = quantised

    def volts(self, reference: float, theta: float) -> float:
        read = theta * COUNTS
        if self.quantised:
            read = np.floor(read + 0.5)
        error = reference - read
        level = 2 * error + 4 * (error - self.error)
        if self.quantised:
            level = np.rint(level)
        level = min(max(level, -2048.0), 2047.0)
        if self.quantised and level * self.level < 0:
            level = 0.0
        self.error, self.level = error, level
        return level * VOLT * GAIN


def seconds(call: Callable[[], Any], repeats: int = 9) -> float:
    """Return the shortest of some runs: the one that was disturbed least."""
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - start)
    return best


def ours_per_tick(case: str) -> float:
    machine = machine_of(case)
    commands = table_of(machine, rows_of(case, 100_000))

    def run() -> None:
        for _ in simulate(commands, machine, settle_s=0.0, record_every=20):
            pass

    run()
    return seconds(run) / 100_000


def clipped(case: str, volts: float, omega: float) -> float:
    current = (volts - KE * omega) / R
    return min(max(current, -LIMIT), LIMIT) if case == "saturated" else current


def scipy_run(case: str, ticks: int, quantised: bool, rtol: float = 1e-8) -> np.ndarray:
    """Return (ticks,) angles in rad at the ticks."""
    rows, loop = rows_of(case, ticks), Loop(quantised)
    x, reference, sign, angles = np.zeros(2), 0.0, 0, []
    for row in rows:
        angles.append(x[0])
        volts = loop.volts(reference, x[0])
        if case != "contact":

            def slope(_t: float, y: np.ndarray, u: float = volts) -> list[float]:
                return [y[1], KT * clipped(case, u, y[1]) / J]

            x = solve_ivp(slope, (0, H), x, rtol=rtol, atol=1e-10).y[:, -1]
        else:
            x, sign = _slip(x, sign, volts, rtol)
        reference += row
    return np.array(angles)


def _slip(x: np.ndarray, sign: int, volts: float, rtol: float) -> tuple[np.ndarray, int]:
    left = H
    while left > 0:
        if sign == 0:
            torque = KT * volts / R
            if abs(torque) <= BREAK:
                return np.array([x[0], 0.0]), 0
            sign = 1 if torque > 0 else -1

        def slope(_t: float, y: np.ndarray, s: int = sign) -> list[float]:
            return [y[1], (KT * (volts - KE * y[1]) / R - s * SLIDE) / J]

        def stops(_t: float, y: np.ndarray, s: int = sign) -> float:
            return s * y[1]

        stops.terminal, stops.direction = True, -1  # type: ignore[attr-defined]
        done = solve_ivp(slope, (0, left), x, rtol=rtol, atol=1e-10, events=stops)
        x, left = done.y[:, -1], left - done.t[-1]
        if done.status == 1:
            x, sign = np.array([x[0], 0.0]), 0
    return x, sign


def control_run(case: str, ticks: int) -> np.ndarray:
    import control

    rows = rows_of(case, ticks)
    references = np.concatenate(([0], np.cumsum(rows)[:-1])).astype(float)
    if case == "linear-quantised":
        generator = np.zeros((3, 3))
        generator[0, 1], generator[1, 1], generator[1, 2] = 1.0, -KT * KE / (R * J), KT / (R * J)
        E = expm(generator * H)

        def update(_t: float, x: np.ndarray, r: np.ndarray, _p: dict[str, Any]) -> np.ndarray:
            error = r[0] - np.floor(x[0] * COUNTS + 0.5)
            level = min(max(np.rint(2 * error + 4 * (error - x[2])), -2048.0), 2047.0)
            if level * x[3] < 0:
                level = 0.0
            u = level * VOLT * GAIN
            return np.array(
                [
                    E[0, 0] * x[0] + E[0, 1] * x[1] + E[0, 2] * u,
                    E[1, 0] * x[0] + E[1, 1] * x[1] + E[1, 2] * u,
                    error,
                    level,
                ]
            )

        whole = control.nlsys(
            update, lambda _t, x, _u, _p: x[:1], inputs=1, outputs=1, states=4, dt=H
        )
        times = np.arange(ticks) * H
        done = control.input_output_response(whole, times, references, np.zeros(4))
        return np.asarray(done.outputs).ravel()

    def slope(_t: float, x: np.ndarray, u: np.ndarray, _p: dict[str, Any]) -> np.ndarray:
        torque = KT * clipped(case, u[0], x[1])
        if case == "contact":
            # It has no events: friction opposes the speed, and holds below the breakaway torque.
            if abs(x[1]) < 1e-6 and abs(torque) <= BREAK:
                return np.array([0.0, -x[1] / H])
            torque -= SLIDE * np.sign(x[1] if abs(x[1]) >= 1e-6 else torque)
        return np.array([x[1], torque / J])

    plant = control.nlsys(slope, None, inputs=1, states=2)
    loop, x, angles = Loop(), np.zeros(2), []
    span = np.array([0.0, H])
    for reference in references:
        angles.append(x[0])
        volts = loop.volts(reference, x[0])
        done = control.input_output_response(plant, span, np.full(2, volts), x)
        x = np.asarray(done.states)[:, -1]
    return np.array(angles)


def inertias() -> np.ndarray:
    return J * (1 + 0.1 * np.linspace(-1.0, 1.0, VARIANTS))


def ours_batch(case: str) -> tuple[float, np.ndarray, float]:
    """Return s per tick and variant, loads of every 100th variant unquantised, the slow share."""
    machine = machine_of(case)
    commands = table_of(machine, rows_of(case, BATCH_TICKS[case]))
    variants = {"bodies.x.inertia": inertias()}

    def run(**more: Any) -> Any:
        return simulate_batch(
            commands, machine, variants, settle_s=0.0, watch_current=False, **more
        )

    result = run()
    few = {"bodies.x.inertia": inertias()[::100]}
    smooth = simulate_batch(
        commands,
        machine_of(case, reversal=False),
        few,
        settle_s=0.0,
        channels=("X.load",),
        quantised=False,
    ).samples["X.load"]
    slow = result.slow_ticks / (BATCH_TICKS[case] * VARIANTS)
    return seconds(run) / (BATCH_TICKS[case] * VARIANTS), smooth, slow


def jax_batch(  # noqa: PLR0915
    case: str, substeps: int
) -> tuple[Callable[[], float], np.ndarray]:
    """Return what measures s per tick and variant, and every 100th variant's load, unquantised."""
    import jax
    import jax.numpy as jnp
    from jax import lax

    jax.config.update("jax_enable_x64", True)
    # Per mode: matrices of one substep, (2, 4, V), columns angle, speed, volts, 1.
    constants = {"linear-quantised": (0.0,), "saturated": (0.0, LIMIT, -LIMIT),
                 "contact": (0.0, SLIDE, -SLIDE)}[case]  # fmt: skip
    tables = []
    for index, constant in enumerate(constants):
        columns = []
        for inertia in inertias():
            Z = np.zeros((4, 4))
            Z[0, 1] = 1.0
            if case == "saturated" and index:
                Z[1, 3] = KT * constant / inertia
            else:
                Z[1] = 0.0, -KT * KE / (R * inertia), KT / (R * inertia), -constant / inertia
            columns.append(expm(Z * H / substeps)[:2])
        stacked = np.moveaxis(np.array(columns), 0, -1)
        tables.append([[jnp.asarray(stacked[i, j]) for j in range(4)] for i in range(2)])
    rows = rows_of(case, BATCH_TICKS[case])
    references = jnp.asarray(np.concatenate(([0], np.cumsum(rows))).astype(float))

    def linear(m: int, theta: Any, omega: Any, u: Any) -> tuple[Any, Any]:
        P = tables[m]
        return tuple(P[i][0] * theta + P[i][1] * omega + P[i][2] * u + P[i][3] for i in range(2))  # type: ignore[return-value]

    def substep(theta: Any, omega: Any, u: Any) -> tuple[Any, Any]:
        if case == "linear-quantised":
            return linear(0, theta, omega, u)
        if case == "saturated":
            current = (u - KE * omega) / R
            picks = current > LIMIT, current < -LIMIT
            options = [linear(m, theta, omega, u) for m in range(3)]
            return tuple(
                jnp.where(
                    picks[0], options[1][i], jnp.where(picks[1], options[2][i], options[0][i])
                )
                for i in range(2)
            )  # type: ignore[return-value]
        torque = KT * u / R
        way = jnp.where(
            omega != 0, jnp.sign(omega), jnp.where(abs(torque) > BREAK, jnp.sign(torque), 0.0)
        )
        forth, back = linear(1, theta, omega, u), linear(2, theta, omega, u)
        moved = [jnp.where(way > 0, forth[i], back[i]) for i in range(2)]
        speed = jnp.where(moved[1] * way < 0, 0.0, moved[1])
        return jnp.where(way == 0, theta, moved[0]), jnp.where(way == 0, 0.0, speed)

    def run_of(quantised: bool) -> Any:
        def tick(carry: Any, reference: Any) -> tuple[Any, None]:
            theta, omega, before, last, worst = carry
            start = theta
            read = theta * COUNTS
            read = jnp.floor(read + 0.5) if quantised else read
            error = reference - read
            level = 2 * error + 4 * (error - before)
            level = jnp.clip(jnp.round(level) if quantised else level, -2048, 2047)
            if quantised:
                level = jnp.where(level * last < 0, 0.0, level)
            u = level * (VOLT * GAIN)
            if substeps == 1:
                theta, omega = substep(theta, omega, u)
            else:
                theta, omega = lax.fori_loop(
                    0, substeps, lambda _, x: substep(x[0], x[1], u), (theta, omega)
                )
            kept = None if quantised else start[::100]
            return (theta, omega, error, level, jnp.maximum(worst, abs(error))), kept

        zero = jnp.zeros(VARIANTS)
        return jax.jit(lambda refs: lax.scan(tick, (zero,) * 5, refs))

    quantised, smooth = run_of(True), run_of(False)
    driven = references[: BATCH_TICKS[case]]
    loads = np.asarray(smooth(driven)[1]) * COUNTS / 55.358e3

    def measure() -> float:
        jax.block_until_ready(quantised(driven))
        taken = seconds(lambda: jax.block_until_ready(quantised(driven)))
        return taken / (BATCH_TICKS[case] * VARIANTS)

    return measure, loads


def entry(
    name: str, ours: float, peer: str, value: float | None, unit: str, note: str
) -> dict[str, Any]:
    ratio = None if value is None else value / ours
    return {"name": name, "ours": ours, "peer": peer, "peer_value": value, "ratio": ratio,
            "unit": unit, "note": note}  # fmt: skip


def difference_um(case: str, other: np.ndarray) -> float:
    """Return the largest difference of the twin from a peer's angles, unquantised, in um."""
    machine = machine_of(case, reversal=False)
    commands = table_of(machine, rows_of(case, len(other)))
    load = simulate(commands, machine, quantised=False, settle_s=0.0).samples("X.load")[1]
    scale = COUNTS / machine.axes["X"].counts.si
    return float(np.abs(load[: len(other)] - other * scale).max() * 1e6)


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
    results += [against_jax(case) for case in CASES]
    return results


def against_jax(case: str) -> dict[str, Any]:
    """Measure a batch, JAX with as few substeps as bring it near enough."""
    name = f"twin batch vs jax, {case}"
    ours, loads, slow = ours_batch(case)
    apart_um = {}
    try:
        for substeps in SUBSTEPS:
            measure, peer = jax_batch(case, substeps)
            apart_um[substeps] = float(np.abs(loads[: len(peer)] - peer).max()) * 1e6
            if apart_um[substeps] < WITHIN_UM:
                break
    except ImportError:
        return entry(name, ours, "jax", None, "s/tick/variant", "jax isn't installed")
    taken = measure()
    return entry(
        name,
        ours,
        "jax vmap+scan f64",
        taken,
        "s/tick/variant",
        f"{VARIANTS} variants, {ours * 1e9:.2f} against {taken * 1e9:.2f} ns; {slow:.1%} of our "
        f"ticks with events; {substeps} substeps of jax, {apart_um[substeps]:.2g} um apart without "
        f"quantisers ({apart_um[1]:.2g} with one)",
    )
