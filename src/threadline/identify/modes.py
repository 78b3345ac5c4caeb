"""The mode that an accelerometer saw: frequency and damping with intervals, from power alone.

The spectrum of a sweep or a tap gives the strength of a vibration at each frequency, and not its
phase to the command, so it shows modes and is no response. The power near a mode is ``C f^p |H +
c|^2 + N`` with

    H = 1 / (1 - r^2 + 2 i zeta r),    r = f / f_n

where ``p`` depends on the excitation (Klipper's sweep: 2, a tap: 0), and ``c`` is the part of other
modes and of another excitation. The intervals allow for residuals of uneven size that are
correlated over neighbouring lines: White's covariance with Newey and West's weights (1987), "A
simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance
matrix", Econometrica 55(3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError, RecordingError
from threadline.identify.accelerometer import AXES, Spectrum, Vibration
from threadline.motion.shaping import FlexibleMode

KAISER = 6.0
"""Beta of the window of Klipper's spectra."""
WINDOW_S = 0.5
"""Duration in s; Klipper's windows have the next power of 2 of samples above it."""
MOST_HZ = 200.0
_BINS = 60
_LAGS = 3
_STARTS = (0.006, 0.02, 0.06, 0.15)
_WIDE, _WIDTHS = (
    0.4,
    (4.0, 2.5),
)  # of the lines fitted to either side, in halves of the mode's width
_USUAL = 1e-20, 1e20
"""Usual range of the greatest power of a line; outside it all powers are divided by the
greatest."""
_LEAST_WIDTH_SHARE = (
    0.4  # share of the window's width; a narrower mode looks like the window itself
)
_LEAST_PEAK_RATIO = 4.0  # least power of a peak over the median of all lines
_LEAST_OTHER_POWER = 1.0 / 20.0  # Klipper ignores power below this share of the peak
_UNKNOWN = 0.35  # half width of the damping over its value, beyond which it is refused
_FINE = 24  # points of the model to a line of a spectrum
_CLEAR, _FALL = 5, 1.5  # an end of the sweep: lines off the peak, and fall of log power over three
_ENOUGH = 8  # samples of power in a line, below which a fall may be chance
_LEAST = {Vibration: (5e-4, 0.01), Spectrum: (1e-3, 0.02)}
"""Narrowest half widths, as shares: of the frequency (clocks, rounded files) and the damping (the
excitation is not a pure sweep)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """A number and the half width of its 95 % interval."""

    value: float
    half_width: float

    @property
    def low(self) -> float:
        """Lower end."""
        return self.value - self.half_width

    @property
    def high(self) -> float:
        """Upper end."""
        return self.value + self.half_width


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredMode:
    """One mode of one axis.

    Parameters
    ----------
    axis
        ``"x"``, ``"y"`` or ``"z"``.
    frequency_hz
        Undamped natural frequency.
    damping_ratio
        Damping ratio; its half width is 0 if the damping was given and not measured.
    shares
        Power of x, y and z around the mode, as shares of their sum.
    others
        Other peaks of the axis, the highest first: frequency in Hz, and height as a share of the
        mode's height, both heights of the power divided by the frequency.
    lines_hz, power, fitted
        (k,) lines, their power and its fit, for pictures.
    """

    axis: str
    frequency_hz: Known
    damping_ratio: Known
    shares: tuple[float, float, float]
    others: tuple[tuple[float, float], ...]
    lines_hz: FloatArray
    power: FloatArray
    fitted: FloatArray

    @property
    def mode(self) -> FlexibleMode:
        """The mode to design for."""
        return FlexibleMode(self.frequency_hz.value, self.damping_ratio.value)


def klipper_spectrum(run: Vibration) -> Spectrum:
    """Return Klipper's spectrum of a run: Welch's method with Kaiser windows that overlap by half.

    Raises
    ------
    RecordingError
        If the run is no longer than one window.
    """
    from scipy import signal

    n = len(run.acceleration_m_s2)
    rate = run.rate_hz * n / (n - 1)  # Klipper divides by the time from first to last
    length = 1 << int(rate * WINDOW_S - 1).bit_length()
    if n <= length:
        raise RecordingError(
            f"the run lasts {n / rate:.3g} s, Klipper's window {length / rate:.3g} s",
            place=run.place,
            remedy="Record for longer.",
        )
    window: Any = np.kaiser(length, KAISER)  # symmetric, unlike scipy's own
    f, psd = signal.welch(
        run.acceleration_m_s2, rate, window=window, nperseg=length, detrend="constant", axis=0
    )
    return Spectrum(frequency_hz=f, psd=psd, normalised=False, place=run.place)


def measured_mode(
    data: Vibration | Spectrum, axis: str | None = None, damping: float | None = None
) -> MeasuredMode:
    """Return the strongest mode of an axis.

    Parameters
    ----------
    axis
        The axis that was shaken; None: the axis with the highest peak.
    damping
        Damping ratio, if it is known from elsewhere; None: it is fitted.

    Raises
    ------
    OptionError
        If there is no such axis.
    RecordingError
        If nothing rings, the run is too short, or the spectrum is too coarse for its damping.
    """
    if axis is not None and axis.lower() not in AXES:
        raise OptionError(f"--axis {axis!r} is unknown", remedy=f"Axes: {', '.join(AXES)}.")
    f, power = _lines(data)
    largest_power = float(power.max(initial=0.0))
    if not _USUAL[0] < largest_power < _USUAL[1]:  # in odd units, or hardly anything
        power = power / (largest_power or 1.0)
    weight = 1.0 if isinstance(data, Spectrum) and data.normalised else 1.0 / f
    low = max(data.lowest_hz, 4.0 * float(f[1] - f[0]))
    in_range = (f >= low) & (f <= MOST_HZ)
    if int(in_range.sum()) < _BINS // 5:
        raise RecordingError(
            f"the data has {int(in_range.sum())} lines from {low:.3g} to {MOST_HZ:g} Hz",
            place=data.place,
            remedy="Record for longer.",
        )
    coarse_f, coarse = _coarse(f[in_range], (power * np.reshape(weight, (-1, 1)))[in_range])
    axis_index = (
        AXES.index(axis.lower()) if axis is not None else int(np.argmax(coarse.max(axis=0)))
    )
    shape = coarse[:, axis_index]
    top = int(np.argmax(shape))
    peak_hz, height = float(coarse_f[top]), float(shape[top])
    if height < _LEAST_PEAK_RATIO * float(np.median(shape)) or top in (0, len(shape) - 1):
        raise RecordingError(
            f"nothing rings along {AXES[axis_index]} from {low:.3g} to {coarse_f[-1]:.4g} Hz",
            place=data.place,
            remedy="Shake that axis through its resonance, or name another with --axis.",
        )
    fit = _fitted(data, f, power[:, axis_index], peak_hz, damping)
    is_near = np.abs(coarse_f - peak_hz) <= max(
        0.1 * peak_hz, 2.0 * float(coarse_f[1] - coarse_f[0])
    )
    axis_power = coarse[is_near].sum(axis=0)
    x, y, z = (axis_power / axis_power.sum()).tolist()
    return MeasuredMode(
        axis=AXES[axis_index],
        frequency_hz=fit.frequency,
        damping_ratio=fit.damping,
        shares=(x, y, z),
        others=_others(coarse_f, shape, top, fit.damping.value),
        lines_hz=fit.lines_hz,
        power=fit.power,
        fitted=fit.model,
    )


def _lines(data: Vibration | Spectrum) -> tuple[FloatArray, FloatArray]:
    """Return (k,) frequencies and (k, 3) power of a whole run, or of a spectrum."""
    if isinstance(data, Spectrum):
        f = data.frequency_hz[0] + data.step_hz * np.arange(len(data.frequency_hz))
        keep = f > 0.0
        return np.asarray(f[keep]), data.psd[keep]
    from scipy import signal

    detrended = signal.detrend(data.acceleration_m_s2, axis=0)
    taper = signal.windows.tukey(len(detrended), 0.02)[:, None]
    spectrum = np.fft.rfft(detrended * taper, axis=0)[1:]
    f = np.fft.rfftfreq(len(detrended), 1.0 / data.rate_hz)[1:]
    keep = f <= 1.6 * MOST_HZ
    power = np.square(np.abs(spectrum[keep])) / (len(detrended) * data.rate_hz)
    return np.asarray(f[keep], dtype=np.float64), np.asarray(power, dtype=np.float64)


def _coarse(f: FloatArray, power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return means over at most 400 bins of lines, for finding peaks."""
    count = min(len(f), 400)
    if len(f) <= 400:
        return f, power
    edges = np.linspace(0, len(f), count + 1).astype(np.int64)
    size = np.diff(edges)
    return (
        np.asarray(np.add.reduceat(f, edges[:-1]) / size, dtype=np.float64),
        np.asarray(np.add.reduceat(power, edges[:-1], axis=0) / size[:, None]),
    )


