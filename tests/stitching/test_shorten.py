"""Linear programs shorten the schedules of a wide band of modes; sums of swings check them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tools.second_stitches import frames, shortest_turns, swings_left, total_s

from threadline.commands.stitch_pace import Moves, Pace
from threadline.commands.stitched import stitch
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.motion.laws import law

MACHINE = load_machine("schiffli-frame")
SINE = law("modified-sine")
FIRST, END = 109, 136  # turns of the rosette, from its long stitches into its circle of 1.8 mm
CHANGE = 4.0 / 3.0 * 3.0 / (2.0 * np.pi)  # by the spindle, of 1 / turn^2, 1/s^2


@pytest.fixture(scope="module")
def passage() -> tuple[Moves, np.ndarray]:
    """Return moves that pass a speed at which each turn excites the mode, and their turns."""
    file = Path(__file__).resolve().parents[2] / "examples" / "rosette.dst"
    moves = stitch(read_job(file, MACHINE), MACHINE, SINE, 1e-4, 0.6).turns.moves
    part = Moves(units=moves.units[FIRST:END], needle=moves.needle[FIRST:END])
    return part, Pace(MACHINE, SINE, 1e-4, 0.25).scheduled(part).turn_s


def test_a_passage_between_the_speeds_of_the_grid_is_found(
    passage: tuple[Moves, np.ndarray],
) -> None:
    """The search on the grid stays slow in the whole circle (16.6 s); a second one takes 13.5 s."""
    _, turn_s = passage
    assert total_s(turn_s, 1.0 / 3.0) <= 1.05 * 13.5


def test_shortened_schedule_keeps_the_tolerance_by_an_independent_sum(
    passage: tuple[Moves, np.ndarray],
) -> None:
    """The sum takes modes 0.3 % apart over +-5 %, and 0.7, 1 and 1.3 times the damping."""
    moves, turn_s = passage
    travels_m = np.asarray(moves.units * 1e-4, dtype=np.float64)
    left_m = swings_left(
        frames(MACHINE, 0.25, 0.003, (0.7, 1.0, 1.3)), travels_m, moves.needle, turn_s, 1.0 / 3.0
    )
    assert 0.95e-4 < left_m <= 1.001e-4
    assert np.abs(np.diff(turn_s**-2.0)).max() <= CHANGE * (1.0 + 1e-9)
    assert (turn_s >= shortest_turns(MACHINE, travels_m) * (1.0 - 1e-9)).all()


@pytest.mark.long(shown_by="test_a_passage_between_the_speeds_of_the_grid_is_found")
def test_no_stitch_of_a_whole_design_is_left_over_the_tolerance() -> None:
    """A second search found 110.6 s; with one stitch 0.2 % over the tolerance 110.4 s would do."""
    file = Path(__file__).resolve().parents[2] / "examples" / "rosette.dst"
    moves = stitch(read_job(file, MACHINE), MACHINE, SINE, 1e-4, 0.6).turns.moves
    turn_s = Pace(MACHINE, SINE, 1e-4, 0.25).scheduled(moves).turn_s
    assert total_s(turn_s, 1.0 / 3.0) <= 1.02 * 110.6
    travels_m = np.asarray(moves.units * 1e-4, dtype=np.float64)
    modes = frames(MACHINE, 0.25, 0.003, (0.7, 1.0, 1.3))
    assert swings_left(modes, travels_m, moves.needle, turn_s, 1.0 / 3.0) <= 1.001e-4
