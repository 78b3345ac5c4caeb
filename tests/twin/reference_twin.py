"""A slow twin, written from the documents and the equations: numpy, scipy and exact fractions.

Nothing here comes from the engine or from the machine's equations in the package; the machine file
gives the numbers. Each part of the network is one affine law at a time; between two instants the
whole is ``z' = A z`` with ``z = [states, inputs, 1]``, whose exponential gives it at any time. What
ends a law is watched on a grid of an eighth of the fastest rate, and between its points at every
peak; Brent's method finds the place on the series of the exponential, taken to 1e-43.

Agreement that is asked for: 1e-6 counts without quantisers. What is left is the difference between
two ways to round: the engine widens the bounds of its modes by 1e-12, so does this one by 1e-13.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from threadline.machine import Machine

PER_RATE = 8.0
SLACK = 1e-13
MOST_CHANGES = 400
TERMS = 24  # the last is an eighth to its power, over its factorial: 1e-43 of the first


@dataclass
class Watch:
    """A law holds while ``row . z <= 0``; then ``leave`` makes it another."""

    row: np.ndarray
    leave: Callable[[np.ndarray], None]

    def slack(self) -> float:
        return SLACK * max(1.0, abs(float(self.row[-1])))


@dataclass
class Held:
    """A state that stands still at a value while the force on it is within bounds."""

    state: int
    scale: float  # of its derivative, to the force that is watched
    low: float
    high: float
    leave_low: Callable[[np.ndarray], None]
    leave_high: Callable[[np.ndarray], None]


class Part:
    """A force or current that is ``row . z`` in each of its modes; ``mode`` is the one in force."""

    mode = "free"

    def __init__(self, direction: np.ndarray) -> None:
        self.direction = direction  # what a unit of it adds to the derivative of z

    def law(self) -> np.ndarray:
        raise AssertionError

    def watches(self) -> Iterator[Watch]:
        return iter(())

    def held(self) -> Held | None:
        return None

    def to(self, mode: str) -> Callable[[np.ndarray], None]:
        def change(_z: np.ndarray) -> None:
            self.mode = mode

        return change


class Belt(Part):
    """Two runs, each pulls with ``max(0, P + its share of the spring's force)``."""

    def __init__(self, direction, spring, preload, first) -> None:
        super().__init__(direction)
        self.spring, self.preload, self.first = spring, preload, first
        self.mode = "both"

    def law(self) -> np.ndarray:
        row = self.spring.copy()
        if self.mode == "first":
            row = self.first * row
            row[-1] += self.preload
        if self.mode == "second":
            row = (1.0 - self.first) * row
            row[-1] -= self.preload
        return row

    def watches(self) -> Iterator[Watch]:
        first, second = -self.first * self.spring, (1.0 - self.first) * self.spring
        first[-1] -= self.preload  # above 0: the first run is slack
        second[-1] -= self.preload  # above 0: the second
        if self.mode == "both":
            yield Watch(first, self.to("second"))
            yield Watch(second, self.to("first"))
        else:
            yield Watch(-(second if self.mode == "first" else first), self.to("both"))


class Play(Part):
    """A dead band; a contact pushes and never pulls, and with damping lets go before its edge."""

    def __init__(self, direction, stretch, spring, stiffness, width, damped) -> None:
        super().__init__(direction)
        self.stretch, self.damped = stretch, damped
        self.half, self.push = 0.5 * width, {}
        for side, sign in (("above", 1.0), ("below", -1.0)):
            self.push[side] = sign * spring
            self.push[side][-1] -= stiffness * self.half

    def edge(self, side: str) -> np.ndarray:
        """Return a row that is above 0 beyond the edge."""
        row = self.stretch * (1.0 if side == "above" else -1.0)
        row[-1] -= self.half
        return row

    def law(self) -> np.ndarray:
        if self.mode not in self.push:
            return 0.0 * self.stretch
        return self.push[self.mode] * (1.0 if self.mode == "above" else -1.0)

    def watches(self) -> Iterator[Watch]:
        if self.mode == "free":
            for side in ("above", "below"):
                yield Watch(self.edge(side), self.to(side))
        elif self.mode in self.push:
            after = f"parting {self.mode}" if self.damped else "free"
            yield Watch(-self.push[self.mode], self.to(after))
        else:
            side = self.mode.removeprefix("parting ")
            yield Watch(-self.edge(side), self.to("free"))
            yield Watch(self.push[side], self.to(side))


class Friction(Part):
    """Coulomb's: a body sticks up to the breakaway force and slides against the lower one."""

    def __init__(self, direction, speed, inertia, sliding, breakaway) -> None:
        super().__init__(direction)
        self.speed, self.inertia = speed, inertia
        self.sliding, self.breakaway = sliding, breakaway
        self.mode = "stick"

    def law(self) -> np.ndarray:
        row = np.zeros_like(self.direction)
        row[-1] = {"stick": 0.0, "forwards": -self.sliding, "backwards": self.sliding}[self.mode]
        return row

    def stop(self, z: np.ndarray) -> None:
        self.mode = "stick"
        z[self.speed] = 0.0

    def watches(self) -> Iterator[Watch]:
        if self.mode != "stick":
            row = np.zeros_like(self.direction)
            row[self.speed] = -1.0 if self.mode == "forwards" else 1.0
            yield Watch(row, self.stop)

    def held(self) -> Held | None:
        if self.mode != "stick":
            return None
        return Held(
            self.speed, self.inertia, -self.breakaway, self.breakaway,
            self.to("backwards"), self.to("forwards"),
        )  # fmt: skip


class Motor(Part):
    """A current: free, at a limit, or cut off for good by a switch.

    ``clamped`` is the state of a coil whose current itself is held at the limit, -1 where what is
    clipped is taken from a law or from an integrator that runs on.
    """

    def __init__(self, direction, free, upper, lower, clamped, scale) -> None:
        super().__init__(direction)
        self.free, self.upper, self.lower = free, upper, lower
        self.clamped, self.scale = clamped, scale
        self.switches: list[tuple[str, np.ndarray]] = []  # rows above 0 where closed
        self.tripped: list[str] = []

    def law(self) -> np.ndarray:
        if self.mode == "cut":
            return 0.0 * self.free
        if self.clamped >= 0 or self.mode == "free":
            return self.free
        return self.upper if self.mode == "upper" else self.lower

    def limit(self, mode: str) -> Callable[[np.ndarray], None]:
        def change(z: np.ndarray) -> None:
            self.mode = mode
            if self.clamped >= 0:
                z[self.clamped] = (self.upper if mode == "upper" else self.lower)[-1]

        return change

    def trip(self, name: str) -> Callable[[np.ndarray], None]:
        def change(z: np.ndarray) -> None:
            self.mode = "cut"
            self.tripped.append(name)
            if self.clamped >= 0:
                z[self.clamped] = 0.0

        return change

    def watches(self) -> Iterator[Watch]:
        if self.mode == "cut":
            return
        if self.mode == "free" and self.upper is not None:
            yield Watch(self.free - self.upper, self.limit("upper"))
            yield Watch(self.lower - self.free, self.limit("lower"))
        elif self.mode == "upper" and self.clamped < 0:
            yield Watch(self.upper - self.free, self.to("free"))
        elif self.mode == "lower" and self.clamped < 0:
            yield Watch(self.free - self.lower, self.to("free"))
        for name, row in self.switches:
            yield Watch(row, self.trip(name))

    def held(self) -> Held | None:
        if self.clamped < 0 or self.mode == "free":
            return None
        inf, free = np.inf, self.to("free")
        if self.mode == "cut":
            return Held(self.clamped, self.scale, -inf, inf, free, free)
        low, high = (0.0, inf) if self.mode == "upper" else (-inf, 0.0)
        return Held(self.clamped, self.scale, low, high, free, free)


class Plant:
    """All bodies of a machine as one system; ``z`` is its state with inputs and the constant."""

    def __init__(self, machine: Machine, start: dict[str, float]) -> None:
        bodies, drives = list(machine.bodies), list(machine.drives)
        coils = [
            d for d in drives
            if machine.drives[d].inductance and machine.drives[d].amplifier.mode == "voltage"
        ]  # fmt: skip
        n = len(bodies)
        self.states = 2 * n + len(coils)
        size = self.states + len(drives) + 1
        self.place = {b: i for i, b in enumerate(bodies)}
        self.rate = {b: n + i for i, b in enumerate(bodies)}
        self.coil = {d: 2 * n + i for i, d in enumerate(coils)}
        self.input = {d: self.states + i for i, d in enumerate(drives)}
        self.z = np.zeros(size)
        self.z[-1] = 1.0
        self.changes = 0
        self.A = np.zeros((size, size))
        self.parts: list[Part] = []
        self.kept: dict[tuple[object, ...], np.ndarray] = {}
        self.rates: dict[tuple[object, ...], float] = {}
        self.powers: dict[tuple[object, ...], np.ndarray] = {}
        self.equations: dict[tuple[object, ...], tuple[np.ndarray, list[Watch]]] = {}
        self.inertia = {b: body.inertia.si for b, body in machine.bodies.items()}

        def weights(given, where):
            row = np.zeros(size)
            for body, weight in (given or {}).items():
                row[where[body]] = weight.si
            return row

        def pushes(given, factor):
            row = np.zeros(size)
            for body, weight in given.items():
                row[self.rate[body]] = factor * weight.si / self.inertia[body]
            return row

        self.weights = lambda given: weights(given, self.place)
        for b, body in machine.bodies.items():
            self.A[self.place[b], self.rate[b]] = 1.0
            self.A[self.rate[b], self.rate[b]] -= _si(body.damping) / self.inertia[b]
        for link in machine.links.values():
            assert link.eccentric is None
            stretch, rate = weights(link.stretch, self.place), weights(link.stretch, self.rate)
            spring = link.stiffness.si * stretch + _si(link.damping) * rate
            direction = pushes(link.stretch, -1.0)
            if link.preload is not None:
                share = 0.5 if link.first_run is None else link.first_run.si
                self.parts.append(Belt(direction, spring, link.preload.si, share))
            elif link.play is not None:
                self.parts.append(
                    Play(direction, stretch, spring, link.stiffness.si, link.play.si,
                         _si(link.damping) > 0)
                )  # fmt: skip
            else:
                self.A += np.outer(direction, spring)
        self.motors = {name: self._motor(drive, name, weights, pushes)
                       for name, drive in machine.drives.items()}  # fmt: skip
        self.parts += self.motors.values()
        for b, body in machine.bodies.items():
            if body.friction is not None:
                direction = np.zeros(size)
                direction[self.rate[b]] = 1.0 / self.inertia[b]
                breakaway = (body.stiction or body.friction).si
                self.parts.append(
                    Friction(direction, self.rate[b], self.inertia[b], body.friction.si, breakaway)
                )
        self.load = {name: self._load(machine, name) for name in machine.axes}
        for name, switch in machine.inputs.items():
            row = self.load[switch.axis].copy()
            row[-1] -= switch.at.si - start[switch.axis]
            closed = row if switch.beyond == "above" else -row
            self.motors[switch.cuts].switches.append((name, closed))

    def _motor(self, drive, name, weights, pushes) -> Motor:
        amplifier, at = drive.amplifier, self.input[name]
        asked = np.zeros_like(self.z)
        asked[at] = 1.0
        back = drive.back_emf.si * weights(drive.acts_on, self.rate)
        ohm = drive.resistance.si
        constant = np.zeros_like(self.z)
        constant[-1] = 1.0
        amps = amplifier.current_limit
        upper = None if amps is None else amps.si * constant
        clamped, scale, free = -1, 1.0, (asked - back) / ohm
        if amplifier.mode == "current":
            free, upper = asked, None
            if amplifier.voltage_limit is not None:
                volts = amplifier.voltage_limit.si * constant
                direction = pushes(drive.acts_on, drive.torque_constant.si)
                return Motor(direction, free, (volts - back) / ohm, (-volts - back) / ohm, -1, 1.0)
        elif name in self.coil:
            state = self.coil[name]
            free = np.zeros_like(self.z)
            free[state] = 1.0
            self.A[state] = (asked - back - ohm * free) / drive.inductance.si
            if amplifier.limits == "state":
                clamped, scale = state, drive.inductance.si
        direction = pushes(drive.acts_on, drive.torque_constant.si)
        return Motor(direction, free, upper, None if upper is None else -upper, clamped, scale)

    def _load(self, machine: Machine, name: str) -> np.ndarray:
        axis = machine.axes[name]
        if axis.load is not None:
            return self.weights(axis.load)
        sensor = machine.sensors[machine.controllers[axis.controller].sensor]
        return self.weights(sensor.reads) / axis.counts.si

    def _equations(self) -> tuple[np.ndarray, list[Watch]]:
        """Return the generator of the modes in force and what ends one of them."""
        A = self.A.copy()
        watches: list[Watch] = []
        for part in self.parts:
            A += np.outer(part.direction, part.law())
        holds = [held for part in self.parts if (held := part.held()) is not None]
        for held in holds:
            force = held.scale * A[held.state]
            for sign, bound, leave in ((1.0, held.high, held.leave_high),
                                       (-1.0, -held.low, held.leave_low)):  # fmt: skip
                if np.isfinite(bound):
                    row = sign * force
                    row[-1] -= bound
                    watches.append(Watch(row, leave))
        for held in holds:
            A[held.state] = 0.0
        for part in self.parts:
            watches += part.watches()
        return A, watches

    def advance(self, span: float) -> None:
        """Go on for a time with the inputs as they are."""
        left = span
        for _ in range(MOST_CHANGES):
            modes = tuple(part.mode for part in self.parts)
            if modes not in self.equations:
                self.equations[modes] = self._equations()
            A, watches = self.equations[modes]
            left_now = next((w for w in watches if w.row @ self.z > w.slack()), None)
            if left_now is None:
                if left <= 0.0:
                    return
                time, left_now = self._until(A, watches, left)
                self.z = self._after(A, time, bool(watches))
                left -= time
            if left_now is not None:
                left_now.leave(self.z)
                self.changes += 1
        raise AssertionError("modes change without end")

    def _after(self, A: np.ndarray, time: float, watched: bool) -> np.ndarray:
        if watched:
            parts = max(1, ceil(PER_RATE * self._rate(A) * time))
            z = self.z
            for _ in range(parts):
                z = self._series(A, z, time / parts).sum(axis=0)
            return z
        key = (*(part.mode for part in self.parts), time)
        if key not in self.kept:
            self.kept[key] = expm(A * time)
        return self.kept[key] @ self.z

    def _rate(self, A: np.ndarray) -> float:
        modes = tuple(part.mode for part in self.parts)
        if modes not in self.rates:
            self.rates[modes] = float(np.abs(np.linalg.eigvals(A)).max())
        return self.rates[modes]

    def _series(self, A: np.ndarray, z: np.ndarray, time: float) -> np.ndarray:
        """Return the (TERMS, N) terms of ``exp(A t) z``, an eighth of the fastest rate at most."""
        modes = tuple(part.mode for part in self.parts)
        if modes not in self.powers:
            self.powers[modes] = powers(A)
        return self.powers[modes] @ z * (time ** np.arange(TERMS))[:, None]

    def _until(self, A, watches, left) -> tuple[float, Watch | None]:
        """Return the time of the first exit, and whose it is; all of ``left`` without one."""
        steps = max(2, ceil(PER_RATE * self._rate(A) * left))
        grid = left / steps
        if not watches:
            return left, None
        rows = np.array([w.row for w in watches])
        slack = np.array([w.slack() for w in watches])
        now = self.z
        for k in range(steps):
            terms = self._series(A, now, grid)  # of the state, over a part of the grid
            values = rows @ terms.T
            values[:, 0] -= slack
            ends = values.sum(axis=1)
            order = np.arange(values.shape[1])
            turns = (values[:, 1] > 0) & (values @ order < 0)
            found: list[tuple[float, Watch]] = []
            for i in np.flatnonzero((ends > 0) | turns):
                beyond = np.polynomial.Polynomial(values[i])
                end = 1.0
                if ends[i] <= 0:
                    end = float(brentq(beyond.deriv(), 0.0, 1.0, xtol=1e-16, rtol=1e-15))
                    if beyond(end) <= 0.0:
                        continue
                at = 0.0 if beyond(0.0) >= 0.0 else brentq(beyond, 0.0, end, xtol=1e-18, rtol=1e-15)
                found.append((at, watches[i]))
            if found:
                at, first = min(found, key=lambda item: item[0])
                return (k + at) * grid, first
            now = terms.sum(axis=0)
        return left, None


def powers(A: np.ndarray) -> np.ndarray:
    """Return the (TERMS, N, N) coefficients ``A**k / k!`` of the exponential."""
    found = [np.eye(len(A))]
    while len(found) < TERMS:
        found.append(A @ found[-1] / len(found))
    return np.array(found)


ROUND = {"nearest": np.rint, "floor": np.floor, "truncate": np.trunc}


@dataclass
class Loop:
    """A controller: its difference equation, what it remembers, and levels under way."""

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
    """Give ``b``, ``a`` of ``u = b0 e + b1 e' + b2 e'' - a1 u' - a2 u''`` (docs/machines.md)."""

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
                wanted = float(way[min(at, len(way) - 1)])
                _act(machine, plant, loop, wanted, (phases or {}).get(axis, 0.5), quantised, now)
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


def _act(machine, plant, loop, wanted, phase, quantised, now) -> None:
    controller = machine.controllers[loop.name]
    e = wanted - _seen(machine, plant, controller, phase, quantised)
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
        add(f"{name}.measured", begin[name] + seen / axis.counts.si)
        add(f"{name}.voltage", loops[axis.controller].level * volt)
        motor = plant.motors[controller.drive]
        add(f"{name}.current", motor.law() @ plant.z)
        if axis.frame is not None:
            add(f"{name}.frame", plant.weights(axis.frame) @ plant.z)
    tripped = [t for motor in plant.motors.values() for t in motor.tripped]
    for name in machine.inputs:
        add(name, name in tripped)


def _si(quantity) -> float:
    return 0.0 if quantity is None else quantity.si
