"""The job of a seam: the strokes of a drawing, joined into contours, and their stitches."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import JobError, Place
from threadline.files import Stream
from threadline.geometry.contours import Contour, DrawnLine, drop_zero_lengths, join_strokes
from threadline.geometry.curves import join_pieces
from threadline.geometry.offset import offset_contour
from threadline.geometry.strokes import Drawing, Stroke, read_limited
from threadline.jobs.operations import (
    Column,
    Dwell,
    Feed,
    FeedMode,
    Job,
    Move,
    MoveRun,
    Operation,
    OperationStream,
    Source,
    ToolEvent,
)
from threadline.jobs.seam.checks import (
    StitchCheck,
    corner_warnings,
    crossing_warnings,
    head_accelerations_m_s2,
)
from threadline.jobs.seam.corners import swinging_modes, with_journeys
from threadline.jobs.seam.read_toml import MAX_TOML_BYTES, SeamChoice, SeamFile, read_seam_file
from threadline.jobs.seam.settings import stitching
from threadline.jobs.seam.sewing import SewnContour, StitchBlock, sewn_contour
from threadline.machine import Machine

MAX_REACH_M = 1e4


def seam_choices(seam_file: SeamFile, drawing: Drawing) -> list[SeamChoice]:
    """Return the seams that the file names, or else one seam for each layer or colour."""
    if seam_file.choices:
        return list(seam_file.choices)
    if seam_file.by == "all":
        return [SeamChoice(name="seam")]
    by = seam_file.by
    values = dict.fromkeys(getattr(stroke, by) for stroke in drawing.strokes)
    for refusal in drawing.refusals:
        # A text in an SVG counts for every colour.
        if by == "layer" or refusal.colour:
            values.setdefault(getattr(refusal, by))
    if not values:
        return [SeamChoice(name="seam")]
    return [
        SeamChoice(name=value or "seam", layer=value)
        if by == "layer"
        else SeamChoice(name=value, colour=value)
        for value in values
    ]


def seam_contours(
    drawing: Drawing, choice: SeamChoice, seam_file: SeamFile
) -> tuple[list[Contour], list[str]]:
    """Return the contours of a seam in machine coordinates, and warnings.

    Raises
    ------
    JobError
        If an entity of the seam cannot be sewn, or the seam has no entity.
    """
    file = drawing.file
    for refusal in drawing.refusals:
        same_colour = choice.colour is None or refusal.colour in ("", choice.colour)
        if same_colour and choice.layer in (None, refusal.layer):
            raise JobError(
                f"layer {refusal.layer!r}: {refusal.message}",
                place=Place(file, refusal.line),
                remedy=refusal.remedy,
            )
    strokes = [
        stroke
        for stroke in drawing.strokes
        if choice.layer in (None, stroke.layer) and choice.colour in (None, stroke.colour)
    ]
    _check_size(strokes, file)
    strokes, warnings = drop_zero_lengths(strokes, file)
    if any(seam_file.origin_m):
        origin = np.array(seam_file.origin_m)
        strokes = [
            replace(stroke, pieces=stroke.pieces.transform(np.eye(2), origin)) for stroke in strokes
        ]
    if not strokes:
        layers = sorted({f"{s.layer or '(no name)'} {s.colour}" for s in drawing.strokes})
        raise JobError(
            f"seam {choice.name!r} has nothing to sew",
            place=choice.places.get("layer", choice.places.get("colour", Place(file))),
            remedy=f"The drawing has the layers and colours: {', '.join(layers[:20]) or 'none'}.",
        )
    contours, join_warnings = join_strokes(strokes, seam_file.gap_m, file)
    return contours, warnings + join_warnings


def _check_size(strokes: list[Stroke], file: str) -> None:
    pieces = join_pieces([stroke.pieces for stroke in strokes])
    in_reach = (np.abs(pieces.top) < MAX_REACH_M).all(axis=(1, 2))
    in_reach &= np.isfinite(pieces.bottom).all(axis=1)
    in_reach &= np.isfinite(pieces.begin_rad) & np.isfinite(pieces.sweep_rad)
    if not in_reach.all():
        raise JobError(
            f"a stroke reaches further than {MAX_REACH_M:g} m",
            place=Place(file, int(pieces.line[int(np.argmin(in_reach))])),
            remedy="Check the unit of the drawing.",
        )


_RAPID = Feed(FeedMode.RAPID, 0.0)
_LONGEST_RUN = 4096


class StitchStream(OperationStream):
    """The operations of a job's contours: for each contour the travel, the stitches and a trim."""

    __slots__ = ()

    def __init__(self, sewn: Sequence[SewnContour]) -> None:
        super().__init__(Stream(_runs, sewn))


