"""From words of the command line to how the cylinders are shaped."""

from __future__ import annotations

from threadline.errors import OptionError, UnitError
from threadline.machine import Machine
from threadline.plant.pneumatic import flow_mode
from threadline.shaping import FlexibleMode, ShaperKind, convolve, design
from threadline.signals.files.common import nearest
from threadline.targets.schedule_moves import AxisShaping
from threadline.units import parse_quantity

UNSHAPED_WORD = "none"


def shaping_of(
    machine: Machine,
    shaper: str,
    *,
    mode: str | None = None,
    damping_ratio: float | None = None,
) -> dict[str, AxisShaping]:
    """Return the shaping of every cylinder.

    Parameters
    ----------
    shaper
        Kinds joined by ``*``, which convolve: ``"zv*um-2ei"``; ``"none"`` for unshaped moves.
    mode, damping_ratio
        Undamped frequency, like ``"3.04 Hz"``, and damping ratio that the shapers are made for;
        where one is None, it is that of the slowest mode under each cylinder with its air.

    Raises
    ------
    OptionError
        If a word is unknown.
    """
    if shaper == UNSHAPED_WORD:
        return {}
    kinds = [word.strip() for word in shaper.split("*")]
    for kind in kinds:
        if kind not in set(ShaperKind):
            known = (UNSHAPED_WORD, *ShaperKind)
            raise OptionError(
                f"unknown shaper {kind[:40]!r}", remedy=nearest(kind, tuple(map(str, known)))
            )
    found: dict[FlexibleMode, AxisShaping] = {}
    shaping = {}
    for axis in machine.cylinders:
        own_hz, own_damping = flow_mode(machine, axis)
        frequency = own_hz if mode is None else _frequency(mode)
        used = FlexibleMode(frequency, own_damping if damping_ratio is None else damping_ratio)
        if used not in found:
            made = [design(kind, used) for kind in kinds]
            train = made[0] if len(made) == 1 else convolve(*made)
            found[used] = AxisShaping(shaper=train, mode=used)
        shaping[axis] = found[used]
    return shaping


def _frequency(text: str) -> float:
    try:
        return parse_quantity(text, "Hz")
    except UnitError as error:
        raise OptionError(
            f"mode {text!r}: {error.message}", remedy='Write it like "3.04 Hz".'
        ) from error
