"""The ends of a path for the least time: no chord of almost no length, and wider cuts."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.files import Stream
from threadline.machine import load_machine
from threadline.motion.path import path_deviation, plan_path
from threadline.motion.path.polygon import ANY_CUT, turns
from threadline.motion.path.runs import runs
from threadline.motion.path.types import ProgrammedPath, VertexBlock

WINDER = load_machine("lathe-winder")


def programmed(places, cuts=(), rests=()) -> ProgrammedPath:
    places = np.array(places, dtype=float)
    rows = np.arange(len(places))
    rest = np.isin(rows, [*rests, len(places) - 1]).astype(np.int64)
    blocks = [
        VertexBlock(
            positions=places[part],
            operation=np.maximum(part - 1, 0),
            nominal_s=np.zeros(len(part)),
            rest=rest[part],
            dwell_s=np.zeros(len(part)),
            line=part,
        )
        for part in np.split(rows, list(cuts))
    ]
    return ProgrammedPath(axes=("X", "Y"), radius_m=np.ones(2), blocks=Stream.of(blocks))


@pytest.mark.parametrize("seed", range(5))
def test_wide_tolerances_are_used_at_the_ends_of_a_run_and_held(seed):
    """Two or three legs, and a tolerance so wide that no corner needs additional points.

    ``path_deviation`` compares it with the program; ``auto`` cuts less, because its smoothing in
    time uses a share of the tolerance.
    """
    random = np.random.default_rng(seed)
    places = np.cumsum(random.uniform(-0.02, 0.02, (3 + seed % 2, 2)), axis=0)
    places[:, 1] += 0.1
    length, turn = turns(places, np.ones(2))
    most = np.maximum(length[1:], length[:-1])
    cut_m = 1.0001 * ANY_CUT * float((turn[1:-1] * most).max())
    program = programmed(places)
    mine, auto = (
        path_deviation(program, plan_path(program, WINDER, name, cut_m / 0.99)).at_tool_m
        for name in ("optimal", "auto")
    )
    assert auto < mine <= cut_m * (1.0 + 1e-9)


def test_a_vertex_near_the_end_of_a_run_gives_way_to_it_wherever_blocks_end():
    """Within 1 um of a rest by a tolerance of 0.1 mm; its move then ends at the rest, exactly."""
    places = [[0, 0.1], [0.02, 0.1], [0.02, 0.1 + 5e-7], [0, 0.1 + 5e-7], [0.02, 0.1], [0.02, 0.12]]
    places += [[0.03, 0.12], [0.03, 0.12 + 9e-7]]
    kept = [[0, 1], [3], [4, 5, 6]]  # rows of each run; 2, 3 and 7 are rests
    for cuts in ([], [1], [2], [3], [6], [7], [2, 7], [1, 2, 3, 4, 5, 6, 7]):
        found, run = [], []
        for chunk in runs(programmed(places, cuts, rests=(2, 3)), 1e-6):
            run += list(
                zip(
                    chunk.vertices.line.tolist(),
                    map(tuple, chunk.vertices.positions.tolist()),
                    strict=True,
                )
            )
            if chunk.is_last:
                found.append(run)
                run = []
        assert [[line for line, _ in run] for run in found] == kept, cuts
        ends = [run[-1][1] for run in found]
        assert ends == [(0.02, 0.1 + 5e-7), (0.0, 0.1 + 5e-7), (0.03, 0.12 + 9e-7)], cuts
    path = plan_path(programmed([[0, 0.1], [0.2, 0.1], [0.2, 0.1 + 9e-7]]), WINDER, "optimal")
    (block,) = list(path)
    assert len(block) == 1 and not block.coefficients[0, 2:].any()
