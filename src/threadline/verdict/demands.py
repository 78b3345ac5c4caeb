"""Criteria that every verdict lists, whatever the specification, and the machine's own limits.

They depend on the kind of axis: a servo axis, an axis driven by pulses or known only by its limits,
a cylinder, or an axis that plays step tables.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.quantity import Quantity
from threadline.motion.timing.extremes import derivatives, farthest, highest, hull_of, in_direction
from threadline.motion.timing.types import TrajectoryBlock
from threadline.verdict.finding import Finding, RunFindings, Worst, largest
from threadline.verdict.measure import Measure
from threadline.verdict.needle import Stitches, has_stitches, planned_stitches
from threadline.verdict.samples import Block, Setting
from threadline.verdict.types import Criterion, Spec

PLAN_DEMANDS = ("travel", "velocity", "acceleration", "jerk")
BRAKING, PATH_USE = "deceleration", "path_use"
"""Measures of plans on machines with braking limits, and with limits along the tool's path."""
_SWITCHING_LIMITS = ("switching_order", "switching_dwell", "valve_conflict", "over_level")


@dataclass(frozen=True, slots=True, kw_only=True)
class Always:
    """The criteria of all machines with one kind of axis.

    Parameters
    ----------
    listed
        Measures that every verdict lists.
    limited
        Measures among them whose limit is the machine's own.
    limit
        Returns the machine's limit, SI, of a measure for an axis; None if it has none.
    keys
        Further keys that a criterion of such a machine may have in a specification.
    """

    listed: tuple[str, ...]
    limited: tuple[str, ...]
    limit: Callable[[Machine, str, str], float | None]
    keys: tuple[str, ...] = ()


def _of_axis(machine: Machine, measure: str, axis: str) -> float | None:
    if measure == PATH_USE:
        return 1.0
    limits = machine.axes[axis]
    if measure == "travel":
        return None if limits.endless else 0.0
    own = {
        "velocity": limits.velocity,
        "acceleration": limits.acceleration,
        BRAKING: limits.deceleration or limits.acceleration,
        "jerk": limits.jerk,
    }[measure]
    return None if own is None else own.si


def _of_cylinder(machine: Machine, measure: str, axis: str) -> float | None:  # noqa: ARG001
    over = machine.plc is None or machine.plc.never_over
    return 0.0 if over or measure != "over_level" else None


_AXIS = Always(
    listed=(*PLAN_DEMANDS, "path_deviation", "tracking_error", "dac_saturation"),
    limited=PLAN_DEMANDS,
    limit=_of_axis,
)


def _of_pulsed(machine: Machine, measure: str, axis: str) -> float | None:
    return 1.0 if measure == "step_loss" else _of_axis(machine, measure, axis)


_PULSED = Always(
    listed=(*PLAN_DEMANDS, "path_deviation", "tracking_error", "step_loss"),
    limited=(*PLAN_DEMANDS, "step_loss"),
    limit=_of_pulsed,
)
_KINEMATIC = Always(listed=(*PLAN_DEMANDS, "path_deviation"), limited=PLAN_DEMANDS, limit=_of_axis)
_STITCH_LIMITS = ("servo_force", "window_use", "step_rate", "fetch_use", "travel")


def _of_stitched(machine: Machine, measure: str, axis: str) -> float | None:
    if measure == "step_rate":
        assert machine.tables is not None
        return machine.tables.step_rate.si
    return _of_axis(machine, measure, axis) if measure == "travel" else 1.0


_ALWAYS_STEPPED = Always(
    listed=("stitch_residual", *_STITCH_LIMITS), limited=_STITCH_LIMITS, limit=_of_stitched
)
_CYLINDER = Always(
    listed=(
        "residual_vibration",
        "settling_time",
        "end_position_error",
        "cycle_time",
        "travel",
        *_SWITCHING_LIMITS,
        "switching_error",
    ),
    limited=("travel", *_SWITCHING_LIMITS),
    limit=_of_cylinder,
    keys=("step",),
)
_BY_WHAT_MOVES: Mapping[str, Always] = {
    "linear": _AXIS,
    "rotary": _AXIS,
    "stepper": _PULSED,
    "pulse-servo": _PULSED,
    "kinematic": _KINEMATIC,
    "stepped": _ALWAYS_STEPPED,
    "cylinder": _CYLINDER,
}


