"""What became of every stitch: its length, place and time, and the head's speed; the worst."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.plan import Plan
from threadline.signals import ChannelKind, Recording
from threadline.verdict.blocks import find_first, judged_blocks, setting_of
from threadline.verdict.measure import Finding, Measure, Option
from threadline.verdict.needle import Stitches, has_stitches, planned_stitches
from threadline.verdict.samples import Block, Setting

OPTIONS = {"delay": Option(unit="s", default=0.0)}
SPEED_OPTIONS = {**OPTIONS, "over": Option(unit="s", default=0.002)}
_ACTUAL = (ChannelKind.TOOL, ChannelKind.LOAD)
_NONE = "the job has no stitches"
_WORDS = {False: ("too long", "too short"), True: ("too fast", "too slow")}
SHORT = "the recording ends before this stitch"
_BEHIND, _AHEAD = 12, 3  # stitches about its own that a needle-down is compared with


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SewnStitches:
    """Stitches and where the tool was.

    Parameters
    ----------
    stitches
        n of them.
    down_s
        (n,) when the needle went down, its delay included.
    actual, begun
        (n, axes) where the tool was then, and at the needle-down before; lengths at the tool.
    length_error
        (n,) distance moved since the needle-down before, over the wanted one, less 1.
    placement_m
        (n,) distance of ``actual`` from the seam: the nearest point of the stitches about it.
    speed_error
        (n,) of the head's speeds while the stitch was made, each the mean over ``over_s``, the one
        that is furthest from the stitch's length over its time, relative to that, less 1.
    speed_s
        (n,) the instant at the end of that mean.
    """

    stitches: Stitches
    down_s: FloatArray
    actual: FloatArray
    begun: FloatArray
    length_error: FloatArray
    placement_m: FloatArray
    speed_error: FloatArray
    speed_s: FloatArray


class StitchFollower:
    """Takes the tool's position and gives back the stitches that were sewn meanwhile.

    The position is taken as straight between samples: at an acceleration a it is off by at most
    a T^2 / 8 in a sample interval T.

    Parameters
    ----------
    setting
        Plan and recording.
    delay_s
        How long after the command the needle goes down: the head's lag, to which the needle is
        set. A head that itself follows the motion has none, and the needle goes down when due.
    over_s
        Over which the head's speed is taken.
    """

    def __init__(self, setting: Setting, delay_s: float, over_s: float = 0.002) -> None:
        self._source = planned_stitches(setting.plan)
        self._columns = [setting.axes.index(axis) for axis in setting.plan.job.axes]
        self._radius_m = setting.radius_m
        self._delay_s = delay_s if setting.plan.motion.of_loads is None else 0.0
        self._over_s = over_s
        self._pending: list[Stitches] = []
        self._ended = False
        self._time_s: FloatArray = np.empty(0)
        self._points: FloatArray = np.empty((0, len(self._columns)))
        self._seam: FloatArray | None = None  # needle points before the pending ones

    @property
    def unsewn(self) -> Stitches | None:
        """The run with the first stitch that no sample came to, if there is one."""
        self._pull(1)
        return self._pending[0] if self._pending else None

    def feed(self, time_s: FloatArray, actual: FloatArray) -> list[SewnStitches]:
        """Return the runs of stitches that are complete with these samples."""
        points = (actual * self._radius_m)[:, self._columns]
        self._time_s = np.concatenate([self._time_s, time_s])
        self._points = np.concatenate([self._points, points])
        sewn = []
        while True:
            self._pull(2)  # one run more: the seam ahead of the last stitch
            if not self._pending or self._pending[0].down_s[-1] + self._delay_s > time_s[-1]:
                break
            sewn.append(self._finish(self._pending.pop(0)))
        keep_s = self._pending[0].from_s[0] + self._delay_s if self._pending else time_s[-1]
        keep_s -= self._over_s
        first = max(int(np.searchsorted(self._time_s, keep_s, side="right")) - 2, 0)
        self._time_s, self._points = self._time_s[first:], self._points[first:]
        return sewn

    def _pull(self, runs: int) -> None:
        while len(self._pending) < runs and not self._ended:
            run = next(self._source, None)
            if run is None:
                self._ended = True
            else:
                self._pending.append(run)

    def _at(self, time_s: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(time_s, self._time_s, p) for p in self._points.T])

    def _finish(self, run: Stitches) -> SewnStitches:
        down_s = run.down_s + self._delay_s
        actual = self._at(down_s)
        begun = self._at(run.from_s + self._delay_s)
        moved = np.linalg.norm(actual - begun, axis=1)
        behind = run.from_point[:1] if self._seam is None else self._seam
        ahead = self._pending[0].point[:_AHEAD] if self._pending else run.point[-1:]
        seam = np.concatenate([behind, run.point, ahead])
        placement = _to_seam(actual, seam, len(behind))
        self._seam = seam[: len(behind) + len(run)][-_BEHIND:]
        speed_error, speed_s = self._speeds(run)
        return SewnStitches(
            stitches=run,
            down_s=down_s,
            actual=actual,
            begun=begun,
            length_error=moved / run.target_m - 1.0,
            placement_m=placement,
            speed_error=speed_error,
            speed_s=speed_s,
        )

    def _speeds(self, run: Stitches) -> tuple[FloatArray, FloatArray]:
        """Return (n,) the largest relative error of the speed in each stitch, and when it was.

        Instants are the samples within the stitch, less the first ``over_s`` of it, and its end.
        """
        begin_s, end_s = run.from_s + self._delay_s, run.down_s + self._delay_s
        at_s = np.unique(np.concatenate([self._time_s, end_s]))
        stitch = np.searchsorted(end_s, at_s, side="left")
        stitch = np.minimum(stitch, len(run) - 1)
        within = (at_s >= begin_s[stitch] + self._over_s) & (at_s <= end_s[stitch])
        within |= at_s == end_s[stitch]
        at_s, stitch = at_s[within], stitch[within]
        moved = np.linalg.norm(self._at(at_s) - self._at(at_s - self._over_s), axis=1)
        wanted = run.target_m / (run.down_s - run.from_s)
        error = moved / self._over_s / wanted[stitch] - 1.0
        order = np.lexsort((-np.abs(error), stitch))
        first = order[np.searchsorted(stitch[order], np.arange(len(run)))]
        return error[first], at_s[first]


def sewn_stitches(plan: Plan, recording: Recording, delay_s: float) -> Iterator[SewnStitches]:
    """Yield the stitches of a recording in runs; nothing where the job has none.

    Parameters
    ----------
    plan, recording
        What was intended, and what happened; without a tool or load channel nothing is known.
    delay_s
        As for ``StitchFollower``.
    """
    axes = plan.motion.programmed.axes
    known = all(find_first(recording, _ACTUAL, axis) is not None for axis in axes)
    if not known or not has_stitches(plan.job):
        return
    follower = StitchFollower(setting_of(plan, recording), delay_s)
    for block in judged_blocks(recording, axes, 0, None):
        if block.actual is not None:
            yield from follower.feed(block.time_s, block.actual)


def _to_seam(points: FloatArray, seam: FloatArray, offset: int) -> FloatArray:
    """Return (n,) distances of point i to the chords of ``seam`` about ``seam[offset + i]``."""
    best = np.full(len(points), np.inf)
    own = np.arange(len(points)) + offset
    for shift in range(-_BEHIND, _AHEAD):
        begin = np.clip(own + shift, 0, len(seam) - 1)
        end = np.minimum(begin + 1, len(seam) - 1)
        chord, away = seam[end] - seam[begin], points - seam[begin]
        squared = (chord**2).sum(axis=1)
        along = np.zeros(len(points))
        np.divide((away * chord).sum(axis=1), squared, out=along, where=squared > 0.0)
        foot = np.clip(along, 0.0, 1.0)[:, None] * chord
        best = np.minimum(best, np.linalg.norm(away - foot, axis=1))
    return best


class _Stitching:
    """The worst stitch by one of its figures."""

    def __init__(
        self, setting: Setting, delay_s: float, figure: str, over_s: float = 0.002
    ) -> None:
        self._figure = figure
        self._radius_m = setting.radius_m[[setting.axes.index(a) for a in setting.plan.job.axes]]
        self._follower = (
            StitchFollower(setting, delay_s, over_s) if has_stitches(setting.plan.job) else None
        )
        self._worst = Finding(value=None, note=_NONE)

    def feed(self, block: Block) -> None:
        assert block.actual is not None
        if self._follower is None:
            return
        for sewn in self._follower.feed(block.time_s, block.actual):
            self._take(sewn)

    def finish(self) -> Sequence[Finding]:
        left = None if self._follower is None else self._follower.unsewn
        if left is not None:
            return [
                Finding(
                    value=None,
                    operation=int(left.operation[0]),
                    job_line=int(left.line[0]),
                    note=SHORT,
                )
            ]
        return [self._worst]

    def _take(self, sewn: SewnStitches) -> None:
        run = sewn.stitches
        at_s = sewn.down_s
        if self._figure == "placement":
            values = sewn.placement_m
        else:
            if self._figure == "length":
                error = sewn.length_error
            elif self._figure == "speed":
                error, at_s = sewn.speed_error, sewn.speed_s
            else:
                error = (run.down_s - run.from_s) / run.period_s - 1.0
            values = np.where(run.exempt | np.isnan(error), -1.0, np.abs(error))
        at = int(np.argmax(values))
        if values[at] < 0.0:
            if self._worst.value is None:
                self._worst = Finding(value=None, note="every stitch is exempt")
            return
        if self._worst.value is not None and values[at] <= self._worst.value:
            return
        note = ""
        if self._figure != "placement":
            more, less = (
                ("too fast", "too slow") if self._figure == "speed" else ("too long", "too short")
            )
            note = more if error[at] > 0.0 else less
        self._worst = Finding(
            value=float(values[at]),
            time_s=float(at_s[at]),
            operation=int(run.operation[at]),
            job_line=int(run.line[at]),
            position=tuple((run.point[at] / self._radius_m).tolist()),
            note=note,
        )


def start_length(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the relative error of the length of stitches, those exempt excepted."""
    return _Stitching(setting, options["delay"], "length")


def start_placement(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring how far from the seam the needle goes down."""
    return _Stitching(setting, options["delay"], "placement")


def start_speed(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the relative error of the head's speed, in stitches that are not exempt."""
    return _Stitching(setting, options["delay"], "speed", options["over"])


def start_needle(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the relative error of the time of stitches, those exempt excepted."""
    return _Stitching(setting, options["delay"], "time")
