"""Commands of experiments on one axis: a multisine, steps, constant speeds, slow reversals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import OptionError
from threadline.files import Stream, TickBlock, TickTable
from threadline.machine import Machine
from threadline.units import parse_quantity

EXPERIMENTS = ("sweep", "steps", "constant", "backlash")
_LINES = 24
_PERIODS = 4
_LOWEST_HZ, _HIGHEST_HZ = 0.5, 60.0
_SPEED, _ACCELERATION, _TRAVEL = 0.25, 0.5, 0.05  # shares of the limits of the axis
# A DAC of few levels rounds a slow sweep alike in every period, so that no average helps.
_SWEEP_SPEED, _SWEEP_ACCELERATION = 0.9, 0.7
_CONSTANT_SPEEDS = (0.0625, 0.125, 0.25, 0.5)  # shares of the limit
_PAUSE_S = 0.4
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
    """

    kind: str
    axis: str
    commands: TickTable
    lines: IntArray
    period: int = 0
    first: int = 0


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
        endless axis a twentieth of a turn.
    band_hz
        Lowest and highest frequency of a sweep; by default 0.5 to 60 Hz, at most a tenth of the
        rate of the ticks.
    speeds
        Speeds of ``constant``, shares of the limit of the axis.

    Raises
    ------
    OptionError
        If there is no such axis or experiment, or an option is out of range.
    """
    if kind == "coast":
        raise OptionError(
            "coast needs a link that cuts the power of a moving axis, and no link does",
            remedy="constant gives friction and damping from the volts at several speeds.",
        )
    if kind not in EXPERIMENTS:
        raise OptionError(
            f"there is no experiment {kind[:30]!r}", remedy=f"There are {', '.join(EXPERIMENTS)}."
        )
    if axis not in machine.axes or not machine.axes[axis].controller:
        closed = [name for name, one in machine.axes.items() if one.controller]
        raise OptionError(
            f"machine {machine.name!r} has no axis {axis[:20]!r} with a control loop",
            remedy=f"It has: {', '.join(closed) or 'none'}.",
        )
    tick_s = float(machine.tick_clock.period_s)
    size = _usual_amplitude(machine, axis) if amplitude is None else amplitude
    if size <= 0.0:
        raise OptionError(f"--amplitude is {size:g}", remedy="Give one above 0.")
    lines, period = np.zeros(0, dtype=np.int64), 0
    if kind == "sweep":
        lines, period = _harmonics(band_hz, tick_s)
        position = _multisine(machine, axis, lines, period, size)
    elif band_hz is not None:
        raise OptionError("--band is for a sweep", remedy="Leave it out.")
    else:
        position = _moves(machine, axis, kind, size, speeds)
    counts = np.rint(position * machine.axes[axis].counts.si).astype(np.int64)
    return Experiment(
        kind=kind,
        axis=axis,
        commands=_table(machine, axis, counts),
        lines=lines,
        period=period,
        first=period,
    )


def parse_band(text: str) -> tuple[float, float]:
    """Return the two frequencies in ``"1 Hz, 60 Hz"``, in Hz.

    Raises
    ------
    OptionError
        If there are not two.
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
    top = max(int(high * period * tick_s), 1)
    return np.unique(np.rint(np.geomspace(1, top, _LINES)).astype(np.int64)), period


def _multisine(
    machine: Machine, axis: str, lines: IntArray, period: int, size: float
) -> FloatArray:
    """Return positions of a multisine of even speeds that begins and ends at rest.

    The phases are Schroeder's ("Synthesis of low-peak-factor signals", IEEE Trans. Information
    Theory 16, 1970). The first and the last period fade in and out.
    """
    tick_s = float(machine.tick_clock.period_s)
    order = np.arange(len(lines))
    turn = 2.0 * np.pi * np.outer(np.arange(period) / period, lines)
    phase = -np.pi * order * (order + 1) / len(lines)
    one = (np.sin(turn + phase) / lines).sum(axis=1)
    fade = 0.5 - 0.5 * np.cos(np.pi * np.arange(period) / period)
    wave = np.concatenate((one * fade, *([one] * _PERIODS), one * fade[::-1]))
    wave -= wave[0]
    limits = machine.axes[axis]
    reached = (
        size / np.abs(wave).max(),
        _SWEEP_SPEED * limits.velocity.si * tick_s / np.abs(np.diff(wave)).max(),
        _SWEEP_ACCELERATION * limits.acceleration.si * tick_s**2 / np.abs(np.diff(wave, 2)).max(),
    )
    return np.asarray(wave * min(reached))


def _moves(
    machine: Machine, axis: str, kind: str, size: float, speeds: Sequence[float]
) -> FloatArray:
    """Return positions of trapezoidal moves to and fro, with pauses."""
    top = _SPEED * machine.axes[axis].velocity.si
    plan: list[tuple[float, float]] = []  # (to, speed)
    if kind == "steps":
        for share in (0.1, 0.3, 1.0):
            plan += [
                (share * size, 4.0 * top),
                (0.0, 4.0 * top),
                (-share * size, 4.0 * top),
                (0, top),
            ]
    elif kind == "constant":
        limit = machine.axes[axis].velocity.si
        for share in speeds:
            plan += [(size, share * limit), (-size, share * limit), (0.0, share * limit)]
    else:
        slow = 0.04 * top
        for share in (0.05, 0.1, 0.2):
            plan += [(share * size, slow), (-share * size, slow)] * 2
        plan += [(0.0, slow)]
    parts, at = [], 0.0
    for to, speed in plan:
        parts.append(_move(machine, axis, at, to, speed))
        at = to
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
    way = abs(end - begin)
    speed = min(speed, np.sqrt(way * acceleration), 0.95 * machine.axes[axis].velocity.si)
    ramp, cruise = speed / acceleration, way / speed - speed / acceleration
    time = np.arange(1, int(np.ceil((2 * ramp + cruise + _PAUSE_S) / tick_s)) + 1) * tick_s
    up = np.minimum(time, ramp)
    down = np.clip(time - ramp - cruise, 0.0, ramp)
    gone = 0.5 * acceleration * up**2 + speed * np.clip(time - ramp, 0.0, cruise)
    gone += speed * down - 0.5 * acceleration * down**2
    return np.asarray(begin + np.sign(end - begin) * np.minimum(gone, way))


def _table(machine: Machine, axis: str, counts: IntArray) -> TickTable:
    """Return commands in which one axis moves to (n,) counts from the start."""
    rows = np.zeros((len(counts), len(machine.axes)), dtype=np.int64)
    rows[:, machine.axis_names.index(axis)] = np.diff(counts, prepend=0)
    block = TickBlock(first_tick=0, counts=rows, operation=np.zeros(len(rows), dtype=np.int64))
    return TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=np.array([one.counts.si for one in machine.axes.values()]),
        start_counts=np.zeros(len(machine.axes), dtype=np.int64),
        blocks=Stream(iter, (block,)),
        job_sha256="",
        machine_sha256=machine.sha256,
    )


def duration_s(commands: TickTable) -> Fraction:
    """Return the duration of commands."""
    return commands.tick_count() * commands.clock.period_s
