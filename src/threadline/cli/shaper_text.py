"""Options of ``threadline shaper``, and its sensitivity curve drawn as text."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from threadline.cli.messages import warning
from threadline.cli.output import print_json, say, say_lines
from threadline.errors import OptionError
from threadline.motion.shaping import (
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
    unit_magnitude_over_bands,
    vibration_of,
)
from threadline.motion.shaping.designs import mzv_shape
from threadline.motion.shaping.firmwares import klipper_export
from threadline.motion.shaping.types import MAX_DAMPING_RATIO
from threadline.report.document import Table
from threadline.units import without_noise

BANDED = ("si", "um-si")
"""Kinds that are designed for the bands of all modes at once."""
KINDS = (*ShaperKind, *BANDED, "direct", "um-direct")
SUSPICIOUS_DAMPING = 0.1
"""Damping ratio above which a warning is given: frames, belts and beams have some hundredths."""

_ROWS, _COLUMNS = 12, 61
_SPAN = 0.5
_IN_BAND, _ROUNDED = 201, 1.005


@dataclass(frozen=True, slots=True)
class ModeOption:
    """A mode given by ``--mode``; a part that is None takes the value for all modes.

    Parameters
    ----------
    mode
        Frequency and damping ratio.
    band
        Half width of the band over the mode's frequency, in (0, 1).
    tolerance
        Vibration allowed over the band, as a share of one unit impulse's vibration.
    """

    mode: FlexibleMode
    band: float | None = None
    tolerance: float | None = None


def modes_of(texts: Sequence[str], damping: Sequence[float] | None) -> tuple[ModeOption, ...]:
    """Return the modes in ``texts``, each ``FREQUENCY[:DAMPING[:BAND[:TOLERANCE]]]``.

    Raises
    ------
    OptionError
        If a part cannot be read or is out of range, the number of damping ratios is neither one
        nor the number of modes, or bands overlap.
    """
    ratios = list(damping or [0.0])
    if len(ratios) == 1:
        ratios *= len(texts)
    if len(ratios) != len(texts):
        raise OptionError(
            f"{len(texts)} modes have {len(ratios)} damping ratios",
            remedy="Give --damping once, or once for each --mode.",
        )
    modes = tuple(
        _mode_option(text, ratio, given=damping is not None)
        for text, ratio in zip(texts, ratios, strict=True)
    )
    _refuse_overlaps(modes)
    return modes


def _mode_option(text: str, ratio: float, *, given: bool) -> ModeOption:
    words = [word.strip() for word in text.split(":")]
    if len(words) > 4 or not all(words):
        raise OptionError(
            f"--mode {text[:60]!r} cannot be read",
            remedy='Write "3.04Hz", or "3.04Hz:0.0089:20%:5%": damping ratio, band, tolerance.',
        )
    if len(words) > 1:
        if given:
            raise OptionError(
                f"--mode {text!r} and --damping both give a damping ratio",
                remedy="Leave --damping out.",
            )
        ratio = _share(words[1], "the damping ratio", text)
    return ModeOption(
        FlexibleMode(parse_mode_hz(words[0]), ratio),
        _within(words[2], "the band", text) if len(words) > 2 else None,
        _within(words[3], "the tolerance", text) if len(words) > 3 else None,
    )


def _share(word: str, what: str, text: str) -> float:
    number, percent = word.removesuffix("%").strip(), word.endswith("%")
    try:
        return float(number) / (100.0 if percent else 1.0)
    except ValueError:
        raise OptionError(
            f"--mode {text!r}: {what} {word!r} is not a number",
            remedy='Write it like "20%" or 0.2.',
        ) from None


def _within(word: str, what: str, text: str) -> float:
    value = _share(word, what, text)
    if not 0.0 < value < 1.0:
        raise OptionError(
            f"--mode {text!r}: {what} must be between 0 and 100 %, got {word}",
            remedy='Write it like "20%": that much to either side of the frequency.'
            if what == "the band"
            else 'Write it like "5%", of the vibration of one unit impulse.',
        )
    return value


def _refuse_overlaps(modes: Sequence[ModeOption]) -> None:
    bands = sorted(
        (a.mode.frequency_hz * (1.0 - a.band), a.mode.frequency_hz * (1.0 + a.band), a)
        for a in modes
        if a.band is not None
    )
    for (_, high, one), (low, _, other) in itertools.pairwise(bands):
        if low < high:
            raise OptionError(
                f"the bands of the modes at {one.mode.frequency_hz:g} Hz and "
                f"{other.mode.frequency_hz:g} Hz overlap from {low:.4g} to {high:.4g} Hz",
                remedy="Narrow them, or give one mode with a band over both.",
            )


def bands_of(modes: Sequence[ModeOption], band: float) -> tuple[float, ...]:
    """Return the half band width of every mode: the mode's own value, or else ``band``."""
    return tuple(band if one.band is None else one.band for one in modes)


