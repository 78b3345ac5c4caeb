"""Readers of accelerometer files: runs and spectra of Klipper and Kalico, CSV of others."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.reading import read_text
from threadline.errors import Place, RecordingError

AXES = "xyz"
MAX_BYTES = 200_000_000
LEAST_RATE_HZ = 20.0
MOST_M_S2, MOST_PSD = 1e9, 1e100
"""Largest acceleration and power in any unit: beyond them numbers overflow in a fit."""
KLIPPER_LOWEST_HZ = 5.0
"""Start of Klipper's sweep: lower frequencies come from the motion of the axis to and fro."""
_LOWEST_HZ = 0.5
_LEAST_SAMPLES, _LEAST_BINS = 200, 12
_MAX_GAP_STEPS = 2.5  # times the usual step
_GRAVITY = 9.80665
_UNITS = {"mm/s^2": 1e-3, "mm/s2": 1e-3, "m/s^2": 1.0, "m/s2": 1.0, "g": _GRAVITY, "mg": 9.80665e-3}
_TIMES = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_TIME = re.compile(r"(?:elapsed[ _]?)?(?:time|timestamp|t|seconds_elapsed)(?:[ _(\[]+(\w+)[)\]]?)?")
_ACCELERATION = re.compile(
    r"(?:linear[ _])?(?:a|acc|accel|acceleration|accelerometer|gf)?[ _]?([xyz])"
    r"(?:[ _]?axis)?\s*(?:[(\[]\s*([^)\]]+?)\s*[)\]])?"
)
_CLIPPED_SAMPLES, _CLIPPED_RATIO = (
    12,
    8.0,
)  # samples at the extreme, at least, and times the levels next to it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Vibration:
    """Acceleration, sampled at even times.

    Parameters
    ----------
    rate_hz
        Samples a second.
    acceleration_m_s2
        (n, 3): x, y, z; values without a unit count as m/s^2, Klipper's as mm/s^2.
    place
        The file.
    lowest_hz
        Lowest frequency at which modes are looked for.
    drive_power
        Exponent of the frequency in the power of the excitation: 2 in Klipper's sweep, 0 in a tap.
    """

    rate_hz: float
    acceleration_m_s2: FloatArray
    place: Place
    lowest_hz: float = KLIPPER_LOWEST_HZ
    drive_power: float = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spectrum:
    """Power spectral density of an acceleration, as Klipper and Kalico write it.

    Parameters
    ----------
    frequency_hz
        (k,) evenly spaced, increasing; each line is one bin of Welch's method.
    psd
        (k, 3): x, y, z.
    normalised
        Whether the power was divided by the frequency, as in files with columns of shapers.
    place
        The file.
    """

    frequency_hz: FloatArray
    psd: FloatArray
    normalised: bool
    place: Place

    @property
    def lowest_hz(self) -> float:
        """Lowest frequency at which modes are looked for."""
        return KLIPPER_LOWEST_HZ

    @property
    def drive_power(self) -> float:
        """Exponent of the frequency in the power of Klipper's sweep, as the file has it."""
        return 1.0 if self.normalised else 2.0

    @property
    def step_hz(self) -> float:
        """Distance between two lines: 1 over the duration of the window."""
        f = self.frequency_hz
        return float(f[-1] - f[0]) / (len(f) - 1)


def read_accelerometer(path: Path) -> Vibration | Spectrum:
    """Read a run or a spectrum of an accelerometer.

    Runs: Klipper's ``#time,accel_x,accel_y,accel_z`` (s, mm/s^2), or a CSV of a phone or an ADXL
    with a time (s unless its header says ms, us or ns) and three columns whose headers name x, y
    and z, such as ``Time (s),Linear Acceleration x (m/s^2),...``. Spectra: ``freq,psd_x,psd_y,
    psd_z,psd_xyz``, with or without columns of shapers or Kalico's ``accel_per_hz``.

    Raises
    ------
    RecordingError
        If the file is empty, too short, has other columns, holds no finite numbers, has gaps in
        its time or runs at the end of the sensor's range.
    """
    text = read_text(path, MAX_BYTES, RecordingError, "file of an accelerometer", "utf-8-sig")
    place = Place(str(path))
    start, header = _header(text, place)
    names = [name.strip().strip('"').strip().lower() for name in header]
    if names[0] == "freq":
        power_names = [f"psd_{axis}" for axis in AXES]
        if missing := [name for name in power_names if name not in names]:
            raise RecordingError(
                f"the spectrum has no column {missing[0]!r}",
                place=place,
                remedy="Give a file of one accelerometer: freq,psd_x,psd_y,psd_z,psd_xyz.",
            )
        table = _table(
            text, start, header, [0, *(names.index(name) for name in power_names)], place
        )
        # Klipper divides by the frequency before it adds the columns of shapers.
        normalised = any("(" in name or name == "shapers:" for name in names[1:])
        return _spectrum(table, normalised, place)
    time_index, to_seconds = _time_column(names, place)
    columns, scale = _accelerations(names, place)
    table = _table(text, start, header, [time_index, *columns], place)
    run = _vibration(table[:, 0] * to_seconds, table[:, 1:], scale, Place(str(path), start))
    return run if "accel_x" in names else replace(run, lowest_hz=_LOWEST_HZ, drive_power=0.0)


