"""Shared parts of the file formats of commands and recordings: instants, units, values."""

from __future__ import annotations

import hashlib
import json
import re
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from math import floor
from pathlib import Path
from typing import IO, Annotated, Any, TypeVar

from pydantic import Field, TypeAdapter, ValidationError

from threadline.base.reading import KnownFile
from threadline.base.wording import field_fault, json_line, nearest
from threadline.base.writing import content_of, staged_file
from threadline.errors import Place, RecordingError, ThreadlineError, UnitError
from threadline.files.recording import Channel, ChannelKind, Recording, RecordingBlock
from threadline.files.stream import Stream
from threadline.units import same_dimension, unit_factor

AXES = ("A", "B", "C", "U", "V", "W", "X", "Y", "Z")
TIME = "time"

_COLUMN = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*(?:\[\s*(?P<unit>[^\[\]]*?)\s*\])?\s*")
_SWITCHED = re.compile(r"(?P<name>[A-Za-z][A-Za-z0-9_-]*)\.(?P<kind>output|input)")
"""Heading of a column of a PLC output or input, by its name in the machine file; 0 or 1."""
_SENSED = re.compile(r"[A-Za-z][A-Za-z0-9_-]*\.sensor")
"""Heading of a column of a sensor other than the encoders of axes, with its name in the file."""
_POSITIONS = frozenset(
    {
        ChannelKind.COMMANDED,
        ChannelKind.MEASURED,
        ChannelKind.LOAD,
        ChannelKind.FRAME,
        ChannelKind.TOOL,
    }
)
_UNITS = {
    ChannelKind.VOLTAGE: ("V",),
    ChannelKind.CURRENT: ("A",),
    ChannelKind.VELOCITY: ("m/s", "rad/s"),
    ChannelKind.SENSOR: ("V", "count", "m/s^2", "rad/s^2"),
    ChannelKind.TENSION: ("N",),
}
_OF_NO_AXIS = (ChannelKind.SENSOR, ChannelKind.TENSION)
_PER_AXIS = tuple(
    k for k in ChannelKind if k in _POSITIONS or (k in _UNITS and k not in _OF_NO_AXIS)
)


