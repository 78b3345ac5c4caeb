"""A slow twin, written from the documents and the equations: numpy, scipy and exact fractions.

Nothing here uses the engine; ``reference_plant.py`` has the network, and this file its controllers,
converters and sensors, at instants that are exact fractions.

Both must agree to 1e-6 counts without quantisers. The difference comes from two ways to round: the
engine widens the bounds of its modes by 1e-12, and this twin by 1e-13.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from tests.twin.reference_plant import Plant
from threadline.machine import Machine

ROUND = {"nearest": np.rint, "floor": np.floor, "truncate": np.trunc}


@dataclass
class Loop:
    """A controller: its difference equation, its memory, and the levels under way."""

    name: str
    b: tuple[float, float, float]
    a: tuple[float, float]
    period: Fraction
    delay: Fraction
    errors: list[float] = field(default_factory=lambda: [0.0, 0.0])
    outputs: list[float] = field(default_factory=lambda: [0.0, 0.0])
    level: float = 0.0
    arriving: dict[Fraction, float] = field(default_factory=dict)


def difference(controller) -> tuple[tuple[float, float, float], tuple[float, float]]:
    """Give ``b``, ``a`` of ``u = b0 e + b1 e' + b2 e'' - a1 u' - a2 u''``.

    docs/machine-file.md has the laws.
    """

    def gain(name):
        return getattr(controller, name).si

    match controller.kind:
        case "p":
            return (gain("kp"), 0.0, 0.0), (0.0, 0.0)
        case "pd":
            return (gain("kp") + gain("kd"), -gain("kd"), 0.0), (0.0, 0.0)
        case "pi":
            return (gain("kp") + gain("ki"), -gain("kp"), 0.0), (-1.0, 0.0)
        case "pid":
            p, i, d = gain("kp"), gain("ki"), gain("kd")
            return (p + i + d, -p - 2.0 * d, d), (-1.0, 0.0)
        case "lead":
            return (gain("gain"), -gain("gain") * gain("zero"), 0.0), (gain("pole"), 0.0)
        case "proportional-velocity":
            return (gain("gain"), -gain("gain"), 0.0), (0.0, 0.0)
    raise AssertionError(controller.kind)


def reference_run(
    machine: Machine,
    rows: dict[str, np.ndarray],
    *,
    quantised: bool = True,
    phases: dict[str, float] | None = None,
    settle: int = 20,
    start: dict[str, float] | None = None,
) -> tuple[dict[str, np.ndarray], int]:
    """Return what each channel is at the ticks, and how often a law changed.

    Parameters
    ----------
    rows
        Per axis counts per tick.
    phases
        Per axis where between two counts its encoder stands at rest; a half when left out.
    settle
        Ticks after the last row.
    start
        Per axis where it stands before, m or rad.
    """
    begin = {a: (start or {}).get(a, 0.0) for a in machine.axes}
    plant = Plant(machine, begin)
    tick = machine.tick_clock.period_s
    loops = {}
    owner = {axis.controller: a for a, axis in machine.axes.items()}
    for name, controller in machine.controllers.items():
        delay = machine.drives[controller.drive].delay
        exact = Fraction(0) if delay is None else delay.exact_s
        b, a = difference(controller)
        loops[name] = Loop(name, b, a, machine.clock(controller.clock).period_s, exact)
    count = len(next(iter(rows.values()))) + settle + 1
    travelled = {
        a: np.concatenate(
            (
                [0],
                np.cumsum(rows.get(a, np.zeros(1))),
            )
        )
        for a in machine.axes
    }
    end = tick * (count - 1)
    instants = {tick * k for k in range(count)}
    for loop in loops.values():
        given = [loop.period * k for k in range(int(end / loop.period) + 1)]
        instants |= {i for i in (*given, *(g + loop.delay for g in given)) if i <= end}
    found: dict[str, list[float]] = {}
    ordered = sorted(instants)
    for now, then in zip(ordered, [*ordered[1:], None], strict=True):
        if now % tick == 0:
            _sample(machine, plant, loops, begin, phases or {}, quantised, found)
        at = int(now // tick)
        for loop in loops.values():
            if now % loop.period == 0:
                axis = owner.get(loop.name)
                way = np.zeros(1) if axis is None else travelled[axis]
                expected = float(way[min(at, len(way) - 1)])
                _act(machine, plant, loop, expected, (phases or {}).get(axis, 0.5), quantised, now)
            if now in loop.arriving:
                _arrive(machine, plant, loop, loop.arriving.pop(now))
        if then is not None:
            plant.advance(float(then - now))
    return {name: np.array(values) for name, values in found.items()}, plant.changes


def _seen(machine, plant, controller, phase, quantised) -> float:
    sensor = machine.sensors[controller.sensor]
    exact = float(plant.weights(sensor.reads) @ plant.z)
    if not quantised:
        return exact
    if getattr(sensor, "rounding", "nearest") == "nearest":
        return float(np.floor(exact + phase))
    return float(ROUND[sensor.rounding](exact + phase - 0.5))


def _act(machine, plant, loop, expected, phase, quantised, now) -> None:
    controller = machine.controllers[loop.name]
    e = expected - _seen(machine, plant, controller, phase, quantised)
    (b0, b1, b2), (a1, a2) = loop.b, loop.a
    u = b0 * e + b1 * loop.errors[0] + b2 * loop.errors[1]
    u -= a1 * loop.outputs[0] + a2 * loop.outputs[1]
    half = 2.0 ** (controller.dac.bits.si - 1)
    rounded = ROUND[getattr(controller.dac, "rounding", "nearest")](u) if quantised else u
    level = float(np.clip(rounded, -half, half - 1))
    loop.errors = [e, loop.errors[0]]
    loop.outputs = [float(np.clip(u, -half, half - 1)), loop.outputs[0]]
    if controller.dac.zero_on_reversal and level * loop.level < 0:
        level = 0.0
    loop.level = level
    loop.arriving[now + loop.delay] = level


def _arrive(machine, plant, loop, level) -> None:
    controller = machine.controllers[loop.name]
    amplifier = machine.drives[controller.drive].amplifier
    volts = level * 2.0 * controller.dac.range.si / 2.0**controller.dac.bits.si
    given = volts * amplifier.gain.si
    limit = amplifier.voltage_limit if amplifier.mode == "voltage" else amplifier.current_limit
    if limit is not None:
        given = float(np.clip(given, -limit.si, limit.si))
    plant.z[plant.input[controller.drive]] = given


def _sample(machine, plant, loops, begin, phases, quantised, found) -> None:
    def add(name, value):
        found.setdefault(name, []).append(float(value))

    for name, axis in machine.axes.items():
        controller = machine.controllers[axis.controller]
        volt = 2.0 * controller.dac.range.si / 2.0**controller.dac.bits.si
        seen = _seen(machine, plant, controller, phases.get(name, 0.5), quantised)
        add(f"{name}.load", begin[name] + plant.load[name] @ plant.z)
        add(f"{name}.velocity", plant.load[name] @ plant.A @ plant.z)
        add(f"{name}.measured", begin[name] + seen / axis.counts.si)
        add(f"{name}.voltage", loops[axis.controller].level * volt)
        motor = plant.motors[controller.drive]
        add(f"{name}.current", motor.law() @ plant.z)
        if axis.frame is not None:
            add(f"{name}.frame", plant.weights(axis.frame) @ plant.z)
    closed = {controller.sensor for controller in machine.controllers.values()}
    for name, sensor in machine.sensors.items():
        if name not in closed:
            assert sensor.kind == "potentiometer", "the others have tests of their own"
            add(f"{name}.sensor", plant.weights(sensor.reads) @ plant.z)
    tripped = [t for motor in plant.motors.values() for t in motor.tripped]
    for name in machine.inputs:
        add(name, name in tripped)
