"""The same axis by scipy and by python-control."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from benchmarks._twin_cases import (
    BREAK,
    COUNTS,
    GAIN,
    KE,
    KT,
    LIMIT,
    SLIDE,
    VOLT,
    H,
    J,
    Loop,
    R,
    rows_of,
)


def clipped(case: str, volts: float, omega: float) -> float:
    current = (volts - KE * omega) / R
    return min(max(current, -LIMIT), LIMIT) if case == "saturated" else current


def scipy_run(case: str, ticks: int, quantised: bool, rtol: float = 1e-8) -> np.ndarray:
    """Return (ticks,) angles in rad at the ticks."""
    rows, loop = rows_of(case, ticks), Loop(quantised)
    x, reference, sign, angles = np.zeros(2), 0.0, 0, []
    for row in rows:
        angles.append(x[0])
        volts = loop.volts(reference, x[0])
        if case != "contact":

            def slope(_t: float, y: np.ndarray, u: float = volts) -> list[float]:
                return [y[1], KT * clipped(case, u, y[1]) / J]

            x = solve_ivp(slope, (0, H), x, rtol=rtol, atol=1e-10).y[:, -1]
        else:
            x, sign = _slip(x, sign, volts, rtol)
        reference += row
    return np.array(angles)


def _slip(x: np.ndarray, sign: int, volts: float, rtol: float) -> tuple[np.ndarray, int]:
    left = H
    while left > 0:
        if sign == 0:
            torque = KT * volts / R
            if abs(torque) <= BREAK:
                return np.array([x[0], 0.0]), 0
            sign = 1 if torque > 0 else -1

        def slope(_t: float, y: np.ndarray, s: int = sign) -> list[float]:
            return [y[1], (KT * (volts - KE * y[1]) / R - s * SLIDE) / J]

        def stops(_t: float, y: np.ndarray, s: int = sign) -> float:
            return float(s * y[1])

        stops.terminal, stops.direction = True, -1  # type: ignore[attr-defined]
        done = solve_ivp(slope, (0, left), x, rtol=rtol, atol=1e-10, events=stops)
        x, left = done.y[:, -1], left - done.t[-1]
        if done.status == 1:
            x, sign = np.array([x[0], 0.0]), 0
    return x, sign


def control_run(case: str, ticks: int) -> np.ndarray:
    import control

    rows = rows_of(case, ticks)
    references = np.concatenate(([0], np.cumsum(rows)[:-1])).astype(float)
    if case == "linear-quantised":
        generator = np.zeros((3, 3))
        generator[0, 1], generator[1, 1], generator[1, 2] = 1.0, -KT * KE / (R * J), KT / (R * J)
        E = expm(generator * H)

        def update(_t: float, x: np.ndarray, r: np.ndarray, _p: dict[str, Any]) -> np.ndarray:
            error = r[0] - np.floor(x[0] * COUNTS + 0.5)
            level = min(max(np.rint(2 * error + 4 * (error - x[2])), -2048.0), 2047.0)
            if level * x[3] < 0:
                level = 0.0
            u = level * VOLT * GAIN
            return np.array(
                [
                    E[0, 0] * x[0] + E[0, 1] * x[1] + E[0, 2] * u,
                    E[1, 0] * x[0] + E[1, 1] * x[1] + E[1, 2] * u,
                    error,
                    level,
                ]
            )

        whole = control.nlsys(
            update, lambda _t, x, _u, _p: x[:1], inputs=1, outputs=1, states=4, dt=H
        )
        times = np.arange(ticks) * H
        done = control.input_output_response(whole, times, references, np.zeros(4))
        return np.asarray(done.outputs).ravel()

    def slope(_t: float, x: np.ndarray, u: np.ndarray, _p: dict[str, Any]) -> np.ndarray:
        torque = KT * clipped(case, u[0], x[1])
        if case == "contact":
            # It has no events: friction opposes the speed, and holds below the breakaway torque.
            if abs(x[1]) < 1e-6 and abs(torque) <= BREAK:
                return np.array([0.0, -x[1] / H])
            torque -= SLIDE * np.sign(x[1] if abs(x[1]) >= 1e-6 else torque)
        return np.array([x[1], torque / J])

    plant = control.nlsys(slope, None, inputs=1, states=2)
    loop, x, angles = Loop(), np.zeros(2), []
    span = np.array([0.0, H])
    for reference in references:
        angles.append(x[0])
        volts = loop.volts(reference, x[0])
        done = control.input_output_response(plant, span, np.full(2, volts), x)
        x = np.asarray(done.states)[:, -1]
    return np.array(angles)
