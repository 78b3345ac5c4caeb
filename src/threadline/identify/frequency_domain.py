"""Residuals of measured frequency responses: logarithms of measured over modelled response.

The real part is the logarithm of the ratio of magnitudes, the imaginary part the difference of
phases in rad, so that 2 % of magnitude weigh as much as 0.02 rad of phase. A response without a
unit has a free gain: the mean of its real parts is removed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray, IntArray
from threadline.dynamics.values import Values
from threadline.identify.measured_response import (
    MeasuredResponse,
    Path,
    model_response,
    path_of,
    usable,
)
from threadline.machine import Machine

_UNLIKELY = 4.0  # deviations
_ROUNDING = 1e-9
_SURE = 0.9999  # coherence above which the weight of a point does not grow


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ResponseData:
    """A measured response on a machine, ready to be compared with its variants.

    Parameters
    ----------
    machine
        The machine on which it was measured.
    measured
        The response.
    axis
        The axis, if the file does not name it.
    """

    machine: Machine
    measured: MeasuredResponse
    axis: str = ""
    path: Path = field(init=False)
    left_out: int = field(init=False)
    omega: FloatArray = field(init=False)
    value: ComplexArray = field(init=False)
    weight: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        is_usable, left_out = usable(self.measured)
        coherence = self.measured.coherence
        weight = np.ones(int(np.sum(is_usable)))
        if coherence is not None:
            # The relative deviation of a response is sqrt((1 - c) / (2 c n)) for n averages (Bendat
            # and Piersol, *Random Data*, 2010, section 9.2); the fit finds the common factor.
            clipped_coherence = np.minimum(coherence[is_usable], _SURE)
            weight = np.sqrt(clipped_coherence / (1.0 - clipped_coherence))
            weight /= np.median(weight)
        for name, value in (
            ("path", path_of(self.machine, self.measured, self.axis)),
            ("left_out", left_out),
            ("omega", 2.0 * np.pi * self.measured.frequency_hz[is_usable]),
            ("value", self.measured.value[is_usable]),
            ("weight", weight),
        ):
            object.__setattr__(self, name, value)

    @property
    def name(self) -> str:
        """Name of the file; without a file, the output."""
        return str(self.measured.place) if self.measured.place else self.path.output

    @property
    def step(self) -> float:
        """Relative step of a derivative."""
        return 1e-5

    @property
    def floor(self) -> FloatArray:
        """(size,) least noise: the rounding of a table with nine digits."""
        return np.full(self.size, _ROUNDING)

    @property
    def robust(self) -> bool:
        """Whether outliers are expected: yes, single points of a response may be wrong."""
        return True

    @property
    def normalised(self) -> bool:
        """Whether the magnitude has no unit."""
        return not self.measured.absolute

    @property
    def size(self) -> int:
        """Number of residuals: two for each point."""
        return 2 * len(self.omega)

    @property
    def sources(self) -> IntArray:
        """(size,) source of each residual, counted from 0."""
        return np.zeros(self.size, dtype=np.int64)

    def residuals(self, numbers: Mapping[str, FloatArray]) -> FloatArray:
        """Return the (variants, size) weighted residuals of variants of the machine.

        Parameters
        ----------
        numbers
            Dotted name to (variants,) SI values.
        """
        # Not ``Values.of``, which checks every name: thousands of times in a fit.
        (count,) = {len(value) for value in numbers.values()}
        values = Values(self.machine, numbers, count)
        model = model_response(self.machine, values, self.path, self.omega)
        with np.errstate(divide="ignore", invalid="ignore"):
            log_ratio = np.log(self.value / model)
        log_magnitude = log_ratio.real
        if not self.measured.absolute:
            share = self.weight**2 / np.sum(self.weight**2)
            log_magnitude = log_magnitude - (log_magnitude @ share)[:, None]
        return np.concatenate((log_magnitude * self.weight, log_ratio.imag * self.weight), axis=1)

    def left_over(self, residual: FloatArray, noise: FloatArray) -> list[str]:
        """Describe where the residuals of the fitted response exceed their noise.

        The mean of seven neighbouring residuals, of magnitude or phase, is compared with four times
        the deviation of such a mean.

        Parameters
        ----------
        residual, noise
            (size,) residuals of magnitude, then of phase, and their noise.
        """
        count = len(self.omega)
        width = min(7, count)
        hertz = self.omega / (2.0 * np.pi)
        texts = []
        for offset, quantity in ((0, "magnitude"), (count, "phase")):
            share = (residual / noise)[offset : offset + count]
            unweighted = residual[offset : offset + count] / self.weight
            mean = np.convolve(share, np.ones(width) / np.sqrt(width), mode="valid")
            unlikely = np.flatnonzero(np.abs(mean) > _UNLIKELY)
            for run in np.split(unlikely, np.flatnonzero(np.diff(unlikely) > width) + 1):
                if not len(run):
                    continue
                worst = run[int(np.argmax(np.abs(mean[run])))]
                size = float(np.mean(unweighted[worst : worst + width]))
                off_text = (
                    f"{100.0 * np.expm1(size):+.1f} %"
                    if not offset
                    else f"{np.degrees(size):+.1f} deg"
                )
                texts.append(
                    f"{quantity} from {hertz[run[0]]:.4g} to {hertz[run[-1] + width - 1]:.4g} Hz: "
                    f"measured {off_text} from the fit"
                )
        return texts
