"""The control loop of an axis: its plant, its controllers, and their open-loop response.

If axes share a piece of the network, the loop of one axis is opened while the other loops stay
closed. There are two models of a loop. In ``"sampled"`` the controller acts tick by tick, like the
real controller. In ``"continuous"`` it is the continuous form of its filter, with a dead time of
half a tick for its held output.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics.groups import connected_groups
from threadline.dynamics.linear_model import linear_model
from threadline.dynamics.matrix_controller import (
    LoopPart,
    MatrixController,
    close_matrix_loop,
    in_volts,
    loop_parts,
    of_filter,
    side_by_side,
)
from threadline.dynamics.sampled import (
    ClosedLoop,
    DigitalFilter,
    SampledPlant,
    StateSpace,
    close_loop,
    digital_filter,
    sample,
)
from threadline.dynamics.values import Values
from threadline.errors import MachineError, OptionError
from threadline.machine import Machine
from threadline.machine.controllers import StateSpaceController

Model: TypeAlias = Literal["sampled", "continuous"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Loop:
    """The loop of one axis.

    Parameters
    ----------
    axis
        Name of the axis.
    plant
        The connected network piece, from the voltages of all its controllers to all its outputs.
    controllers, sensors, filters
        Names of the controllers of the piece, their sensor outputs in counts, and their difference
        equations.
    index
        Index of this axis' controller in ``controllers``.
    counts_per_unit
        Counts of the axis' sensor per m or rad.
    hold
        Whether the continuous model has half a tick of dead time for the held output.
    """

    axis: str
    plant: StateSpace
    controllers: tuple[str, ...]
    sensors: tuple[str, ...]
    filters: tuple[DigitalFilter, ...]
    index: int
    counts_per_unit: float
    hold: bool = True

    @property
    def period_s(self) -> float:
        """Tick of the controller."""
        return self.filters[self.index].period_s

    @property
    def single(self) -> bool:
        """Whether every controller of the piece has a single error, as a continuous model needs."""
        return True

    def follower(self, model: Model = "sampled") -> Callable[[FloatArray], ComplexArray]:
        """Return the response from reference to sensor as a function of (k,) rad/s."""
        response = self.responder(model)

        def followed(omega_rad_s: FloatArray) -> ComplexArray:
            L = response(omega_rad_s)
            return np.asarray(L / (1.0 + L))

        return followed

    def measured(self) -> StateSpace:
        """Return the plant from all controllers' voltages to their sensors, in counts."""
        return self.plant.select(list(self.plant.inputs), list(self.sensors))

    def axis_plant(self) -> StateSpace:
        """Return the plant from this axis' voltage to its sensor, in counts, other loops open."""
        return self.plant.select([self.plant.inputs[self.index]], [self.sensors[self.index]])

    def delays_s(self) -> FloatArray:
        """Return the (controllers,) dead times of the continuous model."""
        hold_delays = [f.period_s / 2.0 if self.hold else 0.0 for f in self.filters]
        return np.asarray(self.plant.delay_s + np.array(hold_delays))

    def sampled_plant(self) -> SampledPlant:
        """Return the plant of ``measured`` with held inputs, from tick to tick."""
        return sample(self.measured(), self.period_s)

    def closed(self, gain: float = 1.0) -> ClosedLoop:
        """Return the closed loops of the piece, with a factor ``gain`` on this axis' controller."""
        gains = [1.0] * len(self.filters)
        gains[self.index] = gain
        return close_loop(self.plant, self.filters, self.sensors, self.controllers, tuple(gains))

    def plant_response(self, omega_rad_s: FloatArray, model: Model = "sampled") -> ComplexArray:
        """Return the (k,) response from this axis' voltage to its counts, other loops closed."""
        return self._seen(np.atleast_1d(np.asarray(omega_rad_s, dtype=np.float64)), model, None)

    def _seen(self, omega: FloatArray, model: Model, sampled: SampledPlant | None) -> ComplexArray:
        if model == "sampled":
            G = (self.sampled_plant() if sampled is None else sampled).response(omega)
        else:
            G = self.measured().response(omega)
            hold_delays = self.delays_s() - self.plant.delay_s
            G = G * np.exp(-1j * omega[:, None] * hold_delays)[:, None, :]
        own = self.index
        others = [k for k in range(len(self.filters)) if k != own]
        if not others:
            return np.asarray(G[:, 0, 0])
        other_filters = np.stack([_filter(self.filters[k], omega, model) for k in others], axis=1)
        others_open = np.eye(len(others)) + G[:, others][:, :, others] * other_filters[:, None, :]
        others_response = np.linalg.solve(others_open, G[:, others, own][:, :, None])[:, :, 0]
        return np.asarray(
            G[:, own, own]
            - np.einsum("ko,ko->k", G[:, own, others] * other_filters, others_response)
        )

    def responder(self, model: Model = "sampled") -> Callable[[FloatArray], ComplexArray]:
        """Return the open-loop response ``L = D G`` as a function of (k,) rad/s, dead time exact.

        The sampled plant is computed once for all calls. No frequency may be a pole on the
        imaginary axis, such as 0.
        """
        sampled = self.sampled_plant() if model == "sampled" else None

        def response(omega_rad_s: FloatArray) -> ComplexArray:
            omega = np.atleast_1d(np.asarray(omega_rad_s, dtype=np.float64))
            filter_response = _filter(self.filters[self.index], omega, model)
            return np.asarray(filter_response * self._seen(omega, model, sampled))

        return response

    def response(self, omega_rad_s: FloatArray, model: Model = "sampled") -> ComplexArray:
        """Return the (k,) open-loop response at (k,) rad/s, see ``responder``."""
        return self.responder(model)(omega_rad_s)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatrixLoop(Loop):
    """The loop of an axis in a piece with a state-space controller, cut at the axis' drive.

    The loops of all other drives stay closed. ``filters`` is empty, and there is no continuous
    model, because a state-space controller has no continuous form.

    Parameters
    ----------
    controller
        All controllers of the piece as one.
    readings
        Sensor outputs that it reads, in its order; ``sensors`` has the encoder of each loop.
    tick_s
        Tick of the controllers, s.
    """

    controller: MatrixController
    readings: tuple[str, ...]
    tick_s: float

    @property
    def period_s(self) -> float:
        """Tick of the controllers."""
        return self.tick_s

    @property
    def single(self) -> bool:
        """Whether every controller of the piece has one error."""
        return False

    def closed(self, gain: float = 1.0) -> ClosedLoop:
        """Return the closed loops of the piece, with a factor ``gain`` on this axis' voltage."""
        gains = np.ones(len(self.controllers))
        gains[self.index] = gain
        return close_matrix_loop(
            self.plant, self.controller, self.readings, self.controllers, self.tick_s, gains
        )

    def delays_s(self) -> FloatArray:
        """Raise a ``MachineError``: there is no continuous model."""
        raise self._refused()

    def _refused(self) -> MachineError:
        name = self.controllers[self.index]
        return MachineError(
            f"axis {self.axis}: controllers.{name.partition(' ')[0]} has the kind state-space, "
            "which has no continuous form",
            remedy="Use the sampled model.",
        )

    def responder(self, model: Model = "sampled") -> Callable[[FloatArray], ComplexArray]:
        """Return the open-loop response as a function of (k,) rad/s.

        It is minus the response from this axis' voltage to the output of its controller, with all
        other loops closed.

        Raises
        ------
        MachineError
            For the continuous model.
        """
        if model != "sampled":
            raise self._refused()
        read_plant = self.plant.select(list(self.plant.inputs), list(self.readings))
        sampled = sample(read_plant, self.tick_s)
        own = self.index
        others = [k for k in range(len(self.controllers)) if k != own]

        def response(omega_rad_s: FloatArray) -> ComplexArray:
            omega = np.atleast_1d(np.asarray(omega_rad_s, dtype=np.float64))
            feedback = self.controller.feedback(np.exp(1j * omega * self.tick_s))
            M = feedback @ sampled.response(omega)
            others_open = np.eye(len(others)) - M[:, others][:, :, others]
            others_response = np.linalg.solve(others_open, M[:, others, own][:, :, None])[:, :, 0]
            by_others = np.einsum("ko,ko->k", M[:, own, others], others_response)
            return np.asarray(-(M[:, own, own] + by_others))

        return response

    def follower(self, model: Model = "sampled") -> Callable[[FloatArray], ComplexArray]:
        """Return the closed-loop response from reference to sensor, as a function of (k,) rad/s.

        Raises
        ------
        MachineError
            For the continuous model.
        """
        if model != "sampled":
            raise self._refused()
        closed = self.closed()
        row = closed.outputs.index(self.sensors[self.index])

        def followed(omega_rad_s: FloatArray) -> ComplexArray:
            z = np.exp(1j * np.atleast_1d(omega_rad_s) * self.tick_s)
            resolvent = z[:, None, None] * np.eye(len(closed.A)) - closed.A
            B = np.broadcast_to(closed.B[:, self.index, None], (len(z), len(closed.A), 1))
            state = np.linalg.solve(resolvent, B)[:, :, 0]
            return np.asarray(state @ closed.C[row] + closed.D[row, self.index])

        return followed