def always_of(machine: Machine) -> Always:
    """Return the criteria that every verdict on a machine lists, whatever its specification."""
    always = _BY_WHAT_MOVES[next(iter(machine.moving.values()))]
    braking = any(axis.deceleration is not None for axis in machine.axes.values())
    own = (*(BRAKING,) * braking, *(PATH_USE,) * (machine.path is not None))
    return replace(always, listed=(*always.listed, *own), limited=(*always.limited, *own))


def measure_path_use(plan: Plan) -> dict[str, list[Finding]]:
    """Return the largest used share of the limits along the path, sampled densely.

    The finding names the limit. A speed step between two pieces of a historical plan does not
    count.
    """
    from threadline.motion.timing.optimal.along_path import path_use
    from threadline.motion.timing.optimal.motion_limits import along_of

    along = along_of(plan.machine, plan.motion.path.radius_m)
    if along is None:
        none = Finding(value=None, note="the machine file has no [path] with a limit")
        return {PATH_USE: [none]}
    used = path_use(plan.motion.trajectory, along)
    if used is None:
        return {PATH_USE: [Finding(value=0.0)]}
    worst = Finding(
        value=used.share,
        time_s=used.time_s,
        operation=used.operation,
        note=f"of path.{used.quantity}",
    )
    return {PATH_USE: [worst]}


NEEDLE_USE = "needle_use"


def with_needle(spec: Spec, job: Job) -> Spec:
    """Return the specification with the needle limit of a seam that sets one.

    The limit comes from the seam file, as axis limits come from the machine: a specification can
    lower it, but not raise it.
    """
    if not np.isfinite(job.along_m_s2):
        return spec
    own = [c.limit for c in spec.criteria if c.name == NEEDLE_USE and c.limit is not None]
    limit = min(1.0, *own) if own else 1.0
    others = tuple(c for c in spec.criteria if c.name != NEEDLE_USE)
    return replace(
        spec, criteria=(*others, Criterion(name=NEEDLE_USE, limit=limit, required=True, hard=True))
    )


def measure_needle_use(plan: Plan) -> dict[str, list[Finding]]:
    """Return the largest change of the needle's speed between turns, as a share of its limit.

    The speed of a turn is one over its time. It changes from the middle of a turn to the middle of
    the next. Beside a rest of the head it changes to or from zero at that end of the turn.
    """
    if not has_stitches(plan.job):
        return {NEEDLE_USE: [Finding(value=None, note="the job has no stitches")]}
    worst = Finding(value=None, note="no seam sets the acceleration of a needle that follows")
    before = (0.0, 0.0)  # speed of the last turn, and half its duration
    for run in planned_stitches(plan):
        share, before = _shares(run, before)
        known = np.flatnonzero(np.isfinite(share))
        if not len(known):
            continue
        k = int(known[np.argmax(share[known])])
        if worst.value is None or share[k] > worst.value:
            worst = Finding(
                value=float(share[k]),
                time_s=float(run.down_s[k]),
                operation=int(run.operation[k]),
                job_line=int(run.line[k]),
            )
    return {NEEDLE_USE: [worst]}


def _shares(run: Stitches, before: tuple[float, float]) -> tuple[FloatArray, tuple[float, float]]:
    """Return (n,) used shares of the limit, NaN without one, and ``before`` of the next turn."""
    hz, half_s = 1.0 / run.period_s, 0.5 * run.period_s
    came_hz = np.append(before[0], hz[:-1])
    came_s = np.append(before[1], half_s[:-1])
    came_hz[run.departs], came_s[run.departs] = 0.0, 0.0
    change = np.abs(hz - came_hz) / (half_s + came_s)
    change = np.maximum(change, np.where(run.stops, hz / half_s, 0.0))
    return change / run.most_hz_s, (float(hz[-1]), float(half_s[-1]))


class _StepLoss:
    """Per axis: the largest used share of its drive's torque; above 1 it loses steps."""

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

    def finish(self) -> Sequence[RunFindings]:
        found = (worst.found() for worst in self._worst)
        return [one for one in found if not np.isnan(one.value).all()]


