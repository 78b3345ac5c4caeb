"""Patterns: how many circuits close over the mandrel, and what makes them close.

Each of n circuits advances by whole turns and k/n of a turn. Then the fibre is back where it began,
and n bands lie side by side. With ``p k = 1 (mod n)`` the band after p circuits lies beside the
first one, ahead of it (leading); the band after n - p circuits lies behind it (lagging).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import JobError
from threadline.jobs.winding.circuit import Circuit
from threadline.jobs.winding.layers import MARGIN, Closing, Layer
from threadline.jobs.winding.on_mandrel import Wrap

_TURN = 2.0 * math.pi
_SAMPLES = 9  # angles between which the table interpolates
_HALVINGS = 14  # of the range of friction ratios in search of its end
_MORE = 1.10  # coverage up to which patterns are listed, by the least wanted
_MOST_SHOWN = 1000
_MAX_COUNTS_AWAY = 200  # circuits from the asked number, in search of a pattern that closes
_ROUNDS = 40
_CLOSED = 1e-13  # rad


@dataclass(frozen=True, slots=True)
class Pattern:
    """A pattern that closes.

    Parameters
    ----------
    circuits, shift
        n and k: each circuit advances by k/n of a turn more than whole turns.
    coverage
        Width of all bands at the largest radius over the circumference.
    beside
        Circuits after which a band lies beside the first; the smaller of p and n - p.
    leading
        Whether that band lies ahead of the first one.
    turns
        Turns of the mandrel in the layer.
    off
        Angle by which a circuit of the geodesic falls short, rad; negative: it goes too far.
    ratio
        Friction ratio on the domes that closes it; NaN if none does.
    constant_m
        Clairaut radius that closes it without friction; NaN if none does.
    dwell
        Angle on the parallels of the turns that closes it in each circuit, rad; NaN where no turn
        can dwell.
    """

    circuits: int
    shift: int
    coverage: float
    beside: int
    leading: bool
    turns: int
    off: float
    ratio: float = math.nan
    constant_m: float = math.nan
    dwell: float = math.nan

    @property
    def closings(self) -> tuple[Closing, ...]:
        """What can close it."""
        closings: list[Closing] = []
        for name, value in (
            ("friction", self.ratio), ("angle", self.constant_m), ("dwell", self.dwell)
        ):  # fmt: skip
            if not math.isnan(value):
                closings.append(name)  # type: ignore[arg-type]
        return tuple(closings)


def patterns(wrap: Wrap) -> list[Pattern]:
    """Return the patterns that close with the wanted coverage, the nearest to the geodesic first.

    Raises
    ------
    JobError
        If there is none; the error names the nearest one.
    """
    layer, base = wrap.layer, wrap.base
    if layer.kind == "hoop":
        count = layer.circuits or 1
        turns = round(base.advance * count / _TURN)
        return [Pattern(count, 0, float(count), 1, True, turns, 0.0, dwell=0.0)]
    bands_around = _TURN * base.widest_m * math.cos(base.angle) / wrap.width_m
    least = max(math.ceil(layer.cover * bands_around - 1e-9), 1)
    if layer.circuits is not None:
        if layer.circuits < least:
            wrap.winding.refuse(
                layer,
                f"{layer.circuits} circuits cover {100.0 * layer.circuits / bands_around:.1f} % "
                "of the "
                f"largest radius, and cover asks for {100.0 * layer.cover:.4g} %",
                f"The nearest number that covers it is circuits = {least}; or leave out cover.",
            )
        counts = range(layer.circuits, layer.circuits + 1)
    else:
        low = least
        counts = range(low, max(math.floor(_MORE * layer.cover * bands_around), low) + 1)
        if low > _MOST_SHOWN:
            wrap.winding.refuse(
                layer, f"a layer would need {low} circuits, limit {_MOST_SHOWN}",
                f"Is the band so narrow? If so, write circuits = {low} into the layer.",
            )  # fmt: skip
    closings = _Closings(wrap)
    closed_patterns = closings.closed(counts, layer.shift)
    by_dwell = layer.close == "dwell" or not wrap.domes
    closed_patterns.sort(
        key=lambda pattern: (pattern.dwell if by_dwell else abs(pattern.off), pattern.circuits)
    )
    if not closed_patterns:
        wrap.winding.refuse(layer, f"no pattern {_asked_words(layer)}", _remedy(closings, counts))
    return closed_patterns


class _Closings:
    """The ways to close the patterns of a layer."""

    def __init__(self, wrap: Wrap) -> None:
        self.wrap = wrap
        base = wrap.base
        self.around = _TURN * base.widest_m * math.cos(base.angle) / wrap.width_m
        self._frictions, self._angles = _by_friction(wrap), _by_angle(wrap)
        self._dwells = any(wrap.can_dwell(base, site) for site in wrap.sites)

    def closed(self, counts: Sequence[int], shift: int | None) -> list[Pattern]:
        """Return the patterns of some numbers of circuits that close in a way that is wanted."""
        close, closing = self.wrap.layer.close, []
        for pattern in self.patterns(counts, shift):
            dwell = pattern.off % _TURN if self._dwells else math.nan
            candidate = replace(
                pattern, ratio=self._frictions(pattern.off), constant_m=self._angles(pattern.off),
                dwell=dwell,
            )  # fmt: skip
            if candidate.closings and (close is None or close in candidate.closings):
                closing.append(candidate)
        return closing

    def patterns(self, counts: Sequence[int], shift: int | None) -> list[Pattern]:
        """Return all patterns of some numbers of circuits, whether they close or not."""
        advance = self.wrap.base.advance
        return [
            pattern
            for count in counts
            for pattern in _patterns_of_count(advance, count, self.around, shift)
        ]

    def nearest(self, counts: Sequence[int]) -> Pattern | None:
        """Return a pattern that closes, with the number of circuits nearest to the asked ones."""
        ends = (counts[0], counts[-1])
        count_lists = [list(counts)]
        count_lists += [
            [ends[0] - distance, ends[1] + distance] for distance in range(1, _MAX_COUNTS_AWAY)
        ]
        for counts_tried in count_lists:
            closing = self.closed([count for count in counts_tried if count > 0], None)
            if closing:
                return min(closing, key=lambda pattern: abs(pattern.off))
        return None

    def friction_for(self, counts: Sequence[int], shift: int | None) -> float | None:
        """Return the least friction that closes one of the asked patterns; None if none does."""
        if not all(site.dome for site in self.wrap.sites):
            return None
        ratios = _by_friction(replace(self.wrap, friction=1.0))
        ratios_needed = [abs(ratios(pattern.off)) for pattern in self.patterns(counts, shift)]
        return min(
            (pattern / MARGIN for pattern in ratios_needed if pattern <= MARGIN), default=None
        )


def _asked_words(layer: Layer) -> str:
    """Return the words for the patterns that a layer asks for, and how they should close."""
    text = "of this layer" if layer.circuits is None else f"with {layer.circuits} circuits"
    if layer.shift is not None:
        text += f" and shift {layer.shift}"
    return text + " closes" + (f" by {layer.close}" if layer.close else "")


def _remedy(closing: _Closings, counts: Sequence[int]) -> str:
    """Say how to close the pattern: by the nearest other one, or by how much friction."""
    wrap, remedies = closing.wrap, []
    if wrap.layer.close == "dwell":
        slips = max(wrap.slip_at(wrap.base, site) for site in wrap.sites)
        remedies.append(
            f"A dwell on the parallel has a slip tendency of {slips:.2g}, the friction holds "
            f"{wrap.friction:.2g}: declare a [[boss]] or a ring of pins, or close by friction."
        )
    nearest = closing.nearest(counts)
    if nearest is not None:
        remedies.append(
            f"The nearest that closes: circuits = {nearest.circuits}, shift = {nearest.shift}, "
            f"{nearest.coverage:.1%} covered."
        )
    friction = closing.friction_for(counts, wrap.layer.shift)
    if friction is not None and wrap.layer.close in (None, "friction"):
        remedies.append(f"A friction of {friction:.2g} or more would close the asked one.")
    return (
        " ".join(remedies) or "Give another turn or angle, or a [[boss]] on which the fibre dwells."
    )


def _patterns_of_count(
    advance: float, count: int, bands_around: float, shift: int | None
) -> Iterator[Pattern]:
    whole_turns = math.floor(advance / _TURN)
    shifts = range(count) if shift is None else (shift % count,)
    for k in shifts:
        if math.gcd(k, count) != 1:
            continue
        off = math.remainder(_TURN * k / count - advance, _TURN)
        steps_ahead = pow(k, -1, count) if count > 1 else 1
        turns = round((advance + off) * count / _TURN) if whole_turns >= 0 else 0
        yield Pattern(
            circuits=count, shift=k, coverage=count / bands_around,
            beside=min(steps_ahead, count - steps_ahead) or 1,
            leading=steps_ahead <= count - steps_ahead,
            turns=turns, off=off,
        )  # fmt: skip


def _inverse(values: FloatArray, advances: FloatArray, base: float) -> Callable[[float], float]:
    """Return the value for a wanted change of the advance, NaN beyond the samples."""
    order = np.argsort(advances)
    sorted_values, changes = values[order], advances[order] - base
    return lambda off: float(np.interp(off, changes, sorted_values, left=np.nan, right=np.nan))


def _never(_off: float) -> float:
    return math.nan


def _by_friction(wrap: Wrap) -> Callable[[float], float]:
    """Return the friction ratio on the domes for the angle that a circuit lacks."""
    if not wrap.domes:
        return _never

    def advance_at(ratio: float) -> float:
        try:
            circuit = wrap.circuit(ratio)
        except JobError:
            return math.nan
        return math.nan if _turns_too_near(wrap, circuit) else circuit.advance

    ends = [_largest_succeeding(advance_at, sign * wrap.friction) for sign in (-1.0, 1.0)]
    samples = np.concatenate([np.linspace(ends[0], 0.0, 5), np.linspace(0.0, ends[1], 5)[1:]])
    advances = np.array([advance_at(float(ratio)) for ratio in samples])
    is_known = np.isfinite(advances)
    if is_known.sum() < 2:
        return _never
    return _inverse(samples[is_known], advances[is_known], wrap.base.advance)


def _largest_succeeding(advance_at: Callable[[float], float], target: float) -> float:
    """Return the largest value from 0 towards ``target`` at which a trial still succeeds."""
    if not math.isnan(advance_at(target)):
        return target
    low, high = 0.0, target
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if math.isnan(advance_at(middle)) else (middle, high)
    return low


def _turns_too_near(wrap: Wrap, circuit: Circuit) -> bool:
    """Return whether a circuit turns nearer to a pole than its band can, by more than 1 nm."""
    return any(
        site.dome and turn.radius_m < wrap.least_m - 1e-9
        for site, turn in zip(wrap.sites, (circuit.left, circuit.right), strict=True)
    )


def _by_angle(wrap: Wrap) -> Callable[[float], float]:
    """Return the Clairaut radius for the angle that a circuit lacks, within a few degrees."""
    if wrap.layer.angle is not None and not wrap.domes:
        spread = math.radians(1.0)
    else:
        spread = math.radians(3.0)
    values, advances = [], []
    middle = wrap.base.angle
    low = max(middle - spread, math.asin(min(wrap.least_m / wrap.base.widest_m, 1.0)), 1e-3)
    for angle in np.linspace(low, middle + spread, _SAMPLES):
        constant = wrap.base.widest_m * math.sin(float(angle))
        if constant <= 0.0 or angle >= 0.5 * math.pi:
            continue
        try:
            circuit = wrap.circuit(constant_m=constant)
        except JobError:
            continue
        if _turns_too_near(wrap, circuit):
            continue
        values.append(constant)
        advances.append(circuit.advance)
    if len(values) < 2 or not (np.diff(advances) * (advances[-1] - advances[0]) > 0.0).all():
        return _never
    return _inverse(np.array(values), np.array(advances), wrap.base.advance)


def closed_circuit(wrap: Wrap, pattern: Pattern, by: Closing) -> Circuit:
    """Return the circuit of a pattern, closed to ``1e-13`` rad.

    Raises
    ------
    JobError
        If it does not close in that way.
    """
    target = wrap.base.advance + pattern.off

    def circuit_at(value: float) -> Circuit:
        if by == "friction":
            return wrap.circuit(ratio=value)
        return wrap.circuit(constant_m=value)

    if by == "dwell":
        return wrap.circuit(dwell=pattern.dwell) if pattern.dwell else wrap.base
    at, step = (pattern.ratio, 1e-4) if by == "friction" else (pattern.constant_m, 1e-6)
    circuit = circuit_at(at)
    last_value, error = at + step, circuit.advance - target
    last_error = circuit_at(last_value).advance - target
    for _ in range(_ROUNDS):
        if abs(error) < _CLOSED or error == last_error:
            break
        next_value = at - error * (at - last_value) / (error - last_error)
        if next_value == at:
            break
        last_value, last_error, at = at, error, next_value
        circuit = circuit_at(at)
        error = circuit.advance - target
    return circuit


def chosen(wrap: Wrap, found: list[Pattern]) -> tuple[Pattern, Closing]:
    """Return the pattern of a layer and what closes it.

    The first pattern is taken. Friction closes it if it can, else a dwell, else the angle.
    """
    pattern = found[0]
    if wrap.layer.close is not None:
        return pattern, wrap.layer.close
    preferred: tuple[Closing, ...] = ("friction", "dwell", "angle")
    for way in preferred:
        if way in pattern.closings:
            return pattern, way
    raise AssertionError("a listed pattern closes in one way at least")
