"""Tracking error: where the axis is against where it was told to be, at the same instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from threadline.signals import ChannelKind
from threadline.verdict.finding import Found, Worst
from threadline.verdict.largest import largest
from threadline.verdict.measure import Measure
from threadline.verdict.samples import Block, Setting


class _Tracking:
    """Per axis, in its own unit (m or rad): the largest absolute difference. Lag counts.

    The actual position is that of the tool or the load. A live machine has neither: there it is
    what the axis' own encoder read, and the result says so.
    """

    def __init__(self, setting: Setting) -> None:
        recording = setting.recording
        self._own = [
            recording.find(ChannelKind.TOOL, axis) is None
            and recording.find(ChannelKind.LOAD, axis) is None
            for axis in setting.axes
        ]
        count = len(setting.axes)
        self._worst = [Worst(setting.runs, count, axis) for axis in setting.axes]

    def feed(self, block: Block) -> None:
        for source, own in ((block.actual, False), (block.own, True)):
            columns = [column for column, mine in enumerate(self._own) if mine == own]
            if source is None or not columns:
                continue
            sizes, at = largest(source, block.commanded)
            for column in columns:
                self._worst[column].offer(
                    sizes[column],
                    time_s=block.time_s[at[column]],
                    operation=block.operations_at(at[column]),
                    position=block.positions_at(at[column]),
                    note="of the axis' own encoder" if own else "",
                )

    def finish(self) -> Sequence[Found]:
        found = (worst.found() for worst in self._worst)
        return [one for one in found if not np.isnan(one.value).all()]


def start_tracking(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin measuring the tracking error."""
    return _Tracking(setting)