def _others(
    f: FloatArray, shape: FloatArray, top: int, damping: float
) -> tuple[tuple[float, float], ...]:
    from scipy import signal

    peaks, _ = signal.find_peaks(shape, prominence=_LEAST_OTHER_POWER * shape[top])
    least_apart_hz = max(0.1, 3.0 * damping) * f[top]
    other_peaks = [
        (float(f[k]), float(shape[k] / shape[top]))
        for k in peaks
        if abs(f[k] - f[top]) > least_apart_hz
    ]
    return tuple(sorted(other_peaks, key=lambda peak: -peak[1])[:3])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fit:
    frequency: Known
    damping: Known
    lines_hz: FloatArray
    power: FloatArray
    model: FloatArray


def _fitted(
    data: Vibration | Spectrum,
    f: FloatArray,
    power: FloatArray,
    peak_hz: float,
    damping: float | None,
) -> _Fit:
    step = float(f[1] - f[0])

    def fit_over(reach: float, peak_hz: float, starts: tuple[float, ...]) -> _Fit:
        lines, mean = _within_sweep(data, f, power, (peak_hz, max(reach * peak_hz, 8.0 * step)))
        return _least_squares(data, lines, mean, (peak_hz, *starts), damping)

    def fit_again(fit: _Fit, widths: float) -> _Fit:
        ratio = fit.damping.value
        reach = float(np.clip(widths * ratio, 0.05, _WIDE))
        return fit_over(reach, fit.frequency.value, (ratio,))

    first = fit_again(fit_over(_WIDE, peak_hz, _STARTS), 6.0)
    best_fit = fit_again(first, _WIDTHS[0])
    narrow_fit = fit_again(best_fit, _WIDTHS[1])
    best_fit = replace(
        best_fit,
        frequency=_widened(best_fit.frequency, narrow_fit.frequency),
        damping=_widened(best_fit.damping, narrow_fit.damping),
    )
    _refuse_unresolved(data, best_fit, step, given=damping is not None)
    return best_fit


