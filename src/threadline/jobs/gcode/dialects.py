"""Dialects of part programs: the words of each control, and its parameters where it has any.

Two controls read parameters and expressions, LinuxCNC and FluidNC; ``Flavour`` holds their
differences. Sources: LinuxCNC 2.9, Overview of G code programming (parameters, expressions,
functions) and O codes, with its interpreter as an oracle (2.9; in its source of August 2026 the
tolerance of EQ is 1e-6); FluidNC 4, Expression.cpp, Parameters.cpp and Flowcontrol.cpp.

A word moves axes, sets a mode, or has no effect on motion; a warning names each word without
effect once. Words that change motion in a way that is not modelled (tool lengths, cutter radii,
canned cycles, limits set by the program) are in no table and are refused; ``refused_words``
explains some.

Sources of the words: ``linuxcnc``: LinuxCNC 2.9, G Codes and M Codes; ``grbl``: grbl 1.1 wiki and
gcode.c; ``fluidnc``: the grbl sources and FluidNC's wiki; ``marlin``: Marlin 2.1,
marlinfw.org/meta/gcode; ``klipper``: its ``gcode.py``, ``gcode_move.py`` and ``gcode_arcs.py``;
``reprapfirmware``: RepRapFirmware 3.5, ``StringParser.cpp``, ``GCodes.cpp``, ``GCodes2.cpp``;
``fanuc``: B-63174EN; ``winder``: the printed winder's program with the words that
``docs/part-programs.md`` lists.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from threadline.jobs.gcode import grammar
from threadline.jobs.gcode.grammar import Grammar
from threadline.machine import Machine
from threadline.machine.motion_planner import DialectName, FeedRule

_HALF_TURN = np.longdouble("3.14159265358979323846264338327950288") / np.longdouble(180)


def double(value: float) -> float:
    """Return a number as LinuxCNC stores it, in double precision."""
    return value


def single(value: float) -> float:
    """Return a number as FluidNC stores it, in single precision.

    >>> single(0.1), single(0.5), single(1e300)
    (0.10000000149011612, 0.5, inf)
    """
    try:
        return float(struct.unpack("f", struct.pack("f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)


def radians(degrees: float) -> np.longdouble:
    """Return an angle in rad, in extended precision, in which LinuxCNC's sine of 30 is 0.5."""
    return np.longdouble(degrees) * _HALF_TURN


def in_degrees(angle: float) -> float:
    """Return an angle in degrees; ``angle`` is in rad."""
    return float(np.longdouble(angle) / _HALF_TURN)


@dataclass(frozen=True, slots=True, kw_only=True)
class Flavour:
    """How a control reads parameters, expressions and O words.

    Parameters
    ----------
    rounded
        Function that rounds a number to the precision of the control.
    alike
        Tolerance of EQ and NE: numbers that differ by less are equal.
    alike_later
        Tolerance in later versions, which apply it to LE and GE, too; None if versions do not
        differ.
    unset
        Value of a numbered parameter that was never set; None if reading it is an error.
    readable
        Lowest numbered parameter that a program can read.
    subroutines
        Whether O words define and call subroutines, and may be names.
    labels_once
        Whether a label names only one block (in each subroutine).
    breaks_repeats
        Whether break and continue work in repeat, too.
    loose_comments
        Whether a semicolon inside parentheses ends the line, a ) without ( is ignored, and an
        open comment ends with its line.
    at_motors
        Whether a program reads the position of the motors at the time when its line is parsed,
        instead of the programmed position.
    paths_configure
        Whether a name that begins with a slash names an item of the control's configuration.
    queries
        Lines that ask the control for a report and do nothing else.
    """

    rounded: Callable[[float], float]
    alike: float
    alike_later: float | None
    unset: float | None
    readable: int
    subroutines: bool
    labels_once: bool
    breaks_repeats: bool
    loose_comments: bool
    at_motors: bool
    paths_configure: bool
    queries: frozenset[str] = frozenset()


