"""Tables of the modes of a piecewise linear system: guards, transitions, propagators.

Every combination of the elements' modes is a mode of the system, numbered in mixed radix. Its
tables, for all variants at once, are filled when the first variant enters it. Propagators are
matrix exponentials: ``E(t / 2^s) = exp(Z t / 2^s)`` by its series (the fastest rate times that time
is at most 1/4, the remainder below 1e-18), then squared s times.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import CFUNCTYPE, c_int64, c_void_p, cast
from math import ceil, log2
from threading import Lock

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import MachineError, ThreadlineError
from threadline.twin.kernel.layout import Layout, aligned
from threadline.twin.kernel.names import Field
from threadline.twin.kernel.tables import NET_GUARD, PlantTables

_PER_RATE = 0.25
_REMAINDER = 1e-18
_MOST_BYTES = 1 << 31
_FEW = 64  # variants: up to so many, temporaries for all rows of a matrix are small
_OF_VARIANTS = (
    "base", "direction", "law", "held_at", "net_scale", "guard_row", "guard_low", "guard_high",
)  # fmt: skip


def _product(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return A[i, k] B[k, j] summed over k in order; variants are the last index of both."""
    found = np.zeros((A.shape[0], *B.shape[1:]))
    there = np.any(A, axis=2)
    if A.shape[2] > _FEW:
        for i, k in zip(*np.nonzero(there), strict=True):
            found[i] += A[i, k] * B[k]
        return found
    for k in range(A.shape[1]):
        # For few variants the calls cost more than the sums, so add all rows at once.
        rows = np.flatnonzero(there[:, k])
        found[rows] += A[rows, k, None] * B[k]
    return found


class Propagators:
    """Propagators (n, N, V) of ``x' = generator . [x, inputs, 1]`` over any time.

    Parameters
    ----------
    generator
        (n, N, V).
    rate
        The fastest rate of the machine, 1/s.
    """

    def __init__(self, generator: FloatArray, rate: float) -> None:
        self.generator, self.rate = generator, rate
        self.powers = [generator]

    def over(self, time_s: float) -> FloatArray:
        """Return the propagator over a time, in s."""
        n = len(self.generator)
        halvings = max(0, ceil(log2(max(self.rate * time_s / _PER_RATE, 1.0))))
        part_s = time_s / 2**halvings
        step = np.zeros_like(self.generator)
        step[range(n), range(n)] = 1.0
        factor, left, k = 1.0, 1.0, 0
        while left > _REMAINDER:
            k += 1
            factor *= part_s
            left *= self.rate * part_s / k
            if k > len(self.powers):
                self.powers.append(_product(self.generator[:, :n], self.powers[-1]) / k)
            step += self.powers[k - 1] * factor
        for _ in range(halvings):
            after = _product(step[:, :n], step)
            after[:, n:] += step[:, n:]
            step = after
        return step