def tolerances_of(modes: Sequence[ModeOption], tolerance: float) -> tuple[float, ...]:
    """Return the tolerance of every mode: the mode's own value, or else ``tolerance``."""
    return tuple(tolerance if one.tolerance is None else one.tolerance for one in modes)


def refuse_worse_than_none(made: Shaper, modes: Sequence[FlexibleMode]) -> None:
    """Refuse a train that rings more at its own mode than no shaper, due to ticks and dwell.

    Raises
    ------
    OptionError
        Names the mode and its vibration.
    """
    for mode in modes:
        vibration = vibration_of(made, mode)
        if vibration >= 1.0:
            raise OptionError(
                f"on these ticks shaper {made.name!r} leaves {vibration * 100:.3g} % at "
                f"{mode.frequency_hz:g} Hz itself, more than no shaper at all",
                remedy="Take a shorter --tick or --dwell, or another kind.",
            )


def missed(made: Shaper, modes: Sequence[tuple[FlexibleMode, float, float]]) -> Iterator[str]:
    """Yield a warning for each mode at which a train exceeds the tolerance within the band."""
    for mode, band, tolerance in modes:
        frequency_ratios = np.linspace(1.0 - band, 1.0 + band, _IN_BAND)
        vibrations = [
            vibration_of(made, replace(mode, frequency_hz=mode.frequency_hz * ratio))
            for ratio in frequency_ratios.tolist()
        ]
        worst_index = int(np.argmax(vibrations))
        if vibrations[worst_index] > tolerance * _ROUNDED:
            yield (
                f"shaper {made.name!r} leaves {vibrations[worst_index] * 100:.3g} % at "
                f"{mode.frequency_hz * frequency_ratios[worst_index]:.4g} Hz, within the band of "
                f"+-{band * 100:.4g}% about {mode.frequency_hz:g} Hz, more than the "
                f"{tolerance * 100:.3g} % that were asked"
            )


def designed(
    kind: str, modes: Sequence[FlexibleMode], tolerances: Sequence[float], bands: Sequence[float]
) -> Shaper:
    """Return the shaper of a kind for ``modes``.

    ``si``, ``um-si``, ``direct`` and ``um-direct`` are designed for all modes at once. Of the other
    kinds, one shaper per mode and kind is designed, and all are convolved.

    Raises
    ------
    OptionError, ShaperError
        If no such shaper can be designed.
    """
    check_apart(modes)
    if kind in BANDED:
        if min(bands) <= 0.0:
            raise OptionError(
                f"--kind {kind} needs the band of frequency", remedy="Add --band 0.2."
            )
        requirements = [Requirement(*word) for word in zip(modes, tolerances, bands, strict=True)]
        if kind == "um-si":
            return unit_magnitude_over_bands(requirements)
        return direct_shaper(requirements, name="si")
    if kind == "direct":
        return direct_shaper([Requirement(m) for m in modes])
    if kind == "um-direct":
        return direct_unit_magnitude([Requirement(m) for m in modes])
    kinds = [part.strip() for part in kind.split("*")]
    for word in kinds:
        if word not in list(ShaperKind) and mzv_shape(word) is None:
            place = "" if len(kinds) == 1 else f" in {kind!r}"
            rule = " It cannot be convolved." if word in KINDS else ""
            raise OptionError(
                f"shaper kind {word!r}{place} is unknown"
                if not rule
                else f"shaper kind {word!r}{place} is made for all modes at once and stands alone",
                remedy=f"Kinds: {', '.join(ShaperKind if rule else KINDS)}.",
            )
    return convolve(
        *(
            design(word, mode, tolerance=mode_tolerance)
            for mode, mode_tolerance in zip(modes, tolerances, strict=True)
            for word in kinds
        )
    )


