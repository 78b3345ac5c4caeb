"""Paths in axis space: what is programmed, what is planned, how far the two are apart."""

from threadline.path.budget import check_budget
from threadline.path.deviation import PathDeviation, path_deviation
from threadline.path.plan import interpolation_names, on_time_path, plan_path
from threadline.path.programmed import programmed_path
from threadline.path.types import PieceBlock, PlannedPath, ProgrammedPath, Timing, VertexBlock

__all__ = [
    "PathDeviation",
    "PieceBlock",
    "PlannedPath",
    "ProgrammedPath",
    "Timing",
    "VertexBlock",
    "check_budget",
    "interpolation_names",
    "on_time_path",
    "path_deviation",
    "plan_path",
    "programmed_path",
]
