"""What the trajectory asks of each axis: travel, velocity, acceleration, jerk, anywhere in time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from threadline.arrays import FloatArray
from threadline.plan import Plan
from threadline.trajectory.extremes import derivatives, farthest, highest
from threadline.trajectory.types import TrajectoryBlock
from threadline.verdict.finding import Finding

SLACK = 1.001  # limits hold between samples too, to a thousandth
_ORDERS = {"velocity": 1, "acceleration": 2, "jerk": 3}
_STEPPED = ("position", "velocity", "acceleration")


def measure_demands(plan: Plan) -> dict[str, list[Finding]]:
    """Return the exact extremes of the trajectory: per name, one finding per axis.

    ``travel`` is how far the trajectory goes beyond the travel of the axis, negative where room
    is left; endless axes have none. ``velocity``, ``acceleration`` and ``jerk`` are absolute
    values, in the axis' units. Where a derivative steps between two pieces those above it are
    infinite in theory; the controller sees the step spread over one tick of its clock, and so it
    is counted: a step of velocity is an acceleration for one tick, and that in turn a jerk.
    """
    axes = plan.motion.trajectory.axes
    tick_s = float(plan.machine.tick_clock.period_s)
    demands = {
        name: [_Demand(axis, order, tick_s) for axis in axes] for name, order in _ORDERS.items()
    }
    limits = plan.machine.travel
    rows = [plan.machine.axis_names.index(axis) for axis in axes]
    reach = {
        column: _Reach(axis, limits[row])
        for column, (axis, row) in enumerate(zip(axes, rows, strict=True))
        if np.isfinite(limits[row]).all()
    }
    for block in plan.motion.trajectory:
        for column in range(len(axes)) if len(block) else ():
            polys = derivatives(block, column, max(_ORDERS.values()))
            for row in demands.values():
                row[column].take(block, polys)
            if column in reach:
                reach[column].take(block, polys[0])
    for row in demands.values():
        for demand in row:
            demand.stop()
    found = {name: [demand.worst for demand in row] for name, row in demands.items()}
    found["travel"] = [axis_reach.worst for axis_reach in reach.values()]
    return found


def _place(
    block: TrajectoryBlock, piece: int, where: float
) -> tuple[float, int, tuple[float, ...]]:
    position = block.coefficients[piece].T @ where ** np.arange(block.coefficients.shape[1])
    time_s = float(block.start_s[piece] + where * block.duration_s[piece])
    return time_s, int(block.operation[piece]), tuple(position.tolist())


class _Demand:
    """The largest absolute value of one derivative of one axis."""

    def __init__(self, axis: str, order: int, tick_s: float) -> None:
        self._axis, self._order, self._tick_s = axis, order, tick_s
        # What the derivatives below were before the next piece; at rest before the start.
        self._below: dict[int, float] = dict.fromkeys(range(1, order), 0.0)
        self._end: tuple[float, int, tuple[float, ...]] = (0.0, 0, ())
        self._value = 0.0
        self.worst = Finding(value=0.0, axis=axis)

    def take(self, block: TrajectoryBlock, polys: Sequence[FloatArray]) -> None:
        """Compare the pieces of a block, and the steps at their starts."""
        found = farthest(polys[self._order], self._value)
        if found is not None:
            self._set(found[0], _place(block, found[1], found[2]), "")
        # A step of position is a velocity without bound; what it is above that says no more.
        for below in range(min(1, self._order - 1), self._order):
            starts, ends = polys[below][0], polys[below].sum(axis=0)
            before = self._below.get(below, starts[0])
            steps = np.abs(starts - np.concatenate([[before], ends[:-1]]))
            piece = int(np.argmax(steps))
            self._step(below, float(steps[piece]), _place(block, piece, 0.0))
            self._below[below] = float(ends[-1])
        self._end = _place(block, len(block) - 1, 1.0)

    def stop(self) -> None:
        """Compare the step into the standstill after the end."""
        for below in range(1, self._order):
            self._step(below, abs(self._below[below]), self._end)

    def _step(self, below: int, step: float, place: tuple[float, int, tuple[float, ...]]) -> None:
        value = step / self._tick_s ** (self._order - below)
        if value > self._value:
            self._set(value, place, f"the {_STEPPED[below]} steps; taken over one tick")

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
    """How far one axis goes beyond its travel, on either side."""

    def __init__(self, axis: str, limits: FloatArray) -> None:
        self._axis = axis
        self._low, self._high = float(limits[0]), float(limits[1])
        self._value = -np.inf
        self.worst = Finding(value=None, axis=axis, note="the trajectory is empty")

    def take(self, block: TrajectoryBlock, poly: FloatArray) -> None:
        """Widen the reach by a block, of whose positions ``poly`` are the polynomials."""
        for sign, limit in ((1.0, self._high), (-1.0, -self._low)):
            beyond = sign * poly
            beyond[0] -= limit
            found = highest(beyond, self._value)
            if found is None:
                continue
            self._value, piece, where = found
            time_s, operation, position = _place(block, piece, where)
            self.worst = Finding(
                value=self._value,
                axis=self._axis,
                time_s=time_s,
                operation=operation,
                position=position,
                note="beyond" if self._value > 0 else "room left",
            )
