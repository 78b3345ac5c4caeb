"""The space of a redesign: factors on numbers of the machine, and settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import MachineError, OptionError
from threadline.machine import Machine
from threadline.machine.controllers import LeadFilter
from threadline.machine.load import place_in
from threadline.machine.numbers import is_whole, number_at
from threadline.machine.quantity import Quantity
from threadline.machine.tables import Design, DesignParameter
from threadline.proof.kinds import kind_of
from threadline.units import parse_quantity

_LEVELS = 3
_DELAY_STEP_S = 1e-3
_SAME = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Space:
    """Changeable parameters and settings as coordinates.

    A point holds the logarithm of a factor for each of P parameters. Where filters are designed,
    the logarithm of the crossover in Hz and the phase margin in degrees follow; with ``ahead`` the
    logarithm of the smoothing width in s and the share of the acceleration that ramps use.

    Parameters
    ----------
    machine
        The original machine.
    names, weights
        (P,) names and weights of the parameters.
    paths
        Per parameter, the numbers of the machine that it scales.
    low, high
        (P + 0 or 2,) bounds of a point.
    tolerance
        (P,) tolerance of each parameter, as a share.
    levels
        Shares of the acceleration to try; with ``ahead`` a single one: each point has its own.
    ahead
        Whether the commands go through the exact inverse of each candidate: feed-forward.
    serial
        Whether candidates are planned for and proved one by one.
    delays_s
        (D,) needle delays to try; empty where the specification gives the delay.
    """

    machine: Machine
    names: tuple[str, ...]
    weights: FloatArray
    paths: tuple[tuple[str, ...], ...]
    low: FloatArray
    high: FloatArray
    tolerance: FloatArray
    levels: tuple[float, ...]
    delays_s: FloatArray
    ahead: bool = False
    serial: bool = False
    known: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def parameters(self) -> int:
        """Number of parameters P."""
        return len(self.names)

    @property
    def designs_gains(self) -> bool:
        """Whether the filters are designed for every candidate."""
        return not self.ahead and len(self.low) > self.parameters

    def smoothing_s(self, point: FloatArray) -> float | None:
        """Return the smoothing width of a (dims,) point; None without feed-forward."""
        return float(np.exp(point[self.parameters])) if self.ahead else None

    def share(self, point: FloatArray, level: int) -> float:
        """Return the share of the acceleration that ramps use at a (dims,) point and its level."""
        return float(point[-1]) if self.ahead else self.levels[level]

    def cost(self, points: FloatArray) -> FloatArray:
        """Return (n,) the weighted sum of |ln factor| of (n, dims) points."""
        return np.asarray(np.abs(points[:, : self.parameters]) @ self.weights)

    def numbers(self, points: FloatArray) -> dict[str, FloatArray]:
        """Return the numbers of the machine at (n, dims) points: path to (n,) SI values."""
        factors = np.exp(points[:, : self.parameters])
        return {
            path: factors[:, k] * number_at(self.machine, path).si
            for k, paths in enumerate(self.paths)
            for path in paths
        }

    def slower(self, share: float) -> dict[str, float]:
        """Return the limits of a machine with a share of its acceleration and jerk, by path."""
        if share == 1.0:
            return {}
        names = ("acceleration", "deceleration", "jerk")
        machine_limits: dict[str, Quantity | None] = {
            f"axes.{axis}.{name}": getattr(limits, name)
            for axis, limits in self.machine.axes.items()
            for name in names
        }
        if self.machine.path is not None:
            for name in (*names, "centripetal"):
                machine_limits[f"path.{name}"] = getattr(self.machine.path, name)
        return {
            path: limit.si * share for path, limit in machine_limits.items() if limit is not None
        }

    def corners(self, points: FloatArray) -> FloatArray:
        """Return (n * C, dims) the tolerance corners of (n, dims) points, point by point."""
        toleranced = np.flatnonzero(self.tolerance > 0)
        if not len(toleranced):
            return points
        signs = np.array(list(product((-1.0, 1.0), repeat=len(toleranced))))
        offsets = np.zeros((len(signs), points.shape[1]))
        offsets[:, toleranced] = np.log1p(signs * self.tolerance[toleranced])
        return np.asarray((points[:, None, :] + offsets[None]).reshape(-1, points.shape[1]))

    @property
    def corner_count(self) -> int:
        """Number of corners of a point."""
        return 1 << int((self.tolerance > 0).sum())


def design_space(machine: Machine, smoothing_s: tuple[float, ...] = ()) -> Space:
    """Return the space that the machine's ``[design]`` table allows.

    Parameters
    ----------
    smoothing_s
        Widths of the feed-forward smoothing, s: the search tries all from the least to the largest.
        With feed-forward the machine's filters stay unchanged, and the needle goes down at the
        commanded time. Empty for no feed-forward.

    Raises
    ------
    MachineError
        If the machine has no ``[design]`` table, or the table names numbers that it does not have.
    OptionError
        If the table changes a number that the settings of ``--par`` replace.
    """
    if machine.design is None:
        raise MachineError(
            f"machine {machine.name!r} has no [design] table",
            place=machine.place,
            remedy="Say what may be changed: [design.parameters.NAME] with of and factor.",
        )
    design = machine.design
    low, high = [], []
    for name, parameter in design.parameters.items():
        least, largest = _bounds(machine, name, parameter)
        low.append(np.log(least))
        high.append(np.log(largest))
    ahead = bool(smoothing_s)
    _check_settings(machine, design)
    shares = _levels(design)
    if ahead:
        low_settings = [float(np.log(min(smoothing_s))), min(shares)]
        high_settings = [float(np.log(max(smoothing_s))), max(shares)]
    else:
        low_settings, high_settings = _gain_bounds(machine, design)
    return Space(
        machine=machine,
        names=tuple(design.parameters),
        weights=np.array([p.weight for p in design.parameters.values()]),
        paths=tuple(p.of for p in design.parameters.values()),
        low=np.array([*low, *low_settings]),
        high=np.array([*high, *high_settings]),
        tolerance=np.array([p.spread for p in design.parameters.values()]),
        levels=(1.0,) if ahead else shares,
        delays_s=np.zeros(1) if ahead else _delays(design),
        ahead=ahead,
        serial=not kind_of(machine).together(machine),
        known={name: known.factors for name, known in design.known.items()},
    )


def _bounds(machine: Machine, name: str, parameter: DesignParameter) -> tuple[float, float]:
    """Return the least and the largest factor of a parameter."""
    label = f"design.parameters.{name}"
    place = place_in(machine, f"{label}.of")
    try:
        numbers = [number_at(machine, path) for path in parameter.of]
    except OptionError as error:
        raise MachineError(
            f"{label}: {error.message}", place=place, remedy="Correct of, or take it out."
        ) from error
    whole = [path for path in parameter.of if is_whole(machine, path)]
    if whole:
        raise MachineError(
            f"{label}: {whole[0]} takes whole numbers alone, and a factor would not keep it whole",
            place=place,
            remedy="Take it out; make a machine file for each of its values instead.",
        )
    if any(q.si == 0.0 for q in numbers):
        raise MachineError(f"{label}: a number that is 0 has no factor", place=place)
    settings = Path(machine.parameters).name
    for path, quantity in zip(parameter.of, numbers, strict=True):
        if settings and quantity.note.startswith(f"{settings}:"):
            # With the settings the file of the redesigned machine would be the old one again.
            raise OptionError(
                f"{label} changes {path}, and --par {machine.parameters!r} sets it",
                place=place,
                remedy=f"Leave --par out, or take {path} out of the [design] table.",
            )
    if parameter.factor is not None:
        return parameter.factor
    assert parameter.range is not None
    place = place_in(machine, f"{label}.range")
    first_number = numbers[0]
    if any(
        abs(q.si / first_number.si - 1.0) > _SAME or q.unit != first_number.unit for q in numbers
    ):
        raise MachineError(
            f"{label}: range is for numbers that are equal",
            place=place,
            remedy="Give factor = [low, high] instead.",
        )
    try:
        least, largest = (
            parse_quantity(text, first_number.unit) / first_number.si for text in parameter.range
        )
    except ValueError as error:
        raise MachineError(f"{label}.range: {error}", place=place) from error
    if not 0.0 < least <= largest:
        raise MachineError(
            f"{label}.range runs from {parameter.range[0]} to {parameter.range[1]}", place=place
        )
    return least, largest


def _check_settings(machine: Machine, design: Design) -> None:
    """Refuse settings for parts that the machine does not have.

    Raises
    ------
    MachineError
        If the settings vary the acceleration of a machine without axes, or design lead filters for
        a machine without controllers.
    """
    settings = design.settings
    if settings.acceleration is not None and not machine.axes:
        raise MachineError(
            f"design.settings.acceleration: {machine.name} has no axis with such a limit",
            place=place_in(machine, "design.settings.acceleration"),
            remedy="Take it out.",
        )
    if settings.crossover is not None and not machine.controllers:
        raise MachineError(
            f"design.settings.crossover: {machine.name} has no controller",
            place=place_in(machine, "design.settings.crossover"),
            remedy="Take it out; only lead filters are designed.",
        )


def _gain_bounds(machine: Machine, design: Design) -> tuple[list[float], list[float]]:
    settings = design.settings
    if settings.crossover is None or settings.phase_margin is None:
        return [], []
    (low, high), (least, most) = settings.crossover, settings.phase_margin
    place = place_in(machine, "design.settings.crossover")
    for axis in machine.axes.values():
        if not isinstance(machine.controllers[axis.controller], LeadFilter):
            raise MachineError(
                f"design.settings.crossover: the controller {axis.controller!r} is no lead filter",
                place=place,
                remedy="Only lead filters are designed; give its gains as parameters instead.",
            )
        clock = machine.controllers[axis.controller].clock
        nyquist_hz = 0.5 / float(machine.clock(clock).period_s)
        if high.si >= nyquist_hz:
            raise MachineError(
                f"design.settings.crossover: it reaches {high.si:g} Hz, and the controller "
                f"{axis.controller!r} on clock {clock!r} has none at {nyquist_hz:g} Hz or above",
                place=place,
                remedy="Lower it.",
            )
    return (
        [float(np.log(low.si)), float(np.degrees(least.si))],
        [float(np.log(high.si)), float(np.degrees(most.si))],
    )


def _levels(design: Design) -> tuple[float, ...]:
    if design.settings.acceleration is None:
        return (1.0,)
    low, high = (q.si for q in design.settings.acceleration)
    if low == high:
        return (high,)
    return tuple(float(v) for v in np.geomspace(low, high, _LEVELS)[::-1])


def _delays(design: Design) -> FloatArray:
    if design.settings.needle_delay is None:
        return np.empty(0)
    low, high = (q.si for q in design.settings.needle_delay)
    return np.linspace(low, high, max(round((high - low) / _DELAY_STEP_S) + 1, 1))
