r"""Cross-coupled contouring of two axes, as the matrices of a ``state-space`` controller.

On a line in the direction :math:`\theta` the contour error of two axes is :math:`\epsilon = n^T e`
with the normal :math:`n = (-\sin\theta, \cos\theta)` and the errors e of the axes at the tool. A
cross-coupled controller gives each axis its share of a compensation of the contour error (Kulkarni
and Srinivasan, "Optimal contouring control of multi-axial feed drive servomechanisms", Journal of
Engineering for Industry 111, 1989). Here the existing controller of each axis provides the
compensation: it acts on its component of :math:`e + k n n^T e` instead of e. The error across the
line then has the weight :math:`1 + k`, and the lag along the line keeps the weight 1. If both axes
have the same closed loop, the error has no component across the line, and the coupling has no
effect.

The direction is fixed, because the matrices are constant. On lines in another direction the
coupling mistakes a part of the lag along the line for an error across it.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from threadline.base.arrays import FloatArray
from threadline.dynamics.matrix_controller import loop_parts
from threadline.dynamics.sampled import difference_equation
from threadline.dynamics.state_designs import Designed
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.controllers import StateSpaceController


def cross_coupled(
    machine: Machine, axes: tuple[str, str], direction_rad: float, coupling: float
) -> Designed:
    """Return the controllers of two axes, coupled by the error across a line.

    Parameters
    ----------
    axes
        The two axes.
    direction_rad
        Direction of the line: angle from the first axis towards the second.
    coupling
        k: additional weight of the error across the line, relative to the lag along it.

    Raises
    ------
    MachineError
        If the controllers of the axes have different clocks or DACs, or generate positions.
    """
    names = [machine.axes[axis].controller for axis in axes]
    parts = loop_parts(machine, names)
    controllers = [machine.controllers[name] for name in names]
    for name, controller in zip(names, controllers, strict=True):
        if isinstance(controller, StateSpaceController) or hasattr(controller, "acceleration"):
            raise MachineError(
                f"controllers.{name} is of kind {controller.kind}, but cross-coupling takes the "
                "errors of controllers that follow their references as they are",
                place=machine.place,
                remedy='Give it kind "lead" or "pid".',
            )
    first_kind, second_kind = (
        (p.settings.clock, p.settings.reference_clock, p.settings.dac.bits.si,
         p.settings.dac.range.si, p.settings.dac.zero_on_reversal, p.settings.dac.rounding)
        for p in parts
    )  # fmt: skip
    if first_kind != second_kind:
        raise MachineError(
            f"controllers.{names[0]} and controllers.{names[1]} have different clocks or DACs",
            place=machine.place,
            remedy="Cross-coupling needs one clock and one kind of DAC for both.",
        )
    normal = np.array([-np.sin(direction_rad), np.cos(direction_rad)])
    m_per_count = np.array(
        [machine.radius_m[machine.axis_names.index(a)] / machine.axes[a].counts.si for a in axes]
    )
    coupled_errors = (
        np.eye(2)
        + coupling * np.outer(normal, normal) * m_per_count[None, :] / m_per_count[:, None]
    )
    blocks = [_of_one_error(machine, name) for name in names]
    A, b, c, d = (block_diag(*(block[k] for block in blocks)) for k in range(4))
    error = np.hstack([coupled_errors, -coupled_errors])
    return Designed(
        axes=axes,
        sensors=tuple(part.settings.sensor for part in parts),
        drives=tuple(part.settings.drive for part in parts),
        clock=parts[0].settings.clock,
        reference_clock=parts[0].settings.reference_clock,
        A=A,
        B=b @ error,
        C=c,
        D=d @ error,
        L=block_diag(*[_CLAMPED] * 2),
        dac=parts[0].settings.dac,
    )


_CLAMPED = np.array([[0.0], [0.0], [1.0], [0.0]])


def _of_one_error(
    machine: Machine, name: str
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a controller with the states e', e'', u', u'', where u is the clamped output."""
    (b0, b1, b2), (a1, a2) = (
        row[0] for row in difference_equation(machine, name, Values.of(machine))
    )
    c = np.array([[b1, b2, -a1, -a2]])
    A = np.vstack([np.zeros(4), np.eye(4)[0], c, np.eye(4)[2]])
    return A, np.array([[1.0], [0.0], [b0], [0.0]]), c, np.array([[b0]])
