"""A shaped move compared with the fastest possible one, and the best on/off command."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from threadline.errors import OptionError
from threadline.motion.shaping.onoff.body_and_modes import Command, PerMode, RestToRest, per_mode
from threadline.motion.shaping.onoff.optimal import time_optimal
from threadline.motion.shaping.onoff.robust import ShapedMove, beside, robust_optimum
from threadline.motion.shaping.onoff.switched import FrontPoint, residual_front
from threadline.motion.shaping.types import UNSHAPED, Shaper

WITHIN = 1.1
"""An on/off command is searched up to this multiple of the robust optimum."""
_SEARCH = 30.0
"""Approximate effort of an integer program over a linear one, for progress reports only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveStudy:
    """A move, shaped and not, with its bounds.

    Parameters
    ----------
    move
        The move.
    relative, tolerance
        Half width of the band, and the ringing allowed over it as a share of one full step's.
    optimal
        The time-optimal command: no robustness.
    robust
        The robust optimum, levels free.
    moves
        Unshaped, and shaped.
    front
        Ringing against time on the controller's tick, up to the first on/off command that was
        found within the tolerance; empty without a tick.
    """

    move: RestToRest
    relative: tuple[float, ...]
    tolerance: tuple[float, ...]
    optimal: Command
    robust: Command
    moves: tuple[ShapedMove, ...]
    front: tuple[FrontPoint, ...]

    @property
    def switched(self) -> FrontPoint | None:
        """The shortest on/off command of the front; None if there is none."""
        return next((point for point in self.front if point.command is not None), None)


def study_move(
    move: RestToRest,
    shaper: Shaper,
    *,
    relative: PerMode,
    tolerance: PerMode,
    tick_s: float | None = None,
    dwell_s: float = 0.0,
    progress: Callable[[str, float], None] | None = None,
) -> MoveStudy:
    """Return the study of ``move`` with ``shaper``.

    Parameters
    ----------
    move, shaper
        The move, and a shaper made for its modes.
    relative, tolerance
        Half width of the band, in [0, 1), and the ringing allowed over it: one for all modes, or
        one each.
    tick_s
        Tick of the controller that switches; None omits the search.
    dwell_s
        Shortest time between two changes of the level; 0 for none.
    progress
        Called with the activity and the fraction done.

    Raises
    ------
    OptionError, ShaperError
        If a number is out of range, or a program fails.
    """
    # The robust optimum first: it refuses modes too far apart, where the other may not converge.
    robust = robust_optimum(move, relative=relative, tolerance=tolerance)
    optimal = time_optimal(move).command
    moves = beside(
        move,
        [UNSHAPED, shaper],
        relative=relative,
        optimal_s=optimal.duration_s,
        robust_s=robust.duration_s,
    )
    front: list[FrontPoint] = []
    if tick_s is not None:
        # Below the robust optimum no command can meet the tolerance: it is listed, not searched.
        first_ticks = math.ceil(optimal.duration_s / tick_s - 1e-9)
        last_ticks = math.floor(WITHIN * robust.duration_s / tick_s + 1e-9)
        bound_ticks = math.ceil(robust.duration_s / tick_s - 1e-9)
        coarse_ticks = range(first_ticks, bound_ticks, max(1, (bound_ticks - first_ticks) // 6))
        durations = (*coarse_ticks, *range(bound_ticks, last_ticks + 1))
        dwell_ticks = max(1, math.ceil(dwell_s / tick_s - 1e-9))
        if 2 * dwell_ticks > last_ticks:
            raise OptionError(
                f"on/off command: the valves need {dwell_s:g} s between two switchings, and the "
                f"move takes {robust.duration_s:.4g} s",
                remedy="A command needs room for two stretches: take quicker valves or leave "
                "--dwell out.",
            )
        # Up to the bound a point is one linear program; beyond it an integer program follows.
        effort = [1.0 if ticks < bound_ticks else _SEARCH for ticks in durations]
        for index, ticks in enumerate(durations):
            if progress is not None:
                share = sum(effort[:index]) / sum(effort)
                progress(f"searching on/off commands of {ticks} ticks", share)
            front += residual_front(
                move,
                relative=relative,
                tolerance=tolerance,
                tick_s=tick_s,
                ticks=[ticks],
                dwell_ticks=dwell_ticks,
            )
            if front[-1].command is not None:
                break
    return MoveStudy(
        move=move,
        relative=per_mode(relative, move.modes),
        tolerance=per_mode(tolerance, move.modes),
        optimal=optimal,
        robust=robust,
        moves=tuple(moves),
        front=tuple(front),
    )