def units_of(kind: ChannelKind) -> tuple[str, ...]:
    """Return the SI units allowed for a channel of ``kind``; empty for a channel without unit."""
    return _UNITS.get(kind, ("m", "rad") if kind in _POSITIONS else ())


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a trace: its channel, and the factor from its unit to the SI unit."""

    name: str
    kind: ChannelKind | None  # None for the time
    axis: str
    unit: str
    factor: float


def parse_column(text: str, place: Place) -> Column:
    """Return the column that a heading describes.

    ``X [mm]`` is the measured position of axis X; ``X.load [mm]`` names another kind of channel.
    ``tension [N]`` is the tension of a winder's fibre. ``operation`` has no unit. PLC outputs and
    inputs, such as ``valve.output`` and ``switch.input``, have no unit either.

    Raises
    ------
    RecordingError
        If the name is unknown, or the unit is missing or wrong.
    """
    match = _COLUMN.fullmatch(text.strip().strip('"'))
    if match is None:
        raise RecordingError(
            f"{text.strip()[:60]!r} is not the name of a column",
            place=place,
            remedy='Write it like "X [mm]".',
        )
    name, unit = match["name"], match["unit"]
    if name == TIME:
        return Column(TIME, None, "", "s", _factor(name, unit, ("s",), place))
    if name == ChannelKind.OPERATION:
        if unit:
            raise RecordingError(f"{name!r} has no unit, found [{unit[:20]}]", place=place)
        return Column(name, ChannelKind.OPERATION, "", "", 1.0)
    if name == ChannelKind.TENSION:
        return Column(name, ChannelKind.TENSION, "", "N", _factor(name, unit, ("N",), place))
    switched = _SWITCHED.fullmatch(name)
    if switched is not None:
        if unit:
            raise RecordingError(f"{name[:60]!r} has no unit, found [{unit[:20]}]", place=place)
        return Column(switched["name"], ChannelKind(switched["kind"]), "", "", 1.0)
    if _SENSED.fullmatch(name):
        units = units_of(ChannelKind.SENSOR)
        factor = _factor(name, unit, units, place)
        si_unit = next(u for u in units if same_dimension(unit, u))
        return Column(name, ChannelKind.SENSOR, "", si_unit, factor)
    axis, dot, kind_name = name.partition(".")
    axis_columns = [f"{axis}.{kind.value}" for kind in _PER_AXIS]
    if axis not in AXES or (dot and name not in axis_columns):
        known_columns = axis_columns if axis in AXES else [TIME, *AXES, "operation", "tension"]
        raise RecordingError(
            f"unknown column {name[:60]!r}",
            place=place,
            remedy=f"{nearest(name, known_columns)} Remove columns that are not to be judged.",
        )
    kind = ChannelKind(kind_name) if dot else ChannelKind.MEASURED
    units = units_of(kind)
    factor = _factor(name, unit, units, place)
    si_unit = next(u for u in units if same_dimension(unit, u))
    return Column(f"{axis}.{kind.value}", kind, axis, si_unit, factor)


def _factor(name: str, unit: str | None, units: tuple[str, ...], place: Place) -> float:
    example = {"m": "mm", "m/s": "mm/s"}.get(units[0], units[0])
    remedy = f'Write it like "{name} [{example}]".'
    if not unit:
        raise RecordingError(f"column {name!r} has no unit", place=place, remedy=remedy)
    for target in units:
        try:
            return unit_factor(unit, target)
        except UnitError:
            continue
    unit_names = " or ".join(units)
    raise RecordingError(
        f"column {name!r} is in {unit[:20]!r}, which is not a unit like {unit_names}",
        place=place,
        remedy=remedy,
    )


MAX_LINE_BYTES = 1 << 20
MAX_META_BYTES = 1 << 20
MAX_COUNTS = 2**53
_FRACTION = r"^[0-9]{1,40}/[0-9]{1,40}$"

Counts = Annotated[int, Field(strict=True, ge=-MAX_COUNTS, le=MAX_COUNTS)]
FractionText = Annotated[str, Field(pattern=_FRACTION)]
Label = Annotated[str, Field(min_length=1, max_length=80)]
Hash = Annotated[str, Field(max_length=128)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Written:
    """A written file and its hash.

    ``warnings`` name omissions and suspicious values; ``facts`` name the checks of the content.
    ``as_run_s`` has two durations, according to the planner of a firmware: of the original job, and
    of the written file. It is None if the planner is unknown.
    """

    path: Path
    sha256: str
    warnings: tuple[str, ...] = ()
    facts: tuple[str, ...] = ()
    as_run_s: tuple[float, float] | None = None


@contextmanager
def atomic_file(path: Path) -> Iterator[IO[bytes]]:
    """Open a file that appears at ``path`` only if the block succeeds.

    Inside a ``together`` block of ``threadline.base.writing`` the file appears when that block
    ends. Until then its bytes are in a temporary file, which is the ``name`` of the stream.

    Raises
    ------
    RecordingError
        If the file cannot be written.
    """
    try:
        with staged_file(path) as file:
            yield file
    except OSError as error:
        raise RecordingError(
            f"cannot write {str(path)!r}: {error.strerror or error}", remedy="Give another file."
        ) from error


def written(path: Path, warnings: tuple[str, ...] = ()) -> Written:
    """Return ``path`` with the hash of its content."""
    with content_of(path).open("rb") as file:
        return Written(path, hashlib.file_digest(file, "sha256").hexdigest(), warnings)


@contextmanager
def clear_errors(path: Path) -> Iterator[None]:
    """Turn every error of a damaged file into a ``RecordingError`` that names the file."""
    try:
        yield
    except ThreadlineError:
        raise
    except UnicodeDecodeError as error:
        raise RecordingError("the file is not UTF-8 text", place=Place(str(path))) from error
    except OSError as error:
        raise RecordingError(
            f"cannot read {str(path)[:200]!r}: {error.strerror or error}",
            remedy="Give a file that can be read.",
        ) from error
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        NotImplementedError,
        RuntimeError,
        ValueError,
        OverflowError,
    ) as error:
        raise RecordingError(
            f"the file is damaged: {str(error)[:200] or type(error).__name__}",
            place=Place(str(path)),
            remedy="Write or fetch it again.",
        ) from error


@contextmanager
def reading(known: KnownFile) -> Iterator[None]:
    """Apply ``clear_errors`` while a file is read again, and refuse a file that has changed.

    Raises
    ------
    RecordingError
        If the content has changed since the first reading.
    """
    with clear_errors(known.path):
        if not known.is_unchanged():
            raise RecordingError(
                f"the file has changed since it was read; its SHA-256 was {known.sha256[:12]}",
                place=Place(str(known.path)),
                remedy="Read it again.",
            )
        yield


def text_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line numbers, from 1, and lines; raise RecordingError for binary or too long lines."""
    with path.open("rb") as file:
        number = 0
        while raw := file.readline(MAX_LINE_BYTES + 1):
            number += 1
            if len(raw) > MAX_LINE_BYTES:
                raise RecordingError(
                    f"the line is longer than {MAX_LINE_BYTES} bytes",
                    place=Place(str(path), number),
                    remedy="This is not a table.",
                )
            if b"\0" in raw:
                raise RecordingError(
                    "the file is binary, not text",
                    place=Place(str(path), number),
                    remedy="A table begins with a line that names its columns.",
                )
            try:
                text = raw.decode("utf-8-sig" if number == 1 else "utf-8")
            except UnicodeDecodeError as error:
                raise RecordingError(
                    "the line is not UTF-8 text", place=Place(str(path), number)
                ) from error
            yield number, text.rstrip("\r\n")


