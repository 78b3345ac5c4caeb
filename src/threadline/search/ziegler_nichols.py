"""The rules of Ziegler and Nichols, by the ultimate gain and by a step, from runs of the twin.

J. G. Ziegler and N. B. Nichols, "Optimum settings for automatic controllers", Trans. ASME 64, 1942.
Both experiments run on the simulated machine, because on a real machine they would overheat belts
and motors.

*Ultimate gain.* A proportional controller's gain is raised to the value at which the axis swings
on forever after a step of one count. The encoder and the DAC of these runs do not round: with
rounding an axis swings within a count at any gain.

*Step.* The drive gets a constant voltage without the loop. The position over time becomes a
straight line. The rule takes two numbers from the line: its slope R, and the time L at which it
meets the initial position.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.dynamics.loop import axis_loop
from threadline.dynamics.loop_design import ControllerKind, with_controller
from threadline.dynamics.margins import loop_margins
from threadline.errors import MachineError
from threadline.files import Stream, TickBlock, TickTable
from threadline.identify.time_domain import driven_by_volts
from threadline.machine import Machine
from threadline.twin.batch import BatchOptions, simulate_batch

_GAINS = 24  # number of gains tried side by side in each round
_ROUNDS = 3
_SWINGS = 60  # number of swings in a run at the ultimate gain
_VOLT_SHARE = 0.1
_HALVINGS = 7
_SLOWEST = 12.0  # duration of a run in time constants of the slowest pole
_LINE = 0.3  # share of a run, at its end, to which the line is fitted
_TRAVEL = 0.8  # share of the travel that a step may use


@dataclass(frozen=True, slots=True, kw_only=True)
class Ultimate:
    """The limit of a proportional controller.

    Parameters
    ----------
    kp
        Ultimate gain, DAC levels per count.
    period_s
        Period of the swing.
    """

    kp: float
    period_s: float

    def gains(self, kind: ControllerKind, tick_s: float) -> dict[str, float]:
        """Return the gains of the rule for ``p``, ``pi`` or ``pid``, DAC levels per count."""
        share, integral, differential = {
            "p": (0.5, np.inf, 0.0),
            "pi": (0.45, 1.0 / 1.2, 0.0),
            "pid": (0.6, 0.5, 0.125),
        }[kind]
        return _discrete(
            kind, share * self.kp, integral * self.period_s, differential * self.period_s, tick_s
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ReactionCurve:
    """The response of an axis to a step of its voltage.

    Parameters
    ----------
    slope
        Counts per second and DAC level.
    lag_s
        Time at which the straight line meets the initial position.
    """

    slope: float
    lag_s: float

    def gains(self, kind: ControllerKind, tick_s: float) -> dict[str, float]:
        """Return the gains of the rule for ``p``, ``pi`` or ``pid``, DAC levels per count."""
        share, integral, differential = {
            "p": (1.0, np.inf, 0.0),
            "pi": (0.9, 1.0 / 0.3, 0.0),
            "pid": (1.2, 2.0, 0.5),
        }[kind]
        kp = share / (self.slope * self.lag_s)
        return _discrete(kind, kp, integral * self.lag_s, differential * self.lag_s, tick_s)


def _discrete(
    kind: ControllerKind, kp: float, integral_s: float, differential_s: float, tick_s: float
) -> dict[str, float]:
    gains = {"kp": kp}
    if kind in {"pi", "pid"}:
        gains["ki"] = kp * tick_s / integral_s
    if kind == "pid":
        gains["kd"] = kp * differential_s / tick_s
    return gains


def foreseen_ultimate(machine: Machine, axis: str) -> Ultimate:
    """Return the ultimate gain by the linear model: the gain margin of a gain of 1.

    Raises
    ------
    MachineError
        If no gain brings the loop to its limit.
    """
    loop = axis_loop(with_controller(machine, axis, "p", {"kp": 1.0}), axis)
    crossings = loop_margins(loop).phase_crossovers
    if not crossings:
        raise MachineError(
            f"axis {axis}: no proportional gain brings its loop to the limit of stability",
            place=machine.place,
            remedy="Tune it by its margins.",
        )
    first = min(crossings, key=lambda one: one.gain_factor)
    return Ultimate(kp=first.gain_factor, period_s=2.0 * np.pi / first.omega_rad_s)


def ultimate(machine: Machine, axis: str) -> Ultimate:
    """Find the ultimate gain on the twin, and the period of the swing, within 0.1 %.

    The linear model gives only the range in which the gain is searched.

    Raises
    ------
    MachineError
        If no gain brings the loop to its limit, in the model or on the twin.
    """
    guess = foreseen_ultimate(machine, axis)
    p_machine = with_controller(machine, axis, "p", {"kp": guess.kp})
    name = machine.axes[axis].controller
    tick_s = float(machine.tick_clock.period_s)
    position = np.ones(max(int(np.ceil(_SWINGS * guess.period_s / tick_s)), 400), dtype=np.int64)
    commands = _table(p_machine, axis, position)
    low, high = 0.4 * guess.kp, 1.9 * guess.kp
    for _ in range(_ROUNDS):
        gains = np.geomspace(low, high, _GAINS)
        runs = _runs(commands, p_machine, {f"controllers.{name}.kp": gains}, axis)
        grows = _growth(runs) > 0.0
        if grows.all() or not grows.any():
            raise MachineError(
                f"axis {axis}: on the simulated machine no gain from {low:.4g} to {high:.4g} "
                "dac/count is the limit of stability",
                place=machine.place,
                remedy="Friction or play may hold the axis; tune it by its margins.",
            )
        first_growing = int(np.argmax(grows))
        low, high = float(gains[max(first_growing - 1, 0)]), float(gains[first_growing])
    kp = float(np.sqrt(low * high))
    (run,) = _runs(commands, p_machine, {f"controllers.{name}.kp": np.array([kp])}, axis).T
    return Ultimate(kp=kp, period_s=_period(run, tick_s))


def _runs(
    commands: TickTable, machine: Machine, numbers: Mapping[str, FloatArray], axis: str
) -> FloatArray:
    batch = simulate_batch(
        commands,
        machine,
        numbers,
        options=BatchOptions(
            settle_s=0.0, channels=(f"{axis}.measured",), watch_current=False, quantised=False
        ),
    )
    return batch.samples[f"{axis}.measured"]


def _growth(runs: FloatArray) -> FloatArray:
    """Return (n,) the growth of the swing in (samples, n) runs: log of later over earlier range.

    The growth of a run that overflows is infinite.
    """
    length = len(runs)
    parts = [runs[int(a * length) : int(b * length)] for a, b in ((0.4, 0.6), (0.8, 1.0))]
    early_range, late_range = (np.ptp(part, axis=0) for part in parts)
    with np.errstate(divide="ignore", invalid="ignore"):
        growth = np.log(late_range / early_range)
    growth[late_range == 0.0] = -np.inf  # the axis has come to rest
    return np.asarray(np.where(np.isnan(growth), np.inf, growth))


def _period(run: FloatArray, tick_s: float) -> float:
    """Return the mean period, s, of the second half of a run, from its upward zero crossings."""
    second_half = run[len(run) // 2 :]
    swing = second_half - second_half.mean()
    rising = np.flatnonzero((swing[:-1] < 0.0) & (swing[1:] >= 0.0))
    crossings = rising + swing[rising] / (swing[rising] - swing[rising + 1])
    return float((crossings[-1] - crossings[0]) / (len(crossings) - 1) * tick_s)


def reaction_curve(machine: Machine, axis: str) -> ReactionCurve:
    """Measure slope and lag of the response to a voltage step on the simulated machine.

    The step is a tenth of the DAC's range, halved until current and travel suffice.

    Raises
    ------
    MachineError
        If the axis does not reach a steady speed within its travel even after a small step.
    """
    loop = axis_loop(machine, axis)
    poles = np.abs(loop.plant.poles())
    moving_poles = poles[poles > 1e-6 * max(float(poles.max()), 1.0)]
    slowest = float(moving_poles.min()) if len(moving_poles) else 1.0
    driven_machine = driven_by_volts(machine, [axis])
    tick_s = float(driven_machine.tick_clock.period_s)
    duration_s = _SLOWEST / slowest + float(loop.delays_s()[loop.index])
    dac = machine.controller_of(axis).dac
    level = driven_machine.controller_of(axis).dac.volt_per_level
    for halving in range(_HALVINGS):
        volts = _VOLT_SHARE * dac.range.si / 2.0**halving
        position = np.full(max(int(np.ceil(duration_s / tick_s)), 40), round(volts / level))
        runs = simulate_batch(
            _table(driven_machine, axis, position.astype(np.int64)),
            driven_machine,
            None,
            options=BatchOptions(settle_s=0.0, channels=(f"{axis}.load", f"{axis}.current_peak")),
        )
        load = runs.samples[f"{axis}.load"][:, 0]
        if _within_limits(machine, axis, load, runs.samples[f"{axis}.current_peak"][:, 0]):
            break
    else:
        raise MachineError(
            f"axis {axis}: after a step of {volts:.3g} V its current reaches its limit, or it "
            "leaves its travel before its speed is steady",
            place=machine.place,
            remedy="Tune it by its margins.",
        )
    # The voltage of the first row acts from tick 1 on.
    time_s = (np.arange(len(load)) - 1.0) * tick_s
    is_steady = time_s > (1.0 - _LINE) * time_s[-1]
    slope, offset = np.polyfit(time_s[is_steady], load[is_steady] * machine.axes[axis].counts.si, 1)
    return ReactionCurve(
        slope=float(slope) / volts * dac.volt_per_level, lag_s=float(-offset / slope)
    )


def _within_limits(machine: Machine, axis: str, load: FloatArray, current: FloatArray) -> bool:
    """Return whether a step stays within the travel and below the current limit."""
    travel, limit = machine.axes[axis].travel, machine.drive_of(axis).amplifier.current_limit
    if travel is not None and np.abs(load).max() > _TRAVEL * (travel[1].si - travel[0].si):
        return False
    return limit is None or float(np.abs(current).max()) < limit.si * (1.0 - 1e-9)


def _table(machine: Machine, axis: str, position: IntArray) -> TickTable:
    """Return commands in which one axis takes (n,) positions in counts from rest."""
    rows = np.zeros((len(position), len(machine.axes)), dtype=np.int64)
    rows[:, machine.axis_names.index(axis)] = np.diff(position, prepend=0)
    block = TickBlock(first_tick=0, counts=rows, operation=np.zeros(len(rows), dtype=np.int64))
    return TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(len(machine.axes), dtype=np.int64),
        blocks=Stream(iter, (block,)),
        job_sha256="",
        machine_sha256=machine.sha256,
    )