def _runs(sewn: Sequence[SewnContour]) -> Iterator[Operation | MoveRun]:
    for number, contour in enumerate(sewn):
        yield from _begin(contour)
        needle = _Needle(contour, number)
        line = contour.place.line
        for block, most_hz in _with_highest_speeds(contour):
            line = int(block.line[-1])
            columns = needle.columns(block)
            for start in range(0, len(block.line), _LONGEST_RUN):
                part = slice(start, start + _LONGEST_RUN)
                yield MoveRun(
                    targets=block.points[1:][part],
                    line=block.line[part],
                    feeds=tuple(_feeds(contour, block.times_s[part], most_hz[part])),
                    file=contour.place.file,
                    passes=(),
                    columns={name: column[part] for name, column in columns.items()},
                )
            yield from _rest(contour, block)
        source = Source(contour.place.file, line)
        yield ToolEvent("trim", 1.0, source)
        if contour.settings.trim_s:
            yield Dwell(contour.settings.trim_s, source)


def _begin(contour: SewnContour) -> Iterator[Operation]:
    source = Source(contour.place.file, contour.place.line)
    x, y = contour.start().tolist()
    speed = contour.settings.travel_speed_m_s
    feed = _RAPID if speed is None or math.isinf(speed) else Feed(FeedMode.PATH, speed)
    yield Move((x, y), feed, source, {"kind": "travel", "seam": contour.seam})
    if contour.settings.settle_s:
        yield Dwell(contour.settings.settle_s, source)
    yield ToolEvent("sew", 1.0, source)


def _rest(contour: SewnContour, block: StitchBlock) -> Iterator[Operation]:
    if block.rests and block.leg is not contour.legs[-1]:
        yield Dwell(0.0, Source(contour.place.file, int(block.line[-1])))


def _with_highest_speeds(contour: SewnContour) -> Iterator[tuple[StitchBlock, FloatArray]]:
    """Yield each block with the (n,) highest needle speeds for a timing by limits, in stitch/s.

    At a rounded corner one piece of the path spans two stitches and has one speed. The shorter
    stitch sets this speed, so that neither stitch takes less time than a turn of the needle.
    """
    previous: tuple[StitchBlock, FloatArray] | None = None
    for block in contour.blocks():
        most_hz = np.full(len(block.lengths_m), contour.settings.needle_speed_hz)
        # Only a needle that follows has these speeds, and needs the next leg.
        if not contour.settings.follows:
            yield block, most_hz
            continue
        if previous is not None:
            block_before, slowed_hz = previous
            if not block_before.rests:
                ratio = float(block.lengths_m[0] / block_before.lengths_m[-1])
                slowed_hz[-1] = min(slowed_hz[-1], most_hz[0] * ratio)
                most_hz[0] *= min(1.0, 1.0 / ratio)
            yield previous
        previous = block, most_hz
    if previous is not None:
        yield previous


def _feeds(
    contour: SewnContour, times_s: FloatArray, most_hz: FloatArray
) -> Iterator[tuple[int, Feed]]:
    """Yield each feed with the index of its first stitch."""
    if contour.settings.needle == "constant":
        yield 0, Feed(FeedMode.INVERSE_TIME, contour.settings.needle_speed_hz)
        return
    changes = np.diff(times_s, prepend=-1.0) != 0.0
    if contour.settings.follows:
        changes |= np.diff(most_hz, prepend=-1.0) != 0.0
    for k in np.flatnonzero(changes).tolist():
        most = float(most_hz[k]) if contour.settings.follows else None
        yield k, Feed(FeedMode.INVERSE_TIME, 1.0 / float(times_s[k]), most=most)