def meta_lines(title: str, meta: dict[str, Any]) -> Iterator[str]:
    """Yield the comment lines of a text format, which hold all data without a column."""
    yield f"# threadline {title}"
    for key, value in meta.items():
        yield f"# {key}: {json_line(value)}"


def parse_meta_lines(lines: Iterable[tuple[int, str]], path: Path) -> dict[str, Any]:
    """Return the data that ``meta_lines`` wrote; raise RecordingError for lines of another form."""
    meta: dict[str, Any] = {}
    for number, line in lines:
        key, colon, value = line.lstrip("# ").partition(":")
        if not colon:
            raise RecordingError(
                f"{line[:80]!r} is not a '# key: value' line", place=Place(str(path), number)
            )
        if key in meta:
            raise RecordingError(f"{key!r} occurs twice", place=Place(str(path), number))
        meta[key] = parse_json(value, Place(str(path), number))
    return meta


def parse_json(text: str, place: Place) -> Any:
    """Return the JSON value in ``text``.

    Raises
    ------
    RecordingError
        If it is not JSON.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{text.strip()[:80]!r} is not JSON", place=place) from error


def checked_meta(adapter: TypeAdapter[T], meta: Any, path: Path) -> T:
    """Return ``meta`` as the dataclass of ``adapter``; a RecordingError names a wrong key."""
    try:
        return adapter.validate_python(meta)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise RecordingError(
            f"the description in the file is wrong at {where!r}: {field_fault(first)[0]}",
            place=Place(str(path)),
            remedy="Write it again with this version of Threadline.",
        ) from error


def positive_fraction(text: str, place: Place) -> Fraction:
    """Return a text such as ``"1/200"`` as a fraction; raise RecordingError if it is 0."""
    numerator, _, denominator = text.partition("/")
    if int(numerator) == 0 or int(denominator) == 0:
        raise RecordingError(f"the period {text!r} must be greater than zero", place=place)
    return Fraction(int(numerator), int(denominator))


def fraction_text(value: Fraction) -> str:
    """Return a fraction as ``"1/200"``."""
    return f"{value.numerator}/{value.denominator}"


JITTER = 0.05
"""Largest deviation of an instant from the grid, as a share of the period. A trace with a larger
deviation is refused, not resampled."""


@dataclass(frozen=True, slots=True)
class Grid:
    """An even grid of instants: ``(first + k) * period_s`` for the rows k = 0 ... rows - 1."""

    period_s: Fraction
    first: int
    rows: int


def find_grid(times_s: Iterable[tuple[int, float]], path: str) -> Grid:
    """Return the grid of a trace from its line numbers and instants.

    The period is the fraction with the smallest denominator that agrees with the mean step within a
    tolerance.

    Raises
    ------
    RecordingError
        If there are fewer than two rows, the time does not increase, rows are missing, or the first
        instant is negative or between two periods.
    """
    rows, start_s, last_s = 0, 0.0, 0.0
    widest_s, gap_begin_s, gap_line = 0.0, 0.0, 0
    for number, time_s in times_s:
        if rows and time_s <= last_s:
            raise RecordingError(
                f"time goes from {last_s:.9g} s to {time_s:.9g} s, it must increase",
                place=Place(path, number),
                remedy="Sort the rows and remove duplicates.",
            )
        if not rows:
            start_s = time_s
        elif time_s - last_s > widest_s:
            widest_s, gap_begin_s, gap_line = time_s - last_s, last_s, number
        rows, last_s = rows + 1, time_s
    if rows < 2:
        raise RecordingError(
            f"the trace has {rows} row(s), at least 2 are needed", place=Place(path)
        )
    mean_s = (last_s - start_s) / (rows - 1)
    if widest_s > 1.5 * mean_s:
        raise RecordingError(
            f"rows are missing from {gap_begin_s:.9g} to {gap_begin_s + widest_s:.9g} s, where "
            f"rows are {mean_s:.3g} s apart on average",
            place=Place(path, gap_line),
            remedy="Record again without gaps, or give the part before or after it.",
        )
    # The grid may deviate from the last instant by a thousandth of the allowed jitter.
    slack = Fraction(JITTER * mean_s / 1000.0) / (rows - 1)
    period_s = simplest_between(Fraction(mean_s) - slack, Fraction(mean_s) + slack)
    first = round(Fraction(start_s) / period_s)
    if first < 0 or abs(Fraction(start_s) / period_s - first) > JITTER:
        raise RecordingError(
            f"the trace begins at {start_s:.9g} s, which is not a whole number of periods "
            f"of {float(period_s):.9g} s after 0",
            place=Place(path),
            remedy="Let time begin at 0, where the job begins.",
        )
    return Grid(period_s, first, rows)


def check_on_grid(time_s: float, tick: int, period_s: Fraction, stride: int, place: Place) -> None:
    """Refuse an instant whose distance from ``tick`` exceeds ``JITTER`` of a step."""
    step_s = float(period_s) * stride
    expected_s = tick * float(period_s.numerator) / float(period_s.denominator)
    if not abs(time_s - expected_s) <= JITTER * step_s:
        raise RecordingError(
            f"the row is at {time_s:.9g} s, expected {expected_s:.9g} s with an even period of "
            f"{step_s:.9g} s; at most {JITTER:.0%} of a period may be between them",
            place=place,
            remedy="Record at a fixed rate, or resample the trace; a row may be missing.",
        )


def simplest_between(low: Fraction, high: Fraction) -> Fraction:
    """Return the fraction with the smallest denominator in ``low ... high``, both above 0.

    >>> simplest_between(Fraction(49999, 10**7), Fraction(50001, 10**7))
    Fraction(1, 200)

    Notes
    -----
    The continued fractions of both ends agree up to the term at which the continued fraction of the
    simplest number ends (Stern-Brocot tree).
    """
    terms = []
    while True:
        integer_part = floor(low)
        if integer_part == low or integer_part + 1 <= high:
            terms.append(integer_part if integer_part == low else integer_part + 1)
            break
        terms.append(integer_part)
        low, high = 1 / (high - integer_part), 1 / (low - integer_part)
    result = Fraction(terms.pop())
    while terms:
        result = terms.pop() + 1 / result
    return result


def in_si(recording: Recording, place: Place) -> Recording:
    """Return ``recording`` with every channel in the SI unit of its kind.

    A file may give positions in mm or deg, voltages in mV and currents in mA; such samples are
    converted during reading. A recording in SI units is returned unchanged.

    Raises
    ------
    RecordingError
        If the unit of a channel does not suit its kind, or its kind has no unit.
    """
    factors: dict[str, float] = {}
    channels = []
    for channel in recording.channels:
        unit, factor = _si(channel, place)
        channels.append(replace(channel, unit=unit))
        if factor != 1.0:
            factors[channel.name] = factor
    if factors:
        recording = replace(recording, blocks=Stream(_scaled, recording.blocks, factors))
    return replace(recording, channels=tuple(channels))


def _si(channel: Channel, place: Place) -> tuple[str, float]:
    units = units_of(channel.kind)
    if not units:
        if channel.unit:
            raise RecordingError(
                f"channel {channel.name!r} is of kind {channel.kind.value}, which has no unit; "
                f"it is in {channel.unit!r}",
                place=place,
                remedy="Leave its unit empty.",
            )
        return "", 1.0
    for unit in units:
        try:
            return unit, unit_factor(channel.unit, unit)
        except UnitError:
            continue
    raise RecordingError(
        f"channel {channel.name!r} is of kind {channel.kind.value} and in {channel.unit!r}, "
        f"which is not a unit like {' or '.join(units)}",
        place=place,
        remedy="Convert its samples to such a unit.",
    )


def _scaled(
    blocks: Iterable[RecordingBlock], factors: Mapping[str, float]
) -> Iterator[RecordingBlock]:
    for block in blocks:
        samples = {
            name: values * factors[name] if name in factors else values
            for name, values in block.samples.items()
        }
        yield replace(block, samples=samples)
