"""The judge for thousands of candidates: its own measures, fed from a batch's load channels.

Everything that doesn't depend on the candidate (which chords the command is on, when the needle
goes down) is worked out once. Contour and the other criteria are measured by the very measures of
the verdict; stitch lengths in one sweep over candidates and needle delays.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import MachineError, OptionError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.plan import Plan
from threadline.signals import ChannelKind, Stream, tick_table
from threadline.twin import simulate, simulate_batch
from threadline.verdict import Criterion, Spec
from threadline.verdict.blocks import judged_blocks, setting_of
from threadline.verdict.measure import OfRun
from threadline.verdict.needle import Stitches, has_stitches, planned_stitches
from threadline.verdict.registry import MEASURES
from threadline.verdict.samples import Block, Setting
from threadline.verdict.window import PathWindow

SETTLE_S = 0.25
MOST_SAMPLES = 60_000
HOPELESS = 1e3
"""The ratio, and the most, of a variant that cannot be planned, simulated or measured."""

_CHUNK_BYTES = 2.5e8
_AT_ONCE = 256
_LENGTH = "stitch_length_error"
_SEAM = "seam_error"
_CHANNELS: Mapping[ChannelKind, tuple[tuple[str, str], ...]] = {
    ChannelKind.LOAD: (("actual", "load"),),
    ChannelKind.MEASURED: (("own", "measured"),),
    ChannelKind.VOLTAGE: (("voltage", "voltage"),),
    ChannelKind.CURRENT: (("current", "current"), ("current_peak", "current_peak")),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ratios:
    """How much of each limit candidates use; n candidates, D needle delays.

    Parameters
    ----------
    names
        Of the criteria other than the stitch length.
    others
        (n, criteria) measured over limit.
    length
        (n, D) the same of the stitch length for each delay; None where it isn't asked for.
    """

    names: tuple[str, ...]
    others: FloatArray
    length: FloatArray | None

    def worst_of(self, count: int) -> Ratios:
        """Return the worst of every ``count`` consecutive ones (the corners of a candidate)."""
        length = None
        if self.length is not None:
            length = self.length.reshape(-1, count, self.length.shape[1]).max(axis=1)
        return Ratios(
            names=self.names,
            others=self.others.reshape(-1, count, len(self.names)).max(axis=1),
            length=length,
        )

    def worse(self, other: Ratios) -> Ratios:
        """Return the worse of two, candidate by candidate."""
        length = None
        if self.length is not None and other.length is not None:
            length = np.maximum(self.length, other.length)
        return Ratios(names=self.names, others=np.maximum(self.others, other.others), length=length)

    def best(self) -> tuple[FloatArray, np.ndarray]:
        """Return (n,) the worst ratio at the best delay, and (n,) which delay that is."""
        rest = self.others.max(axis=1, initial=0.0)
        if self.length is None:
            return rest, np.zeros(len(rest), dtype=np.int64)
        at = self.length.argmin(axis=1)
        return np.maximum(rest, self.length[np.arange(len(rest)), at]), at

    def binding(self, index: int) -> str:
        """Return the criterion that a candidate uses most of."""
        rest = self.others[index].max(initial=0.0)
        if self.length is not None and self.length[index].min() >= rest:
            return _LENGTH
        return self.names[int(self.others[index].argmax())] if self.names else _LENGTH


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class QuickJudge:
    """Judges variants of a machine under the commands of one plan.

    Parameters
    ----------
    plan
        Whose commands every variant gets, kept in memory.
    criteria
        With a limit, measured on a recording.
    lag_s
        Of the specification.
    delays_s
        (D,) needle delays; what the specification says where there are none.
    blocks
        Of the plan's own recording: all that doesn't depend on the variant.
    stitches
        Needle-downs of the plan.
    plan_ratio
        Criteria of the plan itself: measured over limit.
    """

    plan: Plan
    criteria: tuple[Criterion, ...]
    lag_s: float
    delays_s: FloatArray
    blocks: tuple[Block, ...]
    stitches: tuple[Stitches, ...]
    columns: tuple[tuple[str, str], ...]
    setting: Setting
    settle_s: float = SETTLE_S
    _others: tuple[Criterion, ...] = field(default=())

    def ratios(self, variants: Mapping[str, FloatArray], count: int) -> Ratios:
        """Return how much of each limit ``count`` variants use; 1000 where there is no answer."""
        samples = sum(len(block) for block in self.blocks)
        chunk = max(int(_CHUNK_BYTES / (8 * samples * max(len(self._channels()), 1))), 1)
        parts = [
            self._part({k: v[at : at + chunk] for k, v in variants.items()}, min(chunk, count - at))
            for at in range(0, count, chunk)
        ]
        return Ratios(
            names=parts[0].names,
            others=np.concatenate([p.others for p in parts]),
            length=None
            if parts[0].length is None
            else np.concatenate([p.length for p in parts if p.length is not None]),
        )

    def _channels(self) -> tuple[str, ...]:
        axes = self.plan.motion.programmed.axes
        return tuple(f"{axis}.{name}" for _, name in self.columns for axis in axes)

    def _part(self, variants: Mapping[str, FloatArray], count: int) -> Ratios:
        names = tuple(f"{c.name} {c.axis}".strip() for c in self._others)
        delays = len(self.delays_s) if len(self._others) < len(self.criteria) else 0
        try:
            found = simulate_batch(
                tick_table(self.plan.commands),
                self.plan.machine,
                variants,
                settle_s=self.settle_s,
                channels=self._channels(),
            )
        except MachineError:
            # One variant without an answer ends the batch: the halves say which.
            if count == 1:
                return Ratios(
                    names=names,
                    others=np.full((1, len(names)), HOPELESS),
                    length=np.full((1, delays), HOPELESS) if delays else None,
                )
            half = count // 2
            low = self._part({k: v[:half] for k, v in variants.items()}, half)
            high = self._part({k: v[half:] for k, v in variants.items()}, count - half)
            return Ratios(
                names=names,
                others=np.concatenate([low.others, high.others]),
                length=np.concatenate([low.length, high.length])
                if low.length is not None and high.length is not None
                else None,
            )
        axes = self.plan.motion.programmed.axes
        data = {
            column: np.stack([found.samples[f"{axis}.{name}"] for axis in axes], axis=2)
            for column, name in self.columns
        }
        others = np.array([self._measured(data, v) for v in range(count)]).reshape(count, -1)
        length = self._length(data["actual"]) if delays else None
        return Ratios(names=names, others=others, length=length)

    def _measured(self, data: Mapping[str, FloatArray], variant: int) -> list[float]:
        running = []
        for criterion in self._others:
            kind = MEASURES[criterion.name]
            measure = kind.start(self.setting, criterion.options)
            assert measure is not None
            running.append(measure)
        for block in self.blocks:
            own = slice(block.first, block.first + len(block))
            columns: dict[str, Any] = {k: v[own, variant] for k, v in data.items()}
            filled = replace(block, **columns)
            for measure in running:
                measure.feed(filled)
        found = []
        for criterion, measure in zip(self._others, running, strict=True):
            values = [
                f.value
                for f in measure.finish()
                if f.value is not None and criterion.axis in {"", f.axis}
            ]
            assert criterion.limit is not None
            found.append(_share(max(values, default=0.0), criterion.limit))
        return found

    def _length(self, load: FloatArray) -> FloatArray:
        """Return (n, D) the stitch length error over its limit, from (samples, n, axes) loads."""
        (criterion,) = (c for c in self.criteria if c.name == _LENGTH)
        assert criterion.limit is not None
        worst = np.zeros((load.shape[1], len(self.delays_s)))
        columns = [self.plan.motion.programmed.axes.index(axis) for axis in self.plan.job.axes]
        points = (load * self.plan.motion.programmed.radius_m)[:, :, columns]
        for run in self.stitches:
            kept = ~run.exempt
            target = run.target_m[kept, None]
            for d, delay_s in enumerate(self.delays_s):
                moved = self._at(points, run.down_s[kept] + delay_s)
                moved -= self._at(points, run.from_s[kept] + delay_s)
                error = np.abs(np.sqrt((moved**2).sum(axis=2)) / target - 1.0)
                worst[:, d] = np.maximum(worst[:, d], error.max(axis=0, initial=0.0))
        return np.asarray(worst / criterion.limit)

    def _at(self, points: FloatArray, time_s: FloatArray) -> FloatArray:
        """Return (m, n, axes) the points at (m,) times, straight between samples."""
        place = np.clip(time_s / self.setting.interval_s, 0.0, len(points) - 1.0)
        index = np.minimum(place.astype(np.int64), len(points) - 2)
        part = (place - index)[:, None, None]
        return np.asarray(points[index] * (1.0 - part) + points[index + 1] * part)


def _share(value: float, limit: float) -> float:
    if limit <= 0.0:
        return 0.0 if value <= 0.0 else HOPELESS
    return min(value / limit, HOPELESS)


def quick_judge(plan: Plan, machine: Machine, spec: Spec, delays_s: FloatArray) -> QuickJudge:
    """Prepare to judge variants of ``machine`` under the commands of ``plan``.

    Parameters
    ----------
    delays_s
        (D,) needle delays to try; empty for the one of the specification.

    Raises
    ------
    OptionError
        If the job is too long to be simulated thousands of times.
    """
    recording = simulate(tick_table(plan.commands), machine, settle_s=SETTLE_S)
    kept = []
    count = 0
    for block in recording:
        kept.append(block)
        count += len(block.samples["operation"])
        if count > MOST_SAMPLES:
            raise OptionError(
                f"{plan.job.name}: the job is longer than {MOST_SAMPLES} ticks, too long to be "
                "simulated for thousands of machines",
                remedy="Search on a short job that has the hard places of it, then prove the long.",
            )
    recording = replace(recording, blocks=Stream.of(kept))
    trajectory = plan.motion.trajectory
    steady_trajectory = replace(trajectory, blocks=Stream.of(trajectory.blocks))
    steady = replace(
        plan,
        machine=machine,
        job=_kept_job(plan.job),
        intent=replace(plan.motion, trajectory=steady_trajectory),
    )
    setting = setting_of(steady, recording, spec.lag_s)
    blocks = tuple(
        replace(block, path=copy.copy(block.path))
        for block in judged_blocks(
            recording, setting.axes, setting.lag_samples, PathWindow(plan.motion.programmed)
        )
    )
    criteria = tuple(c for c in spec.criteria if _is_quick(c, setting))
    stitched = has_stitches(steady.job)
    length = [c for c in criteria if c.name == _LENGTH]
    if not stitched:
        criteria = tuple(c for c in criteria if c.name != _LENGTH)
    elif length and not len(delays_s):
        delays_s = np.array([length[0].options.get("delay", 0.0)])
    kinds = {kind for c in criteria for needs in MEASURES[c.name].needs for kind in needs}
    return QuickJudge(
        plan=steady,
        criteria=criteria,
        lag_s=spec.lag_s,
        delays_s=delays_s,
        blocks=blocks,
        stitches=tuple(planned_stitches(steady)) if stitched else (),
        columns=tuple(
            pair
            for kind, pairs in _CHANNELS.items()
            for pair in pairs
            if kind in kinds or kind is ChannelKind.LOAD
        ),
        setting=setting,
        _others=tuple(c for c in criteria if c.name != _LENGTH),
    )


def _is_quick(criterion: Criterion, setting: Setting) -> bool:
    # What the drawing adds to the contour is the same for every machine: the proof asks for it.
    if criterion.name == _SEAM:
        return False
    of_one_run = isinstance(MEASURES[criterion.name].of_run(setting), OfRun)
    return criterion.limit is not None and of_one_run


def _kept_job(job: Job) -> Job:
    return replace(job, operations=Stream.of(job))
