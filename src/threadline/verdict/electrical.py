"""Currents and the controller's output: peak, root mean square, ticks at the clamp."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.machine.controllers import Dac
from threadline.verdict.finding import Finding, RunFindings, Worst
from threadline.verdict.measure import SweptMeasure
from threadline.verdict.samples import Block, Setting, lanes


class PeakPart(NamedTuple):
    """Arrays that a sweep over a block reads and updates for the peak current.

    ``current`` and ``between``, (n, axes, runs), are compared with ``zero``, (n, axes); ``between``
    may be empty. ``size`` and ``at``, (2, axes, runs), become the largest size in each array, and
    its first sample, or -1.
    """

    current: FloatArray
    between: FloatArray
    zero: FloatArray
    size: FloatArray
    at: IntArray


class RmsPart(NamedTuple):
    """Arrays of a sweep for the mean current: mean squares are added to ``total``, (axes, runs).

    ``before``, (axes, runs), is the sample before the block; with ``fresh`` there is none.
    """

    current: FloatArray
    before: FloatArray
    fresh: bool
    total: FloatArray


class DacPart(NamedTuple):
    """Arrays that a sweep reads and updates for the clamped samples.

    ``beyond``, (axes, runs), counts the (n, axes, runs) values of at least ``limit``, (axes,);
    ``first`` becomes the number of the first such sample. The block begins with number ``begin``.
    """

    voltage: FloatArray
    limit: FloatArray
    beyond: IntArray
    first: IntArray
    begin: int


class _CurrentPeak(SweptMeasure):
    """Per axis: the largest absolute current of its motor, in A.

    Includes the time between samples if the recording has a channel ``AXIS.current_peak``. The note
    gives the share of the drive's limit, and marks the axis with the largest share.
    """

    def __init__(self, setting: Setting) -> None:
        machine = setting.plan.machine
        self._limits = [machine.drive_of(axis).amplifier.current_limit for axis in setting.axes]
        self._drives = [machine.controller_of(axis).drive for axis in setting.axes]
        count = len(setting.axes)
        self._worst = [Worst(setting.runs, count, axis) for axis in setting.axes]
        self._part: PeakPart | None = None

    def part(self, block: Block) -> PeakPart:
        """Return the arrays for the sweep: samples, and the peaks between them if recorded."""
        assert block.current is not None
        current = lanes(block.current)
        # It may be recorded for some axes only.
        between = current[:0] if block.current_peak is None else lanes(block.current_peak)
        shape = 2, *current.shape[1:]
        self._part = PeakPart(
            current=current,
            between=between,
            zero=np.zeros(current.shape[:2]),
            size=np.full(shape, -np.inf),
            at=np.full(shape, -1, dtype=np.int64),
        )
        return self._part

    def feed(self, block: Block) -> None:
        """Take the sweep's results; of equal values the earlier counts."""
        assert self._part is not None
        (sizes, between), (at, at_peak) = self._part.size, self._part.at
        self._part = None
        sooner = (between > sizes) | ((between == sizes) & (at_peak < at))
        sizes, at = np.where(sooner, between, sizes), np.where(sooner, at_peak, at)
        for column, worst in enumerate(self._worst):
            if not worst.is_beaten(sizes[column]):
                continue
            worst.offer(
                sizes[column],
                time_s=block.time_s[at[column]],
                operation=block.operations_at(at[column]),
                position=block.positions_at(at[column]),
            )

    def finish(self) -> Sequence[RunFindings]:
        """Return the findings of every axis."""
        found = [worst.found() for worst in self._worst]
        limits = [np.nan if limit is None else limit.si for limit in self._limits]
        shares = np.array([f.value / limit for f, limit in zip(found, limits, strict=True)])
        return [
            replace(f, of=partial(self._finding, f, column, shares))
            for column, f in enumerate(found)
            if not np.isnan(f.value).all()
        ]

    def _finding(self, found: RunFindings, column: int, shares: FloatArray, run: int) -> Finding:
        """Return the finding of a run with the share of its limit, and the axis that binds."""
        finding, limit, own = found.of(run), self._limits[column], shares[:, run]
        binds = None if np.isnan(own).all() else int(np.nanargmax(own))
        note = ""
        if limit is not None:
            share = 100.0 * own[column]
            note = f"{share:.3g} % of the {limit.si:g} A of drives.{self._drives[column]}"
        if column == binds:
            note += ", the axis that binds"
        elif binds is not None:
            note = "; ".join(filter(None, (note, f"{self._worst[binds].axis} binds")))
        return replace(finding, note=note)


