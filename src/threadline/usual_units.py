"""Units that files and options are mostly written in, as factors that need no unit registry.

To load one and to teach it its units takes a quarter of a second, more than all else that a command
does with numbers and their units. Every factor is the registry's own, to the bit (``tests`` compare
them); units that are not here are asked of the registry.
"""

from __future__ import annotations

_PER_REVOLUTION = 0.15915494309189535
_DEGREE = 0.017453292519943295

_OF_KIND: dict[str, dict[str, float]] = {
    "": {"%": 0.01},
    "m": {"mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "m/s": {"mm/s": 1e-3, "mm/min": 1.6666666666666667e-05, "in/s": 0.0254},
    "m/s^2": {"mm/s^2": 1e-3, "in/s^2": 0.0254},
    "m/s^3": {"mm/s^3": 1e-3, "in/s^3": 0.0254},
    "rad": {"deg": _DEGREE},
    "rad/s": {"deg/s": _DEGREE},
    "rad/s^2": {"deg/s^2": _DEGREE},
    "rad/s^3": {"deg/s^3": _DEGREE},
    "s": {"ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "Hz": {"kHz": 1e3},
    "kg": {"g": 1e-3},
    "kg*m^2": {"kg m^2": 1.0},
    "N": {"kN": 1e3},
    "N/m": {"kN/m": 1e3, "MN/m": 1e6},
    "N*s/m": {"N s/m": 1.0},
    "N*m": {"N m": 1.0},
    "N*m*s/rad": {"N m s/rad": 1.0},
    "N*m/A": {"N m/A": 1.0},
    "V": {},
    "V/m": {},
    "V*s/rad": {"V/krpm": 0.00954929658551372},
    "A": {"mA": 1e-3},
    "A/V": {},
    "ohm": {},
    "H": {"mH": 1e-3},
    "m/rad": {"mm/rad": 1e-3},
    "bit": {},
    "tick": {},
    "count/m": {"count/mm": 1e3},
    "count/rad": {"count/rev": _PER_REVOLUTION, "count/deg": 57.29577951308232},
    "count/tick": {},
    "dac/count": {},
    "stitch/s": {"stitch/min": 0.016666666666666666},
}
"""What one of each unit is in the unit of SI that the program computes in."""

_USUAL = {
    unit: (kind, factor)
    for kind, units in _OF_KIND.items()
    for unit, factor in (units | ({kind: 1.0} if kind else {})).items()
}


def usual_factor(unit: str, target: str) -> float | None:
    """Return what one ``unit`` is in ``target``: 0 where they are of two kinds, None if not known.

    >>> usual_factor("mm", "m"), usual_factor("mm", "rad"), usual_factor("furlong", "m")
    (0.001, 0.0, None)
    """
    known = _USUAL.get(unit)
    if known is None or target not in _OF_KIND:
        return None
    kind, factor = known
    return factor if kind == target else 0.0
