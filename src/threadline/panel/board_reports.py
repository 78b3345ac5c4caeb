"""Reports of a controller's board to the web server: settings, fill of its buffer, its lines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from threadline.live.grbl_console import Exchange
from threadline.live.operated import Operated

SAID_S = 0.25
"""Shortest time between two reports of the lines of a run, s."""
_MOST_SAID = 40  # lines of a run in one report


class BoardReports:
    """The news of a board since the last report.

    Parameters
    ----------
    executor
        The machine; without a board there are no reports.
    """

    def __init__(self, executor: Operated) -> None:
        self._executor = executor
        self._readings = 0
        self._waiting: list[Exchange] = []
        self._sent_s = 0.0

    def fill(self) -> dict[str, int] | None:
        """Return how full the controller is; None if it does not report it."""
        board = self._executor.board
        return None if board is None or board.fill is None else asdict(board.fill)

    def news(self, now_s: float) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield kind and content of each report that is due.

        The lines of a program come in batches, each cut to its latest ``_MOST_SAID`` lines.
        """
        board = self._executor.board
        if board is None:
            return
        if board.readings != self._readings and board.settings:
            self._readings = board.readings
            rows = [asdict(one) for one in board.settings]
            yield "board", {"firmware": board.identity, "settings": rows}
        self._waiting += board.take()
        of_run = all(one.kind == "program" for one in self._waiting)
        if not self._waiting or (of_run and now_s - self._sent_s < SAID_S):
            return
        left_out = max(len(self._waiting) - _MOST_SAID, 0) if of_run else 0
        lines = [asdict(one) for one in self._waiting[left_out:]]
        self._waiting, self._sent_s = [], now_s
        yield "console", {"lines": lines, "left_out": left_out}
