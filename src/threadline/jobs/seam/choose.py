"""The seams of a drawing: their strokes, joined to contours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from threadline.drawing.contours import Contour, drop_zero_lengths, join_strokes
from threadline.drawing.curves import join_pieces
from threadline.drawing.strokes import Drawing, Stroke
from threadline.errors import JobError, Place
from threadline.jobs.seam.read_toml import SeamChoice, SeamFile

MAX_REACH_M = 1e4


def seam_choices(seam_file: SeamFile, drawing: Drawing) -> list[SeamChoice]:
    """Return the seams that were asked for, or one for each layer or colour."""
    if seam_file.choices:
        return list(seam_file.choices)
    if seam_file.by == "all":
        return [SeamChoice(name="seam")]
    by = seam_file.by
    found = dict.fromkeys(getattr(stroke, by) for stroke in drawing.strokes)
    for refusal in drawing.refusals:
        # A text of an SVG counts for every colour.
        if by == "layer" or refusal.colour:
            found.setdefault(getattr(refusal, by))
    if not found:
        return [SeamChoice(name="seam")]
    return [
        SeamChoice(name=value or "seam", layer=value)
        if by == "layer"
        else SeamChoice(name=value, colour=value)
        for value in found
    ]


def seam_contours(
    drawing: Drawing, choice: SeamChoice, seam_file: SeamFile
) -> tuple[list[Contour], list[str]]:
    """Return the contours of a seam on the machine, and warnings.

    Raises
    ------
    JobError
        If the seam has an entity that cannot be sewn, or none at all.
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
    chosen = [
        stroke
        for stroke in drawing.strokes
        if choice.layer in (None, stroke.layer) and choice.colour in (None, stroke.colour)
    ]
    _check_size(chosen, file)
    chosen, warnings = drop_zero_lengths(chosen, file)
    if any(seam_file.origin_m):
        origin = np.array(seam_file.origin_m)
        chosen = [
            replace(stroke, pieces=stroke.pieces.transform(np.eye(2), origin)) for stroke in chosen
        ]
    if not chosen:
        layers = sorted({f"{s.layer or '(no name)'} {s.colour}" for s in drawing.strokes})
        raise JobError(
            f"seam {choice.name!r} has nothing to sew",
            place=choice.places.get("layer", choice.places.get("colour", Place(file))),
            remedy=f"The drawing has the layers and colours: {', '.join(layers[:20]) or 'none'}.",
        )
    contours, found = join_strokes(chosen, seam_file.gap_m, file)
    return contours, warnings + found


def _check_size(strokes: list[Stroke], file: str) -> None:
    pieces = join_pieces([stroke.pieces for stroke in strokes])
    good = (np.abs(pieces.top) < MAX_REACH_M).all(axis=(1, 2))
    good &= np.isfinite(pieces.bottom).all(axis=1)
    good &= np.isfinite(pieces.begin_rad) & np.isfinite(pieces.sweep_rad)
    if not good.all():
        raise JobError(
            f"a stroke reaches further than {MAX_REACH_M:g} m",
            place=Place(file, int(pieces.line[int(np.argmin(good))])),
            remedy="Check the unit of the drawing.",
        )
