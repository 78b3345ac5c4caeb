"""Vibration of an on/off machine's frame after a light barrier was interrupted.

The amplitude is calculated from the residues of the frame's mode, for a scheduled move and with
every kind of shaper. The twin simulates the same breaks independently of the residues.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.intents import Scheduled, ScheduledMove
from threadline.dynamics.pneumatic import StepRinging, flow_mode, step_ringing
from threadline.machine import Machine
from threadline.motion.shaping import FlexibleMode, Shaper, convolve, design
from threadline.motion.shaping.types import UNSHAPED
from threadline.twin.switching import SwitchOptions, ringing_m, simulate_switching

KINDS = ("zv", "zvd", "um-zv", "um-zvd", "um-ei", "um-2ei", "zv*um-2ei", "negative-zv")


@dataclass(frozen=True, slots=True, eq=False)
class BreakSweep:
    """Vibration of the frame after a broken light barrier, over the instant of the break.

    Parameters
    ----------
    name
        Name of the shaper.
    times_s, ringing_m
        (n,) instants of the break since the move began, s; (n,) amplitude of the frame after the
        valves shut, m.
    over_level
        Largest excess of the command's level over 1 or below 0.
    """

    name: str
    times_s: FloatArray
    ringing_m: FloatArray
    over_level: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BrokenBeam:
    """Vibration after a broken beam: for the longest move, and with every kind of shaper.

    Parameters
    ----------
    sweeps
        First the scheduled move, then a full stroke, unshaped and with every shaper.
    instants_s, simulated_m
        (n,) instants at which the valves shut, s since the scheduled move began; (n,) amplitude of
        the frame on the simulated machine, m.
    """

    sweeps: tuple[BreakSweep, ...]
    instants_s: FloatArray
    simulated_m: FloatArray


def broken_beam(scheduled: Scheduled) -> BrokenBeam | None:
    """Return the vibration after a break in the longest move; None if no cylinder moves."""
    # Every cylinder starts retracted, so its first move is forward.
    forward = [move for move in scheduled.moves if move.forward]
    if not forward:
        return None
    longest = max(forward, key=lambda move: move.levels.wanted_m)
    sweep, (instants_s, simulated_m) = move_sweep(scheduled, longest)
    return BrokenBeam(
        sweeps=(sweep, *break_sweeps(scheduled.machine, longest.axis)),
        instants_s=instants_s,
        simulated_m=simulated_m,
    )


def train_of(kind: str, mode: FlexibleMode) -> Shaper:
    """Return the shaper named ``kind`` for ``mode``: kinds joined by ``*``, or ``none``."""
    if kind == "none":
        return UNSHAPED
    return convolve(*(design(word, mode) for word in kind.split("*")))


def level_steps(shaper: Shaper, on_s: float) -> tuple[FloatArray, FloatArray]:
    """Return times, s, and heights, (n,) each, of the level steps of a shaped move.

    ``on_s`` is the time, s, for which the unshaped command is on.
    """
    times = np.concatenate((shaper.times_s, shaper.times_s + on_s))
    heights = np.concatenate((shaper.amplitudes, -shaper.amplitudes))
    order = np.argsort(times, kind="stable")
    return times[order], heights[order]


def break_sweep(name: str, shaper: Shaper, on_s: float, ringing: StepRinging) -> BreakSweep:
    """Return the vibration after a break at each millisecond of a move with on-time ``on_s``.

    All valves shut at the break. The vibration is a sum of terms: each level step before the break
    adds its decayed vibration, and the step of the level down to 0 adds its own.
    """
    return sweep_of_steps(name, *level_steps(shaper, on_s), ringing)


def sweep_of_steps(
    name: str, steps: FloatArray, heights: FloatArray, ringing: StepRinging
) -> BreakSweep:
    """Return the sweep of a command whose level steps by ``heights`` at the times ``steps``, s."""
    times = np.arange(0.0, steps[-1] + 0.2, 1e-3)
    has_stepped = steps[None, :] <= times[:, None] + 1e-12
    elapsed_s = np.where(has_stepped, times[:, None] - steps[None, :], 0.0)
    decaying = np.where(has_stepped, heights[None, :] * np.exp(ringing.pole * elapsed_s), 0.0).sum(
        axis=1
    )
    level = np.where(has_stepped, heights[None, :], 0.0).sum(axis=1)
    amplitude_m = np.abs(ringing.amplitude_m * (decaying - level))
    levels = np.cumsum(heights)
    return BreakSweep(name, times, amplitude_m, float(max(0.0, levels.max() - 1.0, -levels.min())))


def break_sweeps(machine: Machine, axis: str = "X") -> list[BreakSweep]:
    """Return the sweeps of a full stroke: one without a shaper, and one for each kind of shaper."""
    cylinder = machine.cylinders[axis]
    on_s, ringing = cylinder.stroke.si / cylinder.speed.si, step_ringing(machine, axis)
    mode = FlexibleMode(*flow_mode(machine, axis))
    return [break_sweep(kind, train_of(kind, mode), on_s, ringing) for kind in ("none", *KINDS)]


def break_on_twin(scheduled: Scheduled, move: ScheduledMove, scans: IntArray) -> FloatArray:
    """Return the simulated amplitude, (n,) m, if the valves shut n ``scans`` after a move began.

    The move is simulated alone, from the start of the stroke. A light barrier is interrupted half a
    scan before the valves shut. Each amplitude refers to the instant at which the valves shut: a
    sine is fitted to the frame's motion after lag and dead time, and extrapolated back.
    """
    machine, commands = scheduled.machine, scheduled.commands
    cylinder, pole = machine.cylinders[move.axis], step_ringing(machine, move.axis).pole
    rows = (commands.ticks >= move.first_tick) & (commands.ticks <= move.last_tick)
    move_commands = replace(
        commands,
        ticks=commands.ticks[rows] - move.first_tick,
        levels=commands.levels[rows],
        operation=commands.operation[rows],
        duration_ticks=move.last_tick - move.first_tick + round(0.2 / commands.clock.period_s),
        events=(),
    )
    late_s = cylinder.way(move.forward).closes_s + cylinder.delay.si
    calm_s = late_s + 8.0 * cylinder.lag.si
    period_s = float(commands.clock.period_s)
    amplitudes_m = []
    for scan in scans.tolist():
        options = SwitchOptions(after_s=calm_s + 1.0, break_s=(scan - 0.5) * period_s)
        shut_s = scan * period_s
        recording = simulate_switching(move_commands, machine, options)
        amplitude_m = ringing_m(recording, move.axis, shut_s + calm_s, pole)
        amplitudes_m.append(amplitude_m * np.exp(-pole.real * (calm_s - late_s)))
    return np.array(amplitudes_m)


def move_sweep(
    scheduled: Scheduled, move: ScheduledMove, breaks: int = 8
) -> tuple[BreakSweep, tuple[FloatArray, FloatArray]]:
    """Return the sweep of a scheduled move; and times, s, and amplitudes, m, from the twin."""
    period_s = float(scheduled.commands.clock.period_s)
    steps = np.array(move.levels.ticks, dtype=np.float64) * period_s
    heights = np.diff(move.levels.levels, prepend=0.0)
    ringing = step_ringing(scheduled.machine, move.axis)
    sweep = sweep_of_steps("as scheduled", steps, heights, ringing)
    scans = np.unique(np.linspace(1, move.levels.ticks[-1], breaks).round().astype(np.int64))
    instants = scans.astype(np.float64) * period_s
    return sweep, (instants, break_on_twin(scheduled, move, scans))
