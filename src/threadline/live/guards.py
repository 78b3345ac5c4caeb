"""Guards that stop a run: following error, travel, encoders, late ticks, contacts."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit
from threadline.dynamics.responses import answers_of
from threadline.machine import Machine
from threadline.machine.parts import SupplyCut

LATE_IN_A_ROW = 3
LATE_PERIODS = 5.0
"""A fault is ``LATE_IN_A_ROW`` consecutive late reports, or a report late by ``LATE_PERIODS``."""
# Python's monotonic clock stops while Linux or macOS sleep. macOS's own monotonic clock does not.
COUNTS_SLEEP: int | None = getattr(time, "CLOCK_BOOTTIME", None)
if COUNTS_SLEEP is None and sys.platform == "darwin":
    COUNTS_SLEEP = time.CLOCK_MONOTONIC


def clock_s() -> float:
    """Return seconds of a clock that never goes back, the same in all processes.

    It goes on while the computer sleeps, on Linux and macOS. On other systems it may stop then: a
    silence counts only the time for which the computer was awake.
    """
    return time.monotonic() if COUNTS_SLEEP is None else time.clock_gettime(COUNTS_SLEEP)


class Lateness:
    """Counts consecutive late reports."""

    def __init__(self) -> None:
        self._late = 0

    def trip(self, late: bool, late_periods: float) -> str:
        """Return the text of the fault, or nothing.

        Parameters
        ----------
        late, late_periods
            Whether a report came late, and by how many of its periods.
        """
        self._late = self._late + 1 if late else 0
        if late_periods >= LATE_PERIODS:
            return f"a tick came {late_periods:.0f} periods late"
        if self._late >= LATE_IN_A_ROW:
            return f"{self._late} ticks in a row came late"
        return ""


FOLLOWING_M = 1e-3
"""Following error in m that is allowed in addition to twice the lag of the model; rotary axes at
their radius."""
_TRAVEL_M = 2e-3  # overshoot of the loop allowed beyond an end of travel
_JUMP = 3.0  # an encoder faster than this times the axis' speed limit has a fault
_JUMP_COUNTS = 4.0
_LOOKED_AT = ("commanded", "measured", "voltage")
_NONE: FloatArray = np.empty(0)


@dataclass(slots=True)
class _Axis:
    """An axis with its limits, and the state of its guards."""

    name: str
    channels: tuple[str, ...]  # watched channels, see ``_LOOKED_AT``
    lag_s: float  # of its loop, by the model
    room: float  # FOLLOWING_M in m or rad
    count: float  # size of a count, m or rad
    fastest: float  # speed limit, m or rad per tick
    low: float
    high: float
    reverses_by_zero: bool
    speeds: FloatArray  # commanded at the last ticks that still affect the load, oldest first
    last: FloatArray = field(default_factory=lambda: np.full(len(_LOOKED_AT), np.nan))
    """The last sample of each watched channel; NaN before the first."""
    still: tuple[float, float] = (0.0, 0.0)  # encoder and command when the encoder last moved


class Guards:
    """Checks the reports of one run.

    Parameters
    ----------
    machine
        Machine with the limits, loops and switches.
    """

    def __init__(self, machine: Machine) -> None:
        tick_s = float(machine.tick_clock.period_s)
        # Drives with a position interface have no loop and no encoder to watch.
        answers = {} if machine.takes_positions else answers_of(machine)
        scale = machine.counts_per_unit
        self._tick_s = tick_s
        supply_cuts = {
            name: part for name, part in machine.inputs.items() if isinstance(part, SupplyCut)
        }
        self._cuts = {name: part.axis for name, part in supply_cuts.items()}
        self._switches = tuple(name for name in machine.inputs if name not in supply_cuts)
        self._lateness = Lateness()
        self._axes: list[_Axis] = []
        for k, (name, axis) in enumerate(machine.axes.items()):
            if name not in answers:
                continue
            controller = machine.controllers[axis.controller]
            travel_ends = (
                (-np.inf, np.inf) if axis.travel is None else tuple(p.si for p in axis.travel)
            )
            self._axes.append(
                _Axis(
                    name=name,
                    channels=tuple(f"{name}.{quantity}" for quantity in _LOOKED_AT),
                    lag_s=answers[name].moments[0],
                    room=FOLLOWING_M
                    / (1.0 if axis.kind == "linear" else float(machine.radius_m[k])),
                    count=1.0 / scale[k],
                    fastest=float(machine.velocity_limit[k]) * tick_s,
                    low=travel_ends[0] - _TRAVEL_M,
                    high=travel_ends[1] + _TRAVEL_M,
                    reverses_by_zero=controller.dac.zero_on_reversal
                    and controller.clock == machine.tick_clock.name,
                    speeds=np.zeros(int(np.ceil(answers[name].memory_s / tick_s))),
                )
            )

    @property
    def lag_s(self) -> Mapping[str, float]:
        """The lag of each axis by the model, s."""
        return {axis.name: axis.lag_s for axis in self._axes}

    def trip(
        self,
        tick: int,  # noqa: ARG002  # samples come without gaps
        samples: Mapping[str, FloatArray],
        late: bool,
        late_periods: float,
    ) -> str:
        """Return the text of the fault in a report; empty if there is none.

        Parameters
        ----------
        tick
            Tick of the first sample.
        samples
            (n,) samples of each channel at consecutive ticks.
        late, late_periods
            Whether the report came late, and by how many of its periods.
        """
        if why := self._lateness.trip(late, late_periods):
            return why
        if why := self._switch_hit(samples):
            return why
        self._let_coast(samples)
        for axis in self._axes:
            if not self._in_order(axis, samples) and (why := self._trip_of(axis, samples)):
                return why
        return ""

    def _let_coast(self, samples: Mapping[str, FloatArray]) -> None:
        """Let an axis without supply be anywhere within its travel: it follows no command."""
        for name, coasting_axis in self._cuts.items():
            if name in samples and samples[name].any():
                for axis in self._axes:
                    axis.room = np.inf if axis.name == coasting_axis else axis.room

    def _in_order(self, axis: _Axis, samples: Mapping[str, FloatArray]) -> bool:
        """Return whether no guard of an axis trips; if none does, update its state.

        It gives the answer of ``_trip_of`` in one compiled call; only ``_trip_of`` names the guard.
        """
        # Copies: numba compiles separate versions for locked arrays and for views.
        commanded, read, volts = (np.array(samples.get(name, _NONE)) for name in axis.channels)
        if not len(commanded) or len(commanded) != len(read):
            return False
        quiet, axis.still = _in_order(
            commanded, read, volts, axis.last, axis.speeds, axis.still, axis.reverses_by_zero,
            (_JUMP * axis.fastest + _JUMP_COUNTS * axis.count, axis.low, axis.high),
            (self._tick_s, 2.0 * axis.lag_s, axis.room, 1.5 * axis.count),
        )  # fmt: skip
        return quiet

    def _switch_hit(self, samples: Mapping[str, FloatArray]) -> str:
        for name in self._switches:
            if name in samples and samples[name].any():
                return f"the limit switch {name} is hit"
        return ""

    def _trip_of(self, axis: _Axis, samples: Mapping[str, FloatArray]) -> str:
        commanded, read = (self._with_last(axis, channel, samples) for channel in (0, 1))
        if len(commanded) < 2 or len(read) < 2:
            return ""
        volts = self._with_last(axis, 2, samples)
        return (
            self._jumped(axis, read)
            or self._beyond(axis, read)
            or self._reversed(axis, volts)
            or self._following(axis, commanded, read)
        )

    def _jumped(self, axis: _Axis, read: FloatArray) -> str:
        jump = float(np.abs(np.diff(read)).max())
        if jump > _JUMP * axis.fastest + _JUMP_COUNTS * axis.count:
            return f"the encoder of {axis.name} jumps by {jump / axis.count:.0f} counts in a tick"
        return ""

    def _beyond(self, axis: _Axis, read: FloatArray) -> str:
        if read.min() < axis.low or read.max() > axis.high:
            return f"axis {axis.name} is beyond its travel"
        return ""

    def _reversed(self, axis: _Axis, volts: FloatArray) -> str:
        if axis.reverses_by_zero and (volts[1:] * volts[:-1] < 0.0).any():
            return f"the output of {axis.name} changed its sign without a tick of zero between"
        return ""

    def _following(self, axis: _Axis, commanded: FloatArray, read: FloatArray) -> str:
        speeds = np.concatenate([axis.speeds, np.abs(np.diff(commanded)) / self._tick_s])
        index, limit, axis.still = _too_far(
            commanded, read, speeds, 2.0 * axis.lag_s, axis.room, 1.5 * axis.count, axis.still
        )
        axis.speeds = speeds[len(speeds) - len(axis.speeds) :]
        if not index:
            return ""
        error = abs(float(commanded[index] - read[index]))
        unit, to_unit = ("mm", 1e3) if axis.room == FOLLOWING_M else ("deg", 180.0 / np.pi)
        if abs(float(commanded[index]) - axis.still[1]) > 0.5 * limit:
            return (
                f"the encoder of {axis.name} stands still while the axis should move: encoder, "
                "cable or drive"
            )
        return (
            f"axis {axis.name} follows {error * to_unit:.3g} {unit} behind, the limit at this "
            f"speed is {limit * to_unit:.3g} {unit}"
        )

    def _with_last(
        self, axis: _Axis, channel: int, samples: Mapping[str, FloatArray]
    ) -> FloatArray:
        """Return the samples of a channel from the last one of the previous report on."""
        values = samples.get(axis.channels[channel], _NONE)
        if not len(values):
            return values
        previous = values[0] if np.isnan(axis.last[channel]) else axis.last[channel]
        axis.last[channel] = values[-1]
        return np.concatenate([[previous], values])


@njit()
def _too_far(
    commanded: FloatArray,
    read: FloatArray,
    speeds: FloatArray,
    per_speed: float,
    room: float,
    least_motion: float,
    still: tuple[float, float],
) -> tuple[int, float, tuple[float, float]]:
    """Return the first sample whose following error is too large.

    Every tick has a limit of its own, so that reports of any length are judged alike.

    Parameters
    ----------
    commanded, read
        (n,) commanded and measured; the first is the last sample of the previous report.
    speeds
        (m + n - 1,) commanded speeds; each of the last n - 1 and the m before it affect a sample.
    per_speed, room
        The limit is the largest of those speeds times ``per_speed``, plus ``room``.
    least_motion, still
        Least motion of the encoder that counts, and encoder and command when it last moved.

    Returns
    -------
    tuple
        Its index, 0 if there is none; its limit; and ``still`` at that sample, or the last.
    """
    memory = len(speeds) - len(commanded) + 1
    for k in range(1, len(commanded)):
        if max(abs(read[k] - still[0]), abs(read[k - 1] - still[0])) > least_motion:
            still = (read[k], commanded[k])
        error = abs(commanded[k] - read[k])
        if error > room:  # else the speeds need not be read
            limit = per_speed * speeds[k - 1 : k + memory].max() + room
            if error > limit:
                return k, limit, still
    return 0, room, still


@njit()
def _in_order(
    commanded: FloatArray,
    read: FloatArray,
    volts: FloatArray,
    last: FloatArray,
    speeds: FloatArray,
    still: tuple[float, float],
    reverses_by_zero: bool,
    position_limits: tuple[float, float, float],
    following_limits: tuple[float, float, float, float],
) -> tuple[bool, tuple[float, float]]:
    """Return whether no tick trips a guard of an axis, and its ``still`` then.

    Parameters
    ----------
    commanded, read, volts
        (n,) samples of the axis; ``volts`` may be empty.
    last, speeds
        As in ``_Axis``; advanced past the samples if no guard trips, else unchanged.
    still, reverses_by_zero
        As in ``_Axis``.
    position_limits
        Largest jump of the encoder in a tick, and the ends of the travel.
    following_limits
        Period of the tick, and ``per_speed``, ``room`` and ``least_motion`` of ``_too_far``.
    """
    n, memory = len(read), len(speeds)
    jump, low, high = position_limits
    previous = read[0] if np.isnan(last[1]) else last[1]
    for k in range(n):
        if abs(read[k] - previous) > jump or read[k] < low or read[k] > high:
            return False, still
        previous = read[k]
    if reverses_by_zero and len(volts):
        previous = volts[0] if np.isnan(last[2]) else last[2]
        for k in range(len(volts)):
            if volts[k] * previous < 0.0:
                return False, still
            previous = volts[k]
    tick_s, per_speed, room, least_motion = following_limits
    whole_commanded, whole_read = np.empty(n + 1), np.empty(n + 1)
    whole_commanded[0] = commanded[0] if np.isnan(last[0]) else last[0]
    whole_read[0] = read[0] if np.isnan(last[1]) else last[1]
    acting_speeds = np.empty(memory + n)
    # Element by element: an array assignment takes seconds to compile.
    for k in range(memory):
        acting_speeds[k] = speeds[k]
    for k in range(n):
        whole_commanded[k + 1], whole_read[k + 1] = commanded[k], read[k]
        acting_speeds[memory + k] = abs(whole_commanded[k + 1] - whole_commanded[k]) / tick_s
    trip_index, _, still_after = _too_far(
        whole_commanded, whole_read, acting_speeds, per_speed, room, least_motion, still
    )
    if trip_index:
        return False, still
    for k in range(memory):
        speeds[k] = acting_speeds[n + k]
    last[0], last[1] = commanded[n - 1], read[n - 1]
    if len(volts):
        last[2] = volts[len(volts) - 1]
    return True, still_after


FREE = frozenset(("light-grid", "enable"))
"""Kinds of contacts that are on while the machine may move."""


class ScanGuards:
    """Checks the reports of one run.

    Parameters
    ----------
    machine
        Machine with the contacts, and the interlocks of its outputs.
    """

    def __init__(self, machine: Machine) -> None:
        self._lateness = Lateness()
        contacts = machine.contacts.items()
        self._grids = [name for name, contact in contacts if contact.kind in FREE]
        self._needs = {name: output.needs for name, output in machine.outputs.items()}
        end_contacts = [
            (name, end_contact)
            for name, end_contact in contacts
            if end_contact.cylinder and end_contact.beyond and end_contact.at
        ]
        self._both = [
            (str(end_contact.cylinder), first, second)
            for (first, end_contact), (second, other_contact) in combinations(end_contacts, 2)
            if end_contact.cylinder == other_contact.cylinder
            and end_contact.beyond != other_contact.beyond
        ]

    def trip(
        self,
        tick: int,  # noqa: ARG002
        samples: Mapping[str, FloatArray],
        late: bool,
        late_periods: float,
    ) -> str:
        """Return the text of the fault in a report; empty if there is none.

        Parameters
        ----------
        samples
            (n,) samples of each channel.
        late, late_periods
            Whether the report came late, and by how many of its periods.
        """
        if why := self._lateness.trip(late, late_periods):
            return why
        for grid in self._grids:
            if not samples[grid].all():
                return f"{grid} is off: a broken beam, or no enable"
        for cylinder, first, second in self._both:
            if (samples[first] * samples[second]).any():
                return f"{first} and {second} are on together: a contact of cylinder {cylinder}"
        for name, needed in self._needs.items():
            for contact in needed:
                if (samples[name] * (1.0 - samples[contact])).any():
                    return f"{name} is on, and {contact}, which it needs, is not"
        return ""


class TurnGuards:
    """Checks that the reports of one run come in time."""

    def __init__(self) -> None:
        self._lateness = Lateness()

    def trip(
        self,
        tick: int,  # noqa: ARG002
        samples: Mapping[str, FloatArray],  # noqa: ARG002
        late: bool,
        late_periods: float,
    ) -> str:
        """Return the text of the fault in a report; empty if there is none."""
        return self._lateness.trip(late, late_periods)
