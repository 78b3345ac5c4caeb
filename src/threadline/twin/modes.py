"""Modes of a piecewise linear system as tables: guards, transitions, propagators.

Every combination of the elements' modes is one mode of the whole, numbered in mixed radix; its
tables, for all variants at once, are filled when the first variant meets it. Propagators are
matrix exponentials: ``E(t / 2^s) = exp(Z t / 2^s)`` by its series (the fastest rate times that
time is at most 1/4, 16 terms), then squared s times.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import CFUNCTYPE, c_int64, c_void_p, cast
from threading import Lock

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import MachineError, ThreadlineError
from threadline.twin.shape import Layout, aligned
from threadline.twin.tables import NET_GUARD, PlantTables

_SERIES = 16
_PER_RATE = 0.25
_MOST_BYTES = 1 << 31


def _product(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return A[:, i, k] B[:, k, j] summed over k in order: the same for one variant and many."""
    total: FloatArray = A[:, :, 0, None] * B[:, None, 0, :]
    for k in range(1, A.shape[2]):
        total += A[:, :, k, None] * B[:, None, k, :]
    return total


def _after(step: FloatArray, before: FloatArray) -> FloatArray:
    """Return the propagator (V, n, N) of one advance after another."""
    n = step.shape[1]
    found = _product(np.ascontiguousarray(step[:, :, :n]), before)
    found[:, :, n:] += step[:, :, n:]
    return found


def propagator(generator: FloatArray, time_s: float, rate: float) -> FloatArray:
    """Return the (V, n, N) propagator of ``x' = generator . [x, inputs, 1]`` over a time.

    Parameters
    ----------
    rate
        The fastest rate of the machine, 1/s.
    """
    n = generator.shape[1]
    halvings = max(0, int(np.ceil(np.log2(max(rate * time_s / _PER_RATE, 1.0)))))
    scaled = generator * (time_s / 2**halvings)
    inner = np.ascontiguousarray(scaled[:, :, :n])
    step: FloatArray = scaled.copy()
    step[:, range(n), range(n)] += 1.0
    term = scaled
    for k in range(2, _SERIES + 1):
        term = _product(inner, term) / k
        step += term
    for _ in range(halvings):
        step = _after(step, step)
    return step


