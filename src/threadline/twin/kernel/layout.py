"""Layout of the workspace of a kernel.

The workspace of a group of variants ("lanes") is rows of ``width`` numbers, so that one vector
instruction serves all of them; a block is as many groups as fit the fastest cache. Only matrix
entries that can differ from zero (and, on the diagonal of a propagator, from one) have rows.
"""

from __future__ import annotations

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.twin.kernel.names import AXIS_CHANGING, CHANGING, NUMBERS, Field, PlanLayout, Row
from threadline.twin.kernel.shape import BankShape, ControllerShape, SensorShape, Shape

_LINE, _PAGE = 64, 4096


class Layout:
    """Rows of the workspace by name; the rows of a mode come last, and of these the advances.

    With several distinct advances their rows stay in the tables of the modes: while all lanes are
    in one mode, ``SOURCE`` is the address of the first row there. Otherwise the rows of one advance
    at a time are collected in the workspace.

    Attributes
    ----------
    fixed
        Number of rows independent of the mode.
    of_mode, copied
        Rows in the table of a mode, and how many of them a mode change copies.
    per_length
        Rows of one advance.
    stride
        Rows from one group of lanes to the next.
    plan
        Meaning of the integers in a mode's plan.
    """

    def __init__(self, shape: Shape) -> None:
        self.row: dict[Row, int] = {}
        self.shape, self.plan = shape, PlanLayout(len(shape.guards))
        n, size = shape.states, shape.columns
        for i in range(size - 1):
            self._add(Field.COLUMN, i)
        if shape.guards:
            for i in range(n):
                self._add(Field.OLD, i)
        unused = [self._unused(c) for c in shape.controllers]
        for c in range(len(unused)):
            for field in CHANGING:
                if field not in unused[c]:
                    self._add(field, c)
        for c, controller in enumerate(shape.controllers):
            if controller.bank is not None:
                for i in range(len(controller.bank.following)):
                    self._add(Field.HOLDING, c, i)
        for s, sensor in enumerate(shape.observing):
            if sensor.noisy:
                self._add(Field.SEED, s)
        for x in range(len(shape.axes)):
            for field in AXIS_CHANGING:
                self._add(field, x)
        for d in range(len(shape.drives)):
            self._add(Field.PEAK, d)
        for s in range(shape.inputs):
            self._add(Field.TRIPPED, s)
        self._add(Field.MODE)
        if shape.lengths > 1:
            self._add(Field.SOURCE)
        changing = len(self.row)
        self._add_controllers(unused)
        for x, axis in enumerate(shape.axes):
            self._add(Field.SCALE, x)
            for j in axis.load:
                self._add(Field.LOAD, x, j)
            for j in axis.frame:
                self._add(Field.FRAME, x, j)
            for j in axis.rate:
                self._add(Field.RATE, x, j)
        self.fixed = len(self.row)
        reach, _ = shape.reach()
        for w in range(len(shape.guards)):
            self._add(Field.LOW, w)
            self._add(Field.HIGH, w)
        for w, guard in enumerate(shape.guards):
            for j in guard.row:
                self._add(Field.GUARD, w, j)
        for d, pattern in enumerate(shape.drives):
            for j in pattern:
                self._add(Field.CURRENT, d, j)
        for i in shape.derived:
            for j in shape.matrix[i]:
                self._add(Field.MATRIX, i, j)
        self.first_length = len(self.row)
        for i, pattern in enumerate(reach):
            for j in pattern:
                self._add(Field.STEP, i, j)
        for w, pattern in enumerate(shape.rates()):
            for j in pattern:
                self._add(Field.THIRD, w, j)
        for w, pattern in enumerate(shape.nearness()):
            if pattern:
                self._add(Field.NEAR_LOW, w)
                self._add(Field.NEAR_HIGH, w)
            for j in pattern:
                self._add(Field.MIDDLE, w, j)
                self._add(Field.SPREAD, w, j)
        self.rows = len(self.row)
        self.per_length = self.rows - self.first_length
        common = self.first_length - self.fixed
        self.of_mode = common + shape.lengths * self.per_length
        self.copied = common + (self.per_length if shape.lengths == 1 else 0)

        # A load waits for an earlier store to an address with equal last twelve bits (4K aliasing),
        # so changing rows must not alias rows that the next vector of lanes reads.
        lines = max(1, 8 * shape.width // _LINE)
        period = _PAGE // _LINE // lines
        self.stride = self.rows
        if shape.lanes > shape.width:
            self.stride += (changing - self.rows) % period

    def _add_controllers(self, unused: list[set[Field]]) -> None:
        """Add the numbers of controllers and observing sensors."""
        shape = self.shape
        for c, controller in enumerate(shape.controllers):
            for field in NUMBERS:
                if field not in unused[c]:
                    self._add(field, c)
            for j in controller.sensor:
                self._add(Field.SENSOR, c, j)
            if controller.bank is not None:
                self._add_bank(c, controller.bank)
        for s, sensor in enumerate(shape.observing):
            self._add_sensor(s, sensor)

    def _add_bank(self, c: int, bank: BankShape) -> None:
        for field, patterns in (
            (Field.NEXT, bank.following), (Field.OUT, bank.output), (Field.BACK, bank.back),
        ):  # fmt: skip
            for i, pattern in enumerate(patterns):
                for j in pattern:
                    self._add(field, c, i, j)

    def _add_sensor(self, s: int, sensor: SensorShape) -> None:
        for j in sensor.sees:
            self._add(Field.SEES, s, j)
        for i in sensor.feels:
            self._add(Field.FEELS, s, i)
        for field, there in (
            (Field.GRAIN, bool(sensor.rounding)), (Field.SPAN, sensor.limited),
            (Field.NOISE, sensor.noisy),
        ):  # fmt: skip
            if there:
                self._add(field, s)

    def _unused(self, controller: ControllerShape) -> set[Field]:
        """Return the rows that a controller does not need."""
        unused: set[Field] = set()
        if not controller.second:
            unused |= {Field.ERROR_2, Field.OUTPUT_2, Field.B2, Field.A2}
        if not (controller.second or controller.feedback):
            unused |= {Field.OUTPUT_1, Field.A1}
        if controller.banked:
            unused |= {Field.ERROR_1, Field.B0, Field.B1}
        if not self.shape.delayed:
            unused.add(Field.HELD)
        if not controller.limited:
            unused.add(Field.LIMIT)
        if not controller.profile:
            unused |= {Field.POSITION, Field.SPEED, Field.GOAL, Field.ACCELERATION}
        if controller.profile != "speed":
            unused |= {Field.SEEN, Field.PER_TICK}
        if controller.profile != "target":
            unused.add(Field.FASTEST)
        return unused

    def _add(self, *row: *Row) -> None:
        self.row[row] = len(self.row)

    def __getitem__(self, row: Row) -> int:
        return self.row[row]

    @property
    def table_rows(self) -> int:
        """Rows of the whole table of a mode; the last ones are the values of held states."""
        return self.of_mode + 2 * self.plan.guards


def aligned(shape: tuple[int, ...]) -> FloatArray:
    """Return zeros that begin at a cache line; a vector across two lines would cost twice."""
    count = int(np.prod(shape))
    room = np.zeros(8 * count + _LINE, dtype=np.uint8)
    first = -room.ctypes.data % _LINE
    return room[first : first + 8 * count].view(np.float64).reshape(shape)
