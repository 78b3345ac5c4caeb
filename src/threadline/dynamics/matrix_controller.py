"""State-space controllers in the linear analysis: joined to one controller, and in closed loops.

A controller in volts has the states x, the references r and the readings y of one tick:

    x[k+1] = A x[k] + R r[k] + Y y[k],   u[k] = C x[k] + Dr r[k] + Dy y[k]

A difference equation of one error ``r - y`` is the case ``Y = -R``; its states are the states of
the transposed direct form. The clamping of the DAC is left out, as everywhere in the linear
analysis.
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
    """All controllers of a connected piece as one, in volts; n states, m loops, q readings.

    Parameters
    ----------
    A, R, Y
        (n, n), (n, m) and (n, q): from states, references and readings to the states at the next
        tick.
    C, Dr, Dy
        (m, n), (m, m) and (m, q): from states, references and readings to the voltages.
    """

    A: FloatArray
    R: FloatArray
    Y: FloatArray
    C: FloatArray
    Dr: FloatArray
    Dy: FloatArray

    def feedback(self, z: ComplexArray) -> ComplexArray:
        """Return the (k, m, q) response from readings to voltages at (k,) values of z."""
        resolvent = z[:, None, None] * np.eye(len(self.A)) - self.A
        solved = np.linalg.solve(resolvent, np.broadcast_to(self.Y, (len(z), *self.Y.shape)))
        return np.asarray(self.C @ solved + self.Dy)


def in_volts(controller: StateSpaceController) -> MatrixController:
    """Return a state-space controller with outputs in volts; its readings are its ``sensors``."""
    m, volts = len(controller.references), controller.dac.volt_per_level
    B, D = controller.matrix("B"), volts * controller.matrix("D")
    return MatrixController(
        A=controller.matrix("A"), R=B[:, :m], Y=B[:, m:],
        C=volts * controller.matrix("C"), Dr=D[:, :m], Dy=D[:, m:],
    )  # fmt: skip


def of_filter(digital: DigitalFilter) -> MatrixController:
    """Return the difference equation of one error as a controller with two states."""
    (b0, b1, b2), (_, a1, a2) = digital.numerator, digital.denominator
    R = np.array([[b1 - a1 * b0], [b2 - a2 * b0]])
    return MatrixController(
        A=np.array([[-a1, 1.0], [-a2, 0.0]]), R=R, Y=-R,
        C=np.array([[1.0, 0.0]]), Dr=np.full((1, 1), b0), Dy=np.full((1, 1), -b0),
    )  # fmt: skip


def side_by_side(parts: Sequence[MatrixController]) -> MatrixController:
    """Return several controllers as one block-diagonal controller; each keeps its readings."""
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
    """Return the closed loop of ``plant`` with a controller of all its inputs.

    Parameters
    ----------
    sensors
        (q,) names of the plant's outputs that the controller reads.
    names
        (m,) names of the loops.
    gains
        (m,) factors on the voltages.
    """
    sampled = sample(plant, period_s)
    m, n, controller_states = len(names), len(plant.A), len(controller.A)
    line_lengths = [t + 1 for t in sampled.ticks]
    starts = n + np.concatenate(([0], np.cumsum(line_lengths)[:-1])).astype(int)
    memory = n + sum(line_lengths)
    size = memory + controller_states
    reading_rows = np.zeros((len(sensors), size))
    reading_rows[:, :n] = [plant.C[plant.outputs.index(name)] for name in sensors]
    level = gains[:, None] * (controller.Dy @ reading_rows)
    level[:, memory:] += gains[:, None] * controller.C
    feedthrough = gains[:, None] * controller.Dr
    A, B = np.zeros((size, size)), np.zeros((size, m))
    A[:n, :n] = sampled.transition
    for i, first in enumerate(starts.tolist()):
        A[first], B[first] = level[i], feedthrough[i]
        for j in range(1, line_lengths[i]):
            A[first + j, first + j - 1] = 1.0
        if sampled.ticks[i] == 0:
            A[:n] += np.outer(sampled.newer[:, i], level[i])
            B[:n] += np.outer(sampled.newer[:, i], feedthrough[i])
        else:
            A[:n, first + sampled.ticks[i] - 1] += sampled.newer[:, i]
        A[:n, first + sampled.ticks[i]] += sampled.older[:, i]
    A[memory:] += controller.Y @ reading_rows
    A[memory:, memory:] += controller.A
    B[memory:] = controller.R
    rows = np.zeros((len(plant.C), size))
    rows[:, :n] = plant.C
    return ClosedLoop(
        A=A,
        B=B,
        C=np.vstack([rows, level]),
        D=np.vstack([np.zeros((len(plant.C), m)), feedthrough]),
        outputs=(*plant.outputs, *(f"controllers.{name}" for name in names)),
        period_s=period_s,
    )


class LoopPart(NamedTuple):
    """A controller's loop for one axis; a state-space controller has one loop for each of its axes.

    Parameters
    ----------
    controller
        Name of the controller.
    place
        Index of the axis in the references of a state-space controller, else 0.
    axis
        Name of the axis; empty if the controller moves no axis.
    of
        Clocks, sensor, drive and DAC of the loop.
    """

    controller: str
    place: int
    axis: str
    of: AxisController | AxisOfStateSpace


def loop_parts(machine: Machine, controllers: Iterable[str]) -> tuple[LoopPart, ...]:
    """Return the loops of ``controllers``; the loops of one controller follow each other."""
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
