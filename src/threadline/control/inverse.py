"""The exact inverse of an axis: what its motor must do for its load to follow a motion.

From the controller's volts u to the load y there are r integrations: ``y^(r) = C A^r x + g u``.
The states are the load's position and derivatives and, where the plant has zeros (the Y frame of
the stitcher), inner states that follow from the motion alone, ``eta' = Q eta + R (y ... y^(r-1))``.
Their eigenvalues are the zeros; they must decay. Belt, load damping, frame, motor and coil are
all in it, dead time isn't: that is for the caller to send the volts early.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import null_space

from threadline.arrays import FloatArray
from threadline.control.exponential import decay_and_moments
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.plant.boundaries import not_decaying
from threadline.plant.linear import StateSpace
from threadline.plant.loop import Loop, axis_loop
from threadline.plant.values import Values
from threadline.plant.zeros import Chain, chain_of

_GAUSS_AT = 0.5 + 0.5 * np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
# Coefficients, from the constant up, of the parabolas that are 1 at one of these and 0 at others.
_GAUSS_BASIS = np.linalg.inv(np.vander(_GAUSS_AT, increasing=True)).T


class Motion(Protocol):
    """Position of the load over time, with derivatives; m or rad."""

    def __call__(self, time_s: FloatArray, order: int = 0) -> FloatArray:
        """Return the (k,) derivative of ``order`` at (k,) times."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Followed:
    """What an axis does while its load follows a motion exactly.

    Parameters
    ----------
    time_s
        (k,).
    load_si
        (k,) the motion.
    measured_counts
        (k,) what the controller's sensor reads.
    volts
        (k,) at the plant's input, when it acts there.
    current_a
        (k,) of the motor; None where the plant has no such state.
    """

    time_s: FloatArray
    load_si: FloatArray
    measured_counts: FloatArray
    volts: FloatArray
    current_a: FloatArray | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inverse:
    """The inverse of an axis in normal form: ``x = from_load (y ... y^(r-1)) + from_inner eta``.

    Parameters
    ----------
    axis, loop
        What it is the inverse of.
    plant
        The controller's volts to the load, in axis units.
    chain
        From those volts to the load.
    from_load, from_inner
        (n, r) and (n, n - r).
    Q, R
        (n - r, n - r) and (n - r, r) of the inner states.
    """

    axis: str
    loop: Loop
    plant: StateSpace
    chain: Chain
    from_load: FloatArray
    from_inner: FloatArray
    Q: FloatArray
    R: FloatArray

    @property
    def degree(self) -> int:
        """Derivatives of the motion that it needs; the one before the last must not jump."""
        return self.chain.degree

    def follow(self, motion: Motion, time_s: FloatArray) -> Followed:
        """Return what the axis does while the load follows ``motion`` from rest.

        Parameters
        ----------
        motion
            The load's, with ``degree`` derivatives; at rest at ``time_s[0]``.
        time_s
            (k,) equally spaced, in s; where a derivative jumps it should have an instant.
        """
        t = np.asarray(time_s, dtype=np.float64)
        ladder = np.stack([motion(t, order) for order in range(self.degree + 1)], axis=1)
        return self.outputs(t, ladder, self._inner(motion, t), float(ladder[0, 0]))

    def outputs(
        self, time_s: FloatArray, ladder: FloatArray, inner: FloatArray, start_si: float
    ) -> Followed:
        """Return what the axis does where its load and its inner states are known.

        Parameters
        ----------
        time_s
            (k,).
        ladder
            (k, degree + 1) position of the load and its derivatives.
        inner
            (k, n - degree) states that the load does not show, 0 at rest.
        start_si
            Where the load stood at rest before.
        """
        r = self.degree
        states = ladder[:, :r] @ self.from_load.T + inner @ self.from_inner.T
        states += self._rest(start_si)
        volts = (ladder[:, r] - states @ self.chain.rows[r]) / self.chain.gain
        coil = [k for k, name in enumerate(self.plant.states) if name.endswith(".i")]
        return Followed(
            time_s=time_s,
            load_si=ladder[:, 0],
            measured_counts=states @ self.loop.own().C[0],
            volts=volts,
            current_a=states[:, coil[0]] if len(coil) == 1 else None,
        )

    def _rest(self, start_si: float) -> FloatArray:
        # The ladder holds y(0) itself, and a plant at rest there has its inner states at rest too.
        if not len(self.Q) or start_si == 0.0:
            return np.zeros(len(self.plant.A))
        still = np.zeros(self.degree)
        still[0] = start_si
        return np.asarray(self.from_inner @ -np.linalg.solve(self.Q, self.R @ still))

    def _inner(self, motion: Motion, t: FloatArray) -> FloatArray:
        """Integrate the inner states: exactly, for the parabola through Gauss's three points."""
        inner = np.zeros((len(t), len(self.Q)))
        if not len(self.Q) or len(t) < 2:
            return inner
        step = float(t[1] - t[0])
        decay, moments = decay_and_moments(self.Q, step, 3)
        first = float(motion(t[:1], 0)[0])
        push = np.zeros((len(t) - 1, len(self.Q)))
        for at, parabola in zip(_GAUSS_AT, _GAUSS_BASIS, strict=True):
            times = t[:-1] + at * step
            ladder = np.stack([motion(times, order) for order in range(self.degree)], axis=1)
            ladder[:, 0] -= first
            push += ladder @ self.R.T @ np.tensordot(parabola, moments, axes=1).T
        for k in range(len(t) - 1):
            inner[k + 1] = decay @ inner[k] + push[k]
        return inner


