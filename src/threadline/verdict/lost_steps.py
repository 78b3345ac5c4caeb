"""Lost steps: the torque that is asked of a drive, over the torque that it has at its speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from threadline.verdict.finding import Found, Worst
from threadline.verdict.largest import largest
from threadline.verdict.measure import Measure
from threadline.verdict.samples import Block, Setting


class _StepLoss:
    """Per axis: the largest share of its drive's torque that is asked; above 1 it loses steps."""

    def __init__(self, setting: Setting) -> None:
        count = len(setting.axes)
        self._worst = [Worst(setting.runs, count, axis) for axis in setting.axes]

    def feed(self, block: Block) -> None:
        assert block.torque_share is not None
        sizes, at = largest(block.torque_share)
        for column, worst in enumerate(self._worst):
            lost = sizes[column] > 1.0
            worst.offer(
                sizes[column],
                time_s=block.time_s[at[column]],
                operation=block.operations_at(at[column]),
                position=block.positions_at(at[column]),
                note=np.where(lost, "it loses steps", "").astype(object),
            )

    def finish(self) -> Sequence[Found]:
        found = (worst.found() for worst in self._worst)
        return [one for one in found if not np.isnan(one.value).all()]


def start_step_loss(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin measuring the share of the drives' torque that is asked."""
    return _StepLoss(setting)
