"""The network of the slow twin: all bodies of a machine as one system of affine laws.

Between two instants the whole is ``z' = A z`` with ``z = [states, inputs, 1]``, and the exponential
gives z at any time. The end of a law is watched on a grid of an eighth of the fastest rate, and at
every peak between grid points; Brent's method finds it on the series of the exponential, to 1e-43.
"""

from __future__ import annotations

from math import ceil

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from tests.twin.reference_parts import Belt, Friction, Motor, Part, Play, Watch
from threadline.machine import Machine

PER_RATE = 8.0
MOST_CHANGES = 400
TERMS = 24  # the last term is an eighth to its power, over its factorial: 1e-43 of the first


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
        """Return the generator of the present modes, and the conditions that end one of them."""
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
        """Advance by a time with constant inputs."""
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
        """Return the time of the first exit, and its law; the whole ``left`` without one."""
        steps = max(2, ceil(PER_RATE * self._rate(A) * left))
        grid = left / steps
        if not watches:
            return left, None
        rows = np.array([w.row for w in watches])
        slack = np.array([w.slack() for w in watches])
        now = self.z
        for k in range(steps):
            terms = self._series(A, now, grid)  # change of the state, over a part of the grid
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


def _si(quantity) -> float:
    return 0.0 if quantity is None else quantity.si
