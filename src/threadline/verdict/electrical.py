"""Currents and the controller's output: peak, root mean square, ticks at the clamp."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from threadline.arrays import FloatArray
from threadline.machine.controllers import Dac
from threadline.verdict.measure import Finding, Measure, largest
from threadline.verdict.samples import Block, Setting


class _CurrentPeak:
    """Per axis: the largest absolute current of its motor, in A.

    Between samples too where the recording has a channel ``AXIS.current_peak``. The note says which
    share of its drive's limit that is, and which axis uses the largest and so binds.
    """

    def __init__(self, setting: Setting) -> None:
        self._axes = setting.axes
        self._machine = setting.plan.machine
        self._worst: dict[str, Finding] = {}

    def feed(self, block: Block) -> None:
        assert block.current is not None
        sizes = np.abs(block.current)
        if block.current_peak is not None:  # of some axes it may be recorded, of others not
            sizes = np.fmax(sizes, np.abs(block.current_peak))
        for column, axis in enumerate(self._axes):
            at, value = largest(sizes[:, column])
            known = self._worst.get(axis)
            if at >= 0 and (known is None or known.value is None or value > known.value):
                self._worst[axis] = Finding(
                    value=value,
                    axis=axis,
                    time_s=float(block.time_s[at]),
                    operation=block.operation_at(at),
                    position=block.position_at(at),
                )

    def finish(self) -> Sequence[Finding]:
        limits = {
            axis: self._machine.drive_of(axis).amplifier.current_limit for axis in self._worst
        }
        shares = {
            axis: (finding.value or 0.0) / limit.si
            for axis, finding in self._worst.items()
            if (limit := limits[axis]) is not None
        }
        binds = max(shares, key=shares.__getitem__, default="")
        found = []
        for axis, finding in self._worst.items():
            limit, note = limits[axis], ""
            if limit is not None:
                drive = self._machine.controller_of(axis).drive
                note = f"{100.0 * shares[axis]:.3g} % of the {limit.si:g} A of drives.{drive}"
            if axis == binds:
                note += ", the axis that binds"
            elif binds:
                note = "; ".join(filter(None, (note, f"{binds} binds")))
            found.append(replace(finding, note=note))
        return found


class _CurrentRms:
    """Per axis: the root mean square of the motor's current over the recording, in A."""

    def __init__(self, setting: Setting) -> None:
        self._axes = setting.axes
        self._sum: FloatArray = np.zeros(len(setting.axes))
        self._count = 0

    def feed(self, block: Block) -> None:
        assert block.current is not None
        self._sum = self._sum + np.einsum("ij,ij->j", block.current, block.current)
        self._count += len(block)

    def finish(self) -> Sequence[Finding]:
        mean = self._sum / max(self._count, 1)
        return [
            Finding(value=float(np.sqrt(value)), axis=axis)
            for axis, value in zip(self._axes, mean, strict=True)
            if self._count and np.isfinite(value)
        ]


class _DacSaturation:
    """Per axis: the fraction of samples at which the controller's output is at its clamp.

    At the clamp the loop is open. The clamp is ``range`` minus one level on the positive side
    and at most ``range`` on the negative one; both ends count from half a level before.
    """

    def __init__(self, setting: Setting) -> None:
        machine = setting.plan.machine
        self._axes = setting.axes
        self._dacs: list[Dac] = [machine.controller_of(axis).dac for axis in setting.axes]
        self._clamped = [0] * len(setting.axes)
        self._count = 0
        self._first: dict[str, Finding] = {}

    def feed(self, block: Block) -> None:
        assert block.voltage is not None
        self._count += len(block)
        for column, (axis, dac) in enumerate(zip(self._axes, self._dacs, strict=True)):
            clamp = dac.range.si - 1.5 * dac.volt_per_level
            at = np.flatnonzero(np.abs(block.voltage[:, column]) >= clamp)
            self._clamped[column] += len(at)
            if len(at) and axis not in self._first:
                self._first[axis] = Finding(
                    value=0.0,
                    axis=axis,
                    time_s=float(block.time_s[at[0]]),
                    operation=block.operation_at(int(at[0])),
                    position=block.position_at(int(at[0])),
                )

    def finish(self) -> Sequence[Finding]:
        findings = []
        for axis, clamped in zip(self._axes, self._clamped, strict=True):
            if not self._count:
                continue
            first = self._first.get(axis, Finding(value=0.0, axis=axis))
            findings.append(
                Finding(
                    value=clamped / self._count,
                    axis=axis,
                    time_s=first.time_s,
                    operation=first.operation,
                    position=first.position,
                    note=f"{clamped} of {self._count} samples at the clamp" if clamped else "",
                )
            )
        return findings


def start_current_peak(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin measuring the peak current."""
    return _CurrentPeak(setting)


def start_current_rms(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin measuring the root mean square current."""
    return _CurrentRms(setting)


def start_dac_saturation(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin counting the samples at the clamp."""
    return _DacSaturation(setting)
