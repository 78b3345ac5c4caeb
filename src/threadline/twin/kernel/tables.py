"""Equations and controllers as plain arrays, for kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.dynamics.groups import Group
from threadline.dynamics.matrix_controller import LoopPart, loop_parts
from threadline.dynamics.network import PiecewiseLinear
from threadline.dynamics.sampled import difference_equation
from threadline.dynamics.values import Values
from threadline.machine import Machine
from threadline.machine.controllers import (
    ProfileController,
    StateSpaceController,
    TrapezoidController,
)
from threadline.machine.parts import Encoder
from threadline.machine.quantity import Quantity

ROW_GUARD, NET_GUARD = 1, 2
_RELATIVE_SLACK = 1e-12
_PROFILES = {"integral-velocity": "speed", "trapezoid": "target"}


class PlantTables(NamedTuple):
    """A piecewise linear system; V variants, n states, N = n + inputs + 1, E elements.

    M is the largest number of modes of an element, and G of guards of a mode. Bounds of guards are
    widened by 1e-12, so that a mode entered at a bound is not left at once.
    """

    base: FloatArray  # (V, n, N)
    direction: FloatArray  # (V, E, n)
    law: FloatArray  # (V, E, M, N)
    held_at: FloatArray  # (V, E, M)
    net_scale: FloatArray  # (V, E, M)
    guard_row: FloatArray  # (V, E, M, G, N)
    guard_low: FloatArray  # (V, E, M, G)
    guard_high: FloatArray  # (V, E, M, G)
    modes: IntArray  # (E,)
    holds: IntArray  # (E, M)
    guard_kind: IntArray  # (E, M, G): 0 for none
    guard_to: IntArray  # (E, M, G, 2): next mode below, above
    guard_switch: IntArray  # (E, M, G)
    guards: IntArray  # (E,) most guards of any mode
    drive_element: IntArray  # (drives,) the element whose law is the drive's current


class Bank(NamedTuple):
    """A state-space controller; n states, m loops, q inputs.

    The inputs are the references and readings of its loops, then ``sensors``: indices of observing
    sensors of the piece.
    """

    A: FloatArray  # (n, n)
    B: FloatArray  # (n, q)
    C: FloatArray  # (m, n)
    D: FloatArray  # (m, q)
    L: FloatArray  # (n, m)
    sensors: tuple[int, ...]


class SensorTables(NamedTuple):
    """The S observing sensors of a piece."""

    names: tuple[str, ...]
    sees: FloatArray  # (V, S, N)
    feels: FloatArray  # (V, S, n)
    rounding: tuple[str, ...]  # (S,) as in ``shape``
    offset: tuple[float, ...]  # (S,)
    grain: FloatArray  # (V, S) step of the reading, 1 for an encoder
    span: FloatArray  # (V, S) largest reading to either side
    noise: FloatArray  # (V, S) standard deviation


class ControlTables(NamedTuple):
    """Digital controllers ``u = b0 e + b1 e' + b2 e'' - a1 u' - a2 u''`` in DAC levels.

    K controllers, a state-space controller once for each of its loops; primes are earlier ticks, u
    before rounding.
    """

    numerator: FloatArray  # (V, K, 3)
    denominator: FloatArray  # (V, K, 2)
    sensor_row: FloatArray  # (V, K, N) counts
    volt_per_level: FloatArray  # (V, K)
    level_low: FloatArray  # (V, K)
    level_high: FloatArray  # (V, K)
    gain: FloatArray  # (V, K) volts to the drive's input
    limit: FloatArray  # (V, K) of the drive's input
    drive: IntArray  # (K,) index of the input
    zero_on_reversal: IntArray  # (K,)
    profile: tuple[str, ...]  # (K,) as in ``shape``
    encoder: tuple[str, ...]  # (K,) rounding of its encoder, from the machine file
    dac: tuple[str, ...]  # (K,) rounding of its DAC
    acceleration: FloatArray  # (V, K) counts per tick squared, whole 256ths
    fastest: FloatArray  # (V, K) counts per tick
    per_tick: FloatArray  # (V, K) reference ticks per filter tick
    banks: tuple[Bank | None, ...]  # (K,) of the first loop of a state-space controller
    banked: tuple[bool, ...]  # (K,) whether it is a loop of such a controller


def plant_tables(piece: PiecewiseLinear) -> PlantTables:
    """Return the arrays of ``piece``."""
    elements, variants = piece.elements, piece.variants
    n, size = piece.base.shape[1:]
    count = len(elements)
    most_modes = max((len(e.modes) for e in elements), default=1)
    guards = [max(len(m.guards) for m in e.modes) for e in elements]
    most_guards = max([1, *guards])
    shape = (variants, count, most_modes, most_guards)
    tables = PlantTables(
        base=np.ascontiguousarray(piece.base),
        direction=np.zeros((variants, count, n)),
        law=np.zeros((variants, count, most_modes, size)),
        held_at=np.zeros(shape[:3]),
        net_scale=np.ones(shape[:3]),
        guard_row=np.zeros((*shape, size)),
        guard_low=np.full(shape, -np.inf),
        guard_high=np.full(shape, np.inf),
        modes=np.array([len(e.modes) for e in elements], dtype=np.int64),
        holds=np.full((count, most_modes), -1, dtype=np.int64),
        guard_kind=np.zeros(shape[1:], dtype=np.int64),
        guard_to=np.full((*shape[1:], 2), -1, dtype=np.int64),
        guard_switch=np.full(shape[1:], -1, dtype=np.int64),
        guards=np.array(guards, dtype=np.int64),
        drive_element=np.array(
            [[e.name for e in elements].index(f"drives.{d}") for d in piece.group.drives],
            dtype=np.int64,
        ),
    )
    for e, element in enumerate(elements):
        tables.direction[:, e] = element.direction
        for m, mode in enumerate(element.modes):
            tables.law[:, e, m] = mode.law
            tables.holds[e, m] = mode.holds
            tables.held_at[:, e, m] = mode.held_at
            tables.net_scale[:, e, m] = mode.net_scale
            for g, guard in enumerate(mode.guards):
                at = (slice(None), e, m, g)
                tables.guard_low[at] = _widened(guard.low, -1.0)
                tables.guard_high[at] = _widened(guard.high, 1.0)
                tables.guard_kind[e, m, g] = NET_GUARD if guard.row is None else ROW_GUARD
                if guard.row is not None:
                    tables.guard_row[at] = guard.row
                tables.guard_to[e, m, g] = (guard.low_to, guard.high_to)
                tables.guard_switch[e, m, g] = guard.switch
    return tables


def _widened(bound: FloatArray | float, sign: float) -> FloatArray:
    value = np.asarray(bound, dtype=np.float64)
    return value + sign * _RELATIVE_SLACK * np.maximum(1.0, np.abs(value))


def control_tables(machine: Machine, piece: PiecewiseLinear, values: Values) -> ControlTables:
    """Return the arrays of the controllers of ``piece``."""
    group = piece.group
    parts = loop_parts(machine, group.controllers)
    variants, count = piece.variants, len(parts)
    size = piece.base.shape[2]
    tables = ControlTables(
        numerator=np.zeros((variants, count, 3)),
        denominator=np.zeros((variants, count, 2)),
        sensor_row=np.zeros((variants, count, size)),
        volt_per_level=np.zeros((variants, count)),
        level_low=np.zeros((variants, count)),
        level_high=np.zeros((variants, count)),
        gain=np.zeros((variants, count)),
        limit=np.zeros((variants, count)),
        drive=np.zeros(count, dtype=np.int64),
        zero_on_reversal=np.zeros(count, dtype=np.int64),
        profile=tuple(_PROFILES.get(part.settings.kind, "") for part in parts),
        encoder=tuple(_encoder_rounding(machine, part.settings.sensor) for part in parts),
        dac=tuple(part.settings.dac.rounding for part in parts),
        acceleration=np.zeros((variants, count)),
        fastest=np.zeros((variants, count)),
        per_tick=np.zeros((variants, count)),
        banks=tuple(_bank(machine, group, part) for part in parts),
        banked=tuple(part.settings.kind == "state-space" for part in parts),
    )
    for k, part in enumerate(parts):
        path, loop = f"controllers.{part.controller}", part.settings
        controller = machine.controllers[part.controller]
        bits = values.at(f"{path}.dac.bits", loop.dac.bits)
        volts = values.at(f"{path}.dac.range", loop.dac.range)
        drive = group.drives.index(loop.drive)
        half = 2.0 ** (np.asarray(bits) - 1.0)
        if not isinstance(controller, StateSpaceController):
            tables.numerator[:, k], tables.denominator[:, k] = difference_equation(
                machine, part.controller, values
            )
        tables.sensor_row[:, k] = piece.sensor_rows[:, group.sensors.index(loop.sensor)]
        tables.volt_per_level[:, k] = volts / half
        tables.level_low[:, k] = -half
        tables.level_high[:, k] = half - 1.0
        tables.gain[:, k] = piece.input_gain[:, drive]
        tables.limit[:, k] = piece.input_limit[:, drive]
        tables.drive[k] = drive
        tables.zero_on_reversal[k] = loop.dac.zero_on_reversal
        if isinstance(controller, ProfileController):
            pushed = np.asarray(values.at(f"{path}.acceleration", controller.acceleration))
            tables.acceleration[:, k] = np.rint(256.0 * pushed) / 256.0
            filter_s = machine.clock(controller.clock).period_s
            tables.per_tick[:, k] = float(filter_s / machine.tick_clock.period_s)
        if isinstance(controller, TrapezoidController):
            tables.fastest[:, k] = values.at(f"{path}.velocity", controller.velocity)
    return tables


def _bank(machine: Machine, group: Group, part: LoopPart) -> Bank | None:
    controller = machine.controllers[part.controller]
    if part.place or not isinstance(controller, StateSpaceController):
        return None
    others = _observing(machine, group)
    return Bank(
        A=controller.matrix("A"),
        B=controller.matrix("B"),
        C=controller.matrix("C"),
        D=controller.matrix("D"),
        L=controller.matrix("L"),
        sensors=tuple(others.index(s) for s in controller.sensors[len(controller.references) :]),
    )


def _observing(machine: Machine, group: Group) -> tuple[str, ...]:
    return tuple(name for name in machine.observing if name in group.sensors)


def sensor_tables(machine: Machine, piece: PiecewiseLinear, values: Values) -> SensorTables:
    """Return the arrays of the observing sensors of ``piece``."""
    names = _observing(machine, piece.group)
    at = [piece.group.sensors.index(name) for name in names]
    shape = piece.variants, len(names)
    tables = SensorTables(
        names=names,
        sees=piece.sensor_rows[:, at],
        feels=piece.felt_rows[:, at],
        rounding=tuple(_rounding(machine, name) for name in names),
        offset=tuple(0.5 if _encoder_rounding(machine, n) == "nearest" else 0.0 for n in names),
        grain=np.ones(shape),
        span=np.full(shape, np.inf),
        noise=np.zeros(shape),
    )
    for s, name in enumerate(names):
        sensor = machine.sensors[name]
        if isinstance(sensor, Encoder):
            continue
        for column, key in (
            (tables.grain, "resolution"), (tables.span, "range"), (tables.noise, "noise"),
        ):  # fmt: skip
            quantity: Quantity | None = getattr(sensor, key)
            if quantity is not None:
                column[:, s] = values.at(f"sensors.{name}.{key}", quantity)
    return tables


def _rounding(machine: Machine, name: str) -> str:
    sensor = machine.sensors[name]
    if isinstance(sensor, Encoder):
        return "trunc" if sensor.rounding == "truncate" else "floor"
    return "" if sensor.resolution is None else "floor"


def _encoder_rounding(machine: Machine, name: str) -> str:
    sensor = machine.sensors[name]
    return sensor.rounding if isinstance(sensor, Encoder) else "nearest"
