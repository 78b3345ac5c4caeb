"""The worst stitch by one of its figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from threadline.arrays import FloatArray
from threadline.verdict.finding import Finding, Found, Worst
from threadline.verdict.measure import Measure, Option
from threadline.verdict.needle import Stitches, has_stitches
from threadline.verdict.samples import Block, Setting
from threadline.verdict.sewn import Figure, SewnStitches, StitchFollower

OPTIONS = {"delay": Option(unit="s", default=0.0)}
SPEED_OPTIONS = {**OPTIONS, "over": Option(unit="s", default=0.002)}
_NONE = "the job has no stitches"
_WORDS = {False: ("too long", "too short"), True: ("too fast", "too slow")}
SHORT = "the recording ends before this stitch"


class _Stitching:
    """The worst stitch by one of its figures."""

    def __init__(
        self, setting: Setting, delay_s: float, figure: Figure, over_s: float = 0.002
    ) -> None:
        self._figure: Figure = figure
        columns = [setting.axes.index(a) for a in setting.plan.job.axes]
        self._radius_m = setting.radius_m[columns]
        self._follower = (
            StitchFollower(setting, delay_s, over_s, (figure,))
            if has_stitches(setting.plan.job)
            else None
        )
        self._runs = setting.runs
        self._worst = Worst(setting.runs, len(columns), note=_NONE)

    def feed(self, block: Block) -> None:
        assert block.actual is not None
        if self._follower is None:
            return
        for sewn in self._follower.feed(block):
            self._take(sewn)

    def finish(self) -> Sequence[Found]:
        left = None if self._follower is None else self._follower.unsewn
        return [self._worst.found() if left is None else too_short(left, self._runs)]

    def _take(self, sewn: SewnStitches) -> None:
        run = sewn.stitches
        at_s = sewn.down_s
        if self._figure == "placement":
            values, error = sewn.placement_m, sewn.placement_m
        else:
            if self._figure == "length":
                error = sewn.length_error
            elif self._figure == "speed":
                error, at_s = sewn.speed_error, sewn.speed_s
            else:
                turn = turn_error(run)
                error = np.broadcast_to(turn[:, None], (len(turn), self._runs))
            free = run.exempt & ~run.follows if self._figure == "time" else run.exempt
            values = np.where(free[:, None] | np.isnan(error), -1.0, np.abs(error))
        at, columns = np.argmax(values, axis=0), np.arange(self._runs)
        worst = values[at, columns]
        judged = worst >= 0.0
        if not judged.all():
            self._worst.say("every stitch is exempt")
        more, less = _WORDS[self._figure == "speed"]
        notes = np.where(error[at, columns] > 0.0, more, less)
        self._worst.offer(
            np.where(judged, worst, np.nan),
            time_s=at_s[at] if at_s.ndim == 1 else at_s[at, columns],
            operation=run.operation[at],
            line=run.line[at],
            position=run.point[at] / self._radius_m,
            note="" if self._figure == "placement" else notes.astype(object),
        )


def turn_error(run: Stitches) -> FloatArray:
    """Return (n,) relative errors of the planned times of stitches.

    They are against the programmed time, or against the nearest of the two bounds of a needle that
    follows the head; beside a rest it may turn as slowly as it has to.
    """
    own = (run.down_s - run.from_s) / run.period_s - 1.0
    slowest = np.where(run.departs | run.stops, 0.0, run.slowest_hz)
    with np.errstate(divide="ignore"):
        hz = 1.0 / run.period_s
        fast, slow = run.fastest_hz / hz - 1.0, np.maximum(slowest / hz - 1.0, 0.0)
    return np.asarray(np.where(run.follows, np.where(fast < 0.0, fast, slow), own))


def too_short(left: Stitches, runs: int) -> Found:
    """Return what is found where the recording ends before the first stitch of ``left``."""
    finding = Finding(
        value=None, operation=int(left.operation[0]), job_line=int(left.line[0]), note=SHORT
    )
    return Found.alike(finding, runs)


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
    """Begin measuring the relative error of the time of stitches, those exempt excepted.

    None is exempt where the needle follows the head.
    """
    return _Stitching(setting, options["delay"], "time")