LINUXCNC = Flavour(
    rounded=double, alike=1e-4, alike_later=1e-6, unset=0.0, readable=1, subroutines=True,
    labels_once=True, breaks_repeats=False, loose_comments=False, at_motors=False,
    paths_configure=False,
)  # fmt: skip
FLUIDNC = Flavour(
    rounded=single, alike=1e-5, alike_later=None, unset=None, readable=31, subroutines=False,
    labels_once=False, breaks_repeats=True, loose_comments=True, at_motors=True,
    paths_configure=True, queries=grammar.QUERIES,
)  # fmt: skip


Group = str
CANCEL = 80
"""Number of the motion mode after G80: no motion."""
MMode = Literal["stop", "end", "call", "return", "on", "off", "rest", "wait", "idle"]

_MOTION = {0: "motion", 10: "motion"}
_MODES = {
    200: "units", 210: "units", 900: "distance", 910: "distance", 940: "feed", 640: "blending",
}  # fmt: skip
_ARCS = {20: "motion", 30: "motion", 170: "plane", 180: "plane", 190: "plane", 911: "centres"}
_OFFSETS = {920: "action", 921: "action"}
_WINDER = {**_MOTION, **_MODES, 40: "action", 280: "action", 930: "feed"}
_CNC = {
    **_WINDER, **_ARCS, **_OFFSETS, 281: "action", 800: "motion", 610: "blending",
    400: "cutter", 490: "length", 540: "system",
}  # fmt: skip
_SYSTEMS = {**{code: "system" for code in range(540, 600, 10)}, 530: "machine"}
_OUTPUTS: dict[int, MMode] = dict.fromkeys((62, 63, 64, 65), "idle")
_PROGRAM: dict[int, MMode] = {0: "stop", 2: "end", 30: "end", 5: "off"}
_CALLS: dict[int, MMode] = {98: "call", 99: "return"}
_CNC_M: dict[int, MMode] = {
    **_PROGRAM, 1: "stop", 3: "on", 4: "on", 6: "stop", 7: "idle", 8: "idle", 9: "idle",
}  # fmt: skip
_MARLIN_IDLE = (
    16, 17, 18, 31, 42, 73, 75, 76, 77, 78, 80, 81, 82, 83, 84, 85, 104, 105, 106, 107, 108, 110,
    111, 113, 114, 115, 117, 118, 119, 120, 121, 140, 141, 150, 154, 155, 200, 221, 250, 256, 280,
    300,
    301, 302, 304, 355, 486, 500, 503, 900,
)  # fmt: skip
_MARLIN_M: dict[int, MMode] = {
    **dict.fromkeys(_MARLIN_IDLE, "idle"), 0: "stop", 1: "stop", 3: "on", 4: "on", 5: "off",
    7: "idle", 8: "idle", 9: "idle", 400: "rest", 109: "wait", 190: "wait",
    30: "idle",  # it deletes a file on the card and does not end the program
    2: "idle",  # as many posts write it: Marlin has no such command, says so and goes on
}  # fmt: skip