class _Needle:
    """Counts the stitches of a contour and adds up their time."""

    def __init__(self, contour: SewnContour, number: int) -> None:
        self.contour = contour
        self.number = number
        self.stitch = 0
        self.time_s = 0.0

    def columns(self, block: StitchBlock) -> dict[str, Column]:
        """Return the tags of a leg's stitches as columns."""
        settings, count = self.contour.settings, len(block.lengths_m)
        stitch = np.arange(self.stitch, self.stitch + count)
        if settings.needle == "constant":
            # Counting whole turns of the needle avoids a sum of rounding errors.
            ends_s = (stitch + 1) / settings.needle_speed_hz
        else:
            ends_s = np.cumsum(np.concatenate([[self.time_s], block.times_s]))[1:]
        corner = np.zeros(count, dtype=np.int64)
        corner[-1] = block.leg.end_turn_rad is not None
        self.stitch += count
        self.time_s = float(ends_s[-1])
        follows: dict[str, Column] = {}
        if settings.follows:
            follows["slowest_hz"] = np.full(count, settings.needle_slowest_hz)
            follows["fastest_hz"] = np.full(count, settings.needle_speed_hz)
            if math.isfinite(settings.needle_acceleration_hz_s):
                follows["most_hz_s"] = np.full(count, settings.needle_acceleration_hz_s)
        if math.isfinite(settings.swing):
            follows["swing"] = np.full(count, settings.swing)
        return follows | {
            "kind": np.full(count, "lock" if block.leg.lock else "sew"),
            "seam": np.full(count, self.contour.seam),
            "contour": np.full(count, self.number),
            "stitch": stitch,
            "exempt": block.exempt.astype(np.int64),
            "corner": corner,
            "needle_s": ends_s,
            "length_m": block.lengths_m,
            "target_m": block.target_m,
            "from_m": block.at_m[:-1],
            "to_m": block.at_m[1:],
        }


AXES = ("X", "Y")
_READERS = {
    ".csv": ("read_csv", "read_csv"),
    ".dxf": ("read_dxf", "read_dxf"),
    ".svg": ("svg", "read_svg"),
}
"""Module of the geometry and its reader for each kind of drawing, imported when a file needs it."""
SUFFIXES = (".seam.toml", *_READERS)


