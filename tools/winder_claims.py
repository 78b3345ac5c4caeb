"""What the winder thesis claims of its control, run on the twin: ``python -m tools.winder_claims``.

Prints the tables that ``docs/results.md`` quotes, as Markdown, each beside the printed figures.
"""

from __future__ import annotations

import dataclasses
from fractions import Fraction

import numpy as np
from scipy.signal import TransferFunction, step

from threadline.dynamics.linear_model import linear_model
from threadline.files import Stream, TickBlock, TickTable
from threadline.machine import Machine
from threadline.machine.controllers import Controller, PdController
from threadline.machine.load import load_machine
from threadline.machine.model import Drive
from threadline.machine.parts import DcMotor
from threadline.machine.quantity import Quantity
from threadline.twin import simulate

DERIVATIVE_S = 0.005
STEP_COUNTS = 100
"""Small enough that the 4 A limit is not reached by voltage at the printed gains."""
LARGE_STEP_COUNTS = 500
"""Enough to overcome the friction of the overlay ``stiction``."""
AXES = ("A", "X", "Y")
Row = tuple[str, ...]


def changed(
    machine: Machine,
    *,
    kp: float | None = None,
    kd: float | None = None,
    gain: float | None = None,
    tick_ms: int | None = None,
) -> Machine:
    """Return ``machine`` with other gains on all axes, or another tick."""

    def scaled(quantity: Quantity, value: float | None) -> Quantity:
        return quantity if value is None else dataclasses.replace(quantity, si=value)

    controllers: dict[str, Controller] = {
        name: dataclasses.replace(c, kp=scaled(c.kp, kp), kd=scaled(c.kd, kd))
        for name, c in machine.controllers.items()
        if isinstance(c, PdController)
    }
    drives: dict[str, Drive] = {
        name: dataclasses.replace(
            d, amplifier=dataclasses.replace(d.amplifier, gain=scaled(d.amplifier.gain, gain))
        )
        for name, d in machine.drives.items()
        if isinstance(d, DcMotor)
    }
    clocks = dict(machine.clocks)
    if tick_ms is not None:
        period = Fraction(tick_ms, 1000)
        clocks["servo"] = dataclasses.replace(clocks["servo"], si=float(period), exact_s=period)
    return dataclasses.replace(machine, controllers=controllers, drives=drives, clocks=clocks)


def table(machine: Machine, counts: np.ndarray) -> TickTable:
    """Return commands of (ticks, axes) counts."""
    block = TickBlock(first_tick=0, counts=counts, operation=np.zeros(len(counts), dtype=np.int64))
    return TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(len(machine.axes), dtype=np.int64),
        blocks=Stream.of([block]),
        job_sha256="",
        machine_sha256=machine.sha256,
    )


def overshoot_and_settling(
    times_s: np.ndarray, response: np.ndarray, band: float
) -> tuple[float, float]:
    """Return the overshoot as a fraction and the time after which a unit step stays in ``band``."""
    outside = np.flatnonzero(np.abs(response - 1.0) > band)
    settled = 0.0 if not len(outside) else float(times_s[min(outside[-1] + 1, len(times_s) - 1)])
    if len(outside) and outside[-1] == len(times_s) - 1:
        settled = np.inf
    return max(0.0, float(response.max()) - 1.0), settled