def _matrix_loop(
    machine: Machine, parts: tuple[LoopPart, ...], values: Values | None
) -> tuple[MatrixController, tuple[str, ...]]:
    """Return the controllers of a piece as one, and the sensor outputs that it reads."""
    blocks: list[MatrixController] = []
    readings: list[str] = []
    for part in parts:
        controller = machine.controllers[part.controller]
        if isinstance(controller, StateSpaceController):
            if not part.place:
                blocks.append(in_volts(controller))
                readings += [f"sensors.{name}" for name in controller.sensors]
        else:
            blocks.append(of_filter(digital_filter(machine, part.controller, values)))
            readings.append(f"sensors.{part.settings.sensor}")
    return side_by_side(blocks), tuple(readings)


def _filter(digital: DigitalFilter, omega: FloatArray, model: Model) -> ComplexArray:
    if model == "sampled":
        return digital.sampled_response(omega)
    return digital.continuous_response(omega)


def axis_loops(
    machine: Machine, values: Values | None = None, *, hold: bool = True
) -> dict[str, Loop]:
    """Return the loop of every axis with a controller, in the order of the axes.

    Parameters
    ----------
    values
        Numbers that replace the machine's; the first variant is used.
    hold
        Whether the continuous model has half a tick of dead time for the held output.

    Raises
    ------
    MachineError
        If controllers on different clocks share a piece of the network.
    """
    loops: dict[str, Loop] = {}
    groups = [group for group in connected_groups(machine) if not group.sources]
    for group, plant in zip(groups, linear_model(machine, values), strict=True):
        if not group.axes:
            continue
        parts = loop_parts(machine, group.controllers)
        names = tuple(
            part.controller
            if part.settings.kind != "state-space"
            else f"{part.controller} ({part.axis})"
            for part in parts
        )
        clocks = sorted({part.settings.clock for part in parts})
        if len(clocks) > 1:
            raise MachineError(
                f"controllers {', '.join(group.controllers)} share bodies but run on the clocks "
                f"{', '.join(clocks)}",
                place=machine.place,
                remedy="Put the controllers of connected bodies on one clock.",
            )
        driven = plant.select([f"drives.{p.settings.drive}" for p in parts], list(plant.outputs))
        owners = [part.axis for part in parts]
        for axis in group.axes:
            common: dict[str, Any] = {
                "axis": axis,
                "plant": driven,
                "controllers": names,
                "sensors": tuple(f"sensors.{p.settings.sensor}" for p in parts),
                "index": owners.index(axis),
                "counts_per_unit": machine.axes[axis].counts.si,
                "hold": hold,
            }
            if any(part.settings.kind == "state-space" for part in parts):
                controller, readings = _matrix_loop(machine, parts, values)
                loops[axis] = MatrixLoop(
                    **common, filters=(), controller=controller, readings=readings,
                    tick_s=float(machine.clock(clocks[0]).period_s),
                )  # fmt: skip
                continue
            filters = tuple(digital_filter(machine, name, values) for name in names)
            loops[axis] = Loop(**common, filters=filters)
    return {axis: loops[axis] for axis in machine.axes if axis in loops}


def axis_loop(machine: Machine, axis: str, values: Values | None = None) -> Loop:
    """Return the loop of one axis.

    Raises
    ------
    OptionError
        If there is no such axis, or it has no loop.
    MachineError
        If controllers on different clocks share a piece of the network.
    """
    if axis not in machine.axes:
        raise OptionError(
            f"machine {machine.name!r} has no axis {axis!r}",
            remedy=f"It has: {', '.join(machine.axes)}.",
        )
    loops = axis_loops(machine, values)
    if axis not in loops:
        raise OptionError(
            f"axis {axis} of {machine.name!r} has no loop: drives.{machine.axes[axis].drive} "
            "takes positions",
            remedy="Choose an axis with a controller.",
        )
    return loops[axis]