def read_seam(path: str | Path, machine: Machine, **options: Any) -> Job:
    """Read a seam and place its stitches.

    Parameters
    ----------
    path
        Seam file (``.seam.toml``), or a drawing (``.dxf``, ``.svg``, ``.csv``) together with
        ``options``.
    machine
        Machine whose axes X and Y carry the head, and whose limits for travel, speed and
        acceleration apply.
    options
        Settings of the ``[stitching]`` table by name, as text with a unit
        (``needle_speed="40 stitch/s"``); they replace the file's settings for every seam.

    Returns
    -------
    Job
        Job with one move per stitch; the feed of a move gives the time of one turn of the needle.
        The tags are ``kind`` (travel, sew, lock), ``seam``, ``contour`` and ``stitch`` (counted
        from 0), ``exempt`` and ``corner`` (0 or 1), ``needle_s`` (time since the start of the
        contour), ``length_m`` and ``target_m``, and ``from_m`` and ``to_m`` (the stretch of the
        contour that the stitch covers).

    Raises
    ------
    JobError
        If the file cannot be read, or an entity cannot be sewn.
    LimitError
        If a stitch lies outside the travel of an axis.
    """
    path = Path(path)
    for axis in AXES:
        if axis not in machine.axes or machine.axes[axis].kind != "linear":
            raise JobError(
                f"a seam needs the linear axes X and Y; machine {machine.name!r} has "
                f"{', '.join(machine.axis_names) or 'no axes'}",
                place=Place(str(path)),
                remedy="Choose a machine that sews.",
            )
    seam_file, drawing, digest = _load(path)
    place = Place(drawing.file)
    warnings = list(drawing.warnings)
    sewn: list[SewnContour] = []
    modes = swinging_modes(machine, AXES)
    fastest = min(machine.axes[axis].velocity.si for axis in AXES)
    for choice in seam_choices(seam_file, drawing):
        settings = stitching(
            {**seam_file.settings, **choice.settings, **options},
            {**seam_file.places, **choice.places},
            Place(str(path)),
        )
        rests = settings.settle_s
        settings = with_journeys(settings, modes, fastest)
        accelerations, texts = head_accelerations_m_s2(settings, AXES, machine)
        warnings += [f"{place}: seam {choice.name!r}: {text}" for text in texts]
        contours, texts = seam_contours(drawing, choice, seam_file)
        warnings += texts
        for contour in contours:
            warnings += crossing_warnings(contour, choice.name, drawing.file)
            for part in offset_contour(contour, settings.allowance, drawing.file):
                sewn.append(sewn_contour(part, choice.name, drawing.file, settings, accelerations))
                if len(sewn) == 1 and not sewn[0].start().any():
                    # The head is at the start of this contour already.
                    settings_here = replace(settings, settle_s=rests or 0.0)
                    sewn[0] = replace(sewn[0], settings=settings_here)
                warnings += corner_warnings(sewn[-1], machine.least_acceleration(AXES))
    along_m_s2 = math.inf
    for contour_sewn in sewn:
        check = StitchCheck(contour_sewn, AXES, machine)
        check.reach()
        for block in contour_sewn.blocks():
            check.add(block)
        warnings += check.warnings()
        along_m_s2 = min(along_m_s2, check.along_m_s2)
    return Job(
        name=path.name,
        file=str(path),
        sha256=digest,
        axes=AXES,
        start=(0.0, 0.0),
        operations=StitchStream(sewn),
        warnings=tuple(warnings),
        paced_by="needle",
        needle_follows=any(contour.settings.follows for contour in sewn),
        along_m_s2=along_m_s2,
        drawn=tuple(DrawnLine(contour.table, contour.closed) for contour in sewn),
    )


def _load(path: Path) -> tuple[SeamFile, Drawing, str]:
    """Return the seam file, the drawing, and one hash over both files."""
    content = read_limited(path)
    digest = hashlib.sha256(content)
    if path.name.lower().endswith(".toml"):
        if len(content) > MAX_TOML_BYTES:
            raise JobError(
                f"the file has more than {MAX_TOML_BYTES} bytes",
                place=Place(str(path)),
                remedy="Put the points into a CSV file.",
            )
        with np.errstate(all="ignore"):
            seam_file = read_seam_file(content, str(path))
        if isinstance(seam_file.drawing, Drawing):
            return seam_file, seam_file.drawing, digest.hexdigest()
        drawn = path.parent / seam_file.drawing
        if drawn.suffix.lower() not in _READERS:
            raise JobError(
                f"the drawing {seam_file.drawing!r} ends in none of {', '.join(_READERS)}",
                place=Place(str(path), seam_file.drawing_line),
            )
        content = read_limited(drawn)
        digest.update(content)
    else:
        seam_file, drawn = SeamFile(drawing=path.name), path
    suffix = drawn.suffix.lower()
    if suffix not in _READERS:
        raise JobError(f"{path.name!r} is no seam", remedy=f"A seam ends in {', '.join(SUFFIXES)}.")
    module, name = _READERS[suffix]
    reader: Callable[[bytes, str, str | None], Drawing]
    reader = getattr(import_module(f"threadline.geometry.{module}"), name)
    # A number that overflows is not finite; ``_check_size`` refuses it with its place.
    with np.errstate(all="ignore"):
        drawing = reader(content, str(drawn), seam_file.unit)
    return seam_file, drawing, digest.hexdigest()
