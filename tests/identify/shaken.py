"""A damped oscillator shaken by Klipper's sweep, integrated by scipy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy import signal

from threadline.base.arrays import FloatArray

RATE_HZ = 800.0


def sweep(rate_hz: float = RATE_HZ, *, first_hz: float = 10.0, last_hz: float = 90.0) -> FloatArray:
    """Return the commanded acceleration: half periods of either sign, 60 mm/s^2 for every Hz.

    The frequency rises by 1 Hz a second, as in TEST_RESONANCES.
    """
    ends, levels = [], []
    f, sign, time = first_hz, 1.0, 0.0
    while f <= last_hz:
        quarter = 0.25 / f
        for side in (sign, -sign):
            time += quarter
            ends.append(time)
            levels.append(side * 60.0 * f)
        f, sign = f + 2.0 * quarter, -sign
    at = np.arange(0.0, time, 1.0 / rate_hz)
    return np.array(levels)[np.minimum(np.searchsorted(ends, at, side="right"), len(ends) - 1)]


def shaken(
    command: FloatArray, frequency_hz: float, damping: float, rate_hz: float = RATE_HZ
) -> FloatArray:
    """Return the acceleration of a mass behind a spring and a damper, exact for held input."""
    w = 2.0 * np.pi * frequency_hz
    upper, lower, _ = signal.cont2discrete(
        ([w * w], [1.0, 2.0 * damping * w, w * w]), 1.0 / rate_hz, "zoh"
    )
    return np.asarray(signal.lfilter(np.ravel(upper), lower, command))


def three_axes(along_x: FloatArray, noise: float, seed: int) -> FloatArray:
    """Return (n, 3) with gravity along z, leaks of 5 and 2 %, and noise on each."""
    rng = np.random.default_rng(seed)
    found = along_x[:, None] * [1.0, 0.05, 0.02] + [0.0, 0.0, 9800.0]
    return np.asarray(found + noise * rng.standard_normal(found.shape))


def write_raw(path: Path, acceleration: FloatArray, rate_hz: float = RATE_HZ) -> Path:
    """Write Klipper's raw file."""
    table = np.column_stack([np.arange(len(acceleration)) / rate_hz, acceleration])
    np.savetxt(
        path, table, "%.6f", delimiter=",", header="#time,accel_x,accel_y,accel_z", comments=""
    )
    return path


def klipper_psd(
    acceleration: FloatArray, rate_hz: float = RATE_HZ
) -> tuple[FloatArray, FloatArray]:
    """Return Klipper's lines and their power, by a loop over its windows."""
    length = 1 << int(rate_hz * 0.5 - 1.0).bit_length()
    window = np.kaiser(length, 6.0)
    pieces = [
        acceleration[k : k + length] for k in range(0, len(acceleration) - length + 1, length // 2)
    ]
    power = np.mean(
        [
            np.square(np.abs(np.fft.rfft(window[:, None] * (one - one.mean(axis=0)), axis=0)))
            for one in pieces
        ],
        axis=0,
    )
    power *= 2.0 / (rate_hz * np.square(window).sum())
    return np.fft.rfftfreq(length, 1.0 / rate_hz), np.asarray(power)


def write_spectrum(
    path: Path, f: FloatArray, psd: FloatArray, head: str = "", tail: str = ""
) -> Path:
    """Write Klipper's spectrum; ``head`` ends the first line, ``tail`` the others."""
    lines = [f"freq,psd_x,psd_y,psd_z,psd_xyz{head}"]
    for hz, (x, y, z) in zip(f.tolist(), psd.tolist(), strict=True):
        if hz < 200.0:
            lines.append(f"{hz:.1f},{x:.3e},{y:.3e},{z:.3e},{x + y + z:.3e}{tail}")
    path.write_text("\n".join(lines) + "\n")
    return path
