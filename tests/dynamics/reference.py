"""The stitcher written out by hand from the printed numbers, independent of the package."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

KT, R, L, TAU = 0.5, 0.8, 4e-3, 3e-3
KV = 60 / (1000 * 2 * np.pi / 60)
RATIO = 29e-3 / 6
TICK = 136e-6
COUNTS = 8000 / (2 * np.pi)
VOLTS = 20 / 256

X = {"Ka": 40, "J": 4.75e-4, "B": 0.24, "M": 111, "b": 3330, "k": 6.24e5}
Y = {
    "Ka": 42,
    "J": 8.1e-4,
    "B": 0.29,
    "M": 70,
    "b": 2080,
    "k": 1e6,
    "Mf": 175,
    "bf": 1000,
    "kf": 5e6,
}


def motor_angle(p, s, *, rigid=False, mass=1.0, load=False):
    """Return radians of the motor (or metres of the head) per volt, without dead time.

    Belt force F = Z (r/N theta) with Z the dynamic stiffness of belt, head and frame in a row.
    """
    head = p["M"] * mass * s**2 + p["b"] * s
    if rigid:
        impedance = head
    else:
        flexible = 1 / p["k"] + 1 / head
        if "Mf" in p:
            flexible = flexible + 1 / (p["Mf"] * s**2 + p["bf"] * s + p["kf"])
        impedance = 1 / flexible
    torque_per_angle = p["J"] * s**2 + p["B"] * s + RATIO**2 * impedance
    # V = R i + L s i + Kv s theta, i = torque / Kt
    angle = p["Ka"] / (torque_per_angle * (R + L * s) / KT + KV * s)
    return angle * RATIO * impedance / head if load else angle


def lead_tustin(K, A, B, s):
    a, b = 2 / TICK * (1 - A) / (1 + A), 2 / TICK * (1 + B) / (1 - B)
    return K * (1 + A) / (1 - B) * (s + a) / (s + b) * VOLTS * COUNTS


def open_loop(p, K, A, B, omega, **options):
    """Return V/rad times rad/V: the loop with exact dead time and half a tick for the hold."""
    s = 1j * omega
    lag = np.exp(-s * (TAU + TICK / 2))
    return lead_tustin(K, A, B, s) * motor_angle(p, s, **options) * lag


FILTERS = {
    "stitcher-rigid": {"X": (0.89, 0.976, 0.004), "Y": (0.85, 0.973, 0.004)},
    "stitcher-rigid-half-mass": {"X": (0.72, 0.966, 0.047), "Y": (0.77, 0.961, 0.188)},
}


def dense_margins(response, low, high, points=400_001):
    """Return gain margin and worst phase margin by brute force on a dense grid, interpolated."""
    omega = np.geomspace(low, high, points)
    value = response(omega)
    size = np.log(np.abs(value))
    worst = np.inf
    for k in np.nonzero(size[:-1] * size[1:] <= 0)[0]:
        part = size[k] / (size[k] - size[k + 1])
        angle = np.angle(-value[k]) + part * np.angle(value[k + 1] / value[k])
        worst = min(worst, np.degrees(angle))
    gain = np.inf
    for k in np.nonzero((value.imag[:-1] * value.imag[1:] <= 0) & (value.real[:-1] < 0))[0]:
        part = value.imag[k] / (value.imag[k] - value.imag[k + 1])
        factor = -1 / (value.real[k] + part * (value.real[k + 1] - value.real[k]))
        if factor > 1:
            gain = min(gain, factor)
    return gain, worst


def simulate_x(K, A, B, counts, ticks):
    """Return (ticks,) positions of the X head after a step of ``counts``, by DOP853.

    The filter acts at every tick; its volts arrive 22.06 ticks later, between two ticks.
    """
    p = X

    def slope(_t, y, volts):
        theta, x, omega, v, i = y
        force = p["k"] * (RATIO * theta - x)
        return [
            omega,
            v,
            (KT * i - p["B"] * omega - RATIO * force) / p["J"],
            (force - p["b"] * v) / p["M"],
            (p["Ka"] * volts - R * i - KV * omega) / L,
        ]

    state, sent, head = np.zeros(5), [], []
    error_before = level = 0.0
    part = TAU % TICK
    for k in range(ticks):
        head.append(state[1])
        error = counts - state[0] * COUNTS
        level = K * (error - A * error_before) - B * level
        error_before = error
        sent.append(level * VOLTS)
        late = int(TAU // TICK)
        for first, last, index in ((0.0, part, k - late - 1), (part, TICK, k - late)):
            volts = sent[index] if index >= 0 else 0.0
            done = solve_ivp(
                slope, (first, last), state, "DOP853", args=(volts,), rtol=1e-11, atol=1e-15
            )
            state = done.y[:, -1]
    return np.array(head)