def twin_step(
    machine: Machine, quantised: bool = False, step_counts: int = STEP_COUNTS
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return, per axis, times and the load's response to a step, 1 being the step."""
    counts = np.zeros((1, len(machine.axes)), dtype=np.int64)
    counts[0] = step_counts
    recording = simulate(table(machine, counts), machine, settle_s=3.0, quantised=quantised)
    responses = {}
    for axis in machine.axis_names:
        times, load = recording.samples(f"{axis}.load")
        responses[axis] = (
            times[1:] - times[1],
            load[1:] * machine.axes[axis].counts.si / step_counts,
        )
    return responses


def figure_7_5() -> list[Row]:
    """Return the step response of X for three amplifier gains, continuous and on the twin."""
    printed = {0.2: "> 500 ms", 0.45: "125 ms, no overshoot", 2.0: "50 ms, overshoot"}
    rows: list[Row] = []
    times = np.linspace(0.0, 1.0, 20_001)
    for gain, said in printed.items():
        machine = changed(load_machine("lathe-winder"), gain=gain)
        model = next(m for m in linear_model(machine) if "sensors.x" in m.outputs)
        # From volts to counts; the thesis counts DAC levels, so that 20 V / 4096 belong to it.
        sensor = model.C[model.outputs.index("sensors.x")]
        velocity_gain = float(sensor @ model.A @ model.B[:, 0]) * 20 / 4096
        pole = -float(model.poles().real.min())
        closed = TransferFunction(
            [velocity_gain * DERIVATIVE_S, velocity_gain],
            [1.0, pole + velocity_gain * DERIVATIVE_S, velocity_gain],
        )
        _, response = step((closed.num, closed.den), T=times)
        over, settled_half = overshoot_and_settling(times, response, 0.005)
        _, settled_2 = overshoot_and_settling(times, response, 0.02)
        poles = np.sort_complex(closed.poles)
        response_times, sampled = twin_step(machine)["X"]
        over_twin, settled_twin = overshoot_and_settling(response_times, sampled, 0.02)
        rows.append(
            (
                f"{gain}",
                said,
                ", ".join(f"{p.real:.1f}{p.imag:+.1f}j" for p in poles),
                f"{1e3 * settled_2:.0f} ... {1e3 * settled_half:.0f}",
                f"{100 * over:.1f}",
                f"{1e3 * settled_twin:.0f}",
                f"{100 * over_twin:.1f}",
            )
        )
    return rows


def turning_point(feed: int, machine: Machine) -> tuple[float, float, int]:
    """Return by how much X misses 10 000 counts, in mm, its ringing after, and its reversals.

    Positive is past the point, negative short of it. Ringing is the range of the load later than
    0.1 s after the commands have ended; reversals of more than 0.05 mm are counted from the turn.
    """
    out = np.full(10_000 // feed, feed)
    out[-1] += 10_000 - out.sum()
    counts = np.zeros((2 * len(out), len(machine.axes)), dtype=np.int64)
    counts[:, machine.axis_names.index("X")] = np.concatenate((out, -out))
    recording = simulate(table(machine, counts), machine, settle_s=1.5)
    times, load = recording.samples("X.load")
    aim = 10_000 / machine.axes["X"].counts.si
    after = load[times > times[len(counts)] + 0.1]
    error = load - recording.samples("X.commanded")[1]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(error))) != 0) + 1
    late = turns[turns > len(out)]
    swings = int((np.abs(np.diff(error[late])) > 5e-5).sum())
    return 1e3 * (float(load.max()) - aim), 1e3 * float(np.ptp(after)), swings


def figure_10_3() -> list[Row]:
    """Return how X turns under linear interpolation, for both amplifiers and both supplies."""
    rows: list[Row] = []
    for mode in ("", "+8A", "+current", "+physical", "+physical+current"):
        machine = load_machine("lathe-winder" + mode)
        for feed in (10, 20, 30, 80):
            miss, ringing, swings = turning_point(feed, machine)
            speed = feed / 0.005 / machine.axes["X"].counts.si * 1e3
            rows.append(
                (mode or "printed", f"{feed}", f"{speed:.0f}", f"{miss:+.2f}", f"{ringing:.3f}",
                 f"{swings}")
            )  # fmt: skip
    return rows