def _widened(known: Known, narrower: Known) -> Known:
    """Widen an interval by twice the difference from a fit over fewer lines."""
    return replace(
        known, half_width=float(np.hypot(known.half_width, 2.0 * (known.value - narrower.value)))
    )


def _within_sweep(
    data: Vibration | Spectrum, f: FloatArray, power: FloatArray, peak_and_half: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Return lines around a peak, without those beyond an end of the sweep."""
    peak_hz, half_hz = peak_and_half
    lines, mean = _binned(f, power, peak_hz - half_hz, peak_hz + half_hz)
    has_many = 2.0 * half_hz / float(f[1] - f[0]) / len(lines) >= _ENOUGH
    if not (has_many or isinstance(data, Spectrum)):
        return lines, mean
    logs = np.log(np.maximum(mean, np.finfo(float).tiny))
    peak = int(np.argmin(np.abs(lines - peak_hz)))
    low, high = peak_hz - half_hz, peak_hz + half_hz
    for k in range(peak + _CLEAR, len(lines) - 3):
        if logs[k] - logs[k + 3] > _FALL:
            high = float(lines[k])
            break
    for k in range(peak - _CLEAR, 2, -1):
        if logs[k] - logs[k - 3] > _FALL:
            low = float(lines[k])
            break
    return _binned(f, power, low, high)


def _binned(
    f: FloatArray, power: FloatArray, low: float, high: float
) -> tuple[FloatArray, FloatArray]:
    in_range = (f >= low) & (f <= high)
    f, power = f[in_range], power[in_range]
    count = min(len(f), _BINS)
    edges = np.linspace(0, len(f), count + 1).astype(np.int64)[:-1]
    size = np.diff(np.append(edges, len(f)))
    return np.asarray(np.add.reduceat(f, edges) / size, dtype=np.float64), np.asarray(
        np.add.reduceat(power, edges) / size, dtype=np.float64
    )


def _least_squares(
    data: Vibration | Spectrum,
    lines: FloatArray,
    mean: FloatArray,
    starts: tuple[float, ...],
    damping: float | None,
) -> _Fit:
    """Fit the logarithm of the power with a robust loss; ``_covariance`` gives the intervals.

    ``starts`` are the frequency and the damping ratios from which the fit begins.
    """
    first_hz = starts[0]
    from scipy import optimize, stats

    through_window = _through_window(data, lines)
    floor = float(mean[mean > 0.0].min()) if (mean > 0.0).any() else 1.0
    measured = np.log(np.maximum(mean, floor))
    free = damping is None

    def model(p: FloatArray) -> FloatArray:
        frequency, ratio = first_hz * np.exp(p[0]), np.exp(p[4]) if free else damping
        assert ratio is not None

        def power(f: FloatArray) -> FloatArray:
            r = f / frequency
            shape = (2.0 * ratio) ** 2 / ((1.0 - r**2) ** 2 + (2.0 * ratio * r) ** 2)
            residue = (1.0 + p[2] * (1.0 - r**2)) ** 2 + (2.0 * ratio * r * p[2]) ** 2
            return np.asarray(np.exp(p[1]) * (r**data.drive_power * shape * residue + np.exp(p[3])))

        return np.asarray(np.log(through_window(power)))

    def residual(p: FloatArray) -> FloatArray:
        return model(p) - measured

    best = None
    low, high = [-0.3, -60.0, -3.0, -18.0], [0.3, 60.0, 3.0, 1.0]
    for start in starts[1:] if free else (0.0,):
        first = [0.0, float(measured.max()), 0.0, -6.0, *([np.log(start)] if free else [])]
        result = optimize.least_squares(
            residual,
            first,
            bounds=([*low, *([np.log(5e-4)] if free else [])], [*high, *([-0.7] if free else [])]),
            loss="soft_l1",
            f_scale=0.5,
            x_scale="jac",
        )
        if best is None or result.cost < best.cost:
            best = result
    assert best is not None
    p = best.x
    covariance = _covariance(np.asarray(best.jac), residual(p))
    degrees = max(len(lines) - len(p), 1)
    half_widths = float(stats.t.ppf(0.975, degrees)) * np.sqrt(np.diag(covariance))
    frequency = first_hz * float(np.exp(p[0]))
    ratio = float(np.exp(p[4])) if free else float(damping or 0.0)
    least_widths = _LEAST[type(data)]
    return _Fit(
        frequency=Known(
            value=frequency, half_width=frequency * max(float(half_widths[0]), least_widths[0])
        ),
        damping=Known(
            value=ratio,
            half_width=ratio * max(float(half_widths[4]), least_widths[1]) if free else 0.0,
        ),
        lines_hz=lines,
        power=mean,
        model=np.exp(model(p)),
    )


def _covariance(jacobian: FloatArray, residual: FloatArray) -> FloatArray:
    """Return the covariance of the parameters, for residuals that are correlated over lines."""
    n, k = jacobian.shape
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    leverage = np.clip(np.einsum("ij,jk,ik->i", jacobian, bread, jacobian), 0.0, 0.8)
    score = jacobian * (residual / (1.0 - leverage))[:, None]
    middle = score.T @ score
    for lag in range(1, min(_LAGS, n - k) + 1):
        lagged = score[lag:].T @ score[:-lag]
        middle += (1.0 - lag / (_LAGS + 1.0)) * (lagged + lagged.T)
    return np.asarray(bread @ middle @ bread)


def _through_window(
    data: Vibration | Spectrum, lines: FloatArray
) -> Callable[[Callable[[FloatArray], FloatArray]], FloatArray]:
    """Return a function from a model of the true power to the modelled power of the lines.

    A line of a spectrum is the mean of the power over its window's lobe; a line of a whole run is
    the power at its frequency.
    """
    if isinstance(data, Vibration):
        return lambda power: power(lines)
    reach, step = 3.0 * data.step_hz, data.step_hz / _FINE
    offsets = np.arange(-reach, reach + 0.5 * step, step)
    x = np.sqrt((KAISER**2 - (np.pi * offsets / data.step_hz) ** 2).astype(np.complex128))
    lobe = np.square(np.abs(np.sinh(x) / np.where(x == 0.0, 1.0, x)))
    lobe /= lobe.sum()
    grid = np.maximum(lines[:, None] + offsets, 1e-3 * data.step_hz)
    return lambda power: np.asarray(power(grid.ravel()).reshape(grid.shape) @ lobe)


def _refuse_unresolved(data: Vibration | Spectrum, fit: _Fit, step: float, *, given: bool) -> None:
    f, ratio = fit.frequency.value, fit.damping
    width = 2.0 * ratio.value * f  # between the half powers
    if isinstance(data, Vibration):
        if width < 3.0 * step:
            raise RecordingError(
                f"the run lasts {1.0 / step:.3g} s, too short for a mode at {f:.4g} Hz that is "
                f"{width:.2g} Hz wide",
                place=data.place,
                remedy=f"Record {3.0 / max(width, 1e-6):.3g} s or more.",
            )
    # Between half powers a Kaiser window with this beta is 1.7 lines wide.
    elif not given and width < _LEAST_WIDTH_SHARE * 1.7 * step:
        raise RecordingError(
            f"the spectrum's lines are {step:.3g} Hz apart, too coarse for the damping of a mode "
            f"at {f:.4g} Hz that is about {width:.2g} Hz wide",
            place=data.place,
            remedy="Give the raw run instead (Klipper: OUTPUT=raw_data), or add --damping.",
        )
    if not given and ratio.half_width > _UNKNOWN * ratio.value:
        raise RecordingError(
            f"the damping of the mode at {f:.4g} Hz is {ratio.value:.2g} +- "
            f"{ratio.half_width:.2g}: unknown",
            place=data.place,
            remedy="Shake that axis alone and for longer, tap only once, or add --damping.",
        )