def price_table(made: Realised) -> Table:
    """Return a table: vibration over every mode's band, exact and on the controller's ticks."""
    rows = []
    for band_price in made.bands:
        for name, worst, width in (
            ("as designed", band_price.designed, band_price.designed_width),
            ("times to the nearest ticks", band_price.nearest, band_price.nearest_width),
            ("on these ticks", band_price.made, band_price.made_width),
        ):
            band = f"{band_price.low_hz:.4g} to {band_price.high_hz:.4g}"
            width_text = f"{width:.4f} at {band_price.tolerance * 100:g} %"
            rows.append([band, name, f"{without_noise(worst) * 100:.3g} %", width_text])
    return Table(
        title="Price of the controller over the band",
        header=("Hz", "train", "vibration at worst", "insensitivity"),
        rows=rows,
        note="The ticks are chosen for the least vibration over the band.",
    )


def price_content(made: Realised) -> list[dict[str, float]]:
    """Return the vibration over every mode's band, exact and on the ticks, as JSON content."""
    return [
        {
            "frequency_hz": over.mode.frequency_hz,
            "tolerance": over.tolerance,
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
    """Yield a warning for each damping ratio that may be the real part of an eigenvalue instead.

    A mode that would hardly ring with that real part gives no warning.
    """
    for m in modes:
        modulus = 2.0 * np.pi * m.frequency_hz
        meant = m.damping_ratio / modulus
        if m.damping_ratio < SUSPICIOUS_DAMPING or meant >= MAX_DAMPING_RATIO:
            continue
        left = residual_vibration(design("zv", m), m.frequency_hz, meant)
        yield (
            f"a damping ratio of {m.damping_ratio:g} is high for a mode that rings: an eigenvalue "
            f"{-m.damping_ratio:g} +- {modulus * np.sqrt(1.0 - meant**2):.4g}j 1/s has the ratio "
            f"{meant:.4f}, its real part divided by its modulus; if that is meant, a ZV for "
            f"{m.damping_ratio:g} leaves {float(left) * 100:.1f} %"
        )


def curve_lines(
    shaper: Shaper, modes: Sequence[FlexibleMode], tolerances: Sequence[float]
) -> Iterator[str]:
    """Yield lines that draw the sensitivity curve of every mode; ``-`` marks the tolerance."""
    for m, tolerance in zip(modes, tolerances, strict=True):
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


_HEADER = "[input_shaper]\n"


DEFAULT_DAMPING = 0.1
"""Klipper's default damping ratio: modes that use it give no warning."""


def damping_warnings(modes: Sequence[FlexibleMode]) -> list[str]:
    """Return warnings for suspicious damping ratios, except Klipper's default."""
    not_default = [mode for mode in modes if mode.damping_ratio != DEFAULT_DAMPING]
    return list(suspicions(tuple(not_default)))


def shape_two_axes(
    kind: str,
    modes: Sequence[ModeOption],
    tolerances: Sequence[float],
    bands: Sequence[float],
    others: Sequence[object],
    json: bool,
) -> None:
    """Print Klipper's section for both axes: the first mode is X's, the second Y's.

    Parameters
    ----------
    others
        Values of options that need a single impulse train; each must be None.

    Raises
    ------
    OptionError
        If there are more than two modes, or one of ``others`` is given.
    """
    if len(modes) > 2:
        raise OptionError(
            f"Klipper shapes one mode per axis, {len(modes)} are given",
            remedy="Give one --mode for both axes, or two: of X, then of Y.",
        )
    if any(other is not None for other in others):
        raise OptionError(
            "--klipper with a mode for X and one for Y gives two trains, and --tick, --move and "
            "--report take one",
            remedy="Leave them out, or give one --mode.",
        )
    lines, exports = _HEADER, {}
    for axis, given_mode, tolerance, band in zip("xy", modes, tolerances, bands, strict=True):
        made = designed(kind, (given_mode.mode,), (tolerance,), (band,))
        export = klipper_export(made, given_mode.mode, axes=axis)
        exports[axis] = export
        lines += export.section.removeprefix(_HEADER)
    section = lines if all(export.section for export in exports.values()) else ""
    if json:
        notes = {axis: export.explanation for axis, export in exports.items()}
        print_json({"klipper": section or None, "klipper_note": notes})
        return
    for text in damping_warnings([given_mode.mode for given_mode in modes]):
        warning(text)
    for axis, export in exports.items():
        say(f"{axis.upper()}: {export.explanation}")
    if section:
        say_lines(section)
