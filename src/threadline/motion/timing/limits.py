"""The exact extremes of a trajectory, compared with the limits of the machine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf
from typing import Literal

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import LimitError
from threadline.machine import Machine
from threadline.machine.load import place_in
from threadline.motion.timing.extremes import derivatives, farthest, highest, in_direction
from threadline.motion.timing.types import Trajectory, TrajectoryBlock

Quantity = Literal["travel", "velocity", "acceleration", "deceleration", "jerk"]
ALLOWED = 1.001  # of a limit, anywhere
_ORDER: tuple[Quantity, ...] = ("travel", "velocity", "acceleration", "jerk")
_BRAKING: Quantity = "deceleration"
_LISTED: tuple[Quantity, ...] = ("travel", "velocity", "acceleration", _BRAKING, "jerk")
_UNIT = {"travel": "", "velocity": "/s", "acceleration": "/s^2", _BRAKING: "/s^2", "jerk": "/s^3"}
# Joints: a step of the velocity or acceleration above this share of the limit is a jump.
_STEP = 1e-6
_ROUNDING = 8 * float(np.finfo(np.float64).eps)  # of a position


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """The largest demand on one limit of one axis.

    Parameters
    ----------
    value_si, limit_si
        m, m/s ... or rad, rad/s ...; for travel the position nearest to or farthest beyond an
        end and that end. A step of the velocity counts as infinite acceleration and jerk, a step of
        the acceleration as infinite jerk.
    ratio
        Used share of the limit; for travel 1 at the end and 0 in the middle.
    time_s, operation
        Time and operation.
    """

    axis: str
    quantity: Quantity
    value_si: float
    limit_si: float
    ratio: float
    time_s: float
    operation: int


def limit_peaks(trajectory: Trajectory, machine: Machine) -> tuple[Peak, ...]:
    """Return the peak of every axis and limit, in the order of the axes.

    Extremes within the pieces count: each piece whose Bernstein coefficients could exceed the
    peak so far is searched for the roots of its next derivative. If an axis has a braking limit of
    its own, speeding up and braking are searched separately.
    """
    columns = [machine.axis_names.index(axis) for axis in trajectory.axes]
    low, high = machine.travel[columns].T
    speeding, braking = (limit[columns] for limit in machine.accelerations)
    limits = {
        "velocity": machine.velocity_limit[columns],
        "acceleration": np.maximum(speeding, braking),
        "jerk": machine.jerk_limit[columns],
    }
    found: dict[tuple[int, Quantity], Peak] = {}
    end_rates: tuple[FloatArray, FloatArray] | None = None
    last_block: TrajectoryBlock | None = None
    for block in trajectory:
        polys = [derivatives(block, j, len(_ORDER) - 1) for j in range(len(trajectory.axes))]
        for j, axis in enumerate(trajectory.axes):
            for order, quantity in enumerate(_ORDER):
                if quantity == "travel":
                    if not (np.isfinite(low[j]) and np.isfinite(high[j])):
                        continue
                    centre, half_range = 0.5 * (low[j] + high[j]), 0.5 * (high[j] - low[j])
                else:
                    centre, half_range = 0.0, float(limits[quantity][j])
                if quantity == "acceleration" and speeding[j] != braking[j]:
                    sides = float(speeding[j]), float(braking[j])
                    _search_sides(found, j, polys[j], block, axis, sides)
                    continue
                key = (j, quantity)
                _search(found, key, polys[j][order], block, axis, float(centre), float(half_range))
        end_rates = _joints(found, block, polys, end_rates, trajectory.axes, limits)
        last_block = block
    if last_block is not None:
        _end(found, last_block, trajectory.axes, limits)
    return tuple(
        found[j, quantity]
        for j in range(len(trajectory.axes))
        for quantity in _LISTED
        if (j, quantity) in found
    )


def check_limits(trajectory: Trajectory, machine: Machine) -> tuple[Peak, ...]:
    """Return the peaks; refuse a trajectory that exceeds a limit, unless it is historical.

    Raises
    ------
    LimitError
        If a peak exceeds 1.001 of its limit, or the tool a limit along the path (``path_use``).
    """
    peaks = limit_peaks(trajectory, machine)
    if trajectory.historical:
        return peaks
    _check_along(trajectory, machine)
    for peak in peaks:
        if peak.ratio > ALLOWED:
            length = "m" if machine.axes[peak.axis].kind == "linear" else "rad"
            unit = length + _UNIT[peak.quantity]
            raise LimitError(
                f"axis {peak.axis}: {peak.quantity} reaches {peak.value_si:.6g} {unit} at "
                f"{peak.time_s:.4f} s (operation {peak.operation}); the limit is "
                f"{peak.limit_si:.6g} {unit}",
                axis=peak.axis,
                quantity=peak.quantity,
                value_si=peak.value_si,
                limit_si=peak.limit_si,
                remedy="Plan with another interpolation, or with a lower feed.",
            )
    return peaks


def _check_along(trajectory: Trajectory, machine: Machine) -> None:
    if machine.path is None:
        return
    from threadline.motion.timing.optimal.along_path import path_use
    from threadline.motion.timing.optimal.motion_limits import along_of

    columns = [machine.axis_names.index(axis) for axis in trajectory.axes]
    path_limits = along_of(machine, machine.radius_m[columns])
    use = None if path_limits is None else path_use(trajectory, path_limits)
    if use is None or use.share <= ALLOWED:
        return
    key = f"path.{use.quantity}"
    unit = {"velocity": "m/s", "jerk": "m/s^3"}.get(use.quantity, "m/s^2")
    raise LimitError(
        f"{use.share:.6g} of {key}, {use.limit_si:.6g} {unit}, at {use.time_s:.4f} s "
        f"(operation {use.operation})",
        axis="",
        quantity=key,
        value_si=use.share * use.limit_si,
        limit_si=use.limit_si,
        place=place_in(machine, key),
        remedy="Plan with --interpolation optimal, which knows this limit, for the motors and "
        "without a shaper, or lower the feed.",
    )


def _search_sides(
    found: dict[tuple[int, Quantity], Peak],
    j: int,
    polys: Sequence[FloatArray],
    block: TrajectoryBlock,
    axis: str,
    sides: tuple[float, float],
) -> None:
    """Take the largest acceleration of one axis while it speeds up, and while it brakes."""
    push_along, piece, begin, width = in_direction(polys[1], polys[2])
    quantities: tuple[Quantity, Quantity] = ("acceleration", _BRAKING)
    for quantity, sign, limit in zip(quantities, (1.0, -1.0), sides, strict=True):
        key = (j, quantity)
        known_peak = found.get(key)
        peak_found = highest(sign * push_along, -1.0 if known_peak is None else known_peak.value_si)
        if peak_found is None:
            continue
        value, i, u = peak_found
        k = int(piece[i])
        found[key] = Peak(
            axis=axis,
            quantity=quantity,
            value_si=value,
            limit_si=limit,
            ratio=value / limit,
            time_s=float(block.start_s[k] + (begin[i] + u * width[i]) * block.duration_s[k]),
            operation=int(block.operation[k]),
        )


def _search(
    found: dict[tuple[int, Quantity], Peak],
    key: tuple[int, Quantity],
    poly: FloatArray,
    block: TrajectoryBlock,
    axis: str,
    centre: float,
    half_range: float,
) -> None:
    """Take the largest |derivative - centre| of one axis in one block into ``found``."""
    poly = np.concatenate([poly[:1] - centre, poly[1:]])
    peak, known_peak = -1.0, found.get(key)
    if known_peak is not None:
        peak = known_peak.ratio * half_range if half_range < inf else abs(known_peak.value_si)
    peak_found = farthest(poly, peak)
    if peak_found is None:
        return
    _, i, u = peak_found
    value = float(np.polyval(poly[::-1, i], u))
    quantity = key[1]
    limit = centre + half_range if (quantity != "travel" or value > 0) else centre - half_range
    found[key] = Peak(
        axis=axis,
        quantity=quantity,
        value_si=value + centre,
        limit_si=limit,
        ratio=abs(value) / half_range,
        time_s=float(block.start_s[i] + u * block.duration_s[i]),
        operation=int(block.operation[i]),
    )


def _joints(
    found: dict[tuple[int, Quantity], Peak],
    block: TrajectoryBlock,
    polys: Sequence[Sequence[FloatArray]],
    end_rates: tuple[FloatArray, FloatArray] | None,
    axes: tuple[str, ...],
    limits: dict[str, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Take steps of velocity and acceleration at the starts of the pieces into ``found``."""
    begin = [np.stack([poly[order][0] for poly in polys], axis=1) for order in (1, 2)]
    end = [np.stack([poly[order].sum(axis=0) for poly in polys], axis=1) for order in (1, 2)]
    rest = np.zeros((1, len(axes)))
    places = np.stack([poly[0][0] for poly in polys], axis=1)
    for k, (name, infinite_quantities) in enumerate(
        (("velocity", ("acceleration", "jerk")), ("acceleration", ("jerk",)))
    ):
        rate_before = rest if end_rates is None else end_rates[k][None]
        step = np.abs(begin[k] - np.concatenate([rate_before, end[k][:-1]]))
        # Huge values have large roundings, and in a piece of microseconds the rounding of a
        # position is a step.
        least_step = _STEP * np.maximum(limits[name], np.abs(begin[k]).max(axis=0))
        shortest_s = np.minimum(block.duration_s, np.roll(block.duration_s, 1))[:, None]
        least_step = np.maximum(least_step, _ROUNDING * np.abs(places) / shortest_s ** (k + 1))
        for i, j in _first_steps(step > least_step):
            where = (float(block.start_s[i]), int(block.operation[i]))
            _jump(found, j, axes[j], infinite_quantities, limits, where)
    return end[0][-1], end[1][-1]


