"""What the numbers of the engine are called: rows, slots, counters, actions and readings.

Machine code and Python agree on these names and on nothing else: where a name lies is worked out by
``Layout`` (rows of the workspace, for one shape of machine) or is the value of the member itself.
"""

from __future__ import annotations

from enum import IntEnum, auto
from typing import NamedTuple

from threadline.twin.timeline import ARRIVE, CONTROL, TICK


class Field(IntEnum):
    """What a row of the workspace holds; most fields have a row for each of something.

    The comments say for what, and in which unit.
    """

    COLUMN = auto()  # states, then the inputs of drives
    OLD = auto()  # states before the advance under way
    # Of a controller, in counts and levels, one and two of its ticks ago.
    ERROR_1 = auto()
    ERROR_2 = auto()
    OUTPUT_1 = auto()
    OUTPUT_2 = auto()
    LEVEL = auto()  # of its DAC
    HELD = auto()  # level that has arrived after the dead time
    # Of a controller that makes its own profile, in counts and counts per tick.
    POSITION = auto()
    SPEED = auto()
    GOAL = auto()  # speed or target that it goes to
    SEEN = auto()  # last reference
    # Of an axis, m or rad.
    WORST = auto()  # largest |commanded - load|
    LOWEST = auto()  # load, within the window
    HIGHEST = auto()
    LAST = auto()
    SCALE = auto()  # m or rad per count
    PEAK = auto()  # of a drive's current, since the last sample, A
    TRIPPED = auto()  # of a limit switch: 1 once it has cut its drive
    MODE = auto()  # number of the mode in force
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
    PER_TICK = auto()  # ticks of the references in one of the filter
    SENSOR = auto()  # row: counts read
    LOAD = auto()  # row of an axis
    FRAME = auto()  # row of an axis
    # Of a mode.
    LOW = auto()  # bounds of a guard
    HIGH = auto()
    GUARD = auto()  # row
    CURRENT = auto()  # row of a drive
    MATRIX = auto()  # row of a state's derivative
    # Of a mode and of one length of advance.
    STEP = auto()  # row of a state's propagator
    THIRD = auto()  # row of a guard: a third of what its rate makes in an advance
    NEAR_LOW = auto()  # bounds of the cheap first look at a guard
    NEAR_HIGH = auto()
    MIDDLE = auto()  # rows of that look
    SPREAD = auto()


Row = tuple[Field, *tuple[int, ...]]
"""A row of the workspace, ``width`` numbers, one for each lane: its field, of which thing, and of
which column where the field is itself a row, as in ``rows[Field.SENSOR, controller, column]``.
"""

OF_LENGTH = frozenset(
    (Field.STEP, Field.THIRD, Field.NEAR_LOW, Field.NEAR_HIGH, Field.MIDDLE, Field.SPREAD)
)
"""Fields of which every length of advance has rows of its own."""

CHANGING = (
    Field.ERROR_1, Field.ERROR_2, Field.OUTPUT_1, Field.OUTPUT_2, Field.LEVEL, Field.HELD,
    Field.POSITION, Field.SPEED, Field.GOAL, Field.SEEN,
)  # fmt: skip
"""Rows of a controller that change."""
NUMBERS = (
    Field.B0, Field.B1, Field.B2, Field.A1, Field.A2, Field.LEVEL_LOW, Field.LEVEL_HIGH, Field.VOLT,
    Field.GAIN, Field.LIMIT, Field.PHASE, Field.ACCELERATION, Field.FASTEST, Field.PER_TICK,
)  # fmt: skip
"""Rows of a controller that do not."""
AXIS_CHANGING = (Field.WORST, Field.LOWEST, Field.HIGHEST, Field.LAST)
"""Rows of an axis that change."""


class Slot(IntEnum):
    """What machine code is given: an array of integers, addresses and counts of what lies there."""

    WORK = 0  # (groups, rows, width) the workspace
    CLOCK = 1  # (blocks, entries) see ``ClockEntry``
    COUNTS = 2  # (blocks, 4) see ``Count``
    TABLES = 3  # (modes,) addresses
    PLANS = 4  # (modes,) addresses, see ``PlanLayout``
    CELLS = 5  # (lengths,) cells of each advance
    CELL_S = 6  # (lengths,) how long they are
    MEET = 7  # address of the function that fills the tables of a mode
    KINDS = 8  # (steps,) kind of each step of the hyperperiod
    LENGTHS = 9  # (steps,) length of the advance of each
    STEPS = 10
    REFERENCES = 11  # (rows, controllers) counts
    ROWS = 12
    EVERY = 13  # ticks from sample to sample, 0 for none
    WINDOW = 14  # first tick of which the least and the greatest load are kept
    RECORDS = 15  # (columns, 2) where samples go: address, or 0; numbers from sample to sample
    RING = 16  # (blocks, controllers, length, lanes) levels in the dead times
    RING_LENGTH = 17


class ClockEntry(IntEnum):
    """Entries of a block's clock; from ``HEADS`` on two for each controller."""

    STEP = 0  # of the hyperperiod
    UNTIL_SAMPLE = 1  # ticks
    NOW = 2  # tick
    HEADS = 3  # places in a controller's dead time: written, read


class Count(IntEnum):
    """What is counted in a block."""

    EVENTS = 0  # changes of modes
    SLOW = 1  # advances in which a mode changed or might have
    ENDLESS = 2  # changes without end
    UNMET = 3  # modes without a table


class Exit(IntEnum):
    """What the search for a guard's first exit is given and what it answers."""

    LOW = 0
    HIGH = 1
    UNTIL = 2  # end of the cell; the exit, where there is one
    SIDE = 3  # +1 above, -1 below, 0 where the guard stays within its bounds


class Do(IntEnum):
    """What a step does."""

    TICK = TICK  # loads, sample, the next row
    CONTROL = CONTROL  # a controller acts
    ARRIVE = ARRIVE  # its level arrives
    ADVANCE = 3  # to the next instant


class Action(NamedTuple):
    """One thing that a step does."""

    do: Do
    controller: int = 0


class PlanLayout(NamedTuple):
    """The integers that tell what a change of modes does, for a number of guards.

    ``which`` counts sides of guards: two for each, below before above. All methods add only, so
    that they serve integers and values of machine code alike.
    """

    guards: int

    @property
    def size(self) -> int:
        """Integers of a plan."""
        return 5 * self.guards

    @property
    def switch(self) -> int:
        """Where the limit switches of the guards begin; -1 for none."""
        return 0

    @property
    def to(self) -> int:
        """Where the next modes of the sides begin."""
        return self.guards

    @property
    def held(self) -> int:
        """Where the states begin that are held from then on; -1 for none."""
        return 3 * self.guards


class SampleLayout(NamedTuple):
    """Columns of a sample of one connected piece."""

    controllers: int
    axes: int
    drives: int
    inputs: int

    def read(self, controller: int) -> int:
        """Return the column of what a controller's encoder reads, counts."""
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
        """Return the column of a limit switch, 1 once it has cut its drive."""
        return 2 * (self.controllers + self.axes + self.drives) + switch

    @property
    def columns(self) -> int:
        """Return their number."""
        return self.tripped(self.inputs)