def _header(text: str, place: Place) -> tuple[int, list[str]]:
    """Return the number of the line after the header, and its cells."""
    for number, line in enumerate(io.StringIO(text), start=1):
        bare = line.strip().lstrip("#").strip()
        cells = re.split("[,;\t]", bare)
        if bare and (len(cells) >= 4 or not line.startswith("#")):
            if len(cells) < 4 or re.match(r"[-+.\d]", bare):
                break
            return number + 1, cells
        if number > 100:
            break
    fault = "the file is empty" if not text.strip() else "no line names time and x, y and z"
    raise RecordingError(
        fault,
        place=place,
        remedy="The first line must be like '#time,accel_x,accel_y,accel_z', 'Time (s),"
        "Linear Acceleration x (m/s^2),...' or 'freq,psd_x,psd_y,psd_z,psd_xyz'.",
    )


def _time_column(names: list[str], place: Place) -> tuple[int, float]:
    for index, name in enumerate(names):
        match = _TIME.fullmatch(name)
        if match and (match[1] is None or match[1] in _TIMES):
            return index, _TIMES[match[1] or "s"]
    raise RecordingError(
        f"no column is a time among {', '.join(names)[:80]!r}",
        place=place,
        remedy="Name it like 'time', 'Time (s)' or 'time_ms'.",
    )


def _accelerations(names: list[str], place: Place) -> tuple[list[int], float]:
    columns: dict[str, tuple[int, str]] = {}
    for index, name in enumerate(names):
        match = _ACCELERATION.fullmatch(name)
        if match:
            columns.setdefault(match[1], (index, match[2] or ""))
    if missing := [axis for axis in AXES if axis not in columns]:
        raise RecordingError(
            f"no column is the acceleration along {missing[0]}",
            place=place,
            remedy="Name the columns like accel_x, accel_y, accel_z.",
        )
    units = {unit.replace("²", "^2").replace(" ", "") for _, unit in columns.values()}
    unit = next(iter(units))
    if len(units) > 1 or (unit and unit not in _UNITS):
        raise RecordingError(
            f"{' and '.join(sorted(units))!r} is no unit of three accelerations",
            place=place,
            remedy=f"Units: {', '.join(dict.fromkeys(_UNITS))}.",
        )
    klipper = "accel_x" in names and not unit
    return [columns[axis][0] for axis in AXES], _UNITS["mm/s^2" if klipper else unit or "m/s^2"]


def _table(
    text: str, start: int, header: list[str], columns: list[int], place: Place
) -> FloatArray:
    lines = text.splitlines()[start - 1 :]
    heading = text.splitlines()[start - 2]
    separator = max(",;\t", key=heading.count)
    if not any(line.strip() and not line.lstrip().startswith("#") for line in lines):
        raise RecordingError("the file holds no samples", place=place, remedy="Record again.")
    try:
        table = np.loadtxt(lines, delimiter=separator, usecols=columns, comments="#", ndmin=2)
    except ValueError:
        table = np.full((1, len(columns)), np.nan)
    if len(table) and bool(np.isfinite(table).all()):
        return table
    for number, line in enumerate(lines, start=start):
        cells = line.split(separator)
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            is_finite = all(np.isfinite(float(cells[k])) for k in columns)
        except (IndexError, ValueError):
            is_finite = False
        if not is_finite:
            raise RecordingError(
                f"{line.strip()[:60]!r} does not hold finite numbers for "
                f"{', '.join(header[k].strip() for k in columns)[:80]}",
                place=Place(place.file, number),
                remedy="Remove the line, or record again.",
            )
    raise RecordingError(
        "its lines have unlike numbers of cells", place=place, remedy="Record again."
    )