def proportional_only() -> list[Row]:
    """Return the step response under P alone: 5.8 says that it oscillates heavily."""
    rows: list[Row] = []
    for mode in ("", "+current", "+stiction", "+current+stiction"):
        for kp in (0.5, 1.0, 2.0, 4.0):
            machine = changed(load_machine("lathe-winder" + mode), kp=kp, kd=0.0)
            responses = twin_step(machine, quantised=True, step_counts=LARGE_STEP_COUNTS)
            cells = []
            for axis in AXES:
                times, response = responses[axis]
                over, settled = overshoot_and_settling(times, response, 0.05)
                cells.append(f"{100 * over:.0f} % / {_ms(settled)}")
            rows.append((mode or "voltage", f"{kp:g}", *cells))
    return rows


def _ms(time_s: float) -> str:
    return "never" if not np.isfinite(time_s) else f"{1e3 * time_s:.0f} ms"


def one_set_for_all(
    kp: float, kd: float, tick_ms: int, mode: str
) -> dict[str, tuple[float, float]]:
    """Return overshoot and 5 % settling time of each axis for one set of gains."""
    machine = changed(load_machine("lathe-winder" + mode), kp=kp, kd=kd, tick_ms=tick_ms)
    return {
        axis: overshoot_and_settling(times, response, 0.05)
        for axis, (times, response) in twin_step(machine).items()
    }


def serves_all(axes: dict[str, tuple[float, float]]) -> bool:
    """Whether one set of gains serves every axis: overshoot within 10 %, settled within 0.25 s."""
    return all(over <= 0.10 and settled <= 0.25 for over, settled in axes.values())


def claim_5_8() -> tuple[list[Row], list[Row]]:
    """Return where one set of gains serves all axes: details at 2, 4, and counts over a grid."""
    detail: list[Row] = []
    summary: list[Row] = []
    grid_p, grid_d = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0), (0.0, 1.0, 2.0, 4.0, 8.0, 12.0, 16.0)
    for mode in ("", "+current"):
        for tick in (5, 10):
            axes = one_set_for_all(2.0, 4.0, tick, mode)
            cells = [f"{100 * axes[a][0]:.1f} % / {_ms(axes[a][1])}" for a in AXES]
            detail.append((mode or "voltage", f"{tick}", *cells))
            good = [
                (kp, kd)
                for kp in grid_p
                for kd in grid_d
                if serves_all(one_set_for_all(kp, kd, tick, mode))
            ]
            # The same damping in seconds needs half the Kd per difference at twice the tick.
            summary.append(
                (mode or "voltage", f"{tick}", f"{len(good)} of {len(grid_p) * len(grid_d)}",
                 ", ".join(f"{kp:g}/{kd:g}" for kp, kd in good) or "none")
            )  # fmt: skip
    return detail, summary


def show(title: str, head: Row, rows: list[Row]) -> None:
    """Print a table as Markdown."""
    print(f"\n{title}\n\n| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for row in rows:
        print(f"| {' | '.join(row)} |")


def main() -> None:
    """Print every table."""
    show(
        "Figure 7-5: X, eq 7-12 with gain 1 (continuous), and the twin with Kp 2, Kd 4 at 5 ms",
        ("Kamp", "printed", "poles 1/s", "settling ms (2 ... 0.5 %)", "overshoot %",
         "twin settling ms (2 %)", "twin overshoot %"),
        figure_7_5(),
    )  # fmt: skip
    show(
        "Figure 10-3: X 0 -> 180.6 -> 0 mm, linear; + is past the turning point, - short of it",
        ("machine", "feed count/tick", "mm/s", "turning point mm", "ringing mm", "swings"),
        figure_10_3(),
    )
    show(
        f"5.8, P alone: step of {LARGE_STEP_COUNTS} counts, overshoot / settling within 5 %",
        ("amplifier", "Kp", *AXES),
        proportional_only(),
    )
    detail, summary = claim_5_8()
    show(
        "5.8, one set of gains for all axes: Kp 2, Kd 4, overshoot / settling within 5 %",
        ("amplifier", "tick ms", *AXES),
        detail,
    )
    show(
        "5.8, sets Kp/Kd with overshoot within 10 % and settling within 0.25 s on every axis",
        ("amplifier", "tick ms", "sets", "which"),
        summary,
    )


if __name__ == "__main__":
    main()
