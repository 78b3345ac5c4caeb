"""Commands of experiments on one axis: a multisine, steps, constant speeds, reversals, a coast."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import OptionError
from threadline.files import Stream, TickBlock, TickTable
from threadline.files.recording import columns_of
from threadline.machine import Machine
from threadline.machine.variants import SUPPLY_CUT, coasting
from threadline.twin.simulate import simulate
from threadline.units import parse_quantity

EXPERIMENTS = ("sweep", "steps", "constant", "coast", "backlash")
_LINES = 24
_PERIODS = 4
_LOWEST_HZ, _HIGHEST_HZ = 0.5, 60.0
_SPEED, _ACCELERATION, _TRAVEL = 0.25, 0.5, 0.05  # shares of the limits of the axis
# A DAC of few levels rounds a slow sweep alike in every period, so that no average helps.
_SWEEP_SPEED, _SWEEP_ACCELERATION = 0.9, 0.7
_CONSTANT_SPEEDS = (0.0625, 0.125, 0.25, 0.5)  # shares of the limit
_PAUSE_S = 0.4
_COAST_SPEED, _COAST_TRAVEL = 0.5, 0.25  # shares of the limits of the axis
_CRUISE_S, _REST_SHARE = (
    0.4,
    0.005,
)  # constant speed before the cut; share of it that counts as rest
_LONGEST_COAST_S = 60.0
_MOST_TICKS = 300_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Experiment:
    """An experiment, ready to run.

    Parameters
    ----------
    kind, axis
        Its name, and the axis that moves.
    commands
        Counts per tick.
    lines
        (k,) excited harmonics of the period of a sweep; empty for others.
    period
        Ticks of a period of a sweep, 0 for others.
    first
        Tick at which the first whole period begins.
    cut_at_si
        For a coast: position from which on the drive has no supply, m or rad.
    """

    kind: str
    axis: str
    commands: TickTable
    lines: IntArray
    period: int = 0
    first: int = 0
    cut_at_si: float | None = None

    def on(self, machine: Machine) -> Machine:
        """Return the machine of the experiment: for a coast, one with a cut of the supply."""
        return machine if self.cut_at_si is None else coasting(machine, self.axis, self.cut_at_si)


def experiment(
    machine: Machine,
    axis: str,
    kind: str,
    *,
    amplitude: float | None = None,
    band_hz: tuple[float, float] | None = None,
    speeds: Sequence[float] = _CONSTANT_SPEEDS,
) -> Experiment:
    """Return an experiment that keeps a share of the limits of its axis.

    Parameters
    ----------
    kind
        One of ``EXPERIMENTS``.
    amplitude
        Largest deviation from the start, m or rad; by default a twentieth of the travel, of an
        endless axis a twentieth of a turn. For a coast: distance from the start within which it
        ends, by the machine file; by default a quarter of the travel.
    band_hz
        Lowest and highest frequency of a sweep; by default 0.5 to 60 Hz, at most a tenth of the
        rate of the ticks.
    speeds
        Speeds of ``constant``, shares of the limit of the axis.

    Raises
    ------
    OptionError
        If there is no such axis or experiment, an option is out of range, or nothing in the machine
        file would end a coast.
    """
    if kind not in EXPERIMENTS:
        raise OptionError(
            f"there is no experiment {kind[:30]!r}", remedy=f"There are {', '.join(EXPERIMENTS)}."
        )
    if axis not in machine.axes or not machine.axes[axis].controller:
        controlled = [name for name, axis_part in machine.axes.items() if axis_part.controller]
        raise OptionError(
            f"machine {machine.name!r} has no axis {axis[:20]!r} with a control loop",
            remedy=f"It has: {', '.join(controlled) or 'none'}.",
        )
    tick_s = float(machine.tick_clock.period_s)
    amplitude_si = _usual_amplitude(machine, axis) if amplitude is None else amplitude
    if amplitude_si <= 0.0:
        raise OptionError(f"--amplitude is {amplitude_si:g}", remedy="Give one above 0.")
    lines, period, cut = np.zeros(0, dtype=np.int64), 0, None
    if kind == "sweep":
        lines, period = _harmonics(band_hz, tick_s)
        position = _multisine(machine, axis, lines, period, amplitude_si)
    elif band_hz is not None:
        raise OptionError("--band is for a sweep", remedy="Leave it out.")
    elif kind == "coast":
        position, cut = _coast(machine, axis, amplitude)
    else:
        position = _moves(machine, axis, kind, amplitude_si, speeds)
    counts = np.rint(position * machine.axes[axis].counts.si).astype(np.int64)
    return Experiment(
        kind=kind,
        axis=axis,
        commands=_table(machine, axis, counts),
        lines=lines,
        period=period,
        first=period,
        cut_at_si=cut,
    )


def parse_band(text: str) -> tuple[float, float]:
    """Return the two frequencies in ``"1 Hz, 60 Hz"``, in Hz.

    Raises
    ------
    OptionError
        If the text is not two frequencies.
    """
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2:
        raise OptionError(
            f"--band {text[:40]!r} is not two frequencies",
            remedy='Write it like --band "1 Hz, 60 Hz".',
        )
    return parse_quantity(parts[0], "Hz"), parse_quantity(parts[1], "Hz")


def _usual_amplitude(machine: Machine, axis: str) -> float:
    travel = machine.axes[axis].travel
    if travel is None:
        return float(2.0 * np.pi * _TRAVEL)
    low, high = travel
    return _TRAVEL * (high.si - low.si)


def _harmonics(band_hz: tuple[float, float] | None, tick_s: float) -> tuple[IntArray, int]:
    """Return the excited harmonics, nearly even on a logarithmic scale, and the period in ticks."""
    low, high = (_LOWEST_HZ, min(_HIGHEST_HZ, 0.1 / tick_s)) if band_hz is None else band_hz
    if not 0.0 < low < high or high > 0.4 / tick_s:
        raise OptionError(
            f"--band {low:g} to {high:g} Hz does not increase, or goes beyond {0.4 / tick_s:.4g} "
            f"Hz, 0.4 of the rate of the ticks",
            remedy='Write it like --band "1 Hz, 60 Hz".',
        )
    period = round(1.0 / (low * tick_s))
    if (_PERIODS + 2) * period > _MOST_TICKS:
        raise OptionError(
            f"a period of {1.0 / low:.4g} s is too long", remedy="Begin at a higher frequency."
        )
    highest = max(int(high * period * tick_s), 1)
    return np.unique(np.rint(np.geomspace(1, highest, _LINES)).astype(np.int64)), period


def _multisine(
    machine: Machine, axis: str, lines: IntArray, period: int, amplitude_si: float
) -> FloatArray:
    """Return positions of a multisine with equal speeds of all lines, from rest to rest.

    The phases are Schroeder's ("Synthesis of low-peak-factor signals", IEEE Trans. Information
    Theory 16, 1970). The first and the last period fade in and out.
    """
    tick_s = float(machine.tick_clock.period_s)
    order = np.arange(len(lines))
    angle = 2.0 * np.pi * np.outer(np.arange(period) / period, lines)
    phase = -np.pi * order * (order + 1) / len(lines)
    one_period = (np.sin(angle + phase) / lines).sum(axis=1)
    fade = 0.5 - 0.5 * np.cos(np.pi * np.arange(period) / period)
    wave = np.concatenate((one_period * fade, *([one_period] * _PERIODS), one_period * fade[::-1]))
    wave -= wave[0]
    limits = machine.axes[axis]
    factors = (
        amplitude_si / np.abs(wave).max(),
        _SWEEP_SPEED * limits.velocity.si * tick_s / np.abs(np.diff(wave)).max(),
        _SWEEP_ACCELERATION * limits.acceleration.si * tick_s**2 / np.abs(np.diff(wave, 2)).max(),
    )
    return np.asarray(wave * min(factors))


def _moves(
    machine: Machine, axis: str, kind: str, amplitude_si: float, speeds: Sequence[float]
) -> FloatArray:
    """Return positions of trapezoidal moves to and fro, with pauses."""
    usual_speed = _SPEED * machine.axes[axis].velocity.si
    plan: list[tuple[float, float]] = []  # (to, speed)
    if kind == "steps":
        for share in (0.1, 0.3, 1.0):
            plan += [
                (share * amplitude_si, 4.0 * usual_speed),
                (0.0, 4.0 * usual_speed),
                (-share * amplitude_si, 4.0 * usual_speed),
                (0, usual_speed),
            ]
    elif kind == "constant":
        limit = machine.axes[axis].velocity.si
        for share in speeds:
            plan += [
                (amplitude_si, share * limit),
                (-amplitude_si, share * limit),
                (0.0, share * limit),
            ]
    else:
        slow = 0.04 * usual_speed
        for share in (0.05, 0.1, 0.2):
            plan += [(share * amplitude_si, slow), (-share * amplitude_si, slow)] * 2
        plan += [(0.0, slow)]
    parts, begin = [], 0.0
    for target, speed in plan:
        parts.append(_move(machine, axis, begin, target, speed))
        begin = target
    position = np.concatenate(parts)
    if len(position) > _MOST_TICKS:
        raise OptionError(
            f"the experiment takes {len(position)} ticks, limit {_MOST_TICKS}",
            remedy="Give a smaller --amplitude.",
        )
    return position


def _move(machine: Machine, axis: str, begin: float, end: float, speed: float) -> FloatArray:
    """Return the positions of one trapezoidal move and the pause after it, tick by tick."""
    tick_s = float(machine.tick_clock.period_s)
    acceleration = _ACCELERATION * machine.axes[axis].acceleration.si
    distance = abs(end - begin)
    speed = min(speed, np.sqrt(distance * acceleration), 0.95 * machine.axes[axis].velocity.si)
    ramp, cruise = speed / acceleration, distance / speed - speed / acceleration
    time = np.arange(1, int(np.ceil((2 * ramp + cruise + _PAUSE_S) / tick_s)) + 1) * tick_s
    up = np.minimum(time, ramp)
    down = np.clip(time - ramp - cruise, 0.0, ramp)
    travelled = 0.5 * acceleration * up**2 + speed * np.clip(time - ramp, 0.0, cruise)
    travelled += speed * down - 0.5 * acceleration * down**2
    return np.asarray(begin + np.sign(end - begin) * np.minimum(travelled, distance))


def _coast(machine: Machine, axis: str, amplitude: float | None) -> tuple[FloatArray, float]:
    """Return the positions of a coast, tick by tick, and the position of the cut.

    The speed is half of the limit, or the highest at which the axis comes to rest within
    ``amplitude`` by the machine file. After the cut the command slows down as the axis is expected
    to: if the supply is not cut, the axis stops all the same.
    """
    limits = machine.axes[axis]
    if amplitude is None and limits.travel is not None:
        amplitude = _COAST_TRAVEL * (limits.travel[1].si - limits.travel[0].si)
    too_fast = _COAST_SPEED * limits.velocity.si
    slow_enough, speed = 0.0, too_fast
    position, cut = _coast_from(machine, axis, speed)
    if amplitude is None or position[-1] <= amplitude:
        return position, cut
    for _ in range(12):
        speed = 0.5 * (slow_enough + too_fast)
        position, cut = _coast_from(machine, axis, speed)
        slow_enough, too_fast = (
            (speed, too_fast) if position[-1] <= amplitude else (slow_enough, speed)
        )
    if slow_enough == 0.0:
        raise OptionError(
            f"axis {axis}: no coast ends within {amplitude:.4g} of the start by the machine file",
            remedy="Give a larger --amplitude.",
        )
    return _coast_from(machine, axis, slow_enough)


def _coast_from(machine: Machine, axis: str, speed: float) -> tuple[FloatArray, float]:
    """Return the positions of a coast from a speed, and the position of the cut."""
    tick_s = float(machine.tick_clock.period_s)
    ramp_s = speed / (_ACCELERATION * machine.axes[axis].acceleration.si)
    cut_at = speed * (0.5 * ramp_s + _CRUISE_S)
    scale = machine.axes[axis].counts.si
    length_s = ramp_s + 4.0 * _CRUISE_S
    while True:
        time = np.arange(1, int(np.ceil(length_s / tick_s)) + 1) * tick_s
        commanded = speed * (np.minimum(time, ramp_s) ** 2 / (2.0 * ramp_s))
        commanded += speed * np.clip(time - ramp_s, 0.0, None)
        counts = np.rint(commanded * scale).astype(np.int64)
        recording = simulate(_table(machine, axis, counts), coasting(machine, axis, cut_at))
        columns = {name.partition(" ")[0]: v for name, v in columns_of(recording).items()}
        load, rate = columns[f"{axis}.load"], columns[f"{axis}.velocity"]
        is_cut = columns[SUPPLY_CUT] > 0.0
        moving = np.flatnonzero(~is_cut | (np.abs(rate) > _REST_SHARE * speed))
        if moving[-1] + 1 < len(load):
            break
        if length_s > _LONGEST_COAST_S:
            raise OptionError(
                f"axis {axis} would not come to rest within {_LONGEST_COAST_S:g} s without supply: "
                "the machine file has too little damping or friction for a coast",
                remedy="Give its body or motor a damping or a friction first.",
            )
        length_s *= 2.0
    begin, end = int(np.argmax(is_cut)), int(moving[-1]) + 1
    at_rest = np.full(int(np.ceil(_PAUSE_S / tick_s)), load[end] - load[begin])
    slowing = np.concatenate((load[begin : end + 1] - load[begin], at_rest))
    return np.concatenate((commanded[:begin], commanded[begin - 1] + slowing)), cut_at


def _table(machine: Machine, axis: str, counts: IntArray) -> TickTable:
    """Return commands in which one axis moves to (n,) counts from the start."""
    rows = np.zeros((len(counts), len(machine.axes)), dtype=np.int64)
    rows[:, machine.axis_names.index(axis)] = np.diff(counts, prepend=0)
    block = TickBlock(first_tick=0, counts=rows, operation=np.zeros(len(rows), dtype=np.int64))
    return TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=np.array([axis_part.counts.si for axis_part in machine.axes.values()]),
        start_counts=np.zeros(len(machine.axes), dtype=np.int64),
        blocks=Stream(iter, (block,)),
        job_sha256="",
        machine_sha256=machine.sha256,
    )


def duration_s(commands: TickTable) -> Fraction:
    """Return the duration of commands, s."""
    return commands.tick_count() * commands.clock.period_s