def _end(
    found: dict[tuple[int, Quantity], Peak],
    block: TrajectoryBlock,
    axes: tuple[str, ...],
    limits: dict[str, FloatArray],
) -> None:
    """Take the step to rest at the end into ``found``."""
    where = (block.end_s, int(block.operation[-1]))
    for order, name, infinite_quantities in (
        (1, "velocity", ("acceleration", "jerk")),
        (2, "acceleration", ("jerk",)),
    ):
        end_rate = block.evaluate(np.array([block.end_s]), order)[0]
        for j in np.flatnonzero(np.abs(end_rate) > _STEP * limits[name]):
            _jump(found, int(j), axes[j], infinite_quantities, limits, where)


def _first_steps(
    stepped: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
) -> Iterator[tuple[int, int]]:
    for j in np.flatnonzero(stepped.any(axis=0)):
        yield int(np.argmax(stepped[:, j])), int(j)


def _jump(
    found: dict[tuple[int, Quantity], Peak],
    j: int,
    axis: str,
    broken: tuple[str, ...],
    limits: dict[str, FloatArray],
    where: tuple[float, int],
) -> None:
    for quantity in _ORDER:
        limit = float(limits[quantity][j]) if quantity in broken else 0.0
        if quantity not in broken or limit == inf:
            continue
        if (j, quantity) in found and found[j, quantity].ratio == inf:
            continue
        found[j, quantity] = Peak(
            axis=axis,
            quantity=quantity,
            value_si=inf,
            limit_si=limit,
            ratio=inf,
            time_s=where[0],
            operation=where[1],
        )
