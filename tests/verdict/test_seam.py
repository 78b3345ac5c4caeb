"""The seam against its drawing, by closed forms: chords of a circle, and a missing tip.

There are 50 stitches a second, and samples every 5 ms, so that every needle-down is on a sample.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from threadline.files import ChannelKind, Stream
from threadline.geometry.arclength import arc_table
from threadline.geometry.contours import DrawnLine
from threadline.geometry.curves import chords, ellipse_arc
from threadline.jobs.operations import Feed, FeedMode, Move, Source
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import prove
from threadline.verdict import Criterion, Status, judge, load_spec

from .builders import TICK_S, plan_through, record, spec_of

PERIOD_S = 0.02
RADIUS_M, COUNT = 4e-3, 12
ANGLE = 2 * np.pi / COUNT


def circle() -> DrawnLine:
    a, b = np.array([RADIUS_M, 0.0]), np.array([0.0, RADIUS_M])
    return DrawnLine(arc_table(ellipse_arc(np.zeros(2), a, b, 0.0, 2 * np.pi)), True)


def plan_of(downs, at_m, line, tagged=True):
    """Return a plan through needle-downs, each stitch with its stretch of the line."""
    plan = plan_through(downs, move_s=PERIOD_S, vertices_per_block=5)
    feed = Feed(FeedMode.INVERSE_TIME, 1 / PERIOD_S)
    moves = [
        Move(
            tuple(point),
            feed,
            Source("by-hand.svg", 10 * k + 10),
            {"kind": "sew", "contour": 0, "stitch": k, "exempt": 0, "target_m": 2e-3}
            | ({"from_m": at_m[k], "to_m": at_m[k + 1]} if tagged else {}),
        )
        for k, point in enumerate(downs[1:])
    ]
    drawn = (line,) if tagged else ()
    return replace(plan, job=replace(plan.job, operations=Stream.of(moves), drawn=drawn))


def sewn(plan, downs, per_block=13):
    """Return the verdict on a tool that moves straight from needle-down to needle-down."""
    count = len(downs) - 1
    time = TICK_S * np.arange(round(count * PERIOD_S / TICK_S) + 41)
    turns = np.minimum(time / PERIOD_S, count)
    tool = np.column_stack([np.interp(turns, np.arange(count + 1), x) for x in np.transpose(downs)])
    operation = np.minimum(np.floor(turns + 1e-9), count - 1)
    recording = record(("X", "Y"), {ChannelKind.LOAD: tool}, operation, per_block=per_block)
    names = ("seam_error", "contour_error")
    return judge([recording], plan, spec_of(*(Criterion(name=n, limit=5e-4) for n in names)))


def on_circle(radius: float) -> list[list[float]]:
    turn = ANGLE * np.arange(COUNT + 1)
    return [[radius * np.cos(t), radius * np.sin(t)] for t in turn]


@pytest.mark.parametrize("per_block", [1, 13, 1000])
@pytest.mark.parametrize("wider", [0.0, 1e-4, 4e-4, -1e-4])
def test_chords_of_a_circle(wider: float, per_block: int) -> None:
    """The middle of each arc is R - (R + d) cos(angle / 2) away, each needle-down d."""
    line = circle()
    at_m = np.linspace(0.0, 2 * np.pi * RADIUS_M, COUNT + 1)
    plan = plan_of(on_circle(RADIUS_M), at_m, line)
    verdict = sewn(plan, on_circle(RADIUS_M + wider), per_block)
    rise = RADIUS_M - (RADIUS_M + wider) * np.cos(ANGLE / 2)
    result = verdict.result("seam_error")

    assert result.measured == pytest.approx(max(abs(rise), abs(wider)), abs=1e-9)
    if not wider:  # the seam keeps the chords, but not the drawing
        assert verdict.result("contour_error").measured == pytest.approx(0.0, abs=1e-9)
        assert "drawn there" in result.note


def test_a_tip_that_is_cut_off_is_found_in_its_place() -> None:
    """20 mm forth and back 1 mm beside: the seam turns round 6 mm before the tip."""
    corners = np.array([[0.0, 0.0], [0.02, 0.0], [0.02, 1e-3], [0.0, 1e-3]])
    line = DrawnLine(arc_table(chords(corners)), False)
    downs = [[2e-3 * k, 0.0] for k in range(8)] + [[14e-3 - 2e-3 * k, 1e-3] for k in range(8)]
    at_m = np.array([2e-3 * k for k in range(8)] + [27e-3 + 2e-3 * k for k in range(8)])
    result = sewn(plan_of(downs, at_m, line), downs).result("seam_error")

    # 16 places of the 13 mm about the tip are checked: the farthest is nearly at its end.
    assert 6e-3 - 13e-3 / 16 < result.measured <= 6.1e-3
    assert result.status is Status.FAILED
    assert result.job_line == 80  # the stitch that goes across
    assert result.position[0] > 0.019


def test_stitch_ahead_on_its_line_is_no_seam_error() -> None:
    """A tenth of a stitch too far along a straight line is no error, except at its end."""
    line = DrawnLine(arc_table(chords(np.array([[0.0, 0.0], [0.1, 0.0]]))), False)
    downs = [[2e-3 * k, 0.0] for k in range(31)]
    at_m = 2e-3 * np.arange(31)
    ahead = [[0.0, 0.0], *[[x + 2e-4, 0.0] for x, _ in downs[1:-1]], downs[-1]]
    assert sewn(plan_of(downs, at_m, line), ahead).result("seam_error").measured < 1e-12


def test_without_a_drawing_nothing_is_measured() -> None:
    downs = on_circle(RADIUS_M)
    verdict = sewn(plan_of(downs, np.zeros(COUNT + 1), circle(), tagged=False), downs)
    result = verdict.result("seam_error")
    assert (result.status, result.measured) == (Status.NOT_MEASURED, None)
    assert "no drawing" in result.note


def test_an_arc_that_stitches_miss_is_out_of_spec(tmp_path) -> None:
    """Chords of 3.1 mm on a radius of 2 mm miss it by 0.7 mm; the seam keeps the chords."""
    path = tmp_path / "arc.seam.toml"
    path.write_text(
        '[stitching]\nstitch_length = "3.1 mm"\nneedle_speed = "2 stitch/s"\nbow = "1 mm"\n'
        'placement = "1 mm"\n[[contour]]\nunit = "mm"\n'
        "points = [[0, 0], [20, 0], {to = [20, 4], bulge = 1}, [0, 4]]\n"
    )
    machine = load_machine("stitcher")
    proof = prove(path, machine, load_spec(None, machine), Options())
    seam, contour = (proof.verdict.result(n) for n in ("seam_error", "contour_error"))

    assert contour.status is Status.PASSED and contour.measured < 0.2e-3
    assert seam.status is Status.FAILED
    assert 0.4e-3 < seam.measured < 0.9e-3
    assert not proof.verdict.passed
