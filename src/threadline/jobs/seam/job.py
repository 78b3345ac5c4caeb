"""The job of a seam, with one move per stitch, from a drawing and its settings."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from threadline.drawing.line import DrawnLine
from threadline.drawing.offset import offset_contour
from threadline.drawing.read_csv import read_csv
from threadline.drawing.read_dxf import read_dxf
from threadline.drawing.strokes import Drawing, read_limited
from threadline.drawing.svg import read_svg
from threadline.errors import JobError, Place
from threadline.jobs.operations import Job
from threadline.jobs.seam.checks import (
    StitchCheck,
    corner_warnings,
    crossing_warnings,
    head_accelerations_m_s2,
)
from threadline.jobs.seam.choose import seam_choices, seam_contours
from threadline.jobs.seam.journeys import swinging_modes, with_journeys
from threadline.jobs.seam.read_toml import MAX_TOML_BYTES, SeamFile, read_seam_file
from threadline.jobs.seam.settings import stitching
from threadline.jobs.seam.sewing import SewnContour, sewn_contour
from threadline.jobs.seam.stitch_stream import StitchStream
from threadline.machine import Machine

AXES = ("X", "Y")
_READERS = {".csv": read_csv, ".dxf": read_dxf, ".svg": read_svg}
SUFFIXES = (".seam.toml", *_READERS)


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
        A job with one move per stitch, whose feed is the time of one turn of the needle. Tags are
        ``kind`` (travel, sew, lock), ``seam``, ``contour`` and ``stitch`` (counted from 0),
        ``exempt`` and ``corner`` (0 or 1), ``needle_s`` (time since the first stitch of the
        contour), ``length_m`` and ``target_m``, and ``from_m`` and ``to_m``, the stretch of the
        contour that the stitch covers.

    Raises
    ------
    JobError
        If the file cannot be read, or has an entity that cannot be sewn.
    LimitError
        If a stitch lies outside the travel.
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
        accelerations, found = head_accelerations_m_s2(settings, AXES, machine)
        warnings += [f"{place}: seam {choice.name!r}: {text}" for text in found]
        contours, found = seam_contours(drawing, choice, seam_file)
        warnings += found
        for contour in contours:
            warnings += crossing_warnings(contour, choice.name, drawing.file)
            for part in offset_contour(contour, settings.allowance, drawing.file):
                sewn.append(sewn_contour(part, choice.name, drawing.file, settings, accelerations))
                if len(sewn) == 1 and not sewn[0].start().any():
                    # The head is there already.
                    still = replace(settings, settle_s=rests or 0.0)
                    sewn[0] = replace(sewn[0], settings=still)
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
    reader = _READERS.get(drawn.suffix.lower())
    if reader is None:
        raise JobError(f"{path.name!r} is no seam", remedy=f"A seam ends in {', '.join(SUFFIXES)}.")
    # What overflows here is not finite, and refused with its place when the strokes are chosen.
    with np.errstate(all="ignore"):
        drawing = reader(content, str(drawn), seam_file.unit)
    return seam_file, drawing, digest.hexdigest()
