"""Equations of a network with prescribed motor positions: steppers, pulse-controlled servos.

The positions p and velocities p' of the driven bodies are removed from the state of the network
``z' = F z``. The remaining states x obey ``x' = A x + B p + C p'`` exactly. The row of F for a
prescribed velocity gives the acceleration that the network alone would give to this body. The
torque of the drive is therefore ``J (p'' - row . z)`` plus friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.dynamics.network import PiecewiseLinear, piecewise_linear
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.sources import PulseServo, Source


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tight:
    """A preloaded belt, linear while it is tight.

    Parameters
    ----------
    name
        Path of the link in the machine file.
    row
        (n + 2 s,) row of the belt's force over ``[x, p, p']``.
    low, high
        Forces below and above which one of the two runs is slack.
    """

    name: str
    row: FloatArray
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prescribed:
    """A connected piece with n states x and s drives with prescribed positions p.

    Parameters
    ----------
    axes, drives
        Names of the axes and of the drives of the piece.
    states
        (n,) names.
    rates
        (n, n + 2 s) rates of the states over ``[x, p, p']``.
    loads, frames
        (axes, n + 2 s) rows of load and frame in m or rad, from the start position.
    has_frame
        (axes,) whether the axis has a frame.
    pulls
        (s, n + 2 s) rows of the torque (force) that the network exerts on each drive's body, N m
        (N).
    inertia, friction
        (s,) inertia and friction of the drives' bodies.
    belts
        Preloaded belts; the equations hold while all of them are tight.
    """

    axes: tuple[str, ...]
    drives: tuple[str, ...]
    states: tuple[str, ...]
    rates: FloatArray
    loads: FloatArray
    frames: FloatArray
    has_frame: tuple[bool, ...]
    pulls: FloatArray
    inertia: FloatArray
    friction: FloatArray
    belts: tuple[Tight, ...]

    @property
    def matrix(self) -> FloatArray:
        """(n, n) rates of the states with the motors locked."""
        return self.rates[:, : len(self.states)]


def prescribed(machine: Machine) -> tuple[Prescribed, ...]:
    """Return the equations of every piece of ``machine`` with a position-commanded drive.

    Raises
    ------
    MachineError
        If such a piece also has a motor with a control loop, or a nonlinear part: play, or friction
        of a body other than the drive's.
    """
    return tuple(
        _with_prescribed_motors(machine, piece)
        for piece in piecewise_linear(machine, Values.of(machine))
        if piece.group.sources
    )


def piece_of(machine: Machine, axis: str) -> Prescribed:
    """Return the piece of an axis."""
    return next(piece for piece in prescribed(machine) if axis in piece.axes)


def _with_prescribed_motors(machine: Machine, piece: PiecewiseLinear) -> Prescribed:
    group, n = piece.group, len(piece.states)
    sources = {name: machine.position_sources[name] for name in group.sources}
    if group.drives:
        raise MachineError(
            f"drives.{group.sources[0]} takes positions and drives.{group.drives[0]} has a "
            "control loop, but both move one connected piece",
            place=machine.place,
            remedy="Use drives of one kind in each piece.",
        )
    bodies = [source.body for source in sources.values()]
    rates, belts = piece.base[0][:, :n].copy(), []
    for element in piece.elements:
        name = element.name.split(".")
        if name[0] == "links" and element.modes[0].name == "tight":
            law = element.modes[0].law[0]
            guard = element.modes[0].guards[0]
            rates += element.direction[0][:, None] * law[None, :n]
            belts.append((element.name, law[:n], guard.low, guard.high))
        elif not (name[0] == "bodies" and name[1] in bodies):
            raise MachineError(
                f"{element.name} is not linear, and drives.{group.sources[0]} moves its piece",
                place=machine.place,
                remedy="Omit friction and play, except the friction of the drive's body.",
            )
    positions = [piece.states.index(body) for body in bodies]
    speeds = [piece.states.index(f"{body}'") for body in bodies]
    free_states = [k for k in range(n) if k not in {*positions, *speeds}]
    order = [*free_states, *positions, *speeds]
    inertia = np.array([machine.bodies[b].inertia.si for b in bodies])
    friction = [machine.bodies[b].friction for b in bodies]
    return Prescribed(
        axes=group.axes,
        drives=group.sources,
        states=tuple(piece.states[k] for k in free_states),
        rates=rates[np.ix_(free_states, order)],
        loads=piece.load_rows[0][:, order],
        frames=piece.frame_rows[0][:, order],
        has_frame=piece.has_frame,
        pulls=inertia[:, None] * rates[np.ix_(speeds, order)],
        inertia=inertia,
        friction=np.array([0.0 if q is None else q.si for q in friction]),
        belts=tuple(
            Tight(name=name, row=row[order], low=_first(low), high=_first(high))
            for name, row, low, high in belts
        ),
    )


def _first(bound: FloatArray | float) -> float:
    return float(np.atleast_1d(bound)[0])


def resonance_hz(source: Source, inertia: float) -> float | None:
    """Return the resonance in Hz of a stepper about its step; None for a servo.

    The frequency holds for small deflections: the torque of a stepper varies with the sine of the
    electrical angle, and a full step is a quarter of an electrical turn.
    """
    if isinstance(source, PulseServo):
        return None
    return float(np.sqrt(source.stiffness / inertia) / (2.0 * np.pi))
