"""Responses of the stitcher's axes by textbook impedances, independent of the package."""

from __future__ import annotations

import numpy as np

HERTZ = np.geomspace(1.0, 200.0, 120)
S = 2j * np.pi * HERTZ
RADIUS = 4.833333e-3  # m/rad: 29 mm behind 6:1
COUNTS = 8000 / (2 * np.pi)
POT = 282.06
KT, KE, R, L, DELAY = 0.5, 60 * 60 / (2 * np.pi * 1000), 0.8, 4e-3, 3e-3


def stitcher_x(k=6.24e5, mass=111.0, damping=3330.0, delay=DELAY, loaded=True):
    """Return the motor angle per volt, rad/V, at ``HERTZ``."""
    motor = 4.75e-4 * S**2 + 0.24 * S + KT * KE * S / (R + L * S)
    if loaded:
        load = mass * S**2 + damping * S
        motor = motor + RADIUS**2 * k * load / (load + k)
    return 40.0 * KT / (R + L * S) / motor * np.exp(-S * delay)


def stitcher_y(k=1e6, mass=70.0, mount=5e6, frame=175.0):
    """Return encoder counts and potentiometer volts per volt, from the three bodies' forces."""
    encoder, pot = [], []
    for s in S:
        motor = 8.1e-4 * s**2 + 0.29 * s + KT * KE * s / (R + L * s)
        # Unknowns: motor angle, head, frame (counted away from the head); stretch = r a - h - f.
        forces = np.array(
            [
                [motor + k * RADIUS**2, -k * RADIUS, -k * RADIUS],
                [-k * RADIUS, mass * s**2 + 2080 * s + k, k],
                [-k * RADIUS, k, frame * s**2 + 1000 * s + k + mount],
            ]
        )
        torque = 42.0 * KT / (R + L * s) * np.exp(-s * DELAY)
        angle, head, base = np.linalg.solve(forces, [torque, 0, 0])
        encoder.append(COUNTS * angle)
        pot.append(POT * (head + base))
    return np.array(encoder), np.array(pot)


def noisy(response, seed, size=0.02):
    """Return the response with noise of ``size`` in log magnitude and in phase."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(2, len(response)))
    return response * np.exp(size * (noise[0] + 1j * noise[1]))


def write_csv(path, response, unit="rad/s/V", head="# axis: X\n"):
    """Return an analyser's table; without a unit in dB of some reference."""
    column = f"magnitude [{unit}]" if unit else "magnitude_db"
    size = np.abs(response) if unit else 20 * np.log10(np.abs(response)) - 30
    rows = zip(HERTZ, size, np.degrees(np.angle(response)), strict=True)
    body = "".join(f"{f!r},{m!r},{p!r}\n" for f, m, p in (map(float, row) for row in rows))
    path.write_text(f"{head}frequency_hz,{column},phase_deg\n{body}")
    return path
