"""Names of the numbers of the engine: rows, slots, counters, actions and readings.

These names are the only interface between machine code and Python. ``Layout`` gives the position of
a row in the workspace; other positions are the value of the member.
"""

from __future__ import annotations

from enum import IntEnum, auto
from typing import NamedTuple

from threadline.twin.timeline import ARRIVE, CONTROL, TICK


class Field(IntEnum):
    """Content of a row of the workspace; most fields have a row per state, controller, axis ...

    The comments give the unit and the owner of the rows.
    """

    COLUMN = auto()  # states, then the inputs of drives
    OLD = auto()  # states before the present advance
    # Of a controller, in counts and levels, one and two ticks earlier.
    ERROR_1 = auto()
    ERROR_2 = auto()
    OUTPUT_1 = auto()
    OUTPUT_2 = auto()
    LEVEL = auto()  # of its DAC
    HELD = auto()  # level after the dead time
    # Of a controller that generates positions, in counts and counts per tick.
    POSITION = auto()
    SPEED = auto()
    GOAL = auto()  # intended speed or target
    SEEN = auto()  # last reference
    HOLDING = auto()  # state of a state-space controller
    SEED = auto()  # of an observing sensor's noise
    # Of an axis, m or rad.
    WORST = auto()  # largest |commanded - load|
    LOWEST = auto()  # load, within the window
    HIGHEST = auto()
    LAST = auto()
    SCALE = auto()  # m or rad per count
    PEAK = auto()  # of a drive's current, since the last sample, A
    TRIPPED = auto()  # of a limit switch: 1 after it has cut its drive
    MODE = auto()  # number of the present mode
    SOURCE = auto()  # address of the rows of advances, 0 while lanes are in several modes
    # Of a controller, fixed: u = b0 e + b1 e' + b2 e'' - a1 u' - a2 u''.
    B0 = auto()
    B1 = auto()
    B2 = auto()
    A1 = auto()
    A2 = auto()
    LEVEL_LOW = auto()
    LEVEL_HIGH = auto()
    VOLT = auto()  # per level
    GAIN = auto()  # of the drive's input per level
    LIMIT = auto()  # of the drive's input
    PHASE = auto()  # of the encoder, counts
    ACCELERATION = auto()  # counts per tick squared
    FASTEST = auto()  # counts per tick
    PER_TICK = auto()  # reference ticks per filter tick
    SENSOR = auto()  # row: counts read
    # Of a state-space controller: rows over its states, references and readings.
    NEXT = auto()  # of a state at the next tick
    OUT = auto()  # of an output
    BACK = auto()  # of a state, per level that the ends of the DAC cut off the outputs
    # Of an observing sensor.
    SEES = auto()  # row: reading
    FEELS = auto()  # row: reading, over the rates of the states
    GRAIN = auto()  # step of its converter
    SPAN = auto()  # largest reading to either side
    NOISE = auto()  # standard deviation
    LOAD = auto()  # row of an axis
    FRAME = auto()  # row of an axis
    RATE = auto()  # row of an axis: of its load's velocity
    # Of a mode.
    LOW = auto()  # bounds of a guard
    HIGH = auto()
    GUARD = auto()  # row
    CURRENT = auto()  # row of a drive
    MATRIX = auto()  # row of a state's derivative
    # Of a mode and of one length of advance.
    STEP = auto()  # row of a state's propagator
    THIRD = auto()  # row of a guard: a third of its rate times the length of the advance
    NEAR_LOW = auto()  # bounds of the cheap test of a guard
    NEAR_HIGH = auto()
    MIDDLE = auto()  # rows of that test
    SPREAD = auto()


Row = tuple[Field, *tuple[int, ...]]
"""A row of the workspace, with a number per lane: its field, the index of its owner, and the column
for a field that is a row, as in ``rows[Field.SENSOR, controller, column]``."""

PER_LENGTH_FIELDS = frozenset(
    (Field.STEP, Field.THIRD, Field.NEAR_LOW, Field.NEAR_HIGH, Field.MIDDLE, Field.SPREAD)
)
"""Fields with separate rows for every length of advance."""

CHANGING = (
    Field.ERROR_1, Field.ERROR_2, Field.OUTPUT_1, Field.OUTPUT_2, Field.LEVEL, Field.HELD,
    Field.POSITION, Field.SPEED, Field.GOAL, Field.SEEN,
)  # fmt: skip
"""Rows of a controller that change."""
NUMBERS = (
    Field.B0, Field.B1, Field.B2, Field.A1, Field.A2, Field.LEVEL_LOW, Field.LEVEL_HIGH, Field.VOLT,
    Field.GAIN, Field.LIMIT, Field.PHASE, Field.ACCELERATION, Field.FASTEST, Field.PER_TICK,
)  # fmt: skip
"""Rows of a controller that do not change."""
AXIS_CHANGING = (Field.WORST, Field.LOWEST, Field.HIGHEST, Field.LAST)
"""Rows of an axis that change."""


