"""What two controls that have parameters do not do alike: LinuxCNC and FluidNC.

Sources: LinuxCNC 2.9, Overview of G code programming (parameters, expressions, functions) and O
codes, with its interpreter as an oracle (2.9; in its source of August 2026 EQ is of 1e-6); FluidNC
4, Expression.cpp, Parameters.cpp and Flowcontrol.cpp.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

_HALF_TURN = np.longdouble("3.14159265358979323846264338327950288") / np.longdouble(180)


def double(value: float) -> float:
    """Return a number as LinuxCNC keeps it."""
    return value


def single(value: float) -> float:
    """Return a number as FluidNC keeps it, in single precision.

    >>> single(0.1), single(0.5), single(1e300)
    (0.10000000149011612, 0.5, inf)
    """
    try:
        return float(struct.unpack("f", struct.pack("f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)


def radians(degrees: float) -> np.longdouble:
    """Return an angle in rad, in extended precision: so that LinuxCNC's sine of 30 is 0.5."""
    return np.longdouble(degrees) * _HALF_TURN


def in_degrees(angle: float) -> float:
    """Return an angle, given in rad, in degrees."""
    return float(np.longdouble(angle) / _HALF_TURN)


@dataclass(frozen=True, slots=True, kw_only=True)
class Flavour:
    """How a control takes parameters, expressions and O words.

    Parameters
    ----------
    rounded
        Rounds each number to the precision of the control.
    alike
        Numbers that differ by less than this are equal (EQ, NE).
    alike_later
        The same in later versions, where LE and GE take such numbers as equal, too; None where
        versions do not differ.
    unset
        What a numbered parameter is that was never set; None where that is an error.
    subroutines
        Whether O words define and call subroutines, and may be names.
    labels_once
        Whether a label names one block only (in each subroutine).
    breaks_repeats
        Whether break and continue leave repeat, too.
    loose_comments
        Whether a semicolon inside parentheses ends the line, a ) without ( is nothing, and a
        comment ends with its line.
    at_motors
        Whether the position that a program reads is where the motors are as the line is read, and
        not where the program will have led them.
    paths_configure
        Whether a name that begins with a slash is an item of the control's configuration.
    """

    rounded: Callable[[float], float]
    alike: float
    alike_later: float | None
    unset: float | None
    subroutines: bool
    labels_once: bool
    breaks_repeats: bool
    loose_comments: bool
    at_motors: bool
    paths_configure: bool


LINUXCNC = Flavour(
    rounded=double, alike=1e-4, alike_later=1e-6, unset=0.0, subroutines=True, labels_once=True,
    breaks_repeats=False, loose_comments=False, at_motors=False, paths_configure=False,
)  # fmt: skip
FLUIDNC = Flavour(
    rounded=single, alike=1e-5, alike_later=None, unset=None, subroutines=False, labels_once=False,
    breaks_repeats=True, loose_comments=True, at_motors=True, paths_configure=True,
)  # fmt: skip
