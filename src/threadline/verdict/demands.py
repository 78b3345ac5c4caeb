"""What the trajectory asks of each axis: travel, velocity, acceleration, jerk, anywhere in time."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.machine.quantity import Quantity
from threadline.plan import Plan
from threadline.trajectory.extremes import derivatives, farthest, highest, hull_of, in_direction
from threadline.trajectory.types import TrajectoryBlock
from threadline.verdict.finding import Finding

SLACK = 1.001  # limits hold between samples too, to a thousandth
_ORDERS = {"velocity": 1, "acceleration": 2, "jerk": 3}
_PUSH = _ORDERS["acceleration"]
_BELOW = (0, 1, 2)
"""Orders of what may step below a demand."""
_ROUNDED = 1e-12
"""Part by which a bound is taken to be further: it is rounded otherwise than what it bounds."""
VELOCITY_STEPS = "the velocity steps"
"""Begins the note of an acceleration that is infinite but for the length of a tick."""
_STEPPED = ("the position steps", VELOCITY_STEPS, "the acceleration steps")


def measure_demands(plan: Plan) -> dict[str, list[Finding]]:
    """Return the exact extremes of the trajectory: per name, one finding per axis.

    ``travel`` is how far the trajectory goes beyond the travel of the axis, or all of its way
    beyond the stroke, negative where room is left; endless axes have none. ``velocity``,
    ``acceleration`` and ``jerk`` are absolute values, in the axis' units. Where a derivative steps
    between two pieces those above it are infinite in theory; the controller sees the step spread
    over one tick of its clock, and so it is counted: a step of velocity is an acceleration for one
    tick, and that in turn a jerk. The acceleration of an axis that brakes otherwise than it speeds
    up is that of speeding up.
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
                # A step of position is a velocity without bound: above that it says no more.
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
    """Return the largest step into a piece of (order, n) polynomials, which, and the last end.

    Parameters
    ----------
    before
        The end before the first piece; None where nothing was before it.
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
        """Compare the (order, n) accelerations of a block where they make the axis faster."""
        toward, piece, begin, width = in_direction(velocity, push)
        found = highest(toward, self._value)
        if found is not None:
            value, part, place = found
            where = float(begin[part] + place * width[part])
            self._set(value, _place(block, int(piece[part]), where), "")

    def step(
        self, below: int, size: float, block: TrajectoryBlock, piece: int, where: float
    ) -> None:
        """Compare a step of a derivative below, at a place in a piece."""
        value = size / self._tick_s ** (self._order - below)
        if value > self._value:
            note = f"{_STEPPED[below]}; taken over one tick"
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
    """How far one axis goes beyond its travel, on either side, or beyond its stroke in all."""

    def __init__(self, axis: str, limits: FloatArray, stroke: Quantity | None) -> None:
        self._axis = axis
        self._low, self._high = float(limits[0]), float(limits[1])
        self._stroke = np.inf if stroke is None else float(stroke.si)
        self._ends = {1.0: -np.inf, -1.0: -np.inf}  # greatest position, and least one negated
        self._value = -np.inf
        self.worst = Finding(value=None, axis=axis, note="the trajectory is empty")

    def take(self, block: TrajectoryBlock, poly: FloatArray) -> None:
        """Widen the reach by a block, of whose positions ``poly`` are the polynomials."""
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
        """Keep how far a limit is exceeded, and where, if it is more than was found before.

        Parameters
        ----------
        found
            Distance beyond the limit, negative within it; index of the piece; place in the piece.
        of
            Words that the note of the finding ends with.
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
