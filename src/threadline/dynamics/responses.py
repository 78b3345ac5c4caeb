"""Responses of an axis: steps, impulses, and its speed over frequency."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from threadline.base.arrays import FloatArray, Locked, Recent, read_only
from threadline.dynamics.loop import Loop, axis_loops
from threadline.machine import Machine

_STEP_RESPONSES_DECAY = 1e-4
_STEP_RESPONSES_MOST_TICKS = 200_000
_BAND = 0.02


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """The response to a unit step of the reference, in the unit of the reference.

    Parameters
    ----------
    time_s, value
        (k,) times of the controller's ticks, s, and the response; the step is at time 0.
    final
        Steady state of the response.
    rise_s
        Time from 10 to 90 % of the final value.
    settling_s
        Time until the response stays within 2 % of the final value.
    overshoot
        (Largest value - final value) / final value; 0 without overshoot.
    peak_s
        Time of the largest value.
    steady_state_error
        1 - final value.
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

    None if the loop is unstable or the final value is 0.

    Parameters
    ----------
    output
        ``"measured"``, ``"load"`` or ``"frame"``.
    duration_s
        Length of the response; by default until the slowest closed-loop pole has decayed to 1e-4.
    """
    closed = loop.closed()
    radius = closed.spectral_radius
    if radius >= 1.0:
        return None
    ticks = (
        int(np.ceil(np.log(_STEP_RESPONSES_DECAY) / np.log(max(radius, 1e-3)))) + 20
        if duration_s is None
        else int(np.ceil(duration_s / closed.period_s)) + 1
    )
    reference = np.zeros((min(ticks, _STEP_RESPONSES_MOST_TICKS), len(loop.controllers)))
    reference[:, loop.index] = loop.counts_per_unit
    output_row = closed.outputs.index(f"{loop.axis}.{output}")
    value = np.ascontiguousarray(closed.respond(reference)[:, output_row])
    final = float(closed.steady()[output_row, loop.index]) * loop.counts_per_unit
    if final == 0.0:
        return None  # the figures are relative to the final value, which is 0
    time_s = np.asarray(np.arange(len(value)) * closed.period_s, dtype=np.float64)
    return read_step(time_s, value, final)


def read_step(time_s: FloatArray, value: FloatArray, final: float) -> Step:
    """Return the figures of a step response with the final value ``final``.

    ``time_s`` and ``value`` are (k,). Crossings are interpolated linearly between samples.
    """
    share = value / final
    peak = int(np.argmax(share))
    outside = np.nonzero(np.abs(share - 1.0) > _BAND)[0]
    if not len(outside):
        settled_s = 0.0
    elif outside[-1] + 1 == len(share):
        settled_s = float(time_s[-1])
    else:
        k = int(outside[-1])
        edge = 1.0 + _BAND * np.sign(share[k] - 1.0)
        settled_s = _crossing_s(time_s, share, k, float(edge))
    return Step(
        time_s=time_s,
        value=value,
        final=final,
        rise_s=_first_reached_s(time_s, share, 0.9) - _first_reached_s(time_s, share, 0.1),
        settling_s=settled_s,
        overshoot=max(0.0, float(share[peak]) - 1.0),
        peak_s=float(time_s[peak]),
        steady_state_error=1.0 - final,
    )


def _first_reached_s(time_s: FloatArray, share: FloatArray, level: float) -> float:
    above = np.nonzero(share >= level)[0]
    if not len(above):
        return float(time_s[-1])
    k = int(above[0])
    return float(time_s[0]) if k == 0 else _crossing_s(time_s, share, k - 1, level)


def _crossing_s(time_s: FloatArray, share: FloatArray, k: int, level: float) -> float:
    rise = share[k + 1] - share[k]
    part = 0.0 if rise == 0 else (level - share[k]) / rise
    return float(time_s[k] + part * (time_s[k + 1] - time_s[k]))


_CLOSED_LOOP_DECAY = 1e-5  # the response is cut off when the slowest pole has decayed to this share
_CLOSED_LOOP_MOST_TICKS = 50_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer(Locked):
    """The response of the load of one axis to its references, as a finite impulse response.

    Parameters
    ----------
    axis
        Name of the axis.
    period_s
        Tick of its controller.
    taps
        (n,) response of the load, 0 to n - 1 ticks after a unit impulse of the reference; the sum
        is 1.
    """

    axis: str
    period_s: float
    taps: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "taps", read_only(self.taps, "taps", ndim=1))

    @property
    def memory_s(self) -> float:
        """Duration of the effect of a reference on the load, s."""
        return len(self.taps) * self.period_s

    @cached_property
    def moments(self) -> tuple[float, float]:
        """First moment of the taps in s, and half of their second moment in s^2.

        For a slowly changing reference r the position of the load is ``r - first r' + second r''``.
        Therefore ``first`` is the lag.
        """
        time_s = np.arange(len(self.taps)) * self.period_s
        return float(self.taps @ time_s), 0.5 * float(self.taps @ time_s**2)

    def load(self, reference: FloatArray) -> FloatArray:
        """Return the (k,) positions of the load at the ticks of (k,) references.

        Parameters
        ----------
        reference
            (k,) references, m or rad, one per tick of the controller. Before them the load rests at
            the first reference.
        """
        start = reference[0]
        return np.asarray(start + _filtered(reference - start, self.taps))


def _filtered(values: FloatArray, taps: FloatArray) -> FloatArray:
    """Return (k,) values filtered by (n,) taps, by the overlap-add method.

    ``scipy.signal.oaconvolve`` does the same, but its import takes a second: a fifth of the time of
    a short job.
    """
    size = 1 << (4 * len(taps) - 1).bit_length()
    part_length = size - len(taps) + 1
    parts = np.zeros((-(-len(values) // part_length), part_length))
    parts.ravel()[: len(values)] = values
    filtered_parts = np.fft.irfft(np.fft.rfft(parts, size) * np.fft.rfft(taps, size), size)
    joined = np.ascontiguousarray(filtered_parts[:, :part_length])
    joined[1:, : size - part_length] += filtered_parts[
        :-1, part_length:
    ]  # overlap with the next part
    return joined.ravel()[: len(values)]


_RECENT: Recent[Machine, dict[str, Answer]] = Recent(8, lambda a, b: a is b or a == b)


def answers_of(machine: Machine) -> dict[str, Answer]:
    """Return the response of every axis of ``machine`` with a controller, by name.

    If axes share bodies, the response of an axis holds for references 0 of the other axes.
    """

    def answers() -> dict[str, Answer]:
        return {axis: _answer(loop) for axis, loop in axis_loops(machine).items()}

    # Cached, because every run and every plan of a search needs the same machine's response.
    return dict(_RECENT.of(machine, answers))


def _answer(loop: Loop) -> Answer:
    closed = loop.closed()
    slowest = min(max(closed.spectral_radius, 1e-3), 1.0 - 1e-9)
    ticks = min(
        int(np.ceil(np.log(_CLOSED_LOOP_DECAY) / np.log(slowest))) + 20, _CLOSED_LOOP_MOST_TICKS
    )
    reference = np.zeros((ticks, len(loop.controllers)))
    reference[0, loop.index] = loop.counts_per_unit
    taps = closed.respond(reference)[:, closed.outputs.index(f"{loop.axis}.load")]
    # The load finally reaches its reference, so the truncated taps are scaled to the sum 1.
    return Answer(axis=loop.axis, period_s=closed.period_s, taps=taps / taps.sum())


def speed_response(loop: Loop, omega_rad_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the (k,) magnitude of speed per volt, dB relative to zero frequency, and (k,) phase.

    This is the continuous response of amplifier and plant, without sampling.
    """
    plant = loop.axis_plant()

    def speed(omega: FloatArray) -> FloatArray:
        return np.asarray(1j * omega * plant.response(omega)[:, 0, 0])

    speed_at_rest = abs(speed(omega_rad_s[:1] * 1e-3)[0])
    response = speed(omega_rad_s)
    return (
        np.asarray(20.0 * np.log10(np.abs(response) / speed_at_rest)),
        np.asarray(np.degrees(np.unwrap(np.angle(response)))),
    )