def _spectrum(table: FloatArray, shaped: bool, place: Place) -> Spectrum:
    f, psd = table[:, 0], table[:, 1:]
    if len(f) < _LEAST_BINS:
        raise RecordingError(
            f"the spectrum has {len(f)} lines, at least {_LEAST_BINS} are needed",
            place=place,
            remedy="Give the whole file.",
        )
    spectrum = Spectrum(frequency_hz=f, psd=psd, normalised=shaped, place=place)
    # Klipper rounds frequencies to 0.1 Hz.
    if (np.diff(f) <= 0.0).any() or (
        np.abs(f - f[0] - spectrum.step_hz * np.arange(len(f))) > 0.11 + 1e-3 * spectrum.step_hz
    ).any():
        raise RecordingError(
            "the frequencies of the spectrum are not even",
            place=place,
            remedy="Give the file as it was written.",
        )
    if (largest_power := float(psd.max())) > MOST_PSD:
        raise RecordingError(
            f"the spectrum holds a power of {largest_power:.3g}, limit {MOST_PSD:g}",
            place=place,
            remedy="Record again, or correct the line.",
        )
    if (psd < 0.0).any() or not psd.any():
        raise RecordingError(
            "the spectrum holds a negative power" if psd.any() else "the spectrum is 0 throughout",
            place=place,
            remedy="Give a power spectral density.",
        )
    return spectrum


def _vibration(time_s: FloatArray, values: FloatArray, scale: float, first: Place) -> Vibration:
    """Check a run; ``first`` is the line of its first sample."""
    place, start = Place(first.file), first.line or 0
    if len(time_s) < _LEAST_SAMPLES:
        raise RecordingError(
            f"the run has {len(time_s)} samples, at least {_LEAST_SAMPLES} are needed",
            place=place,
            remedy="Record for longer.",
        )
    steps = np.diff(time_s)
    if (steps <= 0.0).any():
        row = int(np.argmax(steps <= 0.0))
        raise RecordingError(
            f"the time {time_s[row + 1]:.6g} s does not increase",
            place=Place(place.file, start + row + 1),
            remedy="Give one run, in the order of time.",
        )
    usual_step_s = float(np.median(steps))
    if usual_step_s > 1.0 / LEAST_RATE_HZ or usual_step_s < 1e-6:
        raise RecordingError(
            f"samples are {usual_step_s:.3g} s apart, from 1e-06 to {1.0 / LEAST_RATE_HZ:g} s "
            "can be read",
            place=place,
            remedy="Is the time in ms? Then name its column 'time (ms)'.",
        )
    if (longest_step_s := float(steps.max())) > _MAX_GAP_STEPS * usual_step_s:
        row = int(np.argmax(steps))
        raise RecordingError(
            f"{longest_step_s * 1e3:.4g} ms are missing after {time_s[row]:.6g} s, where samples "
            "are "
            f"{usual_step_s * 1e3:.4g} ms apart",
            place=Place(place.file, start + row + 1),
            remedy="Record again, or cut the run there.",
        )
    if (largest := float(np.abs(values).max())) > MOST_M_S2 / scale:
        row = int(np.argmax(np.abs(values).max(axis=1)))
        raise RecordingError(
            f"an acceleration of {largest * scale:.3g} m/s^2, limit {MOST_M_S2:g} m/s^2",
            place=Place(place.file, start + row),
            remedy="Correct the line, or the unit in the first line.",
        )
    for axis, column in zip(AXES, values.T, strict=True):
        if limit := _clipped(column):
            count, level = limit
            raise RecordingError(
                f"{count} samples of {axis} are at {level:.6g}, the end of the sensor's range",
                place=place,
                remedy="Choose a larger range, or shake less.",
            )
    rate = len(steps) / float(time_s[-1] - time_s[0])
    even_times_s = time_s[0] + np.arange(len(time_s)) / rate
    table = np.column_stack([np.interp(even_times_s, time_s, column) for column in values.T])
    return Vibration(rate_hz=rate, acceleration_m_s2=table * scale, place=place)


def _clipped(column: FloatArray) -> tuple[int, float] | None:
    """Return how many samples are at the end of the range, and the level of that end, or None.

    At the end of the range far more samples have the extreme level than the levels next to it.
    """
    levels, counts = np.unique(column, return_counts=True)
    if len(levels) < 12:
        return None  # at rest: a few levels of noise
    for end, neighbours in ((0, slice(1, 6)), (-1, slice(-6, -1))):
        if counts[end] >= max(_CLIPPED_SAMPLES, _CLIPPED_RATIO * float(counts[neighbours].mean())):
            return int(counts[end]), float(levels[end])
    return None
