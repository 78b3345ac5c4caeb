"""An oscillator that is simulated, not shaped: the proof that every design has to pass.

Nothing here knows a formula of input shaping. A unit step is cut into the levels that the
shaper makes of it, x'' + 2 zeta omega x' + omega^2 x = omega^2 u is carried from switching to
switching with the matrix exponential, and what still rings at the end is compared with what
rings after the plain step.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm

from threadline.arrays import FloatArray
from threadline.shaping.types import Shaper, ShaperError

PROOF_TOLERANCE = 1e-9
"""Designs are solved to 1e-10; expm and up to 20 switchings add rounding well below 1e-9."""


def simulated_vibration(shaper: Shaper, frequency_hz: float, damping_ratio: float) -> float:
    """Ringing left by a shaped unit step, relative to that left by a plain one.

    Parameters
    ----------
    shaper
        Impulse train; sums to what the step ends at.
    frequency_hz, damping_ratio
        Undamped frequency, Hz, and damping ratio in [0, 1).

    Returns
    -------
    float
        Envelope of the deviation from rest at the last switching over the envelope of the
        plain step at its own.
    """
    omega = 2.0 * math.pi * frequency_hz
    # State (x, x'/omega, u): u is carried along, so that one exponential does it all.
    matrix = omega * np.array([[0.0, 1.0, 0.0], [-1.0, -2.0 * damping_ratio, 1.0], [0.0, 0.0, 0.0]])
    steps = np.diff(shaper.times_s)
    transitions = expm(matrix * steps[:, None, None]) if len(steps) else np.empty((0, 3, 3))
    state = np.zeros(3)
    state[2] = shaper.amplitudes[0]
    for transition, amplitude in zip(transitions, shaper.amplitudes[1:], strict=True):
        state = transition @ state
        state[2] += amplitude
    ringing = _envelope(state[0] - state[2], state[1], damping_ratio)
    return ringing / _envelope(-1.0, 0.0, damping_ratio)


def _envelope(deviation: float, rate_over_omega: float, damping_ratio: float) -> float:
    """Amplitude of a damped ringing from its deviation and its rate over omega."""
    quadrature = (rate_over_omega + damping_ratio * deviation) / math.sqrt(1 - damping_ratio**2)
    return math.hypot(deviation, quadrature)


def prove(
    shaper: Shaper,
    frequency_hz: FloatArray,
    damping_ratio: float,
    expected: FloatArray,
    *,
    at_most: bool = False,
) -> Shaper:
    """Return ``shaper`` if the simulated oscillator agrees with the design, else raise.

    Parameters
    ----------
    shaper
        What was designed; its amplitudes must sum to 1.
    frequency_hz
        Undamped frequencies to simulate, Hz, shape ``(m,)``.
    damping_ratio
        Held for all of them.
    expected
        Vibration that the design claims at each, shape ``(m,)``.
    at_most
        True where ``expected`` is a bound and not a value.

    Raises
    ------
    ShaperError
        If the sum is not 1 or a simulated vibration differs by more than 1e-9.
    """
    if abs(float(shaper.amplitudes.sum()) - 1.0) > PROOF_TOLERANCE:
        raise ShaperError(
            f"shaper '{shaper.name}': amplitudes sum to {shaper.amplitudes.sum()!r}, not to 1"
        )
    for f, claim in zip(frequency_hz, expected, strict=True):
        found = simulated_vibration(shaper, float(f), damping_ratio)
        error = found - float(claim)
        if error > PROOF_TOLERANCE or (not at_most and error < -PROOF_TOLERANCE):
            raise ShaperError(
                f"shaper '{shaper.name}': simulated vibration at {f:.6g} Hz, damping "
                f"{damping_ratio:g}, is {found:.3e}; the design claims {float(claim):.3e}",
                remedy="Change the tolerance, the damping or the kind of shaper.",
            )
    return shaper
