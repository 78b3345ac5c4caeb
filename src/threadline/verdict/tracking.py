"""Tracking error: where the axis is against where it was told to be, at the same instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from threadline.signals import ChannelKind
from threadline.verdict.measure import Finding, Measure, largest
from threadline.verdict.samples import Block, Setting


class _Tracking:
    """Per axis, in its own unit (m or rad): the largest absolute difference. Lag counts.

    The actual position is that of the tool or the load. A live machine has neither: there it is
    what the axis' own encoder read, and the result says so.
    """

    def __init__(self, setting: Setting) -> None:
        self._axes = setting.axes
        recording = setting.recording
        self._own = [
            recording.find(ChannelKind.TOOL, axis) is None
            and recording.find(ChannelKind.LOAD, axis) is None
            for axis in setting.axes
        ]
        self._worst: dict[str, Finding] = {}

    def feed(self, block: Block) -> None:
        assert block.commanded is not None
        for column, axis in enumerate(self._axes):
            source = block.own if self._own[column] else block.actual
            if source is None:
                continue
            at, value = largest(np.abs(source[:, column] - block.commanded[:, column]))
            known = self._worst.get(axis)
            if at < 0 or (known is not None and known.value is not None and value <= known.value):
                continue
            self._worst[axis] = Finding(
                value=value,
                axis=axis,
                time_s=float(block.time_s[at]),
                operation=block.operation_at(at),
                position=block.position_at(at),
                note="of the axis' own encoder" if self._own[column] else "",
            )

    def finish(self) -> Sequence[Finding]:
        return list(self._worst.values())


def start_tracking(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin measuring the tracking error."""
    return _Tracking(setting)
