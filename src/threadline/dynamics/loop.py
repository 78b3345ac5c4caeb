"""The control loop of an axis: its plant, its controllers, and their open-loop response.

If axes share a piece of the network, the loop of one axis is opened while the others stay closed.
There are two models of a loop. In ``"sampled"`` the controller acts tick by tick, like the real
one. In ``"continuous"`` it is the continuous form of its filter, with a dead time of half a tick
for its held output.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics.linear_model import linear_model
from threadline.dynamics.network import connected_groups
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

    def measured(self) -> StateSpace:
        """Return the plant from all controllers' voltages to their sensors, in counts."""
        return self.plant.select(list(self.plant.inputs), list(self.sensors))

    def axis_plant(self) -> StateSpace:
        """Return the plant from this axis' voltage to its sensor, in counts, other loops open."""
        return self.plant.select([self.plant.inputs[self.index]], [self.sensors[self.index]])

    def delays_s(self) -> FloatArray:
        """Return the (controllers,) dead times of the continuous model."""
        held = [f.period_s / 2.0 if self.hold else 0.0 for f in self.filters]
        return np.asarray(self.plant.delay_s + np.array(held))

    def sampled_plant(self) -> SampledPlant:
        """Return the plant of ``measured`` with held inputs, from tick to tick."""
        return sample(self.measured(), self.period_s)

    def closed(self, gain: float = 1.0) -> ClosedLoop:
        """Return all loops of the piece closed, with a factor ``gain`` on this axis' controller."""
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
            held = self.delays_s() - self.plant.delay_s
            G = G * np.exp(-1j * omega[:, None] * held)[:, None, :]
        i = self.index
        others = [k for k in range(len(self.filters)) if k != i]
        if not others:
            return np.asarray(G[:, 0, 0])
        D = np.stack([_filter(self.filters[k], omega, model) for k in others], axis=1)
        oo = np.eye(len(others)) + G[:, others][:, :, others] * D[:, None, :]
        answer = np.linalg.solve(oo, G[:, others, i][:, :, None])[:, :, 0]
        return np.asarray(G[:, i, i] - np.einsum("ko,ko->k", G[:, i, others] * D, answer))

    def responder(self, model: Model = "sampled") -> Callable[[FloatArray], ComplexArray]:
        """Return the open-loop response ``L = D G`` as a function of (k,) rad/s, dead time exact.

        The sampled plant is computed once for all calls. No frequency may be a pole on the
        imaginary axis, such as 0.
        """
        sampled = self.sampled_plant() if model == "sampled" else None

        def response(omega_rad_s: FloatArray) -> ComplexArray:
            omega = np.atleast_1d(np.asarray(omega_rad_s, dtype=np.float64))
            own = _filter(self.filters[self.index], omega, model)
            return np.asarray(own * self._seen(omega, model, sampled))

        return response

    def response(self, omega_rad_s: FloatArray, model: Model = "sampled") -> ComplexArray:
        """Return the (k,) open-loop response at (k,) rad/s, see ``responder``."""
        return self.responder(model)(omega_rad_s)


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
        names = group.controllers
        parts = [machine.controllers[name] for name in names]
        clocks = sorted({part.clock for part in parts})
        if len(clocks) > 1:
            raise MachineError(
                f"controllers {', '.join(names)} share bodies but run on the clocks "
                f"{', '.join(clocks)}",
                place=machine.place,
                remedy="Put the controllers of connected bodies on one clock.",
            )
        driven = plant.select([f"drives.{p.drive}" for p in parts], list(plant.outputs))
        for axis in group.axes:
            loops[axis] = Loop(
                axis=axis,
                plant=driven,
                controllers=names,
                sensors=tuple(f"sensors.{p.sensor}" for p in parts),
                filters=tuple(digital_filter(machine, name, values) for name in names),
                index=names.index(machine.axes[axis].controller),
                counts_per_unit=machine.axes[axis].counts.si,
                hold=hold,
            )
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