def start_step_loss(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin measuring the used share of the drives' torque."""
    return _StepLoss(setting)


def measure_braking(plan: Plan) -> dict[str, list[Finding]]:
    """Return the exact largest deceleration of each axis.

    A step of the velocity is not braking: it is counted as an acceleration.
    """
    axes = plan.motion.trajectory.axes
    worst = [Finding(value=0.0, axis=axis) for axis in axes]
    for block in plan.motion.trajectory:
        for column, axis in enumerate(axes) if len(block) else ():
            polys = derivatives(block, column, 2)
            toward, piece, begin, width = in_direction(polys[1], polys[2])
            known = worst[column].value
            found = highest(-toward, 0.0 if known is None else known)
            if found is None:
                continue
            value, part, place = found
            k, where = int(piece[part]), float(begin[part] + place * width[part])
            position = block.coefficients[k].T @ where ** np.arange(block.coefficients.shape[1])
            worst[column] = Finding(
                value=value,
                axis=axis,
                time_s=float(block.start_s[k] + where * block.duration_s[k]),
                operation=int(block.operation[k]),
                position=tuple(position.tolist()),
            )
    return {BRAKING: worst}


SLACK = 1.001  # limits hold between samples too, to a thousandth
_ORDERS = {"velocity": 1, "acceleration": 2, "jerk": 3}
_PUSH = _ORDERS["acceleration"]
_BELOW = (0, 1, 2)
"""Derivative orders below a demand that may step."""
_ROUNDED = 1e-12
"""Relative margin on a bound: its rounding differs from the rounding of the bounded value."""
VELOCITY_STEPS = "the velocity steps"
"""Start of the note of an acceleration that is finite only because it is spread over a tick."""
_DEMANDS_STEPPED = ("the position steps", VELOCITY_STEPS, "the acceleration steps")


def measure_demands(plan: Plan) -> dict[str, list[Finding]]:
    """Return the exact extremes of the trajectory: per name, one finding per axis.

    ``travel`` is the distance beyond the travel of the axis, or the whole range beyond the stroke,
    negative while room is left; endless axes have none. ``velocity``, ``acceleration`` and ``jerk``
    are absolute values, in the axis' units. If a derivative steps between two pieces, the higher
    derivatives are infinite in theory. The controller spreads the step over one tick of its clock,
    so a velocity step counts as an acceleration for one tick, and the steps of this acceleration as
    a jerk. For an axis with a braking limit, ``acceleration`` counts speeding up only.
    """
    axes = plan.motion.trajectory.axes
    tick_s = float(plan.machine.tick_clock.period_s)
    demands = {
        name: [_Demand(axis, order, tick_s) for axis in axes] for name, order in _ORDERS.items()
    }
    limits = plan.machine.travel
    rows = [plan.machine.axis_names.index(axis) for axis in axes]
    reach = {
        column: _Reach(axis, limits[row], plan.machine.axes[axis].stroke)
        for column, (axis, row) in enumerate(zip(axes, rows, strict=True))
        if np.isfinite(limits[row]).all()
    }
    before: list[dict[int, float]] = [{1: 0.0, 2: 0.0} for _ in axes]  # at rest before the start
    last: TrajectoryBlock | None = None
    for block in plan.motion.trajectory:
        for column in range(len(axes)) if len(block) else ():
            polys = derivatives(block, column, max(_ORDERS.values()))
            steps = {below: _step(polys[below], before[column].get(below)) for below in _BELOW}
            before[column] = {below: steps[below][2] for below in _BELOW}
            for order, row in zip(_ORDERS.values(), demands.values(), strict=True):
                if order == _PUSH and plan.machine.axes[axes[column]].deceleration is not None:
                    row[column].take_towards(block, polys[1], polys[2])
                else:
                    row[column].take(block, polys[order])
                # A position step is an unbounded velocity; higher derivatives add nothing.
                for below in range(min(1, order - 1), order):
                    size, piece, _ = steps[below]
                    row[column].step(below, size, block, piece, 0.0)
            if column in reach:
                reach[column].take(block, polys[0])
        last = block if len(block) else last
    for order, row in zip(_ORDERS.values(), demands.values(), strict=True):
        for column, demand in enumerate(row if last is not None else ()):
            assert last is not None
            for below in range(1, order):
                # The step into the standstill after the end.
                demand.step(below, abs(before[column][below]), last, len(last) - 1, 1.0)
    found = {name: [demand.worst for demand in row] for name, row in demands.items()}
    found["travel"] = [axis_reach.worst for axis_reach in reach.values()]
    return found


def _place(
    block: TrajectoryBlock, piece: int, where: float
) -> tuple[float, int, tuple[float, ...]]:
    position = block.coefficients[piece].T @ where ** np.arange(block.coefficients.shape[1])
    time_s = float(block.start_s[piece] + where * block.duration_s[piece])
    return time_s, int(block.operation[piece]), tuple(position.tolist())


def _step(poly: FloatArray, before: float | None) -> tuple[float, int, float]:
    """Return the largest step between (order, n) pieces, the piece after it, and the last value.

    Parameters
    ----------
    before
        The value at the end of the piece before; None without such a piece.
    """
    starts, ends = poly[0], poly.sum(axis=0)
    steps = np.abs(starts[1:] - ends[:-1])
    piece = int(np.argmax(steps)) + 1 if len(steps) else 0
    size = float(steps[piece - 1]) if piece else 0.0
    first = 0.0 if before is None else abs(float(starts[0]) - before)
    if first >= size:
        size, piece = first, 0
    return size, piece, float(ends[-1])


class _Demand:
    """The largest absolute value of one derivative of one axis."""

    def __init__(self, axis: str, order: int, tick_s: float) -> None:
        self._axis, self._order, self._tick_s = axis, order, tick_s
        self._value = 0.0
        self.worst = Finding(value=0.0, axis=axis)

    def take(self, block: TrajectoryBlock, poly: FloatArray) -> None:
        """Compare the (order, n) pieces of a block."""
        found = farthest(poly, self._value)
        if found is not None:
            self._set(found[0], _place(block, found[1], found[2]), "")

    def take_towards(self, block: TrajectoryBlock, velocity: FloatArray, push: FloatArray) -> None:
        """Compare the (order, n) accelerations ``push`` of a block where they speed the axis up."""
        toward, piece, begin, width = in_direction(velocity, push)
        found = highest(toward, self._value)
        if found is not None:
            value, part, place = found
            where = float(begin[part] + place * width[part])
            self._set(value, _place(block, int(piece[part]), where), "")

    def step(
        self, below: int, size: float, block: TrajectoryBlock, piece: int, where: float
    ) -> None:
        """Compare a step of a lower derivative, at a place in a piece."""
        value = size / self._tick_s ** (self._order - below)
        if value > self._value:
            note = f"{_DEMANDS_STEPPED[below]}; taken over one tick"
            self._set(value, _place(block, piece, where), note)

    def _set(self, value: float, place: tuple[float, int, tuple[float, ...]], note: str) -> None:
        self._value = value
        self.worst = Finding(
            value=value,
            axis=self._axis,
            time_s=place[0],
            operation=place[1],
            position=place[2],
            note=note,
        )


class _Reach:
    """How far one axis goes beyond its travel, or its whole range beyond its stroke."""

    def __init__(self, axis: str, limits: FloatArray, stroke: Quantity | None) -> None:
        self._axis = axis
        self._low, self._high = float(limits[0]), float(limits[1])
        self._stroke = np.inf if stroke is None else float(stroke.si)
        self._ends = {
            1.0: -np.inf,
            -1.0: -np.inf,
        }  # largest position, and smallest position negated
        self._value = -np.inf
        self.worst = Finding(value=None, axis=axis, note="the trajectory is empty")

    def take(self, block: TrajectoryBlock, poly: FloatArray) -> None:
        """Widen the range by a block with the position polynomials ``poly``."""
        hull = hull_of(poly)
        for sign, limit, most in (
            (1.0, self._high, float(hull.max())),
            (-1.0, -self._low, -float(hull.min())),
        ):
            if np.isfinite(self._stroke) and most > self._ends[sign]:
                found = highest(sign * poly, self._ends[sign])
                if found is not None:
                    self._ends[sign] = found[0]
                    spanned = sum(self._ends.values()) - self._stroke
                    self._take(block, (spanned, *found[1:]), " from end to end")
            if most - limit + _ROUNDED * (abs(most) + abs(limit)) <= self._value:
                continue
            beyond = sign * poly
            beyond[0] -= limit
            found = highest(beyond, self._value)
            if found is not None:
                self._take(block, found, "")

    def _take(self, block: TrajectoryBlock, found: tuple[float, int, float], of: str) -> None:
        """Keep the distance beyond a limit, and its place, if it is the largest so far.

        Parameters
        ----------
        found
            Distance beyond the limit, negative within it; index of the piece; place in the piece.
        of
            End of the finding's note.
        """
        value, piece, where = found
        if value <= self._value:
            return
        self._value = value
        time_s, operation, position = _place(block, piece, where)
        self.worst = Finding(
            value=value,
            axis=self._axis,
            time_s=time_s,
            operation=operation,
            position=position,
            note=("beyond" if value > 0 else "room left") + of,
        )
