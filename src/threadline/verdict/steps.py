"""Lost steps: the torque that is asked of a drive over what it has at its speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from threadline.verdict.measure import Finding, Measure, largest
from threadline.verdict.samples import Block, Setting


class _StepLoss:
    """Per axis: the largest share of its drive's torque that is asked; above 1 it loses steps."""

    def __init__(self, setting: Setting) -> None:
        self._axes = setting.axes
        self._worst: dict[str, Finding] = {}

    def feed(self, block: Block) -> None:
        assert block.torque_share is not None
        for column, axis in enumerate(self._axes):
            at, value = largest(block.torque_share[:, column])
            known = self._worst.get(axis)
            if at >= 0 and (known is None or known.value is None or value > known.value):
                self._worst[axis] = Finding(
                    value=value,
                    axis=axis,
                    time_s=float(block.time_s[at]),
                    operation=block.operation_at(at),
                    position=block.position_at(at),
                    note="it loses steps" if value > 1.0 else "",
                )

    def finish(self) -> Sequence[Finding]:
        return list(self._worst.values())


def start_step_loss(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin measuring what is asked of the drives."""
    return _StepLoss(setting)