class Slot(IntEnum):
    """Entries of the integer array that machine code gets: addresses and counts."""

    WORK = 0  # (groups, rows, width) the workspace
    CLOCK = 1  # (blocks, entries) see ``ClockEntry``
    COUNTS = 2  # (blocks, 4) see ``Count``
    TABLES = 3  # (modes,) addresses
    PLANS = 4  # (modes,) addresses, see ``PlanLayout``
    CELLS = 5  # (lengths,) cells of each advance
    CELL_S = 6  # (lengths,) length of these cells, s
    MEET = 7  # address of the function that fills the tables of a mode
    KINDS = 8  # (steps,) kind of each step of the hyperperiod
    LENGTHS = 9  # (steps,) index of the length of each step's advance
    STEPS = 10
    REFERENCES = 11  # (rows, controllers) counts
    ROWS = 12
    EVERY = 13  # ticks from sample to sample, 0 for none
    WINDOW = 14  # first tick of the window of smallest and largest load
    RECORDS = 15  # (columns, 2) address of the samples, or 0; stride in numbers
    RING = 16  # (blocks, controllers, length, lanes) levels in the dead times
    RING_LENGTH = 17


class ClockEntry(IntEnum):
    """Entries of a block's clock; from ``HEADS`` on two per controller."""

    STEP = 0  # of the hyperperiod
    UNTIL_SAMPLE = 1  # ticks
    NOW = 2  # tick
    HEADS = 3  # positions in a controller's dead-time ring: writing, reading


class Count(IntEnum):
    """Counters of a block."""

    EVENTS = 0  # changes of modes
    SLOW = 1  # advances with a possible change of mode
    ENDLESS = 2  # endless changes
    UNMET = 3  # modes without a table


class Exit(IntEnum):
    """Arguments and results of the search for a guard's first exit."""

    LOW = 0
    HIGH = 1
    UNTIL = 2  # end of the cell; afterwards the exit, if any
    SIDE = 3  # +1 above, -1 below, 0 for no exit


class Do(IntEnum):
    """Kind of an action."""

    TICK = TICK  # loads, sample, the next row
    CONTROL = CONTROL  # a controller acts
    ARRIVE = ARRIVE  # its level arrives
    ADVANCE = 3  # to the next instant


class Action(NamedTuple):
    """One action of a step."""

    do: Do
    controller: int = 0


class PlanLayout(NamedTuple):
    """Positions of the integers of a mode's plan, which describe its transitions.

    Sides of guards are numbered in pairs, below before above. Users only add to these positions, so
    that they apply to integers and to machine code values.
    """

    guards: int

    @property
    def size(self) -> int:
        """Integers of a plan."""
        return 5 * self.guards

    @property
    def switch(self) -> int:
        """First of the guards' limit switches; -1 means none."""
        return 0

    @property
    def to(self) -> int:
        """First of the next modes of the sides."""
        return self.guards

    @property
    def held(self) -> int:
        """First of the states held in the next modes; -1 means none."""
        return 3 * self.guards


class SampleLayout(NamedTuple):
    """Columns of a sample of one connected piece."""

    controllers: int
    axes: int
    drives: int
    inputs: int
    observing: int

    def read(self, controller: int) -> int:
        """Return the column of a controller's encoder reading, counts."""
        return 2 * controller

    def volts(self, controller: int) -> int:
        """Return the column of a controller's output, V."""
        return 2 * controller + 1

    def load(self, axis: int) -> int:
        """Return the column of an axis' load, m or rad from its start."""
        return 2 * (self.controllers + axis)

    def frame(self, axis: int) -> int:
        """Return the column of an axis' frame, m or rad."""
        return self.load(axis) + 1

    def current(self, drive: int) -> int:
        """Return the column of a drive's current, A."""
        return 2 * (self.controllers + self.axes + drive)

    def peak(self, drive: int) -> int:
        """Return the column of the current of largest magnitude since the last sample, A."""
        return self.current(drive) + 1

    def tripped(self, switch: int) -> int:
        """Return the column of a limit switch, 1 after it has cut its drive."""
        return 2 * (self.controllers + self.axes + self.drives) + switch

    def rate(self, axis: int) -> int:
        """Return the column of the velocity of an axis' load, m/s or rad/s."""
        return self.tripped(self.inputs) + axis

    def observed(self, sensor: int) -> int:
        """Return the column of the reading of an observing sensor, in its unit."""
        return self.rate(self.axes) + sensor

    @property
    def columns(self) -> int:
        """Number of columns."""
        return self.observed(self.observing)