def inverse_of(machine: Machine, axis: str, values: Values | None = None) -> Inverse:
    """Return the exact inverse of an axis, from the load's motion to the controller's volts.

    Raises
    ------
    OptionError
        If there is no such axis.
    MachineError
        If other drives act on the same bodies, or the plant's zeros do not decay.
    """
    loop = axis_loop(machine, axis, values)
    if len(loop.filters) > 1:
        raise MachineError(
            f"axis {axis} shares bodies with the drives of other axes",
            place=machine.place,
            remedy="An inverse is made for axes that move on their own.",
        )
    plant = loop.plant.select([loop.plant.inputs[loop.index]], [f"{axis}.load"])
    chain = chain_of(plant)
    r, n = chain.degree, len(plant.A)
    # Inner states are chosen so that the volts don't enter them: W b = 0.
    ladder = chain.rows[:r]
    scale = np.linalg.norm(ladder, axis=1)[:, None]
    others = null_space(plant.B.T / np.linalg.norm(plant.B)).T
    kept = _independent(others, ladder / scale, n - r)
    whole = np.vstack([ladder / scale, kept])
    back = np.linalg.inv(whole)
    from_load, from_inner = back[:, :r] / scale.T, back[:, r:]
    Q, R = kept @ plant.A @ from_inner, kept @ plant.A @ from_load
    standing = not_decaying(Q)
    if len(standing):
        worst = standing[0]
        raise MachineError(
            f"axis {axis}: its inverse does not decay, a zero lies at {worst:.4g} rad/s",
            place=machine.place,
            remedy="Give the frame damping, or let the load be what its motor moves first.",
        )
    return Inverse(
        axis=axis,
        loop=loop,
        plant=plant,
        chain=chain,
        from_load=from_load,
        from_inner=from_inner,
        Q=Q,
        R=R,
    )


def _independent(candidates: FloatArray, taken: FloatArray, count: int) -> FloatArray:
    """Return ``count`` combinations of rows that are independent of those ``taken``."""
    if count == 0:
        return np.empty((0, candidates.shape[1]))
    # What of the candidates' space is orthogonal to the part that the taken rows fill.
    inside = taken @ candidates.T @ candidates
    _, _, vectors = np.linalg.svd(inside @ candidates.T)
    rank = candidates.shape[0] - count
    return np.asarray(vectors[rank:] @ candidates)
