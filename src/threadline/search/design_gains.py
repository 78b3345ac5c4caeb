"""Lead filters for many candidates at once, each from its own exact frequency response."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import ComplexArray, FloatArray
from threadline.control import lead_deg, lead_from_response
from threadline.errors import MachineError
from threadline.machine.controllers import COEFFICIENT_HIGH, COEFFICIENT_LOW
from threadline.plant.elements import working_rates
from threadline.plant.network import PiecewiseLinear, piecewise_linear
from threadline.plant.values import Values
from threadline.search.design_space import Space

_ROUNDING = 1e-9
_TERMS = 14  # of the series, for norms up to a half: 0.5^15 / 15! is below rounding


def design_gains(
    space: Space, points: FloatArray
) -> tuple[dict[str, FloatArray], NDArray[np.bool_]]:
    """Return the lead filters of candidates, and which of them have one.

    Parameters
    ----------
    points
        (n, dims): the crossover and phase margin wanted are their last two coordinates.

    Returns
    -------
    tuple
        Path of each controller's number to its (n,) values, and an (n,) mask, False where more
        lead is needed than a filter has. A loop that has more phase than asked without any lead
        keeps it: its zero stays as far out as the chip allows.

    Raises
    ------
    MachineError
        If several controllers share bodies.
    """
    machine, count = space.machine, len(points)
    crossover_hz, margin_deg = np.exp(points[:, -2]), points[:, -1]
    omega = 2.0 * np.pi * crossover_hz
    values = Values.of(machine, space.numbers(points))
    numbers: dict[str, FloatArray] = {}
    possible: NDArray[np.bool_] = np.ones(count, dtype=np.bool_)
    for piece in piecewise_linear(machine, values):
        if not piece.group.axes:
            continue
        if len(piece.group.controllers) != 1:
            raise MachineError(
                f"the controllers {', '.join(piece.group.controllers)} share bodies",
                place=machine.place,
                remedy="Take crossover and phase_margin out of [design.settings]; give gains.",
            )
        name = piece.group.controllers[0]
        controller = machine.controllers[name]
        period = float(machine.clock(controller.clock).period_s)
        response = sampled_response(piece, values, omega, period)
        gain, zero = lead_from_response(response, omega, margin_deg, period)
        # Enough phase without any lead: the zero goes as far out as it can.
        ample = ~(zero <= COEFFICIENT_HIGH) & (lead_deg(response, margin_deg) <= 0.0)
        zero = np.where(ample | (zero < COEFFICIENT_LOW), COEFFICIENT_LOW, zero)
        z = np.exp(1j * omega * period)
        gain = np.abs(z + COEFFICIENT_LOW) / (np.abs(z - zero) * np.abs(response))
        possible &= (zero <= COEFFICIENT_HIGH) & np.isfinite(gain)
        sound = np.where(possible, zero, COEFFICIENT_LOW)
        numbers[f"controllers.{name}.gain"] = np.where(
            possible, gain / controller.dac.volt_per_level, 0.0
        )
        numbers[f"controllers.{name}.zero"] = sound
        numbers[f"controllers.{name}.pole"] = np.full(count, COEFFICIENT_LOW)
    return numbers, possible


def sampled_response(
    piece: PiecewiseLinear, values: Values, omega_rad_s: FloatArray, period_s: float
) -> ComplexArray:
    """Return (n,) the response of each variant of a piece at its own frequency, counts per volt.

    The same as ``SampledPlant.response`` of each: a held output behind a dead time of ``d T + f``
    delivers the older value for ``f`` of each tick and the newer for the rest.

    Parameters
    ----------
    piece
        With one controller.
    omega_rad_s
        (n,) one for each variant.
    """
    machine, n = values.machine, len(piece.states)
    rates = working_rates(piece.base, piece.elements)
    count = len(rates)
    drive = piece.group.drives[0]
    delay = np.broadcast_to(
        values.at(f"drives.{drive}.delay", machine.motors[drive].delay), (count,)
    )
    whole = np.floor(delay / period_s + _ROUNDING)
    part = np.maximum(delay - whole * period_s, 0.0)
    block = np.zeros((count, n + 1, n + 1))
    block[:, :n, :n] = rates[:, :, :n]
    block[:, :n, n] = rates[:, :, n] * piece.input_gain[:, :1]
    late = _exponentials(block * part[:, None, None])
    rest = _exponentials(block * (period_s - part)[:, None, None])
    transition = rest[:, :n, :n] @ late[:, :n, :n]
    older = (rest[:, :n, :n] @ late[:, :n, n:])[:, :, 0]
    z = np.exp(1j * omega_rad_s * period_s)
    push = (rest[:, :n, n] + older / z[:, None]) * (z**-whole)[:, None]
    state = np.linalg.solve(z[:, None, None] * np.eye(n) - transition, push[:, :, None])[:, :, 0]
    index = piece.group.sensors.index(machine.controllers[piece.group.controllers[0]].sensor)
    return np.asarray((piece.sensor_rows[:, index, :n] * state).sum(axis=1))


def _exponentials(matrices: FloatArray) -> FloatArray:
    """Return the exponentials of (n, m, m) matrices: halved until small, summed, squared back.

    All of them at once: scipy's takes them one by one, through a threaded library that makes
    thousands of small matrices wait for each other.
    """
    norm = float(np.abs(matrices).sum(axis=2).max(initial=0.0))
    halvings = max(int(np.ceil(np.log2(max(norm, 0.5)))) + 1, 0)
    small = matrices / 2.0**halvings
    unit = np.broadcast_to(np.eye(matrices.shape[1]), matrices.shape)
    total = unit.copy()
    for k in range(_TERMS, 0, -1):
        total = unit + small @ total / k
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)
