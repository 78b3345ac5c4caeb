"""Guards of a run of an embroidery frame, whose servos tell nothing of where they are."""

from __future__ import annotations

from collections.abc import Mapping

from threadline.arrays import FloatArray
from threadline.live.lateness import Lateness


class TurnGuards:
    """Checks the reports of one run: that they come in time."""

    def __init__(self) -> None:
        self._lateness = Lateness()

    def trip(
        self,
        tick: int,  # noqa: ARG002
        samples: Mapping[str, FloatArray],  # noqa: ARG002
        late: bool,
        late_periods: float,
    ) -> str:
        """Return the text of the fault in a report; empty where there is none."""
        return self._lateness.trip(late, late_periods)
