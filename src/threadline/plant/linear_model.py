"""The linear model of every connected piece of the network, for small motions."""

from __future__ import annotations

import numpy as np

from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.plant import elements as el
from threadline.plant.linear import StateSpace
from threadline.plant.network import PiecewiseLinear, piecewise_linear
from threadline.plant.values import Values


def linear_model(machine: Machine, values: Values | None = None) -> tuple[StateSpace, ...]:
    """Return the linear model of every connected piece, one for each group of the network.

    Limits and friction are left out, play is closed and a preloaded belt is tight, as in small
    motions about a working point. Inputs are the drives, ``"drives.x"``, in volts of the
    controller;
    outputs are ``"sensors.x"`` in counts and, per axis, ``"X.measured"``, ``"X.load"`` and
    ``"X.frame"`` in m or rad. The dead time of each drive is in ``delay_s``.

    Raises
    ------
    MachineError
        If a combination of parts has no equations here.
    """
    used = Values.of(machine) if values is None else values
    # A piece whose drives are given positions has no input in volts: see ``prescribed``.
    return tuple(
        _linear(machine, piece, used)
        for piece in piecewise_linear(machine, used)
        if not piece.group.sources
    )


def _linear(machine: Machine, piece: PiecewiseLinear, values: Values) -> StateSpace:
    group, n = piece.group, len(piece.states)
    full = el.working_rates(piece.base, piece.elements)[0]
    rows, names = [], []
    for index, sensor in enumerate(group.sensors):
        rows.append(piece.sensor_rows[0, index, :n])
        names.append(f"sensors.{sensor}")
    for index, axis in enumerate(group.axes):
        sensor = machine.controller_of(axis).sensor
        counts = piece.sensor_rows[0, group.sensors.index(sensor), :n]
        rows += [counts / machine.axes[axis].counts.si, piece.load_rows[0, index, :n]]
        names += [f"{axis}.measured", f"{axis}.load"]
        if piece.has_frame[index]:
            rows.append(piece.frame_rows[0, index, :n])
            names.append(f"{axis}.frame")
    if not rows:
        raise MachineError(
            f"bodies.{group.bodies[0]}: no drive, sensor or axis has to do with it",
            remedy="Take it out, or connect it by a link.",
        )
    delays = [
        float(np.atleast_1d(values.at(f"drives.{d}.delay", machine.motors[d].delay))[0])
        for d in group.drives
    ]
    return StateSpace(
        A=full[:, :n],
        B=full[:, n : n + len(group.drives)] * piece.input_gain[0],
        C=np.array(rows),
        D=np.zeros((len(rows), len(group.drives))),
        delay_s=np.array(delays),
        states=piece.states,
        inputs=tuple(f"drives.{d}" for d in group.drives),
        outputs=tuple(names),
    )
