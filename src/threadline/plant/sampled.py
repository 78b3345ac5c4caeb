"""Exact sampled models: the plant behind a held output from tick to tick, and closed loops on it.

With a dead time of ``d T + f``, ``0 <= f < T``, a held value reaches the plant ``f`` after a tick.
Within a tick the older value therefore acts for ``f`` and the newer one for ``T - f``. Both parts
are matrix exponentials, so the dead time is neither rounded to a tick nor approximated by a
rational function (Franklin, Powell and Workman, *Digital Control of Dynamic Systems*, section
4.3.4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from threadline.arrays import FloatArray
from threadline.errors import MachineError
from threadline.plant.controllers import DigitalFilter
from threadline.plant.linear import StateSpace

_ROUNDING = 1e-9
_MOST_TICKS = 4000  # of dead time: as many states, whose eigenvalues take 20 s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledPlant:
    """``x[k+1] = transition x[k] + sum(newer u[k-d] + older u[k-d-1])``, ``y = C x``.

    Parameters
    ----------
    transition
        (n, n) matrix of the states over a tick.
    newer, older
        (n, inputs) effect over a tick of the held value with d ticks of delay, and of the one
        before it.
    ticks
        Whole ticks d of dead time of each input.
    C
        (outputs, n) matrix of the outputs.
    period_s
        Length of a tick.
    """

    transition: FloatArray
    newer: FloatArray
    older: FloatArray
    ticks: tuple[int, ...]
    C: FloatArray
    period_s: float

    def response(self, omega_rad_s: FloatArray) -> NDArray[np.complex128]:
        """Return the (k, outputs, inputs) frequency response at ``z = exp(i w T)``."""
        z = np.exp(1j * np.asarray(omega_rad_s, dtype=np.float64) * self.period_s)
        late = z[:, None] ** (-np.array(self.ticks, dtype=np.float64))
        drive = self.newer * late[:, None, :] + self.older * (late / z[:, None])[:, None, :]
        inner = np.linalg.solve(
            z[:, None, None] * np.eye(len(self.transition)) - self.transition, drive
        )
        return np.asarray(self.C @ inner, dtype=np.complex128)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosedLoop:
    """``X[k+1] = A X[k] + B r[k]``, ``y[k] = C X[k] + D r[k]``, from references in counts.

    ``outputs`` names the rows of C and D: the outputs of the plant, then ``"controllers.NAME"`` for
    the outputs of the controllers in V.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    outputs: tuple[str, ...]
    period_s: float

    def eigenvalues(self) -> NDArray[np.complex128]:
        """Return the closed-loop poles in the z plane."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128)

    @property
    def spectral_radius(self) -> float:
        """Largest magnitude of a closed-loop pole; below 1 the loop is stable."""
        return float(np.abs(self.eigenvalues()).max())

    def respond(self, reference: FloatArray) -> FloatArray:
        """Return the (k, outputs) response to (k, inputs) references in counts, from rest."""
        given = np.asarray(reference, dtype=np.float64)
        states = np.zeros((len(given) + 1, len(self.A)))
        # What does not need the state before it is multiplied for all ticks at once.
        for k, push in enumerate(given @ self.B.T):
            states[k + 1] = self.A @ states[k] + push
        return np.asarray(states[:-1] @ self.C.T + given @ self.D.T)

    def steady(self) -> FloatArray:
        """Return the (outputs, inputs) steady state after unit steps of the references."""
        settled = np.linalg.solve(np.eye(len(self.A)) - self.A, self.B)
        return np.asarray(self.C @ settled + self.D)


def sample(plant: StateSpace, period_s: float) -> SampledPlant:
    """Return the sampled model of ``plant`` behind outputs that are held for a tick.

    Raises
    ------
    ValueError
        If the plant passes an input straight to an output.
    """
    if np.any(plant.D):
        raise ValueError("a plant with direct feedthrough cannot be sampled here")
    n, inputs = plant.B.shape
    newer, older, ticks = np.zeros((n, inputs)), np.zeros((n, inputs)), []
    for i, delay in enumerate(plant.delay_s):
        whole = int(np.floor(delay / period_s + _ROUNDING))
        part = max(0.0, float(delay) - whole * period_s)
        _, first = _advance(plant.A, plant.B[:, i], part)
        rest, second = _advance(plant.A, plant.B[:, i], period_s - part)
        older[:, i], newer[:, i] = rest @ first, second
        ticks.append(whole)
    transition, _ = _advance(plant.A, plant.B[:, 0], period_s)
    return SampledPlant(
        transition=transition,
        newer=newer,
        older=older,
        ticks=tuple(ticks),
        C=plant.C,
        period_s=period_s,
    )


def close_loop(
    plant: StateSpace,
    filters: tuple[DigitalFilter, ...],
    sensors: tuple[str, ...],
    names: tuple[str, ...],
    gains: tuple[float, ...] | None = None,
) -> ClosedLoop:
    """Return the closed loop of ``plant`` with one controller for each of its inputs.

    Parameters
    ----------
    filters, sensors, names
        For each input: the difference equation of its controller, the output in counts that the
        controller reads, and the controller's name.
    gains
        Factors on the controllers' gains; 1 when None.

    Raises
    ------
    MachineError
        If the dead times last too many ticks: each is a state.
    """
    period = filters[0].period_s
    sampled = sample(plant, period)
    m, n = len(filters), len(plant.A)
    factors = (1.0,) * m if gains is None else gains
    read = np.array([plant.C[plant.outputs.index(s)] for s in sensors])
    lines = [t + 1 for t in sampled.ticks]
    if sum(lines) > _MOST_TICKS:
        raise MachineError(
            f"{', '.join(f'controllers.{name}' for name in names)}: {sum(sampled.ticks):.6g} ticks "
            f"of {period:.4g} s are under way in the dead time, and a loop is analysed with up to "
            f"{_MOST_TICKS}",
            remedy="Give the controller a longer clock, or its drive a shorter delay.",
        )
    starts = n + np.concatenate(([0], np.cumsum(lines)[:-1])).astype(int)
    memory = n + sum(lines)
    size = memory + 2 * m
    A, B = np.zeros((size, size)), np.zeros((size, m))
    outputs, through = [], []
    A[:n, :n] = sampled.transition
    for i, digital in enumerate(filters):
        b, a = factors[i] * digital.numerator, digital.denominator
        first, second = memory + 2 * i, memory + 2 * i + 1
        error, error_in = np.zeros(size), np.zeros(m)
        error[:n], error_in[i] = -read[i], 1.0
        level, level_in = b[0] * error, b[0] * error_in
        level[first] += 1.0
        # Transposed direct form: s1 = b1 e - a1 u + s2, s2 = b2 e - a2 u.
        A[first], B[first] = b[1] * error - a[1] * level, b[1] * error_in - a[1] * level_in
        A[first, second] += 1.0
        A[second], B[second] = b[2] * error - a[2] * level, b[2] * error_in - a[2] * level_in
        line, ticks = int(starts[i]), sampled.ticks[i]
        A[line], B[line] = level, level_in
        for j in range(1, lines[i]):
            A[line + j, line + j - 1] = 1.0
        if ticks == 0:
            A[:n] += np.outer(sampled.newer[:, i], level)
            B[:n] += np.outer(sampled.newer[:, i], level_in)
        else:
            A[:n, line + ticks - 1] += sampled.newer[:, i]
        A[:n, line + ticks] += sampled.older[:, i]
        outputs.append(level)
        through.append(level_in)
    rows = np.zeros((len(plant.C), size))
    rows[:, :n] = plant.C
    return ClosedLoop(
        A=A,
        B=B,
        C=np.vstack([rows, outputs]),
        D=np.vstack([np.zeros((len(plant.C), m)), through]),
        outputs=(*plant.outputs, *(f"controllers.{name}" for name in names)),
        period_s=period,
    )


def _advance(A: FloatArray, b: FloatArray, time_s: float) -> tuple[FloatArray, FloatArray]:
    """Return ``exp(A t)`` and ``integral of exp(A s) b ds`` over ``0 .. t``."""
    n = len(A)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = A, b
    whole = expm(block * time_s)
    return whole[:n, :n], whole[:n, n]
