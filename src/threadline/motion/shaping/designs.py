"""Design shapers of every kind for one mode, convolve them, and prove them by simulation.

A train for two modes takes about a period of the slower mode, and its impulses must be accurate to
a hundredth of a period of the faster mode. So the grid of a joint design grows with the ratio of
the frequencies. The gain of a joint design shrinks with this ratio, because convolution adds at
most the duration of the shorter train. So modes that are far apart get separate trains, which are
convolved.

The proof uses no formula of input shaping. A unit step is cut into the levels that the shaper
makes of it, x'' + 2 zeta omega x' + omega^2 x = omega^2 u is integrated from switching to switching
with the matrix exponential, and the ringing at the end is compared with the ringing after the plain
step.

``frequency_hz`` is undamped, V is normalised to one unit impulse; see
:mod:`threadline.motion.shaping.types`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from enum import StrEnum
from itertools import pairwise

import numpy as np

from threadline.base.arguments import checked
from threadline.base.arrays import FloatArray
from threadline.errors import OptionError, UnitError
from threadline.motion.shaping.closed import (
    Humps,
    Train,
    alternating,
    binomial,
    modified_zv,
    positive_humps,
    switched_humps,
    switched_zero,
)
from threadline.motion.shaping.types import FlexibleMode, Shaper, ShaperError
from threadline.units import parse_quantity

MOST_APART = 1e3
"""Largest ratio of the highest to the lowest frequency; modes of one machine are closer."""


def check_apart(modes: Sequence[FlexibleMode]) -> None:
    """Refuse modes that no single train can serve.

    Raises
    ------
    OptionError
        If the highest frequency is more than ``MOST_APART`` times the lowest.
    """
    found_hz = sorted(mode.frequency_hz for mode in modes)
    if found_hz and found_hz[-1] > MOST_APART * found_hz[0]:
        raise OptionError(
            f"modes at {found_hz[0]:g} Hz and {found_hz[-1]:g} Hz: the ratio "
            f"{found_hz[-1] / found_hz[0]:.4g} is beyond {MOST_APART:g}, and no "
            "controller plays one train for both",
            remedy="Check their units, or shape one of them and leave out the other.",
        )


def groups(modes: Sequence[FlexibleMode], ratio: float) -> Iterator[list[int]]:
    """Yield groups of indices, lowest frequency first; in a group neighbours are within a ratio."""
    order = sorted(range(len(modes)), key=lambda k: modes[k].frequency_hz)
    group = order[:1]
    for slower, faster in pairwise(order):
        if modes[faster].frequency_hz > ratio * modes[slower].frequency_hz:
            yield group
            group = []
        group.append(faster)
    if group:
        yield group


COINCIDENT_S = 1e-12
"""Impulses closer than this are merged; it is far below any tick and far above rounding."""

MOST_IMPULSES = 10_000
"""Largest number of impulses: convolution multiplies numbers, and would take minutes without a
bound."""


def convolve(*shapers: Shaper, name: str = "") -> Shaper:
    """Convolve shapers: durations add up, vibrations multiply.

    Parameters
    ----------
    *shapers
        At least one shaper; a single shaper keeps its impulses.
    name
        Name of the result; if empty, the names of the shapers joined by ``*``.

    Raises
    ------
    OptionError
        If there is none.
    ShaperError
        If the train would have more than ``MOST_IMPULSES``.
    """
    if not shapers:
        raise OptionError("convolution: at least one shaper is needed")
    amplitudes, times = shapers[0].amplitudes, shapers[0].times_s
    for factor in shapers[1:]:
        if len(times) * len(factor.times_s) > MOST_IMPULSES:
            raise ShaperError(
                f"convolution of {len(shapers)} shapers: more than {MOST_IMPULSES} impulses",
                remedy="Shape fewer modes, or all at once with the kind direct.",
            )
        amplitudes = np.outer(amplitudes, factor.amplitudes).ravel()
        times = np.add.outer(times, factor.times_s).ravel()
        order = np.argsort(times, kind="stable")
        amplitudes, times = amplitudes[order], times[order]
        starts = np.concatenate(([0], np.flatnonzero(np.diff(times) > COINCIDENT_S) + 1))
        amplitudes, times = np.add.reduceat(amplitudes, starts), times[starts]
    return Shaper(
        amplitudes=amplitudes,
        times_s=times,
        name=name or "*".join(shaper.name for shaper in shapers),
    )


PROOF_TOLERANCE = 1e-9
"""Largest difference from the simulation: designs are solved to 1e-10, and expm over up to 20
switchings adds rounding well below 1e-9."""


def simulated_vibration(shaper: Shaper, frequency_hz: float, damping_ratio: float) -> float:
    """Return the ringing after a shaped unit step, relative to the ringing after a plain step.

    Parameters
    ----------
    shaper
        Impulse train; its sum is the final value of the step.
    frequency_hz, damping_ratio
        Undamped frequency, Hz, and damping ratio in [0, 1).

    Returns
    -------
    float
        Envelope of the deviation from rest at the last switching, divided by the envelope of the
        plain step at its switching.
    """
    omega = 2.0 * math.pi * frequency_hz
    # The state is (x, x'/omega, u); because it includes u, a single matrix exponential is enough.
    matrix = omega * np.array([[0.0, 1.0, 0.0], [-1.0, -2.0 * damping_ratio, 1.0], [0.0, 0.0, 0.0]])
    steps = np.diff(shaper.times_s)
    from scipy.linalg import expm  # slow to import, and seldom needed

    transitions = expm(matrix * steps[:, None, None]) if len(steps) else np.empty((0, 3, 3))
    state = np.zeros(3)
    state[2] = shaper.amplitudes[0]
    for transition, amplitude in zip(transitions, shaper.amplitudes[1:], strict=True):
        state = transition @ state
        state[2] += amplitude
    ringing = _envelope(state[0] - state[2], state[1], damping_ratio)
    return ringing / _envelope(-1.0, 0.0, damping_ratio)


def _envelope(deviation: float, rate_over_omega: float, damping_ratio: float) -> float:
    """Return the amplitude of a damped ringing from its deviation and its velocity over omega."""
    quadrature = (rate_over_omega + damping_ratio * deviation) / math.sqrt(1 - damping_ratio**2)
    return math.hypot(deviation, quadrature)


def prove(
    shaper: Shaper,
    frequency_hz: FloatArray,
    damping_ratio: float,
    expected: FloatArray,
    *,
    at_most: bool = False,
) -> Shaper:
    """Return ``shaper`` if the simulated oscillator agrees with the design, else raise.

    Parameters
    ----------
    shaper
        The designed train; its amplitudes must sum to 1.
    frequency_hz
        Undamped frequencies to simulate, Hz, shape ``(m,)``.
    damping_ratio
        Damping ratio of all modes, in [0, 1).
    expected
        Vibration of the design at each frequency, shape ``(m,)``.
    at_most
        True if ``expected`` is an upper bound and not a value.

    Raises
    ------
    ShaperError
        If the sum is not 1 or a simulated vibration differs by more than 1e-9.
    """
    if abs(float(shaper.amplitudes.sum()) - 1.0) > PROOF_TOLERANCE:
        raise ShaperError(
            f"shaper '{shaper.name}': amplitudes sum to {shaper.amplitudes.sum()!r}, not to 1"
        )
    for f, claimed in zip(frequency_hz, expected, strict=True):
        simulated = simulated_vibration(shaper, float(f), damping_ratio)
        error = simulated - float(claimed)
        if error > PROOF_TOLERANCE or (not at_most and error < -PROOF_TOLERANCE):
            raise ShaperError(
                f"shaper '{shaper.name}': simulated vibration at {f:.6g} Hz, damping "
                f"{damping_ratio:g}, is {simulated:.3e}; the design claims {float(claimed):.3e}",
                remedy="Change the tolerance, the damping or the kind of shaper.",
            )
    return shaper


DEFAULT_TOLERANCE = 0.05
_BAND_SAMPLES = 15


class ShaperKind(StrEnum):
    """Kinds of shapers for one mode, by their names on the command line."""

    ZV = "zv"
    MZV = "mzv"
    ZVD = "zvd"
    ZVDD = "zvdd"
    EI = "ei"
    EI2 = "2hump-ei"
    EI3 = "3hump-ei"
    UM_ZV = "um-zv"
    UM_ZVD = "um-zvd"
    UM_EI = "um-ei"
    UM_2EI = "um-2ei"
    NEGATIVE_ZV = "negative-zv"
    NEGATIVE_ZVD = "negative-zvd"
    NEGATIVE_EI = "negative-ei"
    NEGATIVE_2EI = "negative-2ei"


_POSITIVE_ORDER = {ShaperKind.ZV: 0, ShaperKind.ZVD: 1, ShaperKind.ZVDD: 2}
_POSITIVE_HUMPS = {ShaperKind.EI: 1, ShaperKind.EI2: 2, ShaperKind.EI3: 3}
_SWITCHED_ORDER = {
    ShaperKind.UM_ZV: 0,
    ShaperKind.UM_ZVD: 1,
    ShaperKind.NEGATIVE_ZV: 0,
    ShaperKind.NEGATIVE_ZVD: 1,
}
_SWITCHED_HUMPS = {
    ShaperKind.UM_EI: 1,
    ShaperKind.UM_2EI: 2,
    ShaperKind.NEGATIVE_EI: 1,
    ShaperKind.NEGATIVE_2EI: 2,
}
UNIT_MAGNITUDE = (ShaperKind.UM_ZV, ShaperKind.UM_ZVD, ShaperKind.UM_EI, ShaperKind.UM_2EI)
"""Kinds whose shaped step is always 0 or 1, as on/off valves need."""


def design(
    kind: ShaperKind | str,
    mode: FlexibleMode,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
) -> Shaper:
    """Design a shaper of ``kind`` for one mode.

    Parameters
    ----------
    kind
        See :class:`ShaperKind`, or ``mzv(n=4,t=0.9)``, see :func:`mzv_shape`. Negative
        (over-pressure) kinds are for comparison: their step leaves [0, 1].
    mode
        Undamped frequency, Hz, and damping ratio: in [0, 0.3), or in [0, 0.99) for the kinds in
        closed form, ZV, MZV, ZVD and ZVDD.
    tolerance
        Height of the humps of the EI kinds, in (0, 0.5); other kinds ignore it.

    Returns
    -------
    Shaper
        Constraints solved to 1e-10 and confirmed to 1e-9 by a simulation.

    Raises
    ------
    OptionError
        If the kind is unknown or a number is outside its range.
    ShaperError
        If the design does not converge or its simulation disagrees.
    """
    shape = mzv_shape(str(kind))
    if shape is not None:
        amplitudes, periods = modified_zv(mode.damping_ratio, *shape)
        modified = Shaper(
            amplitudes=amplitudes, times_s=periods / mode.frequency_hz, name=str(kind).strip()
        )
        return prove(modified, np.array([mode.frequency_hz]), mode.damping_ratio, np.zeros(1))
    try:
        chosen_kind = ShaperKind(kind)
    except ValueError:
        raise OptionError(
            f"shaper kind {str(kind)!r} is unknown",
            remedy=f"Kinds: {', '.join(ShaperKind)}.",
        ) from None
    if not 0.0 < tolerance < 0.5:
        raise OptionError(f"shaper tolerance must be in (0, 0.5), got {tolerance!r}")
    zeta = mode.damping_ratio
    if chosen_kind not in _POSITIVE_ORDER and chosen_kind is not ShaperKind.MZV:
        mode.refuse_much_damping(f"shaper '{chosen_kind}'")
    if chosen_kind in _POSITIVE_HUMPS:
        return _proved_humps(
            chosen_kind,
            mode,
            positive_humps(_POSITIVE_HUMPS[chosen_kind], zeta, tolerance),
            tolerance,
        )
    if chosen_kind in _SWITCHED_HUMPS:
        humps = _SWITCHED_HUMPS[chosen_kind]
        amplitudes = _switched_amplitudes(chosen_kind, 2 * humps + 3)
        return _proved_humps(
            chosen_kind, mode, switched_humps(humps, zeta, tolerance, amplitudes), tolerance
        )
    if chosen_kind in _SWITCHED_ORDER:
        order = _SWITCHED_ORDER[chosen_kind]
        train = switched_zero(order, zeta, _switched_amplitudes(chosen_kind, 2 * order + 3))
    elif chosen_kind in _POSITIVE_ORDER:
        train = binomial(_POSITIVE_ORDER[chosen_kind], zeta)
    else:
        train = modified_zv(zeta)
    return _proved_zero(chosen_kind, mode, train)


_MZV_WORDS = ("n", "t", "tau")
_MOST_OF_MZV = 32


def mzv_shape(word: str) -> tuple[int, float] | None:
    """Return n and t of ``mzv(n=4,t=0.9)`` as Klipper reads it; None for any other word.

    ``n`` impulses (default 3) take ``t`` damped periods (default 0.75). With ``tau`` in place of
    ``t``, a train with infinitely many impulses would take ``tau`` periods. Values without names
    are n, t, tau in this order.

    Raises
    ------
    OptionError
        If a parameter is unknown, no number, or ``t`` and ``tau`` are both given.
    """
    match = re.fullmatch(r"\s*mzv\s*\((.*)\)\s*", word)
    if match is None:
        return None
    parameters: dict[str, float] = {}
    parts = [part.strip() for part in match[1].split(",") if part.strip()]
    for index, part in enumerate(parts):
        name, equals, value = part.rpartition("=")
        name = name.strip() if equals else _MZV_WORDS[index] if index < 3 else part
        if name not in _MZV_WORDS or name in parameters:
            raise OptionError(
                f"shaper kind {word!r}: {part!r} is unknown or said twice",
                remedy='Write it like "mzv(n=4,t=0.9)" or "mzv(n=5,tau=1)".',
            )
        parameters[name] = _number(value.strip(), name, word)
    n, t, tau = parameters.get("n", 3.0), parameters.get("t", 0.0), parameters.get("tau", 0.0)
    if not 3.0 <= n <= _MOST_OF_MZV or n != int(n):
        raise OptionError(
            f"shaper kind {word!r}: n must be a whole number from 3 to {_MOST_OF_MZV}, got {n:g}"
        )
    if not (0.0 <= t < math.inf and 0.0 <= tau < math.inf):
        raise OptionError(f"shaper kind {word!r}: t and tau must be positive numbers")
    if t and tau:
        raise OptionError(
            f"shaper kind {word!r}: t and tau are both given",
            remedy="Klipper takes tau and ignores t: leave one out.",
        )
    if tau:
        t = tau * (n - 1.0) / (n + 2.0 * tau - 2.0)
    return int(n), t or 0.75


def _switched_amplitudes(kind: ShaperKind, n: int) -> FloatArray:
    """Return amplitudes 1, -1 ... 1; of a negative kind 1, -2, 2 ... 2, whose sums are 1 and -1.

    Singhose, Singer and Seering (1997), "Time-optimal negative input shapers", JDSMC 119.
    """
    if kind in UNIT_MAGNITUDE:
        return alternating(n)
    amplitudes = 2.0 * alternating(n)
    amplitudes[0] = 1.0
    return amplitudes


def _shaper(kind: ShaperKind, mode: FlexibleMode, train: Train) -> Shaper:
    amplitudes, times = train
    return Shaper(amplitudes=amplitudes, times_s=times / mode.frequency_hz, name=str(kind))


def _proved_zero(kind: ShaperKind, mode: FlexibleMode, train: Train) -> Shaper:
    mode_hz = np.array([mode.frequency_hz])
    return prove(_shaper(kind, mode, train), mode_hz, mode.damping_ratio, np.zeros(1))


def _proved_humps(kind: ShaperKind, mode: FlexibleMode, humps: Humps, tolerance: float) -> Shaper:
    shaper = _shaper(kind, mode, (humps.amplitudes, humps.times))
    frequencies = np.concatenate((humps.zeros, humps.peaks))
    claims = np.concatenate((np.zeros(len(humps.zeros)), np.full(len(humps.peaks), tolerance)))
    prove(shaper, frequencies * mode.frequency_hz, mode.damping_ratio, claims)
    # Between the zeros V must not exceed the requested height of the humps.
    band = np.linspace(humps.zeros[0], humps.zeros[-1], _BAND_SAMPLES) * mode.frequency_hz
    return prove(shaper, band, mode.damping_ratio, np.full(_BAND_SAMPLES, tolerance), at_most=True)


_REMEDY = 'Write it like "zv:12Hz:0.02" or "X=ei:12Hz:0.02:0.05, Y=zv:20Hz*zv:31Hz".'


def parse_shaper(text: str, tick_s: float | None = None) -> Shaper | dict[str, Shaper]:
    """Return the shaper that ``text`` describes, or one per axis if it names axes.

    A shaper is ``kind:frequency``, then optionally ``:damping ratio`` (default 0) and
    ``:tolerance``. ``*`` convolves shapers for several modes; ``AXIS=`` gives an axis its own,
    separated by commas.

    Parameters
    ----------
    tick_s
        Tick of the references to be shaped; None if there is none.

    Raises
    ------
    OptionError
        If the text cannot be read, no such shaper can be designed, or a mode lies above half the
        rate of the ticks, so that no reference can excite it.
    """
    # A comma in brackets separates parameters of a kind, not axes.
    parts = [part.strip() for part in re.split(r",(?![^()]*\))", text)]
    axis_matches = [re.fullmatch(r"([A-Z])\s*=\s*(.+)", part) for part in parts]
    if not any(axis_matches) and len(parts) == 1:
        return _convolution(parts[0], tick_s)
    shapers: dict[str, Shaper] = {}
    for part, match in zip(parts, axis_matches, strict=True):
        if match is None:
            raise OptionError(f"shaper {text!r}: {part!r} has no axis before it", remedy=_REMEDY)
        if match[1] in shapers:
            raise OptionError(f"shaper {text!r}: axis {match[1]} has two", remedy=_REMEDY)
        shapers[match[1]] = _convolution(match[2], tick_s)
    return shapers


def parse_mode_hz(text: str) -> float:
    """Return an undamped frequency such as ``"3.04 Hz"``.

    Raises
    ------
    OptionError
        If it is not a frequency.
    """
    try:
        return parse_quantity(text, "Hz")
    except UnitError as error:
        raise OptionError(f"mode {text!r}: {error.message}", remedy='Write "3.04 Hz".') from error


def _convolution(text: str, tick_s: float | None) -> Shaper:
    return convolve(*(_one(part.strip(), text, tick_s) for part in text.split("*")))


def _one(text: str, whole: str, tick_s: float | None) -> Shaper:
    words = [word.strip() for word in text.split(":")]
    if not 2 <= len(words) <= 4 or not all(words):
        raise OptionError(f"shaper {whole!r}: {text!r} is not kind:frequency", remedy=_REMEDY)
    damping = _number(words[2], "damping ratio", whole) if len(words) > 2 else 0.0
    tolerance = _number(words[3], "tolerance", whole) if len(words) > 3 else DEFAULT_TOLERANCE
    mode = FlexibleMode(parse_mode_hz(words[1]), damping)
    if tick_s is not None and mode.frequency_hz > 0.5 / tick_s:
        raise OptionError(
            f"shaper {whole!r}: its mode of {mode.frequency_hz:g} Hz is above "
            f"{0.5 / tick_s:g} Hz, half the rate of the machine's tick of {1e3 * tick_s:g} ms",
            remedy="References on that tick cannot excite it: leave it out.",
        )
    return design(words[0], mode, tolerance=tolerance)


def _number(text: str, what: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise OptionError(
            f"shaper {whole!r}: {what} {text!r} is not a number", remedy=_REMEDY
        ) from None


@checked
def shaper(text: str) -> Shaper | dict[str, Shaper]:
    """Return the shaper that ``text`` describes, or one per axis where it names axes.

    >>> shaper("zv:10Hz").times_s.tolist()
    [0.0, 0.05]

    Raises
    ------
    OptionError
        If the text cannot be read, or no such shaper can be designed.
    """
    return parse_shaper(text)