_REPRAP_NO_M = (7, 8, 9, 2, 16, 31, 75, 76, 77, 78, 113, 120, 121, 154, 155, 250, 256, 355, 900)
# M0, M1 and M2 end the job of a file, and M226, M600 and M601 pause it (GCodes2.cpp).
_REPRAP_M: dict[int, MMode] = {
    **{code: mode for code, mode in _MARLIN_M.items() if code not in _REPRAP_NO_M},
    **dict.fromkeys((0, 1, 2), "end"), **dict.fromkeys((226, 600, 601), "stop"),
    116: "wait", 191: "wait", **dict.fromkeys((144, 207, 568, 572), "idle"),
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """The words of a part program as one kind of control reads them.

    Parameters
    ----------
    name
        Name of the dialect.
    feed_rule
        Rule for the meaning of F, unless the machine file or an option gives another.
    g
        Modal group of each G word, by ten times its number: ``{281: "action"}`` is G28.1. A block
        has at most one word of each group.
    m
        Effect of each M word.
    idle_letters
        Letters of the words for spindle and tool magazine, which have no effect on motion. With
        ``one_command`` T is a command, and T0 is the only tool.
    streams
        Whether the lines after M2 or M30 run, too: in grbl only the sender ends the file.
    needs_end
        Whether a program must end with M2, M30 or M99.
    rapid_is_feed
        Whether G0 moves at the feed, as G1 does.
    each_g
        Whether every block with axis words needs a G word.
    homes
        Whether G28 homes the axes that it names; otherwise G28 moves them through a point.
    home_beside
        Whether G28 may stand beside G0 or G1: it takes the axis words, and they set the mode.
    dwell_s
        Unit in s of each dwell letter of G4, for a whole number and for a number with a point.
    points
        Whether axis words need a decimal point, because the control reads a number without a
        point in least increments.
    one_command
        Whether a block has one command: the words after an M word belong to the M word, and a
        checksum may follow.
    off_behind
        Whether M5 and M9 beside a move act after the move. RS274/NGC and similar controls switch
        before the move.
    semicolon_ends
        Whether a semicolon ends a block; otherwise all text after it is a comment.
    flavour
        How the control reads parameters, expressions and O words; None if it does not read them.
    grammar
        Blocks that the control's own parser takes.
    first_feed_m_s
        Feed before the first F, m/s; None if a move before it is refused.
    asks_feed
        Remedy in the message of that refusal.
    """

    name: DialectName
    feed_rule: FeedRule
    g: Mapping[int, Group]
    m: Mapping[int, MMode]
    idle_letters: str = ""
    needs_end: bool = True
    streams: bool = False
    rapid_is_feed: bool = False
    each_g: bool = False
    homes: bool = False
    home_beside: bool = False
    dwell_s: Mapping[str, tuple[float, float]] = field(default_factory=lambda: {"P": (1.0, 1.0)})
    points: bool = False
    one_command: bool = False
    off_behind: bool = False
    semicolon_ends: bool = False
    flavour: Flavour | None = None
    grammar: Grammar = grammar.PLAIN
    first_feed_m_s: float | None = None
    asks_feed: str = "Give F, in mm/min."


_GRBL_G = {code: group for code, group in {**_CNC, **_SYSTEMS}.items() if code != 640}
_GRBL = Dialect(
    name="grbl", feed_rule="grbl", g=_GRBL_G,
    m=_CNC_M, idle_letters="ST",
    needs_end=False, streams=True, grammar=grammar.GRBL,
)  # fmt: skip
SILENT = frozenset(
    (30, 31, 73, 75, 76, 77, 78, 92, 105, 110, 111, 113, 114, 115, 117, 118, 119, 154, 155, 201,
     203, 205, 500, 503)
)  # fmt: skip
"""M words that only show, report or store something: a program works the same without them.
M92, M201, M203 and M205 are here for klipper alone, which passes them over.
M30 deletes a file in Marlin, and ends a program elsewhere; in neither case does it drive a tool."""
_MARLIN = Dialect(
    name="marlin",
    feed_rule="marlin",
    # motion.cpp: 1500 mm/min in 1.0 to 2.0, DEFAULT_FEEDRATE_MM_M = 4000 in later releases.
    asks_feed="Give F, in mm/min: without one Marlin takes 1500 or 4000, by its version.",
    g={
        **_MOTION, 20: "motion", 30: "motion", 170: "plane", 210: "units", 900: "distance",
        910: "distance", 920: "action", 929: "action", 940: "feed", 40: "action", 280: "action",
        540: "system", 800: "motion",
    },
    m=_MARLIN_M,
    idle_letters="T",
    needs_end=False,
    rapid_is_feed=True,
    each_g=True,
    homes=True,
    dwell_s={"P": (1e-3, 1e-3), "S": (1.0, 1.0)},
    one_command=True,
    grammar=grammar.MARLIN,
)  # fmt: skip
_REPRAP_G: Mapping[int, str] = {
    **_MOTION, 20: "motion", 30: "motion", 170: "plane", 180: "plane", 190: "plane",
    210: "units", 900: "distance", 910: "distance", 920: "action", 940: "feed",
    40: "action", 280: "action", 540: "system",
}  # fmt: skip
DIALECTS: Mapping[str, Dialect] = {
    "winder": Dialect(
        name="winder",
        feed_rule="fastest-axis",
        g=_WINDER,
        m={**_PROGRAM, **_CALLS},
        off_behind=True,
        semicolon_ends=True,
    ),
    "linuxcnc": Dialect(
        name="linuxcnc",
        feed_rule="linuxcnc",
        g={
            **_CNC, **_SYSTEMS, 50: "motion", 611: "blending", 922: "action", 923: "action",
            970: "speed", 430: "length", 980: "retract", 990: "retract",
            **dict.fromkeys((730, 810, 820, 830, 850, 890), "motion"),
        },
        m={**_CNC_M, **_CALLS, **_OUTPUTS, 48: "idle", 49: "idle"},
        idle_letters="ST",
        flavour=LINUXCNC,
        grammar=grammar.LINUXCNC,
    ),
    "grbl": _GRBL,
    "fluidnc": Dialect(
        name="fluidnc", feed_rule="fluidnc", g=_GRBL_G, m={**_CNC_M, **_OUTPUTS}, idle_letters="ST",
        needs_end=False, flavour=FLUIDNC, grammar=grammar.FLUIDNC,
    ),
    "marlin": _MARLIN,
    "klipper": replace(
        _MARLIN,
        name="klipper",
        g={
            **_MOTION, **_ARCS, 210: "units", 900: "distance", 910: "distance", 920: "action",
            940: "feed", 40: "action", 280: "action", 540: "system", 800: "motion",
        },
        # gcode.py: a word that it does not know has no effect; slicers write these for Marlin.
        m={**_MARLIN_M, **dict.fromkeys((92, 201, 203, 205), "idle")},
        dwell_s={"P": (1e-3, 1e-3)},
        grammar=grammar.KLIPPER,
        first_feed_m_s=0.025,
    ),
    "reprapfirmware": replace(
        _MARLIN,
        name="reprapfirmware",
        g=_REPRAP_G,
        m=_REPRAP_M,
        grammar=grammar.REPRAPFIRMWARE,
        first_feed_m_s=0.05,
    ),
    "reprapfirmware-cnc": replace(
        _MARLIN,
        name="reprapfirmware-cnc",
        g=_REPRAP_G,
        m={**_REPRAP_M, 453: "idle"},
        rapid_is_feed=False,
        grammar=replace(grammar.REPRAPFIRMWARE, repeats=True),
        first_feed_m_s=0.05,
    ),
    "fanuc": Dialect(
        name="fanuc",
        feed_rule="fanuc",
        g={
            **_MOTION, **_MODES, **_ARCS, **_SYSTEMS, 920: "action", 40: "action", 280: "action",
            800: "motion", 610: "blending", 400: "cutter", 490: "length", 540: "system",
            430: "length", 690: "rotation", 930: "feed", 150: "polar", 970: "speed", 980: "return",
            990: "return",
        },
        m={**_CNC_M, **_CALLS},
        idle_letters="ST",
        dwell_s={"P": (1e-3, 1.0), "X": (1.0, 1.0), "U": (1.0, 1.0)},
        points=True,
        off_behind=True,
        semicolon_ends=True,
        home_beside=True,
    ),
}  # fmt: skip
"""Dialects by name; X-Winder programs have other words, and ``xwinder`` reads them."""


@dataclass(frozen=True, slots=True)
class Reading:
    """The context in which a block is read.

    Parameters
    ----------
    file
        Path of the file, for errors.
    machine
        Name of the machine, for errors.
    axes
        Index of each axis by its letter in the program.
    names
        Names of all axes of the machine, in order.
    dialect
        Dialect of the program.
    dropped
        Letters whose words are read and left out.
    wrapped
        Axes whose absolute angles count within one turn, with the direction as their sign.
    lengths
        Exact length of each tool in the machine file, by the words that take it (``G43 H1``).
    """

    file: str
    machine: str
    axes: Mapping[str, int]
    names: tuple[str, ...]
    dialect: Dialect
    dropped: frozenset[str] = frozenset()
    wrapped: frozenset[int] = frozenset()
    lengths: Mapping[str, int] = field(default_factory=dict)


def dialect_of(machine: Machine, name: str | None) -> str:
    """Return the dialect name from the option, or without one from the machine file."""
    return name if name is not None else machine.programs.dialect
