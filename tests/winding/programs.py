"""Part programs for the vessel of the examples, and the same programs with one fault each.

The eye is always 40 mm ahead on the tangent of a geodesic of the drawn meridian. The circuit ends
at its start, 63/44 of a turn further on, so that 44 circuits close the pattern.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from threadline.base.arrays import FloatArray
from threadline.winding.surface import Surface

FREE_M = 0.04
TURN_M = 0.032
"""Radius at which the fibre turns back."""
AT_M = 0.1
"""Machine place of the left end of the mandrel."""
CIRCUITS = 44
TOO_FEW = 40
"""Circuits of the program that leaves gaps."""
TURNS = 63
"""Forty-fourths of a turn in a circuit."""


def geodesic(surface: Surface, turn_m: float = TURN_M) -> tuple[FloatArray, FloatArray]:
    """Return lengths, (n,), and (n, 3) u, angle and winding angle of a circuit's geodesic.

    It begins at its turn at the left pole, and ends there.
    """

    def rates(_: float, y: FloatArray) -> list[float]:
        r = surface.at(np.array([min(max(y[0], 0.0), surface.length_m)]))[1][0]
        return [math.cos(y[2]), math.sin(y[2]) / r[0], -r[1] / r[0] * math.sin(y[2])]

    def turned(_: float, y: FloatArray) -> float:
        return float(y[2] - 0.5 * math.pi)

    turned.direction, turned.terminal = -1.0, 2  # type: ignore[attr-defined]
    first = brentq(
        lambda u: float(surface.at(np.array([u]))[1][0, 0]) - turn_m,
        0.0, 0.25 * surface.length_m, xtol=1e-13,
    )  # fmt: skip
    start = [first, 0.0, 0.5 * math.pi + 1e-9]
    found = solve_ivp(
        rates, (0.0, 5.0), start, rtol=1e-10, atol=1e-12, max_step=1e-3, events=turned,
        dense_output=True,
    )  # fmt: skip
    end = float(found.t_events[0][-1])
    length = np.linspace(0.0, end, math.ceil(end / 2e-3) + 1)
    return length, np.asarray(found.sol(length).T)


def circuit_turn(surface: Surface) -> float:
    """Return the angle of a circuit, rad."""
    return float(geodesic(surface)[1][-1, 1])


def eyes(surface: Surface, path: FloatArray, free_m: float = FREE_M) -> FloatArray:
    """Return (n, 3) turn, rad, and places along and across of the eye, m, ahead on a path."""
    x, r = surface.at(path[:, 0])
    cos, sin = np.cos(path[:, 2]), np.sin(path[:, 2])
    out = r[:, 0] + free_m * cos * r[:, 1]
    across = np.hypot(out, free_m * sin)
    # The fibre goes round against the turn, so that the mandrel turns forwards.
    turn = path[:, 1] + np.unwrap(np.arctan2(free_m * sin, out))
    return np.column_stack([turn, AT_M + x[:, 0] + free_m * cos * x[:, 1], across])


def steps(positions: FloatArray) -> FloatArray:
    """Return (n, 3) steps in deg and mm, rounded so that they do not drift."""
    shown = np.round(positions * np.array([math.degrees(1.0), 1e3, 1e3]), 3)
    return np.diff(shown, axis=0)


def program(
    positions: FloatArray, circuits: int, rows: FloatArray | None = None, pieces: int = 1
) -> str:
    """Return the part program: to the start, then a circuit as a subroutine.

    Parameters
    ----------
    positions
        (n, 3) eye of a circuit.
    rows
        (m, 3) steps of a last circuit that is written out in the main program.
    pieces
        Number of blocks of each move to the start.
    """
    first = np.round(positions[0] * np.array([0.0, 1e3, 1e3]), 3)
    lines = ["%", "O 999"]
    lines += [block(10 * k, row) for k, row in enumerate(steps(positions), start=1)]
    lines += ["M99;", "O 998;", "G01 F 1200;", "G91;"]
    for axis, way in ("Y", first[2]), ("X", first[1]):
        ends = np.round(np.linspace(0.0, way, pieces + 1), 3)
        lines += [f"{axis} {step:.3f};" for step in np.diff(ends)]
    # A spline that does not stop here would round the corner between approach and circuit.
    lines += ["M00;"] * (pieces > 1) + [f"M98 P 999 L {circuits};"]
    lines += [block(10 * k, row) for k, row in enumerate(() if rows is None else rows, start=1)]
    return "\n".join([*lines, "M30;", "%", ""])


def block(number: int, row: FloatArray) -> str:
    words = [f"{axis} {value:.3f}" for axis, value in zip("AXY", row, strict=True) if value]
    return f"N {number} {' '.join(words)};"


def slipping(positions: FloatArray) -> FloatArray:
    """Return the steps of a circuit with 3 degrees too much in one block on the cylinder."""
    rows = steps(positions)
    rows[FAULTY, 0] += 3.0
    return rows


def lifting(positions: FloatArray) -> FloatArray:
    """Return the steps of a circuit whose mandrel turns back by 8 degrees in one block."""
    rows = steps(positions)
    rows[FAULTY] = -8.0, 0.0, 0.0
    return rows


PIECES = 60
"""Blocks of each move to the start of the program of one circuit: a spline times all alike."""
FAULTY = 60
"""Block of the faulty programs, from 0: on the cylinder."""
