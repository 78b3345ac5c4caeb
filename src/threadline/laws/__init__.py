"""Motion laws: normalised moves from rest to rest."""

from threadline.laws.catalogue import LAWS, Law, law, trapezoid, trapezoidal_acceleration

__all__ = ["LAWS", "Law", "law", "trapezoid", "trapezoidal_acceleration"]
