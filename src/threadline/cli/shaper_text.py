"""What ``threadline shaper`` reads from its options, and the curve that it draws in text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from threadline.errors import OptionError
from threadline.report.document import Table
from threadline.shaping import (
    FlexibleMode,
    Realised,
    Requirement,
    Shaper,
    ShaperKind,
    check_apart,
    convolve,
    design,
    direct_shaper,
    direct_unit_magnitude,
    parse_mode_hz,
    residual_vibration,
    specified_insensitivity,
)
from threadline.units import without_noise

KINDS = (*ShaperKind, "si", "direct", "um-direct")
SUSPICIOUS_DAMPING = 0.1
"""Frames, belts and beams have damping ratios of some hundredths."""

_ROWS, _COLUMNS = 12, 61
_SPAN = 0.5


def modes_of(
    frequencies: Sequence[str], damping: Sequence[float] | None
) -> tuple[FlexibleMode, ...]:
    """Return the modes that the options name.

    Raises
    ------
    OptionError
        If a frequency cannot be read, or there are neither one nor as many damping ratios.
    """
    ratios = list(damping or [0.0])
    if len(ratios) == 1:
        ratios *= len(frequencies)
    if len(ratios) != len(frequencies):
        raise OptionError(
            f"{len(frequencies)} modes have {len(ratios)} damping ratios",
            remedy="Give --damping once, or once for each --mode.",
        )
    return tuple(
        FlexibleMode(parse_mode_hz(f), zeta) for f, zeta in zip(frequencies, ratios, strict=True)
    )


def designed(kind: str, modes: Sequence[FlexibleMode], tolerance: float, band: float) -> Shaper:
    """Return the shaper: ``si``, ``direct``, ``um-direct`` for all modes at once, others convolved.

    Raises
    ------
    OptionError, ShaperError
        If no such shaper can be designed.
    """
    check_apart(modes)
    if kind == "si":
        if band <= 0.0:
            raise OptionError("--kind si needs the band of frequency", remedy="Add --band 0.2.")
        if len(modes) == 1:
            return specified_insensitivity(modes[0], band, tolerance)
        return direct_shaper([Requirement(m, tolerance, band) for m in modes], name="si")
    if kind == "direct":
        return direct_shaper([Requirement(m) for m in modes])
    if kind == "um-direct":
        return direct_unit_magnitude([Requirement(m) for m in modes])
    kinds = [part.strip() for part in kind.split("*")]
    for one in kinds:
        if one not in list(ShaperKind):
            whole = "" if len(kinds) == 1 else f" in {kind!r}"
            alone = " It cannot be convolved." if one in KINDS else ""
            raise OptionError(
                f"shaper kind {one!r}{whole} is unknown"
                if not alone
                else f"shaper kind {one!r}{whole} is made for all modes at once and stands alone",
                remedy=f"Kinds: {', '.join(ShaperKind if alone else KINDS)}.",
            )
    return convolve(*(design(one, m, tolerance=tolerance) for m in modes for one in kinds))


def price_table(made: Realised, tolerance: float) -> Table:
    """Return what the ticks of a controller cost over the band of every mode."""
    rows = []
    for over in made.bands:
        for name, worst, width in (
            ("as designed", over.designed, over.designed_width),
            ("times to the nearest ticks", over.nearest, over.nearest_width),
            ("on these ticks", over.made, over.made_width),
        ):
            band = f"{over.low_hz:.4g} to {over.high_hz:.4g}"
            rows.append([band, name, f"{without_noise(worst) * 100:.3g} %", f"{width:.4f}"])
    return Table(
        title="Price of the controller over the band",
        header=("Hz", "train", "vibration at worst", f"insensitivity at {tolerance * 100:g} %"),
        rows=rows,
        note="The ticks are chosen for the least vibration over the band.",
    )


def price_content(made: Realised) -> list[dict[str, float]]:
    """Return the same for ``--json``."""
    return [
        {
            "frequency_hz": over.mode.frequency_hz,
            "low_hz": over.low_hz,
            "high_hz": over.high_hz,
            "designed_worst": over.designed,
            "nearest_worst": over.nearest,
            "worst": over.made,
            "designed_insensitivity": over.designed_width,
            "nearest_insensitivity": over.nearest_width,
            "insensitivity": over.made_width,
        }
        for over in made.bands
    ]


def suspicions(modes: Sequence[FlexibleMode]) -> Iterator[str]:
    """Yield a warning for every damping ratio that looks like something else."""
    for m in modes:
        if m.damping_ratio < SUSPICIOUS_DAMPING:
            continue
        omega = 2.0 * np.pi * m.frequency_hz
        right = FlexibleMode(m.frequency_hz, m.damping_ratio / omega)
        left = residual_vibration(design("zv", m), m.frequency_hz, right.damping_ratio)
        yield (
            f"a damping ratio of {m.damping_ratio:g} is high for a mode that rings: an eigenvalue "
            f"{-m.damping_ratio:g} +- {omega:.4g}j 1/s has the ratio {right.damping_ratio:.4f}, "
            f"its real part divided by its modulus; if that is meant, a ZV for "
            f"{m.damping_ratio:g} leaves {float(left) * 100:.1f} %"
        )


def curve_lines(shaper: Shaper, modes: Sequence[FlexibleMode], tolerance: float) -> Iterator[str]:
    """Yield the sensitivity curve of every mode as text, ``-`` being the tolerance."""
    for m in modes:
        ratio = np.linspace(1.0 - _SPAN, 1.0 + _SPAN, _COLUMNS)
        v = residual_vibration(shaper, ratio * m.frequency_hz, m.damping_ratio)
        top = max(float(v.max()), 2.0 * tolerance)
        rows = np.rint(v / top * (_ROWS - 1)).astype(np.int64)
        limit = round(tolerance / top * (_ROWS - 1))
        yield f"Vibration over frequency, damping ratio {m.damping_ratio:g}"
        for row in range(_ROWS - 1, -1, -1):
            line = "".join("*" if r == row else "-" if row == limit else " " for r in rows)
            label = f"{row / (_ROWS - 1) * top * 100:6.1f} %"
            yield f"{label} |{line}"
        left, right = f"{ratio[0] * m.frequency_hz:.4g}", f"{ratio[-1] * m.frequency_hz:.4g} Hz"
        middle = f"{m.frequency_hz:.4g}"
        ends = f"{left}{middle:^{_COLUMNS - len(left) - len(right)}}{right}"
        yield f"          {ends}"
