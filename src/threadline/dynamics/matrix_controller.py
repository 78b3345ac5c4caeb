"""Controllers of the linear analysis in state-space form: conversion, joining and closed loops.

Every tick, a controller with the states x turns the references r and the sensor readings y into the
voltages u:

    x[k+1] = A x[k] + R r[k] + Y y[k],   u[k] = C x[k] + Dr r[k] + Dy y[k]

A difference equation that acts on the error ``r - y`` has ``Y = -R`` and ``Dy = -Dr``; its states
follow the transposed direct form II. The linear analysis has no clamping of the DAC.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics.sampled import ClosedLoop, DigitalFilter, StateSpace, sample
from threadline.machine import Machine
from threadline.machine.controllers import AxisController, AxisOfStateSpace, StateSpaceController


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatrixController:
    """All controllers of coupled axes as one controller; n states, m voltages, q readings.

    Parameters
    ----------
    A, R, Y
        (n, n), (n, m) and (n, q): effect of states, references and readings on the states at the
        next tick.
    C, Dr, Dy
        (m, n), (m, m) and (m, q): effect of states, references and readings on the voltages.
    """

    A: FloatArray
    R: FloatArray
    Y: FloatArray
    C: FloatArray
    Dr: FloatArray
    Dy: FloatArray

    def feedback(self, z: ComplexArray) -> ComplexArray:
        """Return the (k, m, q) frequency response from readings to voltages at (k,) values of z."""
        resolvent = z[:, None, None] * np.eye(len(self.A)) - self.A
        solved = np.linalg.solve(resolvent, np.broadcast_to(self.Y, (len(z), *self.Y.shape)))
        return np.asarray(self.C @ solved + self.Dy)


def in_volts(controller: StateSpaceController) -> MatrixController:
    """Return a state-space controller with its outputs converted from DAC levels to volts.

    The readings are the controller's ``sensors``, in their order.
    """
    m, volts = len(controller.references), controller.dac.volt_per_level
    B, D = controller.matrix("B"), volts * controller.matrix("D")
    return MatrixController(
        A=controller.matrix("A"), R=B[:, :m], Y=B[:, m:],
        C=volts * controller.matrix("C"), Dr=D[:, :m], Dy=D[:, m:],
    )  # fmt: skip


def of_filter(digital: DigitalFilter) -> MatrixController:
    """Return a second-order difference equation on the error as a controller with two states."""
    (b0, b1, b2), (_, a1, a2) = digital.numerator, digital.denominator
    R = np.array([[b1 - a1 * b0], [b2 - a2 * b0]])
    return MatrixController(
        A=np.array([[-a1, 1.0], [-a2, 0.0]]), R=R, Y=-R,
        C=np.array([[1.0, 0.0]]), Dr=np.full((1, 1), b0), Dy=np.full((1, 1), -b0),
    )  # fmt: skip


def side_by_side(parts: Sequence[MatrixController]) -> MatrixController:
    """Return one block-diagonal controller of several independent controllers."""
    return MatrixController(
        **{
            name: np.asarray(block_diag(*(getattr(part, name) for part in parts)))
            for name in ("A", "R", "Y", "C", "Dr", "Dy")
        }
    )


def close_matrix_loop(
    plant: StateSpace,
    controller: MatrixController,
    sensors: tuple[str, ...],
    names: tuple[str, ...],
    period_s: float,
    gains: FloatArray,
) -> ClosedLoop:
    """Return the closed loop of ``plant`` with a controller that drives all inputs of the plant.

    The state vector holds the states of the plant; then for each input its last d + 1 voltages,
    newest first, d being the whole ticks of its dead time; then the states of the controller. The
    outputs are the outputs of the plant, then the voltages.

    Parameters
    ----------
    sensors
        (q,) names of the plant's outputs that the controller reads.
    names
        (m,) names of the loops, in the order of the plant's inputs.
    period_s
        Length of a tick.
    gains
        (m,) factors on the voltages.
    """
    sampled = sample(plant, period_s)
    m, n, controller_states = len(names), len(plant.A), len(controller.A)
    delay_lengths = [t + 1 for t in sampled.ticks]
    starts = n + np.concatenate(([0], np.cumsum(delay_lengths)[:-1])).astype(int)
    first_controller_state = n + sum(delay_lengths)
    size = first_controller_state + controller_states
    reading_rows = np.zeros((len(sensors), size))
    reading_rows[:, :n] = [plant.C[plant.outputs.index(name)] for name in sensors]
    voltage_rows = gains[:, None] * (controller.Dy @ reading_rows)
    voltage_rows[:, first_controller_state:] += gains[:, None] * controller.C
    feedthrough = gains[:, None] * controller.Dr
    A, B = np.zeros((size, size)), np.zeros((size, m))
    A[:n, :n] = sampled.transition
    for i, newest in enumerate(starts.tolist()):
        A[newest], B[newest] = voltage_rows[i], feedthrough[i]
        for j in range(1, delay_lengths[i]):
            A[newest + j, newest + j - 1] = 1.0
        if sampled.ticks[i] == 0:
            A[:n] += np.outer(sampled.newer[:, i], voltage_rows[i])
            B[:n] += np.outer(sampled.newer[:, i], feedthrough[i])
        else:
            A[:n, newest + sampled.ticks[i] - 1] += sampled.newer[:, i]
        A[:n, newest + sampled.ticks[i]] += sampled.older[:, i]
    A[first_controller_state:] += controller.Y @ reading_rows
    A[first_controller_state:, first_controller_state:] += controller.A
    B[first_controller_state:] = controller.R
    plant_rows = np.zeros((len(plant.C), size))
    plant_rows[:, :n] = plant.C
    return ClosedLoop(
        A=A,
        B=B,
        C=np.vstack([plant_rows, voltage_rows]),
        D=np.vstack([np.zeros((len(plant.C), m)), feedthrough]),
        outputs=(*plant.outputs, *(f"controllers.{name}" for name in names)),
        period_s=period_s,
    )


class LoopPart(NamedTuple):
    """One loop of a controller; a state-space controller has a loop for each of its axes.

    Parameters
    ----------
    controller
        Name of the controller.
    place
        Index of the axis among the references of a state-space controller; 0 for other
        controllers.
    axis
        Name of the axis; empty if the controller moves no axis.
    settings
        The loop's table of the machine file: clocks, sensor, drive and DAC.
    """

    controller: str
    place: int
    axis: str
    settings: AxisController | AxisOfStateSpace


def loop_parts(machine: Machine, controllers: Iterable[str]) -> tuple[LoopPart, ...]:
    """Return the loops of ``controllers``, controller by controller."""
    owner = {axis.controller: name for name, axis in machine.axes.items()}
    parts: list[LoopPart] = []
    for name in controllers:
        controller = machine.controllers[name]
        if isinstance(controller, StateSpaceController):
            parts += [
                LoopPart(name, place, axis, controller.of_axis(axis))
                for place, axis in enumerate(controller.references)
            ]
        else:
            parts.append(LoopPart(name, 0, owner.get(name, ""), controller))
    return tuple(parts)
