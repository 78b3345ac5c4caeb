"""Equations of the network of a machine, for each connected piece.

With the coordinates q of the bodies, ``M q'' + C q' + K q = forces``. M is diagonal. A link with
the stretch ``s = w . q`` adds ``k w w^T`` to K and ``c w w^T`` to C. A motor applies the force ``Kt
i`` along its vector ``w`` and moves at the speed ``w . q'``. A nonlinear part is an ``Element``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.dynamics import elements as el
from threadline.dynamics.eccentric import Band, eccentric_play, pieces_needed
from threadline.dynamics.groups import Group, connected_groups
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.parts import Accelerometer, Eccentric
from threadline.machine.quantity import Quantity


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PiecewiseLinear:
    """One connected piece: ``x' = base . z + sum of elements``, ``z = [x, inputs, 1]``.

    Parameters
    ----------
    group
        Parts of the piece. The inputs of the piece are its drives, in this order: the output of a
        voltage amplifier in volts, or of a current amplifier in amperes, with gain and fixed limits
        already applied.
    states
        (n,) names: ``"x"`` is a coordinate, ``"x'"`` its rate, ``"x.i"`` a motor's current.
    base
        (variants, n, N) linear part of the rates of the states.
    elements
        Nonlinear parts; each drive is one of them, called ``"drives.NAME"``.
    sensor_rows
        (variants, sensors, N) rows of the readings in counts or V, relative to the start position;
        0 for an accelerometer.
    felt_rows
        (variants, sensors, n) rows from the rates of the states to the readings of accelerometers;
        0 for any other sensor.
    load_rows, frame_rows
        (variants, axes, N) rows of load and frame in m or rad, relative to the start position.
    rate_rows
        (variants, axes, N) rows of the velocity of the load, m/s or rad/s.
    has_frame
        (axes,) whether the axis has a frame.
    input_gain, input_limit
        (variants, drives) gain from the controller's voltage to the input, and fixed limit of the
        input.
    pulled
        Whether the inputs of the drives are followed by one further input for each axis: an
        external force on the axis, N or N m.
    """

    group: Group
    states: tuple[str, ...]
    base: FloatArray
    elements: tuple[el.Element, ...]
    sensor_rows: FloatArray
    felt_rows: FloatArray
    load_rows: FloatArray
    frame_rows: FloatArray
    rate_rows: FloatArray
    has_frame: tuple[bool, ...]
    input_gain: FloatArray
    input_limit: FloatArray
    pulled: bool = False

    @property
    def variants(self) -> int:
        """Number of variants."""
        return len(self.base)


def piecewise_linear(
    machine: Machine,
    values: Values | None = None,
    start_si: FloatArray | None = None,
    *,
    drive: str = "",
    pulled: bool = False,
) -> tuple[PiecewiseLinear, ...]:
    """Return the equations of every connected piece of ``machine``.

    Parameters
    ----------
    values
        Numbers that replace the machine's; None for the machine's numbers.
    start_si
         (axes,) position of each axis at the start, m or rad, for the distances to limit switches;
        None for 0.
    drive
        Only the piece with this motor; empty for all pieces.
    pulled
        Whether to add inputs for external forces on the axes.

    Raises
    ------
    MachineError
         If a combination of parts has no equations.
    """
    all_values = Values.of(machine) if values is None else values
    start = np.zeros(len(machine.axes)) if start_si is None else start_si
    return tuple(
        _Builder(machine, all_values, group, start, pulled).build()
        for group in connected_groups(machine)
        if not drive or drive in group.drives
    )


class _Builder:
    """Fills the arrays of one group."""

    def __init__(
        self, machine: Machine, values: Values, group: Group, start: FloatArray, pulled: bool
    ) -> None:
        self.pulled = pulled
        self.machine, self.values, self.group = machine, values, group
        self.start = dict(zip(machine.axes, start, strict=True))
        self.count = values.count
        bodies = len(group.bodies)
        self.position = {b: i for i, b in enumerate(group.bodies)}
        self.velocity = {b: bodies + i for i, b in enumerate(group.bodies)}
        with_coil = [
            d
            for d in group.drives
            if machine.motors[d].inductance is not None
            and machine.motors[d].amplifier.mode == "voltage"
        ]
        self.coil = {d: 2 * bodies + i for i, d in enumerate(with_coil)}
        self.n = 2 * bodies + len(with_coil)
        self.size = self.n + len(group.drives) + (len(group.axes) if pulled else 0) + 1
        self.input = {d: self.n + i for i, d in enumerate(group.drives)}
        self.states = (
            *group.bodies,
            *(f"{b}'" for b in group.bodies),
            *(f"{d}.i" for d in with_coil),
        )
        self.inertia = {
            b: self._value(f"bodies.{b}.inertia", machine.bodies[b].inertia) for b in group.bodies
        }
        self.base = np.zeros((self.count, self.n, self.size))
        self.elements: list[el.Element] = []

    def build(self) -> PiecewiseLinear:
        for body in self.group.bodies:
            self._add_body(body)
        for link in self.group.links:
            self._add_link(link)
        gains, limits = [], []
        for drive in self.group.drives:
            gain, limit = self._add_drive(drive)
            gains.append(gain)
            limits.append(limit)
        for body in self.group.bodies:
            self._add_friction(body)
        axes = [self.machine.axes[a] for a in self.group.axes]
        bodies = len(self.group.bodies)
        load_rows = self._stack([self._load_row(a) for a in self.group.axes])
        rate_rows = np.zeros_like(load_rows)
        rate_rows[:, :, bodies : 2 * bodies] = load_rows[:, :, :bodies]
        if self.pulled:
            self._add_pulls(load_rows)
        return PiecewiseLinear(
            group=self.group,
            states=self.states,
            base=self.base,
            elements=tuple(self.elements),
            sensor_rows=self._stack([self._sensor_row(s) for s in self.group.sensors]),
            felt_rows=self._stack([self._felt_row(s) for s in self.group.sensors])[:, :, : self.n],
            load_rows=load_rows,
            rate_rows=rate_rows,
            frame_rows=self._stack([self._weights(a.frame or {}, self.position) for a in axes]),
            has_frame=tuple(a.frame is not None for a in axes),
            input_gain=np.stack(gains, axis=1) if gains else np.zeros((self.count, 0)),
            input_limit=np.stack(limits, axis=1) if limits else np.zeros((self.count, 0)),
            pulled=self.pulled,
        )

    def _add_pulls(self, load_rows: FloatArray) -> None:
        """Add an external force on each axis: by virtual work it acts on the bodies of the load."""
        bodies = len(self.group.bodies)
        first = self.n + len(self.group.drives)
        for axis_index in range(len(self.group.axes)):
            for body_index, body in enumerate(self.group.bodies):
                weight = load_rows[:, axis_index, body_index] / self.inertia[body]
                self.base[:, bodies + body_index, first + axis_index] = weight

    def _value(self, path: str, quantity: Quantity | None) -> FloatArray:
        # Called a hundred times per machine; ``np.broadcast_to`` would be ten times slower.
        column = np.empty(self.count)
        column[:] = self.values.at(path, quantity)
        return column

    def _stack(self, rows: list[FloatArray]) -> FloatArray:
        return np.stack(rows, axis=1) if rows else np.zeros((self.count, 0, self.size))

    def _weights(
        self, parts: Mapping[str, Quantity], columns: dict[str, int], path: str = ""
    ) -> FloatArray:
        row = np.zeros((self.count, self.size))
        for body, quantity in parts.items():
            row[:, columns[body]] = self._value(f"{path}.{body}", quantity)
        return row

    def _direction(
        self, parts: Mapping[str, Quantity], path: str, factor: FloatArray | float = 1.0
    ) -> FloatArray:
        direction = np.zeros((self.count, self.n))
        for body, quantity in parts.items():
            weight = self._value(f"{path}.{body}", quantity)
            direction[:, self.velocity[body]] = factor * weight / self.inertia[body]
        return direction

    def _apply(self, direction: FloatArray, law: FloatArray) -> None:
        self.base += direction[:, :, None] * law[:, None, :]

    def _refuse(self, message: str, remedy: str) -> MachineError:
        return MachineError(message, place=self.machine.place, remedy=remedy)

    def _add_body(self, name: str) -> None:
        body = self.machine.bodies[name]
        velocity = self.velocity[name]
        self.base[:, self.position[name], velocity] = 1.0
        damping = self._value(f"bodies.{name}.damping", body.damping)
        self.base[:, velocity, velocity] -= damping / self.inertia[name]

    def _add_friction(self, name: str) -> None:
        body = self.machine.bodies[name]
        if body.friction is None:
            return
        sliding = self._value(f"bodies.{name}.friction", body.friction)
        breakaway = self._value(f"bodies.{name}.stiction", body.stiction or body.friction)
        if body.stiction is None:
            breakaway = sliding
        if (breakaway < sliding).any():
            raise self._refuse(
                f"bodies.{name}: a stiction below the friction", "Raise stiction or lower friction."
            )
        direction = np.zeros((self.count, self.n))
        direction[:, self.velocity[name]] = 1.0 / self.inertia[name]
        self.elements.append(
            el.friction(
                f"bodies.{name}.friction",
                direction,
                self.velocity[name],
                self.inertia[name],
                sliding,
                breakaway,
                self.size,
            )
        )

    def _add_link(self, name: str) -> None:
        link, path = self.machine.links[name], f"links.{name}"
        stiffness = self._value(f"{path}.stiffness", link.stiffness)
        damping = self._value(f"{path}.damping", link.damping)
        weights = dict(link.stretch)
        stretch = self._weights(weights, self.position, f"{path}.stretch")
        rate = self._weights(weights, self.velocity, f"{path}.stretch")
        spring = stiffness[:, None] * stretch + damping[:, None] * rate
        direction = self._direction(weights, f"{path}.stretch", -1.0)
        if link.preload is not None and link.play is not None:
            raise self._refuse(
                f"{path} has both a preload and a play",
                "Split it into two links with a body between them.",
            )
        if link.preload is not None:
            preload = self._value(f"{path}.preload", link.preload)
            first = self._value(f"{path}.first_run", link.first_run)
            if link.first_run is None:
                first = np.full(self.count, 0.5)
            self.elements.append(el.belt(path, direction, spring, preload, first))
        elif link.play is not None:
            width = self._value(f"{path}.play", link.play)
            band = None if link.eccentric is None else self._band(name, link.eccentric)
            if band is None:
                damped = bool((damping > 0).any())
                element = el.play(path, direction, stretch, spring, stiffness, width, damped)
            else:
                element = eccentric_play(
                    path, direction, stretch, spring, stiffness, damping, width, band
                )
            self.elements.append(element)
        else:
            self._apply(direction, spring)

    def _band(self, link: str, eccentric: Eccentric) -> Band:
        path = f"links.{link}.eccentric"
        phase = self._value(f"{path}.phase", eccentric.phase)
        angle = dict(eccentric.angle)
        first, last = pieces_needed(self.machine, link, eccentric, self.start, phase)
        return Band(
            angle=self._weights(angle, self.position, f"{path}.angle"),
            angle_rate=self._weights(angle, self.velocity, f"{path}.angle"),
            width=self._value(f"{path}.width", eccentric.width),
            phase=phase,
            first=first,
            last=last,
        )

    def _add_drive(self, name: str) -> tuple[FloatArray, FloatArray]:
        drive, path = self.machine.motors[name], f"drives.{name}"
        amplifier = drive.amplifier
        torque = self._value(f"{path}.torque_constant", drive.torque_constant)
        emf = self._value(f"{path}.back_emf", drive.back_emf)
        resistance = self._value(f"{path}.resistance", drive.resistance)
        gain = self._value(f"{path}.amplifier.gain", amplifier.gain)
        volts = self._limit(f"{path}.amplifier.voltage_limit", amplifier.voltage_limit)
        amps = self._limit(f"{path}.amplifier.current_limit", amplifier.current_limit)
        drive_speed = self._weights(dict(drive.acts_on), self.velocity, f"{path}.acts_on")
        input_row = np.zeros((self.count, self.size))
        input_row[:, self.input[name]] = 1.0
        unit_row = np.zeros((self.count, self.size))
        unit_row[:, -1] = 1.0
        no_limit = np.full(self.count, np.inf)
        voltage_modes: tuple[tuple[FloatArray, float], ...] = ()
        state, limit_on_current, limit_on_input = self.coil.get(name, -1), amps, no_limit
        if amplifier.mode == "current":
            free, limit_on_current = input_row, None
            limit_on_input = no_limit if amps is None else amps
            if volts is not None:
                # The current loop inside the amplifier is not simulated, so the inductance takes
                # none of the voltage.
                supply = [
                    (sign * volts[:, None] * unit_row - emf[:, None] * drive_speed)
                    / resistance[:, None]
                    for sign in (1.0, -1.0)
                ]
                voltage_modes = ((supply[0], 1.0), (supply[1], -1.0))
        else:
            limit_on_input = no_limit if volts is None else volts
            law = (input_row - emf[:, None] * drive_speed) / resistance[:, None]
            if state >= 0:
                inductance = self._value(f"{path}.inductance", drive.inductance)
                coil = np.zeros((self.count, self.size))
                coil[:, state] = 1.0
                self.base[:, state] = (law - coil) * (resistance / inductance)[:, None]
                free = coil
            else:
                inductance, free = np.ones(self.count), law
        if amplifier.limits == "output":
            if state < 0 or amps is None:
                raise self._refuse(
                    f'{path}: limits = "output" without an inductance and a current limit',
                    "Add them, or omit limits.",
                )
            state = -1
        scale = inductance if state >= 0 else np.ones(self.count)
        self.elements.append(
            el.motor(
                path,
                self._direction(dict(drive.acts_on), f"{path}.acts_on", torque),
                free,
                current_limit=limit_on_current,
                voltage_modes=voltage_modes,
                state=state,
                net_scale=scale,
                switches=self._switches(name),
            )
        )
        return gain, limit_on_input

    def _limit(self, path: str, quantity: Quantity | None) -> FloatArray | None:
        return None if quantity is None else self._value(path, quantity)

    def _switches(self, drive: str) -> tuple[el.Guard, ...]:
        guards = []
        for index, name in enumerate(self.group.inputs):
            switch = self.machine.inputs[name]
            if switch.cuts != drive:
                continue
            row = self._load_row(switch.axis)
            position = self._value(f"inputs.{name}.at", switch.at) - self.start[switch.axis]
            if switch.beyond == "below":
                guards.append(el.Guard(row=row, low=position, switch=index))
            else:
                guards.append(el.Guard(row=row, high=position, switch=index))
        return tuple(guards)

    def _sensor_row(self, name: str) -> FloatArray:
        sensor = self.machine.sensors[name]
        reads = {} if isinstance(sensor, Accelerometer) else dict(sensor.reads)
        return self._weights(reads, self.position, f"sensors.{name}.reads")

    def _felt_row(self, name: str) -> FloatArray:
        sensor = self.machine.sensors[name]
        reads = dict(sensor.reads) if isinstance(sensor, Accelerometer) else {}
        return self._weights(reads, self.velocity, f"sensors.{name}.reads")

    def _load_row(self, axis_name: str) -> FloatArray:
        axis = self.machine.axes[axis_name]
        if axis.load is not None:
            return self._weights(dict(axis.load), self.position)
        source = self.machine.source_of(axis_name)
        if source is not None:
            row = np.zeros((self.count, self.size))
            row[:, self.position[source.body]] = source.counts / axis.counts.si
            return row
        sensor = self.machine.controller_of(axis_name).sensor
        counts = self._value(f"axes.{axis_name}.counts", axis.counts)
        return self._sensor_row(sensor) / counts[:, None]
