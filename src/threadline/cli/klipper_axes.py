"""``threadline shaper --klipper`` with two modes: X and Y of a printer, a shaper for each."""

from __future__ import annotations

from collections.abc import Sequence

from threadline.cli.output import print_json, say, say_lines
from threadline.cli.shaper_text import Asked, designed, suspicions
from threadline.cli.told import warning
from threadline.errors import OptionError
from threadline.shaping import FlexibleMode
from threadline.shaping.klipper import klipper_export

_HEADER = "[input_shaper]\n"


DEFAULT_DAMPING = 0.1
"""Klipper's default damping ratio: no warning is given where a mode repeats it."""


def doubted(modes: Sequence[FlexibleMode]) -> list[str]:
    """Return warnings of suspicious damping ratios; Klipper's default is none."""
    own = [mode for mode in modes if mode.damping_ratio != DEFAULT_DAMPING]
    return list(suspicions(tuple(own)))


def shape_two_axes(
    kind: str,
    asked: Sequence[Asked],
    tolerances: Sequence[float],
    bands: Sequence[float],
    others: Sequence[object],
    json: bool,
) -> None:
    """Print one section of Klipper's for both axes: the first mode is of X, the second of Y.

    Parameters
    ----------
    others
        Values of the options that need one train of impulses; each must be None.

    Raises
    ------
    OptionError
        If there are more than two modes, or one of ``others`` is given.
    """
    if len(asked) > 2:
        raise OptionError(
            f"Klipper shapes one mode per axis, {len(asked)} are given",
            remedy="Give one --mode for both axes, or two: of X, then of Y.",
        )
    if any(other is not None for other in others):
        raise OptionError(
            "--klipper with a mode for X and one for Y gives two trains, and --tick, --move and "
            "--report take one",
            remedy="Leave them out, or give one --mode.",
        )
    lines, found = _HEADER, {}
    for axis, one, tolerance, band in zip("xy", asked, tolerances, bands, strict=True):
        made = designed(kind, (one.mode,), (tolerance,), (band,))
        export = klipper_export(made, one.mode, axes=axis)
        found[axis] = export
        lines += export.section.removeprefix(_HEADER)
    whole = lines if all(export.section for export in found.values()) else ""
    if json:
        notes = {axis: export.explanation for axis, export in found.items()}
        print_json({"klipper": whole or None, "klipper_note": notes})
        return
    for said in doubted([one.mode for one in asked]):
        warning(said)
    for axis, export in found.items():
        say(f"{axis.upper()}: {export.explanation}")
    if whole:
        say_lines(whole)
