"""What the sources claim and no command answers alone: ``python -m tools.claims NAME``.

Each function below is a NAME, which prints its answer as JSON; what stands behind a NAME on the
command line is given to it. ``tools/validation.py`` compares the answers with the pages, and tests
hold some of them against references of their own. Times are in s, lengths in m unless the key of a
figure says otherwise.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linprog
from scipy.signal import TransferFunction, step
from tools.control_plans import control_fastest, control_stitcher, control_winder

from threadline.dynamics.inverse import corner_responses
from threadline.dynamics.linear_model import linear_model
from threadline.dynamics.loop import axis_loops
from threadline.dynamics.pneumatic import frame_mode, network_of
from threadline.dynamics.robust_averages import frequencies_rad_s
from threadline.dynamics.values import Values
from threadline.files import Stream, TickBlock, TickTable
from threadline.machine import Machine, load_machine
from threadline.machine.controllers import Controller, PdController
from threadline.machine.model import Drive
from threadline.machine.numbers import with_numbers
from threadline.machine.parts import DcMotor
from threadline.machine.quantity import Quantity
from threadline.machine.vary import corners
from threadline.motion.laws import LAWS, Law, law
from threadline.motion.shaping import FlexibleMode, Shaper, convolve, design, vibration_of
from threadline.motion.shaping.law_residual import lasting_windows_s
from threadline.motion.shaping.mode_law import Demand, made_law, usual_jerk_m_s3
from threadline.search.broken_beam import break_sweeps
from threadline.twin import BatchOptions, simulate, simulate_batch

ROOT = Path(__file__).resolve().parent.parent
INCH = 25.4e-3
SIDE_M = 2.5 * INCH  # of the stitcher's test path
FITTING = (1.25, 0.952, 0.6)  # K, A, B of a lead filter on both axes that overshoots as printed


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


# --- the winder --------------------------------------------------------------------------------


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
    machine: Machine, band: float, quantised: bool = False, step_counts: int = 100
) -> dict[str, tuple[float, float]]:
    """Return overshoot and settling time of each axis after a step of as many counts."""
    counts = np.zeros((1, len(machine.axes)), dtype=np.int64)
    counts[0] = step_counts
    recording = simulate(table(machine, counts), machine, settle_s=3.0, quantised=quantised)
    found = {}
    for axis in machine.axis_names:
        times, load = recording.samples(f"{axis}.load")
        response = load[1:] * machine.axes[axis].counts.si / step_counts
        found[axis] = overshoot_and_settling(times[1:] - times[1], response, band)
    return found


def winder_step(gain: str) -> dict[str, Any]:
    """Figure 7-5: X by equation 7-12 with gain 1 in continuous time, and the twin by Kp 2, Kd 4."""
    machine = changed(load_machine("lathe-winder"), gain=float(gain))
    model = next(m for m in linear_model(machine) if "sensors.x" in m.outputs)
    # From volts to counts; the thesis counts DAC levels, so that 20 V / 4096 belong to it.
    sensor = model.C[model.outputs.index("sensors.x")]
    velocity_gain = float(sensor @ model.A @ model.B[:, 0]) * 20 / 4096
    pole, lead_s = -float(model.poles().real.min()), 0.005
    closed = TransferFunction(
        [velocity_gain * lead_s, velocity_gain],
        [1.0, pole + velocity_gain * lead_s, velocity_gain],
    )
    times, response = step((closed.num, closed.den), T=np.linspace(0.0, 1.0, 20_001))
    settled = [overshoot_and_settling(times, response, band) for band in (0.02, 0.005)]
    poles = np.sort_complex(closed.poles)
    return {
        "poles": [[float(p.real), float(p.imag)] for p in poles],
        "settling_s": [settled[0][1], settled[1][1]],
        "overshoot": settled[0][0],
        "twin_settling_s": twin_step(machine, 0.02)["X"][1],
    }


def winder_reversal(reference: str, feed: str) -> dict[str, float]:
    """Figure 10-3: X 10 000 counts forth and back in linear moves of ``feed`` counts a tick.

    ``past_m`` is how far the load runs past the turning point, below 0 where it stops short;
    ringing is the range of the load later than 0.1 s after the commands have ended; swings are the
    reversals of more than 0.05 mm after the turn.
    """
    machine = load_machine(reference)
    out = np.full(10_000 // int(feed), int(feed))
    out[-1] += 10_000 - out.sum()
    counts = np.zeros((2 * len(out), len(machine.axes)), dtype=np.int64)
    counts[:, machine.axis_names.index("X")] = np.concatenate((out, -out))
    recording = simulate(table(machine, counts), machine, settle_s=1.5)
    times, load = recording.samples("X.load")
    after = load[times > times[len(counts)] + 0.1]
    error = load - recording.samples("X.commanded")[1]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(error))) != 0) + 1
    late = turns[turns > len(out)]
    return {
        "past_m": float(load.max()) - 10_000 / machine.axes["X"].counts.si,
        "ringing_m": float(np.ptp(after)),
        "swings": int((np.abs(np.diff(error[late])) > 5e-5).sum()),
    }


def winder_proportional(reference: str) -> dict[str, Any]:
    """Section 5.8: settling within 5 % under P alone, the longest of four gains and three axes."""
    settling = [
        settled
        for kp in (0.5, 1.0, 2.0, 4.0)
        for _, settled in twin_step(
            changed(load_machine(reference), kp=kp, kd=0.0), 0.05, quantised=True, step_counts=500
        ).values()
    ]
    never = [s for s in settling if not np.isfinite(s)]
    return {"longest_s": None if never else max(settling), "never": len(never)}


def winder_one_set(reference: str, tick_ms: str) -> dict[str, Any]:
    """Section 5.8: sets of gains that serve every axis, of 42, and the overshoots of Kp 2, Kd 4.

    A set serves if the overshoot is at most 10 % and the step settled within 5 % in 0.25 s.
    """
    machine = load_machine(reference)

    def steps(kp: float, kd: float) -> dict[str, tuple[float, float]]:
        return twin_step(changed(machine, kp=kp, kd=kd, tick_ms=int(tick_ms)), 0.05)

    serve = sum(
        all(over <= 0.10 and settled <= 0.25 for over, settled in steps(kp, kd).values())
        for kp in (0.5, 1.0, 2.0, 3.0, 4.0, 6.0)
        for kd in (0.0, 1.0, 2.0, 4.0, 8.0, 12.0, 16.0)
    )
    return {"serve": serve, "overshoot": [over for over, _ in steps(2.0, 4.0).values()]}


# --- the stitcher ------------------------------------------------------------------------------


def trapezoid(time_s: np.ndarray, speed: float, acceleration: float) -> np.ndarray:
    """Return the places of one side of the test path, equations 3.11 to 3.13, in m."""
    ramp = speed / acceleration
    end = SIDE_M / speed + ramp
    t = np.clip(time_s, 0.0, end)
    up, down = acceleration * t**2 / 2, SIDE_M - acceleration * (end - t) ** 2 / 2
    steady = speed * (t - ramp / 2)
    return np.asarray(np.where(t < ramp, up, np.where(t < end - ramp, steady, down)))


def three_sides(
    machine: Machine, speed: float, acceleration: float, starts_s: float, rests: int = 0
) -> TickTable:
    """Return the commands of X, Y, X, a side each ``starts_s``, every 1 ms (m/s, m/s2, s).

    ``rests`` is how many rows of rest come before them.
    """
    time_s = np.arange(int(1e3 * (2 * starts_s + 0.4 + speed / acceleration))) * 1e-3
    x = trapezoid(time_s, speed, acceleration)
    x = x + trapezoid(time_s - 2 * starts_s, speed, acceleration)
    y = trapezoid(time_s - starts_s, speed, acceleration)
    place = np.rint(np.stack([x, y], axis=1) * machine.counts_per_unit).astype(np.int64)
    return table(machine, np.pad(np.diff(place, axis=0), ((rests, 0), (0, 0))))


def overshoots_m(
    machine: Machine, filters: np.ndarray, others: dict[str, np.ndarray] | None = None
) -> dict[str, np.ndarray]:
    """Return how far each of (n, 3) filters K, A, B, on both axes, lets the head run past.

    The test path at 7.5 in/s and 281 in/s2, each side begun when the last has ended; ``others``
    are numbers of the machine, of n values each.
    """
    variants = {
        f"controllers.{axis}.{name}": filters[:, column]
        for axis in "xy"
        for column, name in enumerate(("gain", "zero", "pole"))
    }
    speed, acceleration = 7.5 * INCH, 281 * INCH
    whole_s = np.ceil(1e3 * (SIDE_M / speed + speed / acceleration) + 1) * 1e-3
    found = simulate_batch(
        three_sides(machine, speed, acceleration, float(whole_s), rests=1), machine,
        {**variants, **(others or {})},
        options=BatchOptions(window_s=0.0, settle_s=0.4, watch_current=False),
    )  # fmt: skip
    assert found.highest is not None
    past = found.highest - SIDE_M * np.array([2.0, 1.0])
    return {axis: past[:, i] for i, axis in enumerate("XY")}


def stitcher_overshoot(reference: str, *numbers: str) -> dict[str, float]:
    """Overshoot of X and Y with the filter ``FITTING``.

    ``numbers`` are numbers of the machine that are changed, such as ``links.x_belt.play=1e-4``.
    """
    others = {n.partition("=")[0]: np.array([float(n.partition("=")[2])]) for n in numbers}
    found = overshoots_m(load_machine(reference), np.array([FITTING]), others)
    return {f"{axis}_m": float(past[0]) for axis, past in found.items()}


def stitcher_two_stitches(stitches_per_s: str) -> dict[str, float]:
    """Least error of X's speed, as a share, behind the two stitches in which a leg begins.

    A bound over one plan for nine machines of the stitcher: loads and springs at the ends of their
    tolerances and as typed. Every one has 95 % of the speed two turns of the needle after the first
    movement, and its current stays below the limit of the amplifier. Left out are quantisers, days,
    the other axis, and limits of place but for 0.5 mm at the first needle-down. The load as typed
    may have 1 % of its speed before the first movement. Commands are cubic splines with a knot
    every tenth of a turn; the needle comes down from 0.2 to 0.6 of a turn behind the movement.
    """
    machine, turn_s = load_machine("stitcher"), 1.0 / float(stitches_per_s)
    speed, step_s, samples = 0.1 * INCH / turn_s, turn_s / 10, 4096
    grid_s, now = step_s / 4, samples // 4
    omega = frequencies_rad_s(grid_s, samples)
    shift_s = np.arange(-20, 50) * step_s + now * grid_s
    shape = np.sinc(omega * step_s / (2.0 * np.pi))[:, None] ** 4 * np.exp(
        -1j * omega[:, None] * shift_s
    )
    turns = (np.arange(samples) - now) * grid_s / turn_s
    limit = machine.motors["x"].amplifier.current_limit
    assert limit is not None
    answers = [
        [
            np.cumsum(np.fft.irfft(part[:, None] * shape, samples, axis=0), axis=0)
            for part in (one.load, one.current_s_a_m * (speed / limit.si))
        ]
        for one in corner_responses(machine, "X", corners(machine), omega)
        if one.current_s_a_m is not None
    ]
    found = {}
    for needle in (0.2, 0.3, 0.4, 0.5, 0.6):
        own = answers[0][0]
        way = np.cumsum(own, axis=0)[[np.searchsorted(turns, needle)]] * (grid_s * speed / 5e-4)
        held = [(own[(turns > -4.0) & (turns <= 0.0)][::4], 0.01), (way, 1.0)]
        rows, limits = [], []
        for load, current in answers:
            held.append((current[(turns >= -1.0) & (turns < 5.0)][::4], 1.0))
            there = load[(turns >= 2.0 - 2e-3 / turn_s) & (turns <= 2.0)].mean(axis=0)
            rows.append(np.append(-there, 0.0)[None])
            limits.append(np.array([-0.95]))
            even = load[(turns >= 2.0 + needle) & (turns < 2.0 + needle + 0.2 / turn_s)][::4]
            for sign in (1.0, -1.0):
                rows.append(np.hstack([sign * even, np.full((len(even), 1), -1.0)]))
                limits.append(np.full(len(even), sign))
        for part, most in held:
            for sign in (1.0, -1.0):
                rows.append(np.hstack([sign * part, np.zeros((len(part), 1))]))
                limits.append(np.full(len(part), most))
        cost = np.append(np.zeros(len(shift_s)), 1.0)
        bounds = [(-10.0, 10.0)] * len(shift_s) + [(0.0, 10.0)]
        solved = linprog(
            cost, np.vstack(rows), np.concatenate(limits), 1.0 - cost[None], [1.0], bounds
        )
        if solved.status != 0 or solved.fun is None:
            raise ValueError(f"no bound at {stitches_per_s} stitches a second: {solved.message}")
        found[f"{needle:g}"] = float(solved.fun)
    return {"least_error": min(found.values())}


def stitcher_proportional(kp_v_rad: str) -> dict[str, Any]:
    """A right-angle corner under P alone, linear sampled model: missed by, and overshot by.

    X 2.5 in, Y 2.5 in at 7.5 in/s and 546 in/s2; Y starts as X decelerates.
    """
    acceleration, step_s = 546 * INCH, 1e-3
    ramp_s = round(7.5 * INCH / acceleration / step_s) * step_s
    speed = acceleration * ramp_s
    machine = load_machine("stitcher-rigid+proportional")
    volts = 10 / 128 * 8000 / (2 * np.pi)  # of a DAC level, times counts of a radian
    kp = np.array([float(kp_v_rad) / volts])
    values = Values.of(machine, {f"controllers.{c}.kp": kp for c in "xy"})
    t, tracks = np.arange(0, 1.1, step_s), []
    for axis, start_s in (("X", 0.0), ("Y", SIDE_M / speed)):
        loop = axis_loops(machine, values)[axis]
        closed = loop.closed()
        ticks = np.floor(np.arange(0, 1.05, loop.period_s) / step_s + 1e-9).astype(int)
        place = trapezoid(t - start_s, speed, acceleration)
        counts = place[ticks, None] * loop.counts_per_unit
        tracks.append(closed.respond(counts)[:, closed.outputs.index(f"{axis}.load")])
    x, y = tracks
    return {
        "missed_m": float(np.hypot(x - SIDE_M, y).min()),
        "overshot_m": [float(track.max() - SIDE_M) for track in tracks],
    }


def stitcher_corners(reference: str, limit_a: str = "") -> dict[str, list[float]]:
    """The thesis's redesigned path: 7.8 in/s, 1092 in/s2, a side begins as the last decelerates.

    For X and Y: time to 95 % of 7.8 and of 7.5 in/s, and share of the time at the 27 A of the
    amplifier; the miss of both corners; the largest current. ``limit_a`` is another limit, A.
    """
    machine = load_machine(reference)
    if limit_a:
        machine = with_numbers(
            machine, {f"drives.{d}.amplifier.current_limit": float(limit_a) for d in "xy"}
        )
    speed, acceleration = 7.8 * INCH, 1092 * INCH
    starts_s = SIDE_M / speed
    commands = three_sides(machine, speed, acceleration, starts_s)
    blocks = list(simulate(commands, machine))
    found = {k: np.concatenate([b.samples[k] for b in blocks]) for k in blocks[0].samples}
    tick_s = np.arange(len(found["X.load"])) * 1e-3
    until: dict[float, list[float]] = {7.8: [], 7.5: []}
    for axis, start_s in (("X", 0.0), ("Y", starts_s)):
        velocity = np.abs(np.gradient(found[f"{axis}.load"], 1e-3))
        for inches, times in until.items():
            level = 0.95 * inches * INCH
            at = int(np.flatnonzero((velocity >= level) & (tick_s > start_s))[0])
            share = (level - velocity[at - 1]) / (velocity[at] - velocity[at - 1])
            times.append(float(tick_s[at - 1]) + 1e-3 * float(share) - start_s)
    load = np.stack([found["X.load"], found["Y.load"]], axis=1)
    corners = ([SIDE_M, 0.0], [SIDE_M, SIDE_M])
    current = [np.abs(found[f"{axis}.current_peak"]) for axis in "XY"]
    rows = sum(len(block.counts) for block in commands.blocks)
    return {
        "until_95_s": until[7.8],
        "until_75_s": until[7.5],
        "corner_m": [float(np.linalg.norm(load - c, axis=1).min()) for c in corners],
        "peak_a": [float(amperes.max()) for amperes in current],
        "clamped": [float((amperes > 27.0 - 1e-9).sum() / rows) for amperes in current],
    }


# --- the letter placer -------------------------------------------------------------------------


def placer_model() -> dict[str, Any]:
    """Eigenvalues of table, cylinder and head, in the order of their size, and the slow mode."""
    machine = load_machine("letter-placer")
    piece = network_of(machine, "X")
    found = np.linalg.eigvals(piece.base[0][:, : len(piece.states)])
    found = found[found.imag > -1e-9]
    kept = found[np.argsort(-np.abs(found))]
    hertz, damping = frame_mode(machine, "X")
    return {"poles": [[float(p.real), float(p.imag)] for p in kept], "hz": hertz, "zeta": damping}


def placer_left(hertz: str, damping: str) -> dict[str, float]:
    """What the paper's trains leave of a step on a mode: ZV, UM, both, and ZV with wrong levels."""
    mode, paper = FlexibleMode(float(hertz), float(damping)), FlexibleMode(3.04, 0.17)
    zv, um = design("zv", paper), design("um-2ei", paper)
    levels = {
        "swapped": zv.amplitudes[::-1], "both_high": [zv.amplitudes[0]] * 2, "both_half": [0.5] * 2
    }  # fmt: skip
    wrong = {name: Shaper(amplitudes=np.array(a), times_s=zv.times_s) for name, a in levels.items()}
    trains = {"zv": zv, "um": um, "both": convolve(zv, um), **wrong}
    return {name: vibration_of(train, mode) for name, train in trains.items()}


