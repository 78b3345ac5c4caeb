"""A drawing and how to sew it -> a job of one move a stitch."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from threadline.errors import JobError, Place
from threadline.jobs.operations import (
    Dwell,
    Feed,
    FeedMode,
    Job,
    Move,
    Operation,
    Source,
    ToolEvent,
)
from threadline.jobs.seam.checks import (
    StitchCheck,
    corner_warnings,
    crossing_warnings,
    head_acceleration_m_s2,
)
from threadline.jobs.seam.choose import seam_choices, seam_contours
from threadline.jobs.seam.drawing import Drawing, read_limited
from threadline.jobs.seam.offset import offset_contour
from threadline.jobs.seam.read_csv import read_csv
from threadline.jobs.seam.read_dxf import read_dxf
from threadline.jobs.seam.read_svg import read_svg
from threadline.jobs.seam.read_toml import MAX_TOML_BYTES, SeamFile, read_seam_file
from threadline.jobs.seam.settings import stitching
from threadline.jobs.seam.sewing import SewnContour, StitchBlock, sewn_contour
from threadline.machine import Machine
from threadline.signals import Stream

AXES = ("X", "Y")
_READERS = {".csv": read_csv, ".dxf": read_dxf, ".svg": read_svg}
SUFFIXES = (".seam.toml", *_READERS)
_RAPID = Feed(FeedMode.RAPID, 0.0)


def read_seam(path: str | Path, machine: Machine, **options: Any) -> Job:
    """Read a seam and place its stitches.

    Parameters
    ----------
    path
        A seam file (``.seam.toml``), or a drawing (``.dxf``, ``.svg``, ``.csv``) with
        ``options``.
    machine
        Its axes X and Y carry the head; travel, speed and acceleration are checked against it.
    options
        Settings of the ``[stitching]`` table by name, as text with a unit
        (``needle_speed="40 stitch/s"``); they replace those of the file, for every seam.

    Returns
    -------
    Job
        A move a stitch, each with the time of one turn of the needle as its feed, and tags:
        ``kind`` (travel, sew, lock), ``seam``, ``contour`` and ``stitch`` (counted from 0),
        ``exempt`` and ``corner`` (0 or 1), ``needle_s`` (since the needle first went down in
        the contour), ``length_m`` and ``target_m``.

    Raises
    ------
    JobError
        If the file cannot be read, or holds what cannot be sewn.
    LimitError
        If a stitch lies outside the travel.
    """
    path = Path(path)
    for axis in AXES:
        if axis not in machine.axes or machine.axes[axis].kind != "linear":
            raise JobError(
                f"a seam needs the linear axes X and Y; machine {machine.name!r} has "
                f"{', '.join(machine.axis_names)}",
                place=Place(str(path)),
                remedy="Choose a machine that sews.",
            )
    seam_file, drawing, digest = _load(path)
    place = Place(drawing.file)
    warnings = list(drawing.warnings)
    sewn: list[SewnContour] = []
    for choice in seam_choices(seam_file, drawing):
        settings = stitching(
            {**seam_file.settings, **choice.settings, **options},
            {**seam_file.places, **choice.places},
            Place(str(path)),
        )
        acceleration, found = head_acceleration_m_s2(settings, AXES, machine)
        warnings += [f"{place}: seam {choice.name!r}: {text}" for text in found]
        contours, found = seam_contours(drawing, choice, seam_file)
        warnings += found
        for contour in contours:
            warnings += crossing_warnings(contour, choice.name, drawing.file)
            for part in offset_contour(contour, settings, drawing.file):
                sewn.append(sewn_contour(part, choice.name, drawing.file, settings, acceleration))
                limit = min(machine.axes[axis].acceleration.si for axis in AXES)
                warnings += corner_warnings(sewn[-1], limit)
    for contour_sewn in sewn:
        check = StitchCheck(contour_sewn, AXES, machine)
        check.reach()
        for block in contour_sewn.blocks():
            check.add(block)
        warnings += check.warnings()
    return Job(
        name=path.name,
        file=str(path),
        sha256=digest,
        axes=AXES,
        start=(0.0, 0.0),
        operations=Stream(lambda: _operations(sewn)),
        warnings=tuple(warnings),
    )


def _load(path: Path) -> tuple[SeamFile, Drawing, str]:
    """Return the seam file, the drawing, and the hash of both."""
    content = read_limited(path)
    digest = hashlib.sha256(content)
    if path.name.lower().endswith(".toml"):
        if len(content) > MAX_TOML_BYTES:
            raise JobError(
                f"the file has more than {MAX_TOML_BYTES} bytes",
                place=Place(str(path)),
                remedy="Put the points into a CSV file.",
            )
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
    reader = _READERS.get(drawn.suffix.lower())
    if reader is None:
        raise JobError(f"{path.name!r} is no seam", remedy=f"A seam ends in {', '.join(SUFFIXES)}.")
    # What overflows here is not finite, and refused with its place when the strokes are chosen.
    with np.errstate(all="ignore"):
        drawing = reader(content, str(drawn), seam_file.unit)
    return seam_file, drawing, digest.hexdigest()


def _operations(sewn: list[SewnContour]) -> Iterator[Operation]:
    for number, contour in enumerate(sewn):
        file = contour.place.file
        source = Source(file, contour.place.line)
        x, y = contour.start().tolist()
        yield Move((x, y), _RAPID, source, {"kind": "travel", "seam": contour.seam})
        yield ToolEvent("sew", 1.0, source)
        settings = contour.settings
        even = Feed(FeedMode.INVERSE_TIME, settings.needle_speed_hz)
        stitch, needle_s = 0, 0.0
        constant = settings.needle == "constant"
        for block in contour.blocks():
            base: dict[str, float | str] = {
                "kind": "lock" if block.leg.lock else "sew",
                "seam": contour.seam,
                "contour": number,
                "target_m": settings.stitch_length_m,
            }
            corner_at = len(block.lengths_m) - 1 if block.leg.end_turn_rad is not None else -1
            for k, (x, y, length, time, exempt, line) in enumerate(_rows(block)):
                needle_s += time
                tags = {
                    **base,
                    "stitch": stitch,
                    "exempt": exempt,
                    "corner": int(k == corner_at),
                    # Whole turns of the needle are counted, so that no rounding adds up.
                    "needle_s": (stitch + 1) / settings.needle_speed_hz if constant else needle_s,
                    "length_m": length,
                }
                feed = even if constant else Feed(FeedMode.INVERSE_TIME, 1.0 / time)
                if line != source.line:
                    source = Source(file, line)
                yield Move((x, y), feed, source, tags)
                stitch += 1
            if block.rests and block.leg is not contour.legs[-1]:
                yield Dwell(0.0, source)
        yield ToolEvent("trim", 1.0, source)


def _rows(block: StitchBlock) -> Iterator[tuple[float, float, float, float, int, int]]:
    return zip(
        block.points[1:, 0].tolist(),
        block.points[1:, 1].tolist(),
        block.lengths_m.tolist(),
        block.times_s.tolist(),
        block.exempt.astype(np.int64).tolist(),
        block.line.tolist(),
        strict=True,
    )
