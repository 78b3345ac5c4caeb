"""Natural frequencies of the network, with its motors locked and with its motors free."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.machine import Machine
from threadline.plant.coupled import Group, connected_groups
from threadline.plant.linear import StateSpace
from threadline.plant.linear_model import linear_model

_RIGID = 1e-7


@dataclass(frozen=True, slots=True, kw_only=True)
class Oscillation:
    """A natural mode.

    Parameters
    ----------
    frequency_hz
        Undamped natural frequency.
    damping
        Damping ratio of the pole pair of the mode; 1 where its poles are real.
    """

    frequency_hz: float
    damping: float


def locked_modes(machine: Machine, axis: str) -> tuple[Oscillation, ...]:
    """Return the modes of an axis' piece of the network with its driven bodies held still."""
    group, model = _piece(machine, axis)
    held = {b for d in group.drives for b in machine.motors[d].acts_on}
    return _modes(model, [b for b in group.bodies if b not in held])


def free_modes(machine: Machine, axis: str) -> tuple[Oscillation, ...]:
    """Return the modes of an axis' piece with its motors turning freely, without current."""
    group, model = _piece(machine, axis)
    return _modes(model, list(group.bodies))


def _piece(machine: Machine, axis: str) -> tuple[Group, StateSpace]:
    groups = [group for group in connected_groups(machine) if not group.sources]
    for group, model in zip(groups, linear_model(machine), strict=True):
        if axis in group.axes:
            return group, model
    raise KeyError(axis)


def _modes(model: StateSpace, bodies: list[str]) -> tuple[Oscillation, ...]:
    if not bodies:
        return ()
    place = [model.states.index(b) for b in bodies]
    rate = [model.states.index(f"{b}'") for b in bodies]
    stiffness = -model.A[np.ix_(rate, place)]
    squares = np.sort(np.linalg.eigvals(stiffness).real)
    squares = squares[squares > _RIGID * max(float(squares.max()), 1.0)]
    if not len(squares):
        return ()
    return tuple(
        Oscillation(frequency_hz=float(w / (2 * np.pi)), damping=_damping(model, place, rate, w))
        for w in np.sqrt(squares)
    )


def _damping(model: StateSpace, place: list[int], rate: list[int], omega: float) -> float:
    """Return the damping ratio of the pole pair that belongs to an undamped mode.

    The damping is raised from 0 in 64 steps, and the pair is followed from one to the next.
    """
    n = len(place)
    whole = np.zeros((2 * n, 2 * n))
    whole[:n, n:] = np.eye(n)
    whole[n:, :n] = model.A[np.ix_(rate, place)]
    damping: FloatArray = model.A[np.ix_(rate, rate)]
    at = 1j * omega
    for share in np.linspace(0.0, 1.0, 65)[1:]:
        whole[n:, n:] = share * damping
        poles = np.linalg.eigvals(whole)
        at = poles[int(np.argmin(np.abs(poles - at)))]
    # A pair that met on the real axis has a ratio of 1, also where one of it is lost in rounding.
    return float(-at.real / abs(at)) if at else 1.0
