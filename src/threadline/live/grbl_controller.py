"""A grbl controller outside a run: its settings, its position, and jogs.

grbl ends all motion that it has received at rest. A jog is never sent more than ``AHEAD_S`` of
motion beyond the last reported position. If any process dies and no more motion is sent, the
machine therefore stops within that time. A jog cancel (0x85) ends the motion at once.

Source: "Grbl v1.1 Jogging" of gnea/grbl.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import CommandError, LinkFaultError
from threadline.live.grbl_settings import (
    ACCELERATION,
    RATE,
    SAME,
    STEPS,
    BoardSetting,
    compared,
    number_of,
    setting_values,
    texts_of,
    units_of,
)
from threadline.live.grbl_words import (
    JOG_CANCEL,
    RESET,
    RX_BYTES,
    STATUS,
    Status,
    in_words,
    numbers,
    settings_of,
    status_of,
)
from threadline.live.guards import clock_s
from threadline.live.jogging import manual_feed
from threadline.live.pace import place_words, speed_words
from threadline.live.port import Port
from threadline.machine import Machine

_ANSWER_S = 3.0
_HOMING_S = 120.0
_LISTEN_S = 0.05  # longest wait for the controller while the operator may stop it
_QUIET_S = 5.0  # after a reset, the start-up messages of a controller end within this time
_LEAST_ROOM = 40  # characters; the receive buffer must hold at least so many
ASLEEP_S = 1.0  # a longer gap between two polls of a wait: this program was suspended
_OPTIONS = re.compile(r"\[OPT:[^,]*,(\d{1,6})(?:,(\d{1,6}))?(?:,.*)?\]")
"""Blocks of the planner, and characters of the receive buffer."""
_TRAVEL_M = 1e-3  # m or rad that a reported position may lie beyond the travel


class Controller:
    """A grbl controller that drives a machine.

    Parameters
    ----------
    port
        Port of the controller.
    machine
        The machine that must be connected.

    Attributes
    ----------
    port, machine
        As given.
    blocks
        Blocks that its planner holds: 15, unless it reports another number.
    room
        Characters that its receive buffer holds: 128, unless it reports fewer.
    brakes_s
        Longest time in s that an axis needs to stop from its highest speed, by the settings.
    identity
        Firmware version that the controller reports; empty until it has been asked.
    """

    def __init__(self, port: Port, machine: Machine) -> None:
        self.port, self.machine = port, machine
        self.blocks, self.room, self.brakes_s = 15, RX_BYTES, 0.0
        self._letters: tuple[str, ...] = ()
        self._homes = False
        self.identity = ""
        self._texts: dict[int, str] = {}  # its settings, by number

    def meet(self) -> None:
        """Connect to the controller, which must stand still, and check its settings.

        Raises
        ------
        LinkFaultError
            If it does not answer, or moves.
        CommandError
            If its settings are for another machine.
        """
        self.greet()
        self.compare()

    def greet(self) -> None:
        """Connect to the controller, which must stand still, and read its settings.

        No motion is sent. A reset discards lines and modes of an earlier sender.

        Raises
        ------
        LinkFaultError
            If it does not answer, or moves.
        CommandError
            If its reports cannot be read, it lacks an axis, or its receive buffer is too small.
        """
        status = self.ask_status()
        if status.state not in {"Idle", "Alarm"}:
            raise LinkFaultError(
                f"the controller is not at rest: it{status.words.removeprefix('the controller')}",
                remedy="Bring it to Idle by its own means; no motion was sent.",
            )
        self.port.send(RESET)  # at rest: clears modes and lines of an earlier sender
        self._quiet()
        self._letters = self._ask_letters()
        if self.room < _LEAST_ROOM:
            raise CommandError(
                f"the receive buffer of the controller holds {self.room} characters, the least is "
                f"{_LEAST_ROOM}, a move by hand",
                remedy="Build its firmware with a larger one.",
            )
        self.read_settings()

    def read_settings(self) -> None:
        """Read the controller's settings at rest.

        Raises
        ------
        CommandError
            If the settings change the meaning of the reports, or an axis is missing.
        """
        lines = self.ask(b"$$\n", _ANSWER_S)
        settings, self._texts = settings_of(lines), texts_of(lines)
        _refuse_other_reports(settings)
        self._refuse_missing()
        self._homes = bool(settings.get(22, 0.0))

    @property
    def settings(self) -> list[BoardSetting]:
        """Its settings, compared with the machine file; empty until they have been read."""
        return compared(self._texts, self.machine, self._letters) if self._texts else []

    @property
    def has_switches(self) -> bool:
        """Whether homing is enabled (``$22``); without it the reported position is trusted."""
        return self._homes

    def unlock(self) -> None:
        """Reset it at rest; if homing is not enabled (``$22``), clear its alarm, too.

        Raises
        ------
        LinkFaultError
            If it does not answer.
        """
        self.port.send(RESET)
        self._quiet()
        if not self._homes and self.ask_status().state == "Alarm":
            self.ask(b"$X\n", _ANSWER_S)

    def home(self, stopped: Callable[[], bool]) -> FloatArray:
        """Home it if homing is enabled (``$22``); return its (axes,) position, m or rad.

        Parameters
        ----------
        stopped
            Whether the operator has stopped the homing; polled while homing. If so, it is reset.

        Raises
        ------
        LinkFaultError
            If homing is stopped or fails, it is in alarm, or its coordinates are shifted.
        """
        if self._homes:
            self.ask(b"$H\n", _HOMING_S, stopped)
        for line in self.ask(b"$#\n", _ANSWER_S):
            name, _, values = line.strip("[]").partition(":")
            if name in {"G54", "G92"} and numbers(values).any():
                raise LinkFaultError(
                    f"the controller shifts its coordinates: {line}",
                    remedy="Clear it (G10 L2 P1 X0 Y0 Z0, G92.1), then home again.",
                )
        status = self.ask_status()
        if status.state != "Idle":
            raise LinkFaultError(
                f"the controller is not ready: its state is {status.state}",
                remedy="Clear its alarm by its own means, and home it.",
            )
        return self.position(status)

    def ask(
        self, line: bytes, timeout_s: float, stopped: Callable[[], bool] | None = None
    ) -> list[str]:
        """Send a line, and return the lines that come before its ``ok``.

        Raises
        ------
        LinkFaultError
            If the line is refused, not answered in time, or ``stopped`` meanwhile; with ``stopped``
            also if this program was suspended for a while, as when the computer sleeps.
        """
        self.port.send(line)
        looked_s = clock_s()
        until_s, lines = looked_s + timeout_s, list[str]()
        while (left_s := until_s - clock_s()) > 0.0 and not self.port.lost:
            heard = self.port.receive(left_s if stopped is None else min(left_s, _LISTEN_S))
            if stopped is not None:
                absent_s, looked_s = clock_s() - looked_s, clock_s()
                slept = f"this program did not run for {absent_s:.1f} s" * (absent_s > ASLEEP_S)
                if slept or stopped():
                    self.port.send(RESET)
                    raise LinkFaultError(
                        f"{slept or 'stopped by the operator'} while it homed, and it was reset",
                        remedy="Clear its alarm by its own means, and home it.",
                    )
            if heard == "ok":
                return lines
            if heard is not None and heard.startswith(("error", "ALARM")):
                raise LinkFaultError(
                    f"the controller refused {line.strip().decode()!r}: {in_words(heard)}"
                )
            if heard is not None:
                lines.append(heard)
        raise LinkFaultError(
            f"the controller did not answer {line.strip().decode()!r}",
            remedy="Check that it is switched on, speaks grbl, and nobody else is connected.",
        )

    def ask_status(self) -> Status:
        """Ask for a status report, and return it; raise LinkFaultError if none comes."""
        until_s = clock_s() + _ANSWER_S
        while (left_s := until_s - clock_s()) > 0.0 and not self.port.lost:
            self.port.send(STATUS)
            ask_again_s = clock_s() + min(left_s, 0.5)
            while (wait_s := ask_again_s - clock_s()) > 0.0:
                heard = self.port.receive(wait_s)
                if heard is None:
                    break
                if (status := status_of(heard)) is not None:
                    return status
        raise LinkFaultError(
            "the controller did not answer",
            remedy="Check that it is switched on, speaks grbl, and nobody else is connected.",
        )

    def _quiet(self) -> None:
        """Read until nothing more comes; raise LinkFaultError if lines come without end."""
        until_s = clock_s() + _QUIET_S
        while self.port.receive(0.5) is not None:
            if clock_s() >= until_s:
                raise LinkFaultError(
                    f"the controller was reset, and has not been quiet for {_QUIET_S:g} s",
                    remedy="Check that it speaks grbl, and sends no reports by itself.",
                )

    def _ask_letters(self) -> tuple[str, ...]:
        """Read the build information (``$I``); return the axis letters in the order of the reports.

        The size of the receive buffer stands before the axes in grblHAL, and after them in
        grbl-Mega-5X.
        """
        letters: tuple[str, ...] = ("X", "Y", "Z")
        for line in self.ask(b"$I\n", _ANSWER_S):
            if line.startswith("[VER:"):
                self.identity = line.strip("[]").removeprefix("VER:").strip(":")
            if line.startswith("[AXS:") and line.count(":") > 1:
                letters = tuple(line.strip("[]").split(":")[2])
            if line.startswith("[OPT:"):
                options = _OPTIONS.fullmatch(line)
                self.blocks = self.blocks if options is None else int(options[1])
                if options is not None and options[2] is not None:
                    self.room = min(int(options[2]), RX_BYTES)
        return letters

    def _columns(self) -> Sequence[int]:
        return [self._letters.index(name) for name in self.machine.axis_names]

    def _refuse_missing(self) -> None:
        """Refuse a controller that lacks an axis of the machine."""
        missing = [name for name in self.machine.axis_names if name not in self._letters]
        if missing:
            raise CommandError(
                f"the controller has no axis {missing[0]}: it has {', '.join(self._letters)}",
                remedy="Build its firmware with that axis, or name the axes of the machine so.",
            )

    def compare(self) -> None:
        """Refuse a controller whose axes do not match the machine.

        Raises
        ------
        CommandError
            If a setting differs from the machine file, or lets an axis exceed its limit; it names
            the first such setting.
        """
        machine, self.brakes_s = self.machine, 0.0
        expected = setting_values(machine, self._letters)
        for name, letter in zip(machine.axis_names, self._columns(), strict=True):
            for first_number, exact, quantity in (
                (STEPS, True, "steps"),
                (RATE, False, "speed"),
                (ACCELERATION, False, "acceleration"),
            ):
                number = first_number + letter
                board_value, expected_value = (
                    number_of(self._texts.get(number, "")),
                    expected[number],
                )
                within_limit = 0.0 < board_value <= expected_value * (1.0 + SAME)
                if not within_limit or (exact and board_value < expected_value * (1.0 - SAME)):
                    raise CommandError(
                        f"${number}={board_value:g} of the controller: the {quantity} of {name} in "
                        f"{machine.name} is {expected_value:.6g}",
                        remedy=f"Set ${number}={expected_value:.6g}, or correct the machine file.",
                    )
            speed, acceleration = (number_of(self._texts[n + letter]) for n in (RATE, ACCELERATION))
            self.brakes_s = max(self.brakes_s, speed / 60.0 / acceleration)

    def position(self, found: Status) -> FloatArray:
        """Return the (axes,) position in a status report, m or rad.

        Raises
        ------
        LinkFaultError
            If the report has no machine position or too few axes, or its coordinates are shifted.
        """
        if found.position is None:
            raise LinkFaultError(
                "the controller reports no machine positions",
                remedy="Set $10=1, so that it sends MPos.",
            )
        if len(found.position) < len(self._letters or self.machine.axes):
            raise LinkFaultError(f"the controller reports {len(found.position)} axes")
        if found.offset is not None and np.any(found.offset):
            raise LinkFaultError(f"its coordinates are shifted: {found.offset.tolist()}")
        return np.asarray(found.position[self._columns()] * units_of(self.machine))

    def beyond(self, place: FloatArray) -> str:
        """Return the first axis that is beyond its travel; empty if none is."""
        for value, (name, axis) in zip(place.tolist(), self.machine.axes.items(), strict=True):
            if axis.travel is not None and not (
                axis.travel[0].si - _TRAVEL_M <= value <= axis.travel[1].si + _TRAVEL_M
            ):
                return name
        return ""


def _refuse_other_reports(settings: dict[int, float]) -> None:
    """Refuse a controller whose settings change the unit or the origin of its positions."""
    if settings.get(13, 0.0) != 0.0:
        raise CommandError(
            f"$13={settings[13]:g} of the controller: it reports inches, and millimetres are read",
            remedy="Set $13=0.",
        )
    mask = settings.get(10, 1.0)
    if not (np.isfinite(mask) and int(mask) & 1):
        right = int(mask) | 1 if np.isfinite(mask) else 1
        raise CommandError(
            f"$10={mask:g} of the controller: it reports work positions, and machine positions are "
            "read",
            remedy=f"Set $10={right}.",
        )


AHEAD_S = 0.2
"""Most motion sent ahead of the last reported position, as time at the speed of the jog, s."""
_SEGMENT_S = 0.05


def axis_manual_feed(controller: Controller, axis: str) -> float:
    """Return the manual feed of an axis, m/s or rad/s.

    Raises
    ------
    CommandError
        If there is no such axis.
    """
    machine = controller.machine
    if axis not in machine.axes:
        raise CommandError(
            f"there is no axis {axis[:20]!r}", remedy=f"There are {', '.join(machine.axes)}."
        )
    k = machine.axis_names.index(axis)
    tick_s = float(machine.tick_clock.period_s)
    return float(manual_feed(machine)[k] / machine.counts_per_unit[k] / tick_s)


class GrblJog:
    """A jog of one axis to a position, or until it is cancelled.

    Parameters
    ----------
    controller
        The controller, at rest.
    at
        Position of the axis, m or rad.
    axis, velocity
        Name of the axis, and its velocity in m/s or rad/s; the sign is the direction.
    end
        Target, m or rad; None: the jog lasts until it is cancelled or the travel ends.

    Attributes
    ----------
    column
        Number of the axis.
    why
        Why the jog ended before the operator let go; empty if it did not.

    Raises
    ------
    CommandError
        If there is no such axis, the velocity is 0 or above the manual feed, or ``end`` is beyond
        the travel.
    """

    def __init__(
        self, controller: Controller, at: float, axis: str, velocity: float, end: float | None
    ) -> None:
        machine, most = controller.machine, axis_manual_feed(controller, axis)
        if not 0.0 < abs(velocity) <= most * (1.0 + 1e-9):
            raise CommandError(
                f"axis {axis}: {speed_words(machine, axis, abs(velocity))} is no speed up to the "
                f"manual feed, {speed_words(machine, axis, most)}",
                remedy="Jog more slowly, or change operator.manual_feed in the machine file.",
            )
        self.column = machine.axis_names.index(axis)
        travel = machine.axes[axis].travel
        low, high = (-math.inf, math.inf) if travel is None else (travel[0].si, travel[1].si)
        if end is not None and not low <= end <= high:
            raise CommandError(
                f"axis {axis}: {place_words(machine, axis, end)} is beyond its travel, "
                f"{place_words(machine, axis, low)} to {place_words(machine, axis, high)}",
                remedy="Move the position where the job starts.",
            )
        self._port, self._axis, self._speed = controller.port, axis, abs(velocity)
        self._unit = float(units_of(machine)[self.column])
        self._sign = math.copysign(1.0, velocity)
        self._end = end if end is not None else high if velocity > 0.0 else low
        self._stops_at_travel = end is None
        self._sent_to = at
        self._waits = False  # a line has not been answered yet
        self._asked_since = False  # a position was requested after the last answer
        self.cancelled = False
        self.why = ""

    @property
    def _complete(self) -> bool:
        return (self._end - self._sent_to) * self._sign <= 0.0

    def feed(self, at: float) -> None:
        """Send the next piece of the jog if it is due; the axis is at ``at``, m or rad."""
        piece_si = self._speed * _SEGMENT_S
        ahead_si = abs(self._sent_to - at)
        if (
            self._waits
            or self.cancelled
            or ahead_si + piece_si > self._speed * AHEAD_S * (1.0 + 1e-9)
        ):
            return
        if self._complete:
            if self._stops_at_travel:
                self.why = "the end of its travel"
            return
        next_si = self._sent_to + self._sign * piece_si
        self._sent_to = min(next_si, self._end) if self._sign > 0.0 else max(next_si, self._end)
        feed = 60.0 * self._speed / self._unit
        self._port.send(
            f"$J=G21G90G53{self._axis}{self._sent_to / self._unit:.4f}F{feed:.2f}\n".encode()
        )
        self._waits, self._asked_since = True, False

    def answered(self, refusal: str) -> None:
        """Process the answer to the sent line; a refusal ends the motion."""
        self._waits, self._asked_since = False, False
        if refusal:
            self.why = f"the controller refused to go on: {refusal}"
        if self.cancelled or refusal:
            self.cancel()  # grbl may have read this line after the first cancel, and moves again

    def note_request(self) -> None:
        """Note that a report was requested after all answered lines, and includes them."""
        self._asked_since = not self._waits

    def cancel(self) -> None:
        """End the motion at once."""
        self.cancelled = True
        self._port.send(JOG_CANCEL)

    def rests(self, found: Status) -> bool:
        """Return whether a report says that the motion is over."""
        is_reported = self._asked_since and not self._waits
        return is_reported and found.state == "Idle" and (self.cancelled or self._complete)