class _CurrentRms(SweptMeasure):
    """Per axis: the root mean square of the motor's current over the recording, in A.

    Between two samples the current is interpolated linearly.
    """

    def __init__(self, setting: Setting) -> None:
        self._axes = setting.axes
        self._sum: FloatArray = np.zeros((len(setting.axes), setting.runs))
        self._last: FloatArray = np.zeros((len(setting.axes), setting.runs))
        self._count = 0

    def part(self, block: Block) -> RmsPart:
        """Return the arrays for the sweep."""
        assert block.current is not None
        return RmsPart(lanes(block.current), self._last, self._count == 0, self._sum)

    def feed(self, block: Block) -> None:
        """Count the samples that the sweep has added."""
        self._count += len(block)

    def finish(self) -> Sequence[RunFindings]:
        """Return the findings of every axis."""
        mean = self._sum / (self._count - 1) if self._count > 1 else self._last**2
        return [
            _plain(axis, np.sqrt(row))
            for axis, row in zip(self._axes, mean, strict=True)
            if self._count and np.isfinite(row).any()
        ]


def _plain(axis: str, values: FloatArray) -> RunFindings:
    """Return values without a place."""
    found = Worst(len(values), 0, axis)
    found.offer(values)
    return found.found()


class _DacSaturation(SweptMeasure):
    """Per axis: the share of the time in which the controller's output is at its clamp.

    A controller holds its output, so each sample stands for one interval, the last one too. At the
    clamp the loop is open. The clamp is ``range`` minus one level on the positive side, and at most
    ``range`` on the negative side. A value within half a level of the clamp counts.
    """

    def __init__(self, setting: Setting) -> None:
        machine = setting.plan.machine
        self._axes = setting.axes
        dacs: list[Dac] = [machine.controller_of(axis).dac for axis in setting.axes]
        self._clamp: FloatArray = np.array(
            [dac.range.si - 1.5 * dac.volt_per_level for dac in dacs]
        )
        shape = len(setting.axes), setting.runs
        self._clamped: IntArray = np.zeros(shape, dtype=np.int64)
        self._first: IntArray = np.full(shape, -1, dtype=np.int64)
        # Place of the first sample at the clamp; no other sample is offered.
        self._where = [Worst(setting.runs, shape[0], axis) for axis in setting.axes]
        self._count = 0

    def part(self, block: Block) -> DacPart:
        """Return the arrays for the sweep."""
        assert block.voltage is not None
        return DacPart(lanes(block.voltage), self._clamp, self._clamped, self._first, self._count)

    def feed(self, block: Block) -> None:
        """Note the places of the first samples at the clamp."""
        for column, where in enumerate(self._where):
            at = self._first[column] - self._count
            fresh = at >= 0
            if fresh.any():
                index = np.maximum(at, 0)
                where.offer(
                    np.where(fresh, 0.0, np.nan),
                    time_s=block.time_s[index],
                    operation=block.operations_at(index),
                    position=block.positions_at(index),
                )
        self._count += len(block)

    def finish(self) -> Sequence[RunFindings]:
        """Return the findings of every axis."""
        if not self._count:
            return []
        return [
            RunFindings(
                axis=axis,
                value=self._clamped[column] / self._count,
                of=partial(self._finding, column),
            )
            for column, axis in enumerate(self._axes)
        ]

    def _finding(self, column: int, run: int) -> Finding:
        clamped = int(self._clamped[column, run])
        first = self._where[column].of(run)
        note = f"{clamped} of {self._count} samples at the clamp" if clamped else ""
        return replace(first, value=clamped / self._count, note=note)


def start_current_peak(setting: Setting, options: Mapping[str, float]) -> SweptMeasure:  # noqa: ARG001
    """Begin measuring the peak current."""
    return _CurrentPeak(setting)


def start_current_rms(setting: Setting, options: Mapping[str, float]) -> SweptMeasure:  # noqa: ARG001
    """Begin measuring the root mean square current."""
    return _CurrentRms(setting)


def start_dac_saturation(setting: Setting, options: Mapping[str, float]) -> SweptMeasure:  # noqa: ARG001
    """Begin counting the samples at the clamp."""
    return _DacSaturation(setting)
