"""State of a controller with grbl for a panel: settings, buffer, lines sent and received."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from threadline.errors import LinkFaultError
from threadline.live.grbl_console import ConsoleLine, Exchange, Traffic
from threadline.live.grbl_controller import Controller
from threadline.live.grbl_settings import BoardSetting
from threadline.live.grbl_words import Status
from threadline.live.guards import clock_s

_ANSWER_S = 3.0
_LISTEN_S = 0.05


@dataclass(frozen=True, slots=True)
class Fill:
    """How full the controller is, as it reports it.

    Parameters
    ----------
    blocks, characters
        Used blocks of its planner, and used characters of its receive buffer.
    of_blocks, of_characters
        How many it has.
    """

    blocks: int
    of_blocks: int
    characters: int
    of_characters: int


class GrblBoard:
    """The board of a controller with grbl.

    Parameters
    ----------
    controller
        The controller.
    traffic
        Its latest lines.

    Attributes
    ----------
    fill
        How full it is; None if it does not report it.
    readings
        How often its settings were read for a panel.
    """

    def __init__(self, controller: Controller, traffic: Traffic) -> None:
        self._controller, self._traffic = controller, traffic
        self.fill: Fill | None = None
        self.readings = 0
        self._most = (0, 0)  # the most that was free: some boards have more than they say

    @property
    def identity(self) -> str:
        """Version of the firmware; empty if it is unknown."""
        return self._controller.identity

    @property
    def settings(self) -> list[BoardSetting]:
        """Its settings beside the machine file."""
        return self._controller.settings

    def take(self) -> list[Exchange]:
        """Return the lines since the last call."""
        return self._traffic.take()

    def report(self, found: Status) -> None:
        """Take a status report."""
        if found.free is None:
            self.fill = None
            return
        blocks, characters = found.free
        self._most = max(self._most[0], blocks), max(self._most[1], characters)
        of_blocks = max(self._controller.blocks, self._most[0])
        of_characters = max(self._controller.room, self._most[1])
        self.fill = Fill(of_blocks - blocks, of_blocks, of_characters - characters, of_characters)

    def send(self, line: ConsoleLine, look: Callable[[], object]) -> str:
        """Send a typed line at rest, and return its answer: ``ok``, or a refusal.

        Parameters
        ----------
        look
            Called every 50 ms meanwhile.

        Raises
        ------
        LinkFaultError
            If it does not answer: a later answer would be taken for another line's.
        """
        port = self._controller.port
        self._traffic.typed(line.text)
        port.send(f"{line.text}\n".encode())
        until = clock_s() + _ANSWER_S
        while clock_s() < until and not port.lost:
            heard = port.receive(_LISTEN_S)
            if heard == "ok" or (heard is not None and heard.startswith(("error", "ALARM"))):
                return heard
            look()
        raise LinkFaultError(f"the controller did not answer {line.text!r} within {_ANSWER_S:g} s")
