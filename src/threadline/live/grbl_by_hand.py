"""An axis moved by hand on a controller with grbl: short lines of ``$J=``, few of them ahead.

grbl ends every motion that it holds at rest. What it is sent is never more than ``AHEAD_S`` of
motion beyond where it was last reported, so that it stands within that time where nobody sends
more, whoever has died. A jog cancel (0x85) ends it at once.

Source: "Grbl v1.1 Jogging" of gnea/grbl.
"""

from __future__ import annotations

import math

from threadline.errors import CommandError
from threadline.live.grbl_controller import Controller, units_of
from threadline.live.grbl_words import JOG_CANCEL, Status
from threadline.live.jogging import manual_feed
from threadline.live.place_words import place_words, speed_words

AHEAD_S = 0.2
"""Motion that is sent ahead of what was reported, s at its speed."""
_SEGMENT_S = 0.05


def fastest_by_hand(controller: Controller, axis: str) -> float:
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
    """A motion of one axis to a place, or until it is cancelled.

    Parameters
    ----------
    controller
        The controller, at rest.
    at
        Where the axis stands, m or rad.
    axis, velocity
        Its name, and its velocity in m/s or rad/s; the sign is the direction.
    end
        Where it ends at the latest, m or rad; None is the end of its travel.

    Attributes
    ----------
    column
        Number of the axis.
    why
        Reason of an end before the operator let go; empty where there is none.

    Raises
    ------
    CommandError
        If there is no such axis, its manual feed is lower, or ``end`` is beyond its travel.
    """

    def __init__(
        self, controller: Controller, at: float, axis: str, velocity: float, end: float | None
    ) -> None:
        machine, most = controller.machine, fastest_by_hand(controller, axis)
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
        self._waits = False  # a line was not answered yet
        self._asked_since = False  # the position was asked for after the last answer
        self.cancelled = False
        self.why = ""

    @property
    def _complete(self) -> bool:
        return (self._end - self._sent_to) * self._sign <= 0.0

    def feed(self, at: float) -> None:
        """Send the next piece where that is due, the axis being at a place, m or rad."""
        piece = self._speed * _SEGMENT_S
        held = abs(self._sent_to - at)
        if self._waits or self.cancelled or held + piece > self._speed * AHEAD_S * (1.0 + 1e-9):
            return
        if self._complete:
            if self._stops_at_travel:
                self.why = "the end of its travel"
            return
        to = self._sent_to + self._sign * piece
        self._sent_to = min(to, self._end) if self._sign > 0.0 else max(to, self._end)
        feed = 60.0 * self._speed / self._unit
        self._port.send(
            f"$J=G21G90G53{self._axis}{self._sent_to / self._unit:.4f}F{feed:.2f}\n".encode()
        )
        self._waits, self._asked_since = True, False

    def answered(self, refusal: str) -> None:
        """Take the answer to the line that was sent; a refused one ends the motion."""
        self._waits, self._asked_since = False, False
        if refusal:
            self.why = f"the controller refused to go on: {refusal}"
        if self.cancelled or refusal:
            self.cancel()  # what was read after the first cancel began a motion of its own

    def asked(self) -> None:
        """Note that the position was asked for: its report knows of all answered lines."""
        self._asked_since = not self._waits

    def cancel(self) -> None:
        """End the motion at once."""
        self.cancelled = True
        self._port.send(JOG_CANCEL)

    def rests(self, found: Status) -> bool:
        """Return whether a report says that the motion is over."""
        known = self._asked_since and not self._waits
        return known and found.state == "Idle" and (self.cancelled or self._complete)
