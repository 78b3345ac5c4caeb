"""Step responses of the sampled loop, and the figures read from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.plant.loop import Loop

_DECAY = 1e-4
_MOST_TICKS = 200_000
_BAND = 0.02


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """The response to a step of 1 in the reference, in the unit of the reference.

    Parameters
    ----------
    time_s, value
        (k,) ticks of the controller and response at them; the step is at 0.
    final
        Steady state of the response.
    rise_s
        Time from 10 to 90 % of the final value.
    settling_s
        Time until the response stays within 2 % of the final value.
    overshoot
        Excess of the largest value over the final one, as a share of the final one; 0 for none.
    peak_s
        Time of the largest value.
    steady_state_error
        1 less the final value.
    """

    time_s: FloatArray
    value: FloatArray
    final: float
    rise_s: float
    settling_s: float
    overshoot: float
    peak_s: float
    steady_state_error: float


def step_response(
    loop: Loop, output: str = "measured", duration_s: float | None = None
) -> Step | None:
    """Return the response of an axis to a unit step of its reference.

    It is None where the loop is unstable, and where the output ends at 0.

    Parameters
    ----------
    output
        ``"measured"``, ``"load"`` or ``"frame"``.
    duration_s
        By default until the slowest closed-loop pole has decayed to one in ten thousand.
    """
    closed = loop.closed()
    radius = closed.spectral_radius
    if radius >= 1.0:
        return None
    ticks = (
        int(np.ceil(np.log(_DECAY) / np.log(max(radius, 1e-3)))) + 20
        if duration_s is None
        else int(np.ceil(duration_s / closed.period_s)) + 1
    )
    reference = np.zeros((min(ticks, _MOST_TICKS), len(loop.filters)))
    reference[:, loop.index] = loop.counts_per_unit
    row = closed.outputs.index(f"{loop.axis}.{output}")
    value = np.ascontiguousarray(closed.respond(reference)[:, row])
    final = float(closed.steady()[row, loop.index]) * loop.counts_per_unit
    if final == 0.0:
        return None  # the figures are shares of the final value
    time_s = np.asarray(np.arange(len(value)) * closed.period_s, dtype=np.float64)
    return read_step(time_s, value, final)


def read_step(time_s: FloatArray, value: FloatArray, final: float) -> Step:
    """Return the figures of a step response that ends at ``final``.

    Crossings are interpolated linearly between samples.
    """
    share = value / final
    peak = int(np.argmax(share))
    outside = np.nonzero(np.abs(share - 1.0) > _BAND)[0]
    if not len(outside):
        settled = 0.0
    elif outside[-1] + 1 == len(share):
        settled = float(time_s[-1])
    else:
        k = int(outside[-1])
        edge = 1.0 + _BAND * np.sign(share[k] - 1.0)
        settled = _between(time_s, share, k, float(edge))
    return Step(
        time_s=time_s,
        value=value,
        final=final,
        rise_s=_first(time_s, share, 0.9) - _first(time_s, share, 0.1),
        settling_s=settled,
        overshoot=max(0.0, float(share[peak]) - 1.0),
        peak_s=float(time_s[peak]),
        steady_state_error=1.0 - final,
    )


def _first(time_s: FloatArray, share: FloatArray, level: float) -> float:
    above = np.nonzero(share >= level)[0]
    if not len(above):
        return float(time_s[-1])
    k = int(above[0])
    return float(time_s[0]) if k == 0 else _between(time_s, share, k - 1, level)


def _between(time_s: FloatArray, share: FloatArray, k: int, level: float) -> float:
    rise = share[k + 1] - share[k]
    part = 0.0 if rise == 0 else (level - share[k]) / rise
    return float(time_s[k] + part * (time_s[k + 1] - time_s[k]))