class Modes:
    """Tables of the modes met so far, for all variants; used by several threads at once.

    Parameters
    ----------
    plant
        The piece.
    which
        (V,) the variant of ``plant`` that each lane simulates.
    layout
        Rows of a mode, in this order.
    lengths_s
        Distinct advances.
    rate
        The fastest rate of the machine, 1/s.

    Attributes
    ----------
    tables, plans
        Address of the table and of the plan of each mode, 0 while it has not been met.
    address
        Of the function that fills those of a mode.
    failure
        Why a mode could not be filled.
    """

    def __init__(
        self,
        plant: PlantTables,
        which: IntArray,
        layout: Layout,
        lengths_s: tuple[float, ...],
        rate: float,
    ) -> None:
        self.plant, self.which, self.layout = plant, which, layout
        self.lengths_s, self.rate = lengths_s, rate
        count = int(np.prod(plant.modes))
        self.tables = np.zeros(count, dtype=np.uint64)
        self.plans = np.zeros(count, dtype=np.uint64)
        self.guards = len(layout.shape.guards)
        self.kept: dict[int, tuple[FloatArray, IntArray]] = {}
        self.failure: ThreadlineError | None = None
        self._lock = Lock()
        self._callback: Callable[..., None] = CFUNCTYPE(None, c_int64)(self._meet)
        self.address = cast(self._callback, c_void_p).value or 0

    def _meet(self, mode: int) -> None:
        # Called from machine code: nothing may be raised there.
        try:
            self.meet(mode)
        except ThreadlineError as error:
            self.failure = error

    def meet(self, mode: int) -> FloatArray:
        """Return the (groups, rows + 2 W, width) table of a mode; held values come last."""
        with self._lock:
            if mode not in self.kept:
                size = 8 * len(self.which) * (self.layout.of_mode + 2 * self.guards)
                if size * (len(self.kept) + 1) > _MOST_BYTES:
                    raise MachineError(
                        f"the simulation met more than {len(self.kept)} combinations of limits, "
                        f"belts, play and friction; their tables take {size} bytes each, limit "
                        f"{_MOST_BYTES} in all",
                        remedy="Leave out those that do not matter.",
                    )
                table, plan = self.kept[mode] = self._filled(mode)
                self.plans[mode] = plan.ctypes.data
                self.tables[mode] = table.ctypes.data
            return self.kept[mode][0]

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
            generator += plant.direction[:, e, :, None] * plant.law[:, e, m, None, :]
        guard, bounds, held_values, plan = self._guards(mode, choice, generator)
        for e, m in enumerate(choice):
            if plant.holds[e, m] >= 0:
                generator[:, plant.holds[e, m]] = 0.0
        rows: dict[tuple[object, ...], FloatArray] = {}
        for w in range(W):
            rows["low", w], rows["high", w] = bounds[:, w, 0], bounds[:, w, 1]
        _put(rows, ("guard",), guard)
        currents = [plant.law[:, e, choice[e]] for e in plant.drive_element]
        if currents:
            _put(rows, ("current",), np.stack(currents, axis=1))
        _put(rows, ("matrix",), generator)
        table = np.zeros((len(plant.base), self.layout.of_mode + 2 * W))
        self._place(table, rows, 0)
        for x, time_s in enumerate(self.lengths_s):
            of_length = self._of_length(generator, guard, time_s)
            self._place(table, of_length, x * self.layout.per_length)
        table[:, self.layout.of_mode :] = held_values.reshape(len(table), -1)
        groups = table[self.which].reshape(-1, self.layout.shape.width, table.shape[1])
        found = aligned((len(groups), table.shape[1], groups.shape[1]))
        found[:] = groups.transpose(0, 2, 1)
        return found, plan

    def _place(
        self, table: FloatArray, rows: dict[tuple[object, ...], FloatArray], offset: int
    ) -> None:
        for name, at in self.layout.row.items():
            if name in rows:
                table[:, at - self.layout.fixed + offset] = rows[name]

    def _guards(
        self, mode: int, choice: list[int], generator: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
        """Return rows (V, W, N), bounds (V, W, 2), values of held states (V, W, 2), plan (5 W).

        The plan has the limit switch that each guard is (W), the next mode (W, 2) and the state
        that is held then (W, 2), each below and above.
        """
        plant, W = self.plant, self.guards
        variants, _, size = generator.shape
        rows = np.zeros((variants, W, size))
        bounds = np.full((variants, W, 2), (-np.inf, np.inf))
        values = np.zeros((variants, W, 2))
        switch = np.full(W, -1, dtype=np.int64)
        to = np.full((W, 2), mode, dtype=np.int64)
        holds = np.full((W, 2), -1, dtype=np.int64)
        w, radix = 0, 1
        for e, m in enumerate(choice):
            for g in range(int(plant.guards[e])):
                kind = plant.guard_kind[e, m, g]
                switch[w] = plant.guard_switch[e, m, g]
                if kind != 0:
                    bounds[:, w, 0] = plant.guard_low[:, e, m, g]
                    bounds[:, w, 1] = plant.guard_high[:, e, m, g]
                    rows[:, w] = plant.guard_row[:, e, m, g]
                if kind == NET_GUARD:
                    # The force on a held state, whatever else is held, before it is taken out.
                    net = plant.net_scale[:, e, m, None]
                    rows[:, w] = net * generator[:, plant.holds[e, m]]
                for side, next_mode in enumerate(plant.guard_to[e, m, g]):
                    if next_mode >= 0:
                        to[w, side] = mode + (next_mode - m) * radix
                        holds[w, side] = plant.holds[e, next_mode]
                        values[:, w, side] = plant.held_at[:, e, next_mode]
                bounds[:, w] -= rows[:, w, -1:]
                rows[:, w, -1] = 0.0
                w += 1
            radix *= int(plant.modes[e])
        return rows, bounds, values, np.concatenate((switch, to.ravel(), holds.ravel()))

    def _of_length(
        self, generator: FloatArray, guard: FloatArray, time_s: float
    ) -> dict[tuple[object, ...], FloatArray]:
        """Return the rows that belong to one advance.

        Of a guard, a third of what its rate makes in that time: to its inner Bezier points.
        """
        n = generator.shape[1]
        rows: dict[tuple[object, ...], FloatArray] = {}
        _put(rows, ("step",), propagator(generator, time_s, self.rate))
        rate = _product(np.ascontiguousarray(guard[:, :, :n]), generator) if self.guards else guard
        _put(rows, ("third",), rate * (time_s / 3.0))
        return rows


def _put(
    rows: dict[tuple[object, ...], FloatArray], name: tuple[object, ...], values: FloatArray
) -> None:
    for i in range(values.shape[1]):
        for j in range(values.shape[2]):
            rows[(*name, i, j)] = values[:, i, j]
