"""Shaped laws: the convolution of a law with an impulse train is one law over the whole window."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError, UnitError
from threadline.motion.laws import Law, law, measured_law
from threadline.motion.shaping.designs import ShaperKind, design, parse_shaper
from threadline.motion.shaping.law_residual import residual_m
from threadline.motion.shaping.mode_law import Demand
from threadline.motion.shaping.response import residual_vibration
from threadline.motion.shaping.types import FlexibleMode, Shaper
from threadline.units import parse_quantity

SHAPED = (ShaperKind.ZV, ShaperKind.ZVD, ShaperKind.EI)
_STEP_S = 1e-3
_BAND = 9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShapedWindow:
    """A shaped law, and the shortest window in which it meets a demand, s."""

    law: Law
    window_s: float


@dataclass(frozen=True, slots=True, eq=False)
class _Shifted:
    """The rise ``sum(shares[i] s((t - delays[i]) / length))``, evaluated from one of its ends."""

    law: Law
    shares: tuple[float, ...]
    delays: tuple[float, ...]
    length: float
    from_end: bool

    @property
    def breaks(self) -> tuple[float, ...]:
        edges = self.law.edges * self.length
        if self.from_end:
            edges = self.length - edges[::-1]
        all_edges = np.unique(np.add.outer(np.array(self.delays), edges))
        return tuple(all_edges[(all_edges > 0.0) & (all_edges < 1.0)].tolist())

    def value(self, t: FloatArray, derivative: int) -> FloatArray:
        out = np.zeros_like(t)
        for share, delay in zip(self.shares, self.delays, strict=True):
            inside = t > delay
            law_time = (t[inside] - delay) / self.length
            if self.from_end:
                rise = _left(self.law, law_time, derivative)
            else:
                rise = self.law(law_time, derivative)
            out[inside] += share * rise / self.length**derivative
        return out


def _left(law: Law, since: FloatArray, derivative: int) -> FloatArray:
    """Return (n,) 1 minus the rise at the times 1 - ``since``, or its derivative by ``since``.

    ``since`` (n,) counts back from the end of the law. Above 1, before the law begins, the result
    is 1.
    """
    in_closing = since <= 1.0 - law.meets
    out = np.empty_like(since)
    out[in_closing] = law.left(since[in_closing], derivative)
    opening_time = 1.0 - since[~in_closing]
    value = law(opening_time, derivative)
    out[~in_closing] = 1.0 - value if derivative == 0 else value if derivative % 2 else -value
    return out


def shaped_law(law: Law, shaper: Shaper, window_s: float) -> Law:
    """Return ``law`` shaped by ``shaper``, so that both together take ``window_s``.

    Parameters
    ----------
    law
        Law that takes the window less the duration of the shaper.
    shaper
        Impulses that sum to 1. With negative impulses the law may go back; then it has no inverse.
    window_s
        The whole window, s; the shape of the result depends on it.

    Raises
    ------
    OptionError
        If the shaper takes the whole window, or does not sum to 1.
    """
    length = 1.0 - shaper.duration_s / window_s
    if length <= 0.0:
        raise OptionError(
            f"law {law.name}: the shaper {shaper.name} takes {shaper.duration_s * 1e3:.4g} ms, the "
            f"window is {window_s * 1e3:.4g} ms",
            remedy="Give a longer window or a shorter shaper.",
        )
    total = float(shaper.amplitudes.sum())
    if abs(total - 1.0) > 1e-9:
        raise OptionError(f"shaper {shaper.name}: its impulses sum to {total:g}, not to 1")
    shares = tuple((shaper.amplitudes / total).tolist())
    delays = tuple((shaper.times_s / window_s).tolist())
    last = delays[-1]
    opening = _Shifted(law, shares, delays, length, from_end=False)
    closing = _Shifted(law, shares[::-1], tuple(last - d for d in delays[::-1]), length, True)
    return measured_law(f"{law.name}*{shaper.name}", opening, closing, 0.5)


def shaped_windows(law: Law, demand: Demand) -> list[ShapedWindow]:
    """Return ``law`` with a shaper of each kind, in the shortest window that keeps ``demand``.

    Windows are tried in steps of a millisecond, up to four rigid windows beyond the shaper. Kinds
    that meet the demand in none of them are left out. The jerk is not limited.
    """
    d = demand
    shaped = []
    ratios = np.array([1.0]) if d.band == 0.0 else np.linspace(1.0 - d.band, 1.0 + d.band, _BAND)
    frequencies, zeta = ratios * d.mode.frequency_hz, d.mode.damping_ratio
    law_windows_s = np.arange(0.5 * d.rigid_s, 4.0 * d.rigid_s, _STEP_S)
    residuals_m = np.array(
        [residual_m(law, FlexibleMode(f, zeta), d.move_m, law_windows_s) for f in frequencies]
    )
    for kind in SHAPED:
        shaper = design(kind, d.mode)
        # The residual of the shaped law is the residual of the law times V of the shaper.
        share = residual_vibration(shaper, frequencies, zeta)
        for length in law_windows_s[
            (residuals_m * share[:, None] <= d.residual_m).all(axis=0)
        ].tolist():
            # The window is rounded up to whole microseconds, so that the name states it exactly.
            window = ceil((length + shaper.duration_s) * 1e6) / 1e6
            words = f"{law.name}*{kind.value}:{d.mode.frequency_hz!r}Hz:{zeta!r}"
            name = f"{words} in {round(window * 1e3, 3)!r} ms"
            candidate = replace(shaped_law(law, shaper, window), name=name)
            if candidate.acceleration * d.move_m / window**2 <= d.acceleration_m_s2:
                shaped.append(ShapedWindow(law=candidate, window_s=window))
                break
    return shaped


_EXAMPLE = 'Write it like "modified-sine*zv:12Hz:0.02 in 160 ms".'


def law_named(text: str) -> Law:
    """Return the law called ``text``: from the catalogue, or shaped by a shaper.

    ``"modified-sine"`` and other names of ``threadline.motion.laws.law``;
    ``"modified-sine*zv:12Hz:0.02 in 160 ms"`` is a law convolved with a shaper so that both
    together take the window. In another window the law keeps its shape, and the frequency without
    residual vibration is scaled by the ratio of the windows.

    Raises
    ------
    OptionError
        If there is no such law, the shaper cannot be made, or it takes the whole window.

    >>> law_named("cycloidal*zv:12Hz in 160 ms").name
    'cycloidal*zv:12Hz in 160 ms'
    """
    base, star, rest = text.partition("*")
    if not star or text.lower().endswith(".csv"):
        return law(text)
    words, within, window = rest.rpartition(" in ")
    if not within:
        raise OptionError(f"motion law {text!r}: it does not say its window", remedy=_EXAMPLE)
    try:
        window_s = parse_quantity(window.strip(), "s")
    except UnitError as error:
        raise OptionError(f"motion law {text!r}: {error.message}", remedy=_EXAMPLE) from error
    shaper = parse_shaper(words.strip())
    if not isinstance(shaper, Shaper):
        raise OptionError(
            f"motion law {text!r}: a law has one shaper, not one for each axis", remedy=_EXAMPLE
        )
    if not 0.0 < window_s < float("inf"):
        raise OptionError(f"motion law {text!r}: the window must be longer than 0", remedy=_EXAMPLE)
    return replace(shaped_law(law(base.strip()), shaper, window_s), name=text)