class ModeTables:
    """Tables of the modes entered so far, for all variants; shared by threads.

    Parameters
    ----------
    plant
        The piece.
    which
        (V,) the variant of ``plant`` in each lane.
    layout
        Order of the rows of a mode.
    lengths_s
        Distinct advances.
    rate
        The fastest rate of the machine, 1/s.

    Attributes
    ----------
    tables, plans
        Addresses of the table and plan of each mode, 0 before its first use.
    address
        Address of the function that fills the tables of a mode.
    failure
        Error of a mode that could not be filled.
    """

    def __init__(
        self,
        plant: PlantTables,
        which: IntArray,
        layout: Layout,
        lengths_s: tuple[float, ...],
        rate: float,
    ) -> None:
        self.layout, self.lanes = layout, len(which)
        self.plant = plant._replace(
            **{
                name: np.ascontiguousarray(np.moveaxis(getattr(plant, name)[which], 0, -1))
                for name in _OF_VARIANTS
            }
        )
        self.lengths_s, self.rate = lengths_s, rate
        count = int(np.prod(plant.modes))
        self.tables = np.zeros(count, dtype=np.uint64)
        self.plans = np.zeros(count, dtype=np.uint64)
        self.guards = len(layout.shape.guards)
        self._lying = _lying(layout)
        self.filled_tables: dict[int, tuple[FloatArray, IntArray]] = {}
        self.failure: ThreadlineError | None = None
        self._lock = Lock()
        self._callback: Callable[..., None] = CFUNCTYPE(None, c_int64)(self._meet)
        self.address = cast(self._callback, c_void_p).value or 0

    def _meet(self, mode: int) -> None:
        # Called from machine code, so it must not raise.
        try:
            self.meet(mode)
        except ThreadlineError as error:
            self.failure = error

    def meet(self, mode: int) -> FloatArray:
        """Return the (groups, table rows, width) table of a mode, with held values last."""
        with self._lock:
            if mode not in self.filled_tables:
                size = 8 * self.lanes * self.layout.table_rows
                if size * (len(self.filled_tables) + 1) > _MOST_BYTES:
                    raise MachineError(
                        f"the simulation met more than {len(self.filled_tables)} combinations of "
                        f"limits, belts, play and friction; their tables take {size} bytes each, "
                        f"limit {_MOST_BYTES} in all",
                        remedy="Leave out limits, belts, play or friction that hardly matter.",
                    )
                table, plan = self.filled_tables[mode] = self._filled(mode)
                self.plans[mode] = plan.ctypes.data
                self.tables[mode] = table.ctypes.data
            return self.filled_tables[mode][0]

    def _choice(self, mode: int) -> list[int]:
        found = []
        for count in self.plant.modes:
            found.append(mode % int(count))
            mode //= int(count)
        return found

    def _filled(self, mode: int) -> tuple[FloatArray, IntArray]:
        plant, W = self.plant, self.guards
        choice = self._choice(mode)
        generator = plant.base.copy()
        for e, m in enumerate(choice):
            generator += plant.direction[e][:, None] * plant.law[e, m]
        guard, bounds, held_values, plan = self._guards(mode, choice, generator)
        for e, m in enumerate(choice):
            if plant.holds[e, m] >= 0:
                generator[plant.holds[e, m]] = 0.0
        table = np.zeros((self.layout.table_rows, self.lanes))
        self._put(table, Field.LOW, bounds[:, 0])
        self._put(table, Field.HIGH, bounds[:, 1])
        self._put(table, Field.GUARD, guard)
        for d, e in enumerate(plant.drive_element):
            self._put(table, Field.CURRENT, plant.law[e, choice[e]], of=d)
        self._put(table, Field.MATRIX, generator)
        propagators = Propagators(generator, self.rate)
        n = len(generator)
        rate = _product(guard[:, :n], generator) if W else guard
        for x, time_s in enumerate(self.lengths_s):
            own = table[x * self.layout.per_length :]
            step = propagators.over(time_s)
            self._put(own, Field.STEP, step)
            # A third of a guard's rate times the length: offset of its inner Bezier points.
            self._put(own, Field.THIRD, rate * (time_s / 3.0))
            if self.layout.shape.nearness():
                self._put_near(own, bounds, (guard, rate * (time_s / 3.0)), step)
        table[self.layout.of_mode :] = held_values.reshape(2 * W, self.lanes)
        groups = table.reshape(len(table), -1, self.layout.shape.width)
        found = aligned((groups.shape[1], len(table), groups.shape[2]))
        found[:] = groups.transpose(1, 0, 2)
        return found, plan

    def _put(
        self, table: FloatArray, field: Field, values: FloatArray, *, of: int | None = None
    ) -> None:
        """Write the (..., V) values of a field, or of its part ``of``, into its rows."""
        if (field, of) in self._lying:
            rows, places = self._lying[field, of]
            table[rows] = values[places]

    def _put_near(
        self,
        table: FloatArray,
        bounds: FloatArray,
        guard: tuple[FloatArray, FloatArray],
        step: FloatArray,
    ) -> None:
        """Write the range of the guards' Bezier points, for ``Lanes.may_be_near``."""
        n, (row, third) = len(step), guard
        points = [row, row + third]
        for before in (row - third, row):
            after = _product(before[:, :n], step)
            after[:, n:] += before[:, n:]
            points.append(after)
        most, least = np.maximum.reduce(points), np.minimum.reduce(points)
        middle, spread = 0.5 * (most + least), 0.5 * (most - least)
        self._put(table, Field.MIDDLE, middle)
        self._put(table, Field.SPREAD, spread)
        self._put(table, Field.NEAR_LOW, bounds[:, 0] - middle[:, -1] + spread[:, -1])
        self._put(table, Field.NEAR_HIGH, bounds[:, 1] - middle[:, -1] - spread[:, -1])

    def _guards(
        self, mode: int, choice: list[int], generator: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
        """Return rows (W, N, V), bounds (W, 2, V), values of held states (W, 2, V), plan.

        The plan has the limit switch of each guard (W), the next mode (W, 2) and the state that it
        holds (W, 2), below and above each.
        """
        plant, W = self.plant, self.guards
        size = generator.shape[1]
        rows = np.zeros((W, size, self.lanes))
        bounds = np.zeros((W, 2, self.lanes))
        bounds[:, 0], bounds[:, 1] = -np.inf, np.inf
        values = np.zeros((W, 2, self.lanes))
        switch = np.full(W, -1, dtype=np.int64)
        to = np.full((W, 2), mode, dtype=np.int64)
        holds = np.full((W, 2), -1, dtype=np.int64)
        w, radix = 0, 1
        for e, m in enumerate(choice):
            for g in range(int(plant.guards[e])):
                kind = plant.guard_kind[e, m, g]
                switch[w] = plant.guard_switch[e, m, g]
                if kind != 0:
                    bounds[w] = plant.guard_low[e, m, g], plant.guard_high[e, m, g]
                    rows[w] = plant.guard_row[e, m, g]
                if kind == NET_GUARD:
                    # The force on a held state, before its row is set to 0.
                    rows[w] = plant.net_scale[e, m] * generator[plant.holds[e, m]]
                for side, next_mode in enumerate(plant.guard_to[e, m, g]):
                    if next_mode >= 0:
                        to[w, side] = mode + (next_mode - m) * radix
                        holds[w, side] = plant.holds[e, next_mode]
                        values[w, side] = plant.held_at[e, next_mode]
                bounds[w] -= rows[w, -1]
                rows[w, -1] = 0.0
                w += 1
            radix *= int(plant.modes[e])
        at = self.layout.plan
        plan = np.empty(at.size, dtype=np.int64)
        plan[at.switch : at.switch + W] = switch
        plan[at.to : at.to + 2 * W] = to.ravel()
        plan[at.held : at.held + 2 * W] = holds.ravel()
        return rows, bounds, values, plan


def _lying(layout: Layout) -> dict[tuple[Field, int | None], tuple[IntArray, tuple[IntArray, ...]]]:
    """Return the rows of each field in a mode's table, and their indices in the field.

    Currents are listed per drive, with indices within the drive.
    """
    found: dict[tuple[Field, int | None], list[tuple[int, ...]]] = {}
    for (field, *place), row in layout.row.items():
        if row >= layout.fixed:
            of = place.pop(0) if field is Field.CURRENT else None
            found.setdefault((field, of), []).append((row - layout.fixed, *place))
    columns = {key: np.array(rows, dtype=np.int64).T for key, rows in found.items()}
    return {key: (rows[0], tuple(rows[1:])) for key, rows in columns.items()}
