"""Learning filters: from the error of a run to the change of its references for the next run.

A change ``e / T`` of the references compensates an error e of the load, where ``T`` is the closed
loop from reference to load, with dead time and hold (``dynamics/inverse.py``). The filter is
``z Q / T``: z is a complex factor for each frequency, and Q is a zero-phase low-pass. On a machine
with the closed loop ``T_c`` the share ``1 - z Q T_c / T`` of the error remains at each frequency.
The error of the next run is smaller if the magnitude of this share is below 1 for every machine
within the tolerances (Bristow, Tharayil and Alleyne, A survey of iterative learning control, IEEE
Control Systems Magazine 26(3), 2006: Q-filter and plant inversion). At each frequency z minimises
the largest magnitude over the machines, and is found with Lawson's weights. If this magnitude is
still near 1, as next to the zeros of a lightly damped frame, nothing is learned at the frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, log2

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics.inverse import closed_responses, corner_responses
from threadline.errors import OptionError
from threadline.machine import Machine

_REMEMBERED_S = 8.0  # length of the filter: a ringing frame has decayed by then
_SAMPLE_LIMITS = (1024, 16384)
_LAWSON_ROUNDS = 50
_LEARNED, _LEFT = 0.7, 0.9
"""Share of the error that remains on the worst machine: up to the first number the filter learns
fully, and from the second number on it does not learn."""
_LEAST_RESPONSE = 0.1  # smallest response of the loop: the motor moves ten times the load's error
_LOW_PASS_ORDER = 8  # exponent of the low-pass
_LOWEST_HZ = 1e-3
_NYQUIST_SHARE = 0.4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LearningFilter:
    """The learning filter of an axis.

    Parameters
    ----------
    axis
        Name of the axis.
    low_pass_hz
        Frequency at which the gain of the low-pass is a half.
    frequency_hz
        (k,) frequencies from 0 to half the rate of the references.
    response
        (k,) change of the reference / error; both in m, or both in rad.
    left
        (k,) largest share of an error, over the machines within the tolerances, that remains after
        one repeat at full gain.
    kernel
        (m,) impulse response; m is odd, and the middle is at the instant of the error.
    """

    axis: str
    low_pass_hz: float
    frequency_hz: FloatArray
    response: ComplexArray
    left: FloatArray
    kernel: FloatArray

    def change(self, error: FloatArray) -> FloatArray:
        """Return the (n,) change of the references at the ticks of the (n,) error.

        The error is 0 before and after the run.
        """
        from scipy.signal import oaconvolve

        half_length = len(self.kernel) // 2
        convolved = oaconvolve(np.asarray(error, dtype=np.float64), self.kernel)
        return np.asarray(convolved[half_length : half_length + len(error)])

    @property
    def unlearned_hz(self) -> tuple[float, float] | None:
        """Range below the low-pass in which nothing is learned; None if there is none."""
        below = (self.frequency_hz < self.low_pass_hz) & (self.frequency_hz > _LOWEST_HZ)
        unlearned = self.frequency_hz[below & (self.left >= _LEFT)]
        return (float(unlearned[0]), float(unlearned[-1])) if len(unlearned) else None


def learning_filter(
    machine: Machine,
    axis: str,
    machines: Sequence[Machine],
    *,
    of_load: bool = True,
    low_pass_hz: float | None = None,
) -> LearningFilter:
    """Return the learning filter of an axis.

    Parameters
    ----------
    machine
        The machine that the references are planned for.
    machines
        Machines within its tolerances on which the error must become smaller.
    of_load
        True: the error of the load. False: the error at the controller's own sensor.
    low_pass_hz
        Frequency at which the gain of the low-pass is a half; None: the lowest frequency at which
        the gain of the loop is below a tenth.

    Raises
    ------
    OptionError
        If ``low_pass_hz`` is not below 0.4 of the rate of the references, the axis has no loop, or
        it shares bodies with the drives of other axes.
    """
    step_s = float(machine.tick_clock.period_s)
    samples = min(
        max(2 ** ceil(log2(_REMEMBERED_S / step_s)), _SAMPLE_LIMITS[0]), _SAMPLE_LIMITS[1]
    )
    frequency: FloatArray = np.asarray(np.fft.rfftfreq(samples, step_s))
    omega = 2.0 * np.pi * np.maximum(frequency, _LOWEST_HZ)
    closed = closed_responses(machine, axis, omega)
    T = closed.load * machine.axes[axis].counts.si if of_load else closed.sensor
    controller = machine.controller_of(axis)
    if controller.reference_clock:  # a reference is held until the next one
        T = T * np.exp(-0.5j * omega * step_s)
    highest = _NYQUIST_SHARE / step_s
    if low_pass_hz is None:
        weak_index = np.flatnonzero(np.abs(T) < _LEAST_RESPONSE)
        low_pass_hz = min(float(frequency[weak_index[0]]) if len(weak_index) else highest, highest)
    elif not 0.0 < low_pass_hz <= highest:
        raise OptionError(
            f"--low-pass {low_pass_hz:g} Hz is not between 0 and {highest:g} Hz, 0.4 of the rate "
            f"of the references of {machine.name}",
            remedy="Lower it, or leave it out.",
        )
    corners = corner_responses(machine, axis, machines, omega)
    ratios = np.stack([corner.load if of_load else corner.sensor for corner in corners])
    factor, left = _least_left(ratios)
    learned_share = np.clip((_LEFT - left) / (_LEFT - _LEARNED), 0.0, 1.0)
    low_pass = 1.0 / (1.0 + (frequency / low_pass_hz) ** _LOW_PASS_ORDER)
    share = factor * learned_share * low_pass
    response = share / T
    kernel = np.fft.irfft(response, samples)
    return LearningFilter(
        axis=axis,
        low_pass_hz=low_pass_hz,
        frequency_hz=frequency,
        response=response,
        left=np.abs(1.0 - share * ratios).max(axis=0),
        kernel=np.roll(kernel, samples // 2)[1:],
    )


def _least_left(ratios: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    """Return the factors z with the smallest ``max |1 - z R|`` over machines, and this maximum.

    Parameters
    ----------
    ratios
        (machines, k) closed loop of each machine / closed loop of the machine of the plan.

    Notes
    -----
    Lawson's algorithm: weighted least squares, whose weights are multiplied by the errors (Lawson,
    Contributions to the theory of linear least maximum approximation, thesis, UCLA 1961).
    """
    weights = np.full(ratios.shape, 1.0 / len(ratios))
    square = np.abs(ratios) ** 2
    best_factor = np.zeros(ratios.shape[1], dtype=np.complex128)
    best_left = np.ones(ratios.shape[1])
    for _ in range(_LAWSON_ROUNDS):
        factor = (weights * ratios.conj()).sum(axis=0) / (weights * square).sum(axis=0)
        error = np.abs(1.0 - factor * ratios)
        largest = error.max(axis=0)
        is_better = largest < best_left
        best_factor, best_left = (
            np.where(is_better, factor, best_factor),
            np.where(is_better, largest, best_left),
        )
        weights = weights * (error + 1e-12)
        weights /= weights.sum(axis=0)
    return best_factor, best_left
