"""Used share of each limit of a motion, and the least number of ticks of a job."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from threadline.base.arrays import FloatArray, Locked, read_only
from threadline.errors import BudgetError, Place
from threadline.jobs.feed_times import nominal_time_s, wanted_feed
from threadline.jobs.operations import Dwell, Feed, FeedMode, Job, Move, MoveRun, gathered
from threadline.machine import Machine
from threadline.motion.timing.extremes import hull_of
from threadline.motion.timing.optimal.along_path import across, true_shares
from threadline.motion.timing.optimal.elements import restricted
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.optimal.rows import used_shares
from threadline.motion.timing.types import Trajectory, TrajectoryBlock

_PARTS = 4  # parts of a polynomial in time: shorter parts have tighter bounds


@dataclass(frozen=True, kw_only=True, eq=False)
class Retimed(Locked, Trajectory):
    """A motion, and the share of each limit that it uses.

    Parameters
    ----------
    shares
        Largest used share of each limit, by name: (axes,) for limits of axes, (1,) for limits of
        the path. Shares of the axes and of ``centripetal`` hold at every instant, because
        Bernstein coefficients bound polynomials. The three shares along the path are the largest
        at thirteen instants of each polynomial in time.
    start
        (axes,) first point; the only position of a motion of length 0.
    """

    shares: Mapping[str, FloatArray] = field(default_factory=dict)
    start: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", read_only(self.start, "start", ndim=1))

    def __call__(self, time_s: FloatArray | float, derivative: int = 0) -> FloatArray:
        """Return the (m, axes) ``derivative``-th derivative, as ``Trajectory`` does."""
        found = super().__call__(time_s, derivative)
        if derivative == 0 and self.duration_s == 0.0:
            found[:] = self.start
        return found

    @property
    def bound(self) -> float:
        """Largest of all shares; at most 1, up to rounding."""
        return max((float(share.max()) for share in self.shares.values()), default=0.0)


def limits_used(trajectory: Trajectory, limits: Limits) -> dict[str, FloatArray]:
    """Return bounds of the used share of each limit; see ``Retimed.shares``."""
    out: dict[str, FloatArray] = {}
    for block in trajectory:
        for name, share in _of_block(block, limits).items():
            out[name] = np.maximum(share, out.get(name, 0.0))
    return out


def _of_block(block: TrajectoryBlock, limits: Limits) -> dict[str, FloatArray]:
    c, duration_s = _parted(block)
    rates = [c]
    for _ in range(3):
        last = rates[-1]
        rates.append(last[:, 1:] * np.arange(1.0, last.shape[1])[:, None])
    v, a, j = (_hull(rates[k]) / duration_s[:, None, None] ** k for k in (1, 2, 3))
    own = limits.along
    out = {
        "velocity": np.abs(v).max(axis=(0, 1)) / limits.velocity,
        "acceleration": used_shares(v, a, limits.sides).max(axis=0),
        "jerk": np.abs(j).max(axis=(0, 1)) / limits.jerk,
    }
    if own is not None:
        names = ("path_velocity", "path_acceleration", "path_jerk")
        for name, share in zip(names, true_shares(c, duration_s, own), strict=True):
            out[name] = np.array([share])
        most = float((across(c * own.radius_m) / duration_s**2).max())
        out["centripetal"] = np.array([most / own.centripetal])
    return out


def _parted(block: TrajectoryBlock) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of the parts of a block's polynomials, and the parts' durations."""
    order = max(block.coefficients.shape[1], 4)
    pad = ((0, 0), (0, order - block.coefficients.shape[1]), (0, 0))
    c = np.repeat(np.pad(block.coefficients, pad), _PARTS, axis=0)
    begin = np.tile(np.arange(_PARTS) / _PARTS, len(block))
    return (
        restricted(c, begin, np.full(len(c), 1.0 / _PARTS)),
        np.repeat(block.duration_s, _PARTS) / _PARTS,
    )


def _hull(poly: FloatArray) -> FloatArray:
    """Return the (n, order, axes) Bernstein coefficients of polynomials."""
    n, order, axes = poly.shape
    flat = np.moveaxis(poly, 1, 0).reshape(order, n * axes)
    return np.moveaxis(hull_of(flat).reshape(order, n, axes), 0, 1)


_MOST_WORK = 1_000_000
_WORK_PER_ITEM = 64  # cost of a single item, in moves of a run


def check_budget(job: Job, machine: Machine, feed: Feed | None = None) -> None:
    """Refuse a job that takes more ticks than the machine file allows, before it is planned.

    The times of the moves at their feeds are summed. Repeated passes are multiplied, so that
    ``M98 P1 L1000000000`` costs three passes of computation. Rapid moves count at the velocity
    limits. Only the beginning of a long job is summed, for about a second of computation: the
    trajectory counts the rest.

    Parameters
    ----------
    job, machine
        The job, and the machine that does it.
    feed
        Replaces the programmed feeds.

    Raises
    ------
    BudgetError
        If the budget is exceeded; names the line of the call or move that takes most ticks.
    JobError
        If a block lacks a value that it needs.
    PlanError
        If a feed is missing or not above 0.
    """
    budget = machine.tick_budget.si
    period_s = float(machine.tick_clock.period_s)
    position = np.array(job.start)
    ticks_by_line: defaultdict[int, float] = defaultdict(float)
    total = work = 0.0
    for operation, times, call in job.folded():
        item = gathered([operation]) if isinstance(operation, Move) else operation
        if isinstance(item, MoveRun):
            moves_s = _times_s(item, position, feed, job, machine)
            position = item.targets[-1]
            line = int(item.line[int(np.argmax(moves_s))])
            ticks = times * float(moves_s.sum()) / period_s
        elif isinstance(item, Dwell):
            line, ticks = item.source.line, times * item.duration_s / period_s
        else:
            continue
        ticks_by_line[call or line] += ticks
        total += ticks
        work += _WORK_PER_ITEM + (len(item) if isinstance(item, MoveRun) else 0)
        if total > budget:
            worst = max(ticks_by_line, key=ticks_by_line.__getitem__)
            raise BudgetError(
                f"the job takes more than {total:.3g} ticks of {period_s * 1e3:g} ms at its "
                f"feeds; the tick budget of {machine.name!r} is {budget:.3g}",
                place=Place(job.file, worst),
                remedy="Lower L or the dwell, raise the feed, or raise tick_budget in the "
                "machine file.",
            )
        if work > _MOST_WORK:
            return


def _times_s(
    run: MoveRun, position: FloatArray, feed: Feed | None, job: Job, machine: Machine
) -> FloatArray:
    """Return the (moves,) least times of the moves of a run that begins at ``position``."""
    way = np.diff(run.targets, axis=0, prepend=position[None])
    column = [machine.axis_names.index(axis) for axis in job.axes]
    least_s: FloatArray = (np.abs(way) / machine.velocity_limit[column]).max(axis=1)
    ends = [begin for begin, _ in run.feeds[1:]] + [len(way)]
    for (begin, programmed), end in zip(run.feeds, ends, strict=True):
        if programmed is None or programmed.mode is not FeedMode.RAPID:
            wanted = wanted_feed(
                programmed, feed, Place(run.file, int(run.line[begin])), job, machine
            )
            least_s[begin:end], _ = nominal_time_s(way[begin:end], wanted, feed, job, machine)
    return least_s
