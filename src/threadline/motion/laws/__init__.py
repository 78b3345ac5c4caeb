"""Motion laws: normalised moves from rest to rest."""

from threadline.motion.laws.catalogue import (
    FAMILIES,
    LAWS,
    harmonic,
    jerk_limited,
    law,
    modified_constant_velocity,
    trapezoid,
    trapezoidal_acceleration,
)
from threadline.motion.laws.extremes import extremes, refuse_descent
from threadline.motion.laws.law import Form, Law, Pieces, gauss, measured_law
from threadline.motion.laws.law_table import law_of_velocity, law_through, read_law, write_law
from threadline.motion.laws.shortest import ShortestMove, shortest_move

__all__ = [
    "FAMILIES", "LAWS", "Form", "Law", "Pieces", "ShortestMove", "extremes", "gauss", "harmonic",
    "jerk_limited", "law", "law_of_velocity", "law_through", "measured_law",
    "modified_constant_velocity", "read_law", "refuse_descent", "shortest_move", "trapezoid",
    "trapezoidal_acceleration", "write_law",
]  # fmt: skip
