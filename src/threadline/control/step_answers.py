"""Answers of machines to steps of speed that a spline smooths, shifted by each of many weights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
from threadline.control.corner_machines import CornerResponse

Answers = dict[CornerResponse, tuple[FloatArray, FloatArray | None]]
"""(samples, count) answers of each machine to steps of speed, one for each weight: of its load over
the speed, and of its current in A s/m or A s/rad, None without a coil."""


def frequencies_rad_s(period_s: float, count: int) -> FloatArray:
    """Return the frequencies of ``count`` samples; 0 is replaced by next to nothing."""
    omega = 2.0 * np.pi * np.fft.rfftfreq(count, period_s)
    omega[0] = 1e-3 * omega[1]
    return np.asarray(omega)


def answer_steps(
    answers: Answers,
    machines: Sequence[CornerResponse],
    shift_s: FloatArray,
    *,
    step_s: float,
    degree: int,
    grid_s: float,
    samples: int,
) -> None:
    """Put the answers of those of ``machines`` that have none yet into ``answers``.

    Parameters
    ----------
    shift_s
        (count,) by which each weight shifts the step.
    step_s, degree
        Of the uniform B-spline, its knots so far apart.
    grid_s, samples
        Instants about the step; ``machines`` are given at ``frequencies_rad_s(grid_s, samples)``.
    """
    new = [one for one in machines if one not in answers]
    if not new:
        return
    omega = frequencies_rad_s(grid_s, samples)
    spline = np.sinc(omega * step_s / (2.0 * np.pi)) ** (degree + 1)
    shape = spline[:, None] * np.exp(-1j * omega[:, None] * (shift_s + samples // 2 * grid_s))

    def steps(answer: NDArray[np.complex128]) -> FloatArray:
        return np.asarray(np.cumsum(np.fft.irfft(answer[:, None] * shape, samples, axis=0), axis=0))

    for one in new:
        current = None if one.current_s_a_m is None else steps(one.current_s_a_m)
        answers[one] = steps(one.load), current