def placer_beam() -> dict[str, dict[str, float]]:
    """The frame's ringing if the light grid shuts the valves at any millisecond of a stroke, m."""
    found = {}
    for sweep in break_sweeps(load_machine("letter-placer")):
        sizes = sweep.ringing_m
        found[sweep.name] = {"worst_m": float(sizes.max()), "over_level": sweep.over_level}
    return found


# --- the embroidery frame ----------------------------------------------------------------------


def still_s(motion: Law, hertz: float) -> float:
    """Return the window from which on every longer one leaves at most 0.05 mm, +-10 % of a mode."""
    windows = [
        lasting_windows_s(motion, FlexibleMode(ratio, 0.02), np.array([0.0165]), 5e-5)
        for ratio in np.linspace(0.9, 1.1, 9)
    ]
    return float(np.max(windows)) / hertz


def frame_demand(hertz: str, factor: str = "1") -> Demand:
    """16.5 mm on a mode of damping ratio 0.02, at most 0.05 mm left over +-10 % of it.

    At ``factor`` times the peak acceleration of modified sine in 120 ms.
    """
    move_m = 0.0165
    acceleration = float(factor) * law("modified-sine").acceleration * move_m / 0.12**2
    return Demand(
        mode=FlexibleMode(float(hertz), 0.02), band=0.1, move_m=move_m, residual_m=5e-5,
        acceleration_m_s2=acceleration, jerk_m_s3=usual_jerk_m_s3(move_m, acceleration),
    )  # fmt: skip


