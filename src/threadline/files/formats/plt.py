"""``.PLT``: the trace format of the 1994 controller, one line of positions per recorded tick.

The thesis describes the file (section 9.9, appendix A) but prints no example. Threadline adds a
first line with columns, units and rate, so that a spreadsheet shows headings and the file can be
judged without other files.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.reading import KnownFile
from threadline.errors import Place, RecordingError, UnitError
from threadline.files.clock import Clock
from threadline.files.formats.common import (
    AXES,
    Written,
    atomic_file,
    clear_errors,
    parse_column,
    reading,
    text_lines,
    written,
)
from threadline.files.formats.recording_csv import parse_number
from threadline.files.formats.tick_table import READ_ROWS
from threadline.files.recording import Channel, ChannelKind, Recording, RecordingBlock
from threadline.files.stream import Stream
from threadline.units import parse_exact_time_s, unit_factor

LINES_1994 = 5000
"""Largest number of lines of the plot file in 1994."""

_ORDER = ("X", "Y", "A", "Z", "B", "C")
_UNITS = {"m": "mm", "rad": "deg"}
_RATE = re.compile(r"every (?P<every>[1-9][0-9]{0,11}) ticks? of (?P<period>[^\t]{1,60})")


def write_plt(
    recording: Recording,
    path: Path,
    *,
    every: int | None = None,
    kind: ChannelKind = ChannelKind.MEASURED,
    limit_lines: int | None = None,
) -> Written:
    """Write the positions of the existing axes among X, Y, A, Z, B, C, in mm and degrees.

    Parameters
    ----------
    recording
        The recording to write.
    every
        Number of ticks from one line to the next; by default every sample is written.
    kind
        Kind of the positions; by default the encoder positions.
    limit_lines
        Largest number of lines (``LINES_1994`` in 1994); a warning reports omitted lines. With None
        all lines are written.

    Raises
    ------
    RecordingError
        If there are no such channels, or ``every`` is not a multiple of their stride.
    """
    channels = [c for axis in _ORDER if (c := recording.find(kind, axis)) is not None]
    if not channels:
        raise RecordingError(
            f"the recording has no {kind.value} position, which .plt needs",
            remedy="Write it as .csv or .npz.",
        )
    wrong_unit = [c for c in channels if c.unit not in _UNITS]
    if wrong_unit:
        raise RecordingError(
            f"channel {wrong_unit[0].name!r} is in {wrong_unit[0].unit!r}, not in m or rad"
        )
    clock, stride = channels[0].clock, channels[0].stride
    if any((c.clock, c.stride) != (clock, stride) for c in channels):
        raise RecordingError("the positions lie on several clocks", remedy="Write it as .npz.")
    every = stride if every is None else every
    if every < 1 or every % stride:
        raise RecordingError(
            f"a line every {every} ticks is impossible: samples are {stride} ticks apart",
            remedy=f"Give a multiple of {stride}.",
        )
    lines_left = limit_lines
    was_cut = False
    with atomic_file(path) as file:
        heads = [f"{c.axis} [{_UNITS[c.unit]}]" for c in channels]
        rate = f"every {every} ticks of {_period_text(clock.period_s)}"
        file.write(("\t".join([*heads, rate]) + "\n").encode())
        for rows in _rows(recording, channels, every):
            written_rows = rows if lines_left is None else rows[:lines_left]
            lines = ["\t".join(f"{v:.4f}" for v in row) + "\n" for row in written_rows.tolist()]
            file.write("".join(lines).encode())
            was_cut = was_cut or len(written_rows) < len(rows)
            lines_left = None if lines_left is None else lines_left - len(written_rows)
    warnings = (f"{path.name} was cut after {limit_lines} lines",) if was_cut else ()
    return written(path, warnings)


def _period_text(period_s: Fraction) -> str:
    milliseconds = period_s * 1000
    denominator = milliseconds.denominator
    for prime in (2, 5):
        while denominator % prime == 0:
            denominator //= prime
    if denominator == 1 and Fraction(repr(float(milliseconds))) == milliseconds:
        return f"{float(milliseconds)!r} ms".replace(".0 ms", " ms")
    return f"{period_s.numerator}/{period_s.denominator} s"


def _rows(recording: Recording, channels: list[Channel], every: int) -> Iterator[FloatArray]:
    clock, stride = channels[0].clock, channels[0].stride
    factors = np.array([unit_factor(c.unit, _UNITS[c.unit]) for c in channels])
    expected_tick = 0
    for block in recording:
        first = block.first_tick[clock.name]
        samples = np.column_stack([block.samples[c.name] for c in channels])
        if not len(samples):
            continue
        if first != expected_tick:
            raise RecordingError(
                f"the recording has a gap between tick {expected_tick} and tick {first}",
                remedy="Write it as .npz.",
            )
        expected_tick = first + stride * len(samples)
        yield samples[(-first % every) // stride :: every // stride] * factors


def read_plt(path: Path) -> Recording:
    """Read a file that ``write_plt`` wrote, as measured positions.

    Raises
    ------
    RecordingError
        If the first line does not give columns, units and rate, or a line is wrong.
    """
    with clear_errors(path):
        number, head = next(text_lines(path), (0, ""))
        place = Place(str(path), max(number, 1))
        *names, rate = head.split("\t")
        match = _RATE.fullmatch(rate.strip())
        if match is None or not names:
            raise RecordingError(
                f"the first line {head[:60]!r} does not give columns, units and rate",
                place=place,
                remedy='Begin with "X [mm]", "Y [mm]", "A [deg]", "every 20 ticks of 5 ms", '
                "with tabs in between.",
            )
        columns = [parse_column(name, place) for name in names]
        if any(c.axis not in AXES or c.unit not in _UNITS for c in columns):
            raise RecordingError("every column must be the position of an axis", place=place)
        if len({c.name for c in columns}) < len(names):
            raise RecordingError("a column occurs twice", place=place)
        clock = Clock("recording", _period(match["period"], place))
        channels = tuple(
            Channel(
                name=c.name,
                kind=c.kind or ChannelKind.MEASURED,
                unit=c.unit,
                clock=clock,
                axis=c.axis,
                stride=int(match["every"]),
            )
            for c in columns
        )
        factors = np.array([c.factor for c in columns])
        recording = Recording(
            channels=channels,
            blocks=Stream(_blocks, KnownFile.of(path), channels, factors),
            job_sha256="",
            machine_sha256="",
            simulated=False,
        )
        for _ in recording:
            pass  # read every line now, so that a wrong line is found before the recording is used
    return recording


def _period(text: str, place: Place) -> Fraction:
    fraction = re.fullmatch(r"([1-9][0-9]{0,30})/([1-9][0-9]{0,30}) s", text.strip())
    if fraction:
        return Fraction(int(fraction[1]), int(fraction[2]))
    try:
        return parse_exact_time_s(text.strip())
    except UnitError as error:
        raise RecordingError(
            f"the tick {text[:40]!r} cannot be read: {error.message}", place=place
        ) from error


def _blocks(
    known_file: KnownFile, channels: tuple[Channel, ...], factors: FloatArray
) -> Iterator[RecordingBlock]:
    path, clock, stride = known_file.path, channels[0].clock, channels[0].stride
    first = 0
    rows: list[list[float]] = []

    def block() -> RecordingBlock:
        values = np.array(rows) * factors
        samples = {c.name: values[:, k].copy() for k, c in enumerate(channels)}
        return RecordingBlock(first_tick={clock.name: first}, samples=samples)

    with reading(known_file):
        for number, line in text_lines(path):
            if number == 1:
                continue
            place = Place(str(path), number)
            cells = line.split("\t")
            if len(cells) != len(channels):
                raise RecordingError(
                    f"the line has {len(cells)} numbers, but there are {len(channels)} columns",
                    place=place,
                    remedy="The file may have been cut off.",
                )
            if len(rows) == READ_ROWS:
                yield block()
                first, rows = first + stride * len(rows), []
            rows.append([parse_number(cell, place) for cell in cells])
        if not rows and not first:
            raise RecordingError("the trace has no rows", place=Place(str(path)))
        if rows:
            yield block()
