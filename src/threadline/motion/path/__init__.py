"""Programmed and planned paths in axis space, and the deviation between them."""

from typing import TYPE_CHECKING

from threadline.base.importing import later

if TYPE_CHECKING:
    from threadline.motion.path.deviation import PathDeviation, path_deviation
    from threadline.motion.path.interpolations import (
        BY_LAW,
        CHORDS,
        chord_path,
        interpolation_names,
        on_chords,
        plan_path,
    )
    from threadline.motion.path.programmed import programmed_path
    from threadline.motion.path.types import (
        PieceBlock,
        PlannedPath,
        ProgrammedPath,
        Timing,
        VertexBlock,
    )

__all__ = [
    "BY_LAW", "CHORDS", "PathDeviation", "PieceBlock", "PlannedPath", "ProgrammedPath", "Timing",
    "VertexBlock", "chord_path", "interpolation_names", "on_chords", "path_deviation", "plan_path",
    "programmed_path",
]  # fmt: skip

__getattr__ = later(
    __name__,
    {
        "deviation": "PathDeviation path_deviation",
        "interpolations": "BY_LAW CHORDS chord_path interpolation_names on_chords plan_path",
        "programmed": "programmed_path",
        "types": "PieceBlock PlannedPath ProgrammedPath Timing VertexBlock",
    },
)