def ordinary_windows(demand: Demand, names: Iterable[str]) -> dict[str, float]:
    """Return the window of each law from which on every longer one meets the demand."""
    limit, move_m = demand.acceleration_m_s2, demand.move_m
    return {
        name: max(
            still_s(law(name), demand.mode.frequency_hz),
            float(np.sqrt(law(name).acceleration * move_m / limit)),
        )
        for name in names
    }


def frame_windows(hertz: str, factor: str = "1") -> dict[str, float]:
    """Windows of ``frame_demand`` with ordinary laws, and with the law made for the mode."""
    demand = frame_demand(hertz, factor)
    ordinary = ("trapezoid", "double-parabola", "simple-harmonic", "modified-sine")
    found = ordinary_windows(demand, ordinary)
    made = made_law(demand)
    found |= {"made": made.window_s, "free_levels": made.free_levels_s, "rigid": demand.rigid_s}
    return found | {"speed": found["modified-sine"] / made.window_s}


def frame_best(hertz: str) -> dict[str, float]:
    """Windows of ``frame_demand`` with every law by name, and the made law's gain on the best."""
    demand = frame_demand(hertz)
    found = ordinary_windows(demand, LAWS)
    best = min(found.values())
    return found | {"best": best, "speed": best / made_law(demand).window_s}


NAMES: dict[str, Callable[..., Any]] = {
    f.__name__.replace("_", "-"): f
    for f in (
        winder_step, winder_reversal, winder_proportional, winder_one_set, stitcher_overshoot,
        stitcher_proportional, stitcher_corners, stitcher_two_stitches, placer_model,
        placer_left, placer_beam, frame_windows, frame_best, control_stitcher, control_fastest,
        control_winder,
    )
}  # fmt: skip


def answers(name: str, *text: str) -> Any:
    """Return the answer of a NAME."""
    return NAMES[name](*text)


if __name__ == "__main__":
    print(json.dumps(answers(*sys.argv[1:]), indent=1))
