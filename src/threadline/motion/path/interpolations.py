"""Plan a path by the name of its interpolation, and the figures that planners report of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

from threadline.base.option_defaults import DEFAULT_TOLERANCE_M
from threadline.base.wording import nearest
from threadline.errors import OptionError
from threadline.files import CachedStream, Stream
from threadline.machine import Machine
from threadline.machine.vary import within_path
from threadline.motion.path import bspline, straight
from threadline.motion.path.auto import auto_pieces, points_added
from threadline.motion.path.bspline import PULLS, Pull
from threadline.motion.path.deviation import path_deviation
from threadline.motion.path.durations import polynomial_limits, smoothing_for, smoothing_share
from threadline.motion.path.polygon import CUBIC, QUARTIC
from threadline.motion.path.runs import (
    ALONG_ITSELF,
    resting_at_reversals,
    resting_before_first_moves,
)
from threadline.motion.path.straight import blended_pieces, polynomial_pieces
from threadline.motion.path.types import PieceBlock, PlannedPath, ProgrammedPath, Timing
from threadline.motion.path.wide_corners import EVEN, Corners

_Work: TypeAlias = partial[dict[str, float]]


class LazySummary(Mapping[str, float]):
    """Figures of a path that are computed when one of their group is first read.

    Parameters
    ----------
    groups
        For the names of figures, the call that returns them all: of a function of a module, not
        nested in another, so that a summary can be pickled like a ``Stream``.
    """

    def __init__(self, groups: Mapping[tuple[str, ...], _Work]) -> None:
        self._groups = groups
        self._found: dict[str, float] = {}

    def __getitem__(self, key: str) -> float:
        if key not in self._found:
            for names, work in self._groups.items():
                if key in names:
                    self._found |= work()
        return self._found[key]

    def __iter__(self) -> Iterator[str]:
        for names in self._groups:
            yield from names

    def __len__(self) -> int:
        return sum(map(len, self._groups))


def _number_added(
    programmed: ProgrammedPath, cut_m: float, degree: int = CUBIC, corners: Corners = EVEN
) -> dict[str, float]:
    return {"points_added": float(points_added(programmed, cut_m, degree, corners))}


def _deviation(programmed: ProgrammedPath, planned: PlannedPath) -> dict[str, float]:
    deviation = path_deviation(programmed, planned)
    return {
        "largest_deviation_m": deviation.at_tool_m,
        "largest_deviation_line": float(deviation.line),
    }


def _with_deviation(
    programmed: ProgrammedPath,
    planned: PlannedPath,
    added: _Work | None = None,
) -> PlannedPath:
    """Return the path with a summary: points added, largest deviation in m, its program line."""
    groups: dict[tuple[str, ...], _Work] = {}
    if added is not None:
        groups["points_added",] = added
    of_deviation = partial(_deviation, programmed, planned)
    groups["largest_deviation_m", "largest_deviation_line"] = of_deviation
    return replace(planned, summary=LazySummary(groups))


PARABOLA_SHARE = 0.9
NEAR_SHARE = 0.01  # share of the tolerance: ``optimal`` leaves out vertices closer together
_ROUNDING = 1e-9
CHORDS = "chords"
"""The programmed chords unchanged; not an interpolation of its own."""
BY_LAW = "law:"
"""Prefix of the interpolations that follow each chord by a motion law."""
OPTIMAL = "optimal"
FIRMWARE = "firmware"
"""The chords with the timing of the machine's own firmware."""
KEEPING_TOLERANCE = ("auto", OPTIMAL, "parabolic")
"""Interpolations that stay within the tolerance everywhere; the others report their deviation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PathOptions:
    """Options of the interpolations; see ``plan_path``."""

    tolerance_m: float = DEFAULT_TOLERANCE_M
    pull: Pull = "repeat"
    corners: Corners = EVEN


Planner = Callable[[ProgrammedPath, Machine, PathOptions], PlannedPath]


def plan_path(
    programmed: ProgrammedPath,
    machine: Machine,
    interpolation: str = "auto",
    tolerance_m: float = DEFAULT_TOLERANCE_M,
    pull: Pull = "repeat",
    corners: Corners = EVEN,
) -> PlannedPath:
    """Return the path to follow.

    Parameters
    ----------
    programmed, machine
        The programmed path of the job, and its machine.
    interpolation
        One of ``interpolation_names()``.
    tolerance_m
        Largest distance between planned and programmed path at the tool, with rotary axes at
        their radius. The historical interpolations ignore it. The cubic keeps it at the points
        and the quintic meets the points; between the points neither has a bound.
    pull
        How ``b-spline-pulled`` is pulled to its turning points: by repeating them, by points
        nearby, or by knot spacing.
    corners
        With ``optimal``: how far the path may leave the program on the outside of its corners, and
        the corners with a smaller tolerance.

    Raises
    ------
    OptionError
        If the interpolation or the way to pull is unknown, or the tolerance is not positive.
    PlanError
        If the job cannot be done (see ``programmed_path``).
    """
    if interpolation not in _PLANNERS:
        raise OptionError(
            f"unknown interpolation {interpolation!r}",
            remedy=nearest(interpolation, [*_PLANNERS, f"{BY_LAW}NAME"], "There are"),
        )
    if not 0 < tolerance_m < float("inf"):
        raise OptionError(
            f"tolerance is {tolerance_m!r} m; it must be greater than 0",
            remedy='Give one like "0.1 mm".',
        )
    if pull not in PULLS:
        raise OptionError(
            f"unknown way {pull!r} to pull a spline", remedy=f"There are: {', '.join(PULLS)}."
        )
    options = PathOptions(tolerance_m=tolerance_m, pull=pull, corners=corners)
    if interpolation == OPTIMAL and machine.path is not None and machine.path.asks_for_rests:
        programmed = replace(programmed, blocks=Stream(resting_at_reversals, programmed))
    elif machine.planner is not None and interpolation in _ROUNDED:
        resting_blocks = Stream(resting_at_reversals, programmed, ALONG_ITSELF)
        programmed = replace(programmed, blocks=resting_blocks)
        kinds = [machine.axes[name].kind for name in programmed.axes]
        linear = tuple(k for k, kind in enumerate(kinds) if kind == "linear")
        first_move_blocks = Stream(resting_before_first_moves, programmed, linear)
        programmed = replace(programmed, blocks=first_move_blocks)
    if interpolation != OPTIMAL:
        machine = within_path(machine, programmed.axes, programmed.radius_m)
    return _PLANNERS[interpolation](programmed, machine, options)


def chord_path(programmed: ProgrammedPath, interpolation: str = CHORDS) -> PlannedPath:
    """Return the programmed chords as a path, for motions that need no rounded corners.

    Such motions are smoothed in time (``Pace.PROGRAMMED``) or rest at every vertex
    (``Pace.LAW``).

    Parameters
    ----------
    interpolation
        Name of the path.
    """
    return _along(
        programmed, interpolation, Timing.GEOMETRIC, CachedStream(straight.chords, programmed)
    )


def on_chords(interpolation: str) -> bool:
    """Return whether an interpolation follows the programmed chords themselves."""
    return interpolation == CHORDS or interpolation.startswith(BY_LAW)


def interpolation_names() -> tuple[str, ...]:
    """Return the names that ``plan_path`` accepts."""
    return tuple(_PLANNERS)


def _along(
    programmed: ProgrammedPath,
    interpolation: str,
    timing: Timing,
    blocks: Stream[PieceBlock],
    *,
    historical: bool = False,
    **more: Any,
) -> PlannedPath:
    """Return the path that ``blocks`` gives to the axes of the program."""
    return PlannedPath(
        axes=programmed.axes,
        radius_m=programmed.radius_m,
        interpolation=interpolation,
        timing=timing,
        historical=historical,
        blocks=blocks,
        **more,
    )


def _historical(
    name: str,
    programmed: ProgrammedPath,
    blocks: CachedStream[PieceBlock],
    summary: Mapping[str, float],
) -> PlannedPath:
    return _along(programmed, name, Timing.TIME, blocks, historical=True, summary=summary)


def _linear(programmed: ProgrammedPath, machine: Machine, options: PathOptions) -> PlannedPath:
    del options
    return _historical(
        "linear", programmed, CachedStream(straight.linear_pieces, programmed, machine), {}
    )


def _point_to_point(
    programmed: ProgrammedPath, machine: Machine, options: PathOptions
) -> PlannedPath:
    del options
    return _historical(
        "point-to-point",
        programmed,
        CachedStream(straight.point_to_point_pieces, programmed, machine),
        {},
    )


def _bspline(programmed: ProgrammedPath, machine: Machine, options: PathOptions) -> PlannedPath:
    del options
    return _spline("b-spline", bspline.plain, programmed, machine)


def _pulled(programmed: ProgrammedPath, machine: Machine, options: PathOptions) -> PlannedPath:
    return _spline("b-spline-pulled", PULLS[options.pull], programmed, machine)


def _spline(
    name: str, refine: bspline.Refine, programmed: ProgrammedPath, machine: Machine
) -> PlannedPath:
    interval_s = bspline.interval_time_s(programmed, machine, refine)
    return _historical(
        name,
        programmed,
        CachedStream(bspline.bspline_pieces, programmed, machine, refine, interval_s),
        {"interval_s": interval_s},
    )


def _auto(programmed: ProgrammedPath, machine: Machine, options: PathOptions) -> PlannedPath:
    smoothing = smoothing_for(machine, programmed.axes)
    share = smoothing_share(smoothing, machine, programmed.axes, options.tolerance_m)
    smoothing_m = share * options.tolerance_m
    cut_m = options.tolerance_m - smoothing_m
    blocks = CachedStream(auto_pieces, programmed, cut_m)
    path = _along(programmed, "auto", Timing.GEOMETRIC, blocks, smoothing_m=smoothing_m)
    return _with_deviation(programmed, path, partial(_number_added, programmed, cut_m))


def _optimal(programmed: ProgrammedPath, machine: Machine, options: PathOptions) -> PlannedPath:
    # The timing limits the jerk, so the shape may use the whole tolerance, less the distance of
    # vertices that are left out: moves of a nanometre cannot be timed.
    del machine
    near_m, corners = NEAR_SHARE * options.tolerance_m, options.corners
    cut_m = options.tolerance_m * (1.0 - NEAR_SHARE - _ROUNDING)
    blocks = CachedStream(auto_pieces, programmed, cut_m, near_m, degree=QUARTIC, corners=corners)
    path = _along(programmed, OPTIMAL, Timing.FASTEST, blocks)
    added = partial(_number_added, programmed, cut_m, QUARTIC, corners)
    return _with_deviation(programmed, path, added)


def _firmware(programmed: ProgrammedPath, machine: Machine, options: PathOptions) -> PlannedPath:
    del options
    if machine.planner is None:
        raise OptionError(
            f"{machine.name} has no firmware that plans motion by itself",
            place=machine.place,
            remedy="Write [planner] into the machine file (docs/machine-file.md), or choose "
            "another interpolation.",
        )
    blocks, limits = CachedStream(straight.chords, programmed), programmed.limits
    return _along(programmed, FIRMWARE, Timing.FIRMWARE, blocks, historical=True, limits=limits)


def _parabolic(programmed: ProgrammedPath, machine: Machine, options: PathOptions) -> PlannedPath:
    smoothing = smoothing_for(machine, programmed.axes)
    share = smoothing_share(smoothing, machine, programmed.axes, options.tolerance_m)
    # Unlike a spline, a parabola uses all of its share and leaves nothing for the smoothing's outer
    # ends, which by experiment need a tenth of it at reversals.
    smoothing_m = PARABOLA_SHARE * share * options.tolerance_m
    cut_m = (1.0 - share) * options.tolerance_m
    blocks = CachedStream(blended_pieces, programmed, cut_m)
    path = _along(programmed, "parabolic", Timing.GEOMETRIC, blocks, smoothing_m=smoothing_m)
    return _with_deviation(programmed, path)


def _polynomial(name: str) -> Planner:
    quintic = name == "quintic"

    def planner(programmed: ProgrammedPath, machine: Machine, options: PathOptions) -> PlannedPath:
        bounds = polynomial_limits(
            machine, programmed.axes, programmed.radius_m, options.tolerance_m, quintic=quintic
        )
        blocks = CachedStream(polynomial_pieces, programmed, bounds, quintic=quintic)
        smoothing_m = 0.0 if quintic else options.tolerance_m
        path = _along(programmed, name, Timing.TIME, blocks, smoothing_m=smoothing_m)
        return _with_deviation(programmed, path)

    return planner


_ROUNDED = ("auto", OPTIMAL, "parabolic")
"""Interpolations that round corners within a tolerance.

A machine with a planner of its own reaches a point at which the path goes back along itself, such
as the bottom of a drilled hole, and moves no axis before the program does. So these interpolations
rest there on such a machine.
"""
_PLANNERS: dict[str, Planner] = {
    "auto": _auto,
    OPTIMAL: _optimal,
    FIRMWARE: _firmware,
    "point-to-point": _point_to_point,
    "linear": _linear,
    "parabolic": _parabolic,
    "cubic": _polynomial("cubic"),
    "quintic": _polynomial("quintic"),
    "b-spline": _bspline,
    "b-spline-pulled": _pulled,
}
INTERPOLATIONS = tuple(_PLANNERS)
"""Names of the interpolations, without those by a motion law."""
