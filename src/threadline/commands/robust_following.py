"""Averages with which loads follow a motion for all values within a machine's tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import ceil, log2
from typing import overload

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.dynamics.inverse import corner_responses
from threadline.dynamics.robust_averages import (
    MEAN_S,
    Answers,
    ChangeOfSpeed,
    RobustWeights,
    StepOfSpeed,
    WeightGrid,
    frequencies_rad_s,
    robust_weights,
)
from threadline.errors import LimitError, PlanError
from threadline.jobs.operations import FeedMode, Job, Move
from threadline.machine import Machine
from threadline.machine.vary import corners
from threadline.motion.timing import Trajectory, leads_of, with_steps
from threadline.motion.timing.averaged import DEGREE, Averages, denser

TURNS = 4
"""Turns of a needle in which the speed may change: two stitches before and two after a rest."""
_STEPS = 28  # spline steps in the time of a change
_COUNT = 43  # weights: their tails are longer than the change
_SAMPLES = 5  # samples of the motion per spline step; odd, so that the weights have a middle
_FINE = 4  # instants per spline step at which answers are checked
_SEEN_S = 2.0
_SAMPLED = (4096, 8192)  # smallest and largest number of instants: memory grows with them
_LEAST_CHANGE_S = 0.01
_SUPPLY = 0.95  # share of the current limit: the supply of a bad day
_RIPPLE = 0.937  # share of the supply, if possible: references come in steps, current ripples
_PLACE_M = 4.2e-4  # part of the 0.5 mm that the founding cases may be off at a corner
_WEAK, _STRONG = 0.9, 0.43  # shares of the room, worst axis and others: 1 in square
_DEPARTURES = (0.25, 0.35, 0.425, 0.5)  # earlier starts before the step, as shares of two turns
_WITHIN = (1.0, 0.8)  # starts within the run-up, as shares of the run-up
_ENOUGH = 0.04  # share of the speed: a small enough error for a load to stand in the corners
_HOPELESS = 1.25  # times the limit: a larger error is beyond what sharing a corner mends
_SOONER = 0.96
"""Share of the time within which machines other than the machine of the file must reach the speed,
and of the swing that a seam allows. The planned motion differs from the motion of the linear
programs by some per cent."""
_STANDS_S = 1.5 * MEAN_S  # rest before and after a corner, long enough to be measured as a rest
_CLOSE = 2e-3  # share of the speed: an error this close to the smallest possible one suffices
_ALIKE = 1e-5  # cost: of ways whose costs differ by less, the first is used
_STRAIGHT = 1e-9
_BEND = 0.3  # share of the speed: smaller steps need almost no current


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Steps:
    """The speed steps of a motion.

    Parameters
    ----------
    speeds, bends
        (axes,) highest speed, and largest step between moving pieces.
    bent
        Whether some pieces are curved.
    """

    speeds: FloatArray
    bends: FloatArray
    bent: bool


def robust_averages(
    planned: Trajectory,
    machine: Machine,
    job: Job,
    radius_m: FloatArray,
    share: float,
    smoothing_s: float | None,
) -> tuple[Averages, tuple[str, ...]]:
    """Return averages over time with the least speed error on nine machines, and warnings.

    The averages are for the motion with its run-ups as steps (``with_steps``). If the needle is too
    fast for all machines to keep the speed, the averages keep the mean speed over a turn of the
    needle. Stitches then keep their length, and a warning says so.

    Parameters
    ----------
    planned
        Motion before smoothing, with its run-ups.
    job
        Job; its needle sets the time for a change of speed, unless ``smoothing_s`` does.
    radius_m
        (axes,) radii at which the axes act on the job.
    share
        Share of the tolerances of loads and springs at which the machines lie. 0: only the machine
        of the file.

    Raises
    ------
    OptionError
        If no load or spring has a tolerance.
    PlanError
        If a needle follows the head, the job has no needle and no smoothing is given, the time is
        too short, or the current does not suffice.
    """
    if job.needle_follows:
        raise PlanError(
            f"{job.name}: its needle follows the head, which a robust plan lets swing in corners",
            remedy='Leave --robust out, or give needle = "constant".',
        )
    change_s = _change_s(job) if smoothing_s is None else smoothing_s
    if change_s < _LEAST_CHANGE_S:
        raise PlanError(
            f"a robust plan may change the speed within {change_s * 1e3:.4g} ms, at least "
            f"{_LEAST_CHANGE_S * 1e3:g} ms are needed",
            remedy="Lower the speed of the needle, or give a longer --smoothing.",
        )
    step_s = change_s / _STEPS
    grid_s = step_s / _FINE
    samples = min(max(2 ** ceil(log2(_SEEN_S / grid_s)), _SAMPLED[0]), _SAMPLED[1])
    omega = frequencies_rad_s(grid_s, samples)
    steps = _steps(with_steps(planned))
    machines = corners(machine, share) if share else [machine]
    axes = []
    for axis, speed, radius in zip(planned.axes, steps.speeds, radius_m, strict=True):
        limit = machine.drive_of(axis).amplifier.current_limit
        axes.append(
            StepOfSpeed(
                speed=float(speed),
                room=_PLACE_M * (1.0 if len(planned.axes) == 1 else np.sqrt(0.5)) / float(radius),
                current_limit_a=np.inf if limit is None else _SUPPLY * limit.si,
                machines=corner_responses(machine, axis, machines, omega),
            )
        )
    program = _Program(planned.axes, axes, change_s=change_s, grid_s=grid_s, samples=samples)
    leads, shares, swing = leads_of(planned), _shares(job), _swing(job)
    of = _SOONER if len(machines) > 1 else 1.0
    turn_s = change_s / TURNS if smoothing_s is None else None
    own: dict[bool, list[RobustWeights]] = {}
    warnings: list[str] = []
    for stop, leads_s in ((False, leads.starts_s), (True, leads.stops_s)):
        groups = [
            [
                [
                    _change(
                        change_s,
                        early_s,
                        stop=stop,
                        leads_s=leads_s,
                        share=shares,
                        of=of,
                        swing=_SOONER * swing,
                    )
                ]
                for early_s in alike
            ]
            for alike in _departures_s(change_s, leads_s[0])
        ]
        try:
            own[stop], notes = program.speed_or_length(groups, turn_s)
        except PlanError as error:
            raise _without_limit(program, groups, turn_s, swing) or error from None
        warnings += notes
    even = own[False]
    if steps.bent or steps.bends.any():
        # A step between moving pieces may be the start of one axis and the stop of another.
        if (steps.bends < _BEND * steps.speeds).all():
            program.axes = [replace(axis, current_limit_a=np.inf) for axis in axes]
        even = program.least(
            [[[_change(change_s, 0.25 * change_s, stop=stop) for stop in (False, True)]]]
        )
    averages = Averages(
        weights=_acting(even),
        step_s=step_s / _SAMPLES,
        starts=_acting(own[False]),
        stops=_acting(own[True]),
    )
    return averages, tuple(warnings)


def _without_limit(
    program: _Program, groups: _ChangeGroups, turn_s: float | None, swing: float
) -> PlanError | None:
    """Return an error with the cost of a limit on the swing; None if it costs nothing."""
    if not np.isfinite(swing):
        return None
    free = [
        [[replace(one, swing=np.inf) for one in changes] for changes in alike] for alike in groups
    ]
    try:
        found, _ = program.speed_or_length(free, turn_s)
    except PlanError:
        return None
    own = program.swing(found, stop=groups[0][0][0].stop)
    name, most = max(own.items(), key=lambda item: item[1])
    return LimitError(
        f"axes.{name}: the head cannot change its speed in time while it swings by at most "
        f"{swing:.2%} of it; without that limit it swings by {most:.0%}",
        axis=name,
        quantity="swing",
        value_si=most,
        limit_si=swing,
        remedy="Raise swing of the seam, or lower needle_speed. A swing before the head departs "
        "counts in stitches_to_speed.",
    )


_ChangeGroups = Sequence[Sequence[Sequence[ChangeOfSpeed]]]
"""Groups of changes of speed: the best of a group is used; a later group if none suffices."""


class _Program:
    """The linear programs for all axes."""

    def __init__(
        self,
        names: Sequence[str],
        axes: Sequence[StepOfSpeed],
        *,
        change_s: float,
        grid_s: float,
        samples: int,
    ) -> None:
        self.axes = axes
        self._names = names
        self._change_s, self._grid_s, self._samples = change_s, grid_s, samples
        self._near: RobustWeights | None = None
        self._answers: Answers = {}

    def speed_or_length(
        self, groups: _ChangeGroups, turn_s: float | None
    ) -> tuple[list[RobustWeights], list[str]]:
        """Return weights that keep the speed, or else its mean over a turn; and warnings.

        Parameters
        ----------
        turn_s
            Turn of the needle, s; None if only the speed may be kept.

        Raises
        ------
        PlanError
            As ``least``.
        """
        if turn_s is None:
            return self.least(groups), []
        found = self.least(groups, enough=_ENOUGH)
        if found is not None:
            return found, []
        first = groups[0][0][0]
        found = self.least([[[replace(first, mean_s=turn_s)]]])
        error = max(weights.error for weights in found)
        ends = "before stops" if first.stop else "after starts"
        return found, [
            f"--robust: {ends} no average keeps the speed of the head within {_ENOUGH:.0%} on all "
            "machines, so the length of stitches is kept in its place, to "
            f"{error:.1%} as planned; a slower needle keeps both"
        ]

    def swing(self, found: Sequence[RobustWeights], *, stop: bool) -> dict[str, float]:
        """Return the largest speed of each nominal load before all departures, by axis."""
        count = self._samples
        before = (np.arange(count) - count // 2) * self._grid_s < -0.5 * _DEPARTURES[
            -1
        ] * self._change_s
        most = {}
        for name, axis, weights in zip(self._names, self.axes, found, strict=True):
            speed = self._answers[axis.machines[0]][0] @ weights.weights
            # A stop is a start in reversed time.
            speed = 1.0 - speed[::-1] if stop else speed
            most[name] = float(np.abs(speed[before]).max())
        return most

    @overload
    def least(self, groups: _ChangeGroups) -> list[RobustWeights]: ...

    @overload
    def least(self, groups: _ChangeGroups, enough: float) -> list[RobustWeights] | None: ...

    def least(self, groups: _ChangeGroups, enough: float = np.inf) -> list[RobustWeights] | None:
        """Return the best weights of every axis; None if an error exceeds ``enough``.

        Raises
        ------
        LimitError
            If an axis has no weights and ``enough`` is not given.
        """
        found = []
        for name, axis in zip(self._names, self.axes, strict=True):
            best = self._best(axis, groups)
            if best is None:
                if np.isfinite(enough):
                    return None
                raise LimitError(
                    f"axes.{name}: no average over time changes the speed by {axis.speed:.4g} "
                    f"within {self._change_s * 1e3:.4g} ms and {axis.current_limit_a:.4g} A on all "
                    "machines within the tolerances",
                    axis=name,
                    quantity="current_peak",
                    value_si=np.inf,
                    limit_si=axis.current_limit_a,
                    remedy="Give a longer --smoothing, or lower the speed.",
                )
            found.append(best)
            if best.error > _HOPELESS * enough:
                return None
        shared = self._shared(found, groups)
        return shared if max(weights.error for weights in shared) <= enough else None

    def _shared(self, found: list[RobustWeights], groups: _ChangeGroups) -> list[RobustWeights]:
        """Return weights that give the weakest axis more room in a corner, if they are better."""
        # At a corner both axes have errors; the stronger axis leaves room to the weaker one.
        weakest = int(np.argmax([weights.cost for weights in found]))
        if len(found) == 1 or _good(found[weakest], groups):
            return found
        shared = []
        for column, axis in enumerate(self.axes):
            room = axis.room / np.sqrt(0.5) * (_WEAK if column == weakest else _STRONG)
            other = self._best(replace(axis, room=float(room)), groups)
            if other is None or other.cost >= found[weakest].cost:
                return found
            shared.append(other)
        return shared

    def _best(self, axis: StepOfSpeed, groups: _ChangeGroups) -> RobustWeights | None:
        best, enough = None, False
        for part, alike in product((_RIPPLE, 1.0), groups):
            spared = replace(axis, current_limit_a=part * axis.current_limit_a)
            for changes in alike:
                cheaper = np.inf if best is None else best.cost - _ALIKE
                weights = robust_weights(
                    spared,
                    changes,
                    WeightGrid(
                        count=_COUNT,
                        step_s=self._change_s / _STEPS,
                        degree=DEGREE,
                        grid_s=self._grid_s,
                        samples=self._samples,
                    ),
                    near=self._near,
                    # Once one suffices, only a cheaper one can replace it.
                    dearest=cheaper if enough else np.inf,
                    kept=self._answers,
                )
                if weights is None:
                    continue
                self._near = weights
                best = weights if weights.cost < cheaper else best
                enough = enough or weights.error <= _ENOUGH
            if enough:
                return best
        return best


def _departures_s(change_s: float, lead_s: float) -> Sequence[Sequence[float]]:
    """Return how long before its step a start may depart: within its run-up, and earlier.

    If no start departs before its run-up, the motion really stands in the corner.
    """
    earlier = [part for k in _DEPARTURES if (part := 0.5 * k * change_s) > lead_s]
    within = [part for k in _WITHIN if (part := k * (lead_s - _STANDS_S)) > 0.0]
    return [within, earlier] if within else [earlier]


def _good(weights: RobustWeights, groups: _ChangeGroups) -> bool:
    """Say whether the error is close to the difference of planned and wanted speed."""
    planned = max(abs(1.0 - end) for change in groups[0][0] for end in change.share)
    return weights.error < planned + _CLOSE


def _change(
    change_s: float,
    early_s: float,
    *,
    stop: bool,
    leads_s: tuple[float, float] = (0.0, 0.0),
    share: tuple[float, float] = (1.0, 1.0),
    of: float = 1.0,
    swing: float = np.inf,
) -> ChangeOfSpeed:
    """Return the conditions on a load that may depart ``early_s`` before the step.

    The load has the speed after a share ``of`` half the time for a change, and an even speed after
    the whole time.
    """
    half_s = 0.5 * change_s
    return ChangeOfSpeed(
        stop=stop,
        early_s=early_s,
        still_s=max(early_s, leads_s[1]) + _STANDS_S,
        within_s=of * half_s,
        even_s=half_s - leads_s[1],
        aside_s=leads_s[0],
        share=share,
        swing=swing,
    )


def _acting(found: Sequence[RobustWeights]) -> FloatArray:
    """Return the weights of fine samples, reversed: early weights of a window act late."""
    return denser(np.stack([weights.weights[::-1] for weights in found], axis=1), _SAMPLES)


def _shares(job: Job) -> tuple[float, float]:
    """Return the smallest and largest ratio of actual to wanted length of non-exempt stitches."""
    least, most = np.inf, -np.inf
    for move in job:
        if isinstance(move, Move) and "target_m" in move.tags and not move.tags["exempt"]:
            share = float(move.tags["length_m"]) / float(move.tags["target_m"])
            least, most = min(least, share), max(most, share)
    return (least, most) if least <= most else (1.0, 1.0)


def _swing(job: Job) -> float:
    """Return the smallest swing that a seam of the job allows, as a share of the speed."""
    swings = (move.tags.get("swing", np.inf) for move in job if isinstance(move, Move))
    return float(min(swings, default=np.inf))


def _steps(stepped: Trajectory) -> _Steps:
    """Return the speed steps of a motion whose pieces meet with steps of speed, in one pass."""
    width = len(stepped.axes)
    speeds, bends, bent = np.zeros(width), np.zeros(width), False
    before = np.zeros(width)
    for block in stepped:
        lasts_s = block.duration_s[:, None]
        speed = block.coefficients[:, 1:].sum(axis=1) / lasts_s
        curved = (block.coefficients[:, 2:] != 0.0).any(axis=(1, 2))
        bent = bent or bool(curved.any())
        speeds = np.maximum(speeds, np.abs(speed).max(axis=0))
        joined = np.concatenate([before[None], np.where(curved[:, None], 0.0, speed)])
        moves = (joined != 0.0).any(axis=1)
        steps = np.abs(np.diff(joined, axis=0))[moves[1:] & moves[:-1]]
        bends = np.maximum(bends, steps.max(axis=0, initial=0.0))
        before = joined[-1]
    return _Steps(speeds=speeds, bends=np.where(bends > _STRAIGHT * speeds, bends, 0.0), bent=bent)


def _change_s(job: Job) -> float:
    turns = (
        1.0 / move.feed.value
        for move in job
        if isinstance(move, Move)
        and "stitch" in move.tags
        and move.feed is not None
        and move.feed.mode is FeedMode.INVERSE_TIME
    )
    turn_s = min(turns, default=None)
    if turn_s is None:
        raise PlanError(
            f"{job.name} has no needle that says in which time a robust plan may change its speed",
            remedy='Give it: --smoothing "90 ms". Loads ring less the longer it is.',
        )
    return TURNS * turn_s
