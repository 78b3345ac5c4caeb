"""How the judged runs ended: what comes after the end of a run was not measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from threadline.signals import Outcome, Recording, RecordingBlock
from threadline.signals.outcome import said_once
from threadline.verdict.types import Result, Status


class Heard:
    """The blocks of a recording; what their events say is known once they have been read."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._outcome: Outcome | None = None

    def __iter__(self) -> Iterator[RecordingBlock]:
        known = Outcome()
        for block in self._recording:
            known = known.after(block.events)
            yield block
        self._outcome = known

    def outcome(self) -> Outcome:
        """Return how the run ended; reads the recording only if nothing else has read all of it."""
        if self._outcome is None:
            for _ in self:
                pass
        assert self._outcome is not None
        return self._outcome


def heard(recordings: Sequence[Recording]) -> list[tuple[Recording, Heard]]:
    """Return each recording, its blocks read through a ``Heard``, and that ``Heard``."""
    found = []
    for recording in recordings:
        listener = Heard(recording)
        found.append((replace(recording, blocks=listener), listener))
    return found


def told_end(outcome: Outcome) -> str:
    """Say how a run ended before its last row; empty if it came to its end."""
    if not outcome.incomplete:
        return ""
    assert outcome.ended is not None
    # A controller that tells of no operation leaves -1.
    told = outcome.operation is not None and outcome.operation >= 0
    where = f" in operation {outcome.operation}" if told else ""
    return f"the run ended{where}, {said_once(outcome.ended.value, outcome.text)}"


def not_beyond(result: Result, why: str) -> Result:
    """Return ``result`` when a run ended early: only a failure seen until then is certain."""
    if not why or result.status in {Status.FAILED, Status.NOT_MEASURED}:
        return result
    so_far = (
        "" if result.measured is None else f" ({_told(result.measured, result.unit)} until then)"
    )
    note = "; ".join(filter(None, (result.note, f"{why}{so_far}")))
    return replace(result, status=Status.NOT_MEASURED, measured=None, note=note)


def _told(value: float, unit: str) -> str:
    """Return a value with its unit; what has none is a share.

    >>> _told(0.25e-3, "m"), _told(0.05, "")
    ('0.00025 m', '5 %')
    """
    return f"{value:.4g} {unit}" if unit else f"{100.0 * value:.4g} %"
